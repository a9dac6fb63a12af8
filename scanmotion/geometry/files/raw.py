"""What a file holds before anything is judged, and polygons into triangles."""

from dataclasses import dataclass

import mapbox_earcut
import numpy as np

from scanmotion.core.errors import PartError

NO_TRIANGLES = np.zeros((0, 3), np.int64)


@dataclass(frozen=True, eq=False, kw_only=True)
class RawGeometry:
    """What a file holds, in its own unit and frame, unchecked beyond its syntax."""

    vertices: np.ndarray
    """Shape (n, 3), double precision."""
    triangles: np.ndarray
    """Shape (m, 3), int64; (0, 3) for a cloud."""
    normals: np.ndarray | None = None
    """Shape (n, 3), as they stand in the file."""
    format: str = ""
    """Kind of file in words, e.g. "PLY, ASCII"."""
    units: str = ""
    """Unit that the file states (mm, cm, m, in, ..), or ""."""
    units_from: str = ""
    """Where the file states its unit."""
    columns: tuple[str, ...] = ()
    """What was taken for what, one phrase each: "normals: nx, ny, nz"."""
    notes: tuple[str, ...] = ()
    """What was left out or put right while reading, one sentence each."""
    up: str = ""
    """Axis that points up where the format's standard says it (+y in glTF), or ""."""
    doubts: tuple[str, ...] = ()
    """What may be wrong with it, one sentence each."""
    up_doubt: str = ""
    """Why z may not be up, for who does not say what is."""
    step: float = 0.0
    """Least difference of two coordinates that the file can tell apart, in its unit; 0 where not known."""


BEYOND = 1e15
"""No measured coordinate is so large, in any unit: what is stands for no number."""


def are_numbers(points: np.ndarray) -> np.ndarray:
    """Which points (n, 3) are finite and of a size that can have been measured, shape (n,)."""
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(points) < BEYOND).all(axis=1))


def float_step(points: np.ndarray) -> float:
    """The step of single precision at the largest coordinate."""
    largest = float(np.abs(points[np.isfinite(points)]).max(initial=0.0))
    return float(np.spacing(np.float32(min(largest, 3e38))))


def whole_numbers(values: np.ndarray) -> np.ndarray:
    """Counts and corners of faces as int64.

    Raises:
        PartError: one is no whole number.
    """
    with np.errstate(invalid="ignore"):
        if values.dtype.kind == "f" and not ((np.abs(values) < 1 << 53) & (values == np.rint(values))).all():
            raise PartError("faces with counts or corners that are no whole numbers")
    return values.astype(np.int64)


def checked_triangles(faces: np.ndarray, n_vertices: int) -> np.ndarray:
    """Triangles as int64 (m, 3) whose corners exist.

    Raises:
        PartError: a corner that does not exist.
    """
    triangles = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= n_vertices):
        wrong = int(triangles.min() if triangles.min() < 0 else triangles.max())
        raise PartError(f"a face points at vertex {wrong} of {n_vertices}")
    return triangles


@dataclass(frozen=True, eq=False, kw_only=True)
class Polygons:
    """Faces of any number of corners, one after the other."""

    corners: np.ndarray
    """Vertex indices of all faces in a row, shape (k,)."""
    counts: np.ndarray
    """Corners of each face, shape (f,)."""


def triangulated(points: np.ndarray, faces: Polygons) -> tuple[np.ndarray, tuple[str, ...]]:
    """Triangles of the faces in the order of the file, and what is to be said about them.

    Convex faces are cut as a fan from their first corner. Concave ones are cut by ear clipping (the earcut
    library): a fan would cross their notch.

    Raises:
        PartError: a corner that does not exist.
    """
    counts = np.asarray(faces.counts, np.int64)
    corners = np.asarray(faces.corners, np.int64)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        wrong = int(corners.min() if corners.min() < 0 else corners.max())
        raise PartError(f"a face points at vertex {wrong} of {len(points)}")
    if len(counts) and (counts == 3).all():
        return checked_triangles(corners, len(points)), ()
    first = np.cumsum(counts) - counts
    pieces, order, concave = [], [], 0
    for size in np.unique(counts[counts >= 3]):
        rows = np.flatnonzero(counts == size)
        loops = corners[first[rows][:, None] + np.arange(size)]
        made, whose, clipped = _cut(points, loops)
        concave += clipped
        pieces.append(made)
        order.append(rows[whose])
    notes = [f"{concave} concave faces were cut by their ears"] if concave else []
    if few := int((counts < 3).sum()):
        notes.append(f"{few} faces of fewer than three corners were left out")
    if not pieces:
        return NO_TRIANGLES, tuple(notes)
    triangles = np.concatenate(pieces)[np.argsort(np.concatenate(order), kind="stable")]
    return checked_triangles(triangles, len(points)), tuple(notes)


def _cut(points: np.ndarray, loops: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Triangles of faces of equal size (f, k), the face of each triangle, and how many were concave."""
    n, size = loops.shape
    if size == 3:
        return loops, np.arange(n), 0
    fans = np.stack([np.broadcast_to(loops[:, :1], (n, size - 2)), loops[:, 1:-1], loops[:, 2:]], axis=2)
    whose = np.repeat(np.arange(n), size - 2)
    concave = np.flatnonzero(_concave(points[loops]))
    if not len(concave):
        return fans.reshape(-1, 3), whose, 0
    keep = np.ones(n, bool)
    keep[concave] = False
    made, owner = [fans[keep].reshape(-1, 3)], [whose.reshape(n, -1)[keep].ravel()]
    for face in concave.tolist():
        ears = _ears(points[loops[face]])
        made.append(loops[face][ears])
        owner.append(np.full(len(ears), face))
    return np.concatenate(made), np.concatenate(owner), len(concave)


def _newell(loops: np.ndarray) -> np.ndarray:
    """Vector area of closed polygons (f, k, 3), shape (f, 3)."""
    here = loops - loops[:, :1]
    return np.cross(here, np.roll(here, -1, axis=1)).sum(axis=1) / 2


def _concave(loops: np.ndarray) -> np.ndarray:
    """Which polygons (f, k, 3) have a corner that turns against their own sense, shape (f,)."""
    with np.errstate(all="ignore"):  # corners may be no numbers
        normal = _newell(loops)
        into = loops - np.roll(loops, 1, axis=1)
        out = np.roll(loops, -1, axis=1) - loops
        turn = np.einsum("fki,fi->fk", np.cross(into, out), normal)
        return (turn < -1e-6 * np.einsum("fi,fi->f", normal, normal)[:, None]).any(axis=1)


def _ears(loop: np.ndarray) -> np.ndarray:
    """Triangles of one polygon (k, 3) as positions in it, wound like the polygon."""
    normal = _newell(loop[None])[0]
    axis = int(np.argmax(np.abs(normal)))
    u, v = (axis + 1) % 3, (axis + 2) % 3
    plane = np.ascontiguousarray(loop[:, [u, v]] if normal[axis] > 0 else loop[:, [v, u]], dtype=float)
    ears = mapbox_earcut.triangulate_float64(plane, np.array([len(loop)], np.uint32))
    ears = ears.reshape(-1, 3).astype(np.int64)
    a, b, c = (plane[ears[:, i]] for i in range(3))
    turn = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    ears[turn < 0] = ears[turn < 0][:, ::-1]
    return ears
