"""What a report says first, in plain words; the sheet to sign; what its terms mean."""

from collections.abc import Mapping
from html import escape

import numpy as np

from scanmotion.core.summary import MarginsSummary, Summary
from scanmotion.planning.plan import Plan
from scanmotion.report.html import table

GLOSSARY = (
    ("what can be seen", "surface that the scanner sees from at least one allowed place, whatever the robot"),
    ("completeness", "share of the surface that is scanned; said with it: of what can be seen, or of all"),
    ("viewpoint", "a place of the scanner relative to the object, and where it looks"),
    ("global step", "the first scan: the table turns once before each place of the scanner"),
    ("local round", "later scans, of what the first ones missed"),
    ("revolution", "one turn of the table while the arm stands still"),
    ("station", "the scanner stands still for a moment (dwell), or passes by in a straight line (sweep)"),
    ("transit", "the way of the arm from one scan to the next; it does not scan"),
    ("out of reach", "the arm cannot bring the scanner there without touching something"),
    ("not worth its seconds", "the robot could scan it; so little would be added that the time is not spent"),
    ("floor", "proven: no order of the same viewpoints takes fewer seconds"),
    ("accuracy", "distance of the scanned points from the true surface, as the simulator predicts it"),
    ("judge", "a second program that checks the written files and shares no code with the planner"),
    ("clearance", "least distance that arm and scanner keep from all else"),
)
"""Terms of the report, in plain words."""
SHEET = ("object", "operator", "date", "notes")
"""Lines that a sheet always has; what is not known is left open, to be written by hand."""
_UNDER = -0.7
"""z of the normals of an underside; the surface looks down by 45 deg or more."""
_WORTH_SAYING = 0.002
"""Shares below this are not spoken of."""


def first_sentence(plan: Plan, summary: Summary) -> str:
    """The result in one or two sentences without terms."""
    seconds, views = summary.time_s.total, summary.viewpoints.global_ + summary.viewpoints.local
    done = summary.completeness.final
    if done is None:
        return (
            f"The programme scans from {views} places in {seconds:.0f} s; how much of the object that "
            "shows is not known, for there is no model of it."
        )
    said = f"{_percent(done)} of what a scanner can see is scanned in {seconds:.0f} s"
    hidden, under = hidden_shares(plan)
    if under > _WORTH_SAYING and under > 0.5 * hidden:
        return f"{said}; the underside ({_percent(under)} of all) is not: turn the object over for it."
    if hidden > _WORTH_SAYING:
        return f"{said}; {_percent(hidden)} of the surface cannot be seen as the object stands."
    return f"{said}."


def hidden_shares(plan: Plan) -> tuple[float, float]:
    """Shares of the whole surface that cannot be seen as the object stands: all, and of the underside."""
    if plan.samples is None or plan.visible is None:
        return 0.0, 0.0
    hidden = ~plan.visible
    under = hidden & (plan.samples.normals[:, 2] < _UNDER)
    return float(np.mean(hidden)), float(np.mean(under))


def _percent(share: float) -> str:
    """With one digit behind the point, never rounded up to all of it."""
    tenths = np.floor(share * 1000 + 1e-9) / 10
    return f"{tenths:.1f} %"


def sheet(meta: Mapping[str, str]) -> str:
    """What the user noted, with open lines for what was not, and a place to sign."""
    names = [*SHEET, *(name for name in meta if name not in SHEET)]
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(meta.get(name, ''))}</td></tr>" for name in names)
    sign = "<tr><th>checked and released by</th><td></td></tr><tr><th>signature, date</th><td></td></tr>"
    return f'<table class="sheet">{rows}{sign}</table>'


def margin_rows(margins: MarginsSummary) -> list[tuple[str, str, str, str]]:
    """What the programme has to spare: what, how much, where and when."""
    rows = []
    for what, found in (("the object", margins.to_object), ("all else", margins.to_surroundings)):
        if found is not None:
            told = "they touch" if found.mm <= 0 else f"{found.mm:.1f} mm"
            rows.append((f"least distance to {what}", told, f"{found.a}, {found.b}", f"{found.t_s:.2f} s"))
    end = margins.joint_limit
    if end is not None:
        rows.append(("least way to a joint's end", f"{end.deg:.1f} deg", end.joint, f"{end.t_s:.2f} s"))
    near = margins.singularity
    told = f"{near.value:.4f}", "least singular value, 0 is singular", f"{near.t_s:.2f} s"
    rows.append(("nearest to a singularity", *told))
    for name in ("flange", "elbow", "scanner"):
        fast = getattr(margins.fastest, name)
        rows.append((f"fastest {name}", f"{fast.value:.3f} m/s", "", f"{fast.t_s:.2f} s"))
    return rows


def glossary() -> str:
    """The terms of the report as a table."""
    return table((), GLOSSARY)
