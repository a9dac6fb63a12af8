"""One page about several placements: how the part stands in each, how to turn it, and what it adds."""

import base64
import html
import io

import numpy as np

from scanmotion.planning.placements.plan_placements import PlacedPlan, Placement
from scanmotion.report.figures.maps import new_figure

_SIDE, _TOP = (0, 2), (0, 1)


def placements_html(placed: PlacedPlan) -> str:
    """The page; it opens without a network."""
    words = (
        f"{placed.of_ceiling:.2%} of what a floating part would show is scanned, {placed.of_whole:.2%} of "
        f"the whole surface, in {placed.seconds:.0f} s of robot time, {len(placed.placements)} placements. "
        f"No further placement: {placed.reason}."
    )
    body = "".join(_section(n, p) for n, p in enumerate(placed.placements, 1))
    title = f"Placements of {html.escape(placed.part.name)}"
    return _PAGE.format(title=title, words=html.escape(words), body=body)


def _section(number: int, placement: Placement) -> str:
    trajectory = placement.plan.trajectory
    seconds = 0.0 if trajectory is None else trajectory.duration
    lines = [
        f"It adds {placement.added:.2%} of the ceiling in {seconds:.0f} s.",
        "Stand the part as it is given." if number == 1 else turning(placement),
        f"It tips at {np.degrees(placement.resting.tip_rad):.1f} deg."
        if len(placement.resting.support_m)
        else "",
        *placement.warnings,
        _registration(placement),
    ]
    told = "".join(f"<li>{html.escape(line)}</li>" for line in lines if line)
    return (
        f"<h2>{number}. {html.escape(placement.resting.name)}</h2><ul>{told}</ul>"
        f'<img alt="" src="data:image/png;base64,{_picture(placement)}">'
        f'<p><a href="{placement.name}/report.html">report</a>, '
        f'<a href="{placement.name}/scene.html">scene</a></p>'
    )


def turning(placement: Placement) -> str:
    """How the part is turned from the first placement, as one rotation about a level or upright axis."""
    up = placement.resting.up
    angle = np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if angle < 1.0:
        return "Turn the part about the upright axis only."
    # The axis is level in the part as it stands first: it is the cross product of both upward directions.
    axis = np.cross(up, [0.0, 0.0, 1.0])
    if np.linalg.norm(axis) < 1e-9:
        return "Turn the part upside down about any level axis."
    bearing = np.degrees(np.arctan2(axis[1], axis[0]))
    return (
        f"From the first placement, tip the part by {angle:.0f} deg about the level axis that points "
        f"{bearing:.0f} deg from its x axis: its ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}) is then up."
    )


def _registration(placement: Placement) -> str:
    trial = placement.trial
    if trial is None:
        return ""
    trust = "trusted" if trial.found.trusted else "not trusted: place a mark, or tell the yaw by hand"
    return (
        f"Four still frames find it again, simulated with a placing error: {trust}; what is left is "
        f"{trial.distance_m * 1e3:.2f} mm and {np.degrees(trial.angle_rad):.3f} deg."
    )


def _picture(placement: Placement) -> str:
    """From the side and from above: the part's outline, its centre of mass, its support polygon."""
    part, rest = placement.plan.part, placement.resting
    figure = new_figure(8.0, 4.0)
    some = part.vertices[:: max(1, len(part.vertices) // 20_000)] * 1e3
    for n, (a, b) in enumerate((_SIDE, _TOP), 1):
        axes = figure.add_subplot(1, 2, n)
        axes.plot(some[:, a], some[:, b], ",", color="tab:grey")
        axes.plot(rest.com_m[a] * 1e3, rest.com_m[b] * 1e3, "o", color="tab:red", label="centre of mass")
        if len(rest.support_m):
            ring = np.column_stack([rest.support_m, np.zeros(len(rest.support_m))]) * 1e3
            ring = np.vstack([ring, ring[:1]])
            axes.plot(ring[:, a], ring[:, b], color="tab:blue", label="stands on")
        axes.set_aspect("equal")
        axes.set_title("from the side" if n == 1 else "from above")
        axes.set_xlabel("mm")
        axes.legend(fontsize=7)
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return base64.b64encode(data.getvalue()).decode()


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title><style>
body {{ font: 15px/1.5 sans-serif; max-width: 1000px; margin: 2em auto; padding: 0 1em; }}
img {{ max-width: 100%; }}
</style></head><body><h1>{title}</h1><p>{words}</p>{body}</body></html>
"""
