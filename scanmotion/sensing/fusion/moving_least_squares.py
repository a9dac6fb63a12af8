"""Compiled fit of a local surface through the raw points about each voxel."""

import numpy as np

from scanmotion.geometry.jit import copy_into, njit

_MOST = 4000
"""Points about one voxel that are used."""


@njit(cache=True)
def _columns(
    key: np.int64, unique: np.ndarray, shape: np.ndarray, first: np.ndarray, last: np.ndarray
) -> None:
    """Moves on to the nine runs of voxels (z - 1 .. z + 1) about voxel `key`, no less than the one before.

    Keys grow along z, so that a run lies together in `unique`; the grid's last cells are empty, so that a
    step over its border meets nothing.
    """
    c = 0
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            middle = key + (dx * shape[1] + dy) * shape[2]
            a = first[c]
            while a < len(unique) and unique[a] < middle - 1:
                a += 1
            b = a
            while b < len(unique) and unique[b] <= middle + 1:
                b += 1
            first[c], last[c] = a, b
            c += 1


@njit(cache=True)
def _gathered(
    first: np.ndarray, last: np.ndarray, start: np.ndarray, rows: np.ndarray, frames: np.ndarray,
    cameras: np.ndarray, centre: np.ndarray, towards: np.ndarray, radius: float, out: np.ndarray,
) -> int:  # fmt: skip
    """Fills `out` (5, m) with x, y, z about the centre, 1 / sigma^2 and 1 - (r / radius)^2; returns how many.

    Only points seen from the side `towards`: the far sheet of a thin wall is another surface.
    """
    count, most, limit = 0, out.shape[1], radius * radius
    c0, c1, c2 = centre[0], centre[1], centre[2]
    t0, t1, t2 = towards[0], towards[1], towards[2]
    for c in range(9):
        for j in range(start[first[c]], start[last[c]]):
            x, y, z = rows[j, 0] - c0, rows[j, 1] - c1, rows[j, 2] - c2
            r2 = x * x + y * y + z * z
            if r2 >= limit:
                continue
            f = frames[j]
            side = (cameras[f, 0] - rows[j, 0]) * t0
            side += (cameras[f, 1] - rows[j, 1]) * t1
            side += (cameras[f, 2] - rows[j, 2]) * t2
            if side <= 0.0 or count == most:
                continue
            out[0, count], out[1, count], out[2, count] = x, y, z
            out[3, count], out[4, count] = rows[j, 3], 1.0 - r2 / limit
            count += 1
    return count


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _spread(points: np.ndarray, count: int, cov: np.ndarray) -> None:
    """Weighted scatter matrix of the gathered points about their mean."""
    s = sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for i in range(count):
        x, y, z, w = points[0, i], points[1, i], points[2, i], points[4, i]
        s += w
        sx += w * x
        sy += w * y
        sz += w * z
        xx += w * x * x
        xy += w * x * y
        xz += w * x * z
        yy += w * y * y
        yz += w * y * z
        zz += w * z * z
    cov[0, 0], cov[1, 1], cov[2, 2] = xx - sx * sx / s, yy - sy * sy / s, zz - sz * sz / s
    cov[0, 1] = cov[1, 0] = xy - sx * sy / s
    cov[0, 2] = cov[2, 0] = xz - sx * sz / s
    cov[1, 2] = cov[2, 1] = yz - sy * sz / s


@njit(cache=True)
def _least_direction(c: np.ndarray, n: np.ndarray) -> None:
    """Unit eigenvector of the least eigenvalue of a symmetric (3, 3), in closed form where it is simple.

    Smith 1961 (doi 10.1145/355578.366316); the vector is square to the rows of c - least * 1.
    """
    q = (c[0, 0] + c[1, 1] + c[2, 2]) / 3.0
    off = c[0, 1] ** 2 + c[0, 2] ** 2 + c[1, 2] ** 2
    p2 = (c[0, 0] - q) ** 2 + (c[1, 1] - q) ** 2 + (c[2, 2] - q) ** 2 + 2.0 * off
    p = np.sqrt(p2 / 6.0)
    if p > 1e-14 * q:
        a, b, d = (c[0, 0] - q) / p, (c[1, 1] - q) / p, (c[2, 2] - q) / p
        e, f, g = c[0, 1] / p, c[0, 2] / p, c[1, 2] / p
        half = 0.5 * (a * (b * d - g * g) - e * (e * d - g * f) + f * (e * g - b * f))
        least = 2.0 * np.cos(np.arccos(min(1.0, max(-1.0, half))) / 3.0 + 2.0 * np.pi / 3.0)
        a, b, d = a - least, b - least, d - least
        best = 0.0
        for k in range(3):
            if k == 0:
                x, y, z = e * g - f * b, f * e - a * g, a * b - e * e
            elif k == 1:
                x, y, z = e * d - f * g, f * f - a * d, a * g - e * f
            else:
                x, y, z = b * d - g * g, g * f - e * d, e * g - b * f
            size = x * x + y * y + z * z
            if size > best:
                best = size
                n[0], n[1], n[2] = x, y, z
        if best > 1e-6:
            best = np.sqrt(best)
            n[0], n[1], n[2] = n[0] / best, n[1] / best, n[2] / best
            return
    _by_rotations(c, n)


