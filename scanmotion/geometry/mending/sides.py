"""Which side of a surface is out: neighbours agree; bodies by volume, sheets by the file."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scanmotion.geometry.mending.edges import Edges, edges_of, pieces

_ASKED = 64
"""Vertices of a body that are asked whether they lie inside another."""
_NEARLY_CLOSED = 0.03
"""A surface whose holes would take less than this share of it is a body, whatever side the file gives it."""
_MOST_BODIES = 200
"""Nesting is worked out among so many of the largest bodies."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sided:
    """Triangles that agree with one another and look outwards."""

    triangles: np.ndarray
    turned: int
    changes: tuple[str, ...]
    warnings: tuple[str, ...]
    closed: bool


def sided(vertices: np.ndarray, triangles: np.ndarray) -> Sided:
    """Makes neighbours agree, turns each closed body outwards (its cavities inwards), and says so.

    A sheet with a border keeps the side that most of its triangles have in the file: it may be a bowl. Only
    where its holes are a small share of it does its volume decide.
    """
    edges = edges_of(triangles)
    m = edges.faces
    pair = edges.pairs()
    disagree = edges.tail[pair[:, 0]] == edges.tail[pair[:, 1]]
    flip, component, one_sided = _flips(m, pair[:, 0] % m, pair[:, 1] % m, disagree)
    triangles = triangles.copy()
    triangles[flip] = triangles[flip][:, ::-1]
    changes, warnings = [], []
    if flip.any():
        changes.append(f"{int(flip.sum())} triangles were turned to agree with their neighbours")
    if one_sided:
        warnings.append(f"{one_sided} surfaces have one side only (like a Moebius band)")
    inward, doubt = _inward(vertices, triangles, component, edges)
    turn = inward[component]
    triangles[turn] = triangles[turn][:, ::-1]
    if inward.all():
        changes.append("the surface was inside out and was turned")
    elif inward.any():
        changes.append(f"{int(inward.sum())} of {len(inward)} bodies were inside out and were turned")
    if doubt:
        warnings.append(
            "its open surface is hollow on the side that looks out (a bowl, or inside out); its side was kept"
        )
    border = len(edges.border())
    if border:
        warnings.append(f"the surface is open: {border} boundary edges")
    return Sided(
        triangles=triangles, turned=int((flip ^ turn).sum()), changes=tuple(changes),
        warnings=tuple(warnings),
        closed=not (edges.count != 2).any(),
    )  # fmt: skip


