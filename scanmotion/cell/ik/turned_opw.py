"""The closed form for any arm with a spherical wrist and parallel A2 and A3, from its axes alone.

Signs of the joints, their zeros, and the turn of base and flange follow from the axes: A3 may turn against A2
(Fanuc, Motoman), the forearm may lie at zero, the base's x may point anywhere. Guarantees: what is returned
brings the flange to the pose by the arm's own kinematics, within 1e-9; no branch of the arm is left out.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.cell.arm.robot import Robot, Solved, arm_poses, clean_angle, inverse_poses
from scanmotion.cell.ik.opw import OpwArm, opw_poses, opw_solver
from scanmotion.cell.ik.polish import polished
from scanmotion.core.support.streams import fixed_stream

_SQUARE = 1e-4
"""Axes this near to right angles, and this near to one another [rad, m], are taken for so; see `polished`."""
_EXACT = 1e-10


@dataclass(frozen=True, eq=False, kw_only=True)
class TurnedArm:
    """An arm in canonical form: q = up + sign * theta, canonical base A, canonical flange G."""

    robot: Robot
    inner: OpwArm
    X_AB: np.ndarray
    X_FG: np.ndarray
    up: np.ndarray
    """Where the arm is stretched straight up, shape (6,) [rad]."""
    sign: np.ndarray
    """Shape (6,), 1 or -1."""
    rough: bool
    """Whether the axes are square only nearly, so that answers are led onto the pose by Newton's steps."""

    def __call__(self, X_BF: np.ndarray) -> Solved:
        """All branches of flange poses in the base, shape (n, 4, 4), in the slots of `OpwArm`."""
        found = self.inner(self.X_AB @ X_BF @ self.X_FG)
        joints = clean_angle(self.up + self.sign * found.joints)
        if self.rough:
            joints = polished(self.robot, joints, X_BF)
        return Solved(joints=joints, sigma_min=found.sigma_min, extension=found.extension)


def turned_arm(robot: Robot) -> TurnedArm | None:
    """The solver by the arm's axes; None where A2 and A3 are not parallel, or the wrist is not spherical."""
    up, sign = np.zeros(6), np.ones(6)
    w, p = _axes(robot, up)
    z, y = w[0], w[1]
    if abs(z @ y) > _SQUARE or abs(abs(w[1] @ w[2]) - 1) > _SQUARE:
        return None
    y = y - (y @ z) * z
    y /= np.linalg.norm(y)
    R_BA = np.column_stack([np.cross(y, z), y, z])
    sign[2] = np.sign(w[2] @ y)
    arm = (p[2] - p[1]) @ R_BA
    up[1] = -np.arctan2(arm[0], arm[2])
    if not _fore(robot, R_BA, up, sign):
        return None
    w, p = _axes(robot, up)
    flange = (arm_poses(robot, up[None])[0, 6] @ robot.X_6F)[:3, 3]
    wrist = _meeting(w[3:], p[3:])
    square = np.abs(np.array([w[3] @ y, w[4] @ R_BA[:, 0], w[4] @ z, w[5] @ y]))
    if wrist is None or square.max() > _SQUARE:
        return None
    p1, p2, p3, c, f = ((v - p[0]) @ R_BA for v in (p[0], p[1], p[2], wrist, flange))
    on_axis = np.abs(f[:2] - c[:2]).max() < 1e-9
    lengths = {
        "a1": float(p2[0]), "a2": float(c[0] - p3[0]), "b": float(c[1]), "c1": float(p2[2] - p1[2]),
        "c2": float(p3[2] - p2[2]), "c3": float(c[2] - p3[2]), "c4": float(f[2] - c[2]) if on_axis else 0.0,
    }  # fmt: skip
    if min(lengths["c2"], np.hypot(lengths["c3"], lengths["a2"])) < 1e-3:
        return None
    return _checked(robot, lengths, R_BA, p[0], up, sign)


def _fore(robot: Robot, R_BA: np.ndarray, up: np.ndarray, sign: np.ndarray) -> bool:
    """Turns forearm, hand and flange straight up in place; whether the axes allow it."""
    w, p = _axes(robot, up)
    wrist = _meeting(w[3:], p[3:])
    if wrist is None:
        return False
    sign[3] = -1.0 if (wrist - p[2]) @ w[3] < 0 else 1.0
    along = sign[3] * w[3] @ R_BA
    up[2] = -sign[2] * np.arctan2(along[0], along[2])
    w, p = _axes(robot, up)
    hand = w[4] @ R_BA
    up[3] = -sign[3] * np.arctan2(-hand[0], hand[1])
    w, p = _axes(robot, up)
    flange = (arm_poses(robot, up[None])[0, 6] @ robot.X_6F)[:3, 3]
    wrist = _meeting(w[3:], p[3:])
    if wrist is None:
        return False
    sign[5] = -1.0 if (flange - wrist) @ w[5] < 0 else 1.0
    tip = sign[5] * w[5] @ R_BA
    up[4] = -np.arctan2(tip[0], tip[2])
    return True


def _axes(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the six axes and points on them in the base, each (6, 3)."""
    frames = arm_poses(robot, q[None])[0, 1:]
    return np.einsum("kij,kj->ki", frames[:, :3, :3], robot.axes), frames[:, :3, 3]


def _meeting(w: np.ndarray, p: np.ndarray) -> np.ndarray | None:
    """The point where three axes meet, or None."""
    across = np.eye(3) - w[:, :, None] * w[:, None, :]
    point = np.linalg.lstsq(across.sum(axis=0), np.einsum("kij,kj->i", across, p), rcond=None)[0]
    return point if np.abs(np.einsum("kij,kj->ki", across, point - p)).max() < _SQUARE else None


def _checked(
    robot: Robot,
    lengths: dict[str, float],
    R_BA: np.ndarray,
    origin: np.ndarray,
    up: np.ndarray,
    sign: np.ndarray,
) -> TurnedArm | None:
    """The solver, where its kinematics are the arm's."""
    solver = opw_solver(lengths, np.zeros(6), (False,) * 6)
    X_BA = np.eye(4)
    X_BA[:3, :3], X_BA[:3, 3] = R_BA, origin
    X_AB = inverse_poses(X_BA)
    zero = opw_poses(solver, np.zeros((1, 6)))[0]
    X_FG = inverse_poses(X_AB @ arm_poses(robot, up[None])[0, 6] @ robot.X_6F) @ zero
    theta = fixed_stream("turned_opw_check").uniform(-2, 2, (6, 6))
    got = opw_poses(solver, theta)
    true = X_AB @ arm_poses(robot, up + sign * theta)[:, 6] @ robot.X_6F @ X_FG
    off = float(np.abs(got - true).max())
    if off > 100 * _SQUARE:
        return None
    inner = OpwArm(solver=solver, lengths=lengths, X_FG=np.eye(4))
    return TurnedArm(robot=robot, inner=inner, X_AB=X_AB, X_FG=X_FG, up=up, sign=sign, rough=off > _EXACT)
