"""Collisions and clearances of the written trajectory, between its samples too.

Numpy's bounds come first: spheres, then the separating axes of boxes, for all configurations of a pair at
once. Only what they leave open goes to FCL, and from each distance that it finds there follows how far
everything may move until the pair has to be looked at again.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import fcl
import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Trajectory
from scanmotion.judge.motion import Motion, UrdfArm, motion_at
from scanmotion.judge.solids import PART, STILL, Solid, meeting_solids, pairs_of, solids_of
from scanmotion.plan_io.schema import PlanRecord

STEP_M = 0.004
"""Between two checked configurations no two points of robot and part move farther relative to one another."""
TOLERANCE_M = 1e-3
_STEP_RAD = 0.02
"""Joints turn at most this far between two poses by which motion is measured: chords are then arcs."""
_MOST_PARTS = 500
"""A single step between two samples is cut into no more: 10 rad at once."""
_MOST_POSES = 4_000_000
"""A file of nothing but jumps is cut into no more; it breaks every limit of speed anyway."""
_BLOCK = 20_000

Worst = dict[tuple[str, str], tuple[float, float]]
"""Least distance of a pair and its time, where it is below what is asked for."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Block:
    """Consecutive configurations at most STEP_M apart."""

    t: np.ndarray
    """Shape (n,) [s]."""
    q: np.ndarray
    """Shape (n, 7) [rad]."""
    way: np.ndarray
    """How far anything can have moved relative to anything else since the first, shape (n,) [m]."""


def check_clearance(
    folder: Path,
    record: PlanRecord,
    trajectory: Trajectory,
    arm: UrdfArm,
    *,
    progress: Callable[[float], None] | None = None,
) -> list[Finding]:
    """Arm and tool against part, table, surroundings and themselves.

    Joints are taken to move linearly between the samples. Configurations are checked STEP_M apart, so what is
    found holds up to half of that at every instant in between.

    Raises:
        PlanFileError: the part cannot be read.
    """
    solids = solids_of(folder, record, arm)
    meeting = meeting_solids(solids, record, arm)
    pairs = pairs_of(solids, record.process.clearance_m, arm.joined, meeting)
    worst: Worst = {}
    for block in blocks(record, trajectory, arm, solids):
        motion = motion_at(arm, record, block.t, block.q)
        poses = {id(s): s.poses(motion) for s in solids}
        for a, b, allowed in pairs:
            _judge_pair(a, b, poses[id(a)], poses[id(b)], allowed, block, worst)
        if progress is not None:
            progress(float(block.t[-1] / trajectory.t[-1]))
    return _findings(worst, record.process.clearance_m)


def blocks(record: PlanRecord, trajectory: Trajectory, arm: UrdfArm, solids: list[Solid]) -> Iterator[Block]:
    """Cuts the trajectory into stretches, resampled so that nothing moves farther than STEP_M in a step."""
    t, q = trajectory.t, trajectory.q
    parts = np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1) / _STEP_RAD).clip(1, _MOST_PARTS)
    if parts.sum() > _MOST_POSES:
        parts = parts.clip(1, max(_MOST_POSES // len(parts), 1))
    count = np.concatenate([[0], np.cumsum(parts)])
    fine = np.interp(np.arange(int(count[-1]) + 1), count, t)
    for first in range(0, len(fine) - 1, _BLOCK):
        t_fine = fine[first : first + _BLOCK + 1]
        way = way_of(motion_at(arm, record, t_fine, _between(t_fine, t, q)), solids)
        steps = max(int(np.ceil(way[-1] / STEP_M)), 1)
        marks = np.linspace(0.0, way[-1], steps + 1)
        at = np.interp(marks, way, t_fine)
        at[0], at[-1] = t_fine[0], t_fine[-1]
        for start in range(0, steps, _BLOCK):
            own = slice(start, start + _BLOCK + 1)
            yield Block(t=at[own], q=_between(at[own], t, q), way=marks[own])


def _between(at: np.ndarray, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(at, t, q[:, j]) for j in range(q.shape[1])])


def way_of(motion: Motion, solids: list[Solid]) -> np.ndarray:
    """Length of the way of the robot's fastest point plus that of the part's, from the first pose on."""
    robot, part = np.zeros(len(motion.t) - 1), np.zeros(len(motion.t) - 1)
    for s in solids:
        if s.group == STILL:
            continue
        X = s.poses(motion)
        shift = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1)
        turn = np.sqrt((np.diff(X[:, :3, :3], axis=0) ** 2).sum(axis=(1, 2)) / 2)
        moved = 1.001 * (shift + turn * s.radius)
        if s.group == PART:
            part = moved
        else:
            robot = np.maximum(robot, moved)
    return np.concatenate([[0.0], np.cumsum(robot + part)])


