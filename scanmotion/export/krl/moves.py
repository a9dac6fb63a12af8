"""The moves of one operation in KRL: as PTP and LIN, or as a timed spline, and the way back to its start."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import InputError
from scanmotion.export.job import DRY_PERCENT, ExportJob
from scanmotion.export.knots import polyline_knots, spline_knots, way_back_knots
from scanmotion.export.pose import abc_from_rotation
from scanmotion.export.source import Stretch

MOST_POINTS = 300
"""Points of one operation: a block of them, with the way back, still fits into a page."""
PTP_DEG, SCAN_DEG = 0.05, 0.01
"""How far a joint may be from the planned path between two PTP points, and so where it scans [deg]."""
CUT_DEG, PATH_CUT_DEG = 0.2, 0.03
"""C_PTP rounds a corner by no more than this [deg]; so in a continuous motion, which scans at its corners."""
LIN_M, LIN_RAD = 0.2e-3, np.deg2rad(0.05)
"""How far the scanner may be from the planned path between two LIN points."""
SPLINE_DEG = 0.002
"""How far a cubic spline through the timed points may be from the planned joints [deg]."""
SPLINE_LONGEST_S, SPLINE_SHORTEST_S = 0.25, 0.03
"""Greatest and least time between two points of a timed spline [s]."""
PATH_POINTS, PATH_DEG = 6000, 0.004
"""Points of a continuous motion, one spline however long, and how far it may leave the plan [deg]."""
BACK_DEG = 0.02
"""How far the way back along a continuous motion may be from what was driven [deg]."""
BACK_PERCENT, BACK_M_S = 10, 0.05
"""Speed of the way back after a fault of the scanner: of the joints, and of the scanner on a line [m/s]."""
_NAMES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
_MOST = 1e5


@dataclass(frozen=True, kw_only=True)
class KrlBlock:
    """Lines of one operation and how true they are to the plan."""

    lines: tuple[str, ...]
    back: tuple[str, ...] = ()
    """The way back to the operation's start, along what was driven."""
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


STOP_CUT_DEG = 0.05
"""A corner that one percent of rounding cuts by more is driven to exactly; the judge allows 0.06 deg."""


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


