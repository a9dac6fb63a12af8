"""Empty regions of a sampled surface, found by the Voronoi cells of its points.

Every point's neighbours are unrolled into its tangent plane (direction by projection, distance as in space,
so that creases do not fold the cell) and its Voronoi cell is clipped, nearest bisector first. A corner of the
cell is the centre of an empty disc that touches the point: on the rim of a hole it is far away. The area by
which a cell exceeds a sample's share tells how many samples are missing. A hole is then a connected set of
points that share large empty discs and miss enough samples.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scanmotion.core.support.threads import allowed_threads, by_pieces
from scanmotion.geometry.jit import njit

CAP = 3.0
"""Greatest radius of an empty disc that is told apart, in pitches."""
SECOND = 96
"""Neighbours of the second look: enough for a disc of CAP pitches."""
_CORNERS = 12
_MOST = 40
_FAR = 16


@njit(cache=True)
def _frame(n: np.ndarray) -> tuple:
    """Two unit vectors that span the plane normal to n."""
    s = 1.0 if n[2] >= 0.0 else -1.0
    a = -1.0 / (s + n[2])
    b = n[0] * n[1] * a
    return (1.0 + s * n[0] * n[0] * a, s * b, -s * n[0]), (b, s + n[1] * n[1] * a, -n[1])


@njit(cache=True)
def _clip(x, y, gen, m, qx, qy, j, keep):
    """Cuts the polygon by the bisector of the origin and q; returns the new number of corners."""
    half = 0.5 * (qx * qx + qy * qy)
    outside = False
    for i in range(m):
        keep[i] = x[i] * qx + y[i] * qy - half
        outside = outside or keep[i] > 0.0
    if not outside:
        return m
    first = -1
    for i in range(m):
        if keep[i] > 0.0 and keep[i - 1 if i else m - 1] <= 0.0:
            first = i
    if first < 0:
        return m
    last = first
    while keep[(last + 1) % m] > 0.0:
        last = (last + 1) % m
    before, after = (first - 1) % m, (last + 1) % m
    t0 = keep[before] / (keep[before] - keep[first])
    t1 = keep[after] / (keep[after] - keep[last])
    x0 = x[before] + t0 * (x[first] - x[before])
    y0 = y[before] + t0 * (y[first] - y[before])
    x1 = x[after] + t1 * (x[last] - x[after])
    y1 = y[after] + t1 * (y[last] - y[after])
    g1 = gen[last]
    left = (before - after) % m + 1
    cx, cy, cg = np.empty(left), np.empty(left), np.empty(left, np.int64)
    for k in range(left):
        i = (after + k) % m
        cx[k], cy[k], cg[k] = x[i], y[i], gen[i]
    for k in range(left):
        x[k], y[k], gen[k] = cx[k], cy[k], cg[k]
    # edge i runs from corner i to the next: `before` keeps its edge, then the new one, then the rest
    x[left], y[left], gen[left] = x0, y0, j
    x[left + 1], y[left + 1], gen[left + 1] = x1, y1, g1
    return left + 2


@njit(cache=True)
def _cell(P, n, points, row, unit, cap, x, y, gen, keep):
    """Voronoi cell of P in its tangent plane within cap * unit: corners (x, y), the edges' generators."""
    (ux, uy, uz), (vx, vy, vz) = _frame(n)
    m = np.int64(_CORNERS)
    j = row[0]
    dx, dy, dz = points[j, 0] - P[0], points[j, 1] - P[1], points[j, 2] - P[2]
    # the corners that nothing clips must turn with the cloud: the first lies towards the nearest neighbour
    first = np.arctan2(dx * vx + dy * vy + dz * vz, dx * ux + dy * uy + dz * uz)
    for i in range(m):
        a = first + 2.0 * np.pi * i / m
        x[i], y[i], gen[i] = cap * unit * np.cos(a), cap * unit * np.sin(a), -1
    reach = cap * unit
    for j in row:
        if j < 0 or m > _MOST - 4:
            break
        dx, dy, dz = points[j, 0] - P[0], points[j, 1] - P[1], points[j, 2] - P[2]
        d = np.sqrt(dx * dx + dy * dy + dz * dz)
        if d > 2.0 * reach:
            break
        qx, qy = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz
        flat = np.sqrt(qx * qx + qy * qy)
        if flat < 1e-9 * unit or (flat < 0.5 * d and d > 0.5 * unit):
            continue
        qx, qy = qx * d / flat, qy * d / flat
        m = _clip(x, y, gen, m, qx, qy, j, keep)
        reach = 0.0
        for i in range(m):
            reach = max(reach, np.sqrt(x[i] * x[i] + y[i] * y[i]))
    return m, reach


@dataclass(frozen=True, eq=False, kw_only=True)
class RimSet:
    """Points that touch large empty discs, grouped into the rims of the same empty region."""

    points: np.ndarray
    """Indices of the rim points, ascending, shape (m,)."""
    label: np.ndarray
    """Number of the region of each, 0 .. count - 1, shape (m,)."""
    excess: np.ndarray
    """Samples missing in the cell of each, shape (m,)."""
    missing: np.ndarray
    """Samples missing in each region, shape (count,)."""
    reach: np.ndarray
    """Radius of the largest empty disc at each rim point, in local pitches (capped), shape (m,)."""
    opening: np.ndarray
    """Unit vectors from the rim points into the empty region, shape (m, 3); zero where the cell is closed."""


