"""A light copy of a heavy mesh, for distances and pictures, and how far it is from the true triangles.

Guarantee: no point of the true surface is farther from the copy than `deviation`, so that a distance to the
copy less the deviation is never more than the true one. The copy is made by quadric decimation (Garland and
Heckbert 1997, doi 10.1145/258734.258849, by the library fast-simplification). Accuracy, completeness and the
judge take the true triangles.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.part import Part
from scanmotion.core.support.threads import allowed_threads

LIGHT = 200_000
"""Triangles up to which a mesh is its own copy, and of a copy."""
TOLERANCE_M = 0.002
"""A copy that is farther off gets twice the triangles, and at last is the mesh itself [m]."""
_CHUNK = 1_000_000
_MOST_PIECES = 10_000_000
_PIECE_M = 0.001
"""Larger triangles are cut into pieces of at most this edge when a deviation is measured [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WorkingCopy:
    """A mesh with fewer triangles."""

    part: Part
    """The copy, under the name of the true part."""
    deviation: float
    """No point of the true surface is farther from the copy [m]; 0 where it is the mesh itself."""
    back: float
    """The copy's corners are at most so far from the true surface [m]."""


@lru_cache(maxsize=2)
def working_copy(part: Part) -> WorkingCopy:
    """The part with at most some 200,000 triangles, or more where fewer would be too far off.

    Args:
        part: a mesh; what has few triangles is returned as it is.
    """
    most = LIGHT
    while part.is_mesh and len(part.triangles) > 2 * most:
        vertices, triangles = decimated(part.vertices, part.triangles, most)
        deviation = _greatest_distance(part.vertices, part.triangles, vertices, triangles)
        if deviation <= TOLERANCE_M:
            back = cKDTree(part.vertices).query(vertices, workers=allowed_threads())[0].max()
            light = replace(part, vertices=vertices, triangles=triangles)
            return WorkingCopy(part=light, deviation=deviation, back=float(back))
        most *= 2
    return WorkingCopy(part=part, deviation=0.0, back=0.0)


def decimated(vertices: np.ndarray, triangles: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and triangles (about `most`, 3) of a mesh with fewer of them."""
    import fast_simplification

    made: Any = fast_simplification.simplify(
        np.array(vertices, dtype=np.float64, order="C"),  # the library takes none that cannot be written
        np.array(triangles, dtype=np.int32, order="C"),
        target_count=most,
    )
    return np.asarray(made[0], dtype=float), np.asarray(made[1], dtype=np.int64)


def _greatest_distance(
    vertices: np.ndarray, triangles: np.ndarray, to_vertices: np.ndarray, to_triangles: np.ndarray
) -> float:
    """Bound of the distance from any point of one mesh to the other [m].

    The distance to a surface changes by no more than the way: inside of a triangle it is at most that of the
    nearest corner and the way to it, which is at most the longest edge by the root of three. Large triangles
    are cut first; infinite where that makes too many.
    """
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=allowed_threads())
    points: Any = to_vertices.astype(np.float32)
    indices: Any = to_triangles.astype(np.uint32)
    scene.add_triangles(points, indices)

    def distances(p: np.ndarray) -> np.ndarray:
        found = []
        for k in range(0, len(p), _CHUNK):
            some: Any = p[k : k + _CHUNK].astype(np.float32)
            found.append(scene.compute_distance(some, nthreads=allowed_threads()).numpy())
        return np.concatenate(found)

    at_corners = distances(vertices)
    corners = [vertices[triangles[:, k]] for k in range(3)]
    longest = np.max([np.linalg.norm(corners[k] - corners[k - 1], axis=1) for k in range(3)], axis=0)
    large = longest > _PIECE_M
    if float(((longest[large] / _PIECE_M + 2) ** 2).sum()) > 2 * _MOST_PIECES:
        return np.inf
    bound = at_corners[triangles].max(axis=1) + longest / np.sqrt(3)
    found = float(bound[~large].max(initial=0.0))
    for pieces, size in _cut([c[large] for c in corners], longest[large]):
        found = max(found, float(distances(pieces).max()) + size / np.sqrt(3))
    # Single precision of the library, for parts of a metre.
    return found + 1e-6


def _cut(corners: list[np.ndarray], longest: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Points on triangles so dense that no piece has a longer edge than `_PIECE_M`, and the longest there."""
    out = []
    counts = np.ceil(longest / _PIECE_M).astype(int)
    for n in np.unique(counts):
        a, b, c = (corner[counts == n] for corner in corners)
        i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
        u, v = (i / n)[None, :, None], (j / n)[None, :, None]
        points = a[:, None] + u * (b - a)[:, None] + v * (c - a)[:, None]
        out.append((points.reshape(-1, 3), float(longest[counts == n].max()) / n))
    return out
