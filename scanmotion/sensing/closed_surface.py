"""A closed model of what has been scanned: the surface that the data show, and a smooth guess at the holes.

The indicator function of the solid is found from the oriented points by Poisson's equation (Kazhdan, Bolitho
and Hoppe 2006, "Poisson surface reconstruction"), here on a regular grid by the fast cosine transform: the
answer is the same to the last bit every time, which Open3D's octree solver does not promise.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from scanmotion.core.errors import HoleError
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.jit import njit

_MAX_CELLS = 220
"""Greatest number of grid cells along the longest side."""
Passed = Callable[[np.ndarray], np.ndarray]
"""Tells which of the places (n, 3) some frame has looked through, shape (n,) bool."""


@dataclass(frozen=True, eq=False)
class _Solid:
    """The indicator on its grid, above zero inside."""

    values: np.ndarray
    origin: np.ndarray
    cell: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ClosedModel:
    """A watertight surface, and how far each of its triangles lies from the data."""

    vertices: np.ndarray
    """Shape (n, 3) in O [m]."""
    triangles: np.ndarray
    """Counter-clockwise from outside, shape (m, 3)."""
    distance: np.ndarray
    """From each triangle's centre to the nearest scanned point, shape (m,) [m]."""
    cell: float
    """Edge of the grid's cells [m]."""
    solid: _Solid | None = None
    """What the surface bounds."""

    @property
    def centres(self) -> np.ndarray:
        """Triangle centres, shape (m, 3) [m]."""
        return self.vertices[self.triangles].mean(axis=1)

    @property
    def crosses(self) -> np.ndarray:
        """Outward normals of the triangles, as long as twice their area, shape (m, 3) [m2]."""
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        return np.cross(b - a, c - a)

    def measured(self, points: np.ndarray, passed: Passed | None = None) -> "ClosedModel":
        """The same surface with the distances from other scanned points, less what frames passed.

        Args:
            points: shape (n, 3) in O [m].
            passed: tells of places, shape (k, 3) [m], whether frames have looked through them.
        """
        if passed is not None and self.solid is not None:
            values = _without_passed(self.solid, points, passed)
            if (values != self.solid.values).any():
                return _bounded(replace(self.solid, values=values), points)
        return replace(self, distance=cKDTree(points).query(self.centres, workers=allowed_threads())[0])

    @property
    def area(self) -> float:
        """Of the whole surface [m2]."""
        return float(np.linalg.norm(self.crosses, axis=1).sum() / 2)


def closed_model(
    points: np.ndarray,
    normals: np.ndarray,
    *,
    spacing: float,
    table_z: float | None = 0.0,
    passed: Passed | None = None,
) -> ClosedModel:
    """Closes a scanned cloud.

    Args:
        points: shape (n, 3) in O [m].
        normals: outward unit normals, shape (n, 3).
        spacing: of the points [m].
        table_z: nothing is solid below this height, because the part stands there [m]; None for no table.
        passed: tells of places, shape (k, 3) [m], whether frames have looked through them: there nothing is
            solid. None where that is not known.

    Raises:
        HoleError: too few points for a surface.
    """
    if len(points) < 50:
        raise HoleError(f"{len(points)} points are too few to close a surface; at least 50 are needed")
    low, high = points.min(axis=0), points.max(axis=0)
    cell = max(1.25 * spacing, float((high - low).max()) / _MAX_CELLS)
    pad = 8
    origin = low - pad * cell
    shape = tuple(int(n) for n in np.ceil((high - low) / cell).astype(int) + 2 * pad + 1)
    chi = _indicator(points, normals, origin, cell, shape)
    if table_z is not None:
        below = origin[2] + cell * np.arange(shape[2]) < table_z
        chi[:, :, below] = np.minimum(chi[:, :, below], -0.5 * np.abs(chi).mean())
    solid = _Solid(chi, origin, cell)
    if passed is not None:
        solid = replace(solid, values=_without_passed(solid, points, passed))
    return _bounded(solid, points)


