"""How far a measured cloud lies from its reference, and how much of it it covers; in all, and by region.

Guarantees: every point that is not cut off counts once, at its exact distance from the nearest triangle.
Assumes: the cloud is in the reference's frame. Accuracy and standard deviation are the paper's: mean of the
absolute, standard deviation of the signed distance (Zhang et al., doi 10.3390/act14030139).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.support.streams import fixed_stream
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.sensing.assess import covered_samples, raycaster, signed_distances
from scanmotion.sensing.visibility import tangents

PERCENTILES = (5.0, 50.0, 95.0, 99.0)
FACINGS = ("up", "down", "+x", "-x", "+y", "-y")
BANDS = 4
_SPOT = 20
"""Measured points about a probed one."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Moments of signed distances, positive outside of the reference, all in m."""

    points: int
    mean_abs: float
    """The paper's accuracy."""
    mean_signed: float
    sd_signed: float
    """The paper's standard deviation."""
    rms: float
    signed: tuple[float, ...]
    """PERCENTILES of the signed distance."""
    absolute: tuple[float, ...]
    """PERCENTILES of the absolute distance."""
    least: float
    greatest: float


@dataclass(frozen=True, kw_only=True)
class RegionFigures:
    """One region of the reference."""

    name: str
    spread: Spread | None
    """None where no point lies in it."""
    completeness: float | None
    """Share of its surface that is covered; None for a region without surface."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Deviations:
    """A measured cloud against its reference."""

    points: np.ndarray
    """That count, in the reference's frame, shape (n, 3) [m]."""
    distance: np.ndarray
    """Signed, positive outside, shape (n,) [m]."""
    spread: Spread
    cut: int
    """Points left out because they lie farther off than was asked for."""
    completeness: float | None
    """Share of the reference's surface with a like-facing point near; None where the reference is a cloud."""
    samples: SurfaceSamples | None
    covered: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """Which of the samples, shape (m,)."""
    regions: tuple[RegionFigures, ...] = ()


@dataclass(frozen=True, kw_only=True)
class DeviationLimits:
    """What counts, in m and rad."""

    cover_distance: float = 0.003
    """A piece of reference is covered where a like-facing point lies within this."""
    cover_angle: float = float(np.deg2rad(60.0))
    """Greatest angle between the two normals."""
    cut: float = float("inf")
    """Points farther from the reference than this do not count (table, fixture, clutter)."""
    samples: int = 100_000
    """Of the reference's surface."""


def spread_of(d: np.ndarray) -> Spread:
    """Moments of signed distances, shape (n,) [m].

    Raises:
        InputError: there are none.
    """
    if len(d) == 0:
        raise InputError("no points to assess")
    return Spread(
        points=len(d), mean_abs=float(np.abs(d).mean()),
        mean_signed=float(d.mean()), sd_signed=float(d.std()),
        rms=float(np.sqrt((d * d).mean())), least=float(d.min()), greatest=float(d.max()),
        signed=tuple(float(v) for v in np.percentile(d, PERCENTILES)),
        absolute=tuple(float(v) for v in np.percentile(np.abs(d), PERCENTILES)),
    )  # fmt: skip


def deviations(
    points: np.ndarray,
    normals: np.ndarray,
    part: Part,
    *,
    limits: DeviationLimits | None = None,
    boxes: Mapping[str, np.ndarray] | None = None,
) -> Deviations:
    """Compares a measured cloud with a reference mesh.

    Args:
        points: in the reference's frame, shape (n, 3) [m].
        normals: outward, shape (n, 3); for the covered share.
        part: the reference mesh.
        limits: what counts.
        boxes: regions by name, least and greatest corner in the reference's frame, shape (2, 3) each [m];
            None for bands of height and the six facings.

    Raises:
        InputError: no point is left, or the part is a cloud.
    """
    limits = limits or DeviationLimits()
    d = signed_distances(points, part)
    keep = np.abs(d) <= limits.cut
    if not keep.any():
        raise InputError(
            f"no point lies within {limits.cut * 1e3:g} mm of {part.name}: are both in one frame and unit?"
        )
    p, d = points[keep], d[keep]
    samples = surface_samples(part, limits.samples, rng=fixed_stream("deviation_samples"))
    covered = covered_samples(
        samples, p, normals[keep], distance=limits.cover_distance, angle=limits.cover_angle
    )
    near = raycaster(part).compute_closest_points(
        np.ascontiguousarray(p, np.float32), nthreads=allowed_threads()
    )
    facing = near["primitive_normals"].numpy()
    at = near["points"].numpy()
    masks = _boxed(at, samples.points, boxes) if boxes else _usual(at, facing, samples, part)
    return Deviations(
        points=p, distance=d, spread=spread_of(d), cut=int((~keep).sum()), completeness=float(covered.mean()),
        samples=samples, covered=covered, regions=tuple(_figures(n, a, b, d, covered) for n, a, b in masks),
    )  # fmt: skip


