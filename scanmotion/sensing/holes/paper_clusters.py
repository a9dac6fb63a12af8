"""The paper's clusters (sections 3.1, 3.2): boundary points by the largest angle, then DBSCAN."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import HoleError
from scanmotion.sensing.holes.boundary import boundary_points
from scanmotion.sensing.holes.rims import Rim, Sampling


@dataclass(frozen=True, kw_only=True)
class LargestAngle:
    """The paper's search: a point whose neighbours leave a large angle open lies on a boundary."""

    neighbours: int = 45
    """The radius of the neighbourhood is the median distance to so many neighbours, unless it is given."""
    threshold: float = np.pi / 4
    """Largest angle of an interior point [rad]."""
    eps: float | None = None
    """DBSCAN's distance [m]; None for 1.5 radius from 90 deg on, 0.75 radius under it."""
    min_points: int = 5
    """DBSCAN's least number of points within eps."""


def literal_rims(sampling: Sampling, radius: float, angle: LargestAngle) -> tuple[list[Rim], list[Rim]]:
    """Clusters of boundary points.

    Args:
        sampling: of the cloud.
        radius: of the neighbourhood [m].
        angle: what makes a boundary, and what a cluster.

    Returns:
        Rims, and none that are tiny.
    """
    points = sampling.points
    mask = boundary_points(points, sampling.normals, radius=radius, threshold=angle.threshold)
    index = np.flatnonzero(mask)
    eps = radius * (1.5 if angle.threshold > np.pi / 3 else 0.75) if angle.eps is None else angle.eps
    label = dbscan(points[index], eps, angle.min_points)
    rims = [index[label == i] for i in range(int(label.max(initial=-1)) + 1)]
    return [Rim(points=rim, opening=_openings(sampling, rim), missing=np.nan) for rim in rims], []


def dbscan(points: np.ndarray, eps: float, min_points: int) -> np.ndarray:
    """DBSCAN whose result does not depend on the order: border points go to their nearest core point.

    Args:
        points: shape (n, 3). eps: [m]. min_points: within eps, the point itself included, to be a core point.

    Returns:
        Cluster of each point, -1 for noise, shape (n,); clusters are numbered by their first point in
        lexicographic order.

    Raises:
        HoleError: eps not positive or min_points under 1.
    """
    if not (np.isfinite(eps) and eps > 0):
        raise HoleError(f"eps must be positive, got {eps}")
    if min_points < 1:
        raise HoleError(f"min_points must be at least 1, got {min_points}")
    import open3d as o3d

    label = np.full(len(points), -1)
    if not len(points):
        return label
    tree = cKDTree(points)
    core = np.flatnonzero(tree.query_ball_point(points, eps, return_length=True) >= min_points)
    if not len(core):
        return label
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[core]))
    found = np.asarray(cloud.cluster_dbscan(eps, 1))
    rank = np.full(found.max() + 1, -1)
    for i in core_order(points[core]):
        if rank[found[i]] < 0:
            rank[found[i]] = rank.max() + 1
    distance, nearest = cKDTree(points[core]).query(points)
    near = distance <= eps
    label[near] = rank[found[nearest[near]]]
    return label


def core_order(points: np.ndarray) -> np.ndarray:
    """Lexicographic order of points, x first."""
    return np.lexsort(points.T[::-1])


def _openings(sampling: Sampling, rim: np.ndarray) -> np.ndarray:
    """Unit vectors in the tangent plane away from the neighbours: into the hole."""
    points = sampling.points
    away = points[rim] - points[sampling.nearest[rim, 1:]].mean(axis=1)
    normal = sampling.normals[rim]
    away = away - normal * np.einsum("ij,ij->i", away, normal)[:, None]
    length = np.linalg.norm(away, axis=1, keepdims=True)
    return away / np.where(length > 0, length, 1.0)
