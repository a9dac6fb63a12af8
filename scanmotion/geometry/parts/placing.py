"""From the file's frame and unit to the table: which unit, which way is up, and whether the size is sane."""

from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.core.read_report import ReadReport
from scanmotion.geometry.files.raw import RawGeometry
from scanmotion.geometry.mending.mend_cloud import MendedCloud
from scanmotion.geometry.mending.mend_mesh import Mended

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048, "um": 1e-6}
_AXES = {"x": 0, "y": 1, "z": 2}
_LEAST, _MOST = 0.01, 20.0
"""Nothing smaller or larger is scanned in such a cell [m]."""
_SMALL = 0.06
"""A part smaller than this [m] whose unit nobody states may well be in another unit."""
_BLURRED = 0.01
"""A file whose steps are more than this share of the part's size has lost its surface, if it is far off."""
_FAR = 20.0
"""Coordinates are far off beyond so many times the part's size."""


def upright(up: str, path: str) -> np.ndarray:
    """Rotation that turns the file's `up` axis to +z; the two others keep their cyclic order."""
    if len(up) != 2 or up[0] not in "+-" or up[1] not in _AXES:
        raise PartError(f"unknown up axis {up!r}; known: +x, -x, +y, -y, +z, -z", path=path)
    z = np.zeros(3)
    z[_AXES[up[1]]] = 1.0 if up[0] == "+" else -1.0
    x = np.roll(np.abs(z), 1)
    return np.stack([x, np.cross(z, x), z])


def unit_of(raw: RawGeometry, given: str | None, points: np.ndarray, *, guess: bool) -> tuple[str, str]:
    """The unit of a file's coordinates, and how it is known.

    Args:
        raw: what the file states.
        given: by the user; it wins over the file.
        points: shape (n, 3), in the file's unit.
        guess: whether a size that is absurd in mm may be taken for metres.
    """
    if given:
        against = f", though {raw.units_from} says {raw.units}" if raw.units and raw.units != given else ""
        return given, f"given{against}"
    if raw.units in UNITS:
        return raw.units, f"stated by {raw.units_from}"
    size = float(np.ptp(points, axis=0).max())
    if guess and size * UNITS["mm"] < _LEAST and _LEAST <= size <= _MOST:
        return "m", f"guessed: in mm it would be {size:.3g} mm large"
    return "mm", "assumed: the file states none"


def check_size(vertices: np.ndarray, units: str, path: str) -> None:
    """Refuses what is absurdly small or large, or lies on one line.

    Raises:
        PartError: with the size found.
    """
    largest = float(np.ptp(vertices, axis=0).max())
    if largest < _LEAST:
        raise PartError(
            f"is only {largest * 1e3:.3g} mm large in unit {units!r}; {other_units(largest, units)}",
            path=path,
        )
    if largest > _MOST:
        raise PartError(
            f"is {largest:.3g} m large in unit {units!r}; {other_units(largest, units)}", path=path
        )
    centred = vertices - vertices.mean(axis=0)
    if np.linalg.matrix_rank(centred.T @ centred, tol=1e-12 * largest**2 * len(vertices)) < 2:
        raise PartError("all points lie on one line", path=path)


def _small(largest: float, unit: str, units_from: str) -> tuple[str, ...]:
    """What is to be said of a size [m] that would be likelier in another unit than the assumed one."""
    if largest >= _SMALL or not units_from.startswith("assumed"):
        return ()
    others = ", ".join(
        f"{largest / UNITS[unit] * UNITS[u] * 1e3:.4g} mm in {u}" for u in ("cm", "in", "m")
        if largest / UNITS[unit] * UNITS[u] <= _MOST
    )  # fmt: skip
    return (f"it is small: if it is in another unit, give --units (it would be {others})",)


def other_units(largest: float, units: str) -> str:
    """Which other unit would make sense of a size [m]."""
    fit = [u for u, scale in UNITS.items() if _LEAST <= largest / UNITS[units] * scale <= _MOST]
    fit = [u for u in fit if u != units] or list(UNITS)
    return f"try another --units ({', '.join(fit)})"


def check_steps(points: np.ndarray, step: float, path: str) -> None:
    """Refuses coordinates so far from the origin that the file's precision has lost the surface.

    Raises:
        PartError: with the step of the file.
    """
    size = float(np.ptp(points, axis=0).max())
    far = float(np.abs(points).max())
    if step > _BLURRED * size > 0 and far > _FAR * size:
        raise PartError(
            f"its coordinates (up to {far:.6g}) are written in steps of {step:.3g}, its size is {size:.3g}: "
            "the surface is lost; export it about a local origin or in double precision",
            path=path,
        )


def report_of(
    raw: RawGeometry, made: Mended | MendedCloud, path: str, unit: str, units_from: str, size: np.ndarray
) -> ReadReport:
    """What is to be said of a file that was read; size (3,) in metres."""
    mesh = isinstance(made, Mended)
    doubts = (*raw.doubts, *_small(float(size.max()), unit, units_from))
    return ReadReport(
        file=Path(path).name, format=raw.format, points=len(made.vertices) if mesh else len(made.points),
        triangles=len(made.triangles) if mesh else 0,
        size_mm=(float(size[0]) * 1e3, float(size[1]) * 1e3, float(size[2]) * 1e3),
        units=unit, units_from=units_from, columns=raw.columns,
        bodies=made.bodies if mesh else made.pieces, specks=made.specks, closed=mesh and made.closed,
        welded=made.welded if mesh else 0, turned=made.turned, dropped=made.dropped,
        split=made.split if mesh else 0, changes=(*raw.notes, *made.changes),
        warnings=(*doubts, *(made.warnings if mesh else ())),
    )  # fmt: skip
