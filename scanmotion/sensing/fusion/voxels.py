"""Compiled loops of the fusion: points into voxels, and the means over each voxel."""

import numpy as np

from scanmotion.geometry.jit import njit

_NONE = -1


@njit(cache=True)
def extent(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates, shape (3,) each; NaN where a point holds one."""
    low, high = np.empty(3), np.empty(3)
    for a in range(3):
        low[a], high[a] = np.inf, -np.inf
    for i in range(len(points)):
        for a in range(3):
            x = np.float64(points[i, a])
            if not x >= low[a]:
                low[a] = x
            if not x <= high[a]:
                high[a] = x
    return low, high


@njit(cache=True)
def _slot(key: np.int64, keys: np.ndarray, used: np.ndarray) -> np.int64:
    """Position of `key` in an open-addressed table, or of the free slot where it belongs."""
    mask = len(keys) - 1
    h = (key * np.int64(-7046029254386353131)) >> np.int64(20)
    i = h & mask
    while used[i] != _NONE and keys[i] != key:
        i = (i + 1) & mask
    return i


@njit(cache=True)
def _key(points: np.ndarray, i: int, low: np.ndarray, edge: float, shape: np.ndarray) -> np.int64:
    key = np.int64(0)
    for a in range(3):
        key = key * shape[a] + np.int64((points[i, a] - low[a]) / edge)
    return key


@njit(cache=True)
def _numbered(
    points: np.ndarray, low: np.ndarray, edge: float, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Keys of the occupied voxels as they are met, and each point's position among them."""
    size, count = 1 << 16, 0
    table, used = np.zeros(size, np.int64), np.full(size, _NONE, np.int32)
    voxel = np.empty(len(points), np.int32)
    last, number = np.int64(-1), np.int32(0)
    for i in range(len(points)):
        key = _key(points, i, low, edge, shape)
        # Neighbouring pixels often lie in one voxel.
        if key != last:
            s = _slot(key, table, used)
            if used[s] == _NONE:
                table[s], used[s] = key, count
                count += 1
            number, last = used[s], key
            if 2 * count > size:
                old, old_used = table, used
                size *= 4
                table, used = np.zeros(size, np.int64), np.full(size, _NONE, np.int32)
                for k in range(len(old)):
                    if old_used[k] != _NONE:
                        s = _slot(old[k], table, used)
                        table[s], used[s] = old[k], old_used[k]
        voxel[i] = number
    unique = np.empty(count, np.int64)
    for k in range(size):
        if used[k] != _NONE:
            unique[used[k]] = table[k]
    return unique, voxel


def grouped(
    points: np.ndarray, low: np.ndarray, edge: float, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points by voxel.

    Args:
        points: shape (n, 3).
        low: corner of the grid, shape (3,).
        edge: of a voxel.
        shape: cells along x, y, z, shape (3,) int64; the last cell of each is empty.

    Returns:
        keys of the occupied voxels, ascending, shape (v,); first place of each voxel's points in the order,
        shape (v + 1,); the order, shape (n,) int32.
    """
    unique, voxel = _numbered(points, low, edge, shape)
    ascending = np.argsort(unique)
    rank = np.empty(len(unique), np.int32)
    rank[ascending] = np.arange(len(unique), dtype=np.int32)
    start, order = _ordered(voxel, rank)
    return unique[ascending], start, order


@njit(cache=True)
def _ordered(voxel: np.ndarray, rank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First place of each voxel's points, by the voxels' ranks, and the points in that order."""
    start = np.zeros(len(rank) + 1, np.int64)
    for i in range(len(voxel)):
        start[rank[voxel[i]] + 1] += 1
    for v in range(len(rank)):
        start[v + 1] += start[v]
    place = np.empty(len(rank), np.int64)
    for v in range(len(rank)):
        place[v] = start[v]
    order = np.empty(len(voxel), np.int32)
    for i in range(len(voxel)):
        v = rank[voxel[i]]
        order[place[v]] = i
        place[v] += 1
    return start, order


@njit(cache=True)
def averaged(
    points: np.ndarray, frame: np.ndarray, cameras: np.ndarray, sigma: np.ndarray, start: np.ndarray,
    order: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Means over each voxel, and the points in the order of the voxels.

    Returns:
        mean point (v, 3); mean unit vector towards the camera (v, 3); points and 1 / sigma^2 by voxel, (n, 4)
        float32; frames by voxel, (n,) int32.
    """
    n = len(start) - 1
    mean, view = np.zeros((n, 3)), np.zeros((n, 3))
    rows, frames = np.empty((len(order), 4), np.float32), np.empty(len(order), np.int32)
    for v in range(n):
        for j in range(start[v], start[v + 1]):
            i = order[j]
            frames[j] = frame[i]
            rows[j, 3] = 1.0 / np.float64(sigma[i]) ** 2
            d0 = cameras[frame[i], 0] - points[i, 0]
            d1 = cameras[frame[i], 1] - points[i, 1]
            d2 = cameras[frame[i], 2] - points[i, 2]
            length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) + 1e-30
            view[v, 0] += d0 / length
            view[v, 1] += d1 / length
            view[v, 2] += d2 / length
            for a in range(3):
                mean[v, a] += points[i, a]
                rows[j, a] = points[i, a]
        length = np.sqrt(view[v, 0] ** 2 + view[v, 1] ** 2 + view[v, 2] ** 2) + 1e-30
        for a in range(3):
            mean[v, a] /= start[v + 1] - start[v]
            view[v, a] /= length
    return mean, view, rows, frames
