"""Surface partitioning, the other method that the paper compares with: one view for each nearly flat patch.

The paper cites no source for it; this is an interpretation: regions grow from a seed while their normals stay
within a limit of the seed's and their box within 0.85 of the field. Needs the true mesh.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scanmotion.errors import PartError
from scanmotion.part import Part, surface_samples
from scanmotion.scanner import Scanner
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint, look_at

_SHARE = 0.85
_SAMPLES = 6000


def surface_partitioning(
    part: Part,
    scanner: Scanner,
    *,
    standoff: float = 0.7,
    table_z: float = 0.0,
    deviation: float = np.deg2rad(40.0),
) -> tuple[Viewpoint, ...]:
    """One view, `standoff` along the mean normal, for each patch.

    Args:
        part: the true mesh.
        scanner: field of view and range.
        standoff: from the patch's middle [m].
        table_z: height of the table's top; views below it are left out.
        deviation: greatest angle between a patch's normals and its seed's [rad].

    Raises:
        PartError: the part is a cloud.
    """
    if not part.is_mesh:
        raise PartError("surface partitioning needs the true mesh")
    samples = surface_samples(part, _SAMPLES, rng=np.random.default_rng(0))
    points, normals = samples.points, samples.normals
    standing = (points[:, 2] < part.bounds[0, 2] + 1e-3) & (normals[:, 2] < -0.9)
    free = ~standing
    views: list[Viewpoint] = []
    graph = _neighbours(points, normals)
    long, short = (float(side) * _SHARE / 2 for side in scanner.field(standoff))
    while free.any():
        seed = int(np.flatnonzero(free)[np.argmax(points[free, 2])])
        members = _grown(seed, points, normals, free, graph, (long, short), deviation)
        free[members] = False
        if len(members) < _SAMPLES / 2000:
            continue
        n = normals[members].mean(axis=0)
        n /= np.linalg.norm(n)
        p = points[members].mean(axis=0) + standoff * n
        if p[2] < table_z + 0.08:
            continue
        views.append(
            Viewpoint(
                id=f"P{len(views) + 1}", X_OS=look_at(p, -n), standoff=standoff, step="global", kind="station",
                slack=Slack(roll=False), note=f"patch of {len(members) * samples.area * 1e4:.0f} cm2",
            )
        )  # fmt: skip
    return tuple(views)


def _neighbours(points: np.ndarray, normals: np.ndarray) -> coo_array:
    """Joins each sample with its eight nearest that face the same way."""
    _, near = cKDTree(points).query(points, k=9)
    i, j = np.repeat(np.arange(len(points)), 8), near[:, 1:].ravel()
    same = np.einsum("ij,ij->i", normals[i], normals[j]) > 0.3
    i, j = i[same], j[same]
    return coo_array((np.ones(len(i)), (i, j)), shape=(len(points),) * 2)


def _grown(
    seed: int,
    points: np.ndarray,
    normals: np.ndarray,
    free: np.ndarray,
    graph: coo_array,
    half: tuple[float, float],
    deviation: float,
) -> np.ndarray:
    """Free samples joined with the seed, alike in normal and inside the field about the seed."""
    X = look_at(points[seed], -normals[seed])
    local = (points - points[seed]) @ X[:3, :3]
    fits = free & (normals @ normals[seed] >= np.cos(deviation))
    fits &= (
        (np.abs(local[:, 0]) <= half[0]) & (np.abs(local[:, 1]) <= half[1]) & (np.abs(local[:, 2]) < 0.15)
    )
    both = fits[graph.row] & fits[graph.col]
    inner = coo_array((graph.data[both], (graph.row[both], graph.col[both])), shape=graph.shape)
    _, label = connected_components(inner, directed=False)
    return np.flatnonzero(fits & (label == label[seed]))
