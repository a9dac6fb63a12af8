"""Kinematics of the cell in numpy: forward, Jacobian, and every analytic branch of the arm."""

import functools
from dataclasses import dataclass
from itertools import product

import numpy as np
from py_opw_kinematics import KinematicModel, ReachResult
from py_opw_kinematics import Robot as OpwRobot
from scipy.spatial.transform import RigidTransform

from scanmotion.cell.plant import Cell
from scanmotion.cell.robot import Robot, rotations
from scanmotion.errors import CellError


def link_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Poses in W of base and links 1..6 (frames of the URDF), shape (n, 7, 4, 4).

    Args:
        cell: the cell.
        q: shape (n, 6) or (n, 7) [rad].
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    return cell.X_WB @ arm_poses(cell.robot, q[:, :6])


def arm_poses(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Poses in the base of base and links 1..6, shape (n, 7, 4, 4), for q of shape (n, 6)."""
    R = rotations(robot.axes, q)
    out = np.zeros((len(q), 7, 4, 4))
    out[:, 0] = np.eye(4)
    joint = np.zeros((len(q), 4, 4))
    joint[:, 3, 3] = 1.0
    for i in range(6):
        joint[:, :3, :3] = R[:, i]
        out[:, i + 1] = out[:, i] @ (robot.X_PJ[i] @ joint)
    return out


def flange_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_WF for each row of q (n, 6 or 7) [rad], shape (n, 4, 4)."""
    return link_poses(cell, q)[:, 6] @ cell.robot.X_6F


def scanner_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_WS for each row of q (n, 6 or 7) [rad], shape (n, 4, 4)."""
    return flange_poses(cell, q) @ cell.X_FS


def object_poses(cell: Cell, q: np.ndarray) -> np.ndarray:
    """X_WO for each row of q (n, 7) [rad], shape (n, 4, 4); E1 turns counter-clockwise seen from above."""
    angle = np.atleast_2d(np.asarray(q, dtype=float))[:, 6]
    X = np.tile(np.eye(4), (len(angle), 1, 1))
    X[:, 0, 0] = X[:, 1, 1] = np.cos(angle)
    X[:, 1, 0] = np.sin(angle)
    X[:, 0, 1] = -X[:, 1, 0]
    return cell.X_WT @ X @ cell.X_TO


def inverse_poses(X: np.ndarray) -> np.ndarray:
    """Inverses of rigid poses, shape (..., 4, 4)."""
    R = np.swapaxes(X[..., :3, :3], -1, -2)
    out = np.zeros_like(X)
    out[..., :3, :3] = R
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R, X[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


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


@dataclass(frozen=True, eq=False, kw_only=True)
class AnalyticArm:
    """The analytic solver of an arm and how its flange is turned against the URDF's."""

    solver: OpwRobot
    X_FG: np.ndarray
    """The solver's flange frame G in the URDF's F, a rotation, shape (4, 4)."""


@functools.lru_cache(maxsize=16)
def analytic_arm(robot: Robot) -> AnalyticArm:
    """Finds the solver's parameters from the URDF's axes: offsets by quarter turns, signs by trial.

    The parameters are those of Brandstoetter, Angerer and Hofbaur (2014), "An analytical solution of the
    inverse kinematics problem of industrial serial manipulators with an ortho-parallel basis and a spherical
    wrist"; what is returned has been checked against the URDF's own kinematics.

    Raises:
        CellError: the arm is not of this kind.
    """
    q = np.random.default_rng(0).uniform(-2, 2, (6, 6))
    target = arm_poses(robot, q)[:, 6] @ robot.X_6F
    for turns in product((0, -1, 1), repeat=2):
        up = np.array([0.0, *(np.pi / 2 * t for t in turns), 0.0, 0.0, 0.0])
        lengths = _opw_lengths(robot, up)
        if lengths is None:
            continue
        for flips in product((False, True), repeat=6):
            model = KinematicModel(**lengths, offsets=tuple(up), flip_axes=flips)
            solver = OpwRobot(model, degrees=False)
            got = np.array([solver.forward(tuple(row)).as_matrix() for row in q])
            R_FG = np.swapaxes(target[:, :3, :3], 1, 2) @ got[:, :3, :3]
            off = np.abs(got[:, :3, 3] - target[:, :3, 3]).max()
            if off < 1e-6 and np.abs(R_FG - R_FG[0]).max() < 1e-6:
                X_FG = np.eye(4)
                X_FG[:3, :3] = np.round(R_FG[0], 12)
                return AnalyticArm(solver=solver, X_FG=X_FG)
    raise CellError(
        f"{robot.name}: no analytic solution: that needs a spherical wrist and parallel A2 and A3",
        key="robot.model",
    )


def _opw_lengths(robot: Robot, q_up: np.ndarray) -> dict[str, float] | None:
    """Lengths of the arm where `q_up` stretches it straight up; None where it does not."""
    frames = arm_poses(robot, q_up[None])[0]
    p2, p3, wrist = frames[2, :3, 3], frames[3, :3, 3], frames[5, :3, 3]
    flange = (frames[6] @ robot.X_6F)[:3, 3]
    straight = np.array([p3[0] - p2[0], flange[0] - wrist[0], flange[1] - wrist[1]])
    if np.abs(straight).max() > 1e-6 or p3[2] <= p2[2] or wrist[2] <= p3[2]:
        return None
    return {
        "a1": float(p2[0]), "a2": float(wrist[0] - p3[0]), "b": float(wrist[1]), "c1": float(p2[2]),
        "c2": float(p3[2] - p2[2]), "c3": float(wrist[2] - p3[2]), "c4": float(flange[2] - wrist[2]),
    }  # fmt: skip


def _solve(cell: Cell, X_WS: np.ndarray) -> ReachResult:
    """All eight branches for poses (n, 4, 4), limits aside."""
    X_WS = np.asarray(X_WS, dtype=float).reshape(-1, 4, 4)
    arm = analytic_arm(cell.robot)
    X_BG = inverse_poses(cell.X_WB) @ X_WS @ (inverse_poses(cell.X_FS) @ arm.X_FG)
    return arm.solver.reach(RigidTransform.from_matrix(X_BG), np.array([[-2 * np.pi, 2 * np.pi]] * 6))


def branches(cell: Cell, X_WS: np.ndarray, *, windings: bool = True) -> Branches:
    """Every arm configuration inside the limits that brings the scanner to each pose.

    Args:
        cell: the cell.
        X_WS: scanner poses in the world, shape (n, 4, 4).
        windings: also the solutions a whole turn of A1, A4 or A6 away, where the range allows them.
    """
    result = _solve(cell, X_WS)
    exists = np.isfinite(result.joints).all(axis=2)
    pose_index, branch = np.nonzero(exists)
    q = result.joints[pose_index, branch]
    keep, q = _within(cell.q_min[:6], cell.q_max[:6], q)
    pose_index, branch = pose_index[keep], branch[keep]
    if windings:
        for axis in range(6):
            more = [(pose_index, branch, q)]
            for turn in (-2 * np.pi, 2 * np.pi):
                turned = q.copy()
                turned[:, axis] += turn
                ok = (turned[:, axis] >= cell.q_min[axis]) & (turned[:, axis] <= cell.q_max[axis])
                more.append((pose_index[ok], branch[ok], turned[ok]))
            pose_index, branch, q = (np.concatenate(parts) for parts in zip(*more, strict=True))
        order = np.lexsort((branch, pose_index))
        pose_index, branch, q = pose_index[order], branch[order], q[order]
    return Branches(
        pose_index=pose_index, q=q, branch=branch, manipulability=result.sigma_min[pose_index, branch]
    )


def _within(low: np.ndarray, high: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brings each angle into its range by whole turns; which rows succeed, and those rows."""
    turned = q + 2 * np.pi * np.ceil((low - q) / (2 * np.pi) - 1e-12)
    closest = np.where((q >= low) & (q <= high), q, turned)
    keep = ((closest >= low - 1e-12) & (closest <= high + 1e-12)).all(axis=1)
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
