"""Edges with more than two triangles: small flaps are dropped, what else meets there is parted.

Afterwards every edge has one or two triangles, and a walk along a border never meets a fork at an edge.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.geometry.mending.edges import Edges, areas_of, edges_of, pieces

_FLAP = 1e-3
"""A piece that hangs on an edge of three is a flap up to this share of the whole surface."""
_ROUNDS = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Parted:
    """A mesh whose edges have at most two triangles."""

    vertices: np.ndarray
    triangles: np.ndarray
    shared: int
    """Edges that had more than two triangles."""
    flaps: int
    """Triangles of flaps that were dropped."""
    doubled: int
    """Vertices that were doubled."""


def parted(vertices: np.ndarray, triangles: np.ndarray) -> Parted:
    """Drops flaps and parts what meets in edges of more than two triangles."""
    edges = edges_of(triangles)
    shared = int((edges.count > 2).sum())
    flaps = 0
    for _ in range(_ROUNDS):
        if not (edges.count > 2).any():
            break
        drop = _flaps(vertices, triangles, edges)
        if not drop.any():
            break
        flaps += int(drop.sum())
        triangles = triangles[~drop]
        edges = edges_of(triangles)
    n = len(vertices)
    if (edges.count > 2).any():
        vertices, triangles = _split(vertices, triangles, edges)
    return Parted(
        vertices=vertices, triangles=triangles, shared=shared, flaps=flaps, doubled=len(vertices) - n
    )


def _flaps(vertices: np.ndarray, triangles: np.ndarray, edges: Edges) -> np.ndarray:
    """Triangles of small pieces that hang by an edge of three and end in the open, shape (m,)."""
    m = len(triangles)
    pair = edges.pairs() % m
    patch = pieces(m, pair[:, 0], pair[:, 1])
    area = np.bincount(patch, weights=areas_of(vertices, triangles))
    face = np.arange(3 * m) % m
    crowded = edges.count[edges.edge] > 2
    hangs = np.bincount(patch[face[crowded]], minlength=len(area))
    ends = np.bincount(patch[face[edges.border()]], minlength=len(area))
    flap = (hangs > 0) & (ends > 0) & (area < _FLAP * area.sum())
    # Where all that is left of an edge would be a single triangle, a piece belongs to the surface.
    mine = flap[patch[face]] & crowded
    left = edges.count - np.bincount(edges.edge[mine], minlength=len(edges.count))
    needed = mine & (left[edges.edge] < 2)
    flap[patch[face[needed]]] = False
    return flap[patch]


def _split(vertices: np.ndarray, triangles: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """Doubles vertices so that triangles stay joined only where two of them were paired at an edge."""
    m = len(triangles)
    pairs = edges.pairs()
    patch = pieces(m, pairs[:, 0] % m, pairs[:, 1] % m)
    crowd = np.flatnonzero(edges.count[edges.edge] > 2)
    crowd = crowd[np.argsort(edges.edge[crowd], kind="stable")]
    more = []
    for group in np.split(crowd, np.flatnonzero(np.diff(edges.edge[crowd])) + 1):
        more += _partners(vertices, triangles, edges, group, patch)
    pairs = np.concatenate([pairs, np.array(more, np.int64).reshape(-1, 2)])
    # Corner c of triangle f is node c * m + f; a pair of half-edges joins its ends.
    h, g = pairs.T
    alike = edges.tail[h] == edges.tail[g]
    next_h, next_g = (h + m) % (3 * m), (g + m) % (3 * m)
    a = np.concatenate([h, next_h])
    b = np.concatenate([np.where(alike, g, next_g), np.where(alike, next_g, g)])
    label = pieces(3 * m, a, b)
    corner = triangles.T.ravel()
    _, first = np.unique(label, return_index=True)
    rank = corner[first]
    # Fans that met only in a vertex stay joined there; only those at crowded edges are parted.
    touched = np.zeros(len(vertices), bool)
    touched[corner[crowd]] = touched[corner[(crowd + m) % (3 * m)]] = True
    number = np.full(len(first), -1, np.int64)
    fresh = touched[rank]
    number[~fresh] = rank[~fresh]
    order = np.flatnonzero(fresh)[np.argsort(rank[fresh], kind="stable")]
    owner = rank[order]
    again = np.concatenate([[False], owner[1:] == owner[:-1]])
    number[order[~again]] = owner[~again]
    number[order[again]] = len(vertices) + np.arange(int(again.sum()))
    made = np.concatenate([vertices, vertices[owner[again]]])
    return made, number[label].reshape(3, m).T.copy()


def _partners(
    vertices: np.ndarray, triangles: np.ndarray, edges: Edges, group: np.ndarray, patch: np.ndarray
) -> list[tuple[int, int]]:
    """Half-edges of one crowded edge, two by two: those of one patch first, then the flattest (odd numbers
    of triangles: a wall on a surface) or the sharpest (even numbers: bodies that touch).
    """
    m = len(triangles)
    u = vertices[edges.head[group[0]]] - vertices[edges.tail[group[0]]]
    u = u / max(float(np.linalg.norm(u)), 1e-300)
    third = vertices[triangles[group % m, (group // m + 2) % 3]] - vertices[edges.tail[group]]
    out = third - np.outer(third @ u, u)
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
    cosine = out @ out.T
    odd = len(group) % 2 == 1
    choices = []
    for i in range(len(group)):
        for j in range(i):
            agree = edges.tail[group[i]] != edges.tail[group[j]]
            same = patch[group[i] % m] == patch[group[j] % m]
            choices.append((not same, not agree, cosine[i, j] if odd else -cosine[i, j], i, j))
    pairs, free = [], set(range(len(group)))
    for *_, i, j in sorted(choices):
        if i in free and j in free:
            free -= {i, j}
            pairs.append((int(group[i]), int(group[j])))
    return pairs
