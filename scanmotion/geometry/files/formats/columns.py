"""Which column of a table of numbers is what: by its header, else by what the numbers can be."""

from dataclasses import dataclass

import numpy as np

_COORDINATES = (("x", "y", "z"), ("easting", "northing", "height"), ("easting", "northing", "elevation"),
                ("easting", "northing", "altitude"), ("e", "n", "h"), ("px", "py", "pz"))  # fmt: skip
_NORMALS = (("nx", "ny", "nz"), ("normalx", "normaly", "normalz"), ("normal_x", "normal_y", "normal_z"),
            ("n_x", "n_y", "n_z"))  # fmt: skip
_COLOURS = (("r", "g", "b"), ("red", "green", "blue"), ("rf", "gf", "bf"))
_UNIT = 0.02
"""Normals are unit vectors to within so much: files print few digits."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Taken:
    """Which columns were taken for what."""

    xyz: tuple[int, int, int]
    normals: tuple[int, int, int] | None
    said: tuple[str, ...]


def columns_taken(table: np.ndarray, names: tuple[str, ...]) -> Taken:
    """What the columns of a table (n, w) are; names where the file has a header."""
    names = tuple(n.lower().strip("\"'/#: ") for n in names)
    by_name = {n.split("[")[0].split("(")[0].strip("_ "): i for i, n in reversed(list(enumerate(names)))}
    for wanted in _COORDINATES:
        if all(n in by_name for n in wanted):
            return _by_name(table, by_name, wanted)
    return _by_value(table)


def _triple(names: dict[str, int], known: tuple[tuple[str, ...], ...]) -> tuple[int, int, int] | None:
    for wanted in known:
        if all(n in names for n in wanted):
            a, b, c = (names[n] for n in wanted)
            return a, b, c
    return None


def _by_name(table: np.ndarray, names: dict[str, int], wanted: tuple[str, ...]) -> Taken:
    a, b, c = (names[n] for n in wanted)
    said = [f"coordinates: {', '.join(wanted)} by the header"]
    normals = _triple(names, _NORMALS)
    if normals is not None:
        said.append(f"normals: {_list(normals)} by the header")
    colours = _triple(names, _COLOURS)
    if colours is not None:
        said.append(f"colours: {_list(colours)} by the header")
    return Taken(xyz=(a, b, c), normals=normals, said=tuple(said))


def _by_value(table: np.ndarray) -> Taken:
    n, width = table.shape
    first = 0
    said = []
    if width >= 4 and n > 2 and _counts_up(table[:, 0]):
        first = 1
        said.append("column 1: the points' numbers")
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


def _list(columns: tuple[int, ...] | list[int]) -> str:
    """Columns as people count them: "columns 4-6"."""
    names = [c + 1 for c in columns]
    if len(names) > 1 and names == list(range(names[0], names[-1] + 1)):
        return f"columns {names[0]}-{names[-1]}"
    return f"column{'s' if len(names) > 1 else ''} {', '.join(map(str, names))}"


def _counts_up(column: np.ndarray) -> bool:
    return bool((np.diff(column) == 1).all() and column[0] in (0, 1))


def _unit_vectors(vectors: np.ndarray) -> bool:
    """Whether nearly all rows are of length one (others zero or missing), and not all are the same."""
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