_Mask = tuple[str, np.ndarray, np.ndarray]


def _figures(
    name: str, mine: np.ndarray, surface: np.ndarray, d: np.ndarray, covered: np.ndarray
) -> RegionFigures:
    return RegionFigures(
        name=name, spread=spread_of(d[mine]) if mine.any() else None,
        completeness=float(covered[surface].mean()) if surface.any() else None,
    )  # fmt: skip


def _boxed(p: np.ndarray, q: np.ndarray, boxes: Mapping[str, np.ndarray]) -> list[_Mask]:
    return [(n, *(((x >= b[0]) & (x <= b[1])).all(axis=1) for x in (p, q))) for n, b in boxes.items()]


def _usual(p: np.ndarray, facing: np.ndarray, samples: SurfaceSamples, part: Part) -> list[_Mask]:
    """Bands of height, and which way the nearest surface faces."""
    low, high = part.bounds[:, 2]
    step = max((high - low) / BANDS, 1e-12)
    own, theirs = (np.clip(((x[:, 2] - low) / step).astype(int), 0, BANDS - 1) for x in (p, samples.points))
    masks = []
    for k in range(BANDS):
        name = f"z {(low + k * step) * 1e3:.0f} to {(low + (k + 1) * step) * 1e3:.0f} mm"
        masks.append((name, own == k, theirs == k))
    own, theirs = _facing(facing), _facing(samples.normals)
    return masks + [(f"facing {f}", own == k, theirs == k) for k, f in enumerate(FACINGS)]


def _facing(normals: np.ndarray) -> np.ndarray:
    """Index into FACINGS of the axis that a normal is nearest to, shape (n,)."""
    both = np.stack(
        [normals[:, 2], -normals[:, 2], normals[:, 0], -normals[:, 0], normals[:, 1], -normals[:, 1]]
    )
    return both.argmax(axis=0)


def deviations_at_points(points: np.ndarray, reference: Part, *, cut: float = 0.005) -> Deviations:
    """Compares a measured cloud with probed points, as a coordinate measuring machine gives them.

    Each probed point is held against the quadratic surface through its nearest measured points; the sign is
    positive where the measurement lies outside of the probed point, by the probed point's normal.

    Args:
        points: measured, in the reference's frame, shape (n, 3) [m].
        reference: a cloud with normals.
        cut: probed points farther than this from any measured one are not covered [m].

    Raises:
        InputError: the reference has no normals, or nothing is near.
    """
    if reference.normals is None:
        raise InputError(f"{reference.name}: probed points need normals for the sign of a distance")
    if len(points) < _SPOT:
        raise InputError(f"{len(points)} points are too few to assess")
    far, k = cKDTree(points).query(reference.vertices, k=_SPOT)
    covered = far[:, 0] <= cut
    if not covered.any():
        raise InputError(
            f"no measured point lies within {cut * 1e3:g} mm of {reference.name}: are both in one frame?"
        )
    spots = points[k[covered]]
    centre = spots.mean(axis=1)
    offset = spots - centre[:, None]
    plane = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset))[1][:, :, 0]
    plane *= np.where(np.einsum("ij,ij->i", plane, reference.normals[covered]) < 0, -1.0, 1.0)[:, None]
    d = _heights(spots - reference.vertices[covered][:, None], plane)
    return Deviations(
        points=reference.vertices[covered], distance=d, spread=spread_of(d), cut=int((~covered).sum()),
        completeness=float(covered.mean()), samples=None, covered=covered,
    )  # fmt: skip


def _heights(offset: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Height of the quadratic surface through points about each origin, along the normal there.

    Args:
        offset: the points less the origin, shape (n, k, 3) [m].
        normal: unit, shape (n, 3).
    """
    u, v = tangents(normal)
    size = np.linalg.norm(offset, axis=2).max(axis=1)
    x = np.einsum("nki,ni->nk", offset, u) / size[:, None]
    y = np.einsum("nki,ni->nk", offset, v) / size[:, None]
    A = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    return np.einsum("nk,nk->n", np.linalg.pinv(A)[:, 0], np.einsum("nki,ni->nk", offset, normal))
