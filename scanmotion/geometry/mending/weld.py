"""Vertices that are one: equal ones always, near ones at the border by the file's own resolution."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.geometry.mending.edges import edges_of, pieces
from scanmotion.geometry.mending.keys import equal_points, in_order

_STEPS = 4.0
"""Copies of a corner may differ by so many of the file's steps."""
_OF_SIZE = 5e-6
"""Cracks up to this share of the part's size are closed: 1.5 um at 300 mm, far under what is scanned."""
_OF_EDGE = 0.2
"""A vertex never moves by more than this share of its shortest edge."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Welded:
    """A mesh whose equal vertices are one."""

    vertices: np.ndarray
    triangles: np.ndarray
    merged: int
    """Vertices that were merged into another."""


def welded(vertices: np.ndarray, triangles: np.ndarray) -> Welded:
    """Merges vertices of equal coordinates; the first of the file stays."""
    first, place = equal_points(vertices)
    if len(first) == len(vertices):
        return Welded(vertices=vertices, triangles=triangles, merged=0)
    return Welded(vertices=vertices[first], triangles=place[triangles], merged=len(vertices) - len(first))


def weld_tolerance(size: float, step: float) -> float:
    """How far apart two copies of one corner may lie, in the file's unit."""
    return max(_STEPS * step, _OF_SIZE * size)


def border_welded(vertices: np.ndarray, triangles: np.ndarray, *, tolerance: float) -> Welded:
    """Merges vertices of open edges that lie within `tolerance` of one another.

    Only the border is touched: what is closed stays as it is.
    """
    same = Welded(vertices=vertices, triangles=triangles, merged=0)
    edges = edges_of(triangles)
    open_ = edges.border()
    if not len(open_):
        return same
    length = np.linalg.norm(vertices[edges.tail] - vertices[edges.head], axis=1)
    shortest = np.full(len(vertices), np.inf)
    np.minimum.at(shortest, edges.tail, length)
    np.minimum.at(shortest, edges.head, length)
    border = np.unique(np.concatenate([edges.tail[open_], edges.head[open_]]))
    tree = cKDTree(vertices[border])
    near = tree.query_pairs(tolerance, output_type="ndarray")
    if not len(near):
        return same
    a, b = border[near[:, 0]], border[near[:, 1]]
    apart = np.linalg.norm(vertices[a] - vertices[b], axis=1)
    fit = apart <= _OF_EDGE * np.minimum(shortest[a], shortest[b])
    if not fit.any():
        return same
    label = pieces(len(vertices), a[fit], b[fit])
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    first, place = in_order(first, inverse.ravel())
    return Welded(vertices=vertices[first], triangles=place[triangles], merged=len(vertices) - len(first))
