"""Calibration from the scan itself: hand-eye offset, turntable axis and backlash that make the frames agree.

A constant error inside a turn displaces every point towards or away from the frame that saw it: a radial
dilation that no registration of whole turns can mend. But frames that see one spot from different sides then
disagree about it, and the disagreement is linear in the errors. Each spot's own height is unknown and drops
out by taking differences from the spot's mean; what the scan does not determine stays zero and is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.sensing.fusion.fuse import surface_groups
from scanmotion.sensing.simulator.captures import ScanErrors, inverse, true_poses
from scanmotion.sensing.simulator.simulate import Scan

PARAMETERS = (
    "hand_eye_x", "hand_eye_y", "hand_eye_z", "hand_eye_rx", "hand_eye_ry", "hand_eye_rz",
    "axis_x", "axis_y", "axis_rx", "axis_ry", "backlash",
)  # fmt: skip
"""Order of the unknowns; lengths in m, angles in rad."""
_PRIOR = np.array([1e-3] * 3 + [np.deg2rad(0.2)] * 3 + [1e-3] * 2 + [np.deg2rad(0.2)] * 2 + [np.deg2rad(0.2)])
_STEP = np.array([1e-5] * 3 + [1e-5] * 3 + [1e-5] * 2 + [1e-5] * 2 + [1e-5])


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """Constant errors that make the frames agree best."""

    errors: ScanErrors
    """Only the constant errors are set; noise is zero."""
    sd: np.ndarray
    """Standard deviation of each of PARAMETERS, shape (11,) [m, rad]."""
    known: np.ndarray
    """Which of PARAMETERS the scan determines better than the prior does, shape (11,) bool."""
    rms_before: float
    """Disagreement of the frames along the normal [m]."""
    rms_after: float
    statement: str


def calibrate(
    scans: Sequence[Scan], *, voxel: float = 0.004, turns: int = 4, points: int = 400_000
) -> Calibration:
    """Estimates hand-eye offset, table axis and backlash from overlapping frames of one or more scans.

    Args:
        scans: taken with one calibration.
        voxel: size of a spot [m].
        turns: Gauss-Newton iterations; spots are formed anew in each.
        points: most raw points used.

    Raises:
        InputError: no spot was seen by two frames.
    """
    total = sum(len(s) for s in scans)
    scans = [thinned(s, max(1, -(-total // points))) for s in scans]
    theta, before, after = np.zeros(len(PARAMETERS)), 0.0, 0.0
    covariance, prior = np.eye(len(PARAMETERS)), np.diag(1 / _PRIOR**2)
    for turn in range(turns):
        J, r, spot, frame = _equations(scans, errors_from(theta), theta, voxel)
        w = _robust(r)
        after = float(np.sqrt((w * r * r).sum() / w.sum()))
        before = after if turn == 0 else before
        J, r = _without_spot_means(J, r, w, spot)
        information = J.T @ (w[:, None] * J) / after**2
        inverse_information = np.linalg.inv(information + prior)
        theta = theta - inverse_information @ (J.T @ (w * r) / after**2 + prior @ theta)
        covariance = _covariance(J, w * r / after**2, frame, inverse_information, prior)
    sd = np.sqrt(np.diag(covariance))
    known = sd < 0.3 * _PRIOR
    unknown = [name for name, k in zip(PARAMETERS, known, strict=True) if not k]
    return Calibration(
        errors=errors_from(theta), sd=sd, known=known, rms_before=before, rms_after=after,
        statement=f"frames disagree by {before * 1e3:.3f} mm before and {after * 1e3:.3f} mm after; "
        + (f"not determined by this scan: {', '.join(unknown)}" if unknown else "all errors are determined"),
    )  # fmt: skip


def errors_from(theta: np.ndarray) -> ScanErrors:
    """Constant errors from the unknowns in the order of PARAMETERS."""
    t = [float(v) for v in theta]
    return replace(
        ScanErrors.none(), hand_eye_m=(t[0], t[1], t[2]), hand_eye_rad=(t[3], t[4], t[5]),
        axis_m=(t[6], t[7]), axis_rad=(t[8], t[9]), backlash_rad=t[10],
    )  # fmt: skip


def thinned(scan: Scan, every: int) -> Scan:
    """Every so-manieth point of the scan."""
    s = slice(None, None, every)
    return replace(
        scan, points_O=scan.points_O[s], frame=scan.frame[s], depth=scan.depth[s], pixel=scan.pixel[s]
    )


def corrected(scan: Scan, errors: ScanErrors) -> Scan:
    """The scan expressed with the poses that the constant `errors` imply.

    Args:
        scan: points at nominal poses.
        errors: constant errors, e.g. of `calibrate`; their noise must be zero.
    """
    X = _poses(scan, errors)
    change = X @ inverse(scan.captures.X_OS)
    p = np.einsum("nij,nj->ni", change[scan.frame, :3, :3], scan.points_O.astype(float))
    p += change[scan.frame, :3, 3]
    X_WO = scan.captures.X_WS @ inverse(scan.captures.X_OS)
    return replace(scan, points_O=p.astype(np.float32), captures=replace(scan.captures, X_WS=X_WO @ X))


def _poses(scan: Scan, errors: ScanErrors) -> np.ndarray:
    if errors.pose_m or errors.pose_rad:
        raise InputError("only constant errors can be corrected; pose noise is set")
    return true_poses(scan.captures, errors, np.random.default_rng(0))


def _equations(
    scans: Sequence[Scan], errors: ScanErrors, theta: np.ndarray, voxel: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Change of each point's height over its spot with the unknowns (k, 11); height, spot and frame (k,)."""
    now = [corrected(s, errors) for s in scans]
    groups = surface_groups(now, voxel=voxel)
    points = np.concatenate([s.points_O for s in now]).astype(float)[groups.point]
    normal = groups.normals[groups.spot]
    first = np.cumsum([0, *(len(s) for s in scans)])
    J = np.empty((len(points), len(PARAMETERS)))
    for i in range(len(PARAMETERS)):
        moved = theta.copy()
        moved[i] += _STEP[i]
        step = errors_from(moved)
        for k, scan in enumerate(scans):
            mine = (groups.point >= first[k]) & (groups.point < first[k + 1])
            change = _poses(scan, step) @ inverse(_poses(scan, errors))
            frame = scan.frame[groups.point[mine] - first[k]]
            p = points[mine]
            shift = np.einsum("nij,nj->ni", change[frame, :3, :3] - np.eye(3), p) + change[frame, :3, 3]
            J[mine, i] = np.einsum("ij,ij->i", shift, normal[mine]) / _STEP[i]
    return J, groups.height, groups.spot, groups.frame


