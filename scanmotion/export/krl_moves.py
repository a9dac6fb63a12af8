"""The moves of one operation in KRL: as PTP and LIN, or as a timed spline."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import InputError
from scanmotion.export.knots import polyline_knots, spline_knots
from scanmotion.export.pose import Arm, abc_from_rotation
from scanmotion.export.source import Stretch

MOST_POINTS = 600
"""Points of one operation: a timed block of them still fits into a page."""
PTP_DEG = 0.05
"""How far a joint may be from the planned path between two PTP points [deg]."""
CUT_DEG = 0.2
"""Corners that C_PTP would cut by more than this are passed exactly [deg]."""
LIN_M, LIN_RAD = 0.2e-3, np.deg2rad(0.05)
"""How far the scanner may be from the planned path between two LIN points."""
SPLINE_DEG = 0.002
"""How far a cubic spline through the timed points may be from the planned joints [deg]."""
SPLINE_LONGEST_S, SPLINE_SHORTEST_S = 0.25, 0.03
"""Greatest and least time between two points of a timed spline [s]."""
_NAMES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
_MOST = 1e5


@dataclass(frozen=True, kw_only=True)
class Block:
    """Lines of one operation and how true they are to the plan."""

    lines: tuple[str, ...]
    away: float = 0.0
    """Greatest distance of a joint from the plan [deg]."""
    cut: float = 0.0
    """Greatest further distance where corners are rounded [deg]."""


def number(value: float, digits: int = 5) -> str:
    """A number in fixed notation; KRL's REAL has 32 bits, so more than five decimals of a degree are lost.

    Raises:
        InputError: not finite, or larger than any joint or length can be.
    """
    if not abs(value) < _MOST:
        raise InputError(f"{float(value)!r} is no number for a robot programme")
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def axes(degrees: np.ndarray) -> str:
    """E6AXIS of seven joints [deg]."""
    return "{" + ",".join(f"{n} {number(v)}" for n, v in zip(_NAMES, degrees, strict=True)) + "}"


def frame(X: np.ndarray, e1: float | None = None) -> str:
    """FRAME of a pose, in mm and degrees; with `e1` [deg], the E6POS of a point for LIN, without S and T."""
    values = [*(X[:3, 3] * 1e3), *np.rad2deg(abc_from_rotation(X[:3, :3]))]
    text = ",".join(f"{n} {number(v)}" for n, v in zip("XYZABC", values, strict=True))
    return "{" + text + ("" if e1 is None else f",E1 {number(e1)}") + "}"


def still(stretch: Stretch) -> bool:
    """Whether nothing moves by as much as the programme's last digit."""
    return bool(np.ptp(np.rad2deg(stretch.q), axis=0).max() < 1e-5)


def wait(stretch: Stretch) -> Block:
    """A standstill."""
    return Block(lines=(f"WAIT SEC {number(stretch.duration, 4)}",))


def classic_block(stretch: Stretch, arm: Arm, X_FS: np.ndarray, fastest: np.ndarray) -> Block:
    """PTP along the planned joint path; LIN for a sweep; WAIT for a dwell.

    Args:
        stretch: the operation's samples.
        arm: for the scanner's pose at LIN points.
        X_FS: pose of the scanner on the flange, which is the programme's $TOOL.
        fastest: greatest speeds that 100 percent mean, shape (7,) [rad/s].
    """
    if still(stretch):
        return wait(stretch)
    if stretch.operation.kind == "sweep":
        return _sweep(stretch, arm, X_FS)
    q = np.rad2deg(stretch.q)
    knots, away = polyline_knots(q, PTP_DEG, most=MOST_POINTS)
    lines, points, last, rounded = [], q[knots], 0, 0.0
    percents = _percents(stretch, knots, arm, X_FS, fastest)
    for i in range(1, len(knots)):
        percent = percents[i - 1]
        if percent != last:
            lines.append(f"BAS (#VEL_PTP,{percent} )")
            last = percent
        suffix = ""
        if i + 1 < len(knots):
            cut = float(np.abs(points[i - 1] - 2 * points[i] + points[i + 1]).max()) / 4
            if cut <= CUT_DEG:
                suffix, rounded = " C_PTP", max(rounded, cut)
        lines.append(f"PTP {axes(points[i])}{suffix}")
    return Block(lines=tuple(lines), away=away, cut=rounded)


