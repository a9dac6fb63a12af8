"""PLY files of clouds and meshes, written as a whole or not at all."""

from pathlib import Path

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.support.whole_file import write_whole

_FAR = 200.0
"""Beyond so many times their extent from the origin, coordinates are written in double precision."""


def write_ply(
    path: Path, points: np.ndarray, *, normals: np.ndarray | None = None, colors: np.ndarray | None = None,
    quality: np.ndarray | None = None, triangles: np.ndarray | None = None,
) -> None:  # fmt: skip
    """Writes a binary little-endian PLY under a temporary name and renames it; arguments as ply_data."""
    replaced(
        path, ply_data(points, normals=normals, colors=colors, quality=quality, triangles=triangles)
    )  # fmt: skip


def ply_data(
    points: np.ndarray, *, normals: np.ndarray | None = None, colors: np.ndarray | None = None,
    quality: np.ndarray | None = None, triangles: np.ndarray | None = None, double: bool = False,
) -> bytes:  # fmt: skip
    """A binary little-endian PLY, in the unit of `points`; in single precision where that loses no surface.

    Args:
        points: shape (n, 3).
        normals: unit vectors, shape (n, 3).
        colors: shape (n, 3) uint8.
        quality: a number for each point, shape (n,).
        triangles: indices of points, shape (t, 3).
        double: whether points are written in double precision.
    """
    # Far from the origin (UTM) single precision would lose the surface.
    far = len(points) and np.abs(points).max() > _FAR * max(float(np.ptp(points, axis=0).max()), 1e-300)
    place = "f8" if far or double else "f4"
    fields = [("x", place), ("y", place), ("z", place)]
    fields += [("nx", "f4"), ("ny", "f4"), ("nz", "f4")] if normals is not None else []
    fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")] if colors is not None else []
    fields += [("quality", "f4")] if quality is not None else []
    table = np.zeros(len(points), np.dtype([(n, "<" + t) for n, t in fields]))
    for names, values in (
        (("x", "y", "z"), points), (("nx", "ny", "nz"), normals), (("red", "green", "blue"), colors),
        (("quality",), None if quality is None else quality[:, None]),
    ):  # fmt: skip
        if values is not None:
            for a, name in enumerate(names):
                table[name] = values[:, a]
    kinds = {"f4": "float", "f8": "double", "u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", "comment scanmotion", f"element vertex {len(points)}"]
    lines += [f"property {kinds[t]} {n}" for n, t in fields]
    faces = np.zeros(0 if triangles is None else len(triangles), np.dtype([("k", "u1"), ("v", "<i4", (3,))]))
    if triangles is not None:
        faces["k"], faces["v"] = 3, triangles
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header = ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
    return header + table.tobytes() + faces.tobytes()


def replaced(path: Path, data: bytes) -> None:
    """Writes the whole file or none of it.

    Raises:
        InputError: it cannot be written.
    """
    try:
        write_whole(path, data)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
