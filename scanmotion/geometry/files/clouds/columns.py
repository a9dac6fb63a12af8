"""Which column of a table of numbers is what: by its header, else by what the numbers can be."""

import re
import unicodedata
from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.formats.text import UNIT_NAMES

_EAST = ("easting", "east", "rechtswert", "ost", "est", "este", "e")
_NORTH = ("northing", "north", "hochwert", "nord", "norte", "n")
_HEIGHT = (
    "z", "height", "elevation", "elev", "altitude", "alt", "h", "hohe", "hoehe", "quota", "cota", "altura",
    "elevacion", "hauteur", "up", "u",
)  # fmt: skip
_COORDINATES = (
    (("x",), ("y",), _HEIGHT),
    *(((form.format("x"),), (form.format("y"),), (form.format("z"),)) for form in (
        "{}coord", "{}coordinate", "coord{}", "{}pos", "pos{}", "position{}", "p{}", "point{}", "points{}",
        "cartesian{}", "{}koordinate", "coordonnee{}",
    )),
    (("points0",), ("points1",), ("points2",)),
    (("pointsmxyz0",), ("pointsmxyz1",), ("pointsmxyz2",)),
    (_EAST, _NORTH, _HEIGHT),
)  # fmt: skip
"""Names of x, y and z without blanks and marks: one of each stands in the header."""
_NORMALS = (
    ("nx", "ny", "nz"), ("normalx", "normaly", "normalz"), ("xnormal", "ynormal", "znormal"),
    ("normals0", "normals1", "normals2"), ("normal0", "normal1", "normal2"),
    ("normalex", "normaley", "normalez"),
)  # fmt: skip
_COLOURS = (
    ("r", "g", "b"), ("red", "green", "blue"), ("rf", "gf", "bf"), ("rot", "grun", "blau"),
    ("rot", "gruen", "blau"),
    ("rouge", "vert", "bleu"), ("rosso", "verde", "blu"), ("rojo", "verde", "azul"),
)  # fmt: skip
_ANGLES = ("azimuth", "azimut", "theta", "phi", "range", "radius", "rho", "zenith", "distance", "distanz")
_DEGREES = (("lon", "lat"), ("longitude", "latitude"), ("long", "lat"), ("lng", "lat"))
_UNIT = 0.02
"""Normals are unit vectors to within so much: files print few digits."""
_MOST = 30
"""More columns without a header are no points with what was measured there: heights of an image."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Taken:
    """Which columns were taken for what."""

    xyz: tuple[int, int, int]
    normals: tuple[int, int, int] | None
    said: tuple[str, ...]
    unit: str = ""
    """Unit that the header gives for x, or ""."""


def columns_taken(table: np.ndarray, names: tuple[str, ...]) -> Taken:
    """What the columns of a table (n, w) are; names where the file has a header.

    Raises:
        PartError: the header names angles or degrees, or there are more columns than points have.
    """
    split = [_name_and_unit(n) for n in names]
    by_name = {n: i for i, (n, _) in reversed(list(enumerate(split))) if n}
    if set("XYZ") <= set(names):  # beside x and y of an image
        by_name |= {axis.lower(): names.index(axis) for axis in "XYZ"}
    wanted = _coordinates(by_name)
    if wanted is not None:
        return _by_name(by_name, wanted, split[by_name[wanted[0]]][1])
    if any(set(pair) <= by_name.keys() for pair in _DEGREES):
        raise PartError("its header names degrees of longitude and latitude: project them to metres first")
    if sum(n in by_name for n in _ANGLES) >= 2:
        raise PartError("its header names angles and distances: convert them to x, y, z first")
    if table.shape[1] > _MOST:
        raise PartError(
            f"lines of {table.shape[1]} numbers are heights or an image, not points; a point is x y z"
        )
    taken = _by_value(table)
    if by_name:
        said = f"its header ({', '.join(n for n in names[:4] if n)}) is not understood"
        first = _list(taken.xyz)
        return Taken(xyz=taken.xyz, normals=taken.normals, said=(f"{said}: {first} are x, y, z", *taken.said))
    return taken


def names_known(names: tuple[str, ...]) -> bool:
    """Whether the names of a header say which columns are x, y and z."""
    return _coordinates({n: i for i, (n, _) in enumerate(map(_name_and_unit, names)) if n}) is not None


def _name_and_unit(name: str) -> tuple[str, str]:
    """A column's name in plain small letters, and the unit behind it: "x [mm]", "x_mm", "X in cm"."""
    plain = (
        unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower().strip("\"'/#: \t;,.")
    )
    match = re.fullmatch(r"(.*?)[\s_/\-]*(?:[\[(]\s*([a-z]+)\s*[\])]|(?:[\s_/\-]|\bin\s)([a-z]+))", plain)
    unit = UNIT_NAMES.get(match[2] or match[3], "") if match else ""
    if match and (unit or match[2]):
        plain = re.sub(r"[\s_/\-]+in$", "", match[1])
    return re.sub(r"[^a-z0-9]", "", plain), unit


def _coordinates(by_name: dict[str, int]) -> tuple[str, str, str] | None:
    for family in _COORDINATES:
        found = [next((n for n in axis if n in by_name), None) for axis in family]
        if found[0] is not None and found[1] is not None and found[2] is not None:
            return found[0], found[1], found[2]
    return None


