"""What an arm is: six turning axes, limits, and the solids that move with its links."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """A solid fixed to a link: a box, a cylinder about its z axis, or a convex hull."""

    name: str
    link: int
    """0 for the base, 1..6 for the links, 7 for the tool (moves with link 6), 8 the table, 9 the world."""
    shape: str
    """"box", "cylinder" or "hull"."""
    size: tuple[float, ...]
    """Full sides (x, y, z), those of its bounding box for a hull; or (radius, length) [m]."""
    X_LG: np.ndarray
    """Pose of the solid in the link's frame, shape (4, 4)."""
    carrier: str = ""
    """Link of the URDF that has the solid; empty for the cell's own."""
    side: bool = False
    """Whether the carrier hangs by a side branch: before the base, on any link, past the flange."""
    points: np.ndarray | None = None
    """Corners of a hull in its own frame, shape (n, 3) [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Robot:
    """Kinematics, limits and collision bodies of a six-axis arm."""

    name: str
    urdf: Path
    X_PJ: np.ndarray
    """Pose of each joint's frame in its parent at zero, shape (6, 4, 4)."""
    axes: np.ndarray
    """Unit axis of each joint in its own frame, shape (6, 3)."""
    X_6F: np.ndarray
    """Flange in link 6, shape (4, 4)."""
    lower: np.ndarray
    """Shape (6,) [rad]."""
    upper: np.ndarray
    velocity: np.ndarray
    """Shape (6,) [rad/s]."""
    bodies: tuple[Body, ...]
    joints: tuple[str, ...]
    """The six joints, as the plant calls them: a name of our own gets another."""
    flange: str
    """The flange's link, likewise."""
    text: str
    """The URDF as Drake reads it; its meshes are `pieces`."""
    pieces: Mapping[str, bytes]
    """OBJ files of the convex pieces of its meshes."""
    record: bytes
    """The URDF for a plan's folder; its meshes are `meshes`."""
    meshes: Mapping[str, bytes]
    """The collision meshes as they were, by plain names."""
    notes: tuple[str, ...] = field(default=())
    """What was repaired or left out when it was read."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved:
    """What a solver of the inverse kinematics finds for a batch of flange poses, limits aside."""

    joints: np.ndarray
    """Shape (n, slots, 6) [rad]; a row of NaN where a branch does not exist."""
    sigma_min: np.ndarray
    """Least singular value of the flange's Jacobian (m and rad mixed), shape (n, slots)."""
    extension: np.ndarray
    """How far inside the arm's reach each wrist is, shape (n,) [m]; negative outside."""


def rotations(axes: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations by `angles` (n, k) about unit `axes` (k, 3) (Rodrigues), shape (n, k, 3, 3)."""
    K = np.zeros((len(axes), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axes[:, 2], axes[:, 1], -axes[:, 0]
    K = K - K.transpose(0, 2, 1)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


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


def arm_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Angular (rows 0..2) and linear velocity of the flange in the base per joint speed, shape (n, 6, 6)."""
    frames = arm_poses(robot, q)
    axes = np.einsum("nkij,kj->nki", frames[:, 1:, :3, :3], robot.axes)
    tip = (frames[:, 6] @ robot.X_6F)[:, None, :3, 3]
    J = np.concatenate([axes, np.cross(axes, tip - frames[:, 1:, :3, 3])], axis=2)
    return np.swapaxes(J, 1, 2)


def least_singular(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Least singular value of the flange's Jacobian (m and rad mixed) at each row of q (m, 6), shape (m,)."""
    J = arm_jacobian(robot, q)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(J @ np.swapaxes(J, 1, 2))[:, 0], 0.0))


def inverse_poses(X: np.ndarray) -> np.ndarray:
    """Inverses of rigid poses, shape (..., 4, 4)."""
    R = np.swapaxes(X[..., :3, :3], -1, -2)
    out = np.zeros_like(X)
    out[..., :3, :3] = R
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R, X[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def clean_angle(q: np.ndarray) -> np.ndarray:
    """Angles brought into (-pi, pi]."""
    return math.pi - np.mod(math.pi - q, 2 * math.pi)
