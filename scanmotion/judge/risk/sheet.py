"""Figures for a risk assessment (ISO 10218-1 and -2:2025 ask for one): speeds, space, clearances, stops.

From the written files alone, as the judge reads them. Speeds are finite differences of trajectory.csv. A
solid counts with the corners of the box that holds it, so space and speeds are never too small. Least
clearances are FCL's, at configurations between which nothing moves more than STEP_M; the true least is at
most UNSURE_M smaller. Stops: all joints slow down together, constantly, on the path, none faster than stated.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from scanmotion.core.trajectory import Trajectory
from scanmotion.geometry.convex import Hull, hull_from
from scanmotion.judge.contact import exact_distance, separation, way_of
from scanmotion.judge.motion import Motion, UrdfArm, arm_of, motion_at
from scanmotion.judge.solids import PART, TOOL, Solid, solids_of, stands_on
from scanmotion.plan_io.read import read_plan, read_trajectory
from scanmotion.plan_io.schema import PlanRecord

STEP_M, SLACK_M = 0.01, 0.001
UNSURE_M = STEP_M / 2 + SLACK_M
REACTION_S = 0.1
"""Between the signal and the drives' first effect; the integrator measures his cell's."""
_CHUNK = 2000
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
POINTS = ("flange", "scanner", "elbow", "anywhere", "part")
"""Origins of flange and scanner, a point of A3's axis, any corner of links and tool, any of the part."""


@dataclass(frozen=True, kw_only=True)
class OperationRisk:
    """Of one operation."""

    index: int
    kind: str
    viewpoints: tuple[str, ...]
    t_start: float
    t_end: float
    speed_m_s: dict[str, float]
    """Greatest speed of each of `POINTS`."""
    stop_m: dict[str, float]
    """Longest way of each of `POINTS` from the signal to rest."""
    stop_s: float
    """Longest time from the signal to rest."""


@dataclass(frozen=True, kw_only=True)
class Gap:
    """The least distance between the robot and one body around it."""

    robot: str
    around: str
    distance_m: float
    t: float
    operation: int
    q: tuple[float, ...]
    """A1..A6, E1 there [rad]."""
    p_WS: tuple[float, ...]
    """Where the scanner is then [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Risk:
    """What a risk assessment asks about a plan."""

    operations: tuple[OperationRisk, ...]
    low_m: np.ndarray
    """Least corner in W of the box that links 1..6 and tool never leave, shape (3,) [m]."""
    high_m: np.ndarray
    hull: Hull
    """Convex hull of the same space in W."""
    part_radius_m: float
    """Greatest distance of a corner of the part's box from the table's axis."""
    gaps: tuple[Gap, ...]
    """One for each body around the robot, the least first."""
    clearance_m: float
    """What the plan asks for."""
    deceleration_rad_s2: np.ndarray
    """With which each joint is taken to stop, shape (7,)."""
    reaction_s: float


def risk_of(
    folder: str | Path, *, deceleration: np.ndarray | None = None, reaction_s: float = REACTION_S
) -> Risk:
    """The figures of a plan's folder.

    Args:
        folder: what `scanmotion plan` wrote.
        deceleration: with which each joint stops, shape (7,) [rad/s2]; None is the plan's acceleration.
        reaction_s: from the signal to the drives' first effect [s].

    Raises:
        PlanFileError: the files cannot be read.
    """
    folder = Path(folder)
    record = read_plan(folder)
    trajectory = read_trajectory(folder, record)
    arm = arm_of(folder, record)
    solids = solids_of(folder, record, arm)
    given = record.limits.acceleration_rad_s2 if deceleration is None else deceleration
    brake = np.asarray(given, dtype=float)
    every = motion_at(arm, record, trajectory.t, trajectory.q)
    speeds = _speeds(every, solids, trajectory.t)
    t, q, way = _marks(record, trajectory, arm, solids)
    motion = motion_at(arm, record, t, q)
    hull = _swept(motion, solids)
    part = next(s for s in solids if s.group == PART)
    turned = np.linalg.inv(np.array(record.X_WT)) @ _corners(part, motion_at(arm, record, t[:1], q[:1]))[0].T
    return Risk(
        operations=_operations(trajectory, speeds, brake, reaction_s),
        low_m=hull.points.min(axis=0), high_m=hull.points.max(axis=0), hull=hull,
        part_radius_m=float(np.linalg.norm(turned[:2], axis=0).max()),
        gaps=_gaps(motion, q, way, solids, trajectory), clearance_m=record.process.clearance_m,
        deceleration_rad_s2=brake, reaction_s=reaction_s,
    )  # fmt: skip


def _corners(solid: Solid, motion: Motion) -> np.ndarray:
    """Corners of its box in W, shape (N, 8, 4), the last component 1."""
    at_G = np.column_stack([_CORNERS * solid.half, np.ones(8)])
    return np.einsum("nij,kj->nki", solid.poses(motion), at_G)


def _elbow(motion: Motion) -> np.ndarray:
    """The point of A3's axis that is nearest to the base's origin at zero, in W, shape (N, 3)."""
    w, v = motion.arm.screws[2, :3], motion.arm.screws[2, 3:]
    return (motion.X_WL[:, 3] @ np.append(np.cross(w, v), 1.0))[:, :3]


def _speeds(motion: Motion, solids: list[Solid], t: np.ndarray) -> dict[str, np.ndarray]:
    """Speed of each of POINTS between consecutive samples, shape (N - 1,) [m/s]."""
    step = np.maximum(np.diff(t), 1e-9)

    def of(p: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.diff(p, axis=0), axis=-1) / (step if p.ndim == 2 else step[:, None])

    found = {
        "flange": of(motion.X_WF[:, :3, 3]), "scanner": of(motion.X_WS[:, :3, 3]), "elbow": of(_elbow(motion))
    }  # fmt: skip
    for name, groups in (("anywhere", range(1, TOOL + 1)), ("part", (PART,))):
        fastest = np.zeros(len(step))
        for solid in (s for s in solids if s.group in groups):
            fastest = np.maximum(fastest, of(_corners(solid, motion)[:, :, :3]).max(axis=1))
        found[name] = fastest
    return found


def _operations(
    trajectory: Trajectory, speeds: dict[str, np.ndarray], brake: np.ndarray, reaction: float
) -> tuple[OperationRisk, ...]:
    """A stop on the path from speed v lasts as long as the slowest joint needs, T, and takes v T / 2."""
    qd = np.abs(np.diff(trajectory.q, axis=0)) / np.maximum(np.diff(trajectory.t), 1e-9)[:, None]
    slow = (qd / brake).max(axis=1)
    found = []
    for o in trajectory.operations:
        # A shared instant belongs to the earlier operation, so a step belongs to its end.
        own = trajectory.operation[1:] == o.index
        if not own.any():
            continue
        stop = {k: float((v[own] * (reaction + slow[own] / 2)).max()) for k, v in speeds.items()}
        found.append(
            OperationRisk(
                index=o.index, kind=o.kind, viewpoints=o.viewpoints, t_start=o.t_start, t_end=o.t_end,
                speed_m_s={k: float(v[own].max()) for k, v in speeds.items()}, stop_m=stop,
                stop_s=reaction + float(slow[own].max()),
            )
        )  # fmt: skip
    return tuple(found)


def _marks(
    record: PlanRecord, trajectory: Trajectory, arm: UrdfArm, solids: list[Solid]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, joints and way of configurations at most STEP_M apart."""
    t, q = trajectory.t, trajectory.q
    way = way_of(motion_at(arm, record, t, q), solids)
    marks = np.linspace(0.0, way[-1], max(int(np.ceil(way[-1] / STEP_M)), 1) + 1)
    at = np.interp(marks, way, t)
    at[0], at[-1] = t[0], t[-1]
    return at, np.column_stack([np.interp(at, t, q[:, j]) for j in range(7)]), marks