def _triple(names: dict[str, int], known: tuple[tuple[str, ...], ...]) -> tuple[int, int, int] | None:
    for wanted in known:
        if all(n in names for n in wanted):
            a, b, c = (names[n] for n in wanted)
            return a, b, c
    return None


def _by_name(names: dict[str, int], wanted: tuple[str, str, str], unit: str) -> Taken:
    a, b, c = (names[n] for n in wanted)
    said = [f"coordinates: {', '.join(wanted)} by the header"]
    normals = _triple(names, _NORMALS)
    if normals is not None:
        said.append(f"normals: {_list(normals)} by the header")
    colours = _triple(names, _COLOURS)
    if colours is not None:
        said.append(f"colours: {_list(colours)} by the header")
    return Taken(xyz=(a, b, c), normals=normals, said=tuple(said), unit=unit)


def _by_value(table: np.ndarray) -> Taken:
    width = table.shape[1]
    first, said = _leading(table)
    normals, rest = None, first + 3
    for at in range(first + 3, width - 2):
        if _unit_vectors(table[:, at : at + 3]):
            normals = (at, at + 1, at + 2)
            said.append(f"normals: {_list(normals)}, which are unit vectors")
            break
    left = [i for i in range(rest, width) if normals is None or i not in normals]
    colours = None
    for at in left[:-2]:
        if at + 1 in left and at + 2 in left and _colours(table[:, at : at + 3]):
            colours = (at, at + 1, at + 2)
            said.append(f"colours: {_list(colours)}")
            left = [i for i in left if i not in colours]
            break
    if left:
        said.append(f"left aside: {_list(left)}")
    return Taken(xyz=(first, first + 1, first + 2), normals=normals, said=tuple(said))


def _leading(table: np.ndarray) -> tuple[int, list[str]]:
    """How many columns stand before the coordinates, and what they are."""
    n, width = table.shape
    if width >= 4 and n > 2 and _numbers_of_points(table):
        return 1, ["column 1: the points' numbers"]
    if width >= 5 and n > 2 and _places_in_a_grid(table):
        return 2, ["columns 1-2: rows and columns of the scan"]
    return 0, []


def _list(columns: tuple[int, ...] | list[int]) -> str:
    """Columns as people count them: "columns 4-6"."""
    names = [c + 1 for c in columns]
    if len(names) > 1 and names == list(range(names[0], names[-1] + 1)):
        return f"columns {names[0]}-{names[-1]}"
    return f"column{'s' if len(names) > 1 else ''} {', '.join(map(str, names))}"


def _whole(column: np.ndarray) -> bool:
    with np.errstate(invalid="ignore"):
        return bool((column == np.rint(column)).all() and (np.abs(column) < 1 << 53).all())


def _have_fractions(table: np.ndarray) -> bool:
    return not any(_whole(column) for column in table.T)


def _numbers_of_points(table: np.ndarray) -> bool:
    """Whether the first column counts: by one from 0 or 1, or upwards beside three columns of fractions."""
    column = table[:, 0]
    if not _whole(column):
        return False
    step = np.diff(column)
    if (step == 1).all() and column[0] in (0, 1):
        return True
    return bool((step > 0).all() and column[0] >= 0 and _have_fractions(table[:, 1:4]))


def _places_in_a_grid(table: np.ndarray) -> bool:
    """Whether the first two columns are row and column of a scan's image: whole, each pair once, in order."""
    a, b = table[:, 0], table[:, 1]
    if not (_whole(a) and _whole(b)) or min(a.min(), b.min()) < 0:
        return False
    if _unit_vectors(table[:, 3:6]) or not _have_fractions(table[:, 2:5]):
        return False
    later = table[:, 3:5]
    if later.min() >= 0 and later.max() <= 1:
        return False  # colours between 0 and 1 behind whole x and y
    by_rows, by_columns = (np.diff(p * (q.max() + 1) + q) for p, q in ((a, b), (b, a)))
    return bool((by_rows > 0).all() or (by_columns > 0).all())


def _unit_vectors(vectors: np.ndarray) -> bool:
    """Whether nearly all rows are of length one (others zero or missing), and not all are the same."""
    if vectors.shape[1] != 3:
        return False
    with np.errstate(all="ignore"):
        length = np.linalg.norm(vectors, axis=1)
    set_ = np.isfinite(length) & (length > 0)
    if set_.sum() < 0.5 * len(vectors) or set_.sum() < 1:
        return False
    some = vectors[set_]
    whole = (some == np.rint(some)).all()
    spread = np.ptp(some, axis=0).max() > 0
    unit = (np.abs(length[set_] - 1.0) < _UNIT).mean() > 0.98
    return bool(unit and spread and not (whole and len(some) > 100 and (some >= 0).all()))


def _colours(values: np.ndarray) -> bool:
    known = values[np.isfinite(values).all(axis=1)]
    if not len(known) or known.min() < 0:
        return False
    whole = bool((known == np.rint(known)).all())
    return (whole and known.max() <= 65535) or (not whole and known.max() <= 1.0)
