"""Scans on disk: clouds as PLY, range images as NPZ, and measured scans with poses brought into one cloud."""

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.read_report import ReadReport
from scanmotion.geometry.files.ply_write import ply_data, replaced, write_ply
from scanmotion.geometry.parts.cloud_files import cloud_from_file
from scanmotion.geometry.parts.placing import UNITS
from scanmotion.sensing.corrections.registration import Registration, align
from scanmotion.sensing.fusion.fuse import Cloud, RawPoints, fuse_points
from scanmotion.sensing.fusion.surface import surface as surface_of
from scanmotion.sensing.scans.scan_sides import sides_of
from scanmotion.sensing.simulator.captures import Captures
from scanmotion.sensing.simulator.simulate import Scan

POSE_FILE = "poses.json"
_FAR_OFF = 20.0
"""Beyond so many times its size from the origin a scan is computed about an origin of its own."""
_LEAST = 50
"""Points that a registration needs."""
_FAR = 10.0
"""A scanner of unknown place is taken to stand this far off along its viewing direction [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredScan:
    """One measured cloud and where it was taken from."""

    name: str
    points: np.ndarray
    """In the scan's own frame, shape (n, 3) [m]."""
    X: np.ndarray
    """Pose of the scan in O, shape (4, 4)."""
    towards: np.ndarray | None
    """Unit vector from the surface to the sensor in the scan's frame; None where not known."""
    normals: np.ndarray | None = None
    """Outward unit normals in the scan's frame, shape (n, 3); they count where `towards` is not known."""
    said: str = ""
    """How its sides are known."""
    report: ReadReport | None = None
    """What was read from its file."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Fused:
    """Measured scans in one cloud."""

    cloud: Cloud
    registrations: tuple[Registration, ...]
    """One for each scan; empty where none was asked for."""
    names: tuple[str, ...]
    sides: tuple[str, ...] = ()
    """How the sides of each scan are known, one phrase each; "" where its pose says so."""


def save_cloud(path: str | Path, cloud: Cloud) -> None:
    """Writes the cloud as PLY in millimetres, with normals and the raw points' count as `quality`."""
    replaced(Path(path), cloud_data(cloud))


def cloud_data(cloud: Cloud) -> bytes:
    """The PLY that save_cloud writes."""
    return ply_data(cloud.points * 1e3, normals=cloud.normals, quality=cloud.counts.astype(float))


_CAPTURES = ("t", "X_WS", "table_angle", "X_WT", "X_TO", "table_sense", "rates")


def save_scan(path: str | Path, scan: Scan) -> None:
    """Writes all range images of a scan as one NPZ: depths [m] with pixel and frame, and the captures."""
    replaced(Path(path), scan_data(scan))


def scan_data(scan: Scan) -> bytes:
    """The NPZ that save_scan writes; the same scan gives the same bytes."""
    captures = {k: getattr(scan.captures, k) for k in _CAPTURES if getattr(scan.captures, k) is not None}
    buffer = io.BytesIO()
    np.savez(
        buffer, points_O=scan.points_O, depth=scan.depth, pixel=scan.pixel, frame=scan.frame, seen=scan.seen,
        rays=np.int64(scan.rays), **captures,
    )  # fmt: skip
    return buffer.getvalue()


def load_scan(path: str | Path) -> Scan:
    """Reads what save_scan wrote.

    Raises:
        InputError: no such file, or not a scan.
    """
    try:
        with np.load(Path(path), allow_pickle=False) as data:
            names = ("points_O", "depth", "pixel", "frame", "seen")
            captures = Captures(**{k: data[k] for k in _CAPTURES if k in data})
            return Scan(captures=captures, rays=int(data["rays"]), **{k: data[k] for k in names})
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or 'no NPZ'})") from None
    except (KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(f"{path}: is not a scan ({str(error)[:80]})") from None


def scans_from_poses(pose_file: str | Path) -> list[MeasuredScan]:
    """Measured scans that a pose file names, from the folder where it lies.

    The file is JSON: {"units": "mm", "scans": {"a.ply": {"T_object_scan": 4 x 4 in that unit,
    "nominal_view_direction": direction sensor -> surface in the object frame (optional)}}}.

    Raises:
        InputError: the file or a scan cannot be used; the line says which.
    """
    path = Path(pose_file)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({str(error)[:80]})") from None
    scans = data.get("scans") if isinstance(data, dict) else None
    if not isinstance(scans, dict) or not scans:
        raise InputError(f'{path}: names no "scans"')
    unit = data.get("units", "mm")
    if unit not in UNITS:
        raise InputError(f"{path}: unknown unit {str(unit)[:20]!r}; known: {', '.join(UNITS)}")
    return [_scan_from(path, name, entry, UNITS[unit]) for name, entry in scans.items()]


def _scan_from(path: Path, name: str, entry: object, unit: float) -> MeasuredScan:
    if Path(name).name != name:
        raise InputError(f"{path}: {name}: scans lie in the folder of the pose file")
    X = _numbers(entry, "T_object_scan", (4, 4))
    if X is None or not np.allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-3):
        raise InputError(f"{path}: {name}: T_object_scan is not a pose")
    X = X.copy()
    X[:3, 3] *= unit
    view = _numbers(entry, "nominal_view_direction", (3,))
    towards = None if view is None else -X[:3, :3].T @ view / max(float(np.linalg.norm(view)), 1e-12)
    unit_name = next(key for key, metres in UNITS.items() if metres == unit)
    file = cloud_from_file(path.parent / name, units=unit_name, any_size=True)
    return MeasuredScan(name=name, points=file.points, X=X, towards=towards, normals=file.normals)


