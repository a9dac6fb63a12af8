"""The fastest speed along a path without a jerk limit, by reachability analysis (TOPP-RA).

Pham and Pham 2018, doi:10.1109/TRO.2018.2819195. Compiled here because each transit is solved some fifteen
times; the tests hold it against the toppra library. Speed limits are pooled over neighbouring grid points,
for taken at the points alone they are passed between them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanmotion.geometry.jit import njit
from scanmotion.motion.profile.spline import JointSpline

MARGIN = 5e-4
"""Share of every limit that is left unused, for what happens between the checked instants."""
_GRID = 180
_PER_SPAN = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Limits:
    """What the axes and the scanner may do; all positive."""

    v: np.ndarray
    """Greatest joint velocities, shape (7,) [rad/s]."""
    a: np.ndarray
    """Greatest joint accelerations, shape (7,) [rad/s2]."""
    j: np.ndarray
    """Greatest joint jerks, shape (7,) [rad/s3]."""
    tcp: float
    """Greatest speed of the scanner [m/s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Derivatives:
    """The path and its derivatives with respect to s on a grid."""

    s: np.ndarray
    """Increasing from 0, shape (n,)."""
    q1: np.ndarray
    """dq/ds, shape (n, 7); q2 and q3 are the second and third derivatives."""
    q2: np.ndarray
    q3: np.ndarray
    tcp: Callable[[np.ndarray], np.ndarray]
    """|dp/ds| of the scanner's origin [m], shape (k,), at any s (k,)."""


def parameter_grid(path: JointSpline, *, spacing: float = 1.0) -> np.ndarray:
    """Grid over [0, path.end] with points on the spline's knots, finer at both ends where a law rests."""
    spans = len(path.curve.c) - path.curve.k
    cells = spans * int(np.ceil(max(_GRID / spans, _PER_SPAN) / spacing))
    even = np.linspace(0.0, path.end, cells + 1)
    finer = even[1] / 2.0 ** np.arange(5, 0, -1)
    return np.concatenate([[0.0], finer, even[1:-1], path.end - finer[::-1], [path.end]])


def profile_floor(d: Derivatives, limits: Limits) -> float:
    """Duration of the fastest law without a jerk limit [s]."""
    cap = speed_caps(d, d.tcp(d.s), limits)
    return profile_seconds(d.s, fastest_profile(d, cap, np.tile(limits.a, (len(d.s), 1))))


def speed_caps(d: Derivatives, tcp: np.ndarray, limits: Limits) -> np.ndarray:
    """Greatest (ds/dt)^2 at each grid point, the least over it and its neighbours: none is passed between."""
    rate = np.maximum((np.abs(d.q1) / limits.v).max(axis=1), tcp / limits.tcp)
    pooled = rate.copy()
    pooled[1:] = np.maximum(pooled[1:], rate[:-1])
    pooled[:-1] = np.maximum(pooled[:-1], rate[1:])
    return ((1 - MARGIN) / np.maximum(pooled, 1e-12)) ** 2


def fastest_profile(d: Derivatives, cap: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(ds/dt)^2 on the grid, rest to rest, the pointwise greatest."""
    return _forward(d.s, d.q1, d.q2, a, _controllable(d.s, d.q1, d.q2, a, cap))


def profile_seconds(s: np.ndarray, x: np.ndarray) -> float:
    """Duration of the profile x = (ds/dt)^2, linear in s between grid points [s]."""
    v = np.sqrt(x)
    return float((2 * np.diff(s) / np.maximum(v[:-1] + v[1:], 1e-9)).sum())


@njit(cache=True)
def _controllable(
    s: np.ndarray, q1: np.ndarray, q2: np.ndarray, a: np.ndarray, cap: np.ndarray
) -> np.ndarray:
    """Backward pass: the greatest x = (ds/dt)^2 at each grid point from which the end can be met at rest.

    In each cell u = d2s/dt2 is constant; |q1 u + q2 x| <= a is asked at both ends of the cell. The bounds on
    u are lines in x, so the greatest x at which the upper ones stay above the lower ones is the least over
    pairs of where the two lines cross.
    """
    n, m = q1.shape
    reach = np.zeros(n)
    upper = np.zeros((2 * m + 1, 2))
    lower = np.zeros((2 * m + 1, 2))
    for i in range(n - 2, -1, -1):
        h = s[i + 1] - s[i]
        best = cap[i]
        count = 0
        for end in range(2):
            for j in range(m):
                bend = q2[i + end, j]
                slope = q1[i + end, j] + (2.0 * h * bend if end else 0.0)
                limit = a[i + end, j]
                if abs(slope) < 1e-12 * max(1.0, abs(bend)):
                    if abs(bend) > 0.0:
                        best = min(best, limit / abs(bend))
                    continue
                upper[count, 0], upper[count, 1] = limit / abs(slope), -bend / slope
                lower[count, 0], lower[count, 1] = -limit / abs(slope), -bend / slope
                count += 1
        upper[count, 0], upper[count, 1] = reach[i + 1] / (2.0 * h), -1.0 / (2.0 * h)
        lower[count, 0], lower[count, 1] = 0.0, -1.0 / (2.0 * h)
        count += 1
        for k in range(count):
            for r in range(count):
                fall = lower[r, 1] - upper[k, 1]
                if fall > 0.0:
                    best = min(best, (upper[k, 0] - lower[r, 0]) / fall)
        reach[i] = max(best, 0.0)
    return reach


@njit(cache=True)
def _forward(s: np.ndarray, q1: np.ndarray, q2: np.ndarray, a: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Forward pass from rest: at each cell the greatest acceleration that stays controllable."""
    n, m = q1.shape
    x = np.zeros(n)
    for i in range(n - 1):
        h = s[i + 1] - s[i]
        u = (reach[i + 1] - x[i]) / (2.0 * h)
        for end in range(2):
            for j in range(m):
                bend = q2[i + end, j]
                slope = q1[i + end, j] + (2.0 * h * bend if end else 0.0)
                if abs(slope) >= 1e-12 * max(1.0, abs(bend)):
                    u = min(u, a[i + end, j] / abs(slope) - bend / slope * x[i])
        x[i + 1] = min(max(x[i] + 2.0 * h * u, 0.0), reach[i + 1])
    return x
