"""The rim of a hole as an ordered loop, its box, its kind."""

from typing import Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scanmotion.geometry.jit import njit, turn_round

Kind = Literal["common", "interstitial", "edge", "island"]

NARROW = 0.5
"""Radius of the largest circle inside a narrow loop against that of the circle of its area; 1 x 3: 0.51."""
_GRID = 40


def ordered_loop(points: np.ndarray) -> np.ndarray:
    """Order of rim points along the rim: a short closed tour, improved by 2-opt and point moves.

    A tour of least length does not cross itself, so it follows both sides of a narrow or branching gap, and
    it needs no common plane. It starts from nearest neighbours, from the outermost point, and so turns
    with the rim.

    Args:
        points: rim points in any order, shape (k, 3).

    Returns:
        Indices, shape (k,).
    """
    if len(points) < 4:
        return np.arange(len(points))
    order = np.lexsort(points.T[::-1])
    away = ((points[order] - points[order].mean(axis=0)) ** 2).sum(axis=1)
    start = int(order[away.argmax()])
    return _tour(np.ascontiguousarray(points, dtype=float), start)


@njit(cache=True)
def _distance(points, a, b):
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True)
def _tour(points, start):
    k = len(points)
    tour = np.zeros(k, np.int64)
    left = np.ones(k, np.bool_)
    tour[0] = start
    left[start] = False
    for i in range(1, k):
        best, at = np.inf, -1
        for j in range(k):
            if left[j]:
                d = _distance(points, tour[i - 1], j)
                if d < best:
                    best, at = d, j
        tour[i] = at
        left[at] = False
    for _ in range(60):
        if not (_reverse_pass(points, tour) | _move_pass(points, tour)):
            break
    return tour


@njit(cache=True)
def _reverse_pass(points, tour):
    k = len(tour)
    better = False
    for i in range(k - 1):
        a, b = tour[i], tour[i + 1]
        ab = _distance(points, a, b)
        for j in range(i + 2, k):
            c, d = tour[j], tour[(j + 1) % k]
            if d == a:
                continue
            ac = _distance(points, a, c)
            if ac + _distance(points, b, d) < ab + _distance(points, c, d) - 1e-12:
                turn_round(tour, i + 1, j)
                b = tour[i + 1]
                ab = ac
                better = True
    return better


@njit(cache=True)
def _move_pass(points, tour):
    k = len(tour)
    better = False
    for i in range(k):
        p, a, b = tour[i], tour[i - 1], tour[(i + 1) % k]
        gain = _distance(points, a, p) + _distance(points, p, b) - _distance(points, a, b)
        if gain < 1e-12:
            continue
        best, at = gain - 1e-12, -1
        for j in range(k):
            c, d = tour[j], tour[(j + 1) % k]
            if c == p or d == p:
                continue
            cost = _distance(points, c, p) + _distance(points, p, d) - _distance(points, c, d)
            if cost < best:
                best, at = cost, j
        if at >= 0:
            if at > i:
                for m in range(i, at):
                    tour[m] = tour[m + 1]
                tour[at] = p
            else:
                for m in range(i, at + 1, -1):
                    tour[m] = tour[m - 1]
                tour[at + 1] = p
            better = True
    return better


def loop_length(loop: np.ndarray) -> float:
    """Length of the closed polygon, shape (k, 3)."""
    return float(np.linalg.norm(loop - np.roll(loop, -1, axis=0), axis=1).sum())


def vector_area(loop: np.ndarray) -> np.ndarray:
    """Vector area of the closed polygon, shape (3,): exact for a plane loop, its largest shadow otherwise."""
    centred = loop - loop.mean(axis=0)
    return 0.5 * np.cross(centred, np.roll(centred, -1, axis=0)).sum(axis=0)


def roundness(loop: np.ndarray) -> float:
    """Radius of the largest circle inside the loop's shadow against that of the circle of equal area.

    1 for a circle, 0.89 for a square, 0.89 sqrt(w / l) for a slot of sides w < l. A ragged rim, as of a mesh,
    changes it little.
    """
    area = float(np.linalg.norm(vector_area(loop)))
    return inscribed_radius(loop) / np.sqrt(area / np.pi) if area > 0 else 0.0


def inscribed_radius(loop: np.ndarray) -> float:
    """Radius of the largest circle inside the largest shadow of a closed polygon, shape (k, 3) [m]."""
    vector = vector_area(loop)
    area = float(np.linalg.norm(vector))
    if area <= 1e-12 * loop_length(loop) ** 2:
        return 0.0
    x, y = plane_axes(vector / area)
    plane = np.stack([loop @ x, loop @ y], axis=1)
    low, high = plane.min(axis=0), plane.max(axis=0)
    ticks = (np.arange(_GRID) + 0.5) / _GRID
    grid = low + np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2) * (high - low)
    inside = winding(plane, grid) != 0
    return float(_edge_distance(plane, grid[inside]).max(initial=0.0))


