"""PCD of version 0.5 to 0.7: ASCII, binary and binary_compressed, organised or not.

Open3D reads these into single precision and trusts the header's counts; here they are held against the file.
"""

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.text import plain_text, text_step, text_table
from scanmotion.geometry.files.raw import NO_TRIANGLES, RawGeometry, float_step
from scanmotion.geometry.files.thin import MAX_POINTS, stride_of

_LETTERS = {"F": "f", "U": "u", "I": "i"}
_MOST_PACKED = 300
"""LZF makes at most so many bytes of one."""


def read_pcd(data: bytes) -> RawGeometry:
    """Reads a PCD.

    Raises:
        PartError: the header is incomplete or claims more than the file holds.
    """
    header, at = _header(data)
    fields = header.get("FIELDS") or header.get("COLUMNS") or []
    if not set("xyz") <= {f.lower() for f in fields}:
        raise PartError("PCD file without fields x, y, z")
    count = _count(header)
    if count < 0 or count > len(data) * _MOST_PACKED:
        raise PartError(f"PCD header claims {count} points in a file of {len(data)} bytes")
    layout, repeats = _layout(fields, header)
    kind = header["DATA"][0].lower() if header["DATA"] else ""
    columns = _columns(data, at, kind, layout, repeats, count)
    every = stride_of(count, MAX_POINTS)
    columns = {name: column[::every] for name, column in columns.items()} if every > 1 else columns
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(float)
    names = ("normal_x", "normal_y", "normal_z")
    normals = (
        np.column_stack([columns[n] for n in names]).astype(float) if set(names) <= set(columns) else None
    )
    said = [f"normals: {', '.join(names)}"] if normals is not None else []
    said += [f"colours: {n}" for n in ("rgb", "rgba") if n in columns]
    notes = [f"its points were thinned: one of {every} was read"] if every > 1 else []
    if header.get("VIEWPOINT", [])[:7] not in ([], ["0", "0", "0", "1", "0", "0", "0"]):
        notes.append("its VIEWPOINT was not applied: the points are taken as they stand")
    single = dict(layout)["x"][1] == "4"
    step = text_step(data[at:], points) if kind == "ascii" else float_step(points) if single else 0.0
    return RawGeometry(
        vertices=points, triangles=NO_TRIANGLES, normals=normals, columns=tuple(said), notes=tuple(notes),
        format=f"PCD, {kind}", step=step,
    )  # fmt: skip


def _header(data: bytes) -> tuple[dict[str, list[str]], int]:
    header: dict[str, list[str]] = {}
    at = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    while "DATA" not in header:
        end = data.find(b"\n", at, at + 65536)
        if end < 0:
            raise PartError("PCD header has no line DATA")
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        if at > 1 << 20:
            raise PartError("PCD header is longer than a header can be")
    return header, at


def _count(header: dict[str, list[str]]) -> int:
    if header.get("POINTS"):
        return int(header["POINTS"][0])
    if header.get("WIDTH"):
        return int(header["WIDTH"][0]) * int((header.get("HEIGHT") or ["1"])[0])
    raise PartError("PCD header says neither POINTS nor WIDTH")


def _layout(
    fields: list[str], header: dict[str, list[str]]
) -> tuple[list[tuple[str, tuple[str, str]]], list[int]]:
    """(name, (letter, bytes)) of each field, and how many numbers each has; 0: it is not there."""
    n = len(fields)
    sizes, kinds = header.get("SIZE", ["4"] * n), header.get("TYPE", ["F"] * n)
    counts = [int(c) for c in header.get("COUNT", ["1"] * n)]
    if not len(sizes) == len(kinds) == len(counts) == n:
        raise PartError("PCD header: FIELDS, SIZE, TYPE and COUNT are of different length")
    for kind, size in zip(kinds, sizes, strict=True):
        if (
            kind.upper() not in _LETTERS
            or size not in ("1", "2", "4", "8")
            or kind.upper() + size in ("F1", "F2")
        ):
            raise PartError(f"PCD header: no type {kind!r} of {size} bytes")
    if any(not 0 <= c <= 1 << 20 for c in counts):
        raise PartError("PCD header: a COUNT is out of range")
    if any(c != 1 for f, c in zip(fields, counts, strict=True) if f.lower() in "xyz"):
        raise PartError("PCD header: x, y and z must have COUNT 1")
    layout = [(f.lower(), (k.upper(), s)) for f, k, s in zip(fields, kinds, sizes, strict=True)]
    return layout, counts


def _columns(
    data: bytes, at: int, kind: str, layout: list, repeats: list[int], count: int
) -> dict[str, np.ndarray]:
    """First number of each field."""
    if kind == "ascii":
        return _ascii(data[at:], layout, repeats, count)
    if kind not in ("binary", "binary_compressed"):
        raise PartError(f"PCD data kind {kind!r} is unknown")
    types = [np.dtype("<" + _LETTERS[k] + s) for _, (k, s) in layout]
    row = sum(t.itemsize * c for t, c in zip(types, repeats, strict=True))
    packed = kind == "binary_compressed"
    body = _unpacked(data, at, row * count) if packed else data[at:]
    if len(body) < row * count:
        raise PartError(
            f"PCD file is cut short: {count} points need {row * count} bytes, {len(body)} are there"
        )
    columns: dict[str, np.ndarray] = {}
    if packed:
        here = 0
        for (name, _), dtype, c in zip(layout, types, repeats, strict=True):
            if c:
                columns.setdefault(name, np.frombuffer(body, dtype, count * c, here)[::c])
            here += dtype.itemsize * c * count
        return columns
    table = np.frombuffer(body, np.uint8, row * count).reshape(count, row)
    here = 0
    for (name, _), dtype, c in zip(layout, types, repeats, strict=True):
        if c:
            octets = np.ascontiguousarray(table[:, here : here + dtype.itemsize])
            columns.setdefault(name, octets.view(dtype).ravel())
        here += dtype.itemsize * c
    return columns


def _unpacked(data: bytes, at: int, size: int) -> bytes:
    if at + 8 > len(data):
        raise PartError("PCD file is cut short before its packed data")
    packed, full = (int(v) for v in np.frombuffer(data, "<u4", 2, at))
    if at + 8 + packed > len(data):
        raise PartError(
            f"PCD file is cut short: {packed} packed bytes are claimed, {len(data) - at - 8} there"
        )
    if full != size:
        raise PartError(f"PCD file: its points need {size} bytes, its packed data claim {full}")
    if full > packed * _MOST_PACKED:
        raise PartError(f"PCD file: {packed} packed bytes cannot hold {full}")
    from scanmotion.geometry.files.formats.walk import unpacked_entry

    raw, made = unpacked_entry(np.frombuffer(data, np.uint8, packed, at + 8), full)
    if made != full:
        raise PartError("PCD file: its packed data are broken")
    return raw.tobytes()


def _ascii(data: bytes, layout: list, repeats: list[int], count: int) -> dict[str, np.ndarray]:
    text = plain_text(data)
    # Each number of the row takes a word; rows may be fewer than claimed only in broken files.
    width = sum(repeats)
    rows = text_table(text, width)
    if len(rows) < count:
        raise PartError(f"PCD file is cut short: {count} points are claimed, {len(rows)} are there")
    columns: dict[str, np.ndarray] = {}
    at = 0
    for (name, _), c in zip(layout, repeats, strict=True):
        if c:
            columns.setdefault(name, rows[:count, at])
        at += c
    return columns
