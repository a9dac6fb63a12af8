"""Elements of a PLY; rows of binary ones that hold lists, in one read where all are alike, else walked."""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.raw import Polygons, whole_numbers

VERTEX_NAMES = ("vertex", "vertices", "point", "points")
FACE_NAMES = ("face", "faces", "polygon", "triangle")


@dataclass(frozen=True, kw_only=True)
class Property:
    """One property of an element; `length` is the type of a list's length, "" for a scalar."""

    name: str
    kind: str
    length: str = ""


@dataclass(frozen=True, kw_only=True)
class Element:
    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        return any(p.length for p in self.properties)

    @property
    def least_size(self) -> int:
        """Fewest bytes of one row of a binary file."""
        return sum(int((p.length or p.kind)[1:]) for p in self.properties)

    @property
    def index_list(self) -> int | None:
        """Which property lists the corners of a face."""
        lists = [i for i, p in enumerate(self.properties) if p.length and self.name not in VERTEX_NAMES]
        named = [i for i in lists if self.properties[i].name.startswith("vert")]
        if named:
            return named[0]
        return lists[0] if self.name in FACE_NAMES and len(lists) == 1 else None


@dataclass(frozen=True, eq=False, kw_only=True)
class PlyTable:
    """What was read of an element: columns by name, and the lists of corners."""

    columns: dict[str, np.ndarray]
    faces: Polygons | None = None


def lists_of(data: bytes, element: Element, at: int, order: str) -> tuple[PlyTable, int]:
    """The corners that an element lists, and where the next element begins.

    Raises:
        PartError: the file ends inside a list.
    """
    if element.count == 0:
        return PlyTable(columns={}, faces=None), at
    same = _equal_rows(data, element, at, order)
    if same is not None:
        table, end = same
        if element.index_list is None:
            scalars = {p.name: f"scalar{i}" for i, p in enumerate(element.properties) if not p.length}
            return PlyTable(columns={name: table[field] for name, field in scalars.items()}), end
        corners = table[f"list{element.index_list}"].reshape(element.count, -1)
        corners = whole_numbers(corners)
        counts = np.full(element.count, corners.shape[1])
        return PlyTable(columns={}, faces=Polygons(corners=corners.ravel(), counts=counts)), end
    return _walked(data, element, at, order)


def _equal_rows(data: bytes, element: Element, at: int, order: str) -> tuple[np.ndarray, int] | None:
    """All rows at once, if every row's lists are as long as the first row's."""
    fields: list[tuple] = []
    here = at
    for i, p in enumerate(element.properties):
        if not p.length:
            fields.append((f"scalar{i}", order + p.kind))
            here += int(p.kind[1:])
            continue
        if here + int(p.length[1:]) > len(data):
            return None
        n = int(np.frombuffer(data, order + p.length, 1, here)[0])
        here += int(p.length[1:]) + n * int(p.kind[1:])
        if n < 0 or here > len(data):
            return None
        fields += [(f"length{i}", order + p.length), (f"list{i}", order + p.kind, (n,))]
    dtype = np.dtype(fields)
    if at + dtype.itemsize * element.count > len(data):
        return None
    table = np.frombuffer(data, dtype, element.count, at)
    lengths = [name for name in table.dtype.names or () if name.startswith("length")]
    if any((table[name] != table[name][0]).any() for name in lengths):
        return None
    return table, at + dtype.itemsize * element.count


def _walked(data: bytes, element: Element, at: int, order: str) -> tuple[PlyTable, int]:
    from scanmotion.geometry.files.formats.walk import walk_rows

    raw = np.frombuffer(data, np.uint8)
    length = np.array([int(p.length[1:]) if p.length else 0 for p in element.properties], np.int64)
    item = np.array([int(p.kind[1:]) for p in element.properties], np.int64)
    signed = np.array([p.length.startswith("i") for p in element.properties])
    which = -1 if element.index_list is None else element.index_list

    def walked(wanted: int) -> tuple[np.ndarray, np.ndarray, int]:
        return walk_rows(raw, at, element.count, length, item, signed, order == ">", wanted)

    start, counts, end = walked(which)
    if end < 0:
        raise PartError(f"PLY file is cut short inside its {element.name} elements")
    if which < 0:
        wanted = range(len(item)) if element.name in VERTEX_NAMES else ()
        columns = {}
        for i in wanted:
            p = element.properties[i]
            if not p.length:
                octets = np.ascontiguousarray(raw[walked(i)[0][:, None] + np.arange(item[i])])
                columns[p.name] = octets.view(order + p.kind).ravel()
        return PlyTable(columns=columns), end
    size = item[which]
    first = np.cumsum(counts) - counts
    where = np.repeat(start - first * size, counts) + size * np.arange(int(counts.sum()))
    octets = raw[where[:, None] + np.arange(size)]
    values = np.ascontiguousarray(octets).view(order + element.properties[which].kind)
    return PlyTable(columns={}, faces=Polygons(corners=whole_numbers(values.ravel()), counts=counts)), end
