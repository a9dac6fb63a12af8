"""One HTML file about a plan that opens without a network: pictures, charts, tables, settings, versions."""

import base64
import io
import json
import platform
import re
from collections.abc import Sequence
from html import escape
from importlib import metadata
from typing import TYPE_CHECKING

from scanmotion import __version__
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.errors import InputError
from scanmotion.core.summary import BudgetSummary, MotionSummary, Summary
from scanmotion.planning.plan import Plan
from scanmotion.report.figures.charts import curve_figure, joint_figure, tcp_figure, time_figure
from scanmotion.report.figures.maps import cell_figure, coverage_figure, hole_figure, reach_figure
from scanmotion.views.unscanned import Patch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PACKAGES = (
    "drake",
    "open3d",
    "numpy",
    "scipy",
    "ompl",
    "toppra",
    "ruckig",
    "python-fcl",
    "py-opw-kinematics",
)

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 1180px;
margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.6em; margin-bottom: .2em }
h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ccc }
table { border-collapse: collapse; margin: .6em 0 } td, th { padding: .15em .8em .15em 0; text-align: left;
vertical-align: top; border-bottom: 1px solid #eee } th { font-weight: 600; color: #555 }
img { max-width: 100% } pre { background: #f6f6f6; padding: .8em; overflow-x: auto; font-size: 12px }
.ok { color: #1d7a50 } .bad { color: #c8102e } .note { color: #666 } td.n { text-align: right }
td.n, td.w { white-space: nowrap; font-variant-numeric: tabular-nums } details { margin: .6em 0 }
"""
_POSITION = re.compile(r"([-+]?[0-9.]+ *){3}")
# The page may load nothing at all: neither script nor picture nor font from anywhere.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def report_html(plan: Plan) -> str:
    """The report of a plan, made just now or loaded from its folder.

    Args:
        plan: with its summary, as saving and loading give it.

    Raises:
        InputError: the plan has not been judged.
    """
    summary = plan.summary
    if summary is None:
        raise InputError("this plan has not been judged: save it, then report what is loaded")
    sections = [_head(plan, summary), _numbers(summary), _coverage(plan, summary), _holes(plan)]
    sections += [
        _viewpoints(plan, summary),
        _motion(plan, summary),
        _budget(summary.budget),
        _findings(summary),
        _read(summary),
        _settings(plan, summary),
    ]
    body = "\n".join(s for s in sections if s)
    return page(f"scanmotion: {plan.part.name}", body)


def page(title: str, body: str) -> str:
    """A whole HTML page in the house's style that may load nothing from anywhere.

    Args:
        title: plain text.
        body: HTML.
    """
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def table(header: tuple[str, ...], rows: Sequence[tuple[object, ...]]) -> str:
    """An HTML table; every cell is escaped, numbers under a header stand to the right."""

    def cell(value: object) -> str:
        text = str(value)
        number = header and re.fullmatch(r"[-+]?[0-9.]+%?", text)
        kind = ' class="n"' if number else ' class="w"' if _POSITION.fullmatch(text) else ""
        return f"<td{kind}>{escape(text)}</td>"

    head = "".join(f"<th>{escape(h)}</th>" for h in header)
    lines = "\n".join("<tr>" + "".join(map(cell, row)) + "</tr>" for row in rows)
    return f"<table>{f'<tr>{head}</tr>' if header else ''}\n{lines}</table>"


def image(figure: "Figure", what: str) -> str:
    """A figure as an inline picture."""
    buffer = io.BytesIO()
    # Without metadata: the same plan gives the same bytes.
    figure.savefig(buffer, format="png", metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<p><img alt="{escape(what)}" src="data:image/png;base64,{data}"></p>'


def _section(title: str, *parts: str) -> str:
    return f"<h2>{escape(title)}</h2>\n" + "\n".join(parts)


def _head(plan: Plan, summary: Summary) -> str:
    findings, late = len(summary.findings), not summary.budget.ok
    if findings or late:
        reasons = [f"{findings} finding{'s' * (findings > 1)}"] * bool(findings) + ["over its budget"] * late
        verdict = f'<p class="bad"><b>Do not run:</b> {escape(", ".join(reasons))}.</p>'
    else:
        verdict = (
            '<p class="ok"><b>The plan passes its checks</b> (in the model; no controller has run it).</p>'
        )
    sides = " x ".join(f"{side * 1e3:.0f}" for side in plan.part.extent)
    options = plan.options
    told = f"{sides} mm; seed {options.seed}, strategy {options.strategy}, mode {options.mode}"
    return f"<h1>Scan plan: {escape(plan.part.name)}</h1>\n<p>{escape(told)}</p>\n{verdict}"


def _numbers(summary: Summary) -> str:
    done, exact, time = summary.completeness, summary.accuracy, summary.time_s

    def share(value: float | None) -> str:
        return "not known" if value is None else f"{value:.2%}"

    def mm(value: float | None) -> str:
        return "not known" if value is None else f"{value:.3f} mm"

    budget, reach = summary.budget, summary.within_reach
    within = "inside" if budget.ok else "OVER"
    left_out = len(summary.viewpoints.unreachable)
    rows = [
        ("scanned, of what can be seen", share(done.final)),
        ("of which after the global step", share(done.after_global)),
        ("scanned, of the whole surface", share(done.final_of_whole)),
        ("accuracy: mean of the absolute distance", mm(exact.mean_abs_mm)),
        ("standard deviation of the signed distance", mm(exact.sd_signed_mm)),
        ("mean of the signed distance", mm(exact.mean_signed_mm)),
        ("total time", f"{time.total:.1f} s ({within} the budget of {budget.limit_s:.1f} s)"),
        ("proven floor for the same viewpoints", f"{time.floor:.1f} s"),
        ("viewpoints", f"{summary.viewpoints.global_} global, {summary.viewpoints.local} local"),
        ("left out", f"{left_out}"),
    ]
    if summary.confidence is not None:
        sure = summary.confidence.statement
        rows.insert(1, ("how sure, under the uncertainty stated in the settings", sure))
    if summary.helix is not None:
        rows.append(("turns of the global step", summary.helix.note))
    if summary.motion is not None:
        rows += _motion_rows(summary.motion)
    if done.final is None:
        return table((), rows)
    if reach.scanned is not None:
        told = f"{share(reach.scanned)} ({share(reach.share)} of what can be seen is within reach)"
        rows.insert(2, ("scanned, of what this robot's scanner can be brought to see", told))
    # A conservator decides by these numbers: what they are has to stand beside them.
    return table((), rows) + (
        '<p class="note">Completeness and accuracy are predicted by simulating the scanner with the noise '
        "stated in the settings below; the object itself has not been measured.</p>"
    )


def _motion_rows(motion: MotionSummary) -> list[tuple[str, str]]:
    """What came of the continuous motion, and what other ones that were found take and see."""
    curve = ", ".join(f"{p.completeness:.2%} in {p.seconds:.1f} s" for p in motion.curve)
    rows = [("motion", motion.note)]
    return rows + ([("completeness against seconds", curve)] if len(motion.curve) > 1 else [])


def _coverage(plan: Plan, summary: Summary) -> str:
    if plan.samples is None or plan.visible is None:
        return _section(
            "Coverage", '<p class="note">No mesh of the part is known: nothing can be predicted.</p>'
        )
    parts = [image(coverage_figure(plan), "coverage after the global step and at the end")]
    parts += _rounds(summary)
    if plan.unscanned:
        parts += _unscanned(plan.unscanned)
    return _section("Coverage", *parts)


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


def _holes(plan: Plan) -> str:
    report = plan.holes
    if report is None:
        return ""
    rows = [
        (f"H{i}", hole.kind, *(f"{float(s) * 1e3:.1f}" for s in hole.extent), f"{hole.area * 1e6:.0f}")
        for i, hole in enumerate(report.holes, start=1)
    ]
    header = ("hole", "kind", "X' mm", "Y' mm", "Z' mm", "area mm2")
    return _section(
        "Holes of the first scan",
        image(hole_figure(plan.part, report), "holes on the part"),
        table(header, rows) if rows else "<p>None.</p>",
        *(f'<p class="note">{escape(str(note))}</p>' for note in report.notes),
    )


def _viewpoints(plan: Plan, summary: Summary) -> str:
    served: dict[str, str] = {}
    for operation in plan.trajectory.operations if plan.trajectory is not None else ():
        if operation.scanning:
            for view in operation.viewpoints:
                served.setdefault(view, f"{operation.kind} at {operation.t_start:.1f} s")
    lost = {u.id: u.reason for u in summary.viewpoints.unreachable}
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
    return _section("Viewpoints and reach", picture, table((*header, "pose by", "note"), rows))


def _motion(plan: Plan, summary: Summary) -> str:
    if plan.trajectory is None:
        return _section("Motion", "<p>No viewpoint could be served.</p>")
    trajectory, process = plan.trajectory, plan.cell.settings.process
    X_WS = scanner_poses(plan.cell, trajectory.q)
    rows = [
        (o.index, o.kind, " ".join(o.viewpoints), f"{o.t_start:.2f}", f"{o.t_end - o.t_start:.2f}")
        for o in trajectory.operations
    ]
    fastest = max(process.scan_speed_m_s, process.transit_speed_m_s)
    return _section(
        "Motion",
        image(time_figure(plan.time_s(), summary.budget.limit_s), "where the seconds go"),
        image(cell_figure(plan.cell, trajectory, X_WS), "the scanner's way in the cell"),
        image(tcp_figure(trajectory, X_WS[:, :3, 3], fastest), "speed of the scanner"),
        image(joint_figure(trajectory, plan.cell), "joints over time"),
        table(("operation", "kind", "viewpoints", "starts s", "takes s"), rows),
    )


def _budget(budget: BudgetSummary) -> str:
    """What costs most, what a shorter programme would see, what would bring it inside its budget."""
    parts = []
    if budget.advice:
        items = "".join(f"<li>{escape(line)}</li>" for line in budget.advice)
        parts.append(f'<p class="bad">Over the budget. What would help:</p><ul>{items}</ul>')
    if budget.curve and budget.by_order:
        parts.append(image(curve_figure(budget), "completeness against seconds"))
    rows = []
    for cost in budget.costliest:
        lost = cost.completeness_lost_without
        told = "not known" if lost is None else f"{lost:.3%}"
        views = " ".join(cost.viewpoints)
        rows.append((cost.operation, cost.kind, views, cost.seconds, cost.of_which_way, told))
    if rows:
        header = ("operation", "kind", "viewpoints", "seconds", "of which the way", "lost without it")
        parts += ["<p>The costliest stops:</p>", table(header, rows)]
    return _section("Budget", *parts) if parts else ""


def _findings(summary: Summary) -> str:
    if not summary.findings:
        return _section("Findings of the independent judge", '<p class="ok">None.</p>')
    items = "".join(f"<li>{escape(line)}</li>" for line in summary.finding_lines)
    return _section("Findings of the independent judge", f'<ul class="bad">{items}</ul>')


def _read(summary: Summary) -> str:
    """What was read from the part's file, and what was changed; nothing for a box or the built-in part."""
    read = summary.read
    if read is None:
        return ""
    size = " x ".join(f"{side:.4g}" for side in read.size_mm)
    what = f"{read.triangles} triangles" if read.triangles else f"{read.points} points"
    rows = [("file", f"{read.file}, {read.format}"), ("holds", f"{what}, {size} mm")]
    rows.append(("unit", f"{read.units}, {read.units_from}"))
    rows.append(("bodies", f"{read.bodies}; {read.specks} specks were left out"))
    rows += [("taken", text) for text in read.columns]
    rows += [("changed", text) for text in read.changes] + [("note", text) for text in read.warnings]
    return _section("What was read", table((), rows))


def _settings(plan: Plan, summary: Summary) -> str:
    settings = plan.cell.settings.model_dump(mode="json")
    versions = [("scanmotion", __version__), ("python", platform.python_version())]
    for name in PACKAGES:
        try:
            versions.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            versions.append((name, "not installed"))
    spent = [(name, f"{seconds:.2f} s") for name, seconds in summary.planning_s.items()]
    return _section(
        "Settings, versions, seed",
        f"<p>Seed {plan.options.seed}.</p>",
        table(("package", "version"), versions),
        table(("planning stage", "took"), spent),
        f"<pre>{escape(json.dumps(settings, indent=2))}</pre>",
    )