def _bounded(solid: _Solid, points: np.ndarray) -> ClosedModel:
    vertices, triangles = surface_nets(-without_pinches(solid.values))
    vertices = solid.origin + solid.cell * vertices
    vertices, triangles = _pieces_with_data(vertices, triangles, points, solid.cell)
    if len(triangles) == 0:
        raise HoleError("the cloud does not bound a solid; are its normals turned outward?")
    distance, _ = cKDTree(points).query(vertices[triangles].mean(axis=1), workers=allowed_threads())
    return ClosedModel(
        vertices=vertices, triangles=triangles, distance=distance, cell=solid.cell, solid=solid
    )


def _without_passed(solid: _Solid, points: np.ndarray, passed: Passed) -> np.ndarray:
    """The indicator, below zero also where frames looked through what was only guessed.

    Goes inwards from the guessed surface, cell by cell: a lid across a pit gives way as deep as eyes went.
    """
    values = solid.values.copy()
    shape = np.array(values.shape)
    inside = values > 0
    away = np.ones(values.shape, bool)
    at = np.round((points - solid.origin) / solid.cell).astype(int)
    away[tuple(at[((at >= 0) & (at < shape)).all(axis=1)].T)] = False
    # What is solid next to the data is measured, not guessed.
    away = np.asarray(binary_erosion(away, np.ones((3, 3, 3)), border_value=1), dtype=bool)
    edge = np.argwhere(inside & away & np.asarray(binary_dilation(~inside), dtype=bool))
    empty = -0.5 * float(np.abs(values).mean())
    while len(edge):
        gone = edge[passed(solid.origin + solid.cell * edge)]
        values[tuple(gone.T)] = empty
        away[tuple(edge.T)] = False
        beside = np.concatenate([gone + step for step in (*np.eye(3, dtype=int), *-np.eye(3, dtype=int))])
        beside = beside[((beside >= 0) & (beside < shape)).all(axis=1)]
        beside = beside[away[tuple(beside.T)] & inside[tuple(beside.T)]]
        edge = np.unique(beside, axis=0)
    return values


