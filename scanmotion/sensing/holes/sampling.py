"""Point clouds made fit for the search of holes: without copies, evened by voxels, sampled from a mesh."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import HoleError
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.jit import first_not_less, njit
from scanmotion.sensing.holes.rims import Sampling, sampling_of

UNEVEN = 1.5
"""Spread of the local pitch over which a cloud is averaged in voxels first."""
COARSE = 1.1
"""Side of the voxels against the pitch in the sparse parts."""
APART = 0.7
"""Least distance of the voxels' seeds against their side: dense parts then get the pitch of a cubic grid."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """A cloud made fit for the search."""

    sampling: Sampling
    first: np.ndarray
    """One point of the input for each point of the sampling, shape (m,)."""
    directions: np.ndarray | None
    """Towards the outside, shape (m, 3)."""
    averaged: bool
    """Whether points were averaged."""
    notes: tuple[str, ...]


def prepared(
    points: np.ndarray, directions: np.ndarray | None, least: int, voxel: float | None, literal: bool
) -> Prepared | str:
    """The cloud without copies, averaged in voxels where that is asked for or needed; or why there is none.

    Args:
        points: shape (n, 3) [m]. directions: towards the outside, shape (n, 3).
        least: points that are needed.
        voxel: width of the cells [m]; 0 for none; by default only where the pitch is uneven.
        literal: never average by default.

    Raises:
        HoleError: too few points are left.
    """
    first = np.sort(np.unique(points, axis=0, return_index=True)[1])
    doubles = len(points) - len(first)
    notes = (f"{doubles} duplicate points were left out",) if doubles else ()
    cloud = points[first]
    if len(cloud) < least:
        raise HoleError(f"{len(cloud)} distinct points are fewer than the {least} that a neighbourhood needs")
    centred = cloud - cloud.mean(axis=0)
    if np.linalg.matrix_rank(centred.T @ centred, tol=1e-12 * float((centred**2).sum()), hermitian=True) < 2:
        return "all points lie on one line: there is no surface"
    toward = None if directions is None else directions[first]
    sampling = None if voxel else sampling_of(cloud)
    if voxel is None and not literal and sampling is not None and unevenness(sampling) > UNEVEN:
        # two digits: what rounding does to the pitch of a moved cloud must not reach its cells
        voxel = float(f"{COARSE * float(np.percentile(sampling.unit, 95)):.1e}")
        notes = (*notes, f"the cloud is uneven: averaged in voxels of {voxel:.3g} m")
    if voxel:
        cloud, mean, inverse = evened(cloud, toward, voxel)
        first = first[np.unique(inverse, return_index=True)[1]]
        toward = None if toward is None else mean
        if len(cloud) < least:
            raise HoleError(f"voxels of {voxel:.3g} m leave {len(cloud)} points; {least} are needed")
        sampling = sampling_of(cloud)
    assert sampling is not None
    return Prepared(sampling=sampling, first=first, directions=toward, averaged=bool(voxel), notes=notes)


def evened(points: np.ndarray, directions: np.ndarray | None, voxel: float) -> tuple[np.ndarray, ...]:
    """Means of the points about seeds that lie evenly: unlike a grid's, they turn with the cloud.

    Args:
        points: shape (n, 3) [m]. directions: vectors at the points, shape (n, 3).
        voxel: width of the cell about a seed [m]; the seeds are at least APART of it from each other.

    Returns:
        Mean points (m, 3), mean directions (m, 3) (zeros without), cell of each point (n,).
    """
    middle = points.mean(axis=0)
    away = ((points - middle) ** 2).sum(axis=1)
    # from the middle outwards the seeds pack closely; copies are gone, so ties are broken by the coordinates
    order = np.lexsort((*points.T, away))
    seeds = order[spread(points, order, APART * voxel)[order]]
    distance, nearest = cKDTree(points[seeds]).query(points, min(2, len(seeds)), workers=allowed_threads())
    distance, nearest = distance.reshape(len(points), -1), nearest.reshape(len(points), -1)
    # between two seeds, as on the grid of a range image, the inner one has it
    tied = distance[:, -1] - distance[:, 0] < 1e-9 * voxel
    cell = np.where(tied, nearest.min(axis=1), nearest[:, 0])
    count = np.bincount(cell, minlength=len(seeds))

    def mean(values: np.ndarray) -> np.ndarray:
        sums = [np.bincount(cell, values[:, axis], len(seeds)) for axis in range(3)]
        return np.stack(sums, axis=1) / count[:, None]

    around = np.zeros_like(points) if directions is None else directions
    return mean(points - middle) + middle, mean(around), cell


