"""A plan for other programs: one writer a format, each a function of what the judge judged.

The writers read plan.json, trajectory.csv and the cell's settings, files that `scanmotion verify` judges, and
nothing else of the trajectory: what is exported is what was judged. docs/exports.md describes every format.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.export.job import Writer

_WRITERS = {
    "csv": "csv_file.csv_files",
    "json": "json_file.json_files",
    "viewpoints": "viewpoints.viewpoint_files",
    "krl": "krl.programme.classic_files",
    "krl-timed": "krl.programme.timed_files",
    "rapid": "rapid.rapid_files",
    "urscript": "urscript.programme.urscript_files",
    "ros": "ros.yaml_files",
    "mcap": "ros.bag_files",
}
FORMATS = tuple(_WRITERS)
PROGRAMMES = ("krl", "krl-timed", "rapid", "urscript")
"""Formats that a robot's controller runs."""


def export_files(
    folder: str | Path,
    to: str,
    *,
    out: str | Path | None = None,
    name: str = "scan",
    signal: int | None = None,
    dry_run: bool = False,
) -> list[Path]:
    """Writes a plan in another format, each file whole or not at all.

    Args:
        folder: what `scanmotion plan` wrote.
        to: one of `FORMATS`.
        out: folder to write to, made if missing; by default the plan's own.
        name: of the robot programme, and the stem of the files' names.
        signal: number of the digital output that a programme switches on while the scanner scans; None is the
            cell's `programme.start_out`.
        dry_run: a programme with the scanner off, at a tenth of the speed, that halts at each view.

    Returns:
        The files written.

    Raises:
        InputError: unknown format, a name that the format cannot carry, text in the plan that does not belong
            into a programme, a missing library, a folder that cannot be written.
        PlanFileError: the plan cannot be read.
    """
    if to not in FORMATS:
        raise InputError(f"--to {to!r}: unknown format; known are {', '.join(FORMATS)}")
    if to not in PROGRAMMES and (signal is not None or dry_run):
        option = f"--signal {signal}" if signal is not None else "--dry-run"
        raise InputError(f"{option}: only a programme ({', '.join(PROGRAMMES)}) knows it")
    from scanmotion.export.job import job_from
    from scanmotion.export.source import check_targets, checked_name, source_from, write_files

    checked_name(name)
    source = source_from(folder)
    target = Path(folder) if out is None else Path(out)
    files = writer_of(to)(job_from(source, name, signal=signal, dry_run=dry_run))
    check_targets(source, target, files)
    return write_files(target, files)


def writer_of(to: str) -> "Writer":
    """The writer of one of `FORMATS`."""
    module, function = _WRITERS[to].rsplit(".", 1)
    return getattr(import_module(f"scanmotion.export.{module}"), function)
