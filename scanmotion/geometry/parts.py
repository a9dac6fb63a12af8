"""Parts: read from files, checked and brought into the object frame O; the box and the built-in carving."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.geometry.part_files import read_geometry


def surface_samples(part: Part, n: int, *, rng: np.random.Generator) -> SurfaceSamples:
    """`n` random points on the mesh, uniform by area.

    Raises:
        PartError: the part is a cloud.
    """
    if not part.is_mesh:
        raise PartError("a point cloud has no surface to sample; give a mesh")
    corners = part.vertices[part.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    # Stratified along the cumulated area: the count per region strays far less than with independent draws.
    edges = np.concatenate([[0.0], np.cumsum(areas)])
    at = (np.arange(n) + rng.random(n)) / n * edges[-1]
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(areas) - 1)
    u, v = rng.random(n), rng.random(n)
    flip = u + v > 1.0
    u[flip], v[flip] = 1.0 - u[flip], 1.0 - v[flip]
    a, b, c = corners[index, 0], corners[index, 1], corners[index, 2]
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    normals = cross[index] / np.linalg.norm(cross[index], axis=1, keepdims=True)
    return SurfaceSamples(points=points, normals=normals, area=float(edges[-1] / n))


def box_part(length: float, width: float, height: float) -> Part:
    """The closed box of L x W x H [m] on the table's centre: all that is known of an unseen object.

    Raises:
        PartError: a side is not a positive, finite number.
    """
    sides = np.array([length, width, height], dtype=float)
    if not np.isfinite(sides).all() or (sides <= 0).any():
        raise PartError(f"box of {length:g} x {width:g} x {height:g} m: sides must be positive numbers")
    corners = np.array([[x, y, z] for z in (0.0, 1.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Part(name="box", vertices=corners * sides, triangles=np.array(triangles))


UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_AXES = {"x": 0, "y": 1, "z": 2}


def part_from_file(path: str | Path, *, units: str = "mm", up: str = "+z", place: str = "centre") -> Part:
    """Loads a mesh (PLY, STL, OBJ) or a cloud (PLY, PCD, XYZ) into frame O.

    Args:
        path: the file.
        units: unit of the file's coordinates: mm, cm, m or in.
        up: axis of the file that points up: +x, -x, +y, -y, +z or -z.
        place: "centre" stands the box's centre on the table's axis and its base at z = 0; "keep" takes the
            file's x, y, z as they are (a scan measured in the turntable's frame).

    Raises:
        PartError: missing, broken, empty, not finite, flat, or absurd in size; the line says what.
    """
    raw = read_geometry(path)
    name = str(path)
    if units not in UNITS:
        raise PartError(f"unknown unit {units!r}; known: {', '.join(UNITS)}", path=name)
    if place not in ("centre", "keep"):
        raise PartError(f"unknown placement {place!r}; known: centre, keep", path=name)
    if len(raw.vertices) < 3:
        raise PartError(f"only {len(raw.vertices)} points", path=name)
    bad = np.logical_not(np.isfinite(raw.vertices).all(axis=1))
    if bad.any():
        raise PartError(f"{int(bad.sum())} of {len(raw.vertices)} points are not finite numbers", path=name)
    R = _upright(up, name)
    mesh = raw if len(raw.triangles) == 0 else None
    vertices, triangles, repairs, closed = (
        (raw.vertices, raw.triangles, [], False)
        if mesh is not None
        else repaired(raw.vertices, raw.triangles, name)
    )
    scaled = vertices @ R.T * UNITS[units]
    _check_size(scaled, units, name)
    low, high = scaled.min(axis=0), scaled.max(axis=0)
    shift = (
        -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        if place == "centre"
        else np.zeros(3)
    )
    if place == "keep" and not -0.02 <= low[2] <= 0.5:
        raise PartError(
            f"its lowest point is at z = {low[2] * 1e3:.0f} mm, not on the table; use --place centre",
            path=name,
        )
    X_OI = np.eye(4)
    X_OI[:3, :3], X_OI[:3, 3] = R * UNITS[units], shift
    normals = None
    if raw.normals is not None and mesh is not None and np.isfinite(raw.normals).all():
        lengths = np.linalg.norm(raw.normals, axis=1, keepdims=True)
        normals = raw.normals / lengths @ R.T if (lengths > 1e-6).all() else None
    return Part(
        name=Path(path).stem, vertices=scaled + shift, triangles=triangles, normals=normals,
        X_OI=X_OI, closed=closed, repairs=tuple(repairs),
    )  # fmt: skip


def _upright(up: str, path: str) -> np.ndarray:
    """Rotation that turns the file's `up` axis to +z; the two others keep their cyclic order."""
    if len(up) != 2 or up[0] not in "+-" or up[1] not in _AXES:
        raise PartError(f"unknown up axis {up!r}; known: +x, -x, +y, -y, +z, -z", path=path)
    z = np.zeros(3)
    z[_AXES[up[1]]] = 1.0 if up[0] == "+" else -1.0
    x = np.roll(np.abs(z), 1)
    return np.stack([x, np.cross(z, x), z])


