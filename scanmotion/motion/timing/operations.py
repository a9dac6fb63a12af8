"""Timing: operations from rest to rest, inside the limits of every axis and of the scanner's speed.

Transits follow a cubic B-spline beside their checked path (transit/drive.py holds the curve that
transit/plan.py checked) with the profile of toppra_profile.py, made jerk-limited by jerk_limited.py. Sweeps
and revolutions are driven by one path parameter with Ruckig's jerk-limited law (Berscheid and Kroeger 2021,
arXiv:2105.04830), which never leaves the path.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.core.errors import TimingError
from scanmotion.core.tour import Path, Stop, Tour
from scanmotion.core.trajectory import Operation, OperationKind, Trajectory
from scanmotion.motion.profile.jerk_limited import ruckig_law
from scanmotion.motion.profile.speed_profile import MARGIN, parameter_grid
from scanmotion.motion.profile.spline import JointSpline, spline_beside, spline_through
from scanmotion.motion.timing.helix import HelixMotion, helix_motion
from scanmotion.motion.timing.path import PathMotion, path_motion
from scanmotion.motion.transit.drive import emitted_law, limits_of

SAMPLE_S = 0.01
"""Distance of the written samples; operations end on whole samples [s]."""
_SAME_Q = 1e-6
_STILL = 1e-9
_LINE_M = 1e-3
"""How far a sweep may pass beside the straight lines between the points that it was given [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TimedMotion:
    """One operation before it is placed in time."""

    kind: OperationKind
    viewpoints: tuple[str, ...]
    path: JointSpline
    law: Callable[[np.ndarray], np.ndarray]
    """s and its first three derivatives, shape (n, 4), at times (n,)."""
    duration: float
    """[s]"""
    floor: float
    """Duration without a jerk limit, along the same path [s]."""

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations, each (n, 7), at times t; at rest after `duration`."""
        s, s1, s2 = self.law(np.minimum(t, self.duration)).T[:3, :, None]
        q1 = self.path(s[:, 0], 1)
        return self.path(s[:, 0]), q1 * s1, self.path(s[:, 0], 2) * s1**2 + q1 * s2

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """First and last configuration, shape (7,) each [rad]."""
        first, last = (self.path(np.array([s]))[0] for s in (0.0, self.path.end))
        return first, last


def time_plan(
    cell: Cell,
    tour: Tour,
    paths: Sequence[Path],
    *,
    sample_s: float = SAMPLE_S,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """The tour as a timed trajectory: a transit to each stop, then what is scanned there.

    Args:
        cell: limits of the axes, speeds of the process.
        tour: the stops in order.
        paths: one collision-checked path to each stop.
        sample_s: distance of the samples, a whole part of 10 ms [s].
        progress: told the share done.

    Raises:
        TimingError: a path does not lead where the tour goes, leaves the axes' ranges or cannot be driven.
    """
    placed = []
    for n, motion in enumerate(motions(cell, tour, paths)):
        placed.append(motion)
        if progress is not None:
            progress((n + 1) / (2 * len(tour.stops) + 1))
    trajectory = _sampled(placed, np.asarray(tour.start_q, dtype=float), sample_s)
    if progress is not None:
        progress(1.0)
    return trajectory


def motions(
    cell: Cell, tour: Tour, paths: Sequence[Path]
) -> Iterable[TimedMotion | HelixMotion | PathMotion]:
    """The operations of a tour in order, each with path and law; transits that do not move are left out."""
    if len(paths) != len(tour.stops):
        raise TimingError(f"{len(tour.stops)} stops need as many paths, not {len(paths)}")
    at = np.asarray(tour.start_q, dtype=float)
    for stop, path in zip(tour.stops, paths, strict=True):
        name = ", ".join(stop.viewpoints)
        _check_meets(at, path.q[0], f"the path to {name} starts")
        _check_meets(path.q[-1], stop.q_in, f"the path to {name} ends")
        if np.abs(np.diff(path.q, axis=0)).max(initial=0.0) > _STILL:
            yield transit_motion(cell, path.q, stop.viewpoints)
        yield _stop_motion(cell, stop)
        at = np.asarray(stop.q_out, dtype=float)


def transit_motion(cell: Cell, q: np.ndarray, viewpoints: tuple[str, ...] = ()) -> TimedMotion:
    """A transit along the polyline `q` (k, 7), as fast as the limits and the transit speed allow."""
    path, law = emitted_law(cell, q)
    _check_range(cell, path, viewpoints)
    return TimedMotion(
        kind="transit", viewpoints=viewpoints, path=path, law=law, duration=law.duration, floor=law.floor
    )


def _stop_motion(cell: Cell, stop: Stop) -> TimedMotion | HelixMotion | PathMotion:
    if stop.kind == "helix":
        return helix_motion(cell, stop)
    if stop.kind == "path":
        return path_motion(cell, stop)
    if stop.kind == "dwell":
        dwell_s = float(cell.settings.process.dwell_s)
        return TimedMotion(
            kind="dwell",
            viewpoints=stop.viewpoints,
            path=spline_beside(np.tile(stop.q_in, (2, 1))),
            law=lambda t: np.zeros((len(t), 4)),
            duration=dwell_s,
            floor=dwell_s,
        )
    if stop.kind == "revolution":
        ends = np.array([stop.q_in, stop.q_out], dtype=float)
        path = spline_through(ends, np.array([0.0, 1.0]))
        return _driven(cell, stop, path, np.inf)
    if stop.path is None:
        raise TimingError(f"sweep {', '.join(stop.viewpoints)} has no path")
    return _driven(cell, stop, _sweep_spline(cell, stop), cell.settings.process.scan_speed_m_s)


def _sweep_spline(cell: Cell, stop: Stop) -> JointSpline:
    """The sweep's joint path over the distance that the scanner covers relative to the part."""
    q = np.asarray(stop.path, dtype=float)
    name = ", ".join(stop.viewpoints)
    _check_meets(q[0], stop.q_in, f"sweep {name} starts")
    _check_meets(q[-1], stop.q_out, f"sweep {name} ends")
    steps = np.linalg.norm(np.diff(scanner_in_object(cell, q)[:, :3, 3], axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-6])
    if keep.sum() < 2:
        raise TimingError(f"sweep {name} does not move the scanner")
    at = np.concatenate([[0.0], np.cumsum(steps[keep[1:]])])
    path = spline_through(q[keep], at)
    s = parameter_grid(path)
    p = scanner_in_object(cell, path(s))[:, :3, 3]
    nodes = scanner_in_object(cell, q[keep])[:, :3, 3]
    beside = max(float(np.abs(p[:, k] - np.interp(s, at, nodes[:, k])).max()) for k in range(3))
    if beside > _LINE_M:
        raise TimingError(
            f"sweep {name} leaves its line by {1000 * beside:.1f} mm between two of its points: "
            "they are too far apart or in two configurations of the arm",
            joint="tcp",
            value=beside,
            limit=_LINE_M,
        )
    return path


def _driven(cell: Cell, stop: Stop, path: JointSpline, speed: float) -> TimedMotion:
    """One path parameter, driven by Ruckig with the least of what the limits allow along the path.

    Args:
        cell: the axes' limits.
        stop: what is driven.
        path: q(s); for a sweep s is the scanner's distance [m].
        speed: greatest ds/dt [m/s], or infinity.
    """
    _check_range(cell, path, stop.viewpoints)
    limits = limits_of(cell, np.inf)
    s = parameter_grid(path)
    q1, q2, q3 = (np.abs(path(s, k)) for k in (1, 2, 3))
    p = scanner_in_object(cell, path(s))[:, :3, 3]
    if np.isfinite(speed):
        speed /= float((np.linalg.norm(np.diff(p, axis=0), axis=1) / np.diff(s)).max())
    speed = (1 - MARGIN) * min(speed, float(1 / (q1 / limits.v).max()))
    for _ in range(60):
        a = float(((limits.a - q2 * speed**2) / np.maximum(q1, 1e-9)).min())
        j = float(((limits.j - q3 * speed**3 - 3 * q2 * speed * max(a, 0.0)) / np.maximum(q1, 1e-9)).min())
        if a > 0.0 and j > 0.0:
            law = ruckig_law(path.end, speed, (1 - MARGIN) * a, (1 - MARGIN) * j)
            return TimedMotion(
                kind=stop.kind,
                viewpoints=stop.viewpoints,
                path=path,
                law=law,
                duration=law.duration,
                floor=path.end / speed + speed / a,
            )
        speed *= 0.8
    raise TimingError(f"{stop.kind} {', '.join(stop.viewpoints)}: its path turns too sharply to be driven")


def _check_meets(q: np.ndarray, other: np.ndarray, what: str) -> None:
    gap = float(np.abs(np.asarray(q) - np.asarray(other)).max())
    if not gap <= _SAME_Q:
        raise TimingError(f"{what} {gap:.3g} rad beside where the tour stands", value=gap, limit=_SAME_Q)


def _check_range(cell: Cell, path: JointSpline, viewpoints: tuple[str, ...]) -> None:
    q = path(parameter_grid(path))
    over = np.maximum(q - cell.q_max, cell.q_min - q).max(axis=0)
    worst = int(over.argmax())
    if over[worst] > _SAME_Q:
        reached = float(q[np.abs(q[:, worst]).argmax(), worst])
        bound = cell.q_max if reached > 0 else cell.q_min
        name = cell.joint_names[worst]
        raise TimingError(
            f"the way to {', '.join(viewpoints)} takes {name} to {np.degrees(reached):.2f} deg, "
            f"its range ends at {np.degrees(bound[worst]):.2f} deg",
            joint=name,
            value=reached,
            limit=float(bound[worst]),
        )


def _sampled(
    placed: Sequence[TimedMotion | HelixMotion | PathMotion], start_q: np.ndarray, sample_s: float
) -> Trajectory:
    """The operations one after another, each ending on a whole 10 ms, sampled evenly."""
    if not placed:
        still = np.zeros((1, 7))
        return Trajectory(
            t=np.zeros(1),
            q=start_q[None],
            qd=still,
            qdd=still,
            operation=np.zeros(1, dtype=int),
            operations=(),
        )
    per = round(SAMPLE_S / sample_s)
    counts = [max(int(np.ceil(m.duration / SAMPLE_S - 1e-9)), 1) * per for m in placed]
    starts = np.concatenate([[0], np.cumsum(counts)])
    rows, operations = [], []
    for n, motion in enumerate(placed):
        samples = motion(np.arange(0 if n == 0 else 1, counts[n] + 1) * sample_s)
        rows.append(samples)
        operations.append(
            Operation(
                index=n,
                kind=motion.kind,
                viewpoints=motion.viewpoints,
                t_start=starts[n] / per * SAMPLE_S,
                t_end=starts[n + 1] / per * SAMPLE_S,
                q_start=motion.ends[0],
                q_end=motion.ends[1],
            )
        )
    q, qd, qdd = (np.vstack([r[k] for r in rows]) for k in range(3))
    index = np.repeat(np.arange(len(placed)), [len(r[0]) for r in rows])
    t = np.arange(starts[-1] + 1) / per * SAMPLE_S
    return Trajectory(t=t, q=q, qd=qd, qdd=qdd, operation=index, operations=tuple(operations))
