"""STL, binary and ASCII, as programs really write it."""

import mmap
import re
from collections.abc import Iterable

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.text import numbers, plain_text, stated_unit, text_blocks, text_step
from scanmotion.geometry.files.raw import RawGeometry, checked_triangles, float_step
from scanmotion.geometry.files.thin import CHUNK, MAX_TRIANGLES, clustered

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_NUMBER = rb"(?:[-+.\d]\S*|nan\S*|inf\S*)"
_VERTEX = re.compile(
    rb"\bvertex\s+(" + _NUMBER + rb"\s+" + _NUMBER + rb"\s+" + _NUMBER + rb")", re.IGNORECASE
)
_HEAD = 4096
_UNTOLD = (0, 0xFFFFFFFF)
"""Counts of programs that write facets before they know how many."""


def read_stl(data: bytes | mmap.mmap) -> RawGeometry:
    """Reads an STL of one solid or several.

    Raises:
        PartError: cut short, or neither binary nor ASCII.
    """
    if _is_text(data[:_HEAD], len(data)):
        corners, notes, step = _ascii(data[:])
        return _soup(corners, "ASCII", notes, step, stated_unit(data[:200].split(b"\n")[0]), ())
    facets, notes = _binary(data)
    unit, total = stated_unit(data[:80]), sum(map(len, facets))
    if total <= MAX_TRIANGLES:
        table = np.concatenate(facets)
        corners = table["corners"].astype(float)
        doubts = _against_winding(corners, table["normal"].astype(float))
        return _soup(corners, "binary", notes, float_step(corners.reshape(-1, 3)), unit, doubts)

    def chunks() -> Iterable[np.ndarray]:
        for table in facets:
            for at in range(0, len(table), CHUNK):
                yield table["corners"][at : at + CHUNK]

    vertices, triangles, said = clustered(chunks, total)
    return RawGeometry(
        vertices=vertices, triangles=triangles, format="STL, binary", notes=(*notes, said),
        step=float_step(vertices), units=unit, units_from="its header" if unit else "",
    )  # fmt: skip


def _soup(
    corners: np.ndarray, kind: str, notes: tuple[str, ...], step: float, unit: str, doubts: tuple[str, ...]
) -> RawGeometry:
    """Triangles (m, 3, 3) that share no vertex."""
    vertices = corners.reshape(-1, 3)
    return RawGeometry(
        vertices=vertices, triangles=checked_triangles(np.arange(len(vertices)), len(vertices)),
        format=f"STL, {kind}", notes=notes, step=step, doubts=doubts, units=unit,
        units_from="its header" if unit else "",
    )  # fmt: skip


def _is_text(data: bytes, size: int) -> bool:
    """Whether this is ASCII: many binary files too begin with "solid"."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf")):
        return True
    if len(data) >= 84:
        claimed = int(np.frombuffer(data, "<u4", 1, 80)[0])
        if size == 84 + 50 * claimed:
            return False
    head = data
    words = head.lower().split()
    return bool(words) and (words[0] == b"solid" or b"vertex" in words) and head.count(b"\0") == 0


def _binary(data: bytes | mmap.mmap) -> tuple[list[np.ndarray], tuple[str, ...]]:
    if len(data) < 84:
        raise PartError(f"is not an STL file: {len(data)} bytes are fewer than a header")
    facets, notes, at = [], [], 0
    while at + 84 <= len(data):
        count = int(np.frombuffer(data, "<u4", 1, at + 80)[0])
        room = (len(data) - at - 84) // 50
        if count in _UNTOLD and room and at == 0:
            notes.append(_wrong_count(count, room))
            count = room
        if count > room:
            if at:
                break
            raise PartError(
                f"STL header claims {count} triangles, the file has room for {(len(data) - 84) / 50:.1f}"
            )
        if count == 0 and at:
            break
        facets.append(np.frombuffer(data, _FACET, count, at + 84))
        at += 84 + 50 * count
    if len(facets) > 1:
        notes.append(f"{len(facets)} solids stand one after the other; all were read")
    if at < len(data) and (whole := _facets_beyond(data, facets[0])) is not None:
        notes = [_wrong_count(len(facets[0]), len(whole))]
        facets, at = [whole], len(data)
    if at < len(data):
        notes.append(f"{len(data) - at} bytes after the last facet were left out")
    return facets, tuple(notes)


def _wrong_count(claimed: int, there: int) -> str:
    return f"its header claims {claimed} triangles; the {there} that the file has room for were read"


def _facets_beyond(data: bytes | mmap.mmap, known: np.ndarray) -> np.ndarray | None:
    """All facets that the file has room for, if what follows those that are claimed are facets too."""
    if (len(data) - 84) % 50 or not len(known):
        return None
    table = np.frombuffer(data, _FACET, (len(data) - 84) // 50, 84)
    low, high = known["corners"].min(axis=(0, 1)), known["corners"].max(axis=(0, 1))
    reach = 10.0 * float(np.max(high - low))
    more = table["corners"][len(known) :]
    near = np.isfinite(more).all() and (more > low - reach).all() and (more < high + reach).all()
    return table if near and more.any() else None


def _against_winding(corners: np.ndarray, normals: np.ndarray) -> tuple[str, ...]:
    """What is to be said where most facet normals look against the sense of the corners."""
    some = slice(None, None, 1 + len(corners) // 100_000)
    a, b, c = np.moveaxis(corners[some], 1, 0)
    agree = np.einsum("ij,ij->i", np.cross(b - a, c - a), normals[some])
    told = np.isfinite(agree) & (agree != 0)
    if not told.any() or (agree[told] < 0).mean() < 0.5:
        return ()
    return ("its facet normals look against its winding; the winding was taken",)


def _ascii(data: bytes) -> tuple[np.ndarray, tuple[str, ...], float]:
    text = plain_text(data)
    rows, notes = [], []
    comma = re.search(rb"vertex\s+-?\d+,\d+(?:[eE][-+]?\d+)?\s+-?\d+,\d", text[:65536], re.IGNORECASE)
    for block in text_blocks(text):
        found = b"\n".join(_VERTEX.findall(block))
        rows.append(numbers(found.replace(b",", b".") if comma else found))
    flat = np.concatenate(rows) if rows else np.zeros(0)
    if comma:
        notes.append("decimal commas were read as points")
    ends = [m.end() for m in re.finditer(rb"endfacet|end\s+facet", text, re.IGNORECASE)]
    rest = text[ends[-1] :].strip() if ends else b""
    if flat.size % 9 or (rest and not re.search(rb"solid", rest, re.IGNORECASE)):
        raise PartError("STL file is cut short inside a facet")
    if not flat.size:
        raise PartError("STL file without facets")
    if ends and len(ends) * 9 != flat.size:
        raise PartError(
            f"STL file with {len(ends)} facets and {flat.size // 3} corners: not all are triangles"
        )
    solids = len(re.findall(rb"^\s*endsolid|^\s*end\s+solid", text, re.IGNORECASE | re.MULTILINE))
    if not re.search(rb"end\s*solid", text[ends[-1] :] if ends else text, re.IGNORECASE):
        notes.append("its last solid has no end: it may be cut short")
    if solids > 1:
        notes.append(f"{solids} solids stand in one file; all were read")
    points = flat.reshape(-1, 3)
    step = text_step(b"\n".join(_VERTEX.findall(text[:8192])), points)
    # Programs print single precision with more digits than it has.
    return flat.reshape(-1, 3, 3), tuple(notes), max(step, float_step(points))
