"""Signs of normals for clouds whose sensor positions are unknown.

Minimum spanning tree of the neighbour graph, weighted by how much two normals disagree (Hoppe et al. 1992,
doi 10.1145/142920.134011), walked from the root. The usual implementations fail on exactly planar grids (all
weights zero, which a sparse matrix reads as no edge), take forever on concentric shells, and leave separate
sheets with signs of their own. Here every edge keeps a least weight, the walk is linear, and each separate
piece gets its sign from its own outermost points; a flat piece, which has no outside, looks along +z.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from scanmotion.geometry.jit import njit

_LEAST = 1e-6
_FLAT = 1e-3


def signs_by_spanning_tree(points: np.ndarray, normals: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """+1 or -1 for each normal, so that they point out of the object.

    Args:
        points: cloud, shape (n, 3) [m].
        normals: unit normals of either sign, shape (n, 3).
        neighbours: indices of each point's nearest neighbours, shape (n, k).

    Returns:
        Signs, shape (n,).
    """
    n = len(points)
    a = np.repeat(np.arange(n), neighbours.shape[1])
    b = neighbours.ravel()
    a, b = a[a != b], b[a != b]
    weight = 1.0 - np.abs(_agreement(points, normals, a, b)) + _LEAST
    low, high = np.minimum(a, b), np.maximum(a, b)
    _, once = np.unique(low.astype(np.int64) * n + high, return_index=True)
    graph = coo_array((weight[once], (low[once], high[once])), shape=(n, n)).tocsr()
    tree = minimum_spanning_tree(graph)
    tree = tree + tree.T
    count, piece = connected_components(tree, directed=False)
    signs = np.ones(n)
    for root in _roots(piece, count):
        order, parent = breadth_first_order(tree, root, directed=False)
        child = order[1:]
        same = _agreement(points, normals, child, parent[child]) >= 0.0
        _carry(signs, child, parent[child], same)
        if _looks_in(points[order], normals[order] * signs[order, None]):
            signs[order] *= -1.0
    return signs


def _agreement(points: np.ndarray, normals: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cosine between a normal carried from a to b along the arc that joins them, and the normal there.

    On an arc the normal at the far end is the mirror image across the chord's middle plane (as in Koenig and
    Gumhold 2009, "Consistent propagation of normal orientations in point clouds"): so signs also pass right
    angles and round the rim of a thin wall.
    """
    chord = points[b] - points[a]
    length = np.linalg.norm(chord, axis=1, keepdims=True)
    chord = chord / np.where(length > 0, length, 1.0)
    along = np.einsum("ij,ij->i", normals[a], chord) * np.einsum("ij,ij->i", normals[b], chord)
    return np.einsum("ij,ij->i", normals[a], normals[b]) - 2.0 * along


def _roots(piece: np.ndarray, count: int) -> np.ndarray:
    """One point of each piece."""
    roots = np.zeros(count, int)
    roots[piece[::-1]] = np.arange(len(piece))[::-1]
    return roots


@njit(cache=True)
def _carry(signs, child, parent, same):
    for k in range(len(child)):
        signs[child[k]] = signs[parent[k]] if same[k] else -signs[parent[k]]


def _looks_in(points: np.ndarray, normals: np.ndarray) -> bool:
    """Whether the normals of one piece point inwards, by its outermost points along the three axes."""
    mean = normals.mean(axis=0)
    extent = np.ptp(points, axis=0)
    if np.linalg.norm(mean) > 1.0 - _FLAT:
        axis = int(np.flatnonzero(np.abs(mean) > 0.1)[-1])
        return bool(mean[axis] < 0.0)
    score = 0.0
    for axis in np.flatnonzero(extent > 0):
        score += normals[points[:, axis].argmax(), axis] - normals[points[:, axis].argmin(), axis]
    return bool(score < 0.0)
