"""Figures on spheres, ball bars and planes, in the manner of ISO 10360-13 and VDI/VDE 2634 part 3.

ISO 10360-13:2021 (optical 3D systems) and VDI/VDE 2634-3 (several views) ask for: probing form and size on a
sphere, distortion (sphere spacing, size and form), flat form. What is computed here follows their definitions
as they are commonly stated: fits by least squares, form from the points that remain when the worst 3 per
thousand are rejected (VDI/VDE 2634), and from the best 95 % (ISO, D95%). It is not an accredited acceptance
test: number and places of the artefacts are the user's.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from scanmotion.core.errors import InputError

REJECTED = 0.003
"""Share of the points that VDI/VDE 2634 allows to be rejected."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Ball:
    """A sphere fitted by least squares."""

    centre: np.ndarray
    """Shape (3,) [m]."""
    diameter: float
    """[m]."""
    form_all: float
    """Range of the radial distances, the worst 3 per thousand rejected [m]: PF of VDI/VDE 2634."""
    form_95: float
    """Least range that holds 95 % of them [m]: P_Form.Sph.D95% of ISO 10360-13."""
    size_error: float | None
    """Diameter less the nominal one [m]: PS, P_Size.Sph; None where none is known."""
    points: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Plane:
    """A plane fitted by least squares."""

    point: np.ndarray
    normal: np.ndarray
    flatness: float
    """Range of the distances, the worst 3 per thousand rejected [m]: F of VDI/VDE 2634."""
    form_95: float
    """Least range that holds 95 % of them [m]: D_Form.Pla.D95% of ISO 10360-13."""
    points: int


@dataclass(frozen=True, eq=False, kw_only=True)
class BallBar:
    """Two spheres."""

    balls: tuple[Ball, Ball]
    spacing: float
    """Of the centres [m]."""
    spacing_error: float | None
    """Less the nominal one [m]: SD of VDI/VDE 2634, D_CC of ISO 10360-13; None where none is known."""


def ball_from(points: np.ndarray, *, nominal: float | None = None) -> Ball:
    """Fits a sphere.

    Args:
        points: shape (n, 3) [m].
        nominal: calibrated diameter [m].

    Raises:
        InputError: fewer than 20 points, or no sphere in them.
    """
    p = np.asarray(points, float)
    if len(p) < 20:
        raise InputError(f"{len(p)} points are too few for a sphere")
    middle = p.mean(axis=0)
    q = p - middle
    # Linear first: |q|^2 = 2 c.q + (r^2 - |c|^2). Then the distances themselves, without gross errors.
    A = np.hstack([2 * q, np.ones((len(q), 1))])
    (x, y, z, k), _, rank, _ = np.linalg.lstsq(A, (q * q).sum(axis=1), rcond=None)
    if rank < 4 or k + x * x + y * y + z * z <= 0:
        raise InputError("the points lie on a plane or a line, not on a sphere")
    slopes: Any = _radial_slopes
    start = np.array([x, y, z, np.sqrt(k + x * x + y * y + z * z)])
    keep = np.ones(len(q), bool)
    for _ in range(3):
        fit = least_squares(_radial, start, jac=slopes, args=(q[keep],), method="lm", xtol=1e-14, ftol=1e-14)
        start = fit.x
        off = np.abs(_radial(start, q))
        keep = off <= np.quantile(off, 1 - REJECTED)
    radial = _radial(start, q)
    return Ball(
        centre=start[:3] + middle, diameter=2 * float(start[3]), form_all=_range(radial, 1 - REJECTED),
        form_95=_range(radial, 0.95), points=len(p),
        size_error=None if nominal is None else 2 * float(start[3]) - nominal,
    )  # fmt: skip


def _radial(x: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.linalg.norm(q - x[:3], axis=1) - x[3]


def _radial_slopes(x: np.ndarray, q: np.ndarray) -> np.ndarray:
    towards = (x[:3] - q) / np.linalg.norm(q - x[:3], axis=1, keepdims=True)
    return np.hstack([towards, -np.ones((len(q), 1))])


def _range(d: np.ndarray, share: float) -> float:
    """Least interval that holds `share` of the values."""
    ordered = np.sort(d)
    k = max(int(np.ceil(share * len(d))), 1)
    return float((ordered[k - 1 :] - ordered[: len(d) - k + 1]).min())


def plane_from(points: np.ndarray) -> Plane:
    """Fits a plane.

    Args:
        points: shape (n, 3) [m].

    Raises:
        InputError: fewer than 20 points, or all on a line.
    """
    p = np.asarray(points, float)
    if len(p) < 20:
        raise InputError(f"{len(p)} points are too few for a plane")
    keep, normal, middle = np.ones(len(p), bool), np.zeros(3), np.zeros(3)
    for _ in range(3):
        middle = p[keep].mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((p[keep] - middle).T))
        if values[1] <= 1e-12 * values[2]:
            raise InputError("the points lie on a line, not on a plane")
        normal = vectors[:, 0]
        off = np.abs((p - middle) @ normal)
        keep = off <= np.quantile(off, 1 - REJECTED)
    d = (p - middle) @ normal
    return Plane(
        point=middle, normal=normal, flatness=_range(d, 1 - REJECTED), form_95=_range(d, 0.95), points=len(p)
    )


def ball_bar_from(
    points: np.ndarray, *, diameter: float | None = None, spacing: float | None = None
) -> BallBar:
    """Fits the two spheres of a ball bar: the points are parted in two along their longest axis.

    Args:
        points: of both spheres, without the bar between them, shape (n, 3) [m].
        diameter: calibrated, of both spheres [m].
        spacing: calibrated, of the centres [m].

    Raises:
        InputError: as ball_from.
    """
    p = np.asarray(points, float)
    if len(p) < 40:
        raise InputError(f"{len(p)} points are too few for two spheres")
    along = (p - p.mean(axis=0)) @ np.linalg.eigh(np.cov((p - p.mean(axis=0)).T))[1][:, 2]
    split = _widest_gap(along)
    first, second = (ball_from(p[side], nominal=diameter) for side in (along < split, along >= split))
    found = float(np.linalg.norm(first.centre - second.centre))
    return BallBar(
        balls=(first, second), spacing=found, spacing_error=None if spacing is None else found - spacing
    )


def _widest_gap(values: np.ndarray) -> float:
    """Where the ordered values are farthest apart, between their fifth and ninety-fifth percentile."""
    inner = np.sort(values)
    inner = inner[int(0.05 * len(inner)) : int(0.95 * len(inner)) + 1]
    k = int(np.diff(inner).argmax())
    return float(inner[k] + inner[k + 1]) / 2
