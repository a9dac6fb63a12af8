"""Too large files are thinned while they are read: triangles by cells, points and lines by their number.

Triangles: corners in the same cell of an even grid become one, at their mean (vertex clustering: Rossignac
and Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993). The surface moves by less
than a cell, which is chosen from its area so that about `TARGET` triangles are left.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.raw import RawGeometry, are_numbers

MAX_TRIANGLES = 8_000_000
"""A mesh of more triangles is thinned."""
TARGET = 5_000_000
MAX_POINTS = 50_000_000
"""Of a binary cloud of more points every second, third, .. is read."""
MAX_TEXT = 1 << 30
"""Of a text cloud of more bytes every second, third, .. line is read."""
CHUNK = 1_000_000
_TEXT_CHUNK = 1 << 26
_HEADER_LINES = 200

Chunks = Callable[[], Iterable[np.ndarray]]


def stride_of(n: int, most: int) -> int:
    """Every how manieth of n is read."""
    return max(1, -(-n // most))


def thinned(raw: RawGeometry) -> RawGeometry:
    """The same with at most about `MAX_TRIANGLES` triangles, and a note if it had more."""
    m = len(raw.triangles)
    if m <= MAX_TRIANGLES:
        return raw

    def chunks() -> Iterable[np.ndarray]:
        for at in range(0, m, CHUNK):
            yield raw.vertices[raw.triangles[at : at + CHUNK]]

    vertices, triangles, note = clustered(chunks, m)
    return replace(raw, vertices=vertices, triangles=triangles, notes=(*raw.notes, note))


def clustered(chunks: Chunks, total: int) -> tuple[np.ndarray, np.ndarray, str]:
    """Vertices (n, 3), triangles (m, 3) and what is to be said, from corners that come piece by piece.

    Args:
        chunks: gives the corners of the triangles, (k, 3, 3) each, as often as it is called.
        total: how many triangles there are.

    Raises:
        PartError: no corner is a number.
    """
    low, high, area = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for corners in chunks():
        corners = _sound(corners)
        if len(corners):
            low, high = np.minimum(low, corners.min(axis=(0, 1))), np.maximum(high, corners.max(axis=(0, 1)))
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            areas = np.sort(np.linalg.norm(cross, axis=1) / 2)
            area += float(areas[: max(1, int(0.999 * len(areas)))].sum())  # without a few wild ones
    if not np.isfinite(low).all():
        raise PartError("no triangle whose corners are finite numbers")
    size = float((high - low).max())
    # A smooth surface passes through about 1.5 cells for each square of a cell's edge, two triangles each.
    cell = max(np.sqrt(3.0 * area / TARGET), size / (1 << 20), 1e-300)
    for _ in range(8):
        vertices, triangles = _cells(chunks, low, cell, high)
        if len(triangles) <= MAX_TRIANGLES:
            break
        cell *= float(np.sqrt(len(triangles) / TARGET))
    how = f"corners in the same cell of {cell:.3g} became one"
    return vertices, triangles, f"{total} triangles were thinned to {len(triangles)}: {how}"


def _sound(corners: np.ndarray) -> np.ndarray:
    """The triangles (k, 3, 3) whose corners are numbers, in double precision."""
    corners = corners.astype(float)
    return corners[are_numbers(corners.reshape(-1, 3)).reshape(-1, 3).all(axis=1)]


def _cells(chunks: Chunks, low: np.ndarray, cell: float, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    span = np.floor((high - low) / cell).astype(np.int64) + 1
    keys, sums, faces = [], [], []
    for corners in chunks():
        points = _sound(corners).reshape(-1, 3)
        place = np.floor((points - low) / cell).astype(np.int64)
        key = (place[:, 0] * span[1] + place[:, 1]) * span[2] + place[:, 2]
        mine, inverse = np.unique(key, return_inverse=True)
        columns = [
            np.bincount(inverse, weights=w, minlength=len(mine)) for w in (*points.T, np.ones(len(key)))
        ]
        keys.append(mine)
        sums.append(np.column_stack(columns))
        a, b, c = key.reshape(-1, 3).T
        faces.append(key.reshape(-1, 3)[(a != b) & (b != c) & (c != a)])
    known, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    stacked = np.concatenate(sums)
    whole = np.column_stack([np.bincount(inverse, weights=w, minlength=len(known)) for w in stacked.T])
    corners = np.searchsorted(known, np.concatenate(faces))
    return whole[:, :3] / whole[:, 3:], _once(corners)


def _once(triangles: np.ndarray) -> np.ndarray:
    """Each triangle once; of those that lie on one another both ways only what one way has more.

    So a closed surface stays closed where two of its sheets fall into one.
    """
    order = np.argsort(triangles, axis=1)
    rows = np.take_along_axis(triangles, order, axis=1)
    sense = np.where((order == [0, 1, 2]).all(axis=1) | (order[:, 0] == (order[:, 2] + 1) % 3), 1, -1)
    by_row = np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))
    rows = rows[by_row]
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    first = np.flatnonzero(new)
    net = np.add.reduceat(sense[by_row], first) if len(first) else np.zeros(0, int)
    kept = rows[first][net != 0]
    return np.where((net[net != 0] < 0)[:, None], kept[:, ::-1], kept)


def lines_by_number(path: Path, every: int) -> bytes:
    """Of a text file the first lines and every so manieth line behind them."""
    out, before, rest = [], 0, b""
    with path.open("rb") as file:
        while True:
            block = file.read(_TEXT_CHUNK)
            text = rest + block
            end = text.rfind(b"\n") + 1 if block else len(text)
            rest, text = text[end:], text[:end]
            if text:
                kept, n = _kept_lines(text, before, every)
                out.append(kept)
                before += n
            if not block:
                return b"".join(out)


def _kept_lines(text: bytes, before: int, every: int) -> tuple[bytes, int]:
    ink = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(ink == 10) + 1
    if not len(ends) or ends[-1] < len(ink):
        ends = np.append(ends, len(ink))
    number = before + np.arange(len(ends))
    keep = (number < _HEADER_LINES) | (number % every == 0)
    return ink[np.repeat(keep, np.diff(ends, prepend=0))].tobytes(), len(ends)
