"""Convex hulls and convex pieces of meshes.

Guarantees: every point of the mesh's triangles, and of the solid that they bound, lies in one of the pieces.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

MOST_PIECES = 6
"""Slabs that a mesh is cut into at most."""
_THIN_M = 1e-3
"""A flat mesh is taken for so thick [m]."""
_ENOUGH = 0.93
"""More slabs have to take away so much of the volume of the boxes about them."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Hull:
    """A convex polyhedron."""

    points: np.ndarray
    """Its corners, shape (n, 3) [m]."""
    faces: np.ndarray
    """Triangles that look outwards, shape (m, 3)."""

    @property
    def volume(self) -> float:
        """Volume [m3]."""
        a, b, c = (self.points[self.faces[:, k]] - self.points[0] for k in range(3))
        return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def hull_from(points: np.ndarray) -> Hull:
    """The convex hull of points (n, 3) [m]; what is flat is made `_THIN_M` thick.

    Raises:
        ValueError: no point.
    """
    points = np.unique(np.asarray(points, dtype=float).reshape(-1, 3), axis=0)
    if len(points) == 0:
        raise ValueError("a hull of no points")
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        signs = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * _THIN_M
        points = (points[:, None] + signs).reshape(-1, 3)
        hull = ConvexHull(points)
    of = np.full(len(points), -1)
    of[hull.vertices] = np.arange(len(hull.vertices))
    corners, faces = points[hull.vertices], of[hull.simplices]
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[inward] = faces[inward, ::-1]
    return Hull(points=corners, faces=faces)


def convex_pieces(vertices: np.ndarray, triangles: np.ndarray, *, most: int = MOST_PIECES) -> list[Hull]:
    """A mesh as few convex pieces: slabs across one axis, each the hull of what of the mesh lies in it.

    Args:
        vertices: shape (n, 3) [m].
        triangles: shape (m, 3).
        most: pieces at most.
    """
    best = [vertices[np.unique(triangles)]]
    for count in range(2, most + 1):
        cuts = [_slabs(vertices, triangles, axis, count) for axis in range(3)]
        pieces = min(cuts, key=_boxes)
        if _boxes(pieces) < _ENOUGH * _boxes(best):
            best = pieces
    return [hull_from(points) for points in best]


def _boxes(pieces: list[np.ndarray]) -> float:
    """Volume of the boxes about the pieces' points [m3]."""
    return sum(float(np.prod(np.maximum(np.ptp(points, axis=0), _THIN_M))) for points in pieces)


def _slabs(vertices: np.ndarray, triangles: np.ndarray, axis: int, count: int) -> list[np.ndarray]:
    """Points whose hulls hold the mesh between `count` + 1 planes across an axis."""
    used = vertices[np.unique(triangles)]
    low, high = used[:, axis].min(), used[:, axis].max()
    planes = np.linspace(low, high, count + 1)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
    cuts = [_crossings(a, b, axis, plane) for plane in planes[1:-1]]
    cuts = [np.zeros((0, 3)), *cuts, np.zeros((0, 3))]
    pieces = []
    for n in range(count):
        inside = (used[:, axis] >= planes[n]) & (used[:, axis] <= planes[n + 1])
        points = np.concatenate([used[inside], cuts[n], cuts[n + 1]])
        if len(points):
            pieces.append(points)
    return pieces


def _crossings(a: np.ndarray, b: np.ndarray, axis: int, plane: float) -> np.ndarray:
    """Where edges from a to b (n, 3) pass a plane."""
    da, db = a[:, axis] - plane, b[:, axis] - plane
    through = da * db < 0
    t = (da / np.where(da == db, 1.0, da - db))[through, None]
    return a[through] + t * (b[through] - a[through])
