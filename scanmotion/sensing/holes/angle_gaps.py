"""The angle test of boundary points over a grid of cells as wide as the neighbourhood.

A point is interior when no angle over the threshold is free of neighbours. Neighbours only ever divide gaps,
so from 90 degrees on a point is interior as soon as each octant of its tangent plane holds one: most points
are settled by a few sign comparisons; only the others have all their angles sorted.
"""

import numpy as np

from scanmotion.core.support.threads import by_pieces
from scanmotion.geometry.jit import first_not_less, njit, sort_in_place

_MOST_CELLS = 1 << 20


def exceeds_gap(points: np.ndarray, normals: np.ndarray, radius: float, threshold: float) -> np.ndarray:
    """Whether the largest angle without neighbours is over the threshold.

    Args:
        points: shape (n, 3) [m]. normals: unit vectors, shape (n, 3).
        radius: of the neighbourhood, its rim included [m].
        threshold: [rad].

    Returns:
        Mask, shape (n,); points with fewer than two neighbours off their normal have a gap of 2 pi.
    """
    low = points.min(axis=0)
    side = max(radius, float((points.max(axis=0) - low).max()) / _MOST_CELLS) * (1.0 + 1e-9)
    span = np.floor((points.max(axis=0) - low) / side).astype(np.int64) + 3
    cube = ((points - low) / side).astype(np.int64) + 1
    key = (cube[:, 0] * span[1] + cube[:, 1]) * span[2] + cube[:, 2]
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    cells = key[starts]
    ends = np.append(starts[1:], len(key))
    # rounding must not lose the neighbour whose distance is the radius
    reach = radius * radius * (1.0 + 1e-15)
    out, ordered = np.zeros(len(points), bool), points[order]

    def some(first: int, last: int) -> None:
        _exceeds(out, first, last, ordered, normals, order, cells, starts, ends, span, reach, threshold)

    by_pieces(some, len(cells), least=500)
    return out


@njit(cache=True, nogil=True)
def _exceeds(out, first, last, ordered, normals, order, cells, starts, ends, span, reach, threshold):
    """Into `out` (n,), cell by cell of first..last: the neighbours lie in nine runs of three cells each."""
    for c in range(first, last):
        runs = _runs(cells, starts, ends, c, span)
        most = 0
        for k in range(9):
            most += runs[k, 1] - runs[k, 0]
        angles = np.empty(most)
        for i in range(starts[c], ends[c]):
            u, v = _axes(normals[order[i]])
            if threshold >= 0.5 * np.pi and _surrounded(ordered, i, u, v, runs, reach):
                continue
            out[order[i]] = _largest_gap(ordered, i, u, v, runs, reach, angles) > threshold
    return out


@njit(cache=True)
def _runs(cells, starts, ends, c, span):
    """Ranges of the ordered points in the 27 cells about cell c, the nearest run first, shape (9, 2)."""
    runs = np.zeros((9, 2), np.int64)
    k = 0
    for ring in range(3):
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                if abs(dx) + abs(dy) != ring:
                    continue
                middle = cells[c] + (dx * span[1] + dy) * span[2]
                first = first_not_less(cells, middle - 1)
                last = first
                while last < len(cells) and cells[last] <= middle + 1:
                    last += 1
                if last > first:
                    runs[k, 0], runs[k, 1] = starts[first], ends[last - 1]
                k += 1
    return runs


@njit(cache=True)
def _axes(n):
    """Two unit vectors that span the plane normal to n."""
    s = 1.0 if n[2] >= 0.0 else -1.0
    a = -1.0 / (s + n[2])
    b = n[0] * n[1] * a
    return (1.0 + s * n[0] * n[0] * a, s * b, -s * n[0]), (b, s + n[1] * n[1] * a, -n[1])


@njit(cache=True)
def _projected(points, p, j, u, v, reach):
    """Neighbour j in the tangent plane of p, and whether it counts: near enough, and off the normal."""
    dx, dy, dz = points[j, 0] - points[p, 0], points[j, 1] - points[p, 1], points[j, 2] - points[p, 2]
    square = dx * dx + dy * dy + dz * dz
    if square > reach:
        return 0.0, 0.0, False
    x, y = dx * u[0] + dy * u[1] + dz * u[2], dx * v[0] + dy * v[1] + dz * v[2]
    return x, y, x * x + y * y > 1e-18 * square


@njit(cache=True)
def _surrounded(points, p, u, v, runs, reach):
    """Whether every octant of the tangent plane holds a neighbour: no gap then reaches 90 degrees."""
    seen = 0
    for k in range(9):
        for j in range(runs[k, 0], runs[k, 1]):
            x, y, counts = _projected(points, p, j, u, v, reach)
            if not counts:
                continue
            # half-open octants: a quarter turn never separates neighbours of two adjacent ones
            if y >= 0.0 and x > 0.0:
                octant = 0 if y < x else 1
            elif x <= 0.0 and y > 0.0:
                octant = 2 if -x < y else 3
            elif y <= 0.0 and x < 0.0:
                octant = 4 if -y < -x else 5
            else:
                octant = 6 if x < -y else 7
            seen |= 1 << octant
            if seen == 255:
                return True
    return False


@njit(cache=True)
def _largest_gap(points, p, u, v, runs, reach, angles):
    """Largest angle between neighbours in the tangent plane of point p [rad]; 2 pi with fewer than two."""
    m = 0
    for k in range(9):
        for j in range(runs[k, 0], runs[k, 1]):
            x, y, counts = _projected(points, p, j, u, v, reach)
            if counts:
                angles[m] = np.arctan2(y, x)
                m += 1
    if m < 2:
        return 2.0 * np.pi
    sort_in_place(angles, m)
    gap = angles[0] + 2.0 * np.pi - angles[m - 1]
    for k in range(1, m):
        gap = max(gap, angles[k] - angles[k - 1])
    return gap
