"""How numbers stand in lines of text: what parts them; what commas, points and quotes between digits mean."""

import re
from dataclasses import dataclass

from scanmotion.core.errors import PartError

_PLAIN = re.compile(rb"[-+]?(\d+[.,]?\d*|[.,]\d+)([eEdD][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_COMMA_NUMERAL = re.compile(rb"[-+]?\d+,\d+([eE][-+]?\d+)?")
_BY_COMMAS = re.compile(rb"[-+]?\d{1,3}(,\d{3})+(\.\d+)?")
_BY_POINTS = re.compile(rb"[-+]?\d{1,3}(\.\d{3})+,\d+")
_QUOTES = b"\"'"


@dataclass(frozen=True, eq=False, kw_only=True)
class Dialect:
    """How the numbers of a line stand."""

    delimiter: bytes
    """One byte; a blank stands for any white space."""
    comma: str
    """What a comma means: "", "decimal", "grouped" (1.234,5), "thousands" (1,234.5) or "delimiter"."""


def is_numeral(word: bytes) -> bool:
    """Whether a word is one number in any of the ways that are understood."""
    word = word.strip(_QUOTES)
    if _PLAIN.fullmatch(word):
        return True
    word = word.replace(b"'", b"")
    return any(p.fullmatch(word) for p in (_PLAIN, _BY_COMMAS, _BY_POINTS))


def dialect_of(sample: bytes) -> Dialect:
    """What parts the numbers of a file, from its first lines.

    Raises:
        PartError: commas seem to mean two things.
    """
    lines = [line for line in sample.split(b"\n")[:200] if line.strip()]
    lines = lines[:-1] if len(lines) > 1 else lines
    for mark in (b";", b"|"):
        if sum(line.count(mark) >= 2 for line in lines) > 0.5 * len(lines):
            fields = [w.strip(b" \t\"'") for line in lines for w in line.split(mark)]
            return Dialect(delimiter=mark, comma=_comma_in(fields) or "decimal")
    if not any(b"," in line for line in lines):
        return Dialect(delimiter=b" ", comma="")
    meaning = _comma_in([w.strip(_QUOTES) for line in lines for w in line.split()])
    if meaning and all(len(line.split()) >= 3 for line in lines):
        return Dialect(delimiter=b" ", comma=meaning)
    _check_commas(lines)
    return Dialect(delimiter=b",", comma="delimiter")


def _comma_in(words: list[bytes]) -> str:
    """What commas inside of words mean: "decimal", "grouped", "thousands", or "" where they part words."""
    words = [w.replace(b"'", b"") for w in words]
    commas = [w for w in words if b"," in w]
    if not commas:
        return ""
    pointed = any(b"." in w and b"," not in w and is_numeral(w) for w in words)
    if all(_BY_COMMAS.fullmatch(w) for w in commas) and (pointed or any(b"." in w for w in commas)):
        return "thousands"
    if all(_COMMA_NUMERAL.fullmatch(w) for w in commas) and not pointed:
        return "decimal"
    if all(_COMMA_NUMERAL.fullmatch(w) or _BY_POINTS.fullmatch(w) for w in commas):
        return "grouped"
    return ""


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


def plain_numbers(body: bytes, dialect: Dialect) -> bytes:
    """The numbers with blanks between them and points in them."""
    if b'"' in body[:20000] or b"'" in body[:20000]:
        body = body.translate(None, b"\"'")
    mark = dialect.delimiter
    if dialect.comma == "thousands":
        body = body.replace(b",", b"")
    elif dialect.comma in ("decimal", "grouped"):
        body = body.replace(b".", b"") if dialect.comma == "grouped" else body
        body = body.replace(b",", b".")
    if mark != b" ":
        body = re.sub(rb"[ \t]*" + re.escape(mark) + rb"[ \t]*\n", mark + b"\n", body)
        first = body.split(b"\n", 1)[0]
        if first.endswith(mark):
            body = body.replace(mark + b"\n", b"\n")
        empty = re.compile(re.escape(mark) + rb"(?=[ \t]*(?:" + re.escape(mark) + rb"|\n))")
        if mark * 2 in body or mark + b"\n" in body or mark + b" " + mark in body:
            body = empty.sub(mark + b"nan", body)
        if body.startswith(mark) or b"\n" + mark in body:
            body = re.sub(rb"^" + re.escape(mark), b"nan" + mark, body, flags=re.MULTILINE)
        return body.replace(mark, b" ")
    return body
