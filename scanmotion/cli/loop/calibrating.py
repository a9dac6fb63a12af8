"""`scanmotion calibrate`: the constant errors of a cell from frames, and the turns that tell them best."""

from pathlib import Path
from typing import Annotated

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import CellFile, Json, PartFile, Quiet, Robot, Seed, Units, cell_from, check_suffix
from scanmotion.cli.inputs import write_text as write
from scanmotion.core.errors import InputError


def calibrate(
    job: Annotated[str, typer.Argument(metavar="JOB|plan", help="Folder of a job, or the word plan.")],
    write_cell: Annotated[
        Path | None, typer.Option("--write-cell", help="Write the calibrated cell's YAML.")
    ] = None,
    apply: Annotated[
        bool, typer.Option("--apply/--no-apply", help="Correct the job's frames by it from now on.")
    ] = True,
    robot: Robot = None,
    cell: CellFile = None,
    part: PartFile = None,
    units: Units = "mm",
    turns: Annotated[int, typer.Option("--turns", min=2, max=8, help="With plan: how many.")] = 4,
    seed: Seed = 0,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Estimate hand-eye, table axis, backlash and latency from a job's frames, with standard deviations.

    `calibrate plan` proposes the few turns that determine them best, on --part or the built-in carving.
    """
    check_suffix("--write-cell", write_cell, ".yaml", ".yml")
    if job == "plan":
        if write_cell is not None:
            raise InputError("--write-cell: calibrate plan measures nothing; give it with a job")
        return _propose(robot, cell, part, units, turns, seed, quiet, json)
    if robot is not None or cell is not None or part is not None:
        raise InputError("--robot, --cell and --part go with `calibrate plan`; a job has its cell already")
    from scanmotion.job.calibrate import calibrated_cell, calibration_of, cell_yaml, record_of
    from scanmotion.job.store import load_job, with_calibration

    it = load_job(job)
    with progress_bar(quiet=quiet or json) as progress:
        progress("calibrate", 0.2)
        found = calibration_of(it)
    record = record_of(found)
    if write_cell is not None:
        write(write_cell, cell_yaml(calibrated_cell(it, found), found))
    applied = apply and found.determined
    if applied:
        with_calibration(it, record["estimated"])
    record |= {"applied": applied, "cell": None if write_cell is None else str(write_cell)}
    if json:
        say_json(record)
    elif not quiet:
        rows = [(k, _text(v), _text(record["sd"][k])) for k, v in record["estimated"].items()]
        print_table("Calibration", ("constant", "estimated", "standard deviation"), rows)
        print_table("", (), [("", record["statement"])])
    return OK if found.determined else CHECK_FAILED


def _text(value: float | list[float]) -> str:
    many = value if isinstance(value, list) else [value]
    return "  ".join(f"{v:+.4f}" for v in many)


def _propose(
    robot: str | None,
    cell: Path | None,
    part: Path | None,
    units: str,
    turns: int,
    seed: int,
    quiet: bool,
    json: bool,
) -> int:
    """Says which turns tell the constants best, and how well."""
    import numpy as np

    from scanmotion.geometry.parts.make_part import carving, part_from_file
    from scanmotion.plan_io.scans.measured import constants_by_name
    from scanmotion.sensing.corrections.calibration_plan import best_turns, candidate_turns
    from scanmotion.sensing.simulator.captures import ScanErrors

    settings = cell_from(robot, cell)
    subject = carving() if part is None else part_from_file(part, units=units)
    scanner = settings.scanner_model()
    speed = settings.turntable.speed_rpm * np.pi / 30
    noise = ScanErrors(**settings.twin_errors())
    with progress_bar(quiet=quiet or json) as progress:
        progress("simulate", 0.1)
        found = best_turns(
            subject, scanner, candidate_turns(subject, scanner, speed=speed), count=turns, seed=seed,
            acceleration=settings.turntable.acceleration_rad_s2, fps=settings.process.fps,
            errors=noise.without_constants(),
        )  # fmt: skip
    told = {
        "turns": [t.name for t in found.turns], "expected_sd": constants_by_name(found.expected.sd),
        "determined": found.expected.determined, "statement": found.expected.statement,
        "T_object_scanner": [t.X_OS.tolist() for t in found.turns],
    }  # fmt: skip
    if json:
        say_json(told)
    elif not quiet:
        print_table(
            "Turns that tell most", ("", "turn"), [(str(i + 1), n) for i, n in enumerate(told["turns"])]
        )
        rows = [(k, _text(v)) for k, v in told["expected_sd"].items()]
        print_table("Expected", ("constant", "standard deviation"), rows)
    return OK
