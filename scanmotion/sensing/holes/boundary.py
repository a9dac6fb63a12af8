"""Boundary points of a sampled surface: neighbours, plane fits, the largest angle without a neighbour.

Paper section 3.1 (doi 10.3390/act14030139): the neighbours of a point within a radius are projected on its
tangent plane and sorted by angle; where the largest gap exceeds a threshold the point lies on a boundary.
Two things are mended: the projection is the plain one onto the plane (the branch for a = 0 is wrong), and
gaps are measured by atan2 with wrap-around (arccos folds gaps over pi).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import HoleError
from scanmotion.core.support.threads import allowed_threads, by_pieces
from scanmotion.geometry.jit import njit
from scanmotion.sensing.holes.angle_gaps import exceeds_gap
from scanmotion.sensing.holes.orient import signs_by_spanning_tree


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaneFits:
    """Local plane fits of a cloud."""

    normals: np.ndarray
    """Unit normals of either sign, shape (n, 3)."""
    thickness: np.ndarray
    """Root mean square distance of the neighbours from their plane, shape (n,) [m]."""


def project_on_plane(point: np.ndarray, normal: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Foot of q on the plane through `point`: q - n (n . (q - P)) / (n . n); shapes (3,), (3,), (.., 3)."""
    normal = np.asarray(normal, float)
    q = np.asarray(q, float)
    height = (q - point) @ normal / (normal @ normal)
    return q - height[..., None] * normal


def check_points(points: np.ndarray, least: int) -> np.ndarray:
    """The cloud as float64 (n, 3), contiguous.

    Raises:
        HoleError: wrong shape, fewer than `least` points, or numbers that are not finite.
    """
    points = np.ascontiguousarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise HoleError(f"points must have shape (n, 3), got {points.shape}")
    bad = int((~np.isfinite(points)).any(axis=1).sum())
    if bad:
        raise HoleError(f"{bad} of {len(points)} points are not finite")
    if len(points) < least:
        raise HoleError(f"{len(points)} points are fewer than the {least} that a neighbourhood needs")
    return points


def check_unit(vectors: np.ndarray, n: int, name: str) -> np.ndarray:
    """Unit vectors of shape (n, 3).

    Raises:
        HoleError: wrong shape, not finite, or of zero length.
    """
    vectors = np.asarray(vectors, dtype=float)
    if vectors.shape != (n, 3):
        raise HoleError(f"{name} must have shape ({n}, 3), got {vectors.shape}")
    length = np.linalg.norm(vectors, axis=1)
    bad = int((~(length > 0) | ~np.isfinite(length)).sum())
    if bad:
        raise HoleError(f"{bad} of {n} {name} are zero or not finite")
    return np.ascontiguousarray(vectors / length[:, None])


def neighbour_radius(tree: cKDTree, neighbours: int, *, most: int = 20000) -> float:
    """Median distance to the given neighbour [m], from at most `most` evenly picked points.

    The picks go by sorted position, so that permuted clouds give the same radius.
    """
    points = np.asarray(tree.data)
    if len(points) > most:
        order = np.lexsort(points.T)
        points = points[order[np.linspace(0, len(points) - 1, most).astype(int)]]
    distance = tree.query(points, neighbours + 1, workers=allowed_threads())[0][:, -1]
    return float(np.median(distance))


def plane_fits(points: np.ndarray, neighbours: np.ndarray) -> PlaneFits:
    """Total least squares planes through each point and its neighbours.

    Args:
        points: cloud, shape (n, 3) [m].
        neighbours: indices, shape (m, k); row i may hold the point itself.
    """
    # One kind of array, whoever asks: the kernel would be compiled anew for each.
    points, neighbours = np.array(points, dtype=float, order="C"), np.array(neighbours, order="C")
    pieces = by_pieces(lambda a, b: _covariances(points, neighbours[a:b]), len(neighbours), least=2000)
    covariance = np.concatenate(pieces)
    value, vector = np.linalg.eigh(covariance)
    return PlaneFits(
        normals=np.ascontiguousarray(vector[:, :, 0]), thickness=np.sqrt(np.maximum(value[:, 0], 0.0))
    )


@njit(cache=True, nogil=True)
def _covariances(points, neighbours):
    m, k = neighbours.shape
    out = np.zeros((m, 3, 3))
    for i in range(m):
        mean = np.zeros(3)
        for j in range(k):
            for a in range(3):
                mean[a] += points[neighbours[i, j], a] / k
        for j in range(k):
            for a in range(3):
                da = points[neighbours[i, j], a] - mean[a]
                for b in range(a, 3):
                    out[i, a, b] += da * (points[neighbours[i, j], b] - mean[b]) / k
        for a in range(3):
            for b in range(a):
                out[i, a, b] = out[i, b, a]
    return out


def oriented_normals(
    points: np.ndarray, *, view_directions: np.ndarray | None = None, k: int = 16
) -> np.ndarray:
    """Unit normals by local plane fit, all pointing out of the object.

    Args:
        points: cloud, shape (n, 3) [m].
        view_directions: unit vectors point -> sensor, shape (n, 3); the sensor saw the outside. Without them
            the signs are carried along a minimum spanning tree (see `orient`).
        k: neighbours of the plane fit, the point included.

    Returns:
        Normals, shape (n, 3).

    Raises:
        HoleError: fewer than k points, or bad numbers.
    """
    points = check_points(points, k)
    index = cKDTree(points).query(points, k, workers=allowed_threads())[1]
    normals = plane_fits(points, index).normals
    if view_directions is not None:
        directions = check_unit(view_directions, len(points), "view directions")
        return normals * np.where(np.einsum("ij,ij->i", normals, directions) < 0.0, -1.0, 1.0)[:, None]
    return normals * signs_by_spanning_tree(points, normals, index[:, : min(k, 10)])[:, None]


def boundary_points(
    points: np.ndarray,
    normals: np.ndarray,
    *,
    radius: float | None = None,
    threshold: float = np.pi / 2,
    neighbours: int = 30,
) -> np.ndarray:
    """Which points lie on a boundary: those with an angle over `threshold` free of neighbours.

    The test takes all neighbours within `radius`, however many.

    Args:
        points: cloud, shape (n, 3) [m].
        normals: unit normals of either sign, shape (n, 3).
        radius: of the neighbourhood [m]; median distance to the `neighbours`-th neighbour unless given.
        threshold: largest angle of an interior point [rad]; the paper has pi / 4 and 45 neighbours.
        neighbours: which neighbour sets the radius.

    Returns:
        Mask, shape (n,).

    Raises:
        HoleError: fewer points than neighbours, bad shapes or numbers.
    """
    points = check_points(points, neighbours + 1)
    normals = check_unit(normals, len(points), "normals")
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise HoleError(f"radius must be positive, got {radius}")
    if radius is None:
        radius = neighbour_radius(cKDTree(points), neighbours)
    return exceeds_gap(points, normals, radius, threshold)