@njit(cache=True)
def _by_rotations(c: np.ndarray, n: np.ndarray) -> None:
    """The same by Jacobi's rotations, for matrices whose two least eigenvalues are nearly one."""
    a, v = np.empty((3, 3)), np.zeros((3, 3))
    for i in range(3):
        v[i, i] = 1.0
        for j in range(3):
            a[i, j] = c[i, j]
    for _ in range(30):
        for k in range(3):
            p, q = (0, 1) if k == 0 else (0, 2) if k == 1 else (1, 2)
            if a[p, q] == 0.0:
                continue
            half = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
            t = (1.0 if half >= 0.0 else -1.0) / (abs(half) + np.sqrt(1.0 + half * half))
            cos = 1.0 / np.sqrt(1.0 + t * t)
            sin = t * cos
            for m in range(3):
                x, y = a[m, p], a[m, q]
                a[m, p], a[m, q] = cos * x - sin * y, sin * x + cos * y
                x, y = v[m, p], v[m, q]
                v[m, p], v[m, q] = cos * x - sin * y, sin * x + cos * y
            for m in range(3):
                x, y = a[p, m], a[q, m]
                a[p, m], a[q, m] = cos * x - sin * y, sin * x + cos * y
    least = 0 if a[0, 0] <= a[1, 1] else 1
    least = least if a[least, least] <= a[2, 2] else 2
    for m in range(3):
        n[m] = v[m, least]


@njit(cache=True)
def _onto_plane(points: np.ndarray, count: int, radius: float, axes: np.ndarray, out: np.ndarray) -> None:
    """Fills `out` with u, v in units of the radius and the height h, rows 0..2."""
    for i in range(count):
        x, y, z = points[0, i], points[1, i], points[2, i]
        out[0, i] = (x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) / radius
        out[1, i] = (x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) / radius
        out[2, i] = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _moments(uvhw: np.ndarray, count: int, A: np.ndarray, b: np.ndarray) -> None:
    """Normal equations of h over 1, u, v, u^2, u v, v^2 with the weights in row 3; the lower half of A."""
    s0 = su = sv = suu = suv = svv = h0 = hu = hv = 0.0
    for i in range(count):
        u, v, w = uvhw[0, i], uvhw[1, i], uvhw[3, i]
        wh = w * uvhw[2, i]
        wu, wv = w * u, w * v
        s0 += w
        su += wu
        sv += wv
        suu += wu * u
        suv += wu * v
        svv += wv * v
        h0 += wh
        hu += wh * u
        hv += wh * v
    suuu = suuv = suvv = svvv = s40 = s31 = s22 = s13 = s04 = huu = huv = hvv = 0.0
    for i in range(count):
        u, v, w = uvhw[0, i], uvhw[1, i], uvhw[3, i]
        wh = w * uvhw[2, i]
        uu, uv, vv = u * u, u * v, v * v
        suuu += w * uu * u
        suuv += w * uu * v
        suvv += w * u * vv
        svvv += w * vv * v
        s40 += w * uu * uu
        s31 += w * uu * uv
        s22 += w * uu * vv
        s13 += w * uv * vv
        s04 += w * vv * vv
        huu += wh * uu
        huv += wh * uv
        hvv += wh * vv
    A[0, 0] = s0
    A[1, 0], A[1, 1] = su, suu
    A[2, 0], A[2, 1], A[2, 2] = sv, suv, svv
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = suu, suuu, suuv, s40
    A[4, 0], A[4, 1], A[4, 2], A[4, 3], A[4, 4] = suv, suuv, suvv, s31, s22
    A[5, 0], A[5, 1], A[5, 2], A[5, 3], A[5, 4], A[5, 5] = svv, suvv, svvv, s22, s13, s04
    b[0], b[1], b[2], b[3], b[4], b[5] = h0, hu, hv, huu, huv, hvv


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


@njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _misfit(points: np.ndarray, uvhw: np.ndarray, count: int, c: np.ndarray) -> float:
    """Weighted rms of residual / sigma, no residual above 5 sigma; the squares themselves into row 4."""
    total = weights = 0.0
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    for i in range(count):
        u, v = uvhw[0, i], uvhw[1, i]
        r = uvhw[2, i] - c0 - u * (c1 + c3 * u + c4 * v) - v * (c2 + c5 * v)
        r2 = r * r * points[3, i]
        uvhw[4, i] = r2
        w = points[4, i] * points[4, i]
        total += w * min(r2, 25.0)
        weights += w
    return np.sqrt(total / weights)


