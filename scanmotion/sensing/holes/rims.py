"""The rims of a cloud's holes: empty regions that are large enough, on one sheet, in a dense cloud.

Three things look like holes to the largest angle and are none; each is told by what it is:
creases and rims of thin walls (the neighbourhood has no plane), patches that are only thinner (their gaps are
narrow), and the accidents of random sampling (too few samples are missing).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.support.threads import allowed_threads
from scanmotion.sensing.holes.boundary import plane_fits
from scanmotion.sensing.holes.loops import facing, inscribed_radius, ordered_loop
from scanmotion.sensing.holes.voronoi_gaps import RimSet, cell_radii, rim_set

NEIGHBOURS = 24
FIT = 16
PITCH = 8
WEAK = 1.0
"""Radius of an empty disc that joins two larger ones: a gap may be narrower in places."""
AVERAGED = 0.1
"""What it takes more in averaged clouds, whose sparse parts stay sparse: there two holes would be joined."""
LEAST = 1.15
"""Radius of an empty disc that counts, in pitches; even samples leave 0.7 to 1.1, random ones 1.5."""
EVEN, RANDOM = 1.05, 2.3
"""90th percentile of the largest empty discs up to which samples are even; both radii grow so beyond it."""
FOLDED, BENT = 0.42, 0.6
"""Thickness of a neighbourhood, in pitches, from which it may have no tangent plane (a right angle has 0.45),
and from which it surely has none."""
CREASED, CROWDED = 0.2, 0.97
"""Share of folded points from which a rim must look at another part of it and must not be denser than what is
around it, as sheets that meet are."""
TINY = 8.0
"""Samples missing in a gap that is worth a word."""
OPEN = 1.43
"""Radius of a wide empty disc, in pitches: half of those at a patch thinned by half are under 1.37."""
CORE = 20.0
"""Samples missing at the wide discs of a hole that is worth a viewpoint; more where sampling is random."""
THIN, SURE = 1.06, 1.09
"""Pitch at a rim against that around it from which the patch may be, and surely is, thinner."""
NARROW, BROAD, BROAD_AT = 0.4, 2.9, 5
"""Share of wide discs under which the patch at a surely thinner rim is only thinner, however large: the wide
gaps that chance leaves in it grow in number with its area, not in share. But five points at discs of 2.9
pitches, no fold near, are no chance: where a scan thins out towards a shadow, the shadow is a hole."""
DOUBT = 25.0
"""Further samples that must be missing in a thin patch: a third if most discs are wide, twice if folded."""
AROUND = 20.0
"""Pitches around a rim that tell the usual pitch there."""
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
    plain: bool = True
    """Whether enough are missing for a viewpoint."""


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
    fold: np.ndarray
    """Thickness of the neighbourhood, in pitches, less in noisy clouds; folded over FOLDED, shape (n,)."""

    @property
    def points(self) -> np.ndarray:
        """The cloud, shape (n, 3) [m]."""
        return np.asarray(self.tree.data)


def sampling_of(points: np.ndarray) -> Sampling:
    """Neighbours, pitch and plane fits of a cloud, shape (n, 3) [m]."""
    tree = cKDTree(points)
    distance, nearest = tree.query(points, min(NEIGHBOURS + 1, len(points)), workers=allowed_threads())
    eighth = min(PITCH, distance.shape[1] - 1)
    pitch = distance[:, eighth] * np.sqrt(np.pi / (eighth + 0.5))
    unit = np.median(pitch[nearest], axis=1)[nearest].mean(axis=1)
    fits = plane_fits(points, nearest[:, :FIT])
    unit = np.where(unit > 0, unit, np.median(unit[unit > 0]) if (unit > 0).any() else 1.0)
    thickness = fits.thickness / unit
    noisy = max(1.0, 2.5 * float(np.median(thickness)) / FOLDED)
    return Sampling(
        tree=tree,
        nearest=nearest,
        pitch=pitch,
        unit=unit,
        normals=fits.normals,
        fold=thickness / noisy,
    )


def rims_of(sampling: Sampling, *, averaged: bool = False) -> tuple[list[Rim], list[Rim]]:
    """Rims of the holes, and of gaps that are too small to be planned for.

    Args:
        sampling: of the cloud.
        averaged: whether its points are means of others.
    """
    radii = cell_radii(sampling.tree, sampling.normals, sampling.nearest[:, 1:], sampling.unit)
    usual = float(np.percentile(radii, 90))
    random = RANDOM * max(usual - EVEN, 0.0)
    weak = WEAK + random + (AVERAGED if averaged else 0.0)
    suspects = np.flatnonzero((radii > weak) & (sampling.fold < BENT))
    if not len(suspects):
        return [], []
    found = rim_set(
        sampling.tree, sampling.normals, suspects, sampling.unit, least=max(LEAST, weak), weak=weak
    )
    order = np.argsort(found.label, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(found.label))[:-1])
    rims = [_open_rim(sampling, found, g, usual) for g in groups if found.missing[found.label[g[0]]] > TINY]
    whole = [r for r in rims if r is not None and (_facing(sampling, r) > HALF / 2 or _closed(sampling, r))]
    rims = [r for r in _joined(sampling, whole) if _closed(sampling, r)]
    return [r for r in rims if r.plain], [r for r in rims if not r.plain]


def _open_rim(sampling: Sampling, found: RimSet, group: np.ndarray, usual: float) -> Rim | None:
    """The rim of a region whose discs are wide, without the narrow gaps that happen to join it.

    A patch that is only thinner has narrow gaps throughout, and its pitch is wider than that around it: what
    is missing near its wide discs must then be more. Where a cloud gets sparse towards a hole, narrow gaps
    fray its rim and are left out.
    """
    index = found.points[group]
    missing = float(found.missing[found.label[group[0]]])
    wide = found.reach[group] > max(OPEN, 1.21 * usual)
    if not wide.any():
        return None
    sparse = _sparseness(sampling, index)
    folded = float((sampling.fold[index[wide]] > FOLDED).mean())
    if _is_crease(sampling, index[wide], found.opening[group[wide]], folded, sparse):
        return None
    frayed = wide.mean() < 0.5
    thin = (sparse - 0.4 * max(usual - EVEN, 0.0) - THIN) / (SURE - THIN)
    broad = folded <= CREASED and int((found.reach[group] > BROAD).sum()) >= BROAD_AT
    if thin >= 1.0 and wide.mean() < NARROW and not broad:
        return None
    doubt = DOUBT * (1.0 if frayed else 1.0 / 3.0) * (2.0 if folded > CREASED else 1.0)
    core = float(found.excess[group][wide].sum())
    needed = CORE * max(1.0, 1.08 * usual / LEAST) ** 2 + doubt * float(np.clip(thin, 0.0, 1.0))
    if frayed:
        if core < needed:
            return None
        points = sampling.points[index]
        near = cKDTree(points[wide]).query(points)[0] < 1.5 * float(np.median(sampling.unit[index]))
        missing = float(found.excess[group][near].sum())
        group = group[near]
    return Rim(
        points=found.points[group], opening=found.opening[group], missing=missing, plain=core >= needed
    )


def _is_crease(
    sampling: Sampling, index: np.ndarray, opening: np.ndarray, folded: float, sparse: float
) -> bool:
    """Whether points at wide discs are where sheets meet.

    They are if most are folded, or if some are and they look at nothing or are denser than what is around.
    """
    if folded <= CREASED:
        return False
    return folded > HALF or sparse < CROWDED or facing(sampling.points[index], opening) < HALF


def _sparseness(sampling: Sampling, index: np.ndarray) -> float:
    """Pitch at some points against the lower quartile of that within AROUND pitches of them."""
    unit = float(np.median(sampling.unit[index]))
    some = sampling.points[index[:: max(1, len(index) // 20)]]
    around = np.unique(np.concatenate(sampling.tree.query_ball_point(some, AROUND * unit)))
    return unit / float(np.percentile(sampling.unit[around.astype(int)], 25))


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
            if (sampling.fold[sampling.tree.query_ball_point(middle, 1.5 * unit)] > FOLDED).any():
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
        plain=any(r.plain for r in rims),
    )
