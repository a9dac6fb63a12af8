"""`scanmotion job`: the loop of a real scan, from the first programme to the fused model."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import (  # fmt: skip
    OUT,
    CellFile,
    Json,
    Quiet,
    Robot,
    Seed,
    Units,
    box_from,
    cell_from,
    check_file,
    check_suffix,
)
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.job.store import Job

job_app = typer.Typer(
    no_args_is_help=True, help="A real scan, step by step: programme, frames, what is missing, model."
)

JobFolder = Annotated[Path, typer.Argument(metavar="JOB", help="Folder of the job.")]


@job_app.command("new", epilog="Example: scanmotion job new statue --cell my-cell.yaml --box 330 200 600")
def new(
    folder: JobFolder,
    box: Annotated[
        tuple[float, float, float],
        typer.Option("--box", metavar="L W H", help="The object's bounding box, mm."),
    ],
    robot: Robot = None,
    cell: CellFile = None,
    seed: Seed = 0,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Start a job: a folder with the cell, the global programme and the list of its frames."""
    settings = cell_from(robot, cell)
    part = box_from(box)
    from scanmotion.job.flow import start_job

    with progress_bar(quiet=quiet or json) as progress:
        job = start_job(folder, cell, settings, part, box, seed=seed, progress=progress)
    return _told(_state(job), json, quiet)


@job_app.command("add", epilog="Example: scanmotion job add statue scanner/plan-1")
def add(
    folder: JobFolder,
    frames: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Frames, or folders of them: PLY, PCD, XYZ in the scanner's frame; depth NPZ, PNG."
        ),
    ] = None,
    frames_list: Annotated[
        Path | None,
        typer.Option(
            "--frames",
            help="CSV with file, and index, t_s or T00..T33 (pose of the frame in the object's, mm); or a "
            "JSON pose file. Default: frames.csv beside the frames, else the number that ends a file's name.",
        ),
    ] = None,
    log: Annotated[
        Path | None, typer.Option("--log", help="The controller's log, CSV: t_s and the joints in deg.")
    ] = None,
    offset: Annotated[
        float, typer.Option("--offset", help="Added to the frames' time stamps to give the log's time, s.")
    ] = 0.0,
    plan: Annotated[
        int | None, typer.Option("--plan", min=1, help="Whose frames they are; default: the last.")
    ] = None,
    intrinsics: Annotated[
        Path | None,
        typer.Option("--intrinsics", help="JSON: fx, fy, cx, cy in pixels, unit_m of a PNG's count."),
    ] = None,
    units: Units = "mm",
    simulate: Annotated[
        Path | None,
        typer.Option(
            "--simulate", help="No frames: the twin scans this mesh along the plan and writes its files."
        ),
    ] = None,
    kind: Annotated[str, typer.Option("--kind", help="With --simulate: ply, xyz or npz.")] = "ply",
    stride: Annotated[
        int, typer.Option("--stride", min=1, max=64, help="With --simulate: every n-th pixel.")
    ] = 2,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Add frames: each is given its pose; those that the job has already are noticed and left out."""
    if (simulate is None) == (not frames):
        raise InputError("give FRAMES, or --simulate with the mesh that the twin scans")
    for option, path in (("--frames", frames_list), ("--log", log), ("--intrinsics", intrinsics)):
        if path is not None:
            check_file(option, path)
    from scanmotion.geometry.parts.make_part import UNITS, part_from_file
    from scanmotion.job.adding import AddOptions, add_frames
    from scanmotion.job.flow import simulated_frames
    from scanmotion.job.store import load_job

    if units not in UNITS:
        raise InputError(f"--units {units}: unknown; known: {', '.join(UNITS)}")
    job = load_job(folder)
    with progress_bar(quiet=quiet or json) as progress:
        if simulate is not None:
            check_file("--simulate", simulate)
            frames = [
                simulated_frames(
                    job, part_from_file(simulate, units=units), plan, kind=kind, stride=stride,
                    progress=lambda f: progress("twin", f),
                )
            ]  # fmt: skip
            log = log or frames[0] / "log.csv"
        options = AddOptions(
            frames_list=frames_list, log=log, offset_s=offset, plan=plan, intrinsics=intrinsics,
            unit=1e-3 if simulate is not None else UNITS[units], simulated=simulate is not None,
        )  # fmt: skip
        found = add_frames(job, frames or [], options, lambda f: progress("read", f))
    told = {
        "added": found.frames, "points": found.points,
        "had already": len(found.double), "poses from": found.how or "-"
    }  # fmt: skip
    return _told(told, json, quiet)


@job_app.command("next", epilog="Example: scanmotion job next statue")
def next_(folder: JobFolder, quiet: Quiet = False, json: Json = False) -> int:
    """Plan what is still missing, against all that has been seen."""
    from scanmotion.job.flow import plan_next
    from scanmotion.job.store import load_job

    with progress_bar(quiet=quiet or json) as progress:
        found = plan_next(load_job(folder), progress=progress)
    status = _told(found, json, quiet)
    return CHECK_FAILED if found.get("findings") else status


@job_app.command("status", epilog="Example: scanmotion job status statue")
def status(folder: JobFolder, quiet: Quiet = False, json: Json = False) -> int:
    """Say where the job stands."""
    from scanmotion.job.store import load_job

    return _told(_state(load_job(folder)), json, quiet)


@job_app.command("report", epilog="Example: scanmotion job report statue --reference statue.stl")
def report(
    folder: JobFolder,
    reference: Annotated[
        Path | None, typer.Option("--reference", help="CAD mesh: the model is held against it too.")
    ] = None,
    units: Units = "mm",
    register: Annotated[bool, typer.Option(help="Register later frames onto the first.")] = True,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Write report.html and report.json into the job: what was seen, what is missing, how segments fit."""
    if reference is not None:
        check_file("--reference", reference)
    from scanmotion.job.report import write_report
    from scanmotion.job.store import load_job

    with progress_bar(quiet=quiet or json) as progress:
        told = write_report(load_job(folder), reference, units, registered=register, progress=progress)
    return _told(told, json, quiet)


@job_app.command("model", epilog="Example: scanmotion job model statue --out statue.ply")
def model(
    folder: JobFolder,
    out: Annotated[Path, typer.Option("--out", help="Cloud or surface, PLY, mm.", rich_help_panel=OUT)],
    surface: Annotated[bool, typer.Option("--surface", help="A triangle mesh, not a cloud.")] = False,
    register: Annotated[bool, typer.Option(help="Register later frames onto the first.")] = True,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Fuse all frames into one model."""
    check_suffix("--out", out, ".ply")
    from scanmotion.job.flow import write_model
    from scanmotion.job.store import load_job

    with progress_bar(quiet=quiet or json) as progress:
        told = write_model(load_job(folder), out, surface=surface, registered=register, progress=progress)
    return _told(told, json, quiet)


def _state(job: "Job") -> dict[str, object]:
    from scanmotion.job.flow import state_of

    return state_of(job)


def _told(told: Mapping[str, object], json: bool, quiet: bool) -> int:
    """Says a flat record."""
    if json:
        say_json(told)
    elif not quiet:
        rows = []
        for key, value in told.items():
            many = value if isinstance(value, list) else [value]
            rows += [(key.replace("_", " "), str(v)) for v in many]
        print_table("The job", (), rows)
    return OK
