"""OBJ and OFF: vertices and polygons as text.

trimesh and Open3D cut concave faces as fans or leave them out, so the faces are cut here.
"""

import re

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.text import (
    lines_of,
    numbers,
    plain_text,
    stated_unit,
    text_blocks,
    text_step,
    text_table,
)
from scanmotion.geometry.files.raw import NO_TRIANGLES, Polygons, RawGeometry, triangulated, whole_numbers

_FREE_FORM = (b"curv", b"curv2", b"surf", b"cstype", b"parm")
_IGNORED = (b"l", b"p")
_Y_UP = ("Blender", "Maya", "ZBrush", "Cinema 4D", "Houdini", "SketchUp")
"""Programs that turn what they write, as long as nobody tells them not to."""


def read_obj(data: bytes) -> RawGeometry:
    """Reads an OBJ; its groups, materials and textures are of no concern here.

    Raises:
        PartError: no vertices, or a face that is not understood.
    """
    text = plain_text(data)
    if b"\\\n" in text:
        text = text.replace(b"\\\n", b" ")
    kept: dict[bytes, list[bytes]] = {b"v": [], b"f": [], b"vn": []}
    before, n_vertices, strange, comments = [], 0, {}, []
    for block in text_blocks(text):
        found = _lines(block)
        kinds = found["kinds"]
        is_v, is_f = kinds == b"v", kinds == b"f"
        before.append(n_vertices + np.cumsum(is_v)[is_f])
        n_vertices += int(is_v.sum())
        for name in kept:
            kept[name].append(_bodies(block, found, name))
        for name in (*_FREE_FORM, *_IGNORED):
            if n := int((kinds == name).sum()):
                strange[name] = strange.get(name, 0) + n
        if not comments:
            comments.append(b"\n".join(re.findall(rb"^\s*#[^\n]*", block[:65536], re.MULTILINE)))
    if not n_vertices:
        raise PartError("OBJ file without vertices")
    vertices = b"".join(kept[b"v"])
    points, notes = _points(vertices)
    faces = _faces(b"".join(kept[b"f"]), np.concatenate(before))
    triangles, said = triangulated(points, faces) if len(faces.counts) else (NO_TRIANGLES, ())
    if free := [name.decode() for name in _FREE_FORM if name in strange]:
        if not len(triangles):
            raise PartError(f"OBJ file of free-form surfaces ({', '.join(free)}); export it as triangles")
        notes.append(f"free-form surfaces ({', '.join(free)}) were left out")
    if loose := sum(strange.get(name, 0) for name in _IGNORED):
        notes.append(f"{loose} loose points and lines were left out")
    top = b"".join(comments)
    unit = stated_unit(top)
    writer = next((w for w in _Y_UP if w.lower().encode() in top.lower()), "")
    lies = f"{writer} writes OBJ with y up unless told otherwise: if it lies down, give --up +y"
    normals, columns = None, ()
    if not len(triangles):
        table = text_table(b"".join(kept[b"vn"]), 3)
        if len(table) == len(points):
            normals, columns = table, ("normals: vn",)
    return RawGeometry(
        vertices=points, triangles=triangles, normals=normals, format="OBJ", columns=columns,
        notes=(*notes, *said), step=text_step(vertices[:4096], points),
        units=unit, units_from="a comment at its top" if unit else "", up_doubt=lies if writer else "",
    )  # fmt: skip


def _lines(block: bytes) -> dict[str, np.ndarray]:
    """First word of each line (up to five letters), and where it ends and the line ends."""
    ink = np.frombuffer(block + b"\n" * 8, np.uint8)
    end = np.flatnonzero(ink[: len(block)] == 10)
    if len(block) and not block.endswith(b"\n"):
        end = np.append(end, len(block))
    start = np.concatenate([[0], end[:-1] + 1]) if len(end) else np.zeros(0, np.int64)
    for _ in range(64):
        blank = (ink[start] == 32) | (ink[start] == 9)
        if not blank.any():
            break
        start = start + blank
    letters = ink[start[:, None] + np.arange(6)]
    inside = np.cumprod(letters > 32, axis=1).astype(bool)
    letters = np.where(inside, letters, 0)
    kinds = np.char.lower(np.ascontiguousarray(letters).view("S6").ravel())
    kinds = np.where(kinds == b"fo", b"f", kinds)  # as faces were called once
    return {"kinds": kinds, "start": start + inside.sum(axis=1), "end": end}