def separation(Xa: np.ndarray, half_a: np.ndarray, Xb: np.ndarray, half_b: np.ndarray) -> np.ndarray:
    """Lower bound on the distance of two boxes: the widest gap along their 15 axes, negative on overlap.

    Args:
        Xa, Xb: poses, shape (n, 4, 4).
        half_a, half_b: half sides, shape (3,) [m].

    Returns:
        shape (n,) [m]. Source: Gottschalk, Lin and Manocha 1996.
    """
    R = np.swapaxes(Xa[:, :3, :3], 1, 2) @ Xb[:, :3, :3]
    t = np.einsum("nji,nj->ni", Xa[:, :3, :3], Xb[:, :3, 3] - Xa[:, :3, 3])
    size = np.abs(R)
    gap = (np.abs(t) - half_a - size @ half_b).max(axis=1)
    along_b = np.abs(np.einsum("nij,ni->nj", R, t))
    gap = np.maximum(gap, (along_b - half_b - np.einsum("nij,i->nj", size, half_a)).max(axis=1))
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            # e_i x b_j has the components -R[i2, j] along i1 and R[i1, j] along i2.
            length = np.sqrt(np.maximum(1 - R[:, i, j] ** 2, 0.0))
            apart = np.abs(t[:, i2] * R[:, i1, j] - t[:, i1] * R[:, i2, j])
            apart -= half_a[i1] * size[:, i2, j] + half_a[i2] * size[:, i1, j]
            apart -= half_b[j1] * size[:, i, j2] + half_b[j2] * size[:, i, j1]
            gap = np.where(length > 1e-3, np.maximum(gap, apart / np.maximum(length, 1e-3)), gap)
    return gap


def _judge_pair(
    a: Solid, b: Solid, Xa: np.ndarray, Xb: np.ndarray, allowed: float, block: Block, worst: Worst
) -> None:
    """Notes the least distance of a pair in a block where it is less than allowed."""
    between = np.linalg.norm(Xa[:, :3, 3] - Xb[:, :3, 3], axis=1)
    near = np.flatnonzero(between < a.radius + b.radius + allowed)
    if len(near) == 0:
        return
    Xa, Xb = (np.broadcast_to(X, (len(block.t), 4, 4))[near] for X in (Xa, Xb))
    unsure = separation(Xa, a.half, Xb, b.half) < allowed + 1e-9
    near, Xa, Xb = near[unsure], Xa[unsure], Xb[unsure]
    way = block.way[near]
    n = 0
    while n < len(near):
        distance = exact_distance(a, b, Xa[n], Xb[n], needed=allowed > 0)
        if distance < allowed and distance < worst.get((a.name, b.name), (np.inf, 0.0))[0]:
            worst[a.name, b.name] = distance, float(block.t[near[n]])
        # The pair cannot come below what is allowed before it has moved by what it has to spare.
        spare = max(distance - allowed - 1e-6, 0.0)
        n = max(n + 1, int(np.searchsorted(way, way[n] + spare)))


def exact_distance(a: Solid, b: Solid, Xa: np.ndarray, Xb: np.ndarray, *, needed: bool = True) -> float:
    """FCL's distance [m]; -1e-6 where the two touch; 0 where they do not and the distance is not needed."""
    a.shape.setTransform(fcl.Transform(Xa[:3, :3], Xa[:3, 3]))
    b.shape.setTransform(fcl.Transform(Xb[:3, :3], Xb[:3, 3]))
    if fcl.collide(a.shape, b.shape, fcl.CollisionRequest(), fcl.CollisionResult()):
        return -1e-6
    if not needed:
        return 0.0
    return float(fcl.distance(a.shape, b.shape, fcl.DistanceRequest(), fcl.DistanceResult()))


def _findings(worst: Worst, clearance: float) -> list[Finding]:
    findings = []
    for (a, b), (distance, t) in sorted(worst.items(), key=lambda item: item[1][0]):
        if distance <= 0:
            text, code = f"{a} and {b} touch at {t:.2f} s", "collision"
        elif distance < clearance - TOLERANCE_M:
            code = "clearance"
            text = (
                f"{a} and {b} come within {distance * 1e3:.1f} mm at {t:.2f} s, "
                f"{clearance * 1e3:.0f} mm are asked for"
            )
        else:
            continue
        findings.append(
            Finding(code=code, message=text, where=f"{a}, {b}", value=distance, limit=clearance, t=t)
        )
    return findings
