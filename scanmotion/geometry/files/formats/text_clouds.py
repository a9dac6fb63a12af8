"""Clouds as text: XYZ, ASC, TXT, CSV and PTS with any delimiter, header or decimal sign; and PTX."""

import re
from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.columns import columns_taken
from scanmotion.geometry.files.formats.text import (
    UNIT_NAMES,
    Lines,
    lines_of,
    numbers,
    plain_text,
    stated_unit,
    text_step,
    text_table,
)
from scanmotion.geometry.files.raw import NO_TRIANGLES, RawGeometry

_COMMENTS = (b"#", b"//", b"%", b"!", b"'", b"*", b"--")
_MOST_HEADER = 200
_NUMERAL = re.compile(rb"[-+]?(\d+[.,]?\d*|[.,]\d+)([eEdD][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_COMMA_NUMERAL = re.compile(rb"[-+]?\d+,\d+([eE][-+]?\d+)?")
_THOUSANDS = re.compile(rb"[-+]?\d{1,3}(,\d{3})+(\.\d+)?")


@dataclass(frozen=True, eq=False, kw_only=True)
class Dialect:
    """How the numbers of a line stand."""

    delimiter: bytes
    """One byte; a blank stands for any white space."""
    comma: str
    """What a comma means: "", "decimal", "thousands" or "delimiter"."""


def read_text_cloud(data: bytes, kind: str) -> RawGeometry:
    """Reads points from lines of numbers.

    Args:
        data: the file.
        kind: its ending in capital letters, for the report.

    Raises:
        PartError: no points, or lines that are not understood.
    """
    if b"\0" in data[:4096] and not data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise PartError(f"is not a {kind} file: it holds binary data")
    text = plain_text(data)
    head, body, count = _head_and_body(text)
    if not body.strip():
        raise PartError(f"{kind} file without points")
    dialect = _dialect(body[:20000])
    plain, notes = _plain(body, dialect)
    if b"#" in plain or b"//" in plain:
        plain = re.sub(rb"(#|//)[^\n]*", b"", plain)
    table, said = _table(plain, count)
    names, unit = _names(head, table.shape[1])
    taken = columns_taken(table, names)
    points = np.ascontiguousarray(table[:, taken.xyz])
    normals = None if taken.normals is None else np.ascontiguousarray(table[:, taken.normals])
    how = {"decimal": "decimal commas were read as points", "thousands": "commas between digits were dropped"}
    said = [*said, *([how[dialect.comma]] if dialect.comma in how else [])]
    return RawGeometry(
        vertices=points, triangles=NO_TRIANGLES, normals=normals, format=f"{kind}, text", columns=taken.said,
        notes=(*notes, *said), step=text_step(plain[:4096], points),
        units=unit, units_from="its header" if unit else "",
    )  # fmt: skip


def _is_count(line: bytes) -> bool:
    return re.fullmatch(rb"\s*\d+\s*", line) is not None


def _is_numeric(line: bytes) -> bool:
    """Whether a line begins with two numbers or more."""
    words = [w.strip(b"\"'") for w in re.split(rb"[\s;|]+|,\s+", line.strip()) if w]
    if len(words) == 1:
        words = [w for w in line.strip().split(b",") if w]
    return len(words) >= 2 and all(_NUMERAL.fullmatch(w.rstrip(b",")) or not w for w in words[:2])


def _head_and_body(text: bytes) -> tuple[list[bytes], bytes, int | None]:
    """Lines above the numbers, the numbers, and how many points a first line claims."""
    head, at, count = [], 0, None
    for _ in range(_MOST_HEADER):
        if at >= len(text):
            break
        end = text.find(b"\n", at)
        end = len(text) if end < 0 else end
        line = text[at:end].strip()
        comment = line.startswith(_COMMENTS)
        if not comment and line:
            if _is_count(line) and count is None:
                count = int(line)
            elif _is_numeric(line):
                return head, text[at:], count
            else:
                head.append(line)
        elif line:
            head.append(line)
        at = end + 1
    if at >= len(text):
        return head, b"", count
    raise PartError(f"no numbers in its first {_MOST_HEADER} lines")


def _dialect(sample: bytes) -> Dialect:
    lines = [line for line in sample.split(b"\n")[:200] if line.strip()]
    lines = lines[:-1] if len(lines) > 1 else lines
    for mark in (b";", b"|"):
        if sum(line.count(mark) >= 2 for line in lines) > 0.5 * len(lines):
            return Dialect(delimiter=mark, comma="decimal" if any(b"," in line for line in lines) else "")
    if not any(b"," in line for line in lines):
        return Dialect(delimiter=b" ", comma="")
    words = [w for line in lines for w in line.split()]
    commas = [w for w in words if b"," in w]
    if commas and all(_COMMA_NUMERAL.fullmatch(w) for w in commas) and _words_enough(lines):
        return Dialect(delimiter=b" ", comma="decimal")
    if commas and all(_THOUSANDS.fullmatch(w) for w in commas) and _words_enough(lines):
        return Dialect(delimiter=b" ", comma="thousands")
    _check_commas(lines)
    return Dialect(delimiter=b",", comma="delimiter")


def _words_enough(lines: list[bytes]) -> bool:
    return all(len(line.split()) >= 3 for line in lines)


def _check_commas(lines: list[bytes]) -> None:
    """Refuses "1,25,3,50,7,75": a comma cannot both part numbers and stand for their point.

    Raises:
        PartError: so it seems.
    """
    fields = [[w.strip() for w in line.split(b",")] for line in lines]
    if any(len(f) not in (6, 12) for f in fields) or any(b"." in w for f in fields for w in f):
        return
    fractions = [w for f in fields for w in f[1:6:2]]
    if (
        all(w.isdigit() for w in fractions)
        and len({len(w) for w in fractions}) == 1
        and len(fractions[0]) > 1
    ):
        raise PartError(
            "commas seem to part the numbers and to stand for their points; save it with semicolons"
        )


def _plain(body: bytes, dialect: Dialect) -> tuple[bytes, tuple[str, ...]]:
    """The numbers with blanks between them and points in them."""
    if b'"' in body[:20000] or b"'" in body[:20000]:
        body = body.translate(None, b"\"'")
    mark = dialect.delimiter
    if mark != b" ":
        if dialect.comma == "decimal":
            body = body.replace(b",", b".")
        body = re.sub(rb"[ \t]*" + re.escape(mark) + rb"[ \t]*\n", mark + b"\n", body)
        first = body.split(b"\n", 1)[0]
        if first.endswith(mark):
            body = body.replace(mark + b"\n", b"\n")
        empty = re.compile(re.escape(mark) + rb"(?=[ \t]*(?:" + re.escape(mark) + rb"|\n))")
        if mark * 2 in body or mark + b"\n" in body or mark + b" " + mark in body:
            body = empty.sub(mark + b"nan", body)
        if body.startswith(mark) or b"\n" + mark in body:
            body = re.sub(rb"^" + re.escape(mark), b"nan" + mark, body, flags=re.MULTILINE)
        return body.replace(mark, b" "), ()
    if dialect.comma == "decimal":
        return body.replace(b",", b"."), ()
    return (body.replace(b",", b""), ()) if dialect.comma == "thousands" else (body, ())


def _table(text: bytes, count: int | None) -> tuple[np.ndarray, list[str]]:
    """Rows of numbers, and what is to be said of lines that are not like the others."""
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
            if _is_count(line):
                claimed += int(line)
        full = full[words[full] > 1]
        text = _lines_kept(text, lines, full)
        lines = lines_of(text)
        words, full = lines.words, np.flatnonzero(lines.words > 0)
    if not len(full):
        raise PartError("no line holds a point")
    usual = int(np.bincount(np.minimum(words[full], 100)).argmax())
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
    table = _numeric(text, least if uneven else usual, notes)
    if claimed is not None and claimed != len(table):
        if claimed > len(table):
            raise PartError(f"is cut short: it claims {claimed} points and holds {len(table)}")
        notes.append(f"it claims {claimed} points and holds {len(table)}")
    return table, notes


def _line(text: bytes, lines: Lines, row: int) -> bytes:
    end = text.find(b"\n", int(lines.start[row]))
    return text[int(lines.start[row]) : end if end >= 0 else len(text)]


def _shown(line: bytes) -> str:
    return repr(line[:40].decode("latin-1").strip())


def _lines_kept(text: bytes, lines: Lines, rows: np.ndarray) -> bytes:
    edges = np.append(lines.start, len(text))
    return b"".join(text[edges[r] : edges[r + 1]] for r in rows.tolist())


def _numeric(text: bytes, width: int, notes: list[str]) -> np.ndarray:
    try:
        return text_table(text, width)
    except ValueError:
        first = text.split(b"\n", 1)[0].split()
    keep = [i for i, w in enumerate(first) if _NUMERAL.fullmatch(w)]
    if len(keep) == len(first) or keep[:3] not in ([0, 1, 2], [1, 2, 3]):
        return text_table(text, width)
    wordy = ", ".join(str(i + 1) for i in range(len(first)) if i not in keep)
    notes.append(f"columns that hold words were left aside: {wordy}")
    split = (line.split() for line in text.split(b"\n"))
    return text_table(b"\n".join(b" ".join(w[i] for i in keep if i < len(w)) for w in split if w), None)


def _names(head: list[bytes], width: int) -> tuple[tuple[str, ...], str]:
    """Names of the columns and the unit that the lines above the numbers state."""
    unit = stated_unit(b"\n".join(head))
    for line in reversed(head):
        words = re.findall(rb"[A-Za-z_][\w.]*(?:\s*[\[(][^\])]*[\])])?", line)
        names = tuple(w.decode("latin-1").lower() for w in words)
        bare = [n.split("[")[0].split("(")[0].strip("_ ") for n in names]
        if {"x", "y", "z"} <= set(bare) or {"easting", "northing"} <= set(bare):
            first = names[bare.index("x" if "x" in bare else "easting")]
            inside = re.search(r"[\[(]\s*([a-z]+)\s*[\])]", first)
            stated = UNIT_NAMES.get(inside.group(1), "") if inside else ""
            if len(names) > width:
                return (), unit or stated
            return names, unit or stated
    return (), unit


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