def _check_size(vertices: np.ndarray, units: str, path: str) -> None:
    largest = float(np.ptp(vertices, axis=0).max())
    if largest < 0.01:
        raise PartError(
            f"is only {largest * 1e3:.3g} mm large in unit {units!r}; try another --units (mm, cm, m, in)",
            path=path,
        )
    if largest > 20.0:
        raise PartError(
            f"is {largest:.3g} m large in unit {units!r}; try another --units (mm, cm, m, in)", path=path
        )
    centred = vertices - vertices.mean(axis=0)
    if np.linalg.matrix_rank(centred.T @ centred, tol=1e-12 * largest**2 * len(vertices)) < 2:
        raise PartError("all points lie on one line", path=path)


def check_fits(part: Part, table_radius: float, max_height: float) -> None:
    """Refuses a part that hangs over the table's edge or is taller than `max_height` [m].

    Raises:
        PartError: with the size found and the size allowed.
    """
    if part.radius > table_radius:
        raise PartError(
            f"reaches {part.radius * 1e3:.0f} mm from the table's axis; "
            f"the table's radius is {table_radius * 1e3:.0f} mm"
        )
    if part.extent[2] > max_height:
        raise PartError(f"is {part.extent[2] * 1e3:.0f} mm tall, the cell takes {max_height * 1e3:.0f} mm")


