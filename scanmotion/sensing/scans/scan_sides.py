"""Which side of a measured scan is out, where nobody says from where it was taken.

What a scanner saw from one place is a single layer along its direction of view, and nothing of the part
stands between the two. The layer is the same from behind: there the rest of the part stands in the way; where
there is no rest, the side away from the part's middle is taken. A scan from many places has no such
direction: its normals are carried along a spanning tree, and turned where they run into the part.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import HoleError
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.mending.outward import (
    Occupied,
    escapes,
    look_inwards,
    occupied,
    spacing_of_points,
)
from scanmotion.sensing.holes.boundary import oriented_normals, plane_fits

_DIRECTIONS = 256
_NEIGHBOURS = 14
_HIDDEN = 0.06
"""A scan of which more points are hidden behind others, from every side, was not taken from one place."""
_SURE = 0.35
"""A normal within 70 deg of the direction of view takes its side from it; others from their neighbours."""
_MOST = 6000


@dataclass(frozen=True, eq=False, kw_only=True)
class Side:
    """Normals of a scan that point out of the part, and how that is known."""

    normals: np.ndarray
    """Unit normals, shape (n, 3)."""
    said: str


def sides_of(scans: Sequence[np.ndarray], given: Sequence[np.ndarray | None]) -> list[Side]:
    """Outward normals of scans that stand in one frame, z up.

    Args:
        scans: points of each scan, (n, 3) each [m].
        given: normals of each scan as they are known from its file, or None.

    Raises:
        HoleError: a scan has too few points for a plane fit.
    """
    space = occupied(np.concatenate([p[:: max(1, len(p) // 100_000)] for p in scans]))
    middle = space.low + 0.5 * space.cell * space.shape
    return [_side(p, n, space, middle) for p, n in zip(scans, given, strict=True)]


def _side(points: np.ndarray, given: np.ndarray | None, space: Occupied, middle: np.ndarray) -> Side:
    if given is not None:
        inward = look_inwards(points, given, space)
        turned = "normals of the file, which run into the part and were turned"
        return Side(normals=-given if inward else given, said=turned if inward else "normals of the file")
    if len(points) <= _NEIGHBOURS:
        raise HoleError(f"{len(points)} points are too few to tell its sides")
    index = cKDTree(points).query(points, _NEIGHBOURS, workers=allowed_threads())[1]
    fits = plane_fits(points, index).normals
    d, hidden = _view_direction(points, fits)
    if hidden > _HIDDEN:
        normals = oriented_normals(points)
        inward = look_inwards(points, normals, space)
        said = "taken from several sides; its normals were carried along a spanning tree"
        return Side(normals=-normals if inward else normals, said=said)
    d = d * _sign(points, d, space, middle)
    return Side(normals=_towards(points, fits, d), said=f"seen from ({d[0]:+.2f}, {d[1]:+.2f}, {d[2]:+.2f})")


def _sphere(n: int) -> np.ndarray:
    """Even directions on the upper half of a sphere (a direction and its opposite see the same layer)."""
    i = np.arange(n)
    z = 1.0 - i / (n - 1.0)
    turn = i * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


def _view_direction(points: np.ndarray, fits: np.ndarray) -> tuple[np.ndarray, float]:
    """The line of view along which fewest points hide behind others or are seen edge-on; and that share."""
    some = np.linspace(0, len(points) - 1, min(_MOST, len(points))).astype(int)
    p, n = points[some] - points[some].mean(axis=0), fits[some]
    pixel = 1.5 * spacing_of_points(p)
    best = (np.inf, np.zeros(3), 1.0)
    for d in _sphere(_DIRECTIONS):
        hidden = _hidden(p, d, pixel)
        score = hidden + (np.abs(n @ d) < 0.1).mean() - 1e-3 * float(np.abs(n @ d).mean())
        if score < best[0]:
            best = (score, d, hidden)
    return best[1], best[2]


def _hidden(points: np.ndarray, d: np.ndarray, pixel: float) -> float:
    """Share of points that lie behind others along d."""
    axis = np.eye(3)[int(np.argmin(np.abs(d)))]
    u = np.cross(d, axis)
    u /= np.linalg.norm(u)
    cell = np.floor(np.column_stack([points @ u, points @ np.cross(d, u)]) / pixel).astype(np.int64)
    cell -= cell.min(axis=0)
    key = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
    _, place = np.unique(key, return_inverse=True)
    depth = points @ d
    front = np.full(int(place.max()) + 1, -np.inf)
    np.maximum.at(front, place.ravel(), depth)
    # Along a slope a pixel is as deep as it is wide, some times over.
    return float((depth < front[place.ravel()] - 8.0 * pixel).mean())


def _sign(points: np.ndarray, d: np.ndarray, space: Occupied, middle: np.ndarray) -> float:
    """+1 where the scanner stood along d, -1 where it stood against it."""
    some = points[np.linspace(0, len(points) - 1, min(1500, len(points))).astype(int)]
    along = np.broadcast_to(d, some.shape)
    free, back = escapes(space, some, along).mean(), escapes(space, some, -along).mean()
    if abs(free - back) > 0.15:
        return 1.0 if free > back else -1.0
    off = float((points.mean(axis=0) - middle) @ d)
    if abs(off) > 2.0 * space.cell:
        return 1.0 if off > 0 else -1.0
    return 1.0 if d[2] >= 0 else -1.0


def _towards(points: np.ndarray, fits: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The plane fits' normals on the side of d; those edge-on to it go with their nearest sure neighbour."""
    lean = fits @ d
    normals = fits * np.where(lean < 0, -1.0, 1.0)[:, None]
    sure = np.abs(lean) > _SURE
    if sure.any() and not sure.all():
        near = cKDTree(points[sure]).query(points[~sure], workers=allowed_threads())[1]
        agree = np.einsum("ij,ij->i", normals[~sure], normals[sure][near])
        normals[~sure] *= np.where(agree < -0.2, -1.0, 1.0)[:, None]
    return normals
