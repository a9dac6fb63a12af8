"""GLB, glTF, 3MF and E57 by their libraries, in a process of their own.

The libraries (trimesh, pye57) build what a file claims before they look at its size. The process has a limit
of memory and of time, so that the worst a file can do is to be refused.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.raw import NO_TRIANGLES, RawGeometry, checked_triangles

_SECONDS = 600
_LEAST_BYTES, _TIMES = 1 << 30, 40
"""A reader may take a GiB, or 40 times the file where that is more."""


def read_by_library(path: Path) -> RawGeometry:
    """Reads a file of a kind that only libraries read.

    Raises:
        PartError: the library is missing, refuses the file, or takes too much.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "read.npz"
        most = max(_LEAST_BYTES, _TIMES * path.stat().st_size)
        command = [
            sys.executable,
            "-m",
            "scanmotion.geometry.files.in_process",
            str(path),
            str(out),
            str(most),
        ]
        try:
            done = subprocess.run(command, capture_output=True, timeout=_SECONDS, check=False)
        except subprocess.TimeoutExpired:
            raise PartError(f"could not be read in {_SECONDS} s") from None
        if not out.is_file():
            said = done.stderr.decode("utf-8", "replace").strip().split("\n")[-1]
            raise PartError(said[:200] or "its reader broke down over it")
        with np.load(out, allow_pickle=False) as data:
            n = len(data["vertices"])
            return RawGeometry(
                vertices=data["vertices"],
                triangles=checked_triangles(data["triangles"], n) if len(data["triangles"]) else NO_TRIANGLES,
                format=str(data["format"]), units=str(data["units"]), units_from=str(data["units_from"]),
                up=str(data["up"]), notes=tuple(str(n) for n in data["notes"]), step=float(data["step"]),
            )  # fmt: skip


_BY_STANDARD = {".glb": "the glTF standard", ".gltf": "the glTF standard", ".e57": "the E57 standard"}
_LONG_UNITS = {
    "millimeters": "mm", "millimeter": "mm", "centimeters": "cm", "centimeter": "cm", "meters": "m",
    "meter": "m", "inches": "in", "inch": "in", "feet": "ft", "foot": "ft", "microns": "um", "micron": "um",
}  # fmt: skip


_NOT_READ = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization")
"""Extensions of glTF that change where the points are."""


def _check_gltf(path: Path) -> None:
    """Refuses glTF whose points trimesh reads as zeros, or not at all, without a word.

    Raises:
        PartError: packed by an extension, or with sparse or empty accessors.
    """
    data = path.read_bytes()
    words = data[20 : 20 + int.from_bytes(data[12:16], "little")] if data[:4] == b"glTF" else data
    document = json.loads(words)
    used = [
        str(name) for name in [*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())]
    ]
    if packed := [name for name in _NOT_READ if name in used]:
        raise PartError(f"its points are packed by {packed[0]}, which is not read here: export it without")
    for accessor in document.get("accessors", ()):
        if "sparse" in accessor:
            raise PartError("it has sparse accessors, which are not read here: export it without")
        if "bufferView" not in accessor:
            raise PartError("it has an accessor without data")


def _by_trimesh(path: Path) -> dict:
    import trimesh

    if path.suffix.lower() in (".glb", ".gltf"):
        _check_gltf(path)
    scene = trimesh.load_scene(path)
    points, triangles, clouds, first = [], [], 0, 0
    for name in scene.graph.nodes_geometry:
        X, key = scene.graph[name]
        body = scene.geometry[key]
        faces = np.asarray(getattr(body, "faces", NO_TRIANGLES))
        if not hasattr(body, "vertices") or not (len(faces) or isinstance(body, trimesh.PointCloud)):
            clouds += 1
            continue
        placed = np.asarray(body.vertices, float) @ X[:3, :3].T + X[:3, 3]
        if np.linalg.det(X[:3, :3]) < 0:
            faces = faces[:, ::-1]
        points.append(placed)
        triangles.append(faces.reshape(-1, 3) + first)
        first += len(placed)
    if not points:
        raise PartError("holds no triangles and no points")
    notes = [f"{len(points)} bodies of its scene were put together"] if len(points) > 1 else []
    notes += [f"{clouds} entities that are no surfaces were left out"] if clouds else []
    units = _LONG_UNITS.get(str(scene.units or ""), "")
    suffix = path.suffix.lower()
    units_from = _BY_STANDARD.get(suffix, "the file") if units or suffix in _BY_STANDARD else ""
    stacked = np.concatenate(points)
    return {
        "vertices": stacked, "triangles": np.concatenate(triangles), "notes": np.array(notes, dtype=str),
        "format": suffix[1:].upper(), "units": units or ("m" if suffix in _BY_STANDARD else ""),
        "units_from": units_from, "up": "+y" if suffix in _BY_STANDARD else "",
        "step": 0.0 if suffix == ".3mf" else float(np.spacing(np.float32(np.abs(stacked).max(initial=0.0)))),
    }  # fmt: skip


def _by_pye57(path: Path) -> dict:
    try:
        import pye57
    except ImportError:
        raise PartError("E57 files need the package pye57: pip install 'scanmotion[e57]'") from None
    file, size = pye57.E57(str(path)), path.stat().st_size
    points = []
    for number in range(file.scan_count):
        header = file.get_header(number)
        if header.point_count > 8 * size:
            raise PartError(f"scan {number + 1} claims {header.point_count} points in {size} bytes")
        rows = file.read_scan(number, ignore_missing_fields=True, transform=True)
        points.append(np.column_stack([rows["cartesianX"], rows["cartesianY"], rows["cartesianZ"]]))
    if not points:
        raise PartError("E57 file without a scan")
    stacked = np.concatenate(points).astype(float)
    notes = [f"{len(points)} scans were put together by the poses in the file"] if len(points) > 1 else []
    return {
        "vertices": stacked, "triangles": NO_TRIANGLES, "notes": np.array(notes, dtype=str), "format": "E57",
        "units": "m", "units_from": _BY_STANDARD[".e57"], "up": "", "step": 0.0,
    }  # fmt: skip


def _main(path: Path, out: Path, most: int) -> None:
    import contextlib
    import io
    import logging

    logging.disable(logging.CRITICAL)
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most + (2 << 30), most + (2 << 30)))
    except (ImportError, ValueError, OSError):
        pass  # not on this system: the limit of time stays
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            made = _by_pye57(path) if path.suffix.lower() == ".e57" else _by_trimesh(path)
    except PartError as error:
        sys.exit(str(error))
    except MemoryError:
        sys.exit("its reader wants more memory than a file of its size may take")
    except Exception as error:
        kind = path.suffix[1:].upper()
        sys.exit(
            f"is not a readable {kind} file ({type(error).__name__}: {' '.join(str(error).split())[:100]})"
        )
    with out.open("wb") as file:
        np.savez(file, **made)


if __name__ == "__main__":
    _main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