def _percents(
    stretch: Stretch, knots: np.ndarray, arm: Arm, X_FS: np.ndarray, fastest: np.ndarray
) -> list[int]:
    """Speed of each PTP: neither a joint nor the scanner is faster than the plan between the same points."""
    p_BS = (arm.X_BF(stretch.q) @ X_FS)[:, :3, 3]
    planned = np.linalg.norm(np.gradient(p_BS, stretch.t, axis=0), axis=1)
    share = np.linspace(0, 1, 9)[:, None]
    found = []
    for a, b in pairwise(knots):
        step = stretch.q[b] - stretch.q[a]
        peak = float((np.abs(stretch.qd[a : b + 1]) / fastest).max())
        # What the scanner would do at 100 percent, where the joint that needs longest sets the pace.
        seconds = float((np.abs(step) / fastest).max())
        dense = (arm.X_BF(stretch.q[a] + share * step) @ X_FS)[:, :3, 3]
        full = float(np.linalg.norm(np.diff(dense, axis=0), axis=1).max()) * (len(share) - 1) / seconds
        if full > 1e-6:
            peak = min(peak, float(planned[a : b + 1].max()) / full)
        found.append(int(np.clip(np.floor(100 * peak + 1e-6), 1, 100)))
    return found


def _sweep(stretch: Stretch, arm: Arm, X_FS: np.ndarray) -> Block:
    """LIN of the scanner's frame in the robot's base at the sweep's own speed."""
    X_BS = arm.X_BF(stretch.q) @ X_FS
    p, e1 = X_BS[:, :3, 3], np.rad2deg(stretch.q[:, 6])
    turned = Rotation.from_matrix(X_BS[:, :3, :3] @ X_BS[0, :3, :3].T).as_rotvec()
    path = np.column_stack([p / LIN_M, turned / LIN_RAD, e1[:, None] / PTP_DEG])
    knots, _ = polyline_knots(path, 1.0, most=MOST_POINTS)
    velocity = np.gradient(p, stretch.t, axis=0)
    speed = float(np.linalg.norm(velocity, axis=1).max())
    if speed < 1e-6:
        raise InputError(f"sweep {' '.join(stretch.operation.viewpoints[:3])} does not move the scanner")
    gain = float(np.linalg.norm(np.gradient(velocity, stretch.t, axis=0), axis=1).max())
    lines = [
        f"$VEL.CP={number(speed, 4)}",
        f"$ACC.CP={number(max(gain, 0.05), 3)}",
        "$VEL.ORI1=30", "$VEL.ORI2=30", "$ACC.ORI1=60", "$ACC.ORI2=60",
    ]  # fmt: skip
    for i in knots[1:]:
        suffix = "" if i == knots[-1] else " C_DIS"
        lines.append(f"LIN {frame(X_BS[i], float(e1[i]))}{suffix}")
    return Block(lines=tuple(lines))


def timed_block(stretch: Stretch, arm: Arm, X_FS: np.ndarray, fastest: np.ndarray) -> Block:
    """A spline whose points carry the planned instants as shares of the block's time.

    The arguments are those of `classic_block`; only the stretch matters.
    """
    if still(stretch):
        return wait(stretch)
    t, q = stretch.t, np.rad2deg(stretch.q)
    knots, away = spline_knots(
        t, q, SPLINE_DEG, longest=SPLINE_LONGEST_S, shortest=SPLINE_SHORTEST_S, most=MOST_POINTS
    )
    share = np.round(100 * (t[knots] - t[0]) / stretch.duration, 5)
    # The first point is where the arm stands already; public programmes put it before TIME_BLOCK START.
    lines = ["PTP_SPLINE", f" SPTP {axes(q[0])}", " TIME_BLOCK START"]
    for i, part in zip(knots[1:], np.diff(share), strict=True):
        lines += [f" SPTP {axes(q[i])}", f" TIME_BLOCK PART = {number(part)}"]
    lines += [f" TIME_BLOCK END = {number(stretch.duration, 4)}", "ENDSPLINE"]
    return Block(lines=tuple(lines), away=away)
