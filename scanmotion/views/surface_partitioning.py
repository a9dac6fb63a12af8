"""Surface partitioning, the other method that the paper compares with: one view for each nearly flat patch.

The paper cites no source for it; this is an interpretation: regions grow from a seed while their normals stay
within a limit of the seed's and their box within 0.85 of the field. Of many seeds the one with the largest
region is taken, until only scraps are left, so that the method is not burdened with needless views. Needs the
true mesh.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.streams import fixed_stream
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import surface_samples

_SHARE = 0.85
_SAMPLES = 6000
_ABOVE_TABLE = 0.15
"""Least height of a view above the table: below it the scanner's mount comes too near [m]."""
_MOST_RAISED = np.deg2rad(45.0)
"""A view that must be raised further is left out: it would graze its patch [rad]."""
_SEEDS = 24
"""Seeds tried for each patch."""
_SCRAP = 10e-4
"""Patches smaller than this get no view of their own [m2]: their neighbours' views mostly see them."""
_SCRAP_SHARE = 0.002
"""The same as a share of the surface, for small parts."""


def surface_partitioning(
    part: Part,
    scanner: Scanner,
    *,
    standoff: float | None = None,
    table_z: float = 0.0,
    deviation: float = np.deg2rad(30.0),
) -> tuple[Viewpoint, ...]:
    """One view, `standoff` along the mean normal, for each patch.

    Args:
        part: the true mesh.
        scanner: field of view and range.
        standoff: from the patch's middle [m]; None for the middle of the range.
        table_z: height of the table's top; views that would be below it look up less steeply.
        deviation: greatest angle between a patch's normals and its seed's [rad].

    Raises:
        PartError: the part is a cloud.
    """
    if not part.is_mesh:
        raise PartError("surface partitioning needs the true mesh")
    standoff = scanner.middle if standoff is None else standoff
    samples = surface_samples(part, _SAMPLES, rng=fixed_stream("partition_samples"))
    points = samples.points
    graph = _neighbours(points, samples.normals)
    normals = _smoothed(samples.normals, graph)
    standing = (points[:, 2] < part.bounds[0, 2] + 1e-3) & (samples.normals[:, 2] < -0.9)
    half = tuple(float(side) * _SHARE / 2 for side in scanner.field(standoff))
    least = min(_SCRAP / samples.area, _SCRAP_SHARE * _SAMPLES)
    views: list[Viewpoint] = []
    for members in _patches(points, normals, ~standing, graph, half, deviation, least):
        n = normals[members].mean(axis=0)
        n /= np.linalg.norm(n)
        middle = points[members].mean(axis=0)
        n = _raised(n, (table_z + _ABOVE_TABLE - middle[2]) / standoff)
        if n is None:
            continue
        p = middle + standoff * n
        views.append(
            Viewpoint(
                id=f"P{len(views) + 1}", X_OS=look_at(p, -n), standoff=standoff, step="global",
                kind="station", slack=Slack(roll=False),
                note=f"patch of {len(members) * samples.area * 1e4:.0f} cm2",
            )
        )  # fmt: skip
    return tuple(views)


def _raised(n: np.ndarray, least: float) -> np.ndarray | None:
    """The unit vector nearest `n` whose z is at least `least`; None where it would be turned too far."""
    if n[2] >= least:
        return n
    flat = np.linalg.norm(n[:2])
    if least >= 1.0 or flat < 1e-9:
        return None
    raised = np.array([*(n[:2] / flat * np.sqrt(1.0 - least**2)), least])
    return raised if raised @ n >= np.cos(_MOST_RAISED) else None


def _patches(
    points: np.ndarray,
    normals: np.ndarray,
    free: np.ndarray,
    graph: coo_array,
    half: tuple[float, ...],
    deviation: float,
    least: float,
) -> list[np.ndarray]:
    """Samples of each patch: of several seeds the largest region is cut out, while it has `least` samples."""
    free, rng, out = free.copy(), fixed_stream("partition_seeds"), []
    while free.any():
        seeds = rng.choice(np.flatnonzero(free), size=min(_SEEDS, int(free.sum())), replace=False)
        grown = [_grown(int(seed), points, normals, free, graph, half, deviation) for seed in seeds]
        largest = max(grown, key=len)
        if len(largest) >= least:
            out.append(largest)
            free[largest] = False
        else:
            # None of these seeds will do better later: regions only shrink.
            free[seeds] = False
    return out


def _smoothed(normals: np.ndarray, graph: coo_array) -> np.ndarray:
    """Mean normal of each sample and its neighbours: a chiselled surface is one patch, not many facets."""
    for _ in range(2):
        normals = normals + np.column_stack([graph @ normals[:, k] for k in range(3)])
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals


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
    half: tuple[float, ...],
    deviation: float,
) -> np.ndarray:
    """Free samples joined with the seed, alike in normal and inside the field about the seed."""
    X = look_at(points[seed], -normals[seed])
    local = (points - points[seed]) @ X[:3, :3]
    fits = free & (normals @ normals[seed] >= np.cos(deviation))
    fits &= (np.abs(local[:, 0]) <= half[0]) & (np.abs(local[:, 1]) <= half[1]) & (np.abs(local[:, 2]) < 0.15)
    both = fits[graph.row] & fits[graph.col]
    inner = coo_array((graph.data[both], (graph.row[both], graph.col[both])), shape=graph.shape)
    _, label = connected_components(inner, directed=False)
    return np.flatnonzero(fits & (label == label[seed]))
