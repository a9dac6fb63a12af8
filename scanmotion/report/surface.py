"""What the report says of the surface and its viewpoints: coverage, what stays unscanned, holes, reach."""

from collections.abc import Sequence
from html import escape

from scanmotion.core.summary import Summary
from scanmotion.planning.plan import Plan
from scanmotion.report.figures.maps import coverage_figure, hole_figure, reach_figure
from scanmotion.report.html import image, section, table
from scanmotion.views.unscanned import Patch


def coverage(plan: Plan, summary: Summary) -> str:
    """What is scanned and what stays unscanned."""
    if plan.samples is None or plan.visible is None:
        return section(
            "Coverage", '<p class="note">No mesh of the part is known: nothing can be predicted.</p>'
        )
    parts = [image(coverage_figure(plan), "coverage at the end")]
    parts += _rounds(summary)
    if len(summary.rounds) > 1:
        before = image(coverage_figure(plan, after="global"), "coverage after the global step")
        parts.append(f"<details><summary>after the global step</summary>{before}</details>")
    if plan.unscanned:
        parts += _unscanned(plan.unscanned)
    return section("Coverage", *parts)


def _rounds(summary: Summary) -> list[str]:
    """What each round added."""
    rows, before = [], None
    searched = summary.searched
    found = [*searched, *summary.rounds[-1:]] if searched else summary.rounds
    for number, item in enumerate(found, start=1):
        done = item.completeness
        gain = "" if done is None or before is None else f"{done - before:+.2%}"
        share = "not known" if done is None else f"{done:.2%}"
        last = bool(searched) and number == len(found)
        step = "kept: worth their seconds, as one tour" if last else item.step
        rows.append((number, step, item.viewpoints, share, gain))
        before = done
    header = ("round", "step", "viewpoints served", "scanned, of what can be seen", "added")
    return [table(header, rows)] if rows else []


def _unscanned(patches: Sequence[Patch]) -> list[str]:
    """Patches that stay unscanned: by reason, and one by one from the largest."""
    areas: dict[str, list[float]] = {}
    for patch in patches:
        areas.setdefault(patch.reason, []).append(patch.area * 1e6)
    sums = [(reason, len(a), f"{sum(a):.0f}") for reason, a in areas.items()]
    rows = [
        (i, "  ".join(f"{x * 1e3:.0f}" for x in patch.center), f"{patch.area * 1e6:.0f}", patch.reason)
        for i, patch in enumerate(sorted(patches, key=lambda p: -p.area), start=1)
    ]
    return [
        "<p>What stays unscanned, by the last scan, and why. The picture numbers the largest patches:</p>",
        table(("reason", "patches", "area mm2"), sums),
        f"<details><summary>all {len(rows)} patches</summary>"
        + table(("patch", "x y z mm", "area mm2", "reason"), rows)
        + "</details>",
    ]


def holes(plan: Plan) -> str:
    """The holes after the global step; nothing where none were sought."""
    report = plan.holes
    if report is None:
        return ""
    rows = [
        (f"H{i}", hole.kind, *(f"{float(s) * 1e3:.1f}" for s in hole.extent), f"{hole.area * 1e6:.0f}")
        for i, hole in enumerate(report.holes, start=1)
    ]
    header = ("hole", "kind", "X' mm", "Y' mm", "Z' mm", "area mm2")
    return section(
        "Holes of the first scan",
        image(hole_figure(plan.part, report), "holes on the part"),
        table(header, rows) if rows else "<p>None.</p>",
        *(f'<p class="note">{escape(str(note))}</p>' for note in report.notes),
    )


def viewpoints(plan: Plan, summary: Summary) -> str:
    """Each viewpoint: where it is, what serves it, or why it is left out."""
    served: dict[str, str] = {}
    for operation in plan.trajectory.operations if plan.trajectory is not None else ():
        if operation.scanning:
            for view in operation.viewpoints:
                served.setdefault(view, f"{operation.kind} at {operation.t_start:.1f} s")
    lost = {u.id: u.reason for u in summary.viewpoints.left_out}
    rows = []
    for view in plan.viewpoints:
        place = "  ".join(f"{v * 1e3:.0f}" for v in view.p_OS)
        aim = "  ".join(f"{v:+.2f}" for v in view.direction)
        outcome, by = (
            served.get(view.id) or lost.get(view.id, ""),
            summary.viewpoints.solvers.get(view.id, ""),
        )
        rows.append((view.id, view.step, place, aim, round(view.standoff * 1e3), outcome, by, view.note))
    known = {view.id for view in plan.viewpoints}
    rows += [(i, "global", "", "", "", why, "", "") for i, why in lost.items() if i not in known]
    header = ("viewpoint", "step", "x y z mm", "looks along", "standoff mm", "served by, or why not")
    picture = image(reach_figure(plan), "viewpoints round the part") if plan.viewpoints else ""
    return section(
        "Viewpoints and reach",
        picture,
        f"<details><summary>all {len(rows)} viewpoints</summary>"
        + table((*header, "pose by", "note"), rows)
        + "</details>",
    )
