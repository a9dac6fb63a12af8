"""Compiled loops of the fusion: points into voxels, and the local surface fitted through each voxel."""

import numpy as np

from scanmotion.compiled import njit

_NONE = -1


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
def _table(unique: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hash table from key to position in `unique`."""
    size = 16
    while size < 3 * len(unique):
        size *= 2
    keys, used = np.zeros(size, np.int64), np.full(size, _NONE, np.int32)
    for i in range(len(unique)):
        s = _slot(unique[i], keys, used)
        keys[s], used[s] = unique[i], i
    return keys, used


@njit(cache=True)
def _distinct(keys: np.ndarray) -> np.ndarray:
    """The distinct keys, ascending."""
    size, count = 1 << 16, 0
    table, used = np.zeros(size, np.int64), np.full(size, _NONE, np.int32)
    for key in keys:
        s = _slot(key, table, used)
        if used[s] == _NONE:
            table[s], used[s] = key, 0
            count += 1
            if 2 * count > size:
                old, old_used = table, used
                size *= 4
                table, used = np.zeros(size, np.int64), np.full(size, _NONE, np.int32)
                for i in range(len(old)):
                    if old_used[i] != _NONE:
                        s = _slot(old[i], table, used)
                        table[s], used[s] = old[i], 0
    return np.sort(table[used != _NONE])


@njit(cache=True)
def _keys(points: np.ndarray, low: np.ndarray, edge: float, shape: np.ndarray) -> np.ndarray:
    keys = np.empty(len(points), np.int64)
    for i in range(len(points)):
        key = np.int64(0)
        for a in range(3):
            key = key * shape[a] + np.int64((points[i, a] - low[a]) / edge)
        keys[i] = key
    return keys


@njit(cache=True)
def grouped(
    points: np.ndarray, low: np.ndarray, edge: float, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points by voxel.

    Args:
        points: shape (n, 3).
        low: corner of the grid, shape (3,).
        edge: of a voxel.
        shape: cells along x, y, z, shape (3,) int64.

    Returns:
        keys of the occupied voxels, ascending, shape (v,); first place of each voxel's points in the order,
        shape (v + 1,); the order, shape (n,) int32.
    """
    keys = _keys(points, low, edge, shape)
    unique = _distinct(keys)
    table, used = _table(unique)
    voxel = np.empty(len(points), np.int32)
    start = np.zeros(len(unique) + 1, np.int64)
    for i in range(len(points)):
        voxel[i] = used[_slot(keys[i], table, used)]
        start[voxel[i] + 1] += 1
    start = np.cumsum(start)
    place = start[:-1].copy()
    order = np.empty(len(points), np.int32)
    for i in range(len(points)):
        order[place[voxel[i]]] = i
        place[voxel[i]] += 1
    return unique, start, order


@njit(cache=True)
def averaged(
    points: np.ndarray, frame: np.ndarray, cameras: np.ndarray, start: np.ndarray, order: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean point and mean unit vector towards the camera of each voxel, shape (v, 3) each."""
    n = len(start) - 1
    mean, view = np.zeros((n, 3)), np.zeros((n, 3))
    for v in range(n):
        for j in range(start[v], start[v + 1]):
            i = order[j]
            d0 = cameras[frame[i], 0] - points[i, 0]
            d1 = cameras[frame[i], 1] - points[i, 1]
            d2 = cameras[frame[i], 2] - points[i, 2]
            length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2) + 1e-30
            view[v, 0] += d0 / length
            view[v, 1] += d1 / length
            view[v, 2] += d2 / length
            for a in range(3):
                mean[v, a] += points[i, a]
        mean[v] /= start[v + 1] - start[v]
        view[v] /= np.sqrt((view[v] ** 2).sum()) + 1e-30
    return mean, view


@njit(cache=True)
def _around(
    v: int, unique: np.ndarray, shape: np.ndarray, table: np.ndarray, used: np.ndarray, found: np.ndarray
) -> int:
    """Fills `found` with the occupied voxels among the 27 about voxel `v`; returns how many."""
    key = unique[v]
    z = key % shape[2]
    y = (key // shape[2]) % shape[1]
    x = key // (shape[2] * shape[1])
    count = 0
    for i in range(max(x - 1, 0), min(x + 2, shape[0])):
        for j in range(max(y - 1, 0), min(y + 2, shape[1])):
            for k in range(max(z - 1, 0), min(z + 2, shape[2])):
                s = _slot((i * shape[1] + j) * shape[2] + k, table, used)
                if used[s] != _NONE:
                    found[count] = used[s]
                    count += 1
    return count


@njit(cache=True)
def _frame_of(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors square to a unit normal."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(normal))] = 1.0
    x = np.cross(helper, normal)
    x /= np.sqrt((x**2).sum())
    return x, np.cross(normal, x)


@njit(cache=True)
def _gathered(
    v: int, near: np.ndarray, points: np.ndarray, frame: np.ndarray, cameras: np.ndarray, sigma: np.ndarray,
    start: np.ndarray, order: np.ndarray, centre: np.ndarray, towards: np.ndarray, radius: float,
    out: np.ndarray,
) -> int:  # fmt: skip
    """Fills `out` (m, 5) with x, y, z about the centre, sigma and distance; returns how many.

    Only points seen from the side `towards`: the far sheet of a thin wall is another surface.
    """
    count = 0
    for s in near:
        for j in range(start[s], start[s + 1]):
            if count == len(out):
                return count
            i = order[j]
            dot = r2 = 0.0
            for a in range(3):
                d = points[i, a] - centre[a]
                out[count, a] = d
                r2 += d * d
                dot += (cameras[frame[i], a] - points[i, a]) * towards[a]
            if r2 < radius * radius and dot > 0.0:
                out[count, 3], out[count, 4] = sigma[i], np.sqrt(r2)
                count += 1
    return count


@njit(cache=True)
def _flat_normal(rows: np.ndarray, count: int, radius: float) -> np.ndarray:
    """Direction of least spread of the gathered points."""
    c = np.zeros((3, 3))
    m = np.zeros(3)
    total = 0.0
    for i in range(count):
        w = 1.0 - (rows[i, 4] / radius) ** 2
        total += w
        for a in range(3):
            m[a] += w * rows[i, a]
            for b in range(a, 3):
                c[a, b] += w * rows[i, a] * rows[i, b]
    for a in range(3):
        for b in range(a, 3):
            c[a, b] -= m[a] * m[b] / total
            c[b, a] = c[a, b]
    return np.linalg.eigh(c)[1][:, 0].copy()


@njit(cache=True)
def _solved(A: np.ndarray, b: np.ndarray, size: int) -> bool:
    """Solves A x = b in place by Cholesky for the leading `size` unknowns; False where A is singular."""
    for i in range(size):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i == j:
                if s <= 1e-9 * A[i, i] or s <= 0.0:
                    return False
                A[i, i] = np.sqrt(s)
            else:
                A[i, j] = s / A[j, j]
    for i in range(size):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]
    return True


@njit(cache=True)
def _fit(
    rows: np.ndarray, count: int, radius: float, x: np.ndarray, y: np.ndarray, n: np.ndarray, size: int,
    coefficients: np.ndarray,
) -> float:  # fmt: skip
    """Robust polynomial height over the tangent plane, weighted by distance and 1 / sigma^2.

    Two passes: the second weighs each point by Tukey's function of its residual in sigmas.

    Returns:
        weighted rms of residual / sigma; negative where the fit is singular.
    """
    basis = np.empty(6)
    A, spread = np.empty((6, 6)), -1.0
    for turn in range(2):
        A[:], b = 0.0, np.zeros(6)
        scale = 4.7 * max(spread, 1.0)
        for i in range(count):
            u = (rows[i, 0] * x[0] + rows[i, 1] * x[1] + rows[i, 2] * x[2]) / radius
            v = (rows[i, 0] * y[0] + rows[i, 1] * y[1] + rows[i, 2] * y[2]) / radius
            h = rows[i, 0] * n[0] + rows[i, 1] * n[1] + rows[i, 2] * n[2]
            basis[0], basis[1], basis[2], basis[3], basis[4], basis[5] = 1.0, u, v, u * u, u * v, v * v
            w = (1.0 - (rows[i, 4] / radius) ** 2) ** 2 / rows[i, 3] ** 2
            if turn == 1:
                r = h
                for k in range(size):
                    r -= coefficients[k] * basis[k]
                r /= rows[i, 3] * scale
                w *= (1.0 - r * r) ** 2 if r * r < 1.0 else 0.0
            for k in range(size):
                b[k] += w * basis[k] * h
                for m in range(k + 1):
                    A[k, m] += w * basis[k] * basis[m]
        if not _solved(A, b, size):
            return -1.0
        coefficients[:size] = b[:size]
        total = weights = 0.0
        for i in range(count):
            u = (rows[i, 0] * x[0] + rows[i, 1] * x[1] + rows[i, 2] * x[2]) / radius
            v = (rows[i, 0] * y[0] + rows[i, 1] * y[1] + rows[i, 2] * y[2]) / radius
            r = rows[i, 0] * n[0] + rows[i, 1] * n[1] + rows[i, 2] * n[2] - b[0] - b[1] * u - b[2] * v
            if size == 6:
                r -= b[3] * u * u + b[4] * u * v + b[5] * v * v
            w = (1.0 - (rows[i, 4] / radius) ** 2) ** 2
            total += w * min((r / rows[i, 3]) ** 2, 25.0)
            weights += w
        spread = np.sqrt(total / weights)
    return spread


@njit(cache=True, nogil=True)
def fitted(
    first: int, last: int, radius: float, points: np.ndarray, frame: np.ndarray, cameras: np.ndarray,
    sigma: np.ndarray, unique: np.ndarray, shape: np.ndarray, start: np.ndarray, order: np.ndarray,
    view: np.ndarray, out: np.ndarray, normals: np.ndarray, misfit: np.ndarray,
) -> None:  # fmt: skip
    """Moves the means of the voxels first..last onto the surface fitted through the raw points about them.

    Args:
        first: voxel to begin with; last: voxel to end before.
        radius: of the neighbourhood, at most a voxel's edge.
        points: raw points, shape (n, 3).
        frame: of each point, shape (n,).
        cameras: position of the camera in each frame, shape (f, 3).
        sigma: of each point, shape (n,).
        unique: keys of the voxels; shape, start, order: as `grouped`.
        view: mean unit vector to the camera of each voxel, shape (v, 3).
        out: means on entry, fitted points on return, shape (v, 3).
        normals: filled with unit normals, shape (v, 3).
        misfit: filled with the rms of residual / sigma, -1 where nothing could be fitted, shape (v,).
    """
    table, used = _table(unique)
    near, rows, c = np.empty(27, np.int32), np.empty((4000, 5)), np.empty(6)
    for v in range(first, last):
        cells = near[: _around(v, unique, shape, table, used, near)]
        count = _gathered(
            v, cells, points, frame, cameras, sigma, start, order, out[v], view[v], radius, rows
        )
        misfit[v], normals[v] = -1.0, view[v]
        if count < 4:
            continue
        n = _flat_normal(rows, count, radius)
        if (n * view[v]).sum() < 0.0:
            n = -n
        normals[v] = n
        x, y = _frame_of(n)
        spread = _fit(rows, count, radius, x, y, n, 6, c) if count >= 12 else -1.0
        if spread < 0.0:
            spread = _fit(rows, count, radius, x, y, n, 3, c)
        if spread < 0.0 or abs(c[0]) > radius:
            continue
        misfit[v] = spread
        out[v] += c[0] * n
        tilted = n - (c[1] * x + c[2] * y) / radius
        normals[v] = tilted / np.sqrt((tilted**2).sum())
