"""Compiled inner loops of the scan twin: which rays to cast, which hits are measured, where they are put."""

import numpy as np

from scanmotion.geometry.jit import njit


def hull_rows(points: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interval of x that the convex hull of plane points spans at each height y of `rows`.

    Args:
        points: at least two, shape (n, 2).
        rows: heights, shape (m,).

    Returns:
        least and greatest x, shape (m,) each; least > greatest where the hull does not reach.
    """
    # By height, and by x where heights are equal.
    order = np.argsort(points[:, 1] + 1e-10 * points[:, 0], kind="stable")
    low, high = np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
    _hull_rows(np.ascontiguousarray(points), order, np.ascontiguousarray(rows), low, high)
    return low, high


@njit(cache=True, nogil=True)
def _hull_rows(points, order, rows, low, high):
    """Andrew's chains of the points in that order, from both sides, into low and high (m,)."""
    for side in (1.0, -1.0):
        chain = np.empty(len(order), np.int64)
        size = 0
        for i in order:
            while size >= 2:
                a, b = points[chain[size - 2]], points[chain[size - 1]]
                c = points[i]
                turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
                if side * turn > 0.0:
                    break
                size -= 1
            chain[size] = i
            size += 1
        for k in range(size - 1):
            a, b = points[chain[k]], points[chain[k + 1]]
            for j in range(len(rows)):
                if a[1] <= rows[j] <= b[1]:
                    step = b[1] - a[1]
                    x = a[0] if step <= 0.0 else a[0] + (b[0] - a[0]) * (rows[j] - a[1]) / step
                    low[j] = min(low[j], x, b[0] if step <= 0.0 else x)
                    high[j] = max(high[j], x, b[0] if step <= 0.0 else x)


def frame_rays(
    X_OS: np.ndarray, columns: np.ndarray, rows: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays of one frame whose pixel lies in the rows' intervals; their parameter is the depth z.

    Args:
        X_OS: pose of the scanner, shape (4, 4).
        columns: x / z of the pixel columns, ascending, shape (w,).
        rows: y / z of the pixel rows, shape (h,).
        low: least x / z to be cast in each row, shape (h,).
        high: greatest, shape (h,).

    Returns:
        origins and directions, shape (k, 6) float32; column index (k,); row index (k,).
    """
    first = np.searchsorted(columns, low, side="left")
    last = np.maximum(np.searchsorted(columns, high, side="right"), first)
    count = int((last - first).sum())
    return _frame_rays(X_OS, np.ascontiguousarray(columns), np.ascontiguousarray(rows), first, last, count)


@njit(cache=True, nogil=True)
def _frame_rays(X_OS, columns, rows, first, last, count):
    """Row by row, from column first[j] to before last[j]."""
    rays = np.empty((count, 6), np.float32)
    column = np.empty(count, np.int32)
    row = np.empty(count, np.int32)
    k = 0
    for j in range(len(rows)):
        for i in range(first[j], last[j]):
            for a in range(3):
                rays[k, a] = X_OS[a, 3]
                rays[k, 3 + a] = X_OS[a, 0] * columns[i] + X_OS[a, 1] * rows[j] + X_OS[a, 2]
            column[k], row[k] = i, j
            k += 1
    return rays, column, row


@njit(cache=True, nogil=True)
def lit_hits(
    rays: np.ndarray,
    depth: np.ndarray,
    geometry: np.ndarray,
    normals: np.ndarray,
    p_OP: np.ndarray,
    near: float,
    far: float,
    cos_limit: float,
    part: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hits on the part in range and inside the incidence limit of both eyes, with rays from the projector.

    Returns:
        index of the hit's ray, shape (k,); cosine of its incidence at the camera, shape (k,); rays from the
        projector whose parameter is 1 at the hit, shape (k, 6) float32.
    """
    n = len(depth)
    index = np.empty(n, np.int64)
    cosine = np.empty(n, np.float32)
    shadow = np.empty((n, 6), np.float32)
    k = 0
    for i in range(n):
        z = depth[i]
        if not (near <= z <= far) or geometry[i] != part:
            continue
        dot = length = dot_p = length_p = 0.0
        for a in range(3):
            v = np.float64(rays[i, 3 + a])
            w = np.float64(rays[i, a]) + z * v - p_OP[a]
            dot -= v * normals[i, a]
            dot_p -= w * normals[i, a]
            length += v * v
            length_p += w * w
            shadow[k, a] = p_OP[a]
            shadow[k, 3 + a] = w
        if dot < cos_limit * np.sqrt(length) or dot_p < cos_limit * np.sqrt(length_p):
            continue
        index[k] = i
        cosine[k] = dot / np.sqrt(length)
        k += 1
    return index[:k], cosine[:k], shadow[:k]


@njit(cache=True, nogil=True)
def surely_lit(
    depth: np.ndarray, column: np.ndarray, row: np.ndarray, x: np.ndarray, high: np.ndarray, nearest: float,
    baseline: float,
) -> np.ndarray:  # fmt: skip
    """Which hits the projector surely lights: what the camera saw leaves the way to it free.

    The way from the point at (x, z) to the projector runs along the pixel row towards greater x; on it 1 / z
    grows by 1 / baseline for each unit of x. It is free of all that the camera saw where
    g = 1 / z - x / baseline is greater than any g further along, here in the neighbouring rows too and by 0.6
    of what a pixel's step makes, so that only something thinner than a pixel can stand in the way unseen.
    Past the part's outline there is nothing; where the outline leaves the field of view, the part is taken to
    stand there at its least depth.

    Args:
        depth: of the rays of one frame, inf where nothing is hit, shape (k,).
        column, row: of their pixels, shape (k,).
        x: x / z of the columns, ascending, shape (w,).
        high: greatest x / z of the part's outline in each row, shape (h,).
        nearest: least depth of the part's outline, above zero [m].
        baseline: from the camera to the projector along +x of S, above zero [m].
    """
    w, h = len(x), len(high)
    g, top = np.empty((h, w + 1)), np.empty((h, w + 1))
    for j in range(h):
        for c in range(w + 1):
            g[j, c] = -np.inf
    for i in range(len(depth)):
        g[row[i], column[i]] = 1.0 / depth[i] - x[column[i]] / baseline
    for j in range(h):
        if high[j] > x[w - 1]:
            g[j, w] = 1.0 / nearest - x[w - 1] / baseline
    for j in range(h):
        top[j, w] = g[j, w]
        for c in range(w - 1, -1, -1):
            top[j, c] = max(top[j, c + 1], g[j, c])
    margin = 0.6 * (x[w - 1] - x[0]) / max(w - 1, 1) / baseline
    sure = np.zeros(len(depth), np.bool_)
    for i in range(len(depth)):
        j, c = row[i], column[i]
        if np.isfinite(depth[i]):
            most = top[j, c + 1]
            for n in (max(j - 1, 0), min(j + 1, h - 1)):
                most = max(most, top[n, c + 1])
            sure[i] = g[j, c] - margin > most
    return sure


@njit(cache=True, nogil=True)
def placed(
    X_OS: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    depth: np.ndarray,
    cosine: np.ndarray,
    noise: np.ndarray,
    scale: float,
    sigma: float,
    near: float,
    points: np.ndarray,
    measured: np.ndarray,
) -> None:
    """Writes the measured points: noise along the ray, the frame's scale, then the nominal pose.

    Args:
        X_OS: nominal pose, shape (4, 4).
        x: x / z of the pixels, shape (k,).
        y: y / z of the pixels, shape (k,).
        depth: true depths, shape (k,) [m].
        cosine: of the incidence at the camera, shape (k,).
        noise: standard normal numbers, shape (k,).
        scale: of the frame, about 1.
        sigma: standard deviation at the least depth and normal incidence [m].
        near: least depth [m].
        points: filled with points in O, shape (k, 3).
        measured: filled with measured depths, shape (k,).
    """
    for i in range(len(depth)):
        z = depth[i]
        error = noise[i] * sigma * (z / near) ** 2 / max(cosine[i], np.float32(0.3))
        length = np.sqrt(x[i] * x[i] + y[i] * y[i] + 1.0)
        z = (z + error / length) * scale
        measured[i] = z
        for a in range(3):
            points[i, a] = X_OS[a, 3] + z * (X_OS[a, 0] * x[i] + X_OS[a, 1] * y[i] + X_OS[a, 2])
