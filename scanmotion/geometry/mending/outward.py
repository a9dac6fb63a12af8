"""Which side of a cloud is out: the side from which its points can be seen past all the others."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.support.threads import allowed_threads

_RAYS = 1500
_COARSE = 150
"""Cells are never finer than the size over this."""
_START = 3.0
"""A ray begins so many cells off its point."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Occupied:
    """Cells of space that hold points."""

    low: np.ndarray
    cell: float
    shape: np.ndarray
    """Cells along x, y, z, shape (3,)."""
    keys: np.ndarray
    """Sorted numbers of the cells that hold points."""


def spacing_of_points(points: np.ndarray, *, most: int = 4000, k: int = 6) -> float:
    """Side of the square that a point stands for: from the k-th neighbour, 90th percentile of some points."""
    k = min(k, len(points) - 1)
    if k < 1:
        return 0.0
    some = points[np.linspace(0, len(points) - 1, min(most, len(points))).astype(int)]
    distance = cKDTree(points).query(some, k + 1, workers=allowed_threads())[0][:, -1]
    return float(np.percentile(distance, 90) * np.sqrt(np.pi / (k + 0.5)))


def occupied(points: np.ndarray) -> Occupied:
    """The cells that hold points (n, 3); wide enough that a sampled surface has no gap."""
    low = points.min(axis=0)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    cell = max(1.5 * spacing_of_points(points), size / _COARSE, 1e-12)
    place = np.floor((points - low) / cell).astype(np.int64)
    shape = place.max(axis=0) + 1
    keys = np.unique((place[:, 0] * shape[1] + place[:, 1]) * shape[2] + place[:, 2])
    return Occupied(low=low, cell=cell, shape=shape, keys=keys)


def escapes(space: Occupied, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Which rays from points (n, 3) along unit directions (n, 3) leave without meeting a cell; shape (n,)."""
    free = np.ones(len(points), bool)
    steps = int(np.linalg.norm(space.shape)) + 1
    for step in range(steps):
        live = np.flatnonzero(free)
        p = points[live] + (_START + step) * space.cell * directions[live]
        place = np.floor((p - space.low) / space.cell).astype(np.int64)
        within = ((place >= 0) & (place < space.shape)).all(axis=1)
        if not within.any():
            break
        key = (place[within, 0] * space.shape[1] + place[within, 1]) * space.shape[2] + place[within, 2]
        at = np.minimum(np.searchsorted(space.keys, key), len(space.keys) - 1)
        free[live[within][space.keys[at] == key]] = False
    return free


def look_inwards(points: np.ndarray, normals: np.ndarray, space: Occupied | None = None) -> bool:
    """Whether normals point into the part: along them most rays meet the part, against them few do.

    A bowl whose normals look into it is left alone: from there it was seen, and the rays escape.

    Args:
        points: shape (n, 3).
        normals: unit normals, shape (n, 3).
        space: what may stand in the way; the points themselves unless given.
    """
    space = space or occupied(points)
    some = np.linspace(0, len(points) - 1, min(_RAYS, len(points))).astype(int)
    out = escapes(space, points[some], normals[some]).mean()
    back = escapes(space, points[some], -normals[some]).mean()
    return bool(out < 0.4 and back > out + 0.35)


def disagreeing(points: np.ndarray, normals: np.ndarray) -> float:
    """Share of points whose nearest neighbour's normal looks the other way."""
    some = np.linspace(0, len(points) - 1, min(20_000, len(points))).astype(int)
    near = cKDTree(points).query(points[some], 2, workers=allowed_threads())[1][:, 1]
    return float((np.einsum("ij,ij->i", normals[some], normals[near]) < -0.5).mean())
