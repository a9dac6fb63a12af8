"""Triangles for the scene: tubes along lines, letters, fields of view, a part fine enough to be coloured."""

from functools import lru_cache

import numpy as np

from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.parts.working_copy import decimated

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (n, 3) and triangles (m, 3)."""


def joined_meshes(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    shifts = np.cumsum([0] + [len(v) for v, _ in meshes])
    vertices = [v for v, _ in meshes] or [np.zeros((0, 3))]
    triangles = [t + s for (_, t), s in zip(meshes, shifts, strict=False)] or [np.zeros((0, 3), int)]
    return np.concatenate(vertices), np.concatenate(triangles)


def tube(points: np.ndarray, radius: float) -> Mesh:
    """A three-sided tube along a polyline, open at its ends; browsers draw lines one pixel thin.

    Args:
        points: shape (k, 3), k >= 2.
        radius: [m].
    """
    points = np.asarray(points, dtype=float)
    along = np.gradient(points, axis=0)
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.divide(along, lengths, out=np.tile([0.0, 0.0, 1.0], (len(points), 1)), where=lengths > 1e-12)
    helper = np.where(np.abs(along[:, 2:3]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(along, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    w = np.cross(along, u)
    ring = [points + radius * (np.cos(a) * u + np.sin(a) * w) for a in 2 * np.pi / 3 * np.arange(3)]
    vertices = np.stack(ring, axis=1).reshape(-1, 3)
    first = 3 * np.arange(len(points) - 1)[:, None]
    sides = [
        first + np.array([[i, (i + 1) % 3, 3 + i], [(i + 1) % 3, 3 + (i + 1) % 3, 3 + i]])[j]
        for i in range(3)
        for j in range(2)
    ]
    return vertices, np.concatenate(sides)


def segments(pairs: np.ndarray, radius: float) -> Mesh:
    """Tubes along separate segments, shape (k, 2, 3)."""
    return joined_meshes([tube(pair, radius) for pair in pairs])


@lru_cache(maxsize=512)
def _outline(text: str) -> tuple[np.ndarray, ...]:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    path = TextPath((0.0, 0.0), text, size=1.0, prop=FontProperties(family="DejaVu Sans"))
    outlines = (np.asarray(p) for p in path.to_polygons(closed_only=True))
    return tuple(p for p in outlines if len(p) >= 2)


def label(text: str, height: float) -> Mesh:
    """Letters as outlines that stand upright in the x-z plane, begin at the origin and face -y.

    Args:
        text: what they say.
        height: of a capital letter [m].
    """
    size = height / 0.73
    outlines = [np.column_stack([p[:, 0], np.zeros(len(p)), p[:, 1]]) * size for p in _outline(text)]
    return joined_meshes([tube(p, 0.035 * size) for p in outlines])


def field_edges(scanner: Scanner, near: float, far: float) -> np.ndarray:
    """Edges of the field of view between two depths, in S, shape (12, 2, 3) [m]."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2.0
    rings = []
    for depth in (near, far):
        sides = np.array(scanner.field(depth))
        rings.append(np.column_stack([corners * sides, np.full(4, depth)]))
    edges = [(rings[0][i], rings[1][i]) for i in range(4)]
    edges += [(ring[i], ring[(i + 1) % 4]) for ring in rings for i in range(4)]
    return np.array(edges)


def field_faces(scanner: Scanner, far: float) -> Mesh:
    """The pyramid of the field of view from the optical centre to the depth `far`, in S."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2.0 * np.array(scanner.field(far))
    vertices = np.vstack([[0.0, 0.0, 0.0], np.column_stack([corners, np.full(4, far)])])
    return vertices, np.array([(0, i, i % 4 + 1) for i in range(1, 5)])


def paintable(part: Part, *, edge: float = 0.008, most: int = 60_000) -> Mesh:
    """The part's surface with triangles small enough to carry colours and few enough to send.

    Args:
        part: a mesh.
        edge: triangles with a longer edge are split [m]; doubled until the result has at most `most`.
        most: triangles.
    """
    vertices, triangles = part.vertices, part.triangles
    if len(triangles) > most:
        return decimated(vertices, triangles, most)
    corners = vertices[triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    # A triangle whose edges are cut n-fold becomes n * n triangles.
    while (np.ceil(lengths / edge) ** 2).sum() > most:
        edge *= 1.25
    counts = np.maximum(np.ceil(lengths / edge).astype(int), 1)
    pieces = [_split(corners[counts == n], n) for n in np.unique(counts)]
    return joined_meshes(pieces)


def _split(corners: np.ndarray, n: int) -> Mesh:
    """Each of k triangles, shape (k, 3, 3), in n * n equal ones; neighbours do not share vertices."""
    ij = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)])
    index = {tuple(p): k for k, p in enumerate(ij)}
    small = []
    for i, j in ij:
        if i + j < n:
            small.append((index[i, j], index[i + 1, j], index[i, j + 1]))
        if i + j < n - 1:
            small.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    weights = np.column_stack([n - ij.sum(axis=1), ij]) / n
    vertices = np.einsum("wc,kcd->kwd", weights, corners).reshape(-1, 3)
    shifts = len(ij) * np.arange(len(corners))[:, None, None]
    return vertices, (np.array(small)[None] + shifts).reshape(-1, 3)


def shading_normals(mesh: Mesh) -> np.ndarray:
    """Unit normals of a mesh's vertices, area-weighted, shape (n, 3); zero where a vertex has no area."""
    vertices, triangles = mesh
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    faces = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, triangles[:, i], faces)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
