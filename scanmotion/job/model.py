"""All frames of a job in one model: corrected, registered segment by segment, fused; and what is missing.

Guarantees: a segment whose registration cannot be trusted stays where its poses put it, and is named.
Assumes: the first batch is the global scan, onto which the others are brought.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.settings.cell import CalibrationSettings
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.job.store import Job
from scanmotion.sensing.corrections.calibration import corrected
from scanmotion.sensing.corrections.corrected_scan import moved
from scanmotion.sensing.corrections.registration import Registration, align, register
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.holes.find import HoleReport, holes_from_cloud
from scanmotion.sensing.simulator.captures import ScanErrors
from scanmotion.sensing.simulator.simulate import Scan

VOXEL = 0.002

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class JobSegment:
    """A batch in the model."""

    batch: int
    """Counted from 1."""
    registration: Registration | None
    """Onto the first; None for the first itself, or where it has too few points."""
    used: bool
    """Whether the registration moved it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Model:
    """What the frames of a job show together."""

    cloud: Cloud
    segments: tuple[JobSegment, ...]
    holes: HoleReport
    part: Part
    """The cloud as a measured scan, in O."""


def errors_of(constants: dict | None) -> ScanErrors | None:
    """Constant errors from the keys of the cell's section calibration; None for none."""
    if constants is None:
        return None
    c = CalibrationSettings.model_validate(constants)
    none = ScanErrors.none()
    return ScanErrors(
        range_noise=none.range_noise, frame_scale=none.frame_scale, pose_m=none.pose_m,
        pose_rad=none.pose_rad,
        hand_eye_m=_si(c.hand_eye_mm, 1e-3), hand_eye_rad=_si(c.hand_eye_deg, np.pi / 180),
        axis_m=_si(c.axis_mm, 1e-3), axis_rad=_si(c.axis_deg, np.pi / 180),
        backlash_rad=float(np.deg2rad(c.backlash_deg)), latency_s=c.latency_ms * 1e-3,
    )  # fmt: skip


def _si(values: tuple, unit: float) -> tuple:
    return tuple(float(v) * unit for v in values)


def model_of(
    job: Job, *, registered: bool = True, voxel: float = VOXEL, progress: Progress = lambda s, f: None
) -> Model:
    """Fuses all frames of a job.

    Args:
        job: with frames.
        registered: whether later batches are brought onto the first, and all onto one another at last.
        voxel: edge [m].
        progress: told the stage and the share done.

    Raises:
        InputError: the job has no points.
    """
    scans = job.scans()
    if not scans:
        raise InputError(f"{job.folder}: has no frames yet; `scanmotion job add {job.folder} FRAMES`")
    errors = errors_of(job.record.calibration)
    if errors is not None:
        scans = [corrected(s, errors) for s in scans]
    numbers = [i + 1 for i, b in enumerate(job.record.batches) if b.points]
    progress("register", 0.0)
    scans, segments = _registered(scans, numbers, voxel) if registered else (scans, _left(numbers))
    progress("fuse", 0.5)
    cloud = fuse(scans, voxel=voxel)
    progress("holes", 0.8)
    holes = holes_from_cloud(cloud.points, view_directions=cloud.view_directions)
    part = Part(
        name=job.record.name, vertices=cloud.points, triangles=np.zeros((0, 3), int), normals=cloud.normals,
        closed=False,
    )  # fmt: skip
    return Model(cloud=cloud, segments=segments, holes=holes, part=part)


def _left(numbers: list[int]) -> tuple[JobSegment, ...]:
    return tuple(JobSegment(batch=n, registration=None, used=False) for n in numbers)


def _registered(
    scans: list[Scan], numbers: list[int], voxel: float
) -> tuple[list[Scan], tuple[JobSegment, ...]]:
    """Each later scan onto the first; then all that could be trusted onto one another at once."""
    clouds = [fuse([s], voxel=voxel) for s in scans]
    segments = [JobSegment(batch=numbers[0], registration=None, used=False)]
    poses, trusted = [np.eye(4)], [0]
    for k in range(1, len(scans)):
        try:
            found = register(clouds[k], clouds[0])
        except InputError:
            found = None
        used = found is not None and found.trusted
        segments.append(JobSegment(batch=numbers[k], registration=found, used=used))
        poses.append(found.X if found is not None and used else np.eye(4))
        trusted += [k] if used else []
    if len(trusted) > 2:
        start = np.stack([poses[k] for k in trusted])
        for k, found in zip(trusted[1:], align([clouds[k] for k in trusted], start=start)[1:], strict=True):
            if found.trusted:
                segments[k] = JobSegment(batch=numbers[k], registration=found, used=True)
                poses[k] = found.X
    still = np.eye(4)
    return [s if np.array_equal(X, still) else moved(s, X) for s, X in zip(scans, poses, strict=True)], tuple(
        segments
    )