def _numbers(entry: object, key: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """The entry's array of that shape, or None."""
    told = entry if isinstance(entry, dict) else {}
    try:
        value = np.array(told[key], dtype=float)
    except (KeyError, TypeError, ValueError):
        return None
    return value if value.shape == shape and np.isfinite(value).all() else None


def scan_from_file(path: Path, units: str | None = None) -> MeasuredScan:
    """A scan in the table's frame, its specks and the table's plane left out.

    Raises:
        PartError: the file cannot be used.
    """
    file = cloud_from_file(path, units=units, up=np.array([0.0, 0.0, 1.0]), any_size=True)
    return MeasuredScan(name=path.name, points=file.points, X=np.eye(4), towards=None, normals=file.normals)


def fuse_measured(
    scans: Sequence[MeasuredScan], *, voxel: float = 0.002, registered: bool = True, reach: float = 0.008,
    progress: Callable[[str, float], None] | None = None,
) -> Fused:  # fmt: skip
    """Registers measured scans from their poses and merges them; an untrusted registration moves nothing.

    Args:
        scans: with poses; the first stays where its pose puts it.
        voxel: edge [m].
        registered: whether to refine the poses first.
        reach: by how much the poses may be wrong at the surface [m].
        progress: told the stage and the share done.
    """
    tell = progress or (lambda stage, share: None)
    tell("read", 0.0)
    origin = _local_origin(scans)
    scans = _with_sides([_moved(s, -origin) for s in scans])
    found: tuple[Registration, ...] = ()
    if registered and len(scans) > 1:
        # Each scan by itself, in its own frame: its points thinned, with normals that face its sensor.
        single = []
        for i, s in enumerate(scans):
            single.append(fuse_points(_raw([replace(s, X=np.eye(4))]), voxel=voxel))
            tell("normals", (i + 1) / len(scans))
        tell("register", 0.0)
        found = _aligned(single, np.stack([s.X for s in scans]), reach)
        scans = [replace(s, X=r.X) if r.trusted else s for s, r in zip(scans, found, strict=True)]
    tell("fuse", 0.0)
    cloud = fuse_points(_raw(scans), voxel=voxel)
    tell("fuse", 1.0)
    if origin.any():
        cloud = replace(cloud, points=cloud.points + origin, cells=None)
    names, sides = tuple(s.name for s in scans), tuple(s.said for s in scans)
    return Fused(cloud=cloud, registrations=found, names=names, sides=sides)


def _local_origin(scans: Sequence[MeasuredScan]) -> np.ndarray:
    """A round place near the first scan where that is far off (UTM); else the frame's own, shape (3,) [m]."""
    s = scans[0]
    middle = s.X[:3, :3] @ s.points.mean(axis=0) + s.X[:3, 3]
    size = float(np.linalg.norm(np.ptp(s.points, axis=0)))
    return np.round(middle) if np.linalg.norm(middle) > max(_FAR_OFF * size, 1.0) else np.zeros(3)


def _moved(scan: MeasuredScan, by: np.ndarray) -> MeasuredScan:
    X = scan.X.copy()
    X[:3, 3] += by
    return replace(scan, X=X)


def _with_sides(scans: Sequence[MeasuredScan]) -> list[MeasuredScan]:
    """The scans with normals, where no viewing direction is known."""
    unknown = [s for s in scans if s.towards is None]
    if not unknown:
        return list(scans)
    placed = [s.points @ s.X[:3, :3].T + s.X[:3, 3] for s in unknown]
    known = [None if s.normals is None else s.normals @ s.X[:3, :3].T for s in unknown]
    sides = iter(sides_of(placed, known))
    out = []
    for s in scans:
        if s.towards is None:
            side = next(sides)
            s = replace(s, normals=side.normals @ s.X[:3, :3], said=side.said)
        out.append(s)
    return out


def _aligned(clouds: list[Cloud], start: np.ndarray, reach: float) -> tuple[Registration, ...]:
    """Registrations of all clouds; those too small to register stay, and say so."""
    fit = [i for i, c in enumerate(clouds) if len(c) >= _LEAST or i == 0]
    found = iter(align([clouds[i] for i in fit], start=start[fit], reach=reach) if len(fit) > 1 else ())
    stays = {i: _not_registered(start[i], len(c)) for i, c in enumerate(clouds) if i not in fit}
    return tuple(stays[i] if i in stays else next(found) for i in range(len(clouds))) if len(fit) > 1 else ()


def _not_registered(X: np.ndarray, n: int) -> Registration:
    return Registration(
        X=X, fitness=0.0, rms=0.0, condition=np.inf, uncertainty=np.inf, shift=0.0, turn=0.0, trusted=False,
        statement=f"not registered: its {n} points are too few; it stays where it is",
    )  # fmt: skip


def _raw(scans: Sequence[MeasuredScan]) -> RawPoints:
    """All points in O; a scan of unknown viewing direction has a sensor over each of its points."""
    points, frame, cameras = [], [], []
    for s in scans:
        p = s.points @ s.X[:3, :3].T + s.X[:3, 3]
        first = len(cameras)
        if s.towards is None:
            assert s.normals is not None
            cameras += list(p + _FAR * (s.normals @ s.X[:3, :3].T))
            frame.append(first + np.arange(len(p)))
        else:
            cameras.append(p.mean(axis=0) + _FAR * (s.X[:3, :3] @ s.towards))
            frame.append(np.full(len(p), first))
        points.append(p)
    stacked = np.concatenate(points)
    return RawPoints(
        points=stacked.astype(np.float32), frame=np.concatenate(frame).astype(np.int32),
        cameras=np.array(cameras), sigma=np.full(len(stacked), _real_sigma(stacked), np.float32),
    )  # fmt: skip


def _real_sigma(points: np.ndarray) -> float:
    """A thousandth of the size of the cloud: what a scanner of unknown noise is taken to get wrong [m]."""
    return float(np.linalg.norm(np.ptp(points, axis=0))) * 1e-3


def fuse_folder(
    folder: str | Path, pose_file: str | Path | None = None, *, voxel: float = 0.002, registered: bool = True,
    reach: float = 0.008, progress: Callable[[str, float], None] | None = None,
) -> Fused:  # fmt: skip
    """Fuses the scans that a pose file in `folder` names ("poses.json" unless another is given).

    Raises:
        InputError: as scans_from_poses.
    """
    path = Path(folder) / (pose_file or POSE_FILE)
    return fuse_measured(
        scans_from_poses(path), voxel=voxel, registered=registered, reach=reach, progress=progress
    )


def fuse_files(
    files: Sequence[Path], out: Path, *, units: str = "mm", voxel: float = 0.002, align: bool = True,
    surface: bool = False, seed: int = 0, progress: Callable[[str, float], None] | None = None,
) -> list[str]:  # fmt: skip
    """Fuses scan files, folders with a pose file, or pose files, and writes a PLY in millimetres.

    Args:
        files: clouds in the table's frame; a folder stands for its pose file, a .json is a pose file.
        out: PLY to write.
        units: of the cloud files; a pose file states its own.
        voxel: edge [m].
        align: whether to register the scans first.
        surface: write a triangle mesh instead of the cloud.
        seed: unused by the method, which draws no random numbers.
        progress: told the stage and the share done.

    Returns:
        what was done, one line each.
    """
    scans: list[MeasuredScan] = []
    for file in files:
        if file.is_dir() or file.suffix == ".json":
            scans += scans_from_poses(file / POSE_FILE if file.is_dir() else file)
        else:
            scans.append(scan_from_file(file, units))
    fused = fuse_measured(scans, voxel=voxel, registered=align, progress=progress)
    lines = [f"{n}: {r.statement}" for n, r in zip(fused.names[1:], fused.registrations[1:], strict=False)]
    if surface:
        vertices, triangles = surface_of(fused.cloud)
        write_ply(out, vertices * 1e3, triangles=triangles)
        return [*lines, f"{len(scans)} scans -> {len(triangles)} triangles in {out}"]
    save_cloud(out, fused.cloud)
    return [*lines, f"{len(scans)} scans -> {len(fused.cloud)} points in {out}"]
