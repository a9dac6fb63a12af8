"""Smooth joint curves: a cubic B-spline beside a checked polyline, or a quintic one through given points."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

STEP_RAD = 0.06
"""Greatest joint step between control points; a corner is then cut by less than a quarter of it [rad]."""
STEP_M = 0.02
"""Greatest step of the scanner between control points [m]."""
_LEAST_SPANS = 4


@dataclass(frozen=True, eq=False)
class JointSpline:
    """A curve q(u) over u in [0, end] with bounded third derivative."""

    curve: BSpline
    end: float

    def __call__(self, u: np.ndarray, order: int = 0) -> np.ndarray:
        """Derivative of the given order with respect to u, shape (n, 7)."""
        return self.curve(np.clip(u, 0.0, self.end), nu=order)


def subdivided(
    q: np.ndarray, p: np.ndarray, *, step_rad: float = STEP_RAD, step_m: float = STEP_M
) -> np.ndarray:
    """The polyline with points put into its long edges; its vertices stay, a dense polyline stays as it is.

    Args:
        q: vertices, shape (k, 7) [rad].
        p: position of the scanner at each vertex, shape (k, 3) [m].
        step_rad: greatest joint step [rad].
        step_m: greatest step of the scanner, measured along its chord [m].
    """
    steps = step_counts(q, p, step_rad=step_rad, step_m=step_m)
    counts = np.maximum(np.ceil(steps - 1e-6).astype(int), 1)
    if counts.sum() < _LEAST_SPANS:
        counts = np.maximum(counts, -(-_LEAST_SPANS // max(len(counts), 1)))
    edge = np.repeat(np.arange(len(counts)), counts)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    fraction = (np.arange(len(edge)) - first[edge]) / counts[edge]
    inner = q[edge] + fraction[:, None] * (q[edge + 1] - q[edge])
    return np.vstack([inner, q[-1:]])


def step_counts(
    q: np.ndarray, p: np.ndarray, *, step_rad: float = STEP_RAD, step_m: float = STEP_M
) -> np.ndarray:
    """How many steps each edge of the polyline is long, shape (k - 1,); arguments as for `subdivided`."""
    steps = np.abs(np.diff(q, axis=0)).max(axis=1) / step_rad
    return np.maximum(steps, np.linalg.norm(np.diff(p, axis=0), axis=1) / step_m)


def evenly_spaced(
    q: np.ndarray, p: np.ndarray, *, step_rad: float = STEP_RAD, step_m: float = STEP_M
) -> np.ndarray:
    """Points on the polyline at even distances, none longer than a step; corners between points are cut.

    A spline's parameter then runs evenly, which a smooth law needs. Arguments as for `subdivided`.
    """
    place = np.concatenate([[0.0], np.cumsum(step_counts(q, p, step_rad=step_rad, step_m=step_m))])
    at = np.linspace(0.0, place[-1], max(int(np.ceil(1.02 * place[-1])), _LEAST_SPANS) + 1)
    out = np.column_stack([np.interp(at, place, column) for column in q.T])
    out[0], out[-1] = q[0], q[-1]
    return out


def spline_beside(control: np.ndarray) -> JointSpline:
    """Uniform cubic B-spline with these control points; it starts and ends at the first and the last.

    Each of its points lies in the convex hull of four neighbouring control points; at a control point P1
    between P0 and P2 it passes (P0 - 2 P1 + P2) / 6 beside it. On a straight, evenly spaced control polygon
    it is the straight line itself.

    Args:
        control: shape (m, 7), m >= 2 [rad].
    """
    m = len(control)
    padded = np.vstack([2 * control[0] - control[1], control, 2 * control[-1] - control[-2]])
    return JointSpline(BSpline(np.arange(-3.0, m + 3.0), padded, 3), float(m - 1))


def spline_through(q: np.ndarray, at: np.ndarray) -> JointSpline:
    """Interpolating spline of odd degree <= 5 with q(at[i]) = q[i].

    Args:
        q: shape (k, 7), k >= 2 [rad].
        at: increasing parameters from 0, shape (k,).
    """
    degree = min(5, len(q) - 1)
    degree -= 1 - degree % 2
    return JointSpline(make_interp_spline(at, q, k=degree), float(at[-1]))


def corner_cut(control: np.ndarray) -> float:
    """Greatest joint distance between `spline_beside(control)` and its control polygon, an upper bound [rad].

    With D[i] = P[i-1] - 2 P[i] + P[i+1], the curve on span i is the straight line from P[i] to P[i+1] plus
    (1 - u)^3 D[i] / 6 + u^3 D[i+1] / 6, and (1 - u)^3 + u^3 <= 1: no more than max |D| / 6.
    """
    if len(control) < 3:
        return 0.0
    return float(np.linalg.norm(np.diff(control, n=2, axis=0), axis=1).max() / 6)
