"""Text of unknown encoding, line ends, delimiters and decimal signs into numbers."""

import re
import warnings
from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import PartError

_BLOCK = 1 << 24
"""Text is turned into numbers by so many bytes at a time."""
UNIT_NAMES = {
    "mm": "mm", "millimeter": "mm", "millimeters": "mm", "millimetre": "mm", "millimetres": "mm",
    "cm": "cm", "centimeter": "cm", "centimeters": "cm", "centimetre": "cm", "centimetres": "cm",
    "m": "m", "meter": "m", "meters": "m", "metre": "m", "metres": "m",
    "in": "in", "inch": "in", "inches": "in", "ft": "ft", "foot": "ft", "feet": "ft",
    "um": "um", "micron": "um", "microns": "um", "micrometer": "um", "micrometers": "um",
    "micrometre": "um", "micrometres": "um",
}  # fmt: skip
_WORD = rb"([a-zA-Z]+)\b"
_STATED = (
    re.compile(
        rb"\bunits?\b[ \t]*(?:is|are|[:=])?[ \t]*(?:in[ \t]+)?(?:1(?:\.0*)?[ \t]*)?['\"(\[]?" + _WORD,
        re.IGNORECASE,
    ),
    re.compile(rb"\buses[ \t]+" + _WORD + rb"[ \t]+as[ \t]+units", re.IGNORECASE),
)  # fmt: skip
_GROUPS = re.compile(rb"(?<=\d)(?:\xc2\xa0|\xe2\x80\xaf|\xe2\x80\x89)(?=\d{3}(?:\D|$))")
"""No-break blanks between digits by threes, as French and Swiss programs write thousands."""


def plain_text(data: bytes) -> bytes:
    """The text in one byte a character with LF line ends: byte order mark and UTF-16 undone.

    Letters beyond ASCII stay as they are: they stand in names and comments only.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        kind = "utf-16-le" if data.startswith(b"\xff\xfe") else "utf-16-be"
        data = data[2:].decode(kind, errors="replace").encode("utf-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if data.endswith(b"\0"):
        data = data.rstrip(b"\0")  # disks fill the rest of a block so
    if b"\xe2\x80" in data or b"\xc2\xa0" in data:
        data = _GROUPS.sub(b"", data)
    return data.replace(b"\xc2\xa0", b" ").replace(b"\x1a", b"")


def stated_unit(comments: bytes) -> str:
    """The unit that comments state ("units: mm"), or ""."""
    for pattern in _STATED:
        for word in pattern.findall(comments):
            if (unit := UNIT_NAMES.get(word.decode("ascii").lower())) is not None:
                return unit
    return ""


def text_blocks(text: bytes, size: int = _BLOCK) -> list[bytes]:
    """The text in pieces of about `size` bytes that end where lines end."""
    out, at = [], 0
    while at < len(text):
        end = text.rfind(b"\n", at, at + size) + 1
        if end <= at or len(text) - at <= size:
            end = text.find(b"\n", min(at + size, len(text))) + 1 or len(text)
        out.append(text[at:end])
        at = end
    return out


def numbers(text: bytes) -> np.ndarray:
    """All numbers of a text that holds nothing but numbers and white space.

    Raises:
        ValueError: with the word that is no number.
    """
    parts = [_numbers(block) for block in text_blocks(text)]
    return np.concatenate(parts) if parts else np.zeros(0)


def _numbers(block: bytes) -> np.ndarray:
    words = block.split() if len(block) < 4096 else None
    if words is not None:
        return np.array([_number(w) for w in words], float)
    # numpy's text reader stops at what it cannot read, with an error or without one: a number more counts.
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            found = np.fromstring(block + b" 8.25e11", sep=" ")
    except ValueError:
        found = np.zeros(0)
    if len(found) and found[-1] == 8.25e11 and len(found) - 1 == _words(block):
        return found[:-1]
    return np.array([_number(w) for w in block.split()], float)


def _words(block: bytes) -> int:
    """How many words a text has."""
    ink = np.frombuffer(block, np.uint8) > 32
    return int(ink[0]) + int((ink[1:] & ~ink[:-1]).sum()) if len(ink) else 0


def _number(word: bytes) -> float:
    """One number; Fortran's exponent D and Windows' "1.#QNAN" are understood."""
    try:
        if b"_" in word:
            raise ValueError
        return float(word)
    except ValueError:
        pass
    low = word.lower()
    if b"#" in low and (b"nan" in low or b"ind" in low or b"inf" in low):
        return float("nan")
    if low in (b"-nan(ind)", b"nan(ind)", b"nan(snan)", b"null", b"none", b"n/a", b"na"):
        return float("nan")
    try:
        return float(low.replace(b"d", b"e")) if re.fullmatch(rb"[-+0-9.]+d[-+0-9]+", low) else float(b"?")
    except ValueError:
        raise ValueError(f"could not convert string to float: {word[:40].decode('latin-1')!r}") from None


@dataclass(frozen=True, eq=False, kw_only=True)
class Lines:
    """Where the lines of a text are, and how many words each has."""

    start: np.ndarray
    """Position of the first byte, shape (n,)."""
    words: np.ndarray
    """Words of each line, shape (n,)."""


def lines_of(text: bytes) -> Lines:
    """Lines of a text and their number of words; empty lines too."""
    ink = np.frombuffer(text, np.uint8)
    end = np.flatnonzero(ink == 10)
    start = np.concatenate([[0], end + 1])
    if len(start) and start[-1] >= len(text):
        start = start[:-1]
    dark = ink > 32
    begins = dark.copy()
    begins[1:] &= ~dark[:-1]
    at = np.flatnonzero(begins)
    edge = np.searchsorted(at, np.append(start, len(text)))
    return Lines(start=start, words=np.diff(edge))


def text_table(text: bytes, width: int | None = None) -> np.ndarray:
    """Rows of numbers, shape (n, w): the first `width` numbers of each line, or all where lines are equal.

    Raises:
        PartError: lines of different length, or shorter than `width`.
        ValueError: a word that is no number.
    """
    parts = []
    for block in text_blocks(text):
        words = lines_of(block).words
        words = words[words > 0]
        if not len(words):
            continue
        flat = numbers(block)
        if (words == words[0]).all():
            rows = flat.reshape(-1, int(words[0]))
        elif width is None:
            raise PartError(f"lines of {int(words.min())} and of {int(words.max())} numbers")
        else:
            if words.min() < width:
                raise PartError(f"a line of {int(words.min())} numbers where {width} are expected")
            rows = flat[(np.cumsum(words) - words)[:, None] + np.arange(width)]
        parts.append(rows if width is None else rows[:, :width])
        if parts[-1].shape[1] != (width or parts[0].shape[1]):
            raise PartError(f"a line of {parts[-1].shape[1]} numbers where {width} are expected")
    return np.concatenate(parts) if parts else np.zeros((0, width or 0))


def text_step(text: bytes, points: np.ndarray) -> float:
    """One unit of the last decimal that the text's numbers have, as far as its first lines tell."""
    head = text[:4096].rsplit(b"\n", 1)[0]
    decimals = [len(w.split(b".")[1]) for w in head.split() if re.fullmatch(rb"-?\d+\.\d+", w)]
    if len(decimals) < 9:
        digits = [len(m) for m in re.findall(rb"-?\d\.(\d+)[eE]", head)]
        largest = float(np.abs(points[np.isfinite(points)]).max(initial=0.0))
        return largest * 10.0 ** -max(digits) if digits else 0.0
    return 10.0 ** -max(decimals)