@njit(cache=True, nogil=True)
def _cells(points, normals, index, rows, unit, cap):
    """Largest corner distance and area of the cells of the points `index`, in units."""
    radius = np.zeros(len(index))
    area = np.zeros(len(index))
    for i in range(len(index)):
        x, y, gen, keep = np.empty(_MOST), np.empty(_MOST), np.empty(_MOST, np.int64), np.empty(_MOST)
        p = index[i]
        m, reach = _cell(points[p], normals[p], points, rows[i], unit[p], cap, x, y, gen, keep)
        twice = 0.0
        for k in range(m):
            q = (k + 1) % m
            twice += x[k] * y[q] - x[q] * y[k]
        radius[i] = reach / unit[p]
        area[i] = 0.5 * twice / unit[p] ** 2
    return radius, area


@njit(cache=True, nogil=True)
def _discs(points, normals, index, rows, unit, cap, least):
    """Far corners of the cells: the two points that share each (-1 for none), how many, and which way."""
    shared = np.empty((len(index), _FAR, 2), np.int64)
    count = np.zeros(len(index), np.int64)
    toward = np.zeros((len(index), 3))
    for i in range(len(index)):
        x, y, gen, keep = np.empty(_MOST), np.empty(_MOST), np.empty(_MOST, np.int64), np.empty(_MOST)
        p = index[i]
        m, _ = _cell(points[p], normals[p], points, rows[i], unit[p], cap, x, y, gen, keep)
        u, v = _frame(normals[p])
        for k in range(_FAR):
            shared[i, k, 0] = shared[i, k, 1] = -1
        for k in range(m):
            if np.sqrt(x[k] * x[k] + y[k] * y[k]) <= least * unit[p] or count[i] == _FAR:
                continue
            shared[i, count[i], 0] = gen[k - 1 if k else m - 1]
            shared[i, count[i], 1] = gen[k]
            count[i] += 1
            for a in range(3):
                toward[i, a] += x[k] * u[a] + y[k] * v[a]
    return shared, count, toward


def rim_set(
    tree: cKDTree, normals: np.ndarray, suspects: np.ndarray, unit: np.ndarray, *, least: float, weak: float
) -> RimSet:
    """Regions without samples, as sets of the rim points around them.

    Args:
        tree: of the cloud, (n, 3) [m].
        normals: unit normals of either sign, (n, 3).
        suspects: indices of the points whose cells are to be looked at again with all neighbours, (m,).
        unit: local pitch, (n,) [m].
        least: radius of an empty disc that counts as missing samples, in pitches.
        weak: radius of an empty disc that joins two such discs, in pitches.
    """
    points = np.asarray(tree.data)
    n = len(points)
    rows = tree.query(points[suspects], min(SECOND + 1, n), workers=allowed_threads())[1][:, 1:]
    suspects = np.ascontiguousarray(suspects, dtype=np.int64)
    widest, area = _pieces(_cells, points, normals, suspects, rows, unit, CAP)
    shared, count, toward = _pieces(_discs, points, normals, suspects, rows, unit, CAP, weak)
    here = np.repeat(suspects, count)
    other = shared[np.arange(_FAR) < count[:, None]]
    edge = np.concatenate([np.stack([here, other[:, 0]]), np.stack([here, other[:, 1]])], axis=1)
    edge = edge[:, edge[1] >= 0]
    member = np.union1d(suspects[count > 0], edge[1])
    graph = coo_array((np.ones(edge.shape[1]), (edge[0], edge[1])), shape=(n, n))
    label = np.unique(connected_components(graph, directed=False)[1][member], return_inverse=True)[1]
    regions = int(label.max()) + 1 if len(label) else 0
    excess, reach, into = np.zeros(n), np.zeros(n), np.zeros((n, 3))
    far = widest > least
    excess[suspects[far]] = np.maximum(area[far] - 1.0, 0.0)
    reach[suspects] = widest
    into[suspects] = toward
    length = np.linalg.norm(into[member], axis=1, keepdims=True)
    return RimSet(
        points=member,
        label=label,
        excess=excess[member],
        missing=np.bincount(label, excess[member], regions),
        reach=reach[member],
        opening=into[member] / np.where(length > 0, length, 1.0),
    )


def _pieces(
    kernel: Callable[..., tuple[np.ndarray, ...]],
    points: np.ndarray,
    normals: np.ndarray,
    index: np.ndarray,
    rows: np.ndarray,
    *rest: Any,
) -> tuple[np.ndarray, ...]:
    """A kernel over the points `index` on threads; each point is looked at for itself."""
    rows = np.array(rows, dtype=np.int64, order="C")
    found = by_pieces(
        lambda a, b: kernel(points, normals, index[a:b], rows[a:b], *rest), len(index), least=500
    )
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def cell_radii(tree: cKDTree, normals: np.ndarray, rows: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Largest empty disc at every point by its nearest neighbours alone, in pitches, shape (n,)."""
    points = np.asarray(tree.data)
    return _pieces(_cells, points, normals, np.arange(len(points)), rows, unit, CAP)[0]
