"""Ways from one configuration to another without regard to obstacles: scanner on a line, or joints on a line.

At 0.1 m/s nearly all of a transit's time is the length of the scanner's way, and no way is shorter than the
straight line in W. `chord` keeps the scanner on it: the wrist turns evenly in its joints, which no wrist
singularity disturbs, and the first three axes follow by position alone. The table turns by its own ramps
over the same time, for its slow acceleration would otherwise hold back the arm at both ends.
"""

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import tcp_jacobian
from scanmotion.core.tour import PathMethod
from scanmotion.geometry.rest_to_rest import trapezoid_seconds
from scanmotion.motion.profile.jerk_limited import ruckig_law
from scanmotion.motion.profile.spline import STEP_M, STEP_RAD, step_counts
from scanmotion.motion.transit.drive import positions, transit_limits

_TABLE = 6
_REACHED_M = 1e-6
_NEWTON_STEPS = 12
_JUMP = 4.0
"""A joint step this many times the greatest planned one means another branch of the arm."""
_EASE = 0.9
"""Share of the table's acceleration and jerk that its turn plans with; the rest lets the arm's ramps in."""
_FINE = 1600
_STEP_S = 0.1
"""Greatest time between points of a way on which the table turns [s]."""


def least_seconds(cell: Cell, qa: np.ndarray, qb: np.ndarray) -> np.ndarray:
    """No way from qa to qb, shape (n, 7) each, is faster: the chord, each axis alone, no jerk limit [s]."""
    qa, qb = np.atleast_2d(qa), np.atleast_2d(qb)
    limits = transit_limits(cell)
    chord = np.linalg.norm(positions(cell, qb) - positions(cell, qa), axis=1)
    return np.maximum(chord / limits.tcp, trapezoid_seconds(np.abs(qb - qa), limits.v, limits.a).max(axis=1))


def ways(cell: Cell, qa: np.ndarray, qb: np.ndarray) -> list[tuple[PathMethod, np.ndarray]]:
    """Ways (method, polyline (k, 7)) from qa to qb, shape (7,), not yet checked for collisions."""
    found: list[tuple[PathMethod, np.ndarray]] = []
    turns = abs(qb[_TABLE] - qa[_TABLE]) > 1e-9
    line = chord(cell, qa, qb)
    if line is not None:
        found.append(("line", with_table(cell, line)))
        if turns:
            found.append(("line", line))
    even = np.linspace(0.0, 1.0, _count(cell, np.array([qa, qb])) + 1)
    arm = qa + even[:, None] * (qb - qa)
    if turns:
        found.append(("joint", with_table(cell, arm)))
    found.append(("joint", np.array([qa, qb], dtype=float)))
    return found


def chord(cell: Cell, qa: np.ndarray, qb: np.ndarray) -> np.ndarray | None:
    """The scanner on its straight line in W; None where the arm cannot follow it without another branch."""
    n = _count(cell, np.array([qa, qb]))
    even = np.linspace(0.0, 1.0, n + 1)[:, None]
    q = qa + even * (qb - qa)
    ends = positions(cell, np.array([qa, qb]))
    goal = ends[0] + even * (ends[1] - ends[0])
    error = np.inf
    for _ in range(_NEWTON_STEPS):
        miss = goal - positions(cell, q)
        error = float(np.abs(miss).max())
        if error < _REACHED_M:
            break
        J = tcp_jacobian(cell, q)[:, 3:, :3]
        damped = J @ J.transpose(0, 2, 1) + 1e-6 * np.eye(3)
        step = (J.transpose(0, 2, 1) @ np.linalg.solve(damped, miss[:, :, None]))[:, :, 0]
        q[:, :3] += np.clip(step, -0.3, 0.3)
    q[0], q[-1] = qa, qb
    steps = np.abs(np.diff(q[:, :3], axis=0)).max()
    inside = (q >= cell.q_min).all() and (q <= cell.q_max).all()
    if error >= _REACHED_M or steps > _JUMP * STEP_RAD or not inside:
        return None
    return q


def _count(cell: Cell, ends: np.ndarray) -> int:
    """Points that a way needs, for its arm joints and the scanner's chord."""
    p = positions(cell, ends)
    steps = max(
        float(np.linalg.norm(p[1] - p[0])) / STEP_M,
        float(np.abs(ends[1] - ends[0])[:_TABLE].max()) / STEP_RAD,
    )
    return max(int(np.ceil(steps)), 4)


def with_table(cell: Cell, arm: np.ndarray) -> np.ndarray:
    """The arm's polyline with the table turning by its own ramps; evenly spaced in what takes time.

    The table's turn is the fastest that its jerk allows, stretched to the arm's time where that is longer;
    the arm moves evenly in time.
    """
    limits = transit_limits(cell)
    turn = arm[-1, _TABLE] - arm[0, _TABLE]
    if abs(turn) < 1e-9:
        return arm
    steps = np.linalg.norm(np.diff(positions(cell, arm), axis=0), axis=1) / limits.tcp
    steps = np.maximum(steps, (np.abs(np.diff(arm[:, :_TABLE], axis=0)) / limits.v[:_TABLE]).max(axis=1))
    arm_s = np.concatenate([[0.0], np.cumsum(steps)])
    slope = np.abs(np.diff(arm[:, :_TABLE], axis=0)).max(axis=0) / max(float(steps.min()), 1e-9)
    slope = np.maximum(np.minimum(slope, limits.v[:_TABLE]), 1e-9)
    drive = ruckig_law(
        max(float(arm_s[-1]), 1e-6),
        1.0,
        float((limits.a[:_TABLE] / slope).min()),
        float((limits.j[:_TABLE] / slope).min()),
    )
    table = ruckig_law(abs(turn), limits.v[_TABLE], _EASE * limits.a[_TABLE], _EASE * limits.j[_TABLE])
    total = max(drive.duration, table.duration)
    fine = np.linspace(0.0, 1.0, _FINE)
    along = drive(fine * drive.duration)[:, 0]
    angle = np.sign(turn) * table(fine * table.duration)[:, 0]
    pace = np.diff(along) + np.abs(np.diff(angle)) / limits.v[_TABLE]
    place = np.concatenate([[0.0], np.cumsum(pace)])
    count = max(len(arm) - 1, int(np.ceil(total / _STEP_S)))
    while True:
        at = np.interp(np.linspace(0.0, place[-1], count + 1), place, fine)
        here = np.interp(at, fine, along)
        q = np.column_stack([np.interp(here, arm_s, arm[:, k]) for k in range(_TABLE)])
        q = np.column_stack([q, arm[0, _TABLE] + np.interp(at, fine, angle)])
        q[0], q[-1] = arm[0], arm[-1]
        steps = step_counts(q, positions(cell, q))
        if steps.max() <= 1.0:
            return q
        # Evenly spaced points would be split unevenly later where a step is too long: take more of them.
        count = int(np.ceil(count * max(float(steps.max()), 1.02)))
