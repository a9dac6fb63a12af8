"""The rims of a cloud's holes: empty regions that are large enough, on one sheet, in a dense cloud.

Three things look like holes to the largest angle and are none; each is told by what it is:
creases and rims of thin walls (the neighbourhood has no plane), patches that are only thinner (their gaps are
narrow), and the accidents of random sampling (too few samples are missing).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.viewpoints.boundary import plane_fits
from scanmotion.viewpoints.loops import facing, inscribed_radius, ordered_loop
from scanmotion.viewpoints.voids import RimSet, cell_radii, rim_set

NEIGHBOURS = 24
FIT = 16
PITCH = 8
WEAK = 1.0
"""Radius of an empty disc that joins two larger ones: a gap may be narrower in places."""
LEAST = 1.15
"""Radius of an empty disc that counts, in pitches; even samples leave 0.7 to 1.1, random ones 1.5."""
FOLDED = 0.42
"""Thickness of a neighbourhood, in pitches, over which it has no tangent plane; a right angle has 0.45."""
MISSING = 20.0
"""Samples missing in a hole that is worth a viewpoint; more where the sampling is random."""
TINY = 8.0
"""Samples missing in a gap that is worth a word."""
OPEN = 1.43
"""Median radius of the empty discs at a rim, in pitches: patches thinned by half reach 1.37."""
CORE = 28.0
"""Samples missing at the wide discs of a frayed rim."""
HALF = 0.5
"""Share of a rim that must look at another part of it; half as much where the rim is an open edge."""
ROUND = 0.6
"""Points of a rim against the circle round as many missing samples."""


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
    """Smoothed pitch: mean over the neighbours of their neighbours' medians, shape (n,) [m]."""
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
    unit = np.median(pitch[nearest], axis=1)[nearest].mean(axis=1)
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
    usual = float(np.percentile(radii, 90))
    least, weak = max(LEAST, 1.08 * usual), max(WEAK, 1.05 * usual)
    missing = missing * (least / LEAST) ** 2
    suspects = np.flatnonzero((radii > weak) & sampling.flat)
    if not len(suspects):
        return [], []
    found = rim_set(sampling.tree, sampling.normals, suspects, sampling.unit, least=least, weak=weak)
    order = np.argsort(found.label, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(found.label))[:-1])
    rims = [_open_rim(sampling, found, g, least) for g in groups if found.missing[found.label[g[0]]] > TINY]
    whole = [r for r in rims if r is not None and (_facing(sampling, r) > HALF / 2 or _closed(sampling, r))]
    rims = [r for r in _joined(sampling, whole) if _closed(sampling, r)]
    return [r for r in rims if r.missing >= missing], [r for r in rims if r.missing < missing]


def _open_rim(sampling: Sampling, found: RimSet, group: np.ndarray, least: float) -> Rim | None:
    """The rim of a region whose discs are wide, without the narrow gaps that happen to join it.

    A patch that is only thinner has narrow gaps throughout: half of its rim's discs are under OPEN. Where a
    cloud gets sparse towards a hole, such gaps fray its rim: what is left near the wide discs must then miss
    enough samples by itself.
    """
    missing = float(found.missing[found.label[group[0]]])
    wide = found.reach[group] > max(OPEN, 1.12 * least)
    if wide.mean() < 0.5:
        if not wide.any():
            return None
        points = sampling.points[found.points[group]]
        unit = float(np.median(sampling.unit[found.points[group]]))
        near = cKDTree(points[wide]).query(points)[0] < 1.5 * unit
        missing = float(found.excess[group][near].sum())
        if found.excess[group][wide].sum() < CORE:
            return None
        group = group[near]
    return Rim(points=found.points[group], opening=found.opening[group], missing=missing)


def _closed(sampling: Sampling, rim: Rim) -> bool:
    """Whether the rim goes round its empty region: the side of a crease is a line that faces nothing."""
    circle = 2.0 * np.sqrt(np.pi * rim.missing)
    if len(rim.points) < ROUND * circle:
        return False
    if _facing(sampling, rim) >= HALF:
        return True
    points = sampling.points[rim.points]
    unit = float(np.median(sampling.unit[rim.points]))
    loop = points[ordered_loop(points)]
    longest = np.linalg.norm(loop - np.roll(loop, -1, axis=0), axis=1).max()
    return bool(inscribed_radius(loop) > (3.0 if longest < 6.0 * unit else 8.0) * unit)


def _facing(sampling: Sampling, rim: Rim) -> float:
    return facing(sampling.points[rim.points], rim.opening)


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
