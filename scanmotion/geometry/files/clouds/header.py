"""What stands above the numbers of a text cloud: comments, a count, the names of the columns, the unit."""

import re

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.clouds.columns import names_known
from scanmotion.geometry.files.clouds.dialect import Dialect, is_numeral
from scanmotion.geometry.files.formats.text import stated_unit

_COMMENTS = (b"#", b"//", b"%", b"!", b"'", b"*", b"--")
_MOST_HEADER = 200
_LABELLED = 4
"""A line of a label and numbers has at least so many words."""


def is_count(line: bytes) -> bool:
    """Whether a line holds one whole number alone, as the number of points in a PTS."""
    return re.fullmatch(rb"\s*\d+\s*", line) is not None


def words_of(line: bytes) -> list[bytes]:
    """The words of a line, whatever parts them."""
    words = [w.strip(b"\"'") for w in re.split(rb"[\s;|]+|,\s+", line.strip()) if w]
    return words if len(words) > 1 else [w.strip(b"\"'") for w in line.strip().split(b",") if w]


def _is_numeric(line: bytes) -> bool:
    """Whether a line begins with two numbers or more."""
    words = words_of(line)
    return len(words) >= 2 and all(is_numeral(w.rstrip(b",")) or not w for w in words[:2])


def _is_labelled(line: bytes) -> bool:
    """Whether a line begins with one word that is no number, and numbers follow."""
    words = words_of(line)
    if len(words) < _LABELLED:
        words = [w.strip() for w in line.strip().split(b",")]
    return (
        len(words) >= _LABELLED
        and not is_numeral(words[0])
        and all(is_numeral(w.rstrip(b",")) for w in words[1:_LABELLED])
    )


def head_and_body(text: bytes) -> tuple[list[bytes], bytes, int | None]:
    """Lines above the numbers, the numbers, and how many points a first line claims.

    Raises:
        PartError: no numbers in the first lines.
    """
    head: list[bytes] = []
    at, count, labelled = 0, None, -1
    for _ in range(_MOST_HEADER):
        if at >= len(text):
            break
        end = text.find(b"\n", at)
        end = len(text) if end < 0 else end
        line = text[at:end].strip()
        if line and not line.startswith(_COMMENTS):
            if is_count(line) and count is None:
                count = int(line)
            elif _is_numeric(line):
                return head, text[at:], count
            elif _is_labelled(line):
                if labelled >= 0:
                    return head[:-1], text[labelled:], count
                labelled = at
                head.append(line)
            else:
                labelled = -1
                head.append(line)
        elif line:
            head.append(line)
        at = end + 1
    if at >= len(text):
        return head, b"", count
    raise PartError(f"no numbers in its first {_MOST_HEADER} lines")


def names_of(head: list[bytes], width: int, dialect: Dialect) -> tuple[tuple[str, ...], str]:
    """Names of the columns and the unit that the lines above the numbers state.

    Args:
        head: the lines.
        width: how many columns there are, those of words too.
        dialect: what parts the columns.
    """
    unit = stated_unit(b"\n".join(head))
    last: tuple[str, ...] = ()
    for number, line in enumerate(reversed(head)):
        for words in _ways(line, dialect):
            if len(words) == width - 1 and all(words):
                words = ["", *words]  # R names its rows, and not their column
                if not names_known(tuple(words)):
                    continue
            if len(words) != width:
                continue
            if names_known(tuple(words)):
                return tuple(words), unit
            plainly = dialect.delimiter != b" " or b"\t" in line or line.startswith(b'"')
            if (
                number == 0
                and plainly
                and not line.startswith(_COMMENTS)
                and not any(is_numeral(w.encode()) for w in words if w)
            ):
                last = tuple(words)
    return last, unit


def _ways(line: bytes, dialect: Dialect) -> list[list[str]]:
    """The names of a line in the ways in which they can be parted."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    bare = re.sub(r"^\s*(#|//|%|!|--|\*)+\s*", "", text)
    marks = [*([dialect.delimiter.decode()] if dialect.delimiter != b" " else []), "\t", ",", ";"]
    ways = [[w.strip(" \t\"'") for w in bare.split(mark)] for mark in marks if mark in bare]
    ways.append(re.findall(r"[^\W\d][\w.:]*(?:\s*[\[(][^\])]*[\])])?", bare))
    return ways