def winding(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How often a closed polygon, shape (k, 2), goes round each point, shape (n, 2) -> (n,)."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    above_a, above_b = a[None, :, 1] > points[:, None, 1], b[None, :, 1] > points[:, None, 1]
    to = points[:, None, :] - a[None, :, :]
    side = (b - a)[None, :, 0] * to[:, :, 1] - (b - a)[None, :, 1] * to[:, :, 0]
    up, down = ~above_a & above_b & (side > 0), above_a & ~above_b & (side < 0)
    return up.sum(axis=1) - down.sum(axis=1)


def _edge_distance(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each point, shape (n, 2), from the nearest edge of the polygon, shape (k, 2)."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    square = np.einsum("ij,ij->i", edge, edge)
    to = points[:, None, :] - polygon[None, :, :]
    t = np.clip(np.einsum("ijk,jk->ij", to, edge) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    return np.linalg.norm(to - t[:, :, None] * edge[None], axis=2).min(axis=1)


def plane_axes(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors x, y with x cross y = normal, each shape (3,)."""
    x = np.cross(np.eye(3)[int(np.abs(normal).argmin())], normal)
    x /= np.linalg.norm(x)
    return x, np.cross(normal, x)


def box_about(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest box with one side normal to `normal` (rotating calipers in the plane).

    Args:
        points: shape (k, 3). normal: unit vector, shape (3,).

    Returns:
        X_OH: pose of the box, Z' = normal, X' along its longer side, shape (4, 4); full sides, shape (3,).
    """
    x, y = plane_axes(normal)
    plane = np.stack([points @ x, points @ y], axis=1)
    angle = _calipers(plane)
    x, y = np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y
    if np.ptp(points @ y) > np.ptp(points @ x):
        x, y = y, -x
    R = np.stack([x, y, normal], axis=1)
    local = points @ R
    low, high = local.min(axis=0), local.max(axis=0)
    X = np.eye(4)
    X[:3, :3] = R
    X[:3, 3] = R @ (0.5 * (low + high))
    return X, high - low


def _calipers(plane: np.ndarray) -> float:
    """Angle of the rectangle of least area about points of the plane [rad]; a line's own if they are one."""
    try:
        hull = plane[ConvexHull(plane).vertices]
    except (QhullError, ValueError):
        centred = plane - plane.mean(axis=0)
        direction = np.linalg.svd(centred, full_matrices=False)[2][0]
        return float(np.arctan2(direction[1], direction[0]))
    edge = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.round(np.mod(np.arctan2(edge[:, 1], edge[:, 0]), np.pi / 2), 12))
    u = np.stack([np.cos(angles), np.sin(angles)])
    v = np.stack([-np.sin(angles), np.cos(angles)])
    area = np.ptp(hull @ u, axis=0) * np.ptp(hull @ v, axis=0)
    return float(angles[area.argmin()])


def outward(normals: np.ndarray, opening: np.ndarray) -> tuple[np.ndarray, float]:
    """Outward direction of the missing patch, and how well the rim agrees on it (length of the mean).

    Where the rim's normals agree (length of their mean from 0.5 on) it is their mean. Round an open end, as
    the foot of a hollow statue, they cancel, while the directions in which the surface would go on agree: the
    sum of both means serves there.

    Args:
        normals: outward unit normals at the rim, shape (k, 3).
        opening: unit vectors from the rim into the hole, shape (k, 3).
    """
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < 0.5:
        mean = mean + opening.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1e-9:
        return normals[0], 0.0
    return mean / length, length


def kind_of(loop: np.ndarray, opening: np.ndarray, *, islands: int) -> Kind:
    """Kind of a hole by figures 2 and 3 of the paper.

    Edge: the empty side faces no other part of the loop (an open rim). Island: points inside. Interstitial:
    narrow. Else common.
    """
    if islands:
        return "island"
    if facing(loop, opening) < 0.5:
        return "edge"
    return "interstitial" if roundness(loop) < NARROW else "common"


def facing(loop: np.ndarray, opening: np.ndarray) -> float:
    """Share of the rim from which the empty side faces the other side of the loop."""
    step = loop[None, :, :] - loop[:, None, :]
    if len(loop) > 400:
        step = step[:: len(loop) // 400 + 1]
        opening = opening[:: len(loop) // 400 + 1]
    length = np.linalg.norm(step, axis=2)
    ahead = np.einsum("ijk,ik->ij", step, opening) > 0.7 * length
    return float((ahead & (length > 0)).any(axis=1).mean())


def chains_of(points: np.ndarray, opening: np.ndarray) -> list[np.ndarray]:
    """Rim points as one outer chain and the chains of the islands inside it.

    Rim points lie close along a rim and apart across a gap. A separate chain is an island only when the empty
    side is all around it; otherwise it is a piece of the outer rim.

    Args:
        points: rim points of one hole, shape (k, 3) [m].
        opening: unit vectors into the hole, shape (k, 3).

    Returns:
        Indices, the outer chain first.
    """
    if len(points) < 10:
        return [np.arange(len(points))]
    tree = cKDTree(points)
    step = 2.0 * float(np.median(tree.query(points, 3)[0][:, 2]))
    pairs = tree.query_pairs(step, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    label = connected_components(graph, directed=False)[1]
    size = np.bincount(label)
    islands = [
        np.flatnonzero(label == i)
        for i in range(len(size))
        if i != size.argmax() and size[i] >= 5 and _looks_away(points[label == i], opening[label == i])
    ]
    inner = np.concatenate([np.zeros(0, int), *islands])
    return [np.setdiff1d(np.arange(len(points)), inner), *islands]


def _looks_away(points: np.ndarray, opening: np.ndarray) -> bool:
    """Whether the empty side lies outside of a chain all round."""
    radial = points - points.mean(axis=0)
    length = np.linalg.norm(radial, axis=1)
    side = np.einsum("ij,ij->i", radial, opening) / np.where(length > 0, length, 1.0)
    return bool(np.mean(side > 0.3) > 0.8)
