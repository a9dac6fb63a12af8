"""Few points that stand for a sampled path: for straight moves, and for a spline in time."""

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline


def polyline_knots(path: np.ndarray, tolerance: float, *, most: int) -> tuple[np.ndarray, float]:
    """Samples whose straight connections pass every other sample within a tolerance (Douglas-Peucker).

    Args:
        path: samples in order, shape (n, k).
        tolerance: greatest distance in the maximum norm; doubled until `most` knots suffice.
        most: greatest number of knots, at least 2.

    Returns:
        Indices of the knots, the first and last sample among them, and the greatest distance that remains.
    """
    knots, rest = _douglas_peucker(path, tolerance)
    while len(knots) > most:
        tolerance *= 2
        knots, rest = _douglas_peucker(path, tolerance)
    return knots, rest


def _douglas_peucker(path: np.ndarray, tolerance: float) -> tuple[np.ndarray, float]:
    kept, open_spans, rest = {0, len(path) - 1}, [(0, len(path) - 1)], 0.0
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        away = _beside(path[first + 1 : last], path[first], path[last])
        worst = int(away.argmax())
        if away[worst] <= tolerance:
            rest = max(rest, float(away[worst]))
            continue
        middle = first + 1 + worst
        kept.add(middle)
        open_spans += [(first, middle), (middle, last)]
    return np.array(sorted(kept)), rest


def _beside(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Maximum-norm distance of points from their foot points on the segment from a to b."""
    along = b - a
    square = float(along @ along)
    share = np.clip((points - a) @ along / square, 0, 1) if square > 0 else np.zeros(len(points))
    return np.abs(points - a - share[:, None] * along).max(axis=1)


def way_back_knots(
    t: np.ndarray, path: np.ndarray, knots: np.ndarray, tolerance: float, *, shortest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Knots that are close enough to go back along straight lines, and which of them that takes.

    Args:
        t: times, shape (n,) [s].
        path: samples in order, shape (n, k).
        knots: indices of samples, the first and last sample among them, shape (m,).
        tolerance: greatest distance of a sample from the straight line past it, as far as `shortest` allows.
        shortest: no knot is added closer to another one [s].

    Returns:
        the knots with those that were added between them, and those of them on the way back, both as
        indices of samples.
    """
    kept, spans = {0, len(path) - 1}, [(0, len(path) - 1)]
    fine = set(knots.tolist())
    while spans:
        a, b = spans.pop()
        away = _beside(path[a : b + 1], path[a], path[b])
        if away.max() <= tolerance:
            continue
        known = [k for k in fine if a < k < b]
        worst = a + int(away.argmax())
        middle = min(known, key=lambda k: abs(k - worst)) if known else (a + b) // 2
        if not known and min(t[middle] - t[a], t[b] - t[middle]) < shortest:
            continue
        fine.add(middle)
        kept.add(middle)
        spans += [(a, middle), (middle, b)]
    return np.array(sorted(fine)), np.array(sorted(kept))


def spline_knots(
    t: np.ndarray, q: np.ndarray, tolerance: float, *, longest: float, shortest: float, most: int
) -> tuple[np.ndarray, float]:
    """Samples through which a cubic spline, at rest at both ends, follows a motion within a tolerance.

    Args:
        t: times, shape (n,) [s].
        q: positions, shape (n, k).
        tolerance: greatest deviation of any component at any sample, where `shortest` and `most` allow it.
        longest: no two knots are further apart [s], as far as the samples allow it.
        shortest: no knot is set closer to another one [s].
        most: greatest number of knots.

    Returns:
        Indices of the knots, the first and last sample among them, and the greatest deviation that remains.
    """
    spans = max(int(np.ceil((t[-1] - t[0]) / longest - 1e-9)), 1)
    knots = np.unique(np.searchsorted(t, np.linspace(t[0], t[-1], min(spans, most - 1) + 1) - 1e-9))
    knots = knots[np.append(True, np.any(q[knots[1:]] != q[knots[:-1]], axis=1))]
    knots = np.unique([0, *knots, len(t) - 1])
    while True:
        away = np.abs(CubicSpline(t[knots], q[knots], bc_type="clamped")(t) - q).max(axis=1)
        fresh = []
        for a, b in pairwise(knots):
            room = np.flatnonzero((t[a:b] - t[a] >= shortest) & (t[b] - t[a:b] >= shortest)) + a
            if away[a:b].max() > tolerance and len(room):
                # In the middle of the room rather than at the worst sample: knots stay evenly apart.
                fresh.append((away[a:b].max(), room[len(room) // 2]))
        fresh = sorted(fresh, reverse=True)[: max(most - len(knots), 0)]
        if not fresh:
            return knots, float(away.max())
        knots = np.unique([*knots, *(k for _, k in fresh)])


def timed_knots(
    t: np.ndarray, q: np.ndarray, tolerance: float, *, shortest: float, longest: float
) -> np.ndarray:
    """Samples between which even motion in time follows a motion within a tolerance.

    Args:
        t: times, shape (n,) [s].
        q: positions, shape (n, k).
        tolerance: greatest deviation of any component, where `shortest` allows it.
        shortest: no two knots are closer [s].
        longest: no two knots are farther apart [s].

    Returns:
        Indices of the knots, the first and last sample among them.
    """
    kept, spans = {0, len(t) - 1}, [(0, len(t) - 1)]
    while spans:
        a, b = spans.pop()
        if b - a < 2 or t[b] - t[a] < 2 * shortest:
            continue
        share = ((t[a:b] - t[a]) / (t[b] - t[a]))[:, None]
        away = np.abs(q[a] + share * (q[b] - q[a]) - q[a:b]).max()
        if away <= tolerance and t[b] - t[a] <= longest:
            continue
        middle = a + int(np.searchsorted(t[a : b + 1], (t[a] + t[b]) / 2))
        kept.add(middle)
        spans += [(a, middle), (middle, b)]
    return np.array(sorted(kept))
