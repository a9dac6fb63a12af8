"""Clouds as text: XYZ, ASC, TXT, CSV and PTS with any delimiter, header or decimal sign."""

import re

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.clouds.columns import columns_taken
from scanmotion.geometry.files.clouds.dialect import dialect_of, is_numeral, plain_numbers
from scanmotion.geometry.files.clouds.header import head_and_body, is_count, names_of
from scanmotion.geometry.files.formats.text import Lines, lines_of, plain_text, text_step, text_table
from scanmotion.geometry.files.raw import NO_TRIANGLES, RawGeometry

_HOW = {
    "decimal": "decimal commas were read as points",
    "grouped": "decimal commas were read as points, and points between digits were dropped",
    "thousands": "commas between digits were dropped",
}


def read_text_cloud(data: bytes, kind: str, *, whole: bool = True) -> RawGeometry:
    """Reads points from lines of numbers.

    Args:
        data: the file.
        kind: its ending in capital letters, for the report.
        whole: whether all lines are there, so that a count at the top must fit.

    Raises:
        PartError: no points, or lines that are not understood.
    """
    if b"\0" in data[:4096].rstrip(b"\0") and not data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise PartError(f"is not a {kind} file: it holds binary data")
    text = plain_text(data)
    head, body, count = head_and_body(text)
    if not body.strip():
        raise PartError(f"{kind} file without points")
    dialect = dialect_of(body[:20000])
    plain = plain_numbers(body, dialect)
    if b"#" in plain or b"//" in plain:
        plain = re.sub(rb"(#|//)[^\n]*", b"", plain)
    table, kept, width, said = _table(plain, count, whole)
    names, unit = names_of(head, width, dialect)
    taken = columns_taken(table, tuple(names[i] for i in kept) if names else ())
    unit = unit or taken.unit
    points = np.ascontiguousarray(table[:, taken.xyz])
    normals = None if taken.normals is None else np.ascontiguousarray(table[:, taken.normals])
    notes = [*said, *([_HOW[dialect.comma]] if dialect.comma in _HOW and b"," in body[:20000] else [])]
    return RawGeometry(
        vertices=points, triangles=NO_TRIANGLES, normals=normals, format=f"{kind}, text", columns=taken.said,
        notes=tuple(notes), step=text_step(plain[:4096], points),
        units=unit, units_from="its header" if unit else "",
    )  # fmt: skip


def _table(text: bytes, count: int | None, whole: bool) -> tuple[np.ndarray, list[int], int, list[str]]:
    """Rows of numbers, which columns of the file they are, of how many, and what is odd about the lines."""
    notes: list[str] = []
    lines = lines_of(text)
    words = lines.words
    full = np.flatnonzero(words > 0)
    claimed = None if count is None else count
    single = full[words[full] == 1]
    if len(single) and claimed is not None:
        # PTS: every scan of the file has a line with its count.
        for row in single.tolist():
            line = _line(text, lines, row)
            if is_count(line):
                claimed += int(line)
        full = full[words[full] > 1]
        text = _lines_kept(text, lines, full)
        lines = lines_of(text)
        words, full = lines.words, np.flatnonzero(lines.words > 0)
    if not len(full):
        raise PartError("no line holds a point")
    usual = int(np.bincount(np.minimum(words[full], 10_000)).argmax())
    if words[full[-1]] < usual and len(full) > 1:
        notes.append("its last line is cut short and was left out")
        text, full = text[: lines.start[full[-1]]], full[:-1]
    least = int(words[full].min())
    if least < 3:
        row = int(full[np.argmin(words[full])])
        raise PartError(
            f"line {row + 1} of its points has {least} numbers: {_shown(_line(text, lines, row))}"
        )
    uneven = bool((words[full] != words[full[0]]).any())
    if uneven:
        notes.append(
            f"its lines have {least} to {int(words[full].max())} numbers; the first {least} were taken"
        )
    width = least if uneven else usual
    table, kept = _numeric(text, width, notes)
    if whole and claimed is not None and claimed != len(table):
        if claimed > len(table):
            raise PartError(f"is cut short: it claims {claimed} points and holds {len(table)}")
        notes.append(f"it claims {claimed} points and holds {len(table)}")
    return table, kept, int(words[full].max()) if uneven else width, notes


def _line(text: bytes, lines: Lines, row: int) -> bytes:
    end = text.find(b"\n", int(lines.start[row]))
    return text[int(lines.start[row]) : end if end >= 0 else len(text)]


def _shown(line: bytes) -> str:
    return repr(line[:40].decode("latin-1").strip())


def _lines_kept(text: bytes, lines: Lines, rows: np.ndarray) -> bytes:
    edges = np.append(lines.start, len(text))
    return b"".join(text[edges[r] : edges[r + 1]] for r in rows.tolist())


def _numeric(text: bytes, width: int, notes: list[str]) -> tuple[np.ndarray, list[int]]:
    """The numbers of lines (n, k), and which columns they are; columns of words are left aside."""
    try:
        return text_table(text, width), list(range(width))
    except ValueError:
        first = text.split(b"\n", 1)[0].split()
    keep = [i for i, w in enumerate(first) if is_numeral(w)]
    if len(keep) == len(first) or keep[:3] not in ([0, 1, 2], [1, 2, 3]):
        return text_table(text, width), list(range(width))
    wordy = ", ".join(str(i + 1) for i in range(len(first)) if i not in keep)
    notes.append(f"columns that hold words were left aside: {wordy}")
    split = (line.split() for line in text.split(b"\n"))
    table = text_table(b"\n".join(b" ".join(w[i] for i in keep if i < len(w)) for w in split if w), None)
    return table, keep