def repaired(
    vertices: np.ndarray, triangles: np.ndarray, path: str = ""
) -> tuple[np.ndarray, np.ndarray, list[str], bool]:
    """Merges, drops and turns what is plainly broken in a mesh, and says so.

    Returns:
        vertices, triangles, one sentence for each repair, and whether the result is watertight.

    Raises:
        PartError: nothing of a surface is left.
    """
    repairs: list[str] = []
    n = len(vertices)
    size = float(np.ptp(vertices, axis=0).max())
    _, first, inverse = np.unique(
        np.round(vertices / max(size, 1e-300) * 1e9).astype(np.int64),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    order = np.sort(first)
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(len(order))
    vertices, triangles = vertices[order], rank[first[inverse.ravel()]][triangles]
    if len(order) < n:
        repairs.append(f"{n - len(order)} duplicate vertices were merged")
    a, b, c = triangles.T
    cross = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
    keep = (a != b) & (b != c) & (c != a) & (np.linalg.norm(cross, axis=1) > 1e-16 * size * size)
    if not keep.all():
        repairs.append(f"{int((~keep).sum())} degenerate triangles were dropped")
        triangles = triangles[keep]
    _, unique = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    if len(unique) < len(triangles):
        repairs.append(f"{len(triangles) - len(unique)} duplicate triangles were dropped")
        triangles = triangles[np.sort(unique)]
    if len(triangles) == 0:
        raise PartError("no triangle of positive area", path=path)
    triangles, edge_repairs, closed = _oriented(vertices, triangles)
    used = np.unique(triangles)
    if len(used) < len(vertices):
        rank = np.full(len(vertices), -1, np.int64)
        rank[used] = np.arange(len(used))
        repairs.append(f"{len(vertices) - len(used)} vertices without a triangle were dropped")
        vertices, triangles = vertices[used], rank[triangles]
    return vertices, triangles, repairs + edge_repairs, closed


def _oriented(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, list[str], bool]:
    """Makes neighbouring triangles agree, turns inside-out components, and tests for open or shared edges."""
    repairs: list[str] = []
    m = len(triangles)
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    face = np.tile(np.arange(m), 3)
    forward = directed[:, 0] < directed[:, 1]
    _, edge, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    edge = edge.ravel()
    if (count > 2).any():
        repairs.append(
            f"{int((count > 2).sum())} edges are shared by more than two triangles (left as they are)"
        )
    order = np.argsort(edge, kind="stable")
    pair = order[np.isin(edge[order], np.flatnonzero(count == 2))].reshape(-1, 2)
    f, g = face[pair[:, 0]], face[pair[:, 1]]
    disagree = forward[pair[:, 0]] == forward[pair[:, 1]]
    flip, component = _flips(m, f, g, disagree)
    triangles = triangles.copy()
    triangles[flip] = triangles[flip][:, ::-1]
    if flip.any():
        repairs.append(f"{int(flip.sum())} triangles were turned to agree with their neighbours")
    a, b, c = (vertices[triangles[:, i]] - vertices.mean(axis=0) for i in range(3))
    volume = np.bincount(component, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)
    # An inner wall (a cavity) of a closed solid has negative volume rightly: only the largest shell decides.
    largest = int(np.argmax(np.abs(volume)))
    if volume[largest] < 0:
        triangles = triangles[:, ::-1].copy()
        repairs.append("the surface was inside out and was turned")
    if (count == 1).any():
        repairs.append(f"the surface is open: {int((count == 1).sum())} boundary edges")
    return triangles, repairs, not (count != 2).any()


def _flips(m: int, f: np.ndarray, g: np.ndarray, disagree: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangles to turn so that neighbours agree, and the component of each triangle.

    A breadth-first tree over the face graph carries the parity; where no neighbours disagree nothing is done.
    """
    graph = coo_array(
        (np.ones(2 * len(f)), (np.concatenate([f, g]), np.concatenate([g, f]))), shape=(m, m)
    ).tocsr()
    _, component = connected_components(graph, directed=False)
    flip = np.zeros(m, bool)
    if not disagree.any():
        return flip, component
    # Doubled graph: node i is "kept", node i + m is "turned"; agreeing neighbours join like with like.
    d = disagree
    rows = np.concatenate([f, f + m])
    cols = np.concatenate([np.where(d, g + m, g), np.where(d, g, g + m)])
    double = coo_array((np.ones(len(rows)), (rows, cols)), shape=(2 * m, 2 * m)).tocsr()
    _, label = connected_components(double, directed=False)
    root = np.full(component.max() + 1, -1, np.int64)
    first = np.unique(component, return_index=True)[1]
    root[component[first]] = label[first]
    flip = label[:m] != root[component]
    # The smaller side of each component is turned, so that a lone inverted triangle is what changes.
    turned = np.bincount(component, weights=flip)
    total = np.bincount(component)
    return np.where((turned > total / 2)[component], ~flip, flip), component


def carving() -> Part:
    """The built-in part: a carving of 600 x 330 x 200 mm, made by models/parts/carving.py."""
    return replace(part_from_file(models_dir() / "parts" / "carving.ply"), name="carving")


def models_dir() -> Path:
    """The folder of robots, cells and parts: in the checkout, or installed inside the package."""
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "_models", here.parent / "models"):
        if folder.is_dir():
            return folder
    raise PartError("the models folder is missing; install scanmotion again")
