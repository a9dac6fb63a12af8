"""The table that ends `scanmotion plan`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from scanmotion.cli.app import print_table

if TYPE_CHECKING:
    from scanmotion.core.summary import LeftOut, Summary, ViewpointSummary, WithinReach

_FORMATS = {"kr210": "krl-timed", "kr240": "krl-timed", "kr240-ultra": "krl-timed", "irb6700": "rapid"}
FEW = 3
"""Viewpoints that are only not worth their seconds are listed one by one up to this many."""


def print_summary(summary: "Summary", folder: Path, *, html: bool = True) -> None:
    """The table that ends `scanmotion plan`."""
    print_table("The plan", (), summary_rows(summary))
    views = summary.viewpoints
    if views.left_out:
        rows = left_out_rows(views.unreachable, views.not_worth)
        print_table("Viewpoints left out", ("viewpoint", "reason"), rows)
    if summary.budget.advice:
        print_table("Over the budget", ("what would help",), [(a,) for a in summary.budget.advice])
    if summary.findings:
        print_table("The judge found", ("finding",), [(line,) for line in summary.finding_lines])
    names = ["trajectory.csv", "summary.json"] + (["scene.html", "report.html"] if html else [])
    names += [name for name in ("cloud.ply", "deviation.ply") if (folder / name).is_file()]
    print_table("Files", (), [(name.split(".")[0], str(folder / name)) for name in names])
    print_table("Next", (), next_rows(summary, folder))


def next_rows(summary: "Summary", folder: Path) -> list[tuple[str, str]]:
    """What somebody does with a plan that is done: purpose and command."""
    rows = [("look at it", f"scanmotion show {folder}"), ("judge it again", f"scanmotion verify {folder}")]
    if summary.passes:
        rows.append(("write the programme", f"scanmotion export {folder} --to {_format_for(folder)}"))
    return rows


def _format_for(folder: Path) -> str:
    """The format that the maker of a built-in robot reads; ROS for any other."""
    model = str(json.loads((folder / "cell.json").read_text(encoding="utf-8"))["robot"]["model"])
    return _FORMATS.get(model, "ros")


def left_out_rows(unreachable: "Sequence[LeftOut]", not_worth: "Sequence[LeftOut]") -> list[tuple[str, ...]]:
    """Viewpoints and reasons; many that are only not worth their seconds share a line."""
    rows: list[tuple[str, ...]] = [(u.id, u.reason) for u in unreachable]
    if len(not_worth) <= FEW:
        return [*rows, *((u.id, u.reason) for u in not_worth)]
    return [*rows, (f"{len(not_worth)} others", "not worth their seconds; summary.json lists them")]


def summary_rows(summary: "Summary") -> list[tuple[str, ...]]:
    """Name and value of each line of the final table."""
    views, done, exact = summary.viewpoints, summary.completeness, summary.accuracy
    time, budget = summary.time_s, summary.budget
    split = f"arm {time.arm:.1f}, table {time.table:.1f}, sweep {time.sweep:.1f}, dwell {time.dwell:.1f}"
    verdict = "inside" if budget.ok else "OVER"
    seen = [
        ("completeness, of what can be seen", _share(done.final)),
        *sure_rows(summary),
        ("after the global step", _share(done.after_global)),
        *reach_rows(summary.within_reach),
        ("of the whole surface", _share(done.final_of_whole)),
        ("accuracy", f"mean {_mm(exact.mean_abs_mm)}, standard deviation {_mm(exact.sd_signed_mm)}"),
    ]
    if done.final is None:
        seen = [("completeness", "not known: there is no model of the part (--part)")]
    return [
        ("viewpoints", f"{views.global_} global, {views.local} local, {_left_out(views)}"),
        *seen,
        *twin_rows(summary),
        (
            "time",
            f"{time.total:.1f} s, {verdict} the budget of {budget.limit_s:g} s (floor {time.floor:.1f} s)",
        ),
        ("of which [s]", split),
        *([("helix", summary.helix.note)] if summary.helix is not None else []),
        *([("motion", summary.motion.note)] if summary.motion is not None else []),
        ("checks", counted(len(summary.findings))),
        ("planned in", f"{summary.planning_s['total']:.1f} s"),
    ]


def _left_out(views: "ViewpointSummary") -> str:
    lost, dear = len(views.unreachable), len(views.not_worth)
    return f"{lost} unreachable" + (f", {dear} not worth their seconds" if dear else "")


def _share(value: float | None) -> str:
    return "not known" if value is None else f"{value:.2%}"


def _mm(value: float | None) -> str:
    return "not known" if value is None else f"{value:.3f} mm"


def sure_rows(summary: "Summary") -> list[tuple[str, ...]]:
    """Line of the final table on how sure the prediction is, where that is known."""
    return [] if summary.confidence is None else [("how sure", summary.confidence.statement)]


def reach_rows(found: "WithinReach") -> list[tuple[str, ...]]:
    """Line of the final table on what this robot's scanner can be brought to see, where that is known."""
    if found.scanned is None or found.share is None:
        return []
    return [("of what this robot can reach", f"{found.scanned:.2%} ({found.share:.2%} is within reach)")]


def counted(findings: int) -> str:
    """How many findings, in words."""
    return "no finding" if not findings else "1 finding" if findings == 1 else f"{findings} findings"


def twin_rows(summary: "Summary") -> list[tuple[str, ...]]:
    """Lines of the final table on the surface, calibration and registration, where there are any."""
    rows: list[tuple[str, ...]] = []
    made, found = summary.accuracy.surface, summary.calibration
    if made is not None:
        told = f"mean {_mm(made.mean_abs_mm)}, standard deviation {_mm(made.sd_signed_mm)}"
        rows.append(("of the surface", told))
    if found is not None:
        before, after = found.global_cloud.before.mean_abs_mm, found.global_cloud.after.mean_abs_mm
        bought = f"the global scan's mean from {_mm(before)} to {_mm(after)}"
        rows.append(("calibration", bought if found.applied else found.statement))
    rows += [(f"round {item.round} on the cloud", item.statement) for item in summary.registration]
    return rows
