"""Specks: small pieces that float far from everything else, as scanners leave them."""

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.support.streams import fixed_stream
from scanmotion.geometry.mending.edges import areas_of, bodies_of, pieces

_ISLAND = 0.05
"""What floats off the part, and does not stand on its ground, is left out up to this share."""
_SHARE = 0.005
"""All that floats off together is specks only up to this share of the surface (or of the points), each."""
_SIZE = 0.25
"""Its box is at most so large, as a share of the part's."""
_GAP = 0.02
"""It is at least this share of the part's size away from the rest, and its own size."""
_NEAR_ENOUGH = 20_000
"""Points of the part that stand for it where a gap is measured, beside its triangles' corners."""


def mesh_specks(
    vertices: np.ndarray, triangles: np.ndarray, up: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Specks of a mesh.

    Args:
        vertices: shape (n, 3).
        triangles: shape (m, 3).
        up: unit vector, shape (3,); islands that do not stand on the part's ground count where it is given.

    Returns:
        which triangles belong to specks (m,), the body of each triangle (m,), and how many specks there are.
    """
    body = bodies_of(triangles, len(vertices))
    none = np.zeros(len(triangles), bool)
    k = int(body.max(initial=0)) + 1
    if k < 2:
        return none, body, 0
    area = areas_of(vertices, triangles)
    share = np.bincount(body, weights=area, minlength=k) / max(float(area.sum()), 1e-300)
    corner, whose = triangles.ravel(), np.repeat(body, 3)
    points = vertices[corner]
    some, _ = spread_samples(vertices, triangles)
    far = _far(points, whose, share, some, up)
    return far[body], body, int(far.sum())


def cloud_specks(
    points: np.ndarray, cells: float, up: np.ndarray | None = None
) -> tuple[np.ndarray, int, int]:
    """Specks of a cloud: points whose neighbours within `cells` are few and far from the rest.

    Args:
        points: shape (n, 3).
        cells: edge of the cells whose neighbours are taken together.
        up: as of mesh_specks.

    Returns:
        which points are specks (n,), how many specks there are, and how many pieces the rest has.
    """
    place = np.floor((points - points.min(axis=0)) / cells).astype(np.int64)
    cell, inverse = np.unique(place, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    near = cKDTree(cell).query_pairs(1.8, output_type="ndarray")
    piece = pieces(len(cell), near[:, 0], near[:, 1])[inverse]
    k = int(piece.max()) + 1
    if k < 2:
        return np.zeros(len(points), bool), 0, 1
    share = np.bincount(piece, minlength=k) / len(points)
    far = _far(points, piece, share, np.zeros((0, 3)), up)
    return far[piece], int(far.sum()), k - int(far.sum())


def _boxes(points: np.ndarray, whose: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full((k, 3), np.inf), np.full((k, 3), -np.inf)
    for axis in range(3):
        np.minimum.at(low[:, axis], whose, points[:, axis])
        np.maximum.at(high[:, axis], whose, points[:, axis])
    return low, high


def spread_samples(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points spread over the triangles by area, and their normals; shapes (n, 3)."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    edges = np.cumsum(area)
    rng = fixed_stream("speck_samples")
    at = (np.arange(_NEAR_ENOUGH) + rng.random(_NEAR_ENOUGH)) / _NEAR_ENOUGH * edges[-1]
    rows = np.minimum(np.searchsorted(edges, at, side="right"), len(area) - 1)
    u, v = rng.random((2, len(rows)))
    flip = u + v > 1
    u[flip], v[flip] = 1 - u[flip], 1 - v[flip]
    points = a[rows] + u[:, None] * (b - a)[rows] + v[:, None] * (c - a)[rows]
    return points, cross[rows] / np.maximum(area[rows], 1e-300)[:, None]


def _far(
    points: np.ndarray, whose: np.ndarray, share: np.ndarray, more: np.ndarray, up: np.ndarray | None
) -> np.ndarray:
    """Which pieces are specks or islands, shape (k,).

    Args:
        points: of all pieces, shape (n, 3).
        whose: piece of each point, shape (n,).
        share: of the whole, shape (k,).
        more: further points of the large pieces, for the gap.
        up: as of mesh_specks.
    """
    low, high = _boxes(points, whose, len(share))
    small = share < (_SHARE if up is None else _ISLAND)
    if not small.any() or small.all():
        return np.zeros(len(share), bool)
    keep = ~small
    size = float(np.linalg.norm(high[keep].max(axis=0) - low[keep].min(axis=0)))
    own = np.linalg.norm(high - low, axis=1)
    small &= own < _SIZE * size
    if up is not None:
        # What stands on the ground beside the part may be a part of its own.
        foot = np.full(len(share), np.inf)
        np.minimum.at(foot, whose, points @ up)
        small &= (share < _SHARE) | (np.abs(foot - foot[keep].min()) > _GAP * size)
    if not small.any():
        return np.zeros(len(share), bool)
    rest = ~small[whose]
    base = np.concatenate([points[rest], more[_inside_boxes(more, low, high, ~small)]])
    mine = np.flatnonzero(~rest)
    distance = cKDTree(base).query(points[mine])[0]
    gap = np.full(len(share), np.inf)
    np.minimum.at(gap, whose[mine], distance)
    return small & (gap > np.maximum(own, _GAP * size))


def _inside_boxes(points: np.ndarray, low: np.ndarray, high: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Which points lie in the box of what is kept; those on specks stand for specks."""
    if not len(points):
        return np.zeros(0, bool)
    a, b = low[keep].min(axis=0), high[keep].max(axis=0)
    return ((points >= a) & (points <= b)).all(axis=1)
