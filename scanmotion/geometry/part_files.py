"""Readers of part files: PLY, STL, OBJ, PCD, XYZ.

Written here because a broken file must end in one clear line: Open3D's readers answer some of them with a
warning and an empty geometry, and others with a crash. Every count that a header claims is held against the
file's size before anything is allocated.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError

MAX_BYTES = 4 << 30
MAX_TRIANGLES = 50_000_000
SUFFIXES = (".ply", ".stl", ".obj", ".pcd", ".xyz")

_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class RawGeometry:
    """What a file holds, in its own unit and frame, unchecked beyond its syntax."""

    vertices: np.ndarray
    """Shape (n, 3)."""
    triangles: np.ndarray
    """Shape (m, 3), int64; (0, 3) for a cloud."""
    normals: np.ndarray | None = None
    """Shape (n, 3)."""


def read_geometry(path: str | Path) -> RawGeometry:
    """Reads a mesh or a cloud.

    Raises:
        PartError: no such file, unknown kind of file, or content that is not what its header says.
    """
    path = Path(path)
    if not path.exists():
        raise PartError("no such file", path=str(path))
    if not path.is_file():
        raise PartError("is not a file", path=str(path))
    suffix = path.suffix.lower()
    reader = {".ply": _ply, ".stl": _stl, ".obj": _obj, ".pcd": _pcd, ".xyz": _xyz}.get(suffix)
    if reader is None:
        raise PartError(f"unknown kind of file {suffix!r}; known: {', '.join(SUFFIXES)}", path=str(path))
    size = path.stat().st_size
    if size == 0:
        raise PartError("the file is empty", path=str(path))
    if size > MAX_BYTES:
        raise PartError(
            f"{size / 2**30:.1f} GiB is more than the {MAX_BYTES >> 30} GiB allowed", path=str(path)
        )
    try:
        raw = reader(path.read_bytes())
    except PartError as error:
        raise PartError(str(error), path=str(path)) from None
    except (ValueError, IndexError, KeyError, OverflowError, TypeError, UnicodeDecodeError) as error:
        raise PartError(f"is not a readable {suffix[1:].upper()} file ({error})", path=str(path)) from None
    except OSError as error:
        raise PartError(f"cannot be read ({error.strerror})", path=str(path)) from None
    return raw


def _triangles(faces: list[np.ndarray] | np.ndarray, n_vertices: int) -> np.ndarray:
    triangles = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if len(triangles) > MAX_TRIANGLES:
        raise PartError(
            f"{len(triangles)} triangles are more than the {MAX_TRIANGLES} allowed; decimate the mesh"
        )
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= n_vertices):
        raise PartError(f"a face points at vertex {int(triangles.max())} of {n_vertices}")
    return triangles


@dataclass(frozen=True, kw_only=True)
class _Element:
    name: str
    count: int
    scalars: tuple[tuple[str, str], ...]
    lists: tuple[tuple[str, str, str], ...]
    order: tuple[str, ...]


def _ply_header(data: bytes) -> tuple[str, list[_Element], int]:
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0 or end > 1 << 20:
        raise PartError("is not a PLY file: header not found")
    start = data.index(b"\n", end) + 1
    kind, raw = "", []
    for line in data[:end].decode("ascii", errors="strict").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            kind = words[1]
        elif words[0] == "element":
            raw.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            raw[-1][2].append(words[1:])
        else:
            raise PartError(f"PLY header: unknown line {line[:40]!r}")
    if kind not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise PartError(f"PLY format {kind!r} is unknown")
    elements = []
    for name, count, properties in raw:
        if count < 0 or count > len(data):
            raise PartError(f"PLY header claims {count} {name} elements in a file of {len(data)} bytes")
        scalars = tuple((p[1], _PLY_TYPES[p[0]]) for p in properties if p[0] != "list")
        lists = tuple((p[3], _PLY_TYPES[p[1]], _PLY_TYPES[p[2]]) for p in properties if p[0] == "list")
        order = tuple(p[3] if p[0] == "list" else p[1] for p in properties)
        if len(set(order)) != len(order):
            raise PartError(f"PLY header: a property of {name} stands twice")
        elements.append(_Element(name=name, count=count, scalars=scalars, lists=lists, order=order))
    return kind, elements, start


def _ply(data: bytes) -> RawGeometry:
    kind, elements, at = _ply_header(data)
    read = _ply_ascii if kind == "ascii" else _ply_binary
    columns, faces = read(data, elements, at, "<" if "little" in kind else ">")
    if not all(axis in columns for axis in "xyz"):
        raise PartError("PLY file without vertex coordinates x, y, z")
    vertices = np.column_stack([columns[axis] for axis in "xyz"]).astype(float)
    normals = None
    if all(axis in columns for axis in ("nx", "ny", "nz")):
        normals = np.column_stack([columns[axis] for axis in ("nx", "ny", "nz")]).astype(float)
    return RawGeometry(vertices=vertices, triangles=_triangles(faces, len(vertices)), normals=normals)


def _ply_binary(data: bytes, elements: list[_Element], at: int, order: str) -> tuple[dict, np.ndarray]:
    columns: dict[str, np.ndarray] = {}
    faces = np.zeros((0, 3), np.int64)
    for element in elements:
        if not element.lists:
            dtype = np.dtype([(name, order + kind) for name, kind in element.scalars])
            if at + dtype.itemsize * element.count > len(data):
                raise PartError(f"PLY file is cut short inside its {element.name} elements")
            table = np.frombuffer(data, dtype, element.count, at)
            at += dtype.itemsize * element.count
            if element.name == "vertex":
                columns = {name: table[name] for name, _ in element.scalars}
            continue
        indices, at = _ply_lists(data, element, at, order)
        if element.name == "face":
            faces = indices
    return columns, faces


def _ply_lists(data: bytes, element: _Element, at: int, order: str) -> tuple[np.ndarray, int]:
    """Faces of a binary element whose rows hold lists; triangles in one read, other polygons row by row."""
    triangle = np.dtype(
        [
            item
            for name in element.order
            for item in _triangle_fields(name, element, order)
        ]
    )  # fmt: skip
    index_name = next((n for n in element.order if n in ("vertex_indices", "vertex_index")), None)
    if len(element.lists) == 1 and at + triangle.itemsize * element.count <= len(data):
        table = np.frombuffer(data, triangle, element.count, at)
        name = element.lists[0][0]
        if (table[name + "#"] == 3).all():
            at += triangle.itemsize * element.count
            return (table[name].astype(np.int64) if name == index_name else np.zeros((0, 3), np.int64)), at
    rows: list[tuple[int, int, int]] = []
    kinds = dict(element.scalars) | {name: (c, v) for name, c, v in element.lists}
    for _ in range(element.count):
        for name in element.order:
            kind = kinds[name]
            if isinstance(kind, str):
                at += np.dtype(kind).itemsize
                continue
            n = int(np.frombuffer(data, order + kind[0], 1, at)[0])
            at += np.dtype(kind[0]).itemsize
            if n < 0 or at + n * np.dtype(kind[1]).itemsize > len(data):
                raise PartError("PLY file is cut short inside its faces")
            if name == index_name:
                loop = np.frombuffer(data, order + kind[1], n, at).astype(np.int64)
                rows += [(loop[0], loop[i], loop[i + 1]) for i in range(1, n - 1)]
            at += n * np.dtype(kind[1]).itemsize
    return np.array(rows, np.int64).reshape(-1, 3), at


def _triangle_fields(name: str, element: _Element, order: str) -> list[tuple]:
    for list_name, count_kind, value_kind in element.lists:
        if list_name == name:
            return [(name + "#", order + count_kind), (name, order + value_kind, (3,))]
    return [(name, order + dict(element.scalars)[name])]


def _ply_ascii(data: bytes, elements: list[_Element], at: int, _: str) -> tuple[dict, np.ndarray]:
    lines = data[at:].decode("ascii").splitlines()
    columns: dict[str, np.ndarray] = {}
    rows: list[tuple[int, int, int]] = []
    first = 0
    for element in elements:
        block = lines[first : first + element.count]
        first += element.count
        if len(block) < element.count:
            raise PartError(f"PLY file is cut short inside its {element.name} elements")
        if element.name == "vertex":
            table = np.array([line.split()[: len(element.order)] for line in block], dtype=float)
            table = table.reshape(element.count, -1)
            columns = {name: table[:, i] for i, name in enumerate(element.order)} if element.count else {}
        elif element.name == "face":
            for line in block:
                words = line.split()
                n = int(words[0])
                loop = [int(word) for word in words[1 : n + 1]]
                if len(loop) < n:
                    raise PartError("PLY file is cut short inside its faces")
                rows += [(loop[0], loop[i], loop[i + 1]) for i in range(1, n - 1)]
    return columns, np.array(rows, np.int64).reshape(-1, 3)


def _stl(data: bytes) -> RawGeometry:
    count = int(np.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        dtype = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(data, dtype, count, 84)["corners"].astype(float)
    elif data.lstrip()[:5].lower() == b"solid":
        words = [line.split() for line in data.decode("ascii", errors="strict").splitlines()]
        corners = np.array([w[1:4] for w in words if w and w[0] == "vertex"], dtype=float)
        if len(corners) % 3 or corners.size % 9:
            raise PartError("STL file is cut short inside a facet")
        corners = corners.reshape(-1, 3, 3)
    else:
        raise PartError(
            f"STL header claims {count} triangles, the file has room for {(len(data) - 84) / 50:.1f}"
        )
    vertices = corners.reshape(-1, 3)
    return RawGeometry(vertices=vertices, triangles=_triangles(np.arange(len(vertices)), len(vertices)))


def _obj(data: bytes) -> RawGeometry:
    vertices: list[list[str]] = []
    rows: list[tuple[int, int, int]] = []
    for line in data.decode("utf-8", errors="strict").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(words[1:4])
        elif words[0] == "f":
            loop = [int(word.split("/")[0]) for word in words[1:]]
            loop = [i - 1 if i > 0 else len(vertices) + i for i in loop]
            rows += [(loop[0], loop[i], loop[i + 1]) for i in range(1, len(loop) - 1)]
    if not vertices:
        raise PartError("OBJ file without vertices")
    points = np.array(vertices, dtype=float).reshape(-1, 3)
    return RawGeometry(vertices=points, triangles=_triangles(np.array(rows, np.int64), len(points)))


def _pcd(data: bytes) -> RawGeometry:
    header, at = {}, 0
    while "DATA" not in header:
        end = data.index(b"\n", at)
        words = data[at:end].decode("ascii").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    fields, count = header["FIELDS"], int(header["POINTS"][0])
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(fields))]
    if count < 0 or count > len(data):
        raise PartError(f"PCD header claims {count} points in a file of {len(data)} bytes")
    if not set("xyz") <= set(fields):
        raise PartError("PCD file without fields x, y, z")
    if header["DATA"][0] == "binary":
        letter = {"F": "f", "U": "u", "I": "i"}
        dtype = np.dtype(
            [
                (f"{name}@{i}", "<" + letter[kind] + size, (c,))
                for i, (name, kind, size, c) in enumerate(
                    zip(fields, header["TYPE"], header["SIZE"], counts, strict=True)
                )
            ]
        )
        if at + dtype.itemsize * count > len(data):
            raise PartError("PCD file is cut short")
        table = np.frombuffer(data, dtype, count, at)
        columns = {name: table[f"{name}@{i}"][:, 0] for i, name in enumerate(fields)}
    elif header["DATA"][0] == "ascii":
        rows = [line.split() for line in data[at:].decode("ascii").splitlines() if line.strip()]
        if len(rows) < count:
            raise PartError("PCD file is cut short")
        offsets = np.concatenate([[0], np.cumsum(counts)[:-1]])
        table = np.array(rows[:count], dtype=float)
        columns = {name: table[:, o] for name, o in zip(fields, offsets, strict=True)}
    else:
        raise PartError(f"PCD data kind {header['DATA'][0]!r} is not read here; save it as ascii or binary")
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(float)
    names = ("normal_x", "normal_y", "normal_z")
    normals = (
        np.column_stack([columns[n] for n in names]).astype(float) if set(names) <= set(fields) else None
    )
    return RawGeometry(vertices=points, triangles=np.zeros((0, 3), np.int64), normals=normals)


def _xyz(data: bytes) -> RawGeometry:
    lines = [line.replace(",", " ").split() for line in data.decode("ascii").splitlines()]
    rows = [words for words in lines if words and not words[0].startswith("#")]
    if not rows:
        raise PartError("XYZ file without points")
    width = 6 if all(len(words) >= 6 for words in rows) else 3
    table = np.array([words[:width] for words in rows], dtype=float).reshape(len(rows), width)
    normals = table[:, 3:] if width == 6 else None
    return RawGeometry(vertices=table[:, :3], triangles=np.zeros((0, 3), np.int64), normals=normals)
