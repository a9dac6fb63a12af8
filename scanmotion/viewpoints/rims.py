"""The rims of a cloud's holes: empty regions that are large enough, on one sheet, in a dense cloud.

Three things look like holes to the largest angle and are none; each is told by what it is:
creases and rims of thin walls (the neighbourhood has no plane), patches that are only thinner (their gaps are
narrow), and the accidents of random sampling (too few samples are missing).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.viewpoints.boundary import plane_fits
from scanmotion.viewpoints.loops import compactness, facing, ordered_loop
from scanmotion.viewpoints.voids import cell_radii, rim_set

NEIGHBOURS = 24
FIT = 16
PITCH = 8
WEAK = 1.0
"""Radius of an empty disc that joins two larger ones: a gap may be narrower in places."""
LEAST = 1.15
"""Radius of an empty disc that counts, in pitches; evenly spread samples leave 0.7 to 1.1."""
FOLDED = 0.42
"""Thickness of a neighbourhood, in pitches, over which it has no tangent plane; a right angle has 0.45."""
MISSING = 20.0
"""Samples missing in a hole that is worth a viewpoint."""
TINY = 8.0
"""Samples missing in a gap that is worth a word."""
OPEN = 1.24
"""Median radius of the empty discs at a rim against the least that counts: thinned patches reach 1.19."""
ROUND = 0.85
"""Points of a rim against the circle round as many missing samples."""
COMPACT = 0.3
"""4 pi area / perimeter^2 of a rim that looks outwards (the open end of a sheet) and is not merely a line."""
SPARSE = 1.15
"""Pitch of a rim's surrounding against that of the wider surface, over which the patch is merely thin."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rim:
    """Points around one empty region."""

    points: np.ndarray
    """Indices, shape (m,)."""
    opening: np.ndarray
    """Unit vectors into the empty region, shape (m, 3)."""
    missing: float
    """Samples that are missing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sampling:
    """How a cloud samples its surface."""

    tree: cKDTree
    nearest: np.ndarray
    """Indices of each point's NEIGHBOURS nearest, itself first, shape (n, NEIGHBOURS + 1)."""
    pitch: np.ndarray
    """Square root of the area per sample, from the 8th neighbour, shape (n,) [m]."""
    unit: np.ndarray
    """Median pitch of the neighbours, shape (n,) [m]."""
    normals: np.ndarray
    """Plane fits, of either sign, shape (n, 3)."""
    flat: np.ndarray
    """Whether the neighbourhood has a tangent plane, shape (n,)."""

    @property
    def points(self) -> np.ndarray:
        """The cloud, shape (n, 3) [m]."""
        return np.asarray(self.tree.data)


def sampling_of(points: np.ndarray) -> Sampling:
    """Neighbours, pitch and plane fits of a cloud, shape (n, 3) [m]."""
    tree = cKDTree(points)
    distance, nearest = tree.query(points, min(NEIGHBOURS + 1, len(points)), workers=-1)
    eighth = min(PITCH, distance.shape[1] - 1)
    pitch = distance[:, eighth] * np.sqrt(np.pi / (eighth + 0.5))
    unit = np.median(pitch[nearest], axis=1)
    fits = plane_fits(points, nearest[:, :FIT])
    unit = np.where(unit > 0, unit, np.median(unit[unit > 0]) if (unit > 0).any() else 1.0)
    thickness = fits.thickness / unit
    limit = max(FOLDED, 2.5 * float(np.median(thickness)))
    return Sampling(
        tree=tree,
        nearest=nearest,
        pitch=pitch,
        unit=unit,
        normals=fits.normals,
        flat=thickness < limit,
    )


def rims_of(sampling: Sampling, *, missing: float = MISSING) -> tuple[list[Rim], list[Rim]]:
    """Rims of the holes, and of gaps that are too small to be planned for."""
    radii = cell_radii(sampling.tree, sampling.normals, sampling.nearest[:, 1:], sampling.unit)
    least = max(LEAST, float(np.percentile(radii, 90)))
    weak = least - (LEAST - WEAK)
    suspects = np.flatnonzero((radii > weak) & sampling.flat)
    if not len(suspects):
        return [], []
    found = rim_set(sampling.tree, sampling.normals, suspects, sampling.unit, least=least, weak=weak)
    order = np.argsort(found.label, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(found.label))[:-1])
    rims = [
        Rim(points=found.points[g], opening=found.opening[g], missing=float(found.missing[label]))
        for label, g in enumerate(groups)
        if found.missing[label] > TINY and np.median(found.reach[g]) > OPEN * least
    ]
    rims = [r for r in rims if _closed(sampling, r) and _surrounding(sampling, r) < SPARSE]
    rims = _joined(sampling, rims)
    return [r for r in rims if r.missing >= missing], [r for r in rims if r.missing < missing]


def _closed(sampling: Sampling, rim: Rim) -> bool:
    """Whether the rim goes round its empty region: the side of a crease is a line that faces nothing."""
    circle = 2.0 * np.sqrt(np.pi * rim.missing)
    if len(rim.points) < ROUND * circle:
        return False
    points = sampling.points[rim.points]
    loop = points[ordered_loop(points)]
    return facing(points, rim.opening) >= 0.5 or compactness(loop) >= COMPACT


def _joined(sampling: Sampling, rims: list[Rim]) -> list[Rim]:
    """Rims that a crease has cut in two, put together again: close, with a folded point between them."""
    points = sampling.points
    parent = np.arange(len(rims))
    for i, one in enumerate(rims):
        unit = float(np.median(sampling.unit[one.points]))
        tree = cKDTree(points[one.points])
        for j in range(i):
            gap, at = tree.query(points[rims[j].points], distance_upper_bound=4.0 * unit)
            k = int(gap.argmin())
            if np.isinf(gap[k]):
                continue
            middle = 0.5 * (points[rims[j].points[k]] + points[one.points[at[k]]])
            if (~sampling.flat[sampling.tree.query_ball_point(middle, 1.5 * unit)]).any():
                parent[parent == parent[j]] = parent[i]
    return [
        _merged([r for r, p in zip(rims, parent, strict=True) if p == root]) for root in np.unique(parent)
    ]


def _merged(rims: list[Rim]) -> Rim:
    if len(rims) == 1:
        return rims[0]
    points = np.concatenate([r.points for r in rims])
    order = np.argsort(points)
    return Rim(
        points=points[order],
        opening=np.concatenate([r.opening for r in rims])[order],
        missing=sum(r.missing for r in rims),
    )


def _surrounding(sampling: Sampling, rim: Rim) -> float:
    """Median pitch of the points round a rim against that of the wider surface."""
    points = sampling.points
    pick = points[rim.points[:: max(1, len(rim.points) // 60)]]
    unit = float(np.median(sampling.unit[rim.points]))
    near = _within(sampling.tree, pick, 4.0 * unit)
    near = np.setdiff1d(near, rim.points)
    wide = _within(sampling.tree, pick[:: max(1, len(pick) // 8)], 20.0 * unit)
    if not len(near):
        return np.inf
    return float(np.median(sampling.pitch[near]) / np.median(sampling.pitch[wide]))


def _within(tree: cKDTree, centres: np.ndarray, radius: float) -> np.ndarray:
    return np.unique(np.concatenate([np.asarray(one, int) for one in tree.query_ball_point(centres, radius)]))
