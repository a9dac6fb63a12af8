"""A plan for other programs: one writer a format, each a function of what the judge judged.

The writers read plan.json and trajectory.csv, the files that `scanmotion verify` judges, and nothing else of
the trajectory: what is exported is what was judged. docs/exports.md describes every format.
"""

from pathlib import Path

from scanmotion.core.errors import InputError

FORMATS = ("csv", "json", "viewpoints", "krl", "krl-timed", "ros", "mcap")


def export_plan(
    folder: str | Path,
    to: str,
    *,
    out: str | Path | None = None,
    name: str = "scan",
    signal: int | None = None,
) -> list[Path]:
    """Writes a plan in another format, each file whole or not at all.

    Args:
        folder: what `scanmotion plan` wrote.
        to: one of `FORMATS`.
        out: folder to write to, made if missing; by default the plan's own.
        name: of the robot programme, and the stem of the files' names.
        signal: number of the digital output that a KUKA programme switches on while the scanner scans;
            None leaves the trigger to whoever edits the programme.

    Returns:
        The files written.

    Raises:
        InputError: unknown format, a name that the format cannot carry, text in the plan that does not belong
            into a programme, a missing library, a folder that cannot be written.
        PlanFileError: the plan cannot be read.
    """
    if to not in FORMATS:
        raise InputError(f"--to {to!r}: unknown format; known are {', '.join(FORMATS)}")
    if signal is not None and not to.startswith("krl"):
        raise InputError(f"--signal {signal}: only a KUKA programme (krl, krl-timed) switches an output")
    from scanmotion.export.source import check_targets, checked_name, source_from, write_files

    checked_name(name)
    source = source_from(folder)
    target = Path(folder) if out is None else Path(out)
    files = _files(source, to, name, signal)
    check_targets(source, target, files)
    return write_files(target, files)


def _files(source, to: str, name: str, signal: int | None) -> dict[str, bytes | str]:
    if to in ("krl", "krl-timed"):
        from scanmotion.export.krl import classic_files, timed_files

        return (classic_files if to == "krl" else timed_files)(source, name, signal)
    if to == "csv":
        from scanmotion.export.csv_file import csv_files as writer
    elif to == "json":
        from scanmotion.export.json_file import json_files as writer
    elif to == "viewpoints":
        from scanmotion.export.viewpoints import viewpoint_files as writer
    elif to == "ros":
        from scanmotion.export.ros import yaml_files as writer
    else:
        from scanmotion.export.ros import bag_files as writer
    return writer(source, name)