def _bodies(block: bytes, found: dict[str, np.ndarray], name: bytes) -> bytes:
    """What follows the first word on all lines that begin with it."""
    rows = np.flatnonzero(found["kinds"] == name)
    if not len(rows):
        return b""
    mark = np.zeros(len(block) + 1, np.int8)
    np.add.at(mark, found["start"][rows], 1)
    np.add.at(mark, np.minimum(found["end"][rows] + 1, len(block)), -1)
    keep = np.cumsum(mark[:-1]) > 0
    body = np.frombuffer(block, np.uint8)[keep].tobytes()
    return body if body.endswith(b"\n") else body + b"\n"


def _points(text: bytes) -> tuple[np.ndarray, list[str]]:
    """Vertices of "v x y z", with a weight or a colour behind them."""
    notes = []
    if re.search(rb"^\s*-?\d+,\d+\s+-?\d+,\d+\s", text[:4096], re.MULTILINE):
        text = text.replace(b",", b".")
        notes.append("decimal commas were read as points")
    text = re.sub(rb"#[^\n]*", b"", text) if b"#" in text else text
    points = text_table(text, 3)
    return points, notes


def _faces(text: bytes, before: np.ndarray) -> Polygons:
    """Faces of "f 1/2/3 .."; negative corners count back from the vertices read so far."""
    if b"#" in text:
        text = re.sub(rb"#[^\n]*", b"", text)
    if b"/" in text:
        text = re.sub(rb"/[-/\d]*", b"", text)
    counts = lines_of(text).words
    flat = np.concatenate([numbers(block) for block in text_blocks(text)]) if text.strip() else np.zeros(0)
    if len(counts) != len(before):
        counts = np.append(counts, np.zeros(len(before) - len(counts), np.int64))
    corners = whole_numbers(flat)
    if (corners == 0).any():
        raise PartError("a face points at vertex 0; OBJ counts from 1")
    seen = np.repeat(before, counts)
    if (corners < -seen).any():
        raise PartError("a face counts back beyond the first vertex")
    return Polygons(corners=np.where(corners > 0, corners - 1, seen + corners), counts=counts)


def read_off(data: bytes) -> RawGeometry:
    """Reads an OFF, COFF, NOFF or STOFF as text.

    Raises:
        PartError: binary, of four dimensions, or cut short.
    """
    text = re.sub(rb"#[^\n]*", b"", plain_text(data))
    match = re.match(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b\s*(BINARY)?", text)
    if match is None:
        raise PartError("is not an OFF file: its first word is not OFF")
    _, _, normal, four, many, binary = match.groups()
    if four or many or binary:
        raise PartError("OFF files that are binary or not of three dimensions are not read here")
    text = text[match.end() :]
    lines = lines_of(text)
    full = np.flatnonzero(lines.words > 0)
    if not len(full):
        raise PartError("OFF file without counts")
    head = numbers(text[lines.start[full[0]] : lines.start[full[1]] if len(full) > 1 else len(text)])
    if len(head) < 2 or head[0] < 0 or head[1] < 0 or head[0] + head[1] > len(text):
        raise PartError("OFF header claims more than the file holds")
    n, m = int(head[0]), int(head[1])
    if 1 + n + m > len(full):
        raise PartError(f"OFF file is cut short: {n} vertices and {m} faces on {len(full) - 1} lines")
    edges = np.append(lines.start[full], len(text))
    body = text[edges[1] : edges[1 + n]]
    rows = text_table(body, 6 if normal else 3)
    faces = text[edges[1 + n] : edges[1 + n + m]]
    flat, words = numbers(faces), lines_of(faces).words
    words = words[words > 0]
    at = np.cumsum(words) - words
    counts = whole_numbers(flat[at])
    if (counts < 0).any() or (counts + 1 > words).any():
        raise PartError("OFF file is cut short inside its faces")
    first = np.cumsum(counts) - counts
    corners = whole_numbers(flat[np.repeat(at + 1 - first, counts) + np.arange(int(counts.sum()))])
    triangles, notes = triangulated(rows[:, :3], Polygons(corners=corners, counts=counts))
    return RawGeometry(
        vertices=rows[:, :3].copy(), triangles=triangles, format="OFF",
        normals=rows[:, 3:6] if normal and not len(triangles) else None, notes=notes,
        step=text_step(body[:4096], rows[:, :3]),
    )  # fmt: skip
