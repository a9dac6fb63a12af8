"""Calibration from the scan itself: hand-eye, turntable axis, backlash and latency that make the frames
agree.

A constant error inside a turn displaces every point towards or away from the frame that saw it: a radial
dilation that no registration of whole turns can mend. But frames that see one spot from different sides then
disagree about it, and the disagreement is linear in the errors. Each spot's own height is unknown and drops
out by taking differences from the spot's mean; what the scan does not determine stays zero and is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.support.streams import fixed_stream
from scanmotion.geometry.column_products import column_products
from scanmotion.sensing.fusion.fuse import surface_groups
from scanmotion.sensing.simulator.captures import Captures, ScanErrors, inverse, true_poses
from scanmotion.sensing.simulator.simulate import Scan

PARAMETERS = (
    "hand_eye_x", "hand_eye_y", "hand_eye_z", "hand_eye_rx", "hand_eye_ry", "hand_eye_rz",
    "axis_x", "axis_y", "axis_rx", "axis_ry", "backlash", "latency",
)  # fmt: skip
"""Order of the unknowns; lengths in m, angles in rad, times in s."""
_LATENCY = len(PARAMETERS) - 1
_PRIOR = np.array(
    [1e-3] * 3 + [np.deg2rad(0.2)] * 3 + [1e-3] * 2 + [np.deg2rad(0.2)] * 2 + [np.deg2rad(0.2)] + [5e-3]
)
_STEP = np.array([1e-5] * 11 + [1e-5])


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """Constant errors that make the frames agree best."""

    errors: ScanErrors
    """Only the constant errors are set; noise is zero."""
    sd: np.ndarray
    """Standard deviation of each of PARAMETERS, shape (12,) [m, rad, s]; zero for one that was not asked
    for."""
    known: np.ndarray
    """Which of PARAMETERS the scan determines better than the prior does, shape (12,) bool."""
    rms_before: float
    """Disagreement of the frames along the normal [m]."""
    rms_after: float
    statement: str
    asked: np.ndarray = field(default_factory=lambda: np.ones(len(PARAMETERS), bool))
    """Which of PARAMETERS were estimated, shape (12,) bool; the others are zero."""

    @property
    def determined(self) -> bool:
        """Whether the scan determines all that was estimated."""
        return bool(self.known[self.asked].all())


def calibrate(
    scans: Sequence[Scan],
    *,
    voxel: float = 0.004,
    turns: int = 4,
    points: int = 400_000,
    latency: bool = False,
) -> Calibration:
    """Estimates hand-eye offset, table axis, backlash and latency from overlapping frames of one or more
    scans.

    Latency and backlash show alike in a table that turns at one speed: the object is behind, or ahead, by an
    angle that changes sign with the sense. They are told apart by frames at other speeds (ramps, rests,
    sweeps). Where the frames do not tell the latency, it stays zero, the rest is estimated without it, and
    the statement says so.

    Args:
        scans: taken with one calibration.
        voxel: size of a spot [m].
        turns: Gauss-Newton iterations; spots are formed anew in each.
        points: most raw points used.
        latency: estimate it too.

    Raises:
        InputError: no spot was seen by two frames.
    """
    total = sum(len(s) for s in scans)
    scans = [thinned_frames(s, max(1, -(-total // points))) for s in scans]
    asked = np.ones(len(PARAMETERS), bool)
    moves = any(
        s.captures.rates is not None and np.abs(s.captures.rates).max(initial=0) > 1e-6 for s in scans
    )
    asked[_LATENCY] = latency and moves
    found = _estimated(scans, asked, voxel, turns)
    if asked[_LATENCY] and not found.known[_LATENCY]:
        asked = asked.copy()
        asked[_LATENCY] = False
        found = _estimated(scans, asked, voxel, turns)
    if latency and not asked[_LATENCY]:
        found = replace(found, statement=f"{found.statement}; the latency is not determined and stays zero")
    return found


def _estimated(scans: Sequence[Scan], asked: np.ndarray, voxel: float, turns: int) -> Calibration:
    """Gauss-Newton over the unknowns that are asked for."""
    use = np.flatnonzero(asked)
    theta, before, after = np.zeros(len(PARAMETERS)), 0.0, 0.0
    covariance, prior, arcs = np.eye(len(use)), np.diag(1 / _PRIOR[use] ** 2), np.zeros(len(use))
    for turn in range(turns):
        J, r, spot, frame = _equations(scans, errors_from(theta), theta, use, voxel)
        w = _robust(r)
        after = float(np.sqrt((w * r * r).sum() / w.sum()))
        before = after if turn == 0 else before
        J, r = _without_spot_means(J, r, w, spot)
        information = column_products(J, w[:, None] * J) / after**2
        inverse_information = np.linalg.inv(information + prior)
        theta[use] -= inverse_information @ (column_products(J, w * r) / after**2 + prior @ theta[use])
        covariance = _covariance(J, w * r / after**2, frame, inverse_information, prior)
        arcs = _by_arcs(J, w / after**2, r, frame, prior)
    sd = np.zeros(len(PARAMETERS))
    sd[use] = np.sqrt(np.maximum(np.diag(covariance), arcs))
    known = asked & (sd < 0.3 * _PRIOR)
    unknown = [PARAMETERS[i] for i in use if not known[i]]
    return Calibration(
        errors=errors_from(theta), sd=sd, known=known, asked=asked, rms_before=before, rms_after=after,
        statement=f"frames disagree by {before * 1e3:.3f} mm before and {after * 1e3:.3f} mm after; "
        + (f"not determined by this scan: {', '.join(unknown)}" if unknown else "all errors are determined"),
    )  # fmt: skip


def errors_from(theta: np.ndarray) -> ScanErrors:
    """Constant errors from the unknowns in the order of PARAMETERS."""
    t = [float(v) for v in theta]
    return replace(
        ScanErrors.none(), hand_eye_m=(t[0], t[1], t[2]), hand_eye_rad=(t[3], t[4], t[5]),
        axis_m=(t[6], t[7]), axis_rad=(t[8], t[9]), backlash_rad=t[10], latency_s=t[11],
    )  # fmt: skip


def thinned_frames(scan: Scan, every: int) -> Scan:
    """Every n-th point of the scan, `every` being n."""
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
    return replace(scan, points_O=p.astype(np.float32), captures=with_poses(scan.captures, X))


def with_poses(captures: Captures, X_OS: np.ndarray) -> Captures:
    """The captures with other poses of the scanner in the object frame, shape (n, 4, 4)."""
    return replace(captures, X_WS=captures.X_WS @ inverse(captures.X_OS) @ X_OS)


def _poses(scan: Scan, errors: ScanErrors) -> np.ndarray:
    if errors.pose_m or errors.pose_rad or errors.jitter_s:
        raise InputError("only constant errors can be corrected; pose noise or jitter is set")
    return true_poses(scan.captures, errors, fixed_stream("constant_errors"))


def _equations(
    scans: Sequence[Scan], errors: ScanErrors, theta: np.ndarray, use: np.ndarray, voxel: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Change of each point's height over its spot with the unknowns in `use` (k, u); height, spot and frame
    (k,).
    """
    now = [corrected(s, errors) for s in scans]
    groups = surface_groups(now, voxel=voxel)
    points = np.concatenate([s.points_O for s in now]).astype(float)[groups.point]
    normal = groups.normals[groups.spot]
    first = np.cumsum([0, *(len(s) for s in scans)])
    J = np.empty((len(points), len(use)))
    for column, i in enumerate(use):
        moved = theta.copy()
        moved[i] += _STEP[i]
        step = errors_from(moved)
        for k, scan in enumerate(scans):
            mine = (groups.point >= first[k]) & (groups.point < first[k + 1])
            change = _poses(scan, step) @ inverse(_poses(scan, errors))
            frame = scan.frame[groups.point[mine] - first[k]]
            p = points[mine]
            shift = np.einsum("nij,nj->ni", change[frame, :3, :3] - np.eye(3), p) + change[frame, :3, 3]
            J[mine, column] = np.einsum("ij,ij->i", shift, normal[mine]) / _STEP[i]
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
    return bread @ (column_products(by_frame, by_frame) * frames / (frames - unknowns) + prior) @ bread


