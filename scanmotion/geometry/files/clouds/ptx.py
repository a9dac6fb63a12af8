"""PTX: scans as text, each with its scanner's pose."""

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.text import lines_of, numbers, plain_text, text_table
from scanmotion.geometry.files.raw import NO_TRIANGLES, RawGeometry


def read_ptx(data: bytes) -> RawGeometry:
    """Reads a PTX: one or more scans, each with its scanner's pose; rows of zeros are pixels without a point.

    Raises:
        PartError: a scan claims more lines than there are.
    """
    text = plain_text(data)
    lines = lines_of(text)
    full = np.flatnonzero(lines.words > 0)
    edges = np.append(lines.start[full], len(text))
    pieces, at, empty = [], 0, 0
    while at < len(full):
        if at + 10 > len(full):
            raise PartError("PTX file is cut short inside a header")
        head = [numbers(text[edges[at + i] : edges[at + i + 1]]) for i in range(10)]
        if [len(h) for h in head] != [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]:
            raise PartError(f"PTX header {len(pieces) + 1} is not of 1, 1, 3, 3, 3, 3, 4, 4, 4, 4 numbers")
        if not all(1 <= h[0] <= len(text) for h in head[:2]):
            raise PartError("PTX header claims more points than the file holds")
        n = int(head[0][0]) * int(head[1][0])
        if at + 10 + n > len(full):
            raise PartError(f"PTX file is cut short: scan {len(pieces) + 1} claims {n} points")
        rows = text_table(text[edges[at + 10] : edges[at + 10 + n]], 3)
        seen = (rows != 0).any(axis=1) & np.isfinite(rows).all(axis=1)
        empty += int((~seen).sum())
        X = np.array(head[6:10])
        if not np.isfinite(X).all() or abs(np.linalg.det(X[:3, :3])) < 1e-9:
            raise PartError("PTX header: its matrix is no pose")
        pieces.append(rows[seen] @ X[:3, :3] + X[3, :3])
        at += 10 + n
    if not pieces:
        raise PartError("PTX file without a scan")
    points = np.concatenate(pieces)
    notes = [f"{len(pieces)} scans were put together by the poses in the file"] if len(pieces) > 1 else []
    notes += [f"{empty} pixels without a point were left out"] if empty else []
    return RawGeometry(
        vertices=points, triangles=NO_TRIANGLES, format="PTX, text", notes=tuple(notes), units="m",
        units_from="the custom of PTX files",
    )  # fmt: skip
