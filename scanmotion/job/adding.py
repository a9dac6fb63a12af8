"""Frames into the job: files read, poses given, doubles noticed, written as one batch."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scanmotion.cell.build import build_cell
from scanmotion.core.errors import InputError
from scanmotion.core.support.streams import fixed_stream
from scanmotion.core.viewpoint import look_at
from scanmotion.job.frame_files import (
    INTRINSICS,
    SUFFIXES,
    Intrinsics,
    frame_points,
    intrinsics_of,
    read_intrinsics,
)
from scanmotion.job.poses import LIST, Line, posed, read_list, read_pose_log
from scanmotion.job.store import Job, digest, with_batch
from scanmotion.plan_io.load import load_plan
from scanmotion.sensing.corrections.calibration import with_poses
from scanmotion.sensing.simulator.captures import Captures, ScanErrors, true_poses
from scanmotion.sensing.simulator.simulate import Scan

_NUMBER = re.compile(r"(\d+)$")


@dataclass(frozen=True, kw_only=True)
class AddOptions:
    """How frames are read."""

    frames_list: Path | None = None
    """CSV; None: `frames.csv` beside the frames where there is one, else the number that ends a file's
    name."""
    log: Path | None = None
    """The controller's log."""
    offset_s: float = 0.0
    """Added to the frames' time stamps [s]."""
    plan: int | None = None
    """Number of the plan whose programme took them; None for the last."""
    unit: float = 1e-3
    """Of clouds [m]."""
    intrinsics: Path | None = None
    simulated: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Added:
    """What became of the frames."""

    job: Job
    frames: int
    points: int
    double: tuple[str, ...]
    """Files that the job had already; they are left out."""
    how: str
    """Where the poses came from."""


def add_frames(
    job: Job, paths: Sequence[Path], options: AddOptions, progress: Callable[[float], None] = lambda f: None
) -> Added:
    """Adds frames to a job as one batch.

    Args:
        job: as it is.
        paths: frames, or folders of them.
        options: how to read them.
        progress: told the share done.

    Raises:
        InputError: a frame cannot be read or has no pose; nothing is added then.
    """
    files = frame_paths(paths)
    lines = _lines(files, options.frames_list)
    known, hashes, fresh, double = job.seen_files, [], [], []
    for file, line in zip(files, lines, strict=True):
        sha = digest(file)
        if sha in known:
            double.append(file.name)
            continue
        known = known | {sha}
        hashes.append(sha)
        fresh.append((file, line))
    if not fresh:
        return Added(job=job, frames=0, points=0, double=tuple(double), how="")
    cell = build_cell(job.settings)
    number = options.plan or (len(job.record.plans) or None)
    if number is not None and not 1 <= number <= len(job.record.plans):
        raise InputError(f"--plan {number}: the job has the plans 1 to {len(job.record.plans)}")
    log = None if options.log is None else read_pose_log(options.log, cell.joint_names)
    trajectory = None
    if number is not None and log is None and not all(line.pose is not None for _, line in fresh):
        trajectory = load_plan(job.plan_folder(number)).trajectory
    captures, how = posed([line for _, line in fresh], cell, trajectory, log, offset_s=options.offset_s)
    captures = known_constants(captures, job)
    scan = _scan_of(fresh, captures, job, options, progress)
    done = with_batch(job, scan, hashes, plan=number, how=how, simulated=options.simulated)
    return Added(job=done, frames=len(fresh), points=len(scan), double=tuple(double), how=how)


def frame_paths(paths: Sequence[Path]) -> list[Path]:
    """The frames named, and those in the folders named, in the order of their names.

    Raises:
        InputError: a path that is not there, or a folder without a frame.
    """
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        inside = (
            sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        )
        if not inside:
            raise InputError(f"{path}: no frame in this folder; known: {', '.join(SUFFIXES)}")
        files += inside
    return files


def _lines(files: Sequence[Path], frames_list: Path | None) -> list[Line]:
    """One line for each file: of the list that is given, of the one beside it, or of the number in its
    name.
    """
    lists: dict[Path, dict[str, Line]] = {}
    lines = []
    for file in files:
        path = frames_list or file.parent / LIST
        if frames_list is None and not path.is_file():
            number = _NUMBER.search(file.stem)
            lines.append(Line(file=file.name, index=int(number[1]) if number else None))
            continue
        if path not in lists:
            lists[path] = {line.file: line for line in read_list(path)}
        if file.name not in lists[path]:
            raise InputError(f"{path}: does not name {file.name}")
        lines.append(lists[path][file.name])
    return lines


def known_constants(captures: Captures, job: Job) -> Captures:
    """The captures as the cell's known latency and backlash have them; hand-eye and axis are in its
    frames.
    """
    known = job.settings.calibration
    errors = replace(
        ScanErrors.none(),
        latency_s=known.latency_ms * 1e-3,
        backlash_rad=float(np.deg2rad(known.backlash_deg)),
    )
    if not errors.constant:
        return captures
    return with_poses(captures, true_poses(captures, errors, fixed_stream("known_constants")))


def _scan_of(
    frames: Sequence[tuple[Path, Line]], captures: Captures, job: Job, options: AddOptions,
    progress: Callable[[float], None],
) -> Scan:  # fmt: skip
    """All frames in O; where a file's frame is not the scanner's, the scanner is put a metre before its
    points.
    """
    cloud, frame, depth, X_OS = [], [], [], captures.X_OS
    camera: Intrinsics | None = None if options.intrinsics is None else read_intrinsics(options.intrinsics)
    for k, (file, line) in enumerate(frames):
        own = file.parent / INTRINSICS
        mine = camera or (
            read_intrinsics(own) if own.is_file() else intrinsics_of(job.settings.scanner_model())
        )
        p_S = frame_points(file, unit=options.unit, intrinsics=mine)
        p_O = p_S @ X_OS[k, :3, :3].T + X_OS[k, :3, 3]
        if line.looks is not None and len(p_O):
            towards = line.looks / np.linalg.norm(line.looks)
            X_OS[k] = look_at(p_O.mean(axis=0) - towards, towards)
            p_S = (p_O - X_OS[k, :3, 3]) @ X_OS[k, :3, :3]
        cloud.append(p_O.astype(np.float32))
        frame.append(np.full(len(p_S), k, np.int32))
        depth.append(p_S[:, 2].astype(np.float32))
        progress((k + 1) / len(frames))
    points = np.concatenate(cloud)
    return Scan(
        points_O=points, frame=np.concatenate(frame), depth=np.concatenate(depth),
        pixel=np.concatenate([np.arange(len(d), dtype=np.int32) for d in depth]),
        captures=with_poses(captures, X_OS),
        seen=np.zeros(0, bool), rays=len(points),
    )  # fmt: skip
