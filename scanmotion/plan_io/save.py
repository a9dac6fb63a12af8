"""Saving a plan: its files are written, the judge looks at them, then the summary is written beside them.

Guarantees: the folder is replaced as a whole or stays as it was; the findings of the summary are what the
judge finds in this very folder. Assumes nothing of the judge but that it reads a folder.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from scanmotion.core.finding import Finding
from scanmotion.core.summary import MarginsSummary
from scanmotion.plan_io.files import check_names, fill, fresh_folder
from scanmotion.plan_io.scans.measured import scan_files
from scanmotion.plan_io.summary import summary_from, surface_from
from scanmotion.plan_io.write import json_text, plan_files
from scanmotion.planning.plan import Plan

__all__ = ["Judge", "Saved", "judged", "save"]

Judge = Callable[[Path], Sequence[Finding]]
"""Looks at a plan's folder; see `scanmotion.verify`."""
Measure = Callable[[Path], MarginsSummary]
"""Measures a plan's folder; see `scanmotion.judge.margins`."""
Pages = Callable[[Plan], Mapping[str, str]]
"""Makes further files of a judged plan, by name."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Saved:
    """A plan as it was judged."""

    plan: Plan
    """With its summary."""
    findings: tuple[Finding, ...]
    """What Drake finds in the motion, and the judge in the files."""


def save(
    plan: Plan,
    folder: str | Path,
    *,
    judge: Judge,
    measure: Measure | None = None,
    pages: Pages | None = None,
    extras: Mapping[str, bytes | str] | None = None,
) -> Saved:
    """Writes the plan's folder as a whole or not at all, and has it judged.

    Args:
        plan: with a trajectory.
        folder: replaced if it exists.
        judge: looks at the files before they take the folder's place.
        measure: finds in them what the programme has to spare.
        pages: makes further files of the judged plan, as scene.html and report.html.
        extras: further files by name.

    Raises:
        PlanFileError: the folder cannot be written.
        InputError: there is no trajectory to write.
    """
    files = plan_files(plan)
    check_names(extras or {})
    with fresh_folder(folder) as fresh:
        fill(fresh, files, folder)
        saved = _judged(plan, fresh, judge, measure)
        assert saved.plan.summary is not None
        more: dict[str, bytes | str] = {"summary.json": json_text(saved.plan.summary.document())}
        if plan.scans and plan.cloud is not None:
            more |= scan_files(plan.cloud, surface_from(plan), plan.part, plan.scans)
        fill(fresh, {**more, **(pages(saved.plan) if pages is not None else {}), **(extras or {})}, folder)
    return saved


def judged(plan: Plan, *, judge: Judge) -> Saved:
    """The plan with its summary; its files are written for the judge alone, to a place of their own.

    Args:
        plan: with a trajectory.
        judge: looks at the files.

    Raises:
        InputError: there is no trajectory to write.
    """
    files = plan_files(plan)
    with tempfile.TemporaryDirectory() as work:
        fill(Path(work), files, work)
        return _judged(plan, Path(work), judge)


def _judged(plan: Plan, folder: Path, judge: Judge, measure: Measure | None = None) -> Saved:
    told = () if plan.last_word is None else plan.last_word.findings
    findings = (*told, *judge(folder))
    margins = None if measure is None else measure(folder)
    return Saved(plan=replace(plan, summary=summary_from(plan, findings, margins)), findings=findings)
