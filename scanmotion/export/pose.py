"""Where the flange is, from the plan's URDF, and poses in KUKA's frame notation."""

from dataclasses import dataclass

import numpy as np
from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from scanmotion.core.errors import PlanFileError


@dataclass(frozen=True, eq=False, kw_only=True)
class Arm:
    """A chain of fixed displacements and revolute joints from the base to the flange."""

    origins: tuple[np.ndarray, ...]
    """Displacement before each link of the chain, shape (4, 4) each [m]."""
    axes: tuple[np.ndarray | None, ...]
    """Unit axis of each joint of the chain, shape (3,); None for a fixed one."""
    velocity: np.ndarray
    """Greatest speed of the six joints by the URDF, shape (6,) [rad/s]."""

    def X_BF(self, q: np.ndarray) -> np.ndarray:
        """Pose of the flange in the base, shape (n, 4, 4), for q of shape (n, 6) or more [rad]."""
        X, joint = np.broadcast_to(np.eye(4), (len(q), 4, 4)), 0
        for origin, axis in zip(self.origins, self.axes, strict=True):
            X = X @ origin
            if axis is not None:
                X, joint = X @ _turns(axis, q[:, joint]), joint + 1
        return X

    def axes_at_zero(self) -> np.ndarray:
        """Axes of the joints in the base where every joint is zero, shape (6, 3)."""
        R, found = np.eye(3), []
        for origin, axis in zip(self.origins, self.axes, strict=True):
            R = R @ origin[:3, :3]
            if axis is not None:
                found.append(R @ axis)
        return np.array(found)


def arm_for_poses(text: str, joints: tuple[str, ...], flange: str) -> Arm:
    """The chain of a URDF from its root to a flange link.

    Raises:
        PlanFileError: not a URDF, or no chain of these revolute joints leads to the flange.
    """
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, DefusedXmlException, ValueError) as error:
        raise PlanFileError(f"the robot's URDF cannot be read ({type(error).__name__})") from None
    by_child = {c.get("link"): j for j in root.findall("joint") for c in j.findall("child")}
    chain, link = [], flange
    while link in by_child and len(chain) <= len(by_child):
        chain.insert(0, by_child[link])
        parent = by_child[link].find("parent")
        link = parent.get("link") if parent is not None else None
    turning = [j for j in chain if j.get("type") != "fixed"]
    if tuple(j.get("name") for j in turning) != joints or len(chain) > len(by_child):
        raise PlanFileError(f"the robot's URDF: {', '.join(joints)} are not the joints up to {flange[:60]}")
    try:
        return Arm(
            origins=tuple(_origin(j) for j in chain),
            axes=tuple(_axis(j) for j in chain),
            velocity=np.array([float(j.find("limit").get("velocity")) for j in turning]),
        )
    except (AttributeError, TypeError, ValueError):
        raise PlanFileError("the robot's URDF: a joint's origin, axis or limit is not numbers") from None


def abc_from_rotation(R: np.ndarray) -> np.ndarray:
    """KUKA's A, B, C about Z, Y', X'' of a rotation matrix, shape (3,) [rad]; C = 0 where B = +-90."""
    level = np.hypot(R[0, 0], R[1, 0])
    if level < 1e-9:
        return np.array([np.arctan2(-R[0, 1], R[1, 1]), np.arctan2(-R[2, 0], level), 0.0])
    return np.array([np.arctan2(R[1, 0], R[0, 0]), np.arctan2(-R[2, 0], level), np.arctan2(R[2, 1], R[2, 2])])


def _origin(joint) -> np.ndarray:
    X, origin = np.eye(4), joint.find("origin")
    if origin is not None:
        X[:3, 3] = _three(origin.get("xyz", "0 0 0"))
        r, p, y = _three(origin.get("rpy", "0 0 0"))
        X = X @ _turn((0, 0, 1), y) @ _turn((0, 1, 0), p) @ _turn((1, 0, 0), r)
    return X


def _axis(joint) -> np.ndarray | None:
    if joint.get("type") == "fixed":
        return None
    if joint.get("type") not in ("revolute", "continuous"):
        raise ValueError
    axis = joint.find("axis")
    v = _three(axis.get("xyz")) if axis is not None else np.array([1.0, 0, 0])
    if np.linalg.norm(v) < 1e-9:
        raise ValueError
    return v / np.linalg.norm(v)


def _three(text: str) -> np.ndarray:
    v = np.array([float(x) for x in text.split()])
    if v.shape != (3,) or not np.isfinite(v).all():
        raise ValueError
    return v


def _turn(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    return _turns(np.array(axis, dtype=float), np.array([angle]))[0]


def _turns(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations by Rodrigues' formula, shape (n, 4, 4)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    X = np.tile(np.eye(4), (len(angles), 1, 1))
    X[:, :3, :3] += np.sin(angles)[:, None, None] * K + (1 - np.cos(angles))[:, None, None] * (K @ K)
    return X