def _indicator(
    points: np.ndarray, normals: np.ndarray, origin: np.ndarray, cell: float, shape: tuple[int, ...]
) -> np.ndarray:
    """Smoothed indicator on the grid, above zero inside, zero at the points on average."""
    # One vote per cell: the density of the points must not weigh.
    at = (points - origin) / cell
    index = np.ravel_multi_index(tuple(np.round(at).astype(int).T), shape)
    used, inverse, count = np.unique(index, return_inverse=True, return_counts=True)
    field = np.zeros((3, int(np.prod(shape))))
    for axis in range(3):
        field[axis, used] = np.bincount(inverse, weights=normals[:, axis]) / count
    divergence = np.zeros(shape)
    for axis in range(3):
        smooth = gaussian_filter(field[axis].reshape(shape), 1.0)
        divergence -= np.gradient(smooth, axis=axis)
    # Cosine transform: the flux through the grid's sides is zero.
    spectrum = fft.dctn(divergence, type=2, norm="ortho")
    laplace = sum(
        (2 * np.cos(np.pi * np.arange(n) / n) - 2).reshape([-1 if a == axis else 1 for a in range(3)])
        for axis, n in enumerate(shape)
    )
    laplace = np.asarray(laplace)
    laplace[0, 0, 0] = 1.0
    spectrum = spectrum / laplace
    spectrum[0, 0, 0] = 0.0
    chi: Any = fft.idctn(spectrum, type=2, norm="ortho")
    level = np.median(map_coordinates(chi, at[:: max(1, len(at) // 50_000)].T, order=1))
    return chi - level


def without_pinches(values: np.ndarray, *, fill: float = 1e-9) -> np.ndarray:
    """Fills grid faces whose signs alternate like a chessboard: there two sheets would share an edge.

    Positive is inside; `fill` is what filled nodes get.
    """
    values = values.copy()
    for _ in range(64):
        changed = 0
        for u, v in ((0, 1), (1, 2), (2, 0)):
            w = np.moveaxis(values, (u, v), (0, 1))  # a view: writing to it writes to values
            corners = (w[:-1, :-1], w[1:, :-1], w[:-1, 1:], w[1:, 1:])
            inside = [c > 0 for c in corners]
            bad = (inside[0] == inside[3]) & (inside[1] == inside[2]) & (inside[0] != inside[1])
            changed += int(bad.sum())
            for corner, solid in zip(corners, inside, strict=True):
                corner[bad & ~solid] = fill
        if not changed:
            break
    return values


def surface_nets(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Dual surface of a grid's zero level (negative inside).

    A vertex in each cell that the level cuts, at the mean of the cuts of its edges, and two triangles across
    each cut edge (Gibson 1998, doi 10.1007/BFb0056277).

    Returns:
        vertices in grid units, shape (n, 3); outward triangles, shape (m, 3).
    """
    values = np.ascontiguousarray(values, dtype=float)
    inside = values < 0
    count = np.zeros(tuple(n - 1 for n in values.shape), np.int8)
    for a in np.ndindex(2, 2, 2):
        count += inside[tuple(slice(c, c + n) for c, n in zip(a, count.shape, strict=True))]
    cells = np.argwhere((count > 0) & (count < 8))
    index = np.full(count.shape, -1, np.int32)
    index[tuple(cells.T)] = np.arange(len(cells))
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        low, high = (inside[_shifted(axis, d, values.shape[axis])] for d in (0, 1))
        cut = np.argwhere(low != high)
        most = np.array(count.shape)
        cut = cut[(cut[:, u] > 0) & (cut[:, v] > 0) & (cut[:, u] < most[u]) & (cut[:, v] < most[v])]
        eu, ev = np.eye(3, dtype=int)[u], np.eye(3, dtype=int)[v]
        corners = [index[tuple((cut - du * eu - dv * ev).T)] for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0))]
        quad = np.stack(corners, axis=1).astype(np.int64)
        quad = np.where(low[tuple(cut.T)][:, None], quad, quad[:, ::-1])
        triangles += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    return _mean_cuts(values, cells), np.concatenate(triangles)


def _shifted(axis: int, by: int, length: int) -> tuple[slice, ...]:
    """Selects all but one layer along an axis: the last (by 0) or the first (by 1)."""
    return tuple(slice(by, length - 1 + by) if a == axis else slice(None) for a in range(3))


@njit(cache=True)
def _mean_cuts(values, cells):
    """Mean of the places where the level cuts each cell's twelve edges, shape (n, 3)."""
    out = np.zeros((len(cells), 3))
    at = np.zeros(3, np.int64)
    for n in range(len(cells)):
        cuts = 0
        for axis in range(3):
            for corner in range(4):
                for k in range(3):
                    at[k] = cells[n, k]
                at[(axis + 1) % 3] += corner & 1
                at[(axis + 2) % 3] += corner >> 1
                a = values[at[0], at[1], at[2]]
                b = values[at[0] + (axis == 0), at[1] + (axis == 1), at[2] + (axis == 2)]
                if (a < 0) != (b < 0):
                    for k in range(3):
                        out[n, k] += at[k]
                    out[n, axis] += a / (a - b)
                    cuts += 1
        for k in range(3):
            out[n, k] /= cuts
    return out


def _pieces_with_data(
    vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """Drops what floats free of all data: the smooth field has bubbles of its own."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(triangles) == 0:
        return vertices, triangles
    i, j = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(vertices),) * 2)
    _, piece = connected_components(graph, directed=False)
    near = cKDTree(points).query(vertices, distance_upper_bound=1.5 * cell)[0] < np.inf
    share = np.bincount(piece, weights=near) / np.bincount(piece)
    keep = (share > 0.3)[piece]
    rank = np.cumsum(keep) - 1
    return vertices[keep], rank[triangles[keep[triangles[:, 0]]]]
