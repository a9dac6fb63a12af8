"""Answers of a closed form led onto their poses, for arms whose URDF was written with rounded angles."""

import numpy as np

from scanmotion.cell.arm.robot import Robot, arm_jacobian, arm_poses, clean_angle

_STEPS = 4
_MISSED = 1e-9
"""An answer that stays this far from its pose is none [m, rad]."""


def off_pose(robot: Robot, q: np.ndarray, X_BF: np.ndarray) -> np.ndarray:
    """By how much configurations (m, 6) miss flange poses (m, 4, 4): turn [rad] and shift [m], (m, 6)."""
    now = arm_poses(robot, q)[:, 6] @ robot.X_6F
    turn = X_BF[:, :3, :3] @ np.swapaxes(now[:, :3, :3], 1, 2)
    off = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]],
        axis=1,
    )
    return np.concatenate([off, X_BF[:, :3, 3] - now[:, :3, 3]], axis=1)


def polished(robot: Robot, joints: np.ndarray, X_BF: np.ndarray) -> np.ndarray:
    """Joints (n, slots, 6) led by Newton's steps onto the poses (n, 4, 4); NaN where that does not come off.

    Every step is damped so little that a singular arm stays where it is.
    """
    row, slot = np.nonzero(np.isfinite(joints[:, :, 0]))
    q, X = joints[row, slot], X_BF[row]
    for _ in range(_STEPS):
        error = off_pose(robot, q, X)
        J = arm_jacobian(robot, q)
        JT = np.swapaxes(J, 1, 2)
        q = q + (JT @ np.linalg.solve(J @ JT + 1e-12 * np.eye(6), error[..., None]))[..., 0]
    q[np.abs(off_pose(robot, q, X)).max(axis=1, initial=0.0) > _MISSED] = np.nan
    out = np.full_like(joints, np.nan)
    out[row, slot] = clean_angle(q)
    return out
