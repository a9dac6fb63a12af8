"""A measured cloud brought onto its reference mesh: point to exact surface, robust, whatever the start.

Guarantees: the distances that are made small are those to the triangles themselves, not to samples of them.
Motions that the shape leaves free (a sphere's turns, a plane's slides) are not made, and are said. Assumes:
the cloud is a rigid copy of at least a part of the mesh. A start is looked for only among the box's and the
principal axes.
"""

from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.column_products import column_products
from scanmotion.sensing.assess import raycaster
from scanmotion.sensing.simulator.captures import motion

_TUKEY = 4.685
_FREE = 1e-4
"""Below this share of the greatest eigenvalue a motion counts as free."""
_GOOD = 0.6
"""A start is good where so much of the cloud ends within reach of the surface."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Alignment:
    """Where a measured cloud lies on its reference."""

    X: np.ndarray
    """Pose that takes the cloud's points into the reference's frame, shape (4, 4)."""
    within: float
    """Share of the points that end within `reach` of the surface."""
    rms: float
    """Weighted rms of their distances [m]."""
    free: int
    """How many of the six motions the shape leaves free."""
    start: str
    """"given", or "found" where the start was looked for."""

    @property
    def statement(self) -> str:
        """One sentence."""
        shift = float(np.linalg.norm(self.X[:3, 3])) * 1e3
        loose = f"; the shape leaves {self.free} of 6 motions free, which were not made" if self.free else ""
        return (
            f"{self.within:.1%} of the points within reach, rms {self.rms * 1e3:.4f} mm, "
            f"from a {self.start} start, origin moved by {shift:.3f} mm{loose}"
        )


def aligned(
    points: np.ndarray, part: Part, *, how: str = "auto", reach: float = 0.01, most: int = 20_000
) -> Alignment:
    """Moves a cloud onto a mesh.

    Args:
        points: shape (n, 3) [m].
        part: the reference mesh.
        how: "none": where it is. "fine": from where it is. "global": from a start that is looked for. "auto":
            fine, and global where that leaves much of the cloud off the surface.
        reach: points farther than this from the surface do not pull in the end [m].
        most: points used.

    Raises:
        InputError: the reference is no mesh, fewer than 10 points, or `how` is unknown.
    """
    if how not in ("auto", "fine", "global", "none"):
        raise InputError(f"unknown alignment {how!r}; known: auto, fine, global, none")
    if not part.is_mesh:
        raise InputError(f"{part.name}: the reference of an alignment is a mesh, not a cloud")
    if len(points) < 10:
        raise InputError(f"{len(points)} points are too few to assess")
    some = points[np.unique(np.linspace(0, len(points) - 1, min(most, len(points))).astype(int))]
    scene = raycaster(part)
    if how == "none":
        return _stated(some, scene, np.eye(4), reach, "given")
    if how in ("auto", "fine"):
        found = _stated(some, scene, _fitted(some, scene, np.eye(4), reach), reach, "given")
        if how == "fine" or found.within >= _GOOD:
            return found
    return _stated(some, scene, _fitted(some, scene, _start(some, part, scene), reach), reach, "found")


def _start(points: np.ndarray, part: Part, scene: Any) -> np.ndarray:
    """The best of the ways in which the cloud's axes may lie along the mesh's, after a coarse fit of each."""
    few = points[:: max(1, len(points) // 1500)]
    size = float(np.linalg.norm(part.extent))
    corners = part.vertices[part.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    centres = corners.mean(axis=1)
    middle = np.average(centres, axis=0, weights=areas)
    own, theirs = _axes(few, np.ones(len(few))), _axes(centres, areas)
    best, least = np.eye(4), np.inf
    for R in _turns():
        X = np.eye(4)
        X[:3, :3] = theirs @ R @ own.T
        X[:3, 3] = middle - X[:3, :3] @ few.mean(axis=0)
        X = _fitted(few, scene, X, size / 4, turns=12)
        off = np.sort(np.abs(_distances(few @ X[:3, :3].T + X[:3, 3], scene)[0]))
        worth = float(off[: int(0.8 * len(off)) + 1].mean())
        if worth < least - 1e-9:
            best, least = X, worth
    return best


def _axes(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Principal axes as the columns of a rotation, shape (3, 3)."""
    centred = points - np.average(points, axis=0, weights=weights)
    axes = np.linalg.eigh(np.einsum("n,ni,nj->ij", weights, centred, centred))[1]
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return axes


def _turns() -> list[np.ndarray]:
    """The 24 rotations of the cube; where two axes are alike their order is not known."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0:
                found.append(R)
    return found


def _distances(points: np.ndarray, scene: Any) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (n,) and its gradient (n, 3); the sign is that of the nearest triangle's normal."""
    near = scene.compute_closest_points(np.ascontiguousarray(points, np.float32), nthreads=allowed_threads())
    offset = points - near["points"].numpy().astype(float)
    normal = near["primitive_normals"].numpy().astype(float)
    length = np.linalg.norm(offset, axis=1)
    side = np.where(np.einsum("ij,ij->i", offset, normal) < 0, -1.0, 1.0)
    gradient = np.where(
        (length > 1e-6)[:, None], side[:, None] * offset / np.maximum(length, 1e-12)[:, None], normal
    )
    return side * length, gradient


def _weights(d: np.ndarray, reach: float) -> np.ndarray:
    scale = max(1.4826 * float(np.median(np.abs(d))), 1e-7)
    u = np.clip(np.abs(d) / min(_TUKEY * scale, max(reach, 1e-6)), 0.0, 1.0)
    return (1.0 - u * u) ** 2


def _equations(
    points: np.ndarray, scene: Any, X: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Normal matrix (6, 6), right side (6,), centre (3,) and size [m]; turns are in units of 1 / size."""
    p = points @ X[:3, :3].T + X[:3, 3]
    centre = p.mean(axis=0)
    size = float(np.sqrt(((p - centre) ** 2).sum(axis=1).mean()))
    d, g = _distances(p, scene)
    w = _weights(d, reach)
    J = np.hstack([g, np.cross(p - centre, g) / size])
    return column_products(J, w[:, None] * J), -column_products(J, w * d), centre, size


def _fitted(points: np.ndarray, scene: Any, X: np.ndarray, reach: float, *, turns: int = 60) -> np.ndarray:
    X = X.copy()
    for _ in range(turns):
        A, b, centre, size = _equations(points, scene, X, reach)
        values, vectors = np.linalg.eigh(A)
        keep = values > _FREE * max(float(values[-1]), 1e-12)
        step = vectors[:, keep] @ ((vectors[:, keep].T @ b) / values[keep])
        step[3:] /= size
        D = motion(step[None])[0]
        D[:3, 3] += centre - D[:3, :3] @ centre
        X = D @ X
        if np.abs(step[:3]).max() + size * np.abs(step[3:]).max() < 1e-8:
            break
    return X


def _stated(points: np.ndarray, scene: Any, X: np.ndarray, reach: float, start: str) -> Alignment:
    d = _distances(points @ X[:3, :3].T + X[:3, 3], scene)[0]
    w = _weights(d, reach)
    values = np.linalg.eigvalsh(_equations(points, scene, X, reach)[0])
    return Alignment(
        X=X, within=float((np.abs(d) <= reach).mean()),
        rms=float(np.sqrt((w * d * d).sum() / max(w.sum(), 1e-30))),
        free=int((values <= _FREE * max(float(values[-1]), 1e-12)).sum()), start=start,
    )  # fmt: skip
