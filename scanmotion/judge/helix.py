"""Helices: a whole turn for each viewpoint, never back, the scanner straight from one to the next."""

from itertools import pairwise

import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Trajectory
from scanmotion.judge.motion import Motion
from scanmotion.judge.views import nearest
from scanmotion.plan_io.schema import OperationRecord, PlanRecord

BESIDE_M = 2e-3
"""How far the scanner may pass beside the straight line between two places."""
ASIDE_RAD = np.deg2rad(5.0)
"""By how much the viewing direction's angles to those at both places may exceed the angle between them."""
_WHOLE = 2 * np.pi - 1e-4


def check_helices(record: PlanRecord, trajectory: Trajectory, motion: Motion) -> list[Finding]:
    """What a helix promises beyond its viewpoints, its speed and its clearance.

    While the scanner is nearer to the place of a viewpoint than to its neighbours' the table makes a whole
    turn; it never turns back; from place to place the scanner moves on a straight line in W and looks
    between where it looks at both.
    """
    findings = []
    views = {v.id: v for v in record.viewpoints}
    for o in record.operations:
        where = np.flatnonzero((trajectory.t >= o.t_start - 1e-6) & (trajectory.t <= o.t_end + 1e-6))
        if o.kind != "helix" or len(where) < 2:
            continue
        if len(o.viewpoints) < 2 or not all(v in views for v in o.viewpoints):
            text = f"operation {o.index} (helix) does not serve two known viewpoints or more"
            findings.append(Finding(code="order", message=text, where=f"operation {o.index}", t=o.t_start))
            continue
        at = [nearest(views[name], motion.X_OS[where])[2] for name in o.viewpoints]
        findings += _turns(o, at, trajectory.q[where, 6], motion.X_WS[where, :3, 3])
        for (a, b), (i, j) in zip(pairwise(o.viewpoints), pairwise(at), strict=True):
            if i < j:
                findings += _way(o, f"{a} to {b}", motion.X_WS[where[i : j + 1]])
    return findings


def _turns(o: OperationRecord, at: list[int], angle: np.ndarray, p: np.ndarray) -> list[Finding]:
    """Whether the table makes a whole turn at each of the places, p[at], and never turns back."""
    name = f"operation {o.index} (helix)"
    findings = []
    sense = np.sign(angle[-1] - angle[0])
    steps = sense * np.diff(angle)
    if steps.min() < -1e-7:
        text = f"{name}: the table turns back by {np.rad2deg(-steps.min()):.4f} deg between two samples"
        findings.append(Finding(code="order", message=text, where=name, t=o.t_start))
    for n, view in enumerate(o.viewpoints):
        own = np.ones(len(p), bool)
        away = np.linalg.norm(p - p[at[n]], axis=1)
        for side, other in ((-1, n - 1), (1, n + 1)):
            if 0 <= other < len(at):
                later = (np.arange(len(p)) - at[n]) * side > 0
                own &= ~later | (away < np.linalg.norm(p - p[at[other]], axis=1))
                # What lies beyond the neighbour is the neighbour's, however near the arm comes again.
                own &= (np.arange(len(p)) - at[other]) * side < 0
        turned = float(steps[own[1:] & own[:-1]].sum())
        if turned < _WHOLE:
            text = f"{name}: the table turns {np.rad2deg(turned):.2f} deg instead of 360 at {view}"
            findings.append(
                Finding(code="order", message=text, where=view, value=turned, limit=_WHOLE, t=o.t_start)
            )
    return findings


def _way(o: OperationRecord, name: str, X_WS: np.ndarray) -> list[Finding]:
    """Whether the scanner goes straight from the first of the poses to the last and looks where it should."""
    p, z = X_WS[:, :3, 3], X_WS[:, :3, 2]
    line = p[-1] - p[0]
    share = np.clip((p - p[0]) @ line / max(float(line @ line), 1e-12), 0.0, 1.0)
    beside = float(np.linalg.norm(p - p[0] - share[:, None] * line, axis=1).max())
    first, last = (np.arccos(np.clip(z @ end, -1.0, 1.0)) for end in (z[0], z[-1]))
    aside = float((first + last).max() - first[-1])
    wrong = []
    if beside > BESIDE_M:
        wrong.append((f"passes {beside * 1e3:.1f} mm beside the straight line", beside, BESIDE_M))
    if aside > ASIDE_RAD:
        wrong.append((f"looks {np.rad2deg(aside):.1f} deg aside", aside, ASIDE_RAD))
    where = f"operation {o.index}"
    return [
        Finding(
            code="order", message=f"{where} (helix): the scanner {text} on the way from {name}",
            where=where, value=value, limit=limit, t=o.t_start,
        )
        for text, value, limit in wrong
    ]  # fmt: skip