def spread(points: np.ndarray, order: np.ndarray, distance: float) -> np.ndarray:
    """Which points are taken, going in the given order: none closer than `distance` to one before it."""
    low = points.min(axis=0)
    cube = np.floor((points - low) / distance).astype(np.int64) + 1
    span = cube.max(axis=0) + 2
    key = (cube[:, 0] * span[1] + cube[:, 1]) * span[2] + cube[:, 2]
    return _spread(points, order, key, np.unique(key), span[1], span[2], distance**2)


@njit(cache=True)
def _spread(points, order, key, cells, wide, high, square):
    kept = np.zeros(len(points), np.bool_)
    last = np.full(len(cells), -1)
    before = np.full(len(points), -1)
    for i in order:
        free = True
        for column in range(9):
            middle = key[i] + (column // 3 - 1) * wide * high + (column % 3 - 1) * high
            c = first_not_less(cells, middle - 1)
            while free and c < len(cells) and cells[c] <= middle + 1:
                j = last[c]
                while free and j >= 0:
                    away = 0.0
                    for axis in range(3):
                        away += (points[i, axis] - points[j, axis]) ** 2
                    free = away >= square
                    j = before[j]
                c += 1
        if free:
            kept[i] = True
            c = first_not_less(cells, key[i])
            before[i] = last[c]
            last[c] = i
    return kept


def unevenness(sampling: Sampling) -> float:
    """Spread of the local pitch: 95th over 5th percentile; even samples have 1.1, random ones 1.4."""
    low, high = np.percentile(sampling.unit, (5, 95))
    return float(high / low)


def even_samples(
    vertices: np.ndarray, triangles: np.ndarray, spacing: float, *, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over a mesh: random by area, then thinned so that none are closer than `spacing`.

    Args:
        vertices: shape (n, 3) [m]. triangles: shape (m, 3). spacing: least distance [m].

    Returns:
        Points and the normals of their triangles, each (k, 3).
    """
    corner = vertices[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    twice = np.linalg.norm(normal, axis=1)
    count = int(np.ceil(6.0 * 0.5 * twice.sum() / spacing**2))
    pick = rng.choice(len(triangles), count, p=twice / twice.sum())
    a, b = np.sqrt(rng.random(count)), rng.random(count)
    weight = np.stack([1.0 - a, a * (1.0 - b), a * b], axis=1)
    points = np.einsum("ij,ijk->ik", weight, corner[pick])
    unit = normal[pick] / twice[pick, None]
    kept = thinned_samples(points, unit, spacing)
    return points[kept], unit[kept]


def thinned_samples(points: np.ndarray, normals: np.ndarray, spacing: float) -> np.ndarray:
    """Indices of points kept in order, none closer than `spacing` to one before it on the same side."""
    pairs = cKDTree(points).query_pairs(spacing, output_type="ndarray")
    pairs = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > 0.0]
    order = np.argsort(pairs[:, 1], kind="stable")
    later, earlier = pairs[order, 1], pairs[order, 0]
    kept = np.ones(len(points), bool)
    _thin(kept, earlier, later)
    return np.flatnonzero(kept)


@njit(cache=True)
def _thin(kept, earlier, later):
    for k in range(len(later)):
        if kept[earlier[k]]:
            kept[later[k]] = False
