"""What a scan can mend by itself: calibration from the global step, then each later scan onto the cloud."""

from dataclasses import dataclass, replace

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.sensing.assess import Accuracy, accuracy
from scanmotion.sensing.calibration import Calibration, calibrate, corrected
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.registration import Registration, register
from scanmotion.sensing.simulator.captures import inverse
from scanmotion.sensing.simulator.simulate import Scan

_POINTS = 200_000
"""Raw points that calibration looks at: twice as many cost twice the time and change 0.01 mm."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Mending:
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
    """Of each later scan onto the cloud so far, with its index among the rounds."""


class Mender:
    """Corrects the scans of a trip one after the other."""

    def __init__(self, part: Part, *, voxel: float, latency: bool = False) -> None:
        self._part, self._voxel, self._latency = part, voxel, latency
        self.mending = Mending()

    def mended(self, scan: Scan, cloud: Cloud | None, *, index: int) -> Scan:
        """The scan as calibration and registration have it.

        Args:
            scan: at its nominal poses.
            cloud: fused from the scans before; None for the first, from which calibration is estimated.
            index: of the scan's round.
        """
        if len(scan) == 0:
            return scan
        if cloud is None:
            return self._calibrated(scan)
        if self.mending.calibration is not None and self.mending.applied:
            scan = corrected(scan, self.mending.calibration.errors)
        try:
            found = register(fuse([scan], voxel=self._voxel), cloud)
        except InputError:
            return scan
        pairs = (*self.mending.registrations, (index, found))
        self.mending = replace(self.mending, registrations=pairs)
        return moved(scan, found.X) if found.trusted else scan

    def _calibrated(self, scan: Scan) -> Scan:
        try:
            found = calibrate([scan], points=_POINTS, latency=self._latency)
        except InputError:
            return scan
        applied = found.determined
        better = corrected(scan, found.errors) if applied else scan
        before = accuracy(fuse([scan], voxel=self._voxel).points, self._part)
        after = accuracy(fuse([better], voxel=self._voxel).points, self._part) if applied else before
        self.mending = Mending(calibration=found, applied=applied, before=before, after=after)
        return better


def moved(scan: Scan, X: np.ndarray) -> Scan:
    """The scan with its points and its scanner poses moved in O by X, shape (4, 4)."""
    X_OS = scan.captures.X_OS
    X_WO = scan.captures.X_WS @ inverse(X_OS)
    points = scan.points_O.astype(float) @ X[:3, :3].T + X[:3, 3]
    return replace(
        scan, points_O=points.astype(np.float32), captures=replace(scan.captures, X_WS=X_WO @ X @ X_OS)
    )