def classic_block(stretch: Stretch, job: ExportJob) -> KrlBlock:
    """PTP along the planned joint path; LIN for a sweep; WAIT for a dwell."""
    if still(stretch):
        return _wait(stretch, job)
    if stretch.operation.kind == "sweep":
        return _sweep(stretch, job)
    q, whole = np.rad2deg(stretch.q), stretch.operation.kind == "path"
    knots, away = polyline_knots(
        q, SCAN_DEG if stretch.operation.scanning else PTP_DEG, most=PATH_POINTS if whole else MOST_POINTS
    )
    lines, points, last, rounded, apo = [], q[knots], 0, 0.0, 0
    marks, cut = stretch.operation.kind in ("helix", "path"), PATH_CUT_DEG if whole else CUT_DEG
    percents = ptp_percents(stretch, knots, job)
    for i in range(1, len(knots)):
        percent = max(percents[i - 1] * DRY_PERCENT // 100, 1) if job.dry_run else percents[i - 1]
        if percent != last:
            lines.append(f"{job.name}_SPD ({percent})")
            last = percent
        suffix = ""
        if i + 1 < len(knots):
            share = rounding(points[i - 1 : i + 2], cut)
            passed = cut_of(points[i - 1 : i + 2], share)
            # Where the table turns back after a long way even one percent cuts too much: an exact stop there.
            if passed <= max(cut, STOP_CUT_DEG):
                if share != apo:
                    lines.append(f"$APO.CPTP={share}")
                    apo = share
                suffix, rounded = " C_PTP", max(rounded, passed)
        if marks:
            lines.append(f"TRIGGER WHEN DISTANCE=1 DELAY=0 DO {job.name}_AT={i}")
        lines.append(f"PTP {axes(points[i])}{suffix}")
    lines.append(f"{job.name}_SPD (100)")
    back = _back_along(stretch, knots, job) if marks else _back(stretch, points, job)
    return KrlBlock(lines=tuple(lines), back=back, away=away, cut=rounded)


def rounding(points: np.ndarray, cut: float = CUT_DEG) -> int:
    """$APO.CPTP of the middle of three points, shape (3, k) [deg]: the greatest that cuts `cut` at most."""
    bend = float(np.abs(points[0] - 2 * points[1] + points[2]).max())
    return int(np.clip(np.floor(8 * cut / max(bend, 1e-9) * 100), 1, 100))


def cut_of(points: np.ndarray, share: int) -> float:
    """How far the rounded corner passes the middle one of three points [deg].

    100 percent of C_PTP begins half-way between the points; the curve is taken as a parabola.
    """
    return float(np.abs(points[0] - 2 * points[1] + points[2]).max()) / 8 * share / 100


def ptp_percents(stretch: Stretch, knots: np.ndarray, job: ExportJob) -> list[int]:
    """Speed of each PTP: neither a joint nor the scanner is faster than the plan between the same points."""
    p_BS = (job.arm.X_BF(stretch.q) @ job.X_FS)[:, :3, 3]
    planned = np.linalg.norm(np.gradient(p_BS, stretch.t, axis=0), axis=1)
    share = np.linspace(0, 1, 9)[:, None]
    found = []
    for a, b in pairwise(knots):
        step = stretch.q[b] - stretch.q[a]
        peak = float((np.abs(stretch.qd[a : b + 1]) / job.fastest).max())
        # What the scanner would do at 100 percent, where the joint that needs longest sets the pace.
        seconds = float((np.abs(step) / job.fastest).max())
        dense = (job.arm.X_BF(stretch.q[a] + share * step) @ job.X_FS)[:, :3, 3]
        full = float(np.linalg.norm(np.diff(dense, axis=0), axis=1).max()) * (len(share) - 1) / seconds
        if full > 1e-6:
            peak = min(peak, float(planned[a : b + 1].max()) / full)
        found.append(int(np.clip(np.floor(100 * peak + 1e-6), 1, 100)))
    return found


def timed_block(stretch: Stretch, job: ExportJob) -> KrlBlock:
    """A spline whose points carry the planned instants as shares of the block's time."""
    if still(stretch):
        return _wait(stretch, job)
    t, q = stretch.t, np.rad2deg(stretch.q)
    whole = stretch.operation.kind == "path"
    tolerance, most = (PATH_DEG, PATH_POINTS) if whole else (SPLINE_DEG, MOST_POINTS)
    knots, away = spline_knots(
        t, q, tolerance, longest=SPLINE_LONGEST_S, shortest=SPLINE_SHORTEST_S, most=most
    )
    marked = stretch.operation.kind in ("helix", "path")
    passed = knots if marked else knots[:1]
    if whole:
        knots, passed = way_back_knots(t, q, knots, BACK_DEG, shortest=SPLINE_SHORTEST_S)
    share = np.round(100 * (t[knots] - t[0]) / stretch.duration, 5)
    marks = {int(k): n for n, k in enumerate(passed) if n}
    # The first point is where the arm stands already; public programmes put it before TIME_BLOCK START.
    lines = ["PTP_SPLINE", f" SPTP {axes(q[0])}", " TIME_BLOCK START"]
    for i, part in zip(knots[1:], np.diff(share), strict=True):
        if int(i) in marks:
            lines.append(f" TRIGGER WHEN PATH=0 DELAY=0 DO {job.name}_AT={marks[int(i)]}")
        lines += [f" SPTP {axes(q[i])}", f" TIME_BLOCK PART = {number(part)}"]
    seconds = stretch.duration * (100 / DRY_PERCENT if job.dry_run else 1)
    lines += [f" TIME_BLOCK END = {number(seconds, 4)}", "ENDSPLINE"]
    back = _back_along(stretch, passed, job) if marked else _back(stretch, q[knots], job)
    return KrlBlock(lines=tuple(lines), back=back, away=away)


def _back_along(stretch: Stretch, knots: np.ndarray, job: ExportJob) -> tuple[str, ...]:
    """The way back along a helix or a continuous motion, by its counted points, no faster than driven."""
    q, percents, lines = np.rad2deg(stretch.q[knots]), ptp_percents(stretch, knots, job), []
    for n in range(len(knots) - 2, -1, -1):
        move = (f"{job.name}_SPD ({percents[n]})", f"PTP {axes(q[n])}")
        lines += [f"IF {job.name}_AT>={n} THEN", *move, "ENDIF"] if n else move
    return (*lines, f"{job.name}_SPD (100)")


def _wait(stretch: Stretch, job: ExportJob) -> KrlBlock:
    """A standstill."""
    return KrlBlock(lines=(f"WAIT SEC {number(stretch.duration, 4)}",))


def _back(stretch: Stretch, points: np.ndarray, job: ExportJob) -> tuple[str, ...]:
    """The way back to where an operation starts, along what was driven.

    A turn of the table and a straight line of the scanner have one way back; `_back_along` knows that of a
    helix and of a continuous motion.
    """
    kind = stretch.operation.kind
    if kind == "sweep":
        X, e1 = (job.arm.X_BF(stretch.q[:1]) @ job.X_FS)[0], float(np.rad2deg(stretch.q[0, 6]))
        return (f"$VEL.CP={number(BACK_M_S, 3)}", f"LIN {frame(X, e1)}", f"{job.name}_CP (FALSE)")
    if kind == "revolution":
        return (f"{job.name}_SPD ({BACK_PERCENT})", f"PTP {axes(points[0])}")
    return ()


def _sweep(stretch: Stretch, job: ExportJob) -> KrlBlock:
    """LIN of the scanner's frame in the robot's base at the sweep's own speed."""
    X_BS = job.arm.X_BF(stretch.q) @ job.X_FS
    p, e1 = X_BS[:, :3, 3], np.rad2deg(stretch.q[:, 6])
    turned = Rotation.from_matrix(X_BS[:, :3, :3] @ X_BS[0, :3, :3].T).as_rotvec()
    path = np.column_stack([p / LIN_M, turned / LIN_RAD, e1[:, None] / PTP_DEG])
    knots, _ = polyline_knots(path, 1.0, most=MOST_POINTS)
    velocity = np.gradient(p, stretch.t, axis=0)
    speed = float(np.linalg.norm(velocity, axis=1).max())
    if speed < 1e-6:
        raise InputError(f"sweep {' '.join(stretch.operation.viewpoints[:3])} does not move the scanner")
    gain = float(np.linalg.norm(np.gradient(velocity, stretch.t, axis=0), axis=1).max())
    speed *= DRY_PERCENT / 100 if job.dry_run else 1
    lines = [
        f"$VEL.CP={number(speed, 4)}",
        f"$ACC.CP={number(max(gain, 0.05), 3)}",
        "$VEL.ORI1=30", "$VEL.ORI2=30", "$ACC.ORI1=60", "$ACC.ORI2=60",
    ]  # fmt: skip
    for i in knots[1:]:
        suffix = "" if i == knots[-1] else " C_DIS"
        lines.append(f"LIN {frame(X_BS[i], float(e1[i]))}{suffix}")
    lines.append(f"{job.name}_CP (FALSE)")
    block = KrlBlock(lines=tuple(lines))
    return replace(block, back=_back(stretch, np.rad2deg(stretch.q[[0, -1]]), job))
