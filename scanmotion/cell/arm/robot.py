"""What an arm is: six turning axes, limits, and the solids that move with its links."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scanmotion.geometry.chain import chain_jacobian, chain_poses
from scanmotion.geometry.se3 import clean_angle as clean_angle
from scanmotion.geometry.se3 import inverse_poses as inverse_poses
from scanmotion.geometry.se3 import rotations as rotations


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """A solid fixed to a link: a box, a cylinder about its z axis, a sphere, or a convex hull."""

    name: str
    link: int
    """0 for the base, 1..6 for the links, 7 for the tool (moves with link 6), 8 the table, 9 the world."""
    shape: str
    """"box", "cylinder", "sphere" or "hull"."""
    size: tuple[float, ...]
    """Full sides (x, y, z), those of its bounding box for a hull; (radius, length); or (radius,) [m]."""
    X_LG: np.ndarray
    """Pose of the solid in the link's frame, shape (4, 4)."""
    carrier: str = ""
    """Link of the URDF that has the solid; empty for the cell's own."""
    side: bool = False
    """Whether the carrier hangs by a side branch: before the base, on any link, past the flange."""
    points: np.ndarray | None = None
    """Corners of a hull in its own frame, shape (n, 3) [m]."""
    mesh: str = ""
    """Mesh of the cell that it is a piece of."""


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
    joined: frozenset[frozenset[str]]
    """Links of the URDF that one of the six joints joins directly."""
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


def arm_poses(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Poses in the base of base and links 1..6, shape (n, 7, 4, 4), for q of shape (n, 6)."""
    return chain_poses(robot.X_PJ, robot.axes, q)


def arm_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Angular (rows 0..2) and linear velocity of the flange in the base per joint speed, shape (n, 6, 6)."""
    return chain_jacobian(robot.X_PJ, robot.axes, robot.X_6F, q)


def least_singular(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Least singular value of the flange's Jacobian (m and rad mixed) at each row of q (m, 6), shape (m,)."""
    J = arm_jacobian(robot, q)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(J @ np.swapaxes(J, 1, 2))[:, 0], 0.0))