def _robust(r: np.ndarray) -> np.ndarray:
    scale = max(1.4826 * float(np.median(np.abs(r - np.median(r)))), 1e-7)
    u = np.clip(np.abs(r) / (4.685 * scale), 0.0, 1.0)
    return (1 - u * u) ** 2


def _covariance(
    J: np.ndarray, pull: np.ndarray, frame: np.ndarray, bread: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """Covariance of the unknowns where the points of one frame err together: each frame counts once.

    Liang and Zeger 1986 (doi 10.1093/biomet/73.1.13). As many frames as unknowns are fitted whatever their
    errors, which then cannot be told: nothing but the prior is known.
    """
    by_frame = np.stack([np.bincount(frame, weights=J[:, i] * pull) for i in range(J.shape[1])], axis=1)
    frames, unknowns = len(np.unique(frame)), J.shape[1]
    if frames <= unknowns:
        return np.linalg.inv(prior)
    return bread @ (by_frame.T @ by_frame * frames / (frames - unknowns) + prior) @ bread


def _without_spot_means(
    J: np.ndarray, r: np.ndarray, w: np.ndarray, spot: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Takes out each spot's unknown height: the weighted mean over the spot."""
    total = np.maximum(np.bincount(spot, weights=w), 1e-30)
    out = np.empty_like(J)
    for i in range(J.shape[1]):
        out[:, i] = J[:, i] - (np.bincount(spot, weights=w * J[:, i]) / total)[spot]
    return out, r - (np.bincount(spot, weights=w * r) / total)[spot]