def _flips(m: int, f: np.ndarray, g: np.ndarray, disagree: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Which triangles to turn so that neighbours agree, the component of each, and how many have one side.

    A tree over the face graph carries the parity; where no neighbours disagree nothing is done.
    """
    component = pieces(m, f, g)
    flip = np.zeros(m, bool)
    if not disagree.any():
        return flip, component, 0
    # Doubled graph: node i is "kept", node i + m is "turned"; agreeing neighbours join like with like.
    d = disagree
    rows = np.concatenate([f, f + m])
    cols = np.concatenate([np.where(d, g + m, g), np.where(d, g, g + m)])
    double = coo_array((np.ones(len(rows)), (rows, cols)), shape=(2 * m, 2 * m)).tocsr()
    _, label = connected_components(double, directed=False)
    one_sided = len(np.unique(component[label[:m] == label[m:]]))
    root = np.full(component.max() + 1, -1, np.int64)
    first = np.unique(component, return_index=True)[1]
    root[component[first]] = label[first]
    flip = label[:m] != root[component]
    # The smaller side of each component is turned, so that a lone inverted triangle is what changes.
    turned = np.bincount(component, weights=flip)
    total = np.bincount(component)
    return np.where((turned > total / 2)[component], ~flip, flip), component, one_sided


def _inward(
    vertices: np.ndarray, triangles: np.ndarray, component: np.ndarray, edges: Edges
) -> tuple[np.ndarray, bool]:
    """Which components to turn, and whether a sheet that is kept looks inwards."""
    k = int(component.max()) + 1
    volume = _volumes(vertices, triangles, component, k)
    cap, area = _caps(vertices, edges, component, k), np.zeros(k)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    area = np.bincount(component, weights=np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, minlength=k)
    body = cap <= _NEARLY_CLOSED * area
    depth = _depths(vertices, triangles, component, np.flatnonzero(body & (cap == 0)), volume)
    wanted = np.where(depth % 2 == 0, 1.0, -1.0)
    # A volume that is nothing beside its surface decides nothing.
    firm = np.abs(volume) > 1e-9 * area**1.5
    doubt = ~body & firm & (volume < 0) & (area > 0.2 * area.sum())
    return body & firm & (volume * wanted < 0), bool(doubt.any())


def _volumes(vertices: np.ndarray, triangles: np.ndarray, component: np.ndarray, k: int) -> np.ndarray:
    """Signed volume of each component over the middle of its own corners, shape (k,)."""
    corner = triangles.ravel()
    whose = np.repeat(component, 3)
    n = np.bincount(whose, minlength=k)
    middle = np.column_stack(
        [np.bincount(whose, weights=vertices[corner, i], minlength=k) / n for i in range(3)]
    )
    a, b, c = (vertices[triangles[:, i]] - middle[component] for i in range(3))
    return np.bincount(component, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, minlength=k)


def _caps(vertices: np.ndarray, edges: Edges, component: np.ndarray, k: int) -> np.ndarray:
    """Area that fans over the rims of each component take, shape (k,); over 0 wherever there is a border."""
    border = edges.border()
    cap = np.zeros(k)
    if not len(border):
        return cap
    used, ends = np.unique(np.concatenate([edges.tail[border], edges.head[border]]), return_inverse=True)
    tail, head = ends.ravel().reshape(2, -1)
    rim = pieces(len(used), tail, head)
    n = np.bincount(rim)
    middle = np.column_stack([np.bincount(rim, weights=vertices[used, i]) / n for i in range(3)])[rim[tail]]
    fan = np.linalg.norm(np.cross(vertices[used[tail]] - middle, vertices[used[head]] - middle), axis=1) / 2
    np.add.at(cap, component[border % edges.faces], np.maximum(fan, 1e-300))
    return cap


def _depths(
    vertices: np.ndarray, triangles: np.ndarray, component: np.ndarray, bodies: np.ndarray, volume: np.ndarray
) -> np.ndarray:
    """In how many closed bodies each component lies wholly, shape (k,); 0 for what is not closed."""
    depth = np.zeros(len(volume), np.int64)
    if len(bodies) < 2:
        return depth
    bodies = bodies[np.argsort(-np.abs(volume[bodies]), kind="stable")][:_MOST_BODIES]
    order = np.argsort(component, kind="stable")
    bounds = np.searchsorted(component[order], np.arange(len(volume) + 1))
    faces = {c: triangles[order[bounds[c] : bounds[c + 1]]] for c in bodies.tolist()}
    used = {c: np.unique(t) for c, t in faces.items()}
    box = {c: (vertices[u].min(axis=0), vertices[u].max(axis=0)) for c, u in used.items()}
    for i, outer in enumerate(bodies.tolist()):
        for inner in bodies[i + 1 :].tolist():
            if (box[inner][0] <= box[outer][0]).any() or (box[inner][1] >= box[outer][1]).any():
                continue
            asked = used[inner][
                np.linspace(0, len(used[inner]) - 1, min(_ASKED, len(used[inner]))).astype(int)
            ]
            if inside_surface(vertices[asked], vertices[faces[outer]]).all():
                depth[inner] += 1
    return depth


def inside_surface(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) lie inside a closed surface of triangles (m, 3, 3): a slanted ray's crossings."""
    u = np.array([0.8017, 0.2673, 0.5345])
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    h = np.cross(u, f)
    det = np.einsum("ij,ij->i", e, h)
    crossed = np.zeros(len(points), bool)
    with np.errstate(all="ignore"):
        for i, p in enumerate(points):
            s = p - corners[:, 0]
            a = np.einsum("ij,ij->i", s, h) / det
            q = np.cross(s, e)
            b = (q @ u) / det
            t = np.einsum("ij,ij->i", f, q) / det
            crossed[i] = ((a >= 0) & (b >= 0) & (a + b <= 1) & (t > 0)).sum() % 2 == 1
    return crossed
