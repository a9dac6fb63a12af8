"""Kinematics of the cell in numpy: forward, Jacobian, and every analytic branch of the arm."""

from dataclasses import dataclass

import numpy as np

from scanmotion.cell.arm.robot import arm_poses
from scanmotion.cell.ik.choice import Solved, solver_of
from scanmotion.cell.model import Cell
from scanmotion.geometry.se3 import inverse_poses, turns_about_z


def link_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Poses in W of base and links 1..6 (frames of the URDF), shape (n, 7, 4, 4).

    Args:
        cell: the cell.
        q: shape (n, 6) or (n, 7) [rad].
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    return cell.X_WB @ arm_poses(cell.robot, q[:, :6])


def flange_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_WF for each row of q (n, 6 or 7) [rad], shape (n, 4, 4)."""
    return link_poses(cell, q)[:, 6] @ cell.robot.X_6F


def scanner_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_WS for each row of q (n, 6 or 7) [rad], shape (n, 4, 4)."""
    return flange_poses(cell, q) @ cell.X_FS


def object_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_WO for each row of q (n, 7) [rad], shape (n, 4, 4); E1 turns counter-clockwise seen from above."""
    angle = np.atleast_2d(np.asarray(q, dtype=float))[:, 6]
    return cell.X_WT @ turns_about_z(angle) @ cell.X_TO


def scanner_in_object(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_OS for each row of q (n, 7) [rad], shape (n, 4, 4)."""
    return inverse_poses(object_poses(cell, q)) @ scanner_poses(cell, q)


def tcp_jacobian(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Angular (rows 0..2) and linear (rows 3..5) velocity of S in W per joint speed, shape (n, 6, 7).

    The last column, the table's, is zero.
    """
    links = link_poses(cell, q)
    p_WS = (links[:, 6] @ cell.robot.X_6F @ cell.X_FS)[:, :3, 3]
    J = np.zeros((len(links), 6, 7))
    for i in range(6):
        axis = links[:, i + 1, :3, :3] @ cell.robot.axes[i]
        J[:, :3, i] = axis
        J[:, 3:, i] = np.cross(axis, p_WS - links[:, i + 1, :3, 3])
    return J


@dataclass(frozen=True, eq=False, kw_only=True)
class Branches:
    """Every configuration of the arm for a batch of poses."""

    pose_index: np.ndarray
    """Which pose each row serves, shape (m,)."""
    q: np.ndarray
    """A1..A6, inside the limits, shape (m, 6) [rad]."""
    branch: np.ndarray
    """Slot 0..7 of the analytic solution, shape (m,)."""
    manipulability: np.ndarray
    """Least singular value of the flange's Jacobian (m and rad mixed), shape (m,); 0 at a singularity."""


def _solve(cell: Cell, X_WS: np.ndarray) -> Solved:
    """All branches for poses (n, 4, 4), limits aside."""
    X_WS = np.asarray(X_WS, dtype=float).reshape(-1, 4, 4)
    X_BF = inverse_poses(cell.X_WB) @ X_WS @ inverse_poses(cell.X_FS)
    return solver_of(cell.robot)(X_BF)


def branches(cell: Cell, X_WS: np.ndarray, *, windings: bool = True) -> Branches:
    """Every arm configuration inside the limits that brings the scanner to each pose.

    Args:
        cell: the cell.
        X_WS: scanner poses in the world, shape (n, 4, 4).
        windings: also the solutions whole turns of the joints away, where the ranges allow them.
    """
    result = _solve(cell, X_WS)
    exists = np.isfinite(result.joints).all(axis=2)
    pose_index, branch = np.nonzero(exists)
    q = result.joints[pose_index, branch]
    keep, q = _within(cell.q_min[:6], cell.q_max[:6], q)
    pose_index, branch = pose_index[keep], branch[keep]
    if windings:
        most = np.floor((cell.q_max - cell.q_min)[:6] / (2 * np.pi) + 1e-9).astype(int)
        for axis in np.flatnonzero(most):
            more = [(pose_index, branch, q)]
            for turn in (k for k in range(-most[axis], most[axis] + 1) if k):
                turned = q.copy()
                turned[:, axis] += turn * 2 * np.pi
                ok = (turned[:, axis] >= cell.q_min[axis]) & (turned[:, axis] <= cell.q_max[axis])
                more.append((pose_index[ok], branch[ok], turned[ok]))
            pose_index, branch, q = (np.concatenate(parts) for parts in zip(*more, strict=True))
        order = np.lexsort((branch, pose_index))
        pose_index, branch, q = pose_index[order], branch[order], q[order]
    sigma = result.sigma_min[pose_index, branch]
    return Branches(pose_index=pose_index, q=q, branch=branch % 8, manipulability=sigma)


def _within(low: np.ndarray, high: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brings each angle into its range by whole turns; which rows succeed, and those rows."""
    turned = q + 2 * np.pi * np.ceil((low - q) / (2 * np.pi) - 1e-12)
    closest = np.where((q >= low) & (q <= high), q, turned)
    keep = np.all((closest >= low - 1e-12) & (closest <= high + 1e-12), axis=1)
    return keep, np.clip(closest[keep], low, high)


def wrist_shortfall(cell: Cell, X_WS: np.ndarray) -> np.ndarray:
    """How far the wrist centre of each pose lies outside the shoulder's reach, (n,) [m]; <= 0 inside."""
    return -_solve(cell, X_WS).extension


def joint_excess(cell: Cell, X_WS: np.ndarray) -> tuple[int, float, int]:
    """The least violation of the limits over all poses and branches.

    Returns:
        the joint's index, by how much it passes its limit [rad], and the index of the pose.
    """
    q = _solve(cell, X_WS).joints
    pose_index, branch = np.nonzero(np.isfinite(q).all(axis=2))
    if len(pose_index) == 0:
        return 0, np.inf, 0
    q = q[pose_index, branch]
    wrapped = np.stack([q - 2 * np.pi, q, q + 2 * np.pi])
    excess = np.maximum(np.maximum(cell.q_min[:6] - wrapped, wrapped - cell.q_max[:6]), 0.0).min(axis=0)
    best = int(np.argmin(excess.max(axis=1)))
    joint = int(np.argmax(excess[best]))
    return joint, float(excess[best, joint]), int(pose_index[best])
