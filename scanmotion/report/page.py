"""One HTML file about a plan that opens without a network: pictures, charts, tables, settings, versions."""

import json
import platform
from html import escape
from importlib import metadata

from scanmotion import __version__
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.errors import InputError
from scanmotion.core.summary import BudgetSummary, MotionSummary, Summary
from scanmotion.planning.plan import Plan
from scanmotion.report.figures.charts import curve_figure, joint_figure, tcp_figure, time_figure
from scanmotion.report.figures.maps import cell_figure
from scanmotion.report.html import image, page, section, table
from scanmotion.report.surface import coverage, holes, viewpoints
from scanmotion.report.used import used_packages
from scanmotion.report.words import first_sentence, glossary, margin_rows, sheet

NOT_KNOWN = "not known"
"""A figure that needs a model of the part; a page without one leaves it out."""


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
    first = [_head(plan, summary), coverage(plan, summary), _numbers(summary), _seconds(plan, summary)]
    first += [_margins(summary), _findings(summary), section("Release", sheet(summary.meta))]
    appendix = [
        section("What the words mean", glossary()),
        holes(plan),
        viewpoints(plan, summary),
        _motion(plan),
        _budget(summary.budget),
        _read(summary),
        _settings(plan, summary),
    ]
    body = "\n".join(s for s in first if s)
    body += '\n<div class="appendix">\n' + "\n".join(s for s in appendix if s) + "\n</div>"
    return page(f"scanmotion: {plan.part.name}", body)


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
    said = f'<p class="first">{escape(first_sentence(plan, summary))}</p>'
    title = f"<h1>Scan plan: {escape(plan.part.name)}</h1>"
    return f'{title}\n{said}\n{verdict}\n<p class="note">{escape(told)}</p>'


def _numbers(summary: Summary) -> str:
    done, exact, time = summary.completeness, summary.accuracy, summary.time_s

    def share(value: float | None) -> str:
        return NOT_KNOWN if value is None else f"{value:.2%}"

    def mm(value: float | None) -> str:
        return NOT_KNOWN if value is None else f"{value:.3f} mm"

    budget, reach = summary.budget, summary.within_reach
    within = "inside" if budget.ok else "OVER"
    views = summary.viewpoints
    rows = [
        ("scanned, of what can be seen", share(done.final)),
        ("of which after the global step", share(done.after_global)),
        ("scanned, of the whole surface", share(done.final_of_whole)),
        ("accuracy: mean of the absolute distance", mm(exact.mean_abs_mm)),
        ("standard deviation of the signed distance", mm(exact.sd_signed_mm)),
        ("mean of the signed distance", mm(exact.mean_signed_mm)),
        ("total time", f"{time.total:.1f} s ({within} the budget of {budget.limit_s:.1f} s)"),
        ("proven floor for the same viewpoints", f"{time.floor:.1f} s"),
        ("viewpoints", f"{views.global_} global, {views.local} local"),
        ("left out: the robot cannot serve them", f"{len(views.unreachable)}"),
        ("left out: not worth their seconds", f"{len(views.not_worth)}"),
    ]
    if summary.confidence is not None:
        sure = summary.confidence.statement
        rows.insert(1, ("how sure, under the uncertainty stated in the settings", sure))
    if summary.helix is not None:
        rows.append(("turns of the global step", summary.helix.note))
    if summary.motion is not None:
        rows += _motion_rows(summary.motion)
    if done.final is None:
        return section("In numbers", table((), [row for row in rows if row[1] != NOT_KNOWN]))
    if reach.scanned is not None:
        told = f"{share(reach.scanned)} ({share(reach.share)} of what can be seen is within reach)"
        rows.insert(2, ("scanned, of what this robot's scanner can be brought to see", told))
    # A conservator decides by these numbers: what they are has to stand beside them.
    return section(
        "In numbers",
        table((), rows),
        '<p class="note">Completeness and accuracy are predicted by simulating the scanner with the noise '
        "stated in the settings at the end; the object itself has not been measured.</p>",
    )


def _motion_rows(motion: MotionSummary) -> list[tuple[str, str]]:
    """What came of the continuous motion, and what other ones that were found take and see."""
    curve = ", ".join(f"{p.completeness:.2%} in {p.seconds:.1f} s" for p in motion.curve)
    rows = [("motion", motion.note)]
    return rows + ([("completeness against seconds", curve)] if len(motion.curve) > 1 else [])


def _seconds(plan: Plan, summary: Summary) -> str:
    if plan.trajectory is None:
        return ""
    figure = time_figure(plan.time_s(), summary.budget.limit_s)
    return section("Where the seconds go", image(figure, "where the seconds go"))


def _motion(plan: Plan) -> str:
    if plan.trajectory is None:
        return section("Motion", "<p>No viewpoint could be served.</p>")
    trajectory, process = plan.trajectory, plan.cell.settings.process
    X_WS = scanner_poses(plan.cell, trajectory.q)
    rows = [
        (o.index, o.kind, " ".join(o.viewpoints), f"{o.t_start:.2f}", f"{o.t_end - o.t_start:.2f}")
        for o in trajectory.operations
    ]
    fastest = max(process.scan_speed_m_s, process.transit_speed_m_s)
    return section(
        "Motion",
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
    return section("Budget", *parts) if parts else ""


def _margins(summary: Summary) -> str:
    if summary.margins is None:
        return ""
    return section(
        "What it has to spare",
        table(("", "least or greatest", "where", "at"), margin_rows(summary.margins)),
        '<p class="note">Found in the written files by the judge, not by the planner, with the model\'s '
        "solids; <code>scanmotion verify</code> lists the pairs of solids that it leaves out, and why.</p>",
    )


def _findings(summary: Summary) -> str:
    if not summary.findings:
        return section("Findings of the independent judge", '<p class="ok">None.</p>')
    items = "".join(f"<li>{escape(line)}</li>" for line in summary.finding_lines)
    return section("Findings of the independent judge", f'<ul class="bad">{items}</ul>')


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
    return section("What was read", table((), rows))


def _settings(plan: Plan, summary: Summary) -> str:
    settings = plan.cell.settings.model_dump(mode="json")
    versions = [("scanmotion", __version__, "this plan"), ("python", platform.python_version(), "")]
    for name, what in used_packages(plan):
        try:
            versions.append((name, metadata.version(name), what))
        except metadata.PackageNotFoundError:
            versions.append((name, "not installed here", what))
    spent = [(name, f"{seconds:.2f} s") for name, seconds in summary.planning_s.items()]
    return section(
        "Settings, versions, seed",
        f"<p>Seed {plan.options.seed}.</p>",
        table(("package", "version", "what it did here"), versions),
        table(("planning stage", "took"), spent),
        "<details><summary>all settings of the cell</summary>"
        f"<pre>{escape(json.dumps(settings, indent=2))}</pre></details>",
    )
