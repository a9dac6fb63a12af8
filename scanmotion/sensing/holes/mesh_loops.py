"""Boundary loops of a triangle mesh: the edges with one triangle, walked corner by corner."""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import HoleError


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshLoops:
    """The welded mesh and its boundary loops."""

    vertices: np.ndarray
    """Welded vertices, shape (n, 3) [m]."""
    triangles: np.ndarray
    """Proper triangles over the welded vertices, shape (m, 3)."""
    source: np.ndarray
    """First vertex of the input at each welded place, shape (n,)."""
    loops: tuple[np.ndarray, ...]
    """Vertex indices in order, each (k,)."""
    opposite: tuple[np.ndarray, ...]
    """Third corner of the triangle at edge (loop[i], loop[i + 1]), each (k,)."""
    normals: tuple[np.ndarray, ...]
    """Normals of those triangles, each (k, 3)."""


def mesh_loops(vertices: np.ndarray, triangles: np.ndarray, *, weld: bool = True) -> MeshLoops:
    """Welds equal vertices, drops degenerate triangles, and walks the boundary.

    The walk keeps to the triangles: holes that touch in one vertex have one rim, which passes it twice.

    Args:
        vertices: shape (n, 3) [m]. triangles: indices, shape (m, 3).
        weld: False keeps vertices of equal coordinates apart: a part from a file is welded already, and
            where surfaces meet in an edge its doubled vertices keep them apart.

    Raises:
        HoleError: bad shapes, indices or numbers.
    """
    vertices = np.asarray(vertices, float)
    triangles = np.asarray(triangles)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        shapes = f"{vertices.shape} and {triangles.shape}"
        raise HoleError(f"vertices and triangles must have shapes (n, 3) and (m, 3), got {shapes}")
    if not len(triangles):
        raise HoleError("the mesh has no triangles: look for holes in its vertices with holes_from_cloud")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise HoleError(f"triangle indices must be within 0 .. {len(vertices) - 1}")
    if not np.isfinite(vertices[np.unique(triangles)]).all():
        raise HoleError("the mesh has vertices that are not finite")
    if weld:
        place, source, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
        faces = inverse.ravel()[triangles]
    else:
        place, source, faces = vertices, np.arange(len(vertices)), triangles
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    faces = faces[proper]
    loops, edges = _walk(faces)
    face = [edge % len(faces) for edge in edges]
    third = [faces[f, (edge // len(faces) + 2) % 3] for f, edge in zip(face, edges, strict=True)]
    normal = np.cross(place[faces[:, 1]] - place[faces[:, 0]], place[faces[:, 2]] - place[faces[:, 0]])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1.0)
    return MeshLoops(
        vertices=place,
        triangles=faces,
        source=source,
        loops=tuple(loops),
        opposite=tuple(third),
        normals=tuple(normal[f] for f in face),
    )


def _walk(faces: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Loops as vertices in order, and the half-edge (corner * m + face) from each to the next."""
    tail = faces.T.ravel()
    head = np.roll(faces, -1, axis=1).T.ravel()
    key = np.minimum(tail, head).astype(np.int64) * (faces.max(initial=0) + 1) + np.maximum(tail, head)
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    border = np.flatnonzero(count[inverse] == 1)
    ends: dict[int, list[int]] = {}
    for edge in border.tolist():
        ends.setdefault(int(tail[edge]), []).append(edge)
        ends.setdefault(int(head[edge]), []).append(edge)
    partner: dict[tuple[int, int], int] = {}
    pinched = {v for v, edges in ends.items() if len(edges) > 2}
    around = _faces_around(faces, pinched)
    for v, edges in ends.items():
        if len(edges) == 1:
            continue  # the border ends at an edge of three triangles
        pairs = [tuple(edges)] if len(edges) == 2 else _pairs(v, edges, faces, around[v])
        for a, b in pairs:
            partner[v, a], partner[v, b] = b, a
    return _follow(border, tail, head, partner)


def _faces_around(faces: np.ndarray, vertices: set[int]) -> dict[int, list[int]]:
    around: dict[int, list[int]] = {v: [] for v in vertices}
    if vertices:
        for f in np.flatnonzero(np.isin(faces, list(vertices)).any(axis=1)).tolist():
            for v in faces[f].tolist():
                if v in around:
                    around[v].append(f)
    return around


def _pairs(v: int, edges: list[int], faces: np.ndarray, around: list[int]) -> list[tuple[int, int]]:
    """The boundary edges at a pinched vertex, paired by the fan of triangles that they bound."""
    fan = _fans(v, faces, around)
    by_fan: dict[int, list[int]] = {}
    for edge in edges:
        by_fan.setdefault(fan[edge % len(faces)], []).append(edge)
    return [(group[i], group[i + 1]) for group in by_fan.values() for i in range(0, len(group) - 1, 2)]


def _fans(v: int, faces: np.ndarray, around: list[int]) -> dict[int, int]:
    """Number of the fan of each triangle at v: those that share a spoke belong together."""
    fan = {f: f for f in around}
    by_spoke: dict[int, list[int]] = {}
    for f in around:
        for w in faces[f].tolist():
            if w != v:
                by_spoke.setdefault(w, []).append(f)
    for group in by_spoke.values():
        roots = {fan[f] for f in group}
        for f in fan:
            if fan[f] in roots:
                fan[f] = min(roots)
    return fan


def _follow(border, tail, head, partner) -> tuple[list[np.ndarray], list[np.ndarray]]:
    left = dict.fromkeys(border.tolist())
    loops, edges = [], []
    while left:
        start = edge = next(iter(left))
        at = int(tail[edge])
        vertices, walked = [], []
        while edge is not None and edge in left:
            del left[edge]
            vertices.append(at)
            walked.append(edge)
            at = int(head[edge]) if int(tail[edge]) == at else int(tail[edge])
            edge = partner.get((at, edge))
        if edge == start and len(vertices) > 2:
            loops.append(np.array(vertices))
            edges.append(np.array(walked))
    return loops, edges
