"""How much a written plan has to spare: least distances, joints, singularities, greatest speeds.

By the judge's own kinematics and solids, from the files alone. Distances are exact (FCL) at configurations at
most `STEP_M` of way apart, so that between them a least distance can be smaller by half of that. Joints,
singularities and speeds are those of the written samples; speeds are central differences.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from scanmotion.core.summary import Extreme, FastestSummary, JointMargin, Margin, MarginsSummary
from scanmotion.judge.contact import Block, blocks, exact_distance, separation
from scanmotion.judge.motion import Motion, UrdfArm, arm_of, motion_at
from scanmotion.judge.solids import PART, Solid, pairs_of, solids_of
from scanmotion.plan_io.read import read_plan, read_trajectory
from scanmotion.plan_io.schema import PlanRecord

_ELBOW = 2
"""Joint on whose axis the elbow lies, at the foot of the perpendicular from the base."""


def margins_of(folder: str | Path, *, progress: Callable[[float], None] | None = None) -> MarginsSummary:
    """The margins of a plan's folder.

    Args:
        folder: what `scanmotion plan` wrote.
        progress: told the share done.

    Raises:
        PlanFileError: the files cannot be read.
    """
    folder = Path(folder)
    record = read_plan(folder)
    trajectory = read_trajectory(folder, record)
    arm = arm_of(folder, record)
    solids = solids_of(folder, record, arm)
    pairs = [p[:2] for p in pairs_of(solids, 1.0, arm.joined, {}) if p[2] > 0.0]
    least: dict[bool, Margin] = {}
    for block in blocks(record, trajectory, arm, solids):
        motion = motion_at(arm, record, block.t, block.q)
        for a, b in pairs:
            to_part = PART in (a.group, b.group)
            found = _nearest(a, b, motion, block, least.get(to_part))
            if found is not None:
                least[to_part] = found
        if progress is not None:
            progress(float(block.t[-1] / trajectory.t[-1]))
    motion = motion_at(arm, record, trajectory.t, trajectory.q)
    return MarginsSummary(
        to_object=least.get(True), to_surroundings=least.get(False),
        joint_limit=_joint_limit(arm, record, trajectory.t, trajectory.q),
        singularity=_singularity(motion), fastest=_fastest(motion),
    )  # fmt: skip


def _nearest(a: Solid, b: Solid, motion: Motion, block: Block, known: Margin | None) -> Margin | None:
    """The least distance of a pair in a block, where it is below the one that is known."""
    best = np.inf if known is None else known.mm * 1e-3
    Xa, Xb = (np.broadcast_to(s.poses(motion), (len(block.t), 4, 4)) for s in (a, b))
    bound = separation(Xa, a.half, Xb, b.half)
    at = int(np.argmin(bound))
    if bound[at] >= best:
        return None
    # From the likeliest configuration on: what is found there spares most of the others.
    least, when = exact_distance(a, b, Xa[at], Xb[at]), at
    near = np.flatnonzero(bound < min(best, least))
    n = 0
    while n < len(near):
        d = exact_distance(a, b, Xa[near[n]], Xb[near[n]])
        if d < least:
            least, when = d, int(near[n])
        # No pair comes nearer than the least one before it has moved by the difference.
        way = block.way[near]
        n = max(n + 1, int(np.searchsorted(way, way[n] + max(d - min(best, least), 0.0))))
    if least >= best:
        return None
    return Margin(mm=round(1e3 * least, 3), a=a.name, b=b.name, t_s=round(float(block.t[when]), 3))


def _joint_limit(arm: UrdfArm, record: PlanRecord, t: np.ndarray, q: np.ndarray) -> JointMargin | None:
    """The joint of the arm that comes nearest to an end of its range; None where all turn for ever."""
    spare = np.minimum(q[:, :6] - arm.lower, arm.upper - q[:, :6])
    n, j = np.unravel_index(int(np.argmin(spare)), spare.shape)
    if not np.isfinite(spare[n, j]):
        return None
    deg = float(np.rad2deg(spare[n, j]))
    return JointMargin(joint=record.robot_joints[j], deg=round(deg, 3), t_s=round(float(t[n]), 3))


def jacobians(motion: Motion) -> np.ndarray:
    """Of the flange's origin, angular rows first, in W, shape (N, 6, 6)."""
    columns = []
    for i, screw in enumerate(motion.arm.screws):
        X = motion.X_WL[:, i]
        w = X[:, :3, :3] @ screw[:3]
        p = X[:, :3, :3] @ np.cross(screw[:3], screw[3:]) + X[:, :3, 3]
        columns.append(np.concatenate([w, np.cross(w, motion.X_WF[:, :3, 3] - p)], axis=1))
    return np.stack(columns, axis=2)


def _singularity(motion: Motion) -> Extreme:
    """Least singular value of the flange's Jacobian, a metre weighed as a radian."""
    values = np.linalg.svd(jacobians(motion), compute_uv=False)[:, -1]
    n = int(np.argmin(values))
    return Extreme(value=round(float(values[n]), 6), t_s=round(float(motion.t[n]), 3))


def _fastest(motion: Motion) -> FastestSummary:
    """Greatest speeds in W of the flange's origin, the elbow and the optical centre."""
    screw = motion.arm.screws[_ELBOW]
    foot = np.append(np.cross(screw[:3], screw[3:]), 1.0)
    points = {
        "flange": motion.X_WF[:, :3, 3],
        "elbow": (motion.X_WL[:, _ELBOW] @ foot)[:, :3],
        "scanner": motion.X_WS[:, :3, 3],
    }
    told = {}
    for name, p in points.items():
        speed = np.linalg.norm(np.gradient(p, motion.t, axis=0), axis=1)
        n = int(np.argmax(speed))
        told[name] = Extreme(value=round(float(speed[n]), 5), t_s=round(float(motion.t[n]), 3))
    return FastestSummary(**told)
