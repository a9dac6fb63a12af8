"""How a part can stand: its stable resting poses, by trimesh, with what a conservator asks of them.

Guarantees: in each pose the centre of mass stands inside the support polygon; the tip angle is exact for a
rigid part of even density. Assumes even density where the mesh is closed; where it is open the centre of the
surface stands in, and `even` says so.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part

_CONTACT_M = 5e-4
"""Points this near to the table carry the part [m]."""
_SAME_RAD = np.deg2rad(5.0)
"""Two poses whose upward directions differ by less are one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RestingPose:
    """One way in which a part rests on the table."""

    name: str
    """Which side of the part is up, e.g. "+z up" or "tilted, 0.12 0.70 0.70 up"."""
    R_OP: np.ndarray
    """Rotation that brings the part as it is given to this pose, shape (3, 3)."""
    tip_rad: float
    """By how much it may be tilted about the nearest edge of its support before it falls [rad]."""
    com_m: np.ndarray
    """Centre of mass in this pose, with the part's box centred over the table's axis, shape (3,) [m]."""
    support_m: np.ndarray
    """Corners of the support polygon in the same frame, counter-clockwise, shape (k, 2) [m]."""
    even: bool
    """Whether the centre of mass is that of a closed solid of even density."""

    @property
    def up(self) -> np.ndarray:
        """Direction of the part as it is given that points up in this pose, shape (3,)."""
        return self.R_OP[2]

    def margin(self, acceleration: float) -> float:
        """How many times an angular acceleration of the table [rad/s2] the part bears before it tips.

        The centre of mass at radius r is pushed by r times the acceleration; it tips where that exceeds the
        gravity that holds it, g tan(tip).
        """
        push = acceleration * float(np.linalg.norm(self.com_m[:2]))
        return float("inf") if push <= 0 else float(9.80665 * np.tan(self.tip_rad) / push)


def resting_poses(part: Part, *, least_tip_rad: float = np.deg2rad(5.0)) -> tuple[RestingPose, ...]:
    """Stable poses of a mesh, the steadiest first; the pose in which it is given comes first where it is one.

    Args:
        part: a mesh.
        least_tip_rad: poses that tip at less are left out [rad].

    Raises:
        PartError: a cloud, or a mesh without a hull.
    """
    if not part.is_mesh:
        raise PartError(f"{part.name}: only a mesh has resting poses")
    mesh = trimesh.Trimesh(part.vertices, part.triangles, process=False)
    even = bool(part.closed and mesh.volume > 0)
    com = np.asarray(mesh.center_mass if even else mesh.centroid, dtype=float)
    try:
        hull = mesh.convex_hull
        found, _ = trimesh.poses.compute_stable_poses(hull, center_mass=com, sigma=0.0, threshold=0.0)
    except (QhullError, ValueError) as error:
        raise PartError(f"{part.name}: has no convex hull to rest on ({type(error).__name__})") from None
    rotations = [np.eye(3), *(np.asarray(X)[:3, :3] for X in found)]
    poses: list[RestingPose] = []
    for R in rotations:
        pose = _pose(np.asarray(hull.vertices), com, R, even)
        known = any(np.arccos(np.clip(pose.up @ p.up, -1, 1)) < _SAME_RAD for p in poses if pose)
        if pose is not None and pose.tip_rad >= least_tip_rad and not known:
            poses.append(pose)
    given = [p for p in poses if p.R_OP is not None and np.allclose(p.R_OP, np.eye(3))]
    others = sorted((p for p in poses if p not in given), key=lambda p: -p.tip_rad)
    return (*given, *others)


def _pose(points: np.ndarray, com: np.ndarray, R: np.ndarray, even: bool) -> RestingPose | None:
    """The pose with rotation R; None where the centre of mass is beside its support."""
    turned, mass = points @ R.T, R @ com
    low, high = turned.min(axis=0), turned.max(axis=0)
    shift = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    turned, mass = turned + shift, mass + shift
    carries = turned[turned[:, 2] < _CONTACT_M][:, :2]
    try:
        ring = carries[ConvexHull(carries).vertices]
    except (QhullError, ValueError, IndexError):
        return None
    ahead = np.roll(ring, -1, axis=0) - ring
    inward = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1, keepdims=True)
    inside = float(np.min(np.einsum("ij,ij->i", mass[:2] - ring, inward)))
    if inside <= 0:
        return None
    return RestingPose(
        name=_name(R[2]), R_OP=R, tip_rad=float(np.arctan2(inside, mass[2])), com_m=mass, support_m=ring,
        even=even,
    )  # fmt: skip


def _name(up: np.ndarray) -> str:
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) > 0.9962:  # 5 deg
        return f"{'+' if up[axis] > 0 else '-'}{'xyz'[axis]} up"
    return "tilted, {:.2f} {:.2f} {:.2f} up".format(*up)


def turned_part(part: Part, R_OP: np.ndarray) -> tuple[Part, np.ndarray]:
    """The part turned by R_OP (3, 3), its box centred over the table's axis and its base at z = 0; and X_KO.

    X_KO (4, 4) brings the part's present frame O to that of the placement, K.
    """
    from dataclasses import replace

    vertices = part.vertices @ R_OP.T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    X_KO = np.eye(4)
    X_KO[:3, :3] = R_OP
    X_KO[:3, 3] = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    X_OI = np.eye(4) if part.X_OI is None else part.X_OI
    return replace(part, vertices=vertices + X_KO[:3, 3], X_OI=X_KO @ X_OI), X_KO
