"""The risk sheet beside a programme: figures for the assessment that ISO 10218:2025 asks for."""

import html
import json
from typing import Any

import numpy as np

from scanmotion.geometry.files.ply_write import ply_data
from scanmotion.judge.risk.sheet import POINTS, UNSURE_M, Risk

NOT_IN_THE_MODEL = (
    "people, and what they carry; fences and doors, unless they are obstacles of the cell",
    "cables and hoses of arm, scanner and table, and their slack",
    "the controller's own path and stopping: rounded moves, braking ramps, a stop without power",
    "how far arm and scanner give way, wear of brakes, and the payload's influence on stops",
    "errors of calibration, of the part's shape and place, beyond the clearance that is asked for",
    "the part tipping or sliding on the table, and what comes loose",
    "the way from where the robot stands to the programme's start, and every move by hand",
    "the scanner's light: its class and what it asks for by IEC 60825-1",
)
_NAMES = {
    "flange": "flange", "scanner": "scanner", "elbow": "elbow", "anywhere": "any point of arm and tool",
    "part": "any point of the part",
}  # fmt: skip


def risk_files(risk: Risk, name: str, unjudged: list[dict[str, str]]) -> dict[str, bytes | str]:
    """NAME_risk.html, NAME_risk.json and NAME_risk.ply (the hull of the swept space, metres, in W).

    Args:
        risk: the figures.
        name: of the programme.
        unjudged: pairs of solids that the judge leaves out, with keys a, b and reason.
    """
    return {
        f"{name}_risk.html": risk_html(risk, name, unjudged),
        f"{name}_risk.json": json.dumps(risk_data(risk, unjudged), indent=1) + "\n",
        f"{name}_risk.ply": ply_data(risk.hull.points, triangles=risk.hull.faces),
    }


def _greatest(risk: Risk) -> dict[str, float]:
    return {p: max((o.speed_m_s[p] for o in risk.operations), default=0.0) for p in POINTS}


def risk_data(risk: Risk, unjudged: list[dict[str, str]]) -> dict[str, Any]:
    """The same figures for programs: metres, seconds, radians."""
    return {
        "version": 1,
        "standard": "ISO 10218-1:2025, ISO 10218-2:2025",
        "stops": {
            "deceleration_rad_s2": [round(float(v), 6) for v in risk.deceleration_rad_s2],
            "reaction_s": risk.reaction_s,
        },
        "greatest_speed_m_s": {k: round(v, 4) for k, v in _greatest(risk).items()},
        "operations": [
            {
                "index": o.index, "kind": o.kind, "viewpoints": list(o.viewpoints),
                "t_start": round(o.t_start, 4), "t_end": round(o.t_end, 4),
                "speed_m_s": {k: round(v, 4) for k, v in o.speed_m_s.items()},
                "stop_m": {k: round(v, 4) for k, v in o.stop_m.items()}, "stop_s": round(o.stop_s, 4),
            }
            for o in risk.operations
        ],
        "swept": {
            "low_m": [round(float(v), 4) for v in risk.low_m],
            "high_m": [round(float(v), 4) for v in risk.high_m],
            "hull_m3": round(risk.hull.volume, 4), "part_radius_m": round(risk.part_radius_m, 4),
        },
        "clearance_asked_m": risk.clearance_m,
        "clearance_unsure_m": UNSURE_M,
        "clearances": [
            {
                "robot": g.robot, "around": g.around,
                "distance_m": round(g.distance_m, 5), "t": round(g.t, 3),
                "operation": g.operation, "q_rad": [round(v, 6) for v in g.q],
                "scanner_m": [round(v, 4) for v in g.p_WS],
            }
            for g in risk.gaps
        ],
        "not_judged": unjudged,
        "not_in_the_model": list(NOT_IN_THE_MODEL),
    }  # fmt: skip


def _table(head: list[str], rows: list[list[str]]) -> str:
    top = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def risk_html(risk: Risk, name: str, unjudged: list[dict[str, str]]) -> str:
    """The sheet as a page that opens without a network."""
    speeds = [
        [str(o.index + 1), o.kind, " ".join(o.viewpoints[:3]), f"{o.t_start:.1f}"]
        + [f"{o.speed_m_s[p] * 1e3:.0f}" for p in POINTS]
        + [f"{o.stop_s:.2f}", *(f"{o.stop_m[p] * 1e3:.0f}" for p in ("scanner", "anywhere"))]
        for o in risk.operations
    ]
    total = ", ".join(f"{_NAMES[k]} {v * 1e3:.0f}" for k, v in _greatest(risk).items())
    head = ["operation", "kind", "viewpoints", "from, s", *(f"{_NAMES[p]}, mm/s" for p in POINTS)]
    head += ["stop, s", "scanner's stop, mm", "any point's stop, mm"]
    gaps = [
        [g.around, g.robot, f"{g.distance_m * 1e3:.1f}", f"{g.t:.2f}", str(g.operation + 1)]
        + [", ".join(f"{v:.1f}" for v in np.rad2deg(g.q)), ", ".join(f"{v * 1e3:.0f}" for v in g.p_WS)]
        for g in risk.gaps
    ]
    box = " to ".join(", ".join(f"{v * 1e3:.0f}" for v in p) for p in (risk.low_m, risk.high_m))
    brake = ", ".join(f"{v:.1f}" for v in np.rad2deg(risk.deceleration_rad_s2))
    missing = [*NOT_IN_THE_MODEL, *(f"{p['a']} and {p['b']}: {p['reason']}" for p in unjudged)]
    body = (
        "<p>Figures for the risk assessment that ISO 10218-1:2025 and ISO 10218-2:2025 ask for. They are no "
        "assessment: they follow from the plan's files alone, at full speed, and no controller has "
        f"confirmed them.</p><h2>Speeds and stops</h2><p>"
        f"Greatest speeds, mm/s: {html.escape(total)}.</p>"
        f"<p>Stops: {risk.reaction_s:g} s until the drives slow down, then all "
        "joints together on the path, "
        f"each by at most {brake} deg/s2 (A1 to A6, E1). These are stated, not measured.</p>"
        f"{_table(head, speeds)}"
        f"<h2>Swept space</h2><p>Arm and tool stay inside the box from {box} mm in the "
        "world's frame, and in the "
        f"hull of {risk.hull.volume:.2f} m3 in {html.escape(name)}_risk.ply. The part stays within "
        f"{risk.part_radius_m * 1e3:.0f} mm of the table's axis.</p><h2>Least clearances</h2>"
        f"<p>{risk.clearance_m * 1e3:.0f} mm are asked for. A distance may be {UNSURE_M * 1e3:.0f} mm less "
        "between two configurations that were measured.</p>"
        + _table(["around", "robot", "mm", "at, s", "operation", "A1..A6, E1, deg", "scanner, mm"], gaps)
        + "<h2>Not in the model</h2><ul>"
        + "".join(f"<li>{html.escape(m)}</li>" for m in missing)
        + "</ul>"
    )
    return _PAGE.format(title=f"Risk sheet of {html.escape(name)}", body=body)


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title><style>
body {{ font: 15px/1.5 sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; }}
table {{ border-collapse: collapse; font-size: 13px; }} td, th {{ border: 1px solid #bbb; padding: 2px 6px; }}
</style></head><body><h1>{title}</h1>{body}</body></html>
"""
