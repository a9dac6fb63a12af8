"""Parts from what a programmer has in hand: arrays, trimesh and Open3D meshes, clouds, files.

Guarantees: the same checks and repairs as for a file; the unit is asked for, never guessed.
"""

from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part
from scanmotion.geometry.files.raw import NO_TRIANGLES, RawGeometry, checked_triangles, float_step
from scanmotion.geometry.parts.make_part import carving, part_from_file, part_from_raw


def part_from(
    source: Any, *, units: str | None = None, up: str = "", place: str = "centre", name: str = "part"
) -> Part:
    """The part that `source` is.

    Args:
        source: a Part; a path; the word "carving"; a trimesh or Open3D mesh; an Open3D cloud; a pair
            (vertices, triangles) of arrays of shapes (n, 3) and (m, 3); or points alone, shape (n, 3).
        units: unit of the coordinates: mm, cm, m, in, ft or um. A file may state its own; everything else
            needs it.
        up: axis of the source that points up: +x, -x, +y, -y, +z or -z; by default +z, or as a file says.
        place: "centre" stands it on the table's centre; "keep" takes x, y, z as they are.
        name: what a part made from arrays is called.

    Raises:
        PartError: not one of these, no unit, or refused as a file of the same content would be.
    """
    if isinstance(source, Part):
        return source
    if isinstance(source, str | Path):
        given = str(source) == "carving" and not Path(source).exists()
        return carving() if given else part_from_file(source, units=units, up=up, place=place)
    vertices, triangles, normals = _arrays(source)
    if units is None:
        raise PartError(f"{name}: in which unit are the coordinates? Give units, e.g. units='mm'")
    raw = RawGeometry(
        vertices=vertices,
        triangles=checked_triangles(triangles, len(vertices)),
        normals=normals,
        format="arrays",
        step=float_step(vertices) if _single(source) else 0.0,
    )
    return part_from_raw(raw, name, units=units, up=up, place=place)


def _arrays(source: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Vertices (n, 3), triangles (m, 3) and normals (n, 3) or None."""
    for name in ("faces", "triangles"):
        if hasattr(source, "vertices") and hasattr(source, name):
            return _points(source.vertices), _indices(getattr(source, name)), None
    if hasattr(source, "points"):
        points, normals = _points(source.points), np.asarray(getattr(source, "normals", ()), dtype=float)
        return points, NO_TRIANGLES, normals if normals.shape == points.shape else None
    if isinstance(source, tuple | list) and len(source) == 2 and np.ndim(source[0]) == 2:
        return _points(source[0]), _indices(source[1]), None
    if isinstance(source, np.ndarray):
        return _points(source), NO_TRIANGLES, None
    raise PartError(
        f"a part cannot be made from a {type(source).__name__}; known: Part, path, trimesh or Open3D mesh, "
        "Open3D cloud, (vertices, triangles), points"
    )


def _single(source: Any) -> bool:
    """Whether the coordinates are in single precision."""
    first = source[0] if isinstance(source, tuple | list) else getattr(source, "vertices", source)
    return np.asarray(first).dtype == np.float32


def _points(values: Any) -> np.ndarray:
    found = np.asarray(values, dtype=float)
    if found.ndim != 2 or found.shape[1] != 3:
        raise PartError(f"points of shape {found.shape}; (n, 3) is expected")
    return found


def _indices(values: Any) -> np.ndarray:
    found = np.asarray(values)
    if found.ndim != 2 or found.shape[1] != 3 or not np.issubdtype(found.dtype, np.integer):
        raise PartError(f"triangles of shape {found.shape}, {found.dtype}; integers (m, 3) are expected")
    return found
