"""What a scan is worth: completeness, accuracy and standard deviation against the reference."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.support.threads import allowed_threads


@dataclass(frozen=True, kw_only=True)
class Completeness:
    """How much of a surface has been seen."""

    of_visible: float
    """Share of what can be seen."""
    of_whole: float
    """Share of the whole surface."""
    area_open: float
    """What can be seen and has not been, [m2]."""


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Distances of measured points to the true surface."""

    mean_abs: float
    """Mean of the absolute distance [m]: what the paper calls accuracy."""
    sd_signed: float
    """Standard deviation of the signed distance [m]: what the paper calls standard deviation."""
    mean_signed: float
    """Mean signed distance, positive outside [m]."""
    p95_abs: float
    """95th percentile of the absolute distance [m]."""
    points: int


def completeness(samples: SurfaceSamples, seen: np.ndarray, visible: np.ndarray) -> Completeness:
    """By visibility of surface samples, which is exact in the twin.

    Args:
        samples: uniform by area.
        seen: which of them were measured, shape (n,) bool.
        visible: which any allowed pose can see, shape (n,) bool; what was seen counts as visible.
    """
    seen = np.asarray(seen, bool)
    can = np.asarray(visible, bool) | seen
    return Completeness(
        of_visible=float(seen.sum() / max(int(can.sum()), 1)),
        of_whole=float(seen.mean()) if len(seen) else 0.0,
        area_open=float((can & ~seen).sum() * samples.area),
    )


def signed_distances(points: np.ndarray, part: Part) -> np.ndarray:
    """Signed distance of each point to the mesh, positive outside, shape (n,) [m].

    The sign is that of the winding for a closed mesh, else of the nearest triangle's normal.

    Raises:
        InputError: the part is a cloud.
    """
    if not part.is_mesh:
        raise InputError(f"{part.name}: distances need a mesh, not a point cloud")
    return distances_to(raycaster(part), points, closed=part.closed)


def raycaster(part: Part) -> Any:
    """An Open3D RaycastingScene of the mesh."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=allowed_threads())
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(part.vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(part.triangles.astype(np.uint32)),
    )
    return scene


def distances_to(scene: Any, points: np.ndarray, *, closed: bool) -> np.ndarray:
    """As signed_distances, for a prepared RaycastingScene."""
    at = np.ascontiguousarray(points, np.float32)
    if closed:
        return scene.compute_signed_distance(at, nsamples=3, nthreads=allowed_threads()).numpy().astype(float)
    near = scene.compute_closest_points(at, nthreads=allowed_threads())
    offset = at - near["points"].numpy()
    side = np.einsum("ij,ij->i", offset, near["primitive_normals"].numpy())
    return np.copysign(np.linalg.norm(offset, axis=1), side).astype(float)


def accuracy(points: np.ndarray, part: Part) -> Accuracy:
    """Distance of each point to the true surface, under both of the paper's definitions.

    Args:
        points: shape (n, 3) [m].
        part: the reference mesh.

    Raises:
        InputError: no points, or the part is a cloud.
    """
    if len(points) == 0:
        raise InputError("no points to assess")
    d = signed_distances(points, part)
    return Accuracy(
        mean_abs=float(np.abs(d).mean()), sd_signed=float(d.std()), mean_signed=float(d.mean()),
        p95_abs=float(np.percentile(np.abs(d), 95)), points=len(d),
    )  # fmt: skip


def completeness_by_distance(
    samples: SurfaceSamples,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    visible: np.ndarray | None = None,
    distance: float = 0.003,
    angle: float = np.deg2rad(60.0),
) -> Completeness:
    """For real scans, where nobody knows what was seen: a sample counts if a like-facing point is near.

    The normal test keeps one side of a thin wall from vouching for the other.

    Args:
        samples: of the reference, uniform by area.
        points: of the fused cloud, shape (n, 3) [m].
        normals: outward, shape (n, 3).
        visible: which samples any pose can see, shape (m,) bool; None for all.
        distance: greatest distance of sample and point [m].
        angle: greatest angle between their normals [rad].
    """
    covered = covered_samples(samples, points, normals, distance=distance, angle=angle)
    return completeness(samples, covered, np.ones(len(covered), bool) if visible is None else visible)


def covered_samples(
    samples: SurfaceSamples, points: np.ndarray, normals: np.ndarray, *, distance: float, angle: float
) -> np.ndarray:
    """Which samples have a like-facing point near, shape (m,) bool; arguments as completeness_by_distance."""
    tree, covered = cKDTree(points), np.zeros(len(samples.points), bool)
    todo = np.arange(len(covered) if len(points) else 0)
    near = 8
    while len(todo):
        near = min(near, len(points))
        d, k = tree.query(samples.points[todo], k=near, distance_upper_bound=distance)
        d, k = d.reshape(len(todo), -1), np.minimum(k.reshape(len(todo), -1), len(points) - 1)
        like = np.einsum("ijk,ik->ij", normals[k], samples.normals[todo]) >= np.cos(angle)
        hit = (np.isfinite(d) & like).any(axis=1)
        covered[todo[hit]] = True
        # Only where all the points that were found are near and turned away can a farther one still count.
        todo = todo[~hit & np.isfinite(d).all(axis=1)] if near < len(points) else todo[:0]
        near *= 8
    return covered
