"""`scanmotion fuse`: measured scans into one."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import OK, Progress, progress_bar
from scanmotion.cli.inputs import OUT, Quiet, Units, check_file, check_suffix
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from scanmotion.sensing.fusion.fuse import Cloud
    from scanmotion.sensing.scans.scan_files import MeasuredScan


def fuse(
    scans: Annotated[list[Path], typer.Argument(help="Measured scans, or a folder of them.")],
    out: Annotated[Path, typer.Option("--out", help="Fused cloud or surface, PLY, mm.", rich_help_panel=OUT)],
    units: Units = "",
    poses: Annotated[
        Path | None,
        typer.Option("--poses", help='JSON: {"scans": {FILE: {"T_object_scan": 4 x 4}}}, file units.'),
    ] = None,
    voxel: Annotated[float, typer.Option("--voxel", help="Edge of the cloud's voxels, in mm.")] = 2.0,
    align: Annotated[bool, typer.Option(help="Register the scans to one another first.")] = True,
    surface: Annotated[bool, typer.Option("--surface", help="Write a triangle mesh, not a cloud.")] = False,
    quiet: Quiet = False,
) -> int:
    """Merge measured scans into one cloud, or one surface trimmed to the data.

    Scans without poses are taken to be in the table's frame already. Of a folder every file of a known kind
    is taken, whatever the case of its ending.

    A registration that cannot be trusted leaves a scan where its pose puts it, and says so.
    """
    check_suffix("--out", out, ".ply")
    if not 0.05 <= voxel <= 100.0:
        raise InputError(f"--voxel {voxel:g}: must lie between 0.05 and 100 mm")
    files = scan_files(scans)
    known = read_poses(poses, files) if poses is not None else {}
    with progress_bar(quiet=quiet) as progress:
        measured = measured_scans(files, known, units, progress)
        from scanmotion.sensing.scans.scan_files import fuse_measured

        fused = fuse_measured(measured, voxel=voxel * 1e-3, registered=align, progress=progress)
        if not len(fused.cloud.points):
            raise InputError("no point of the scans has neighbours enough to be kept; is --voxel too small?")
        made = write_surface(out, fused.cloud) if surface else write_cloud(out, fused.cloud)
    if not quiet:
        for scan, side in zip(measured, fused.sides, strict=True):
            read = "" if scan.report is None else f": {scan.report.line}"
            typer.echo(f"{scan.name}{read}" + (f"; {side}" if side else ""))
        for name, found in zip(fused.names[1:], fused.registrations[1:], strict=False):
            moved = f", moved by {found.shift * 1e3:.2f} mm" if found.trusted else ""
            typer.echo(f"{name}: {found.statement}{moved}")
        typer.echo(f"{sum(len(s.points) for s in measured)} points of {len(files)} scans -> {made}")
        typer.echo(str(out))
    return OK


def scan_files(paths: list[Path]) -> list[Path]:
    """The files named, and those in the folders named, in the order of their names.

    Raises:
        InputError: a folder without a scan.
    """
    from scanmotion.geometry.files.part_files import SUFFIXES

    files = []
    for path in paths:
        inside = [path]
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
        if not inside:
            raise InputError(f"{path}: no scan in this folder; known: {', '.join(SUFFIXES)}")
        files += inside
    return files


def read_poses(path: Path, files: list[Path]) -> "dict[str, dict[str, np.ndarray]]":
    """What a pose file says of each file: its pose (4, 4), and which way it looked (3,) where that is told.

    Raises:
        InputError: unreadable, a file without a pose, or a pose that is no rigid motion.
    """
    import json

    import numpy as np

    check_file("--poses", path)
    try:
        scans = json.loads(path.read_text(encoding="utf-8"))["scans"]
        records: dict[str, dict[str, np.ndarray]] = {}
        for file in files:
            told, record = dict(scans[file.name]), {}
            for key, shape in (("T_object_scan", (4, 4)), ("nominal_view_direction", (3,))):
                if key == "T_object_scan" or key in told:
                    record[key] = np.array(told[key], dtype=float).reshape(shape)
            records[file.name] = record
    except (ValueError, TypeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not a pose file ({str(error)[:120]})") from None
    except KeyError as error:
        raise InputError(f"{path}: holds no {error}") from None
    for name, record in records.items():
        X = record["T_object_scan"]
        R, p, last = X[:3, :3], X[:3, 3], X[3]
        rigid = np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0
        if not rigid or not np.allclose(last, [0, 0, 0, 1]) or not (np.abs(p) < 1e9).all():
            raise InputError(f"{path}: the pose of {name} is no rigid motion")
        direction = record.get("nominal_view_direction", np.ones(3))
        if not np.isfinite(direction).all() or not np.linalg.norm(direction) > 1e-9:
            raise InputError(f"{path}: the viewing direction of {name} is no direction")
    return records


def measured_scans(
    files: list[Path], poses: "dict[str, dict[str, np.ndarray]]", units: str, progress: Progress
) -> "list[MeasuredScan]":
    """The scans with their poses, in metres, and which way each looked.

    A pose file may give the viewing direction of a scan; without it the scan's own origin is the camera.
    Without a pose the sides are worked out from all scans together (see sensing.scans.scan_sides).
    """
    import numpy as np

    from scanmotion.geometry.parts.cloud_files import cloud_from_file
    from scanmotion.geometry.parts.placing import UNITS
    from scanmotion.sensing.scans.scan_files import MeasuredScan

    scans = []
    for number, file in enumerate(files):
        progress("load", number / len(files))
        record = poses.get(file.name)
        up = None if record is not None else np.array([0.0, 0.0, 1.0])
        read = cloud_from_file(file, units=units or None, up=up, any_size=number > 0)
        X, towards = np.eye(4), None
        if record is not None:
            X = record["T_object_scan"].copy()
            X[:3, 3] *= UNITS[read.report.units]
            towards = -read.points.mean(axis=0)
            if "nominal_view_direction" in record:
                towards = -X[:3, :3].T @ record["nominal_view_direction"]
            length = float(np.linalg.norm(towards))
            towards = towards / length if length > 1e-9 else None
        scans.append(
            MeasuredScan(name=file.name, points=read.points, X=X, towards=towards, normals=read.normals,
                         report=read.report)
        )  # fmt: skip
    return scans


def write_surface(path: Path, cloud: "Cloud") -> str:
    """The surface through a cloud as binary PLY in mm; says how much it is."""
    from scanmotion.geometry.files.ply_write import write_ply
    from scanmotion.sensing.fusion.surface import surface

    vertices, triangles = surface(cloud)
    write_ply(path, vertices * 1e3, triangles=triangles)
    return f"{len(triangles)} triangles"


def write_cloud(path: Path, cloud: "Cloud") -> str:
    """A cloud with normals as binary PLY in mm, whole or not at all; says how much it is."""
    from scanmotion.geometry.files.ply_write import write_ply

    write_ply(path, cloud.points * 1e3, normals=cloud.normals)
    return f"{len(cloud.points)} points"