@njit(cache=True)
def _fit(points: np.ndarray, uvhw: np.ndarray, count: int, size: int, A: np.ndarray, c: np.ndarray) -> float:
    """Robust polynomial height over the tangent plane, weighted by distance and 1 / sigma^2, into `c`.

    Two passes: the second weighs each point by Tukey's function of its residual in sigmas.

    Returns:
        weighted rms of residual / sigma; negative where the fit is singular.
    """
    for i in range(count):
        uvhw[3, i] = points[4, i] * points[4, i] * points[3, i]
    spread = -1.0
    for turn in range(2):
        if turn == 1:
            limit = (4.7 * max(spread, 1.0)) ** 2
            for i in range(count):
                t = max(1.0 - uvhw[4, i] / limit, 0.0)
                uvhw[3, i] *= t * t
        _moments(uvhw, count, A, c)
        if not _solved(A, c, size):
            return -1.0
        for i in range(size, len(c)):
            c[i] = 0.0
        spread = _misfit(points, uvhw, count, c)
    return spread


@njit(cache=True)
def _axes(n: np.ndarray, axes: np.ndarray) -> None:
    """Fills `axes` (3, 3) with two unit vectors square to the unit normal, and the normal."""
    a, b, c = abs(n[0]), abs(n[1]), abs(n[2])
    if a <= b and a <= c:
        x, y, z = 0.0, -n[2], n[1]
    elif b <= c:
        x, y, z = n[2], 0.0, -n[0]
    else:
        x, y, z = -n[1], n[0], 0.0
    length = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    axes[0, 0], axes[0, 1], axes[0, 2] = x, y, z
    axes[1, 0], axes[1, 1], axes[1, 2] = n[1] * z - n[2] * y, n[2] * x - n[0] * z, n[0] * y - n[1] * x
    axes[2, 0], axes[2, 1], axes[2, 2] = n[0], n[1], n[2]


@njit(cache=True, nogil=True)
def fitted(
    first: int, last: int, radius: float, rows: np.ndarray, frames: np.ndarray, cameras: np.ndarray,
    unique: np.ndarray, shape: np.ndarray, start: np.ndarray, view: np.ndarray, out: np.ndarray,
    normals: np.ndarray, misfit: np.ndarray,
) -> None:  # fmt: skip
    """Moves the means of the voxels first..last onto the surface fitted through the raw points about them.

    Args:
        first: voxel to begin with; last: voxel to end before.
        radius: of the neighbourhood, at most a voxel's edge.
        rows: points and 1 / sigma^2, frames: by voxel, as `averaged`.
        cameras: position of the camera in each frame, shape (f, 3).
        unique: keys of the voxels; shape, start: as `grouped`.
        view: mean unit vector to the camera of each voxel, shape (v, 3).
        out: means on entry, fitted points on return, shape (v, 3).
        normals: filled with unit normals, shape (v, 3).
        misfit: filled with the rms of residual / sigma, -1 where nothing could be fitted, shape (v,).
    """
    begin, end = np.zeros(9, np.int64), np.zeros(9, np.int64)
    near, uvhw = np.empty((5, _MOST)), np.empty((5, _MOST))
    A, c, n, axes = np.empty((6, 6)), np.empty(6), np.empty(3), np.empty((3, 3))
    for v in range(first, last):
        _columns(unique[v], unique, shape, begin, end)
        count = _gathered(begin, end, start, rows, frames, cameras, out[v], view[v], radius, near)
        misfit[v] = -1.0
        copy_into(normals[v], view[v])
        if count < 4:
            continue
        _spread(near, count, A[:3, :3])
        _least_direction(A[:3, :3], n)
        if n[0] * view[v, 0] + n[1] * view[v, 1] + n[2] * view[v, 2] < 0.0:
            n[0], n[1], n[2] = -n[0], -n[1], -n[2]
        copy_into(normals[v], n)
        _axes(n, axes)
        _onto_plane(near, count, radius, axes, uvhw)
        spread = _fit(near, uvhw, count, 6, A, c) if count >= 12 else -1.0
        if spread < 0.0:
            spread = _fit(near, uvhw, count, 3, A, c)
        if spread < 0.0 or abs(c[0]) > radius:
            continue
        misfit[v] = spread
        length = np.sqrt(1.0 + (c[1] * c[1] + c[2] * c[2]) / radius**2)
        for a in range(3):
            out[v, a] += c[0] * n[a]
            tilt = (c[1] * axes[0, a] + c[2] * axes[1, a]) / radius
            normals[v, a] = (n[a] - tilt) / length
