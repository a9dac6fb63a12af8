"""The edges of a triangle mesh and who shares them."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scanmotion.geometry.mending.keys import row_keys


@dataclass(frozen=True, eq=False, kw_only=True)
class Edges:
    """Half-edge h of 3 m belongs to triangle h % m and leads from its corner h // m to the next."""

    tail: np.ndarray
    """Vertex where each half-edge begins, shape (3 m,)."""
    head: np.ndarray
    """Vertex where it ends, shape (3 m,)."""
    edge: np.ndarray
    """Number of the edge of each half-edge, shape (3 m,)."""
    count: np.ndarray
    """Triangles at each edge, shape (e,)."""

    @property
    def faces(self) -> int:
        return len(self.tail) // 3

    def pairs(self) -> np.ndarray:
        """Half-edges of the edges with two triangles, shape (k, 2)."""
        order = np.argsort(self.edge, kind="stable")
        return order[self.count[self.edge[order]] == 2].reshape(-1, 2)

    def border(self) -> np.ndarray:
        """Half-edges of the edges with one triangle, shape (k,)."""
        return np.flatnonzero(self.count[self.edge] == 1)


def edges_of(triangles: np.ndarray) -> Edges:
    """The edges of triangles (m, 3)."""
    tail = triangles.T.ravel()
    head = np.roll(triangles, -1, axis=1).T.ravel()
    key = row_keys(np.column_stack([np.minimum(tail, head), np.maximum(tail, head)]))
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    return Edges(tail=tail, head=head, edge=edge.ravel(), count=count)


def pieces(n: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which connected piece each of n nodes belongs to, joined by the links a - b; shape (n,)."""
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(n, n)).tocsr()
    return connected_components(graph, directed=False)[1]


def bodies_of(triangles: np.ndarray, n_vertices: int) -> np.ndarray:
    """Which body each triangle belongs to, by shared vertices; numbered by first triangle, shape (m,)."""
    a, b, c = triangles.T
    label = pieces(n_vertices, np.concatenate([a, b]), np.concatenate([b, c]))[a]
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse.ravel()]


def areas_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area of each triangle, shape (m,)."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