def _by_arcs(J: np.ndarray, w: np.ndarray, r: np.ndarray, frame: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Variance of each unknown by leaving out arcs of neighbouring frames in turn, shape (u,).

    Neighbouring frames see the same surface at like angles and share what the fit of a spot gets wrong: they
    err together, which frames taken one by one do not show (Kuensch 1989, doi 10.1214/aos/1176347265).
    """
    frames = np.unique(frame)
    count = min(max(len(frames) // 8, 2), 24)
    arc = (np.searchsorted(frames, frame) * count) // max(len(frames), 1)
    steps = np.zeros((count, J.shape[1]))
    total = column_products(J, w[:, None] * J) + prior
    for k in range(count):
        mine = arc == k
        j = J[mine]
        others = total - column_products(j, w[mine, None] * j)
        steps[k] = np.linalg.solve(others, column_products(j, (w * r)[mine]))
    return (count - 1) / count * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0)


def _without_spot_means(
    J: np.ndarray, r: np.ndarray, w: np.ndarray, spot: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Takes out each spot's unknown height: the weighted mean over the spot."""
    total = np.maximum(np.bincount(spot, weights=w), 1e-30)
    out = np.empty_like(J)
    for i in range(J.shape[1]):
        out[:, i] = J[:, i] - (np.bincount(spot, weights=w * J[:, i]) / total)[spot]
    return out, r - (np.bincount(spot, weights=w * r) / total)[spot]


def prior_information() -> np.ndarray:
    """What is believed of the unknowns before any frame, shape (12, 12) [1/m2, 1/rad2, 1/s2]."""
    return np.diag(1 / _PRIOR**2)


def slopes(scans: Sequence[Scan], *, voxel: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """How the points' heights over their spots change with all unknowns, about no error.

    Returns:
        slopes, shape (k, 12); spot and frame of each, shape (k,); robust standard deviation of the heights
        [m].

    Raises:
        InputError: no spot was seen by two frames.
    """
    none = np.zeros(len(PARAMETERS))
    J, r, spot, frame = _equations(scans, errors_from(none), none, np.arange(len(PARAMETERS)), voxel)
    return J, spot, frame, max(1.4826 * float(np.median(np.abs(r - np.median(r)))), 1e-7)