def _swept(motion: Motion, solids: list[Solid]) -> Hull:
    """Hull of the corners of links and tool at every configuration."""
    found = []
    for solid in (s for s in solids if 1 <= s.group <= TOOL):
        points = _corners(solid, motion)[:, :, :3].reshape(-1, 3)
        for first in range(0, len(points), 8 * _CHUNK):
            found.append(hull_from(points[first : first + 8 * _CHUNK]).points)
    return hull_from(np.concatenate(found))


def _gaps(
    motion: Motion, q: np.ndarray, way: np.ndarray, solids: list[Solid], trajectory: Trajectory
) -> tuple[Gap, ...]:
    """The least distance to each body around, over all links and the tool."""
    found = []
    robot = [s for s in solids if s.group >= 1]
    for b in (s for s in solids if s.group < 0):
        best, who, at = np.inf, "", 0
        others = [(a, _bound(a, b, motion)) for a in robot if not stands_on(a, b)]
        for a, low in sorted(others, key=lambda item: (item[1].min(), item[0].name)):
            distance, n = _least(a, b, motion, low, way, best)
            if distance < best:
                best, who, at = distance, a.name, n
        if not np.isfinite(best):
            continue
        t = float(motion.t[at])
        operation = int(
            trajectory.operation[np.searchsorted(trajectory.t, t - 1e-9).clip(0, len(trajectory.t) - 1)]
        )
        found.append(
            Gap(
                robot=who, around=b.name, distance_m=best, t=t, operation=operation,
                q=tuple(float(v) for v in q[at]), p_WS=tuple(float(v) for v in motion.X_WS[at, :3, 3]),
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda g: (g.distance_m, g.around)))


def _bound(a: Solid, b: Solid, motion: Motion) -> np.ndarray:
    """A lower bound on the distance by the spheres about both, shape (N,) [m]."""
    between = np.linalg.norm(a.poses(motion)[:, :3, 3] - b.poses(motion)[:, :3, 3], axis=1)
    return np.broadcast_to(between - a.radius - b.radius, motion.t.shape).copy()


def _least(
    a: Solid, b: Solid, motion: Motion, low: np.ndarray, way: np.ndarray, best: float
) -> tuple[float, int]:
    """The least distance of a pair where it is below `best`, and at which configuration.

    The configuration with the least lower bound is tried next. From a distance d there follows d less the
    way to every other configuration, so that most are never tried.
    """
    Xa, Xb = (np.broadcast_to(s.poses(motion), (len(way), 4, 4)) for s in (a, b))
    near = np.flatnonzero(low < best)
    low[near] = np.maximum(low[near], separation(Xa[near], a.half, Xb[near], b.half))
    found = 0
    while True:
        n = int(low.argmin())
        if low[n] > best - SLACK_M:
            return best, found
        distance = exact_distance(a, b, Xa[n], Xb[n])
        if distance < best:
            best, found = distance, n
        low = np.maximum(low, distance - np.abs(way - way[n]))
        low[n] = np.inf
