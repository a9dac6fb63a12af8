"""A plan as files for others, and beside a programme its risk sheet."""

from pathlib import Path

from scanmotion.export import PROGRAMMES, export_files


def export_plan(
    folder: str | Path,
    to: str,
    *,
    out: str | Path | None = None,
    name: str = "scan",
    signal: int | None = None,
    dry_run: bool = False,
    risk: bool = True,
) -> list[Path]:
    """Writes a plan in another format, each file whole or not at all.

    Args:
        folder: what `scanmotion plan` wrote.
        to: csv, json, viewpoints, krl, krl-timed, rapid, urscript, ros or mcap.
        out: folder to write to, made if missing; by default the plan's own.
        name: of the robot programme, and the stem of the files' names.
        signal: number of the digital output that a programme switches on while the scanner scans; None is the
            cell's `programme.start_out`.
        dry_run: a programme with the scanner off, at a tenth of the speed, that halts at each view.
        risk: whether a programme gets its risk sheet beside it.

    Returns:
        The files written.

    Raises:
        InputError: unknown format, a name that the format cannot carry, text in the plan that does not belong
            into a programme, a missing library, a folder that cannot be written.
        PlanFileError: the plan cannot be read.
    """
    files = export_files(folder, to, out=out, name=name, signal=signal, dry_run=dry_run)
    if risk and to in PROGRAMMES:
        files += risk_sheet(Path(folder), Path(folder if out is None else out), name)
    return files


def risk_sheet(folder: Path, out: Path, name: str) -> list[Path]:
    """Writes the risk sheet of a plan.

    Args:
        folder: of the plan.
        out: where to write.
        name: stem of the files' names.

    Raises:
        PlanFileError: the plan cannot be read.
        InputError: the files cannot be written.
    """
    from scanmotion.export.source import write_files
    from scanmotion.judge.left_out import not_judged
    from scanmotion.judge.risk.page import risk_files
    from scanmotion.judge.risk.sheet import risk_of

    return write_files(out, risk_files(risk_of(folder), name, not_judged(folder)))
