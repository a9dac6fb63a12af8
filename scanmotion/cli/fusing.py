"""`scanmotion fuse`: measured scans into one."""

from pathlib import Path
from typing import Annotated

import typer

from scanmotion.cli.app import OK, progress_bar
from scanmotion.cli.inputs import OUT, Quiet, Seed, Units
from scanmotion.errors import InputError


def fuse(
    files: Annotated[list[Path], typer.Argument(help="Measured scans in the table's frame.")],
    out: Annotated[Path, typer.Option("--out", help="Fused cloud or surface, PLY.", rich_help_panel=OUT)],
    units: Units = "mm",
    voxel: Annotated[float, typer.Option("--voxel", help="Edge of the cloud's voxels [mm].")] = 2.0,
    register: Annotated[
        bool, typer.Option("--register/--no-register", help="Align the scans to one another first.")
    ] = True,
    surface: Annotated[bool, typer.Option("--surface", help="Write a triangle mesh, not a cloud.")] = False,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Merge measured scans into one cloud or surface."""
    from scanmotion.scan.files import fuse_files

    if out.suffix != ".ply":
        raise InputError(f"--out {out}: must end in .ply")
    if not 0.05 <= voxel <= 100.0:
        raise InputError(f"--voxel {voxel:g}: must lie between 0.05 and 100 mm")
    with progress_bar(quiet=quiet) as progress:
        lines = fuse_files(
            files, out, units=units, voxel=voxel * 1e-3, align=register, surface=surface, seed=seed,
            progress=progress,
        )  # fmt: skip
    if not quiet:
        for line in lines:
            typer.echo(line)
    return OK
