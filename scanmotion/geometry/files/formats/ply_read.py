"""PLY: any order of properties, any element, polygons and triangle strips, all three encodings.

trimesh and Open3D drop strips without a word, and trimesh refuses CR line ends and letters beyond ASCII, so
the layout is worked out here and numpy reads the bytes.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.ply_lists import (
    FACE_NAMES,
    VERTEX_NAMES,
    Element,
    PlyTable,
    Property,
    lists_of,
)
from scanmotion.geometry.files.formats.text import (
    lines_of,
    numbers,
    plain_text,
    stated_unit,
    text_step,
    text_table,
)
from scanmotion.geometry.files.raw import (
    NO_TRIANGLES,
    Polygons,
    RawGeometry,
    float_step,
    triangulated,
    whole_numbers,
)
from scanmotion.geometry.files.thin import MAX_POINTS, stride_of

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
    "long": "i8", "ulong": "u8",
}  # fmt: skip
_GRIDS = ("range_grid",)
"""Pixels of a range image that have a point or none (Stanford's scans)."""
_PRINTABLE = bytes(range(32, 127)) + b"\t\r\n"


@dataclass(frozen=True, kw_only=True)
class Header:
    kind: str
    elements: tuple[Element, ...]
    comments: bytes
    start: int


def read_ply(data: bytes) -> RawGeometry:
    """Reads a PLY.

    Raises:
        PartError: the header claims what the file does not hold, or faces are not understood.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        data = plain_text(data)
    header = _header(data)
    tables = (_ascii if header.kind == "ascii" else _binary)(data, header)
    return _geometry(header, tables, data)


def _header(data: bytes) -> Header:
    end = data.find(b"end_header")
    if data[:3].lower() != b"ply" or end < 0 or end > 1 << 20:
        raise PartError("is not a PLY file: header not found")
    first = data.find(b"\n", 0, 80)
    cr = data.find(b"\r", 0, 80)
    only_cr = cr >= 0 and (first < 0 or first > cr + 1)
    start = data.find(b"\r" if only_cr else b"\n", end) + 1
    if start == 0:
        start = len(data)
    kind, raw, comments = "", [], []
    for line in plain_text(data[:end]).decode("latin-1").split("\n")[1:]:
        words = line.split()
        if not words:
            continue
        if words[0] in ("comment", "obj_info"):
            comments.append(line)
        elif words[0] == "format" and len(words) > 1:
            kind = words[1].lower()
        elif words[0] == "element" and len(words) > 2:
            raw.append((words[1].lower(), int(words[2]), []))
        elif words[0] == "property" and raw and len(words) > 2:
            raw[-1][2].append(words[1:])
        else:
            raise PartError(f"PLY header: unknown line {line[:40]!r}")
    if kind not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise PartError(f"PLY format {kind!r} is unknown")
    named = [name for name, _, _ in raw]
    if twice := [name for name in named if named.count(name) > 1]:
        raise PartError(f"PLY header: element {twice[0]} stands twice")
    elements = tuple(_element(name, count, rows, len(data)) for name, count, rows in raw)
    _check_kind(kind, data[start : start + 1024])
    return Header(
        kind=kind, elements=elements, comments="\n".join(comments).encode("latin-1", "replace"), start=start
    )


def _check_kind(kind: str, sample: bytes) -> None:
    """Refuses text that is said to be binary, and the other way round.

    Raises:
        PartError: so it is.
    """
    if kind == "ascii" and b"\0" in sample.rstrip(b"\0"):
        raise PartError("PLY header says ASCII, its content is binary")
    if kind != "ascii" and len(sample) >= 64 and not sample.translate(None, _PRINTABLE):
        raise PartError("PLY header says binary, its content is text")


def _element(name: str, count: int, rows: list[list[str]], size: int) -> Element:
    if count < 0 or count > size:
        raise PartError(f"PLY header claims {count} {name} elements in a file of {size} bytes")
    properties = []
    for words in rows:
        if words[0] == "list":
            if len(words) < 4:
                raise PartError(f"PLY header: a list of {name} has no name")
            types, label = words[1:3], words[3]
        else:
            types, label = [words[0]], words[1]
        if unknown := [t for t in types if t.lower() not in _TYPES]:
            raise PartError(f"PLY header: unknown type {unknown[0][:20]!r} of {name}")
        codes = [_TYPES[t.lower()] for t in types]
        length = codes[0] if len(codes) == 2 else ""
        if length.startswith("f"):
            raise PartError(f"PLY header: the length of a list of {name} cannot be a {types[0]}")
        properties.append(Property(name=label.lower(), kind=codes[-1], length=length))
    names = [p.name for p in properties]
    if len(set(names)) != len(names):
        raise PartError(f"PLY header: a property of {name} stands twice")
    if not properties and count:
        raise PartError(f"PLY header: {name} has no property")
    return Element(name=name, count=count, properties=tuple(properties))


def _geometry(header: Header, tables: dict[str, PlyTable], data: bytes) -> RawGeometry:
    names = {e.name: e for e in header.elements}
    vertex = next((tables[n] for n in VERTEX_NAMES if n in tables), None)
    if vertex is None or not all(axis in vertex.columns for axis in "xyz"):
        raise PartError("PLY file without vertex coordinates x, y, z")
    pieces, notes = [], []
    every = stride_of(len(vertex.columns["x"]), MAX_POINTS)
    if every > 1 and not any(t.faces for t in tables.values()):
        vertex = PlyTable(columns={name: column[::every] for name, column in vertex.columns.items()})
        notes.append(f"its points were thinned: one of {every} was read")
    points = np.column_stack([vertex.columns[axis] for axis in "xyz"]).astype(float)
    for name, table in tables.items():
        if name in VERTEX_NAMES:
            continue
        if name in _GRIDS:
            notes.append("its range grid was left aside: the points are taken as a cloud")
            continue
        if table.faces is None:
            if names[name].count and (name in FACE_NAMES or "strip" in name):
                raise PartError(f"PLY file whose {names[name].count} {name} elements hold no list of corners")
            lists = any(p.length and p.kind[0] in "iu" for p in names[name].properties)
            if lists and names[name].count and not any(t.faces for t in tables.values()):
                raise PartError(f"PLY file whose {names[name].count} {name} elements are not understood")
            if names[name].count:
                notes.append(f"{names[name].count} {name} elements are no faces and were left out")
            continue
        faces = _unstripped(table.faces) if "strip" in name else table.faces
        made, said = triangulated(points, faces)
        pieces.append(made)
        notes += said
        if "strip" in name:
            notes.append(f"{len(table.faces.counts)} triangle strips were read as {len(made)} triangles")
    normals, columns = _normals(vertex)
    kinds = {p.name: p.kind for e in header.elements if e.name in VERTEX_NAMES for p in e.properties}
    text = header.kind == "ascii"
    single = any(kinds[a] == "f4" for a in "xyz")
    step = text_step(data[header.start :], points) if text else float_step(points) if single else 0.0
    unit = stated_unit(header.comments)
    return RawGeometry(
        vertices=points, triangles=np.concatenate(pieces) if pieces else NO_TRIANGLES, normals=normals,
        format=f"PLY, {'ASCII' if text else 'binary'}", columns=columns, notes=tuple(notes), step=step,
        units=unit, units_from="a comment in its header" if unit else "",
    )  # fmt: skip


def _normals(vertex: PlyTable) -> tuple[np.ndarray | None, tuple[str, ...]]:
    said, normals = [], None
    for names in (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")):
        if all(n in vertex.columns for n in names):
            normals = np.column_stack([vertex.columns[n] for n in names]).astype(float)
            said.append(f"normals: {', '.join(names)}")
            break
    if {"red", "green", "blue"} <= vertex.columns.keys():
        said.append("colours: red, green, blue")
    return normals, tuple(said)


def _unstripped(strips: Polygons) -> Polygons:
    """Triangles of triangle strips; -1 ends a strip, equal corners only join strips."""
    made = []
    ends = np.cumsum(strips.counts)
    for first, end in zip(ends - strips.counts, ends, strict=True):
        run = strips.corners[first:end]
        run = np.where(run == 0xFFFFFFFF, -1, run)
        for piece in np.split(run, np.flatnonzero(run == -1)):
            piece = piece[1:] if len(piece) and piece[0] == -1 else piece
            if len(piece) < 3:
                continue
            rows = np.column_stack([piece[:-2], piece[1:-1], piece[2:]])
            rows[1::2] = rows[1::2][:, [1, 0, 2]]
            made.append(rows[(rows != np.roll(rows, 1, axis=1)).all(axis=1)])
    rows = np.concatenate(made) if made else NO_TRIANGLES
    return Polygons(corners=rows.ravel(), counts=np.full(len(rows), 3))


def _binary(data: bytes, header: Header) -> dict[str, PlyTable]:
    at, order, tables = header.start, "<" if "little" in header.kind else ">", {}
    for element in header.elements:
        if at + element.least_size * element.count > len(data):
            raise PartError(f"PLY file is cut short inside its {element.name} elements")
        if element.has_lists:
            tables[element.name], at = lists_of(data, element, at, order)
            continue
        dtype = np.dtype([(p.name, order + p.kind) for p in element.properties])
        table = np.frombuffer(data, dtype, element.count, at)
        at += dtype.itemsize * element.count
        tables[element.name] = PlyTable(columns={p.name: table[p.name] for p in element.properties})
    return tables


def _ascii(data: bytes, header: Header) -> dict[str, PlyTable]:
    text = plain_text(data[header.start :])
    lines = lines_of(text)
    full = np.flatnonzero(lines.words > 0)
    edges = np.append(lines.start[full], len(text))
    tables, row = {}, 0
    for element in header.elements:
        if row + element.count > len(full):
            raise PartError(f"PLY file is cut short inside its {element.name} elements")
        block = text[edges[row] : edges[row + element.count]] if element.count else b""
        tables[element.name] = _ascii_table(block, element)
        row += element.count
    return tables


def _ascii_table(block: bytes, element: Element) -> PlyTable:
    if not element.has_lists:
        try:
            rows = text_table(block, len(element.properties))
        except PartError as error:
            raise PartError(f"PLY {element.name} elements: {error}") from None
        rows = rows.reshape(element.count, len(element.properties))
        return PlyTable(columns={p.name: rows[:, i] for i, p in enumerate(element.properties)})
    vertices = element.name in VERTEX_NAMES
    if element.index_list is None and not vertices:
        return PlyTable(columns={})
    flat = numbers(block)
    words = lines_of(block).words
    words = words[words > 0]
    at = np.cumsum(words) - words
    end = at + words
    columns = {}
    for i, p in enumerate(element.properties):
        if (at >= end).any():
            raise PartError(f"PLY file is cut short inside its {element.name} elements")
        if not p.length:
            if vertices:
                columns[p.name] = flat[at]
            at = at + 1
            continue
        counts = whole_numbers(flat[at])
        if (counts < 0).any() or (at + 1 + counts > end).any():
            raise PartError(f"PLY file is cut short inside its {element.name} elements")
        if i == element.index_list:
            return PlyTable(columns={}, faces=Polygons(corners=_runs(flat, at + 1, counts), counts=counts))
        at = at + 1 + counts
    return PlyTable(columns=columns)


def _runs(flat: np.ndarray, start: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The values of runs of `flat`, one after the other, as int64.

    Raises:
        PartError: a corner that is no whole number.
    """
    first = np.cumsum(counts) - counts
    where = np.repeat(start - first, counts) + np.arange(int(counts.sum()))
    return whole_numbers(flat[where])
