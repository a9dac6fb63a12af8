"""What a scan can correct by itself: calibration from the first scan, then each later scan onto the cloud.

Guarantees: the scans that went before are never changed, and `Corrections` says of each later scan whether it
was moved. Assumes that the errors are constant over the plan, and that a later scan overlaps the cloud.
"""

from dataclasses import dataclass, replace

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.sensing.assess import Accuracy, accuracy
from scanmotion.sensing.corrections.calibration import Calibration, calibrate, corrected
from scanmotion.sensing.corrections.registration import Registration, register
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.simulator.captures import inverse
from scanmotion.sensing.simulator.simulate import Scan

_POINTS = 200_000
"""Raw points that calibration looks at: twice as many cost twice the time and change 0.01 mm."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Corrections:
    """What was estimated, what it changed, and how far later scans could be trusted to fit."""

    calibration: Calibration | None = None
    """None where the first scan does not overlap itself."""
    applied: bool = False
    """Whether scans are corrected: only where the first one determines all unknowns.

    Where it leaves some free (one turn, or two alike), the others drift with them: a clean scan of two turns
    was made ten times worse.
    """
    before: Accuracy | None = None
    """Of the global step's cloud as it was measured."""
    after: Accuracy | None = None
    """The same as it is fused."""
    registrations: tuple[tuple[int, Registration], ...] = ()
    """Of each later scan onto the cloud so far, with its index among the segments."""


def corrected_scan(
    scan: Scan, cloud: Cloud | None, known: Corrections, *, part: Part, voxel: float, index: int,
    latency: bool = False,
) -> tuple[Scan, Corrections]:  # fmt: skip
    """The scan as calibration and registration have it, and what is known from then on.

    Args:
        scan: at its nominal poses.
        cloud: fused from the scans before; None for the first, from which calibration is estimated.
        known: from the scans before.
        part: the true surface, from which distances are told.
        voxel: edge of the fused clouds' voxels [m].
        index: of the scan's segment.
        latency: estimate it too, where the scan is calibrated.
    """
    if len(scan) == 0:
        return scan, known
    if cloud is None:
        return _calibrated(scan, part, voxel, latency)
    if known.calibration is not None and known.applied:
        scan = corrected(scan, known.calibration.errors)
    try:
        found = register(fuse([scan], voxel=voxel), cloud)
    except InputError:
        return scan, known
    known = replace(known, registrations=(*known.registrations, (index, found)))
    return (moved(scan, found.X) if found.trusted else scan), known


def _calibrated(scan: Scan, part: Part, voxel: float, latency: bool) -> tuple[Scan, Corrections]:
    try:
        found = calibrate([scan], points=_POINTS, latency=latency)
    except InputError:
        return scan, Corrections()
    applied = found.determined
    better = corrected(scan, found.errors) if applied else scan
    before = accuracy(fuse([scan], voxel=voxel).points, part)
    after = accuracy(fuse([better], voxel=voxel).points, part) if applied else before
    return better, Corrections(calibration=found, applied=applied, before=before, after=after)


def moved(scan: Scan, X: np.ndarray) -> Scan:
    """The scan with its points and its scanner poses moved in O by X, shape (4, 4)."""
    X_OS = scan.captures.X_OS
    X_WO = scan.captures.X_WS @ inverse(X_OS)
    points = scan.points_O.astype(float) @ X[:3, :3].T + X[:3, 3]
    return replace(
        scan, points_O=points.astype(np.float32), captures=replace(scan.captures, X_WS=X_WO @ X @ X_OS)
    )
