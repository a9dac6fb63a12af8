"""Frames as a scanner writes them: clouds (PLY, PCD, XYZ) and depth images (NPZ, PNG) with intrinsics.

Guarantees: every point comes back in metres in the scanner's frame S (z along the optical axis). Assumes:
clouds are in S and in the unit that is said; a depth image holds z, not the length of the ray.
"""

import io
import json
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.files.part_files import read_geometry

CLOUDS, IMAGES = (".ply", ".pcd", ".xyz"), (".npz", ".png")
SUFFIXES = CLOUDS + IMAGES
INTRINSICS = "intrinsics.json"


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """A pinhole camera: x / z = (column - cx) / fx, y / z = (row - cy) / fy, columns and rows counted from
    0.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    unit_m: float = 1e-3
    """Length of one count of a PNG [m]; an NPZ has metres where it does not say otherwise."""


def intrinsics_of(scanner: Scanner) -> Intrinsics:
    """Those of the cell's scanner at full resolution."""
    w, h = scanner.rays
    fx, fy = w / (2 * np.tan(scanner.fov[0] / 2)), h / (2 * np.tan(scanner.fov[1] / 2))
    return Intrinsics(fx=float(fx), fy=float(fy), cx=(w - 1) / 2, cy=(h - 1) / 2)


def read_intrinsics(path: Path) -> Intrinsics:
    """Reads {"fx": .., "fy": .., "cx": .., "cy": .., "unit_m": ..}.

    Raises:
        InputError: no such file, or not intrinsics.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        values = {k: float(told[k]) for k in ("fx", "fy", "cx", "cy")}
        found = Intrinsics(**values, unit_m=float(told.get("unit_m", 1e-3)))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: are no intrinsics: fx, fy, cx, cy in pixels ({str(error)[:60]})") from None
    if not (np.isfinite(list(values.values())).all() and found.fx > 0 and found.fy > 0 and found.unit_m > 0):
        raise InputError(f"{path}: fx, fy and unit_m must be positive numbers")
    return found


def frame_points(path: Path, *, unit: float, intrinsics: Intrinsics) -> np.ndarray:
    """Points of one frame in S, shape (n, 3) [m]; none where the scanner measured nothing.

    Args:
        path: of the frame.
        unit: of a cloud's coordinates [m].
        intrinsics: for a depth image that brings none of its own.

    Raises:
        InputError: the file cannot be used.
    """
    suffix = path.suffix.lower()
    if suffix == ".e57":
        raise InputError(f"{path}: E57 is not read; write PLY, PCD or XYZ, which every E57 tool can")
    if suffix in CLOUDS:
        points = read_geometry(path).vertices * unit
    elif suffix == ".npz":
        points = _from_npz(path, intrinsics)
    elif suffix == ".png":
        points = _from_depth(_png(path) * intrinsics.unit_m, intrinsics)
    else:
        raise InputError(f"{path}: unknown kind of frame; known: {', '.join(SUFFIXES)}")
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) and np.abs(points).max() > 100.0:
        raise InputError(
            f"{path}: points {np.abs(points).max():.0f} m away from the scanner; is --units right?"
        )
    return points


def _from_npz(path: Path, intrinsics: Intrinsics) -> np.ndarray:
    """`depth` (rows, columns) in metres, or `points` (n, 3) in metres; own fx, fy, cx, cy win."""
    try:
        with np.load(path, allow_pickle=False) as data:
            if "points" in data:
                return np.asarray(data["points"], float).reshape(-1, 3)
            own = {k: float(data[k]) for k in ("fx", "fy", "cx", "cy") if k in data}
            depth = np.asarray(data["depth"], float)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or 'no NPZ'})") from None
    except (KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(f"{path}: holds neither depth nor points ({str(error)[:60]})") from None
    if depth.ndim != 2:
        raise InputError(f"{path}: depth has the shape {depth.shape}, rows and columns are expected")
    return _from_depth(depth, Intrinsics(**own) if len(own) == 4 else intrinsics)


def _png(path: Path) -> np.ndarray:
    """Counts of a 16-bit grey PNG, shape (rows, columns)."""
    import matplotlib.image

    try:
        image = matplotlib.image.imread(str(path), format="png")
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: is not a PNG ({str(error)[:60]})") from None
    if image.ndim != 2:
        raise InputError(f"{path}: a grey image of 16 bits is expected, not {image.shape[2]} channels")
    # matplotlib gives shares of the greatest count; depth images have 16 bits.
    counts = image * 65535.0
    if np.abs(counts - np.rint(counts)).max(initial=0.0) > 0.05 or (image * 255.0 % 1 < 1e-5).all():
        raise InputError(f"{path}: a grey image of 16 bits is expected: 8 bits are too coarse for depths")
    return np.rint(counts)


def _from_depth(depth: np.ndarray, camera: Intrinsics) -> np.ndarray:
    row, column = np.nonzero(np.isfinite(depth) & (depth > 0))
    z = depth[row, column]
    return np.column_stack([(column - camera.cx) / camera.fx * z, (row - camera.cy) / camera.fy * z, z])


def depth_npz(depth: np.ndarray, camera: Intrinsics) -> bytes:
    """A depth image with its intrinsics, as `frame_points` reads it.

    Args:
        depth: NaN where nothing was measured, shape (rows, columns) [m].
        camera: its intrinsics.
    """
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, depth=depth.astype(np.float32), fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy
    )
    return buffer.getvalue()
