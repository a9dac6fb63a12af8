"""What a controller makes of moves: joints over time, for rounded PTP, LIN and timed splines.

Assumptions, none confirmed by a controller: all axes of a PTP start and end together; a rounded corner is a
parabola that begins at the stated share of half of the shorter neighbour; speeds are percentages of the
machine data and 100 percent of the acceleration is the plan's limit; LIN has a trapezoidal speed profile; a
timed spline is a cubic spline at rest at both ends, stretched where a joint would exceed its percentage.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.motion import UrdfArm, exponentials

TICK_S = 0.01
"""Time between two samples of what is driven."""
SPLINE_MORE = 1.25
"""A cubic spline through samples of a plan exceeds the plan's accelerations; up to this it is not slowed."""
_MOST_S = 1e5
_LEAST_SPEED = 1e-6
_NODE_M = 0.002
"""Between two places this far apart on a line, joints are interpolated: an error under 1e-6 m."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Driven:
    """Joints over time from a standstill to a standstill."""

    t: np.ndarray
    """From 0, TICK_S apart but for the last, shape (n,) [s]."""
    q: np.ndarray
    """Shape (n, 7) [deg]."""
    at: np.ndarray
    """When each of the points is passed, shape (points,) [s]."""
    gain: np.ndarray | None = None
    """Greatest acceleration of each joint, shape (7,) [deg/s2], where it is known exactly."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Drive:
    """What the controller's machine data say."""

    arm: UrdfArm
    X_FS: np.ndarray
    speed: np.ndarray
    """At 100 percent, shape (7,) [deg/s]."""
    acceleration: np.ndarray
    """At 100 percent, shape (7,) [deg/s2]."""

    def pose(self, q: np.ndarray) -> np.ndarray:
        """X_BS of joints (7,) [deg], shape (4, 4) [m]."""
        X = np.eye(4)
        for screw, angle in zip(self.arm.screws, np.deg2rad(q[:6]), strict=True):
            X = X @ exponentials(screw, np.array([angle]))[0]
        return X @ self.arm.X_BF @ self.X_FS

    def joints(self, X: np.ndarray, near: np.ndarray) -> np.ndarray:
        """The arm's joints for a pose of the scanner, from joints near them, shape (6,) [deg].

        Raises:
            PlanFileError: Newton's method finds none.
        """
        q = near[:6].copy()
        for _ in range(30):
            here, J = self._jacobian(q)
            turn = Rotation.from_matrix(X[:3, :3] @ here[:3, :3].T).as_rotvec()
            miss = np.concatenate([turn, X[:3, 3] - here[:3, 3]])
            if np.abs(miss).max() < 1e-9:
                return q
            step, *_ = np.linalg.lstsq(J, miss, rcond=1e-9)
            q = q + np.rad2deg(np.clip(step, -0.2, 0.2))
        raise PlanFileError("a point of LIN is out of the arm's reach from where it stands")

    def _jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        X, columns = np.eye(4), []
        for screw, angle in zip(self.arm.screws, np.deg2rad(q), strict=True):
            w, v = X[:3, :3] @ screw[:3], X[:3, :3] @ screw[3:]
            columns.append((w, v + np.cross(X[:3, 3], w)))
            X = X @ exponentials(screw, np.array([angle]))[0]
        here = X @ self.arm.X_BF @ self.X_FS
        J = np.array([[*w, *(v + np.cross(w, here[:3, 3]))] for w, v in columns]).T
        return here, J


def point_to_point(points: np.ndarray, speed: np.ndarray, shares: np.ndarray, drive: Drive) -> Driven:
    """PTP through points whose inner corners are rounded.

    Args:
        points: where the arm stands, and where it goes, shape (n + 1, 7) [deg].
        speed: of each move, shape (n, 7) [percent].
        shares: $APO.CPTP of each inner corner, shape (n - 1,) [percent].
        drive: machine data.
    """
    path, cap, knots = _rounded(points, speed, shares, drive)
    du = np.abs(np.diff(path, axis=0) / drive.speed).max(axis=1)
    if du.max(initial=0.0) <= 0:
        return Driven(t=np.zeros(1), q=points[:1], at=np.zeros(len(points)))
    keep = np.append(True, du > 1e-12)
    index = np.cumsum(keep) - 1
    path, cap, du = path[keep], cap[keep], du[du > 1e-12]
    t = _times(path, du, cap, drive.acceleration)
    grid = np.append(np.arange(0.0, t[-1], TICK_S), t[-1])
    q = np.column_stack([np.interp(grid, t, path[:, j]) for j in range(7)])
    return Driven(t=grid, q=q, at=t[index[knots]])


def _rounded(
    points: np.ndarray, speed: np.ndarray, shares: np.ndarray, drive: Drive
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The path densely, the greatest speed at each of its points, and where the given points lie in it."""
    n = len(points) - 1
    path, cap, knots = [points[0]], [speed[0] * drive.speed / 100], [0]
    for i in range(n):
        a, b = points[i], points[i + 1]
        now = speed[i] * drive.speed / 100
        enter = 0.0 if i == 0 else _share(points, i, shares)
        leave = 1.0 if i == n - 1 else 1 - _share(points, i + 1, shares, before=True)
        long = float(np.abs((b - a) / drive.speed).max()) * (leave - enter)
        for s in np.linspace(enter, leave, int(np.clip(long / 0.01, 4, 2000)) + 1)[1:]:
            path.append(a + s * (b - a))
            cap.append(now)
        if i == n - 1:
            knots.append(len(path) - 1)
            continue
        after = speed[i + 1] * drive.speed / 100
        first, last = path[-1], b + _share(points, i + 1, shares) * (points[i + 2] - b)
        for s in np.linspace(0, 1, 9)[1:]:
            path.append((1 - s) ** 2 * first + 2 * s * (1 - s) * b + s**2 * last)
            cap.append(np.minimum(now, after))
            if s == 0.5:
                knots.append(len(path) - 1)
    return np.array(path), np.array(cap), np.array(knots)


def _share(points: np.ndarray, i: int, shares: np.ndarray, *, before: bool = False) -> float:
    """Which part of the move before or after the inner point i its rounding takes."""
    lengths = np.abs(points[i] - points[i - 1]).max(), np.abs(points[i + 1] - points[i]).max()
    own = lengths[0] if before else lengths[1]
    return float(shares[i - 1] / 100 * 0.5 * min(lengths) / own) if own > 0 else 0.0


def _times(path: np.ndarray, du: np.ndarray, cap: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Times at which the points of a path are passed as fast as speeds and accelerations allow, (n,) [s]."""
    slope = np.diff(path, axis=0) / du[:, None]
    at = np.vstack([slope[:1], (slope[1:] + slope[:-1]) / 2, slope[-1:]])
    bend = np.zeros_like(path)
    bend[1:-1] = np.diff(slope, axis=0) / ((du[1:] + du[:-1]) / 2)[:, None]
    steep, curved = np.maximum(np.abs(at), 1e-9), np.abs(bend)
    most = np.minimum((cap / steep).min(axis=1) ** 2, (gain / np.maximum(curved, 1e-9)).min(axis=1))
    most[0] = most[-1] = 0.0
    b = most.copy()
    for order in (range(len(du)), range(len(du) - 1, -1, -1)):
        forward = order.step > 0
        for k in order:
            here, there = (k, k + 1) if forward else (k + 1, k)
            room = ((gain - curved[here] * b[here]) / steep[here]).min()
            b[there] = min(b[there], b[here] + 2 * du[k] * max(room, 0.0))
    s = np.sqrt(b)
    return np.append(0.0, np.cumsum(2 * du / np.maximum(s[1:] + s[:-1], _LEAST_SPEED)))


def linear(
    start: np.ndarray, targets: list[tuple[np.ndarray, float]], speed: float, gain: float, drive: Drive
) -> Driven:
    """LIN of the scanner's frame through poses; corners are taken as the straight line's own.

    Args:
        start: joints, shape (7,) [deg].
        targets: poses X_BS and the table's angle [deg].
        speed: of the scanner [m/s].
        gain: its acceleration [m/s2].
        drive: machine data.
    """
    X = [drive.pose(start), *(pose for pose, _ in targets)]
    e1 = np.array([start[6], *(angle for _, angle in targets)])
    long = np.array([np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairwise(X)])
    table = np.abs(np.diff(e1)) / drive.speed[6] * speed
    s = np.append(0.0, np.cumsum(np.maximum(long, table)))
    if s[-1] < 1e-9:
        return Driven(t=np.zeros(1), q=start[None], at=np.zeros(len(X)))
    if speed <= 0 or gain <= 0 or s[-1] / speed > _MOST_S:
        raise PlanFileError(f"LIN at {speed:g} m/s and {gain:g} m/s2 does not move")
    ramp = min(speed / gain, np.sqrt(s[-1] / gain))
    top = gain * ramp
    total = s[-1] / top + ramp
    grid = np.append(np.arange(0.0, total, TICK_S), total)

    def way(t: np.ndarray) -> np.ndarray:
        late = np.clip(total - t, 0, ramp)
        return np.where(
            t < ramp,
            gain * t**2 / 2,
            np.where(t > total - ramp, s[-1] - gain * late**2 / 2, top * (t - ramp / 2)),
        )

    nodes = np.unique(np.concatenate([s, np.arange(0.0, s[-1], _NODE_M)]))
    q, here = [], start
    for u in nodes:
        i = int(np.clip(np.searchsorted(s, u, side="right") - 1, 0, len(s) - 2))
        share = (u - s[i]) / (s[i + 1] - s[i]) if s[i + 1] > s[i] else 1.0
        pose = np.eye(4)
        turn = Rotation.from_matrix(X[i + 1][:3, :3] @ X[i][:3, :3].T).as_rotvec()
        pose[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix() @ X[i][:3, :3]
        pose[:3, 3] = (1 - share) * X[i][:3, 3] + share * X[i + 1][:3, 3]
        here = np.append(drive.joints(pose, here), e1[i] + share * (e1[i + 1] - e1[i]))
        q.append(here)
    far = np.clip(way(grid), 0, s[-1])
    rows = np.array(q)
    found = np.column_stack([np.interp(far, nodes, rows[:, j]) for j in range(7)])
    return Driven(t=grid, q=found, at=np.interp(s, far, grid))


def timed_spline(points: np.ndarray, times: np.ndarray, speed: np.ndarray, drive: Drive) -> Driven:
    """A cubic spline at rest at both ends through points at given times.

    Args:
        points: shape (n, 7) [deg].
        times: from 0, shape (n,) [s].
        speed: shape (7,) [percent].
        drive: machine data.

    Raises:
        PlanFileError: the times do not increase.
    """
    if not (np.diff(times) > 0).all() or times[-1] > _MOST_S:
        raise PlanFileError("the times of a spline do not increase")
    curve = CubicSpline(times, points, bc_type="clamped")
    dense = np.linspace(0, times[-1], max(int(times[-1] / TICK_S) * 2, 4))
    slow = max(1.0, float((np.abs(curve(dense, 1)) / (drive.speed * speed / 100 * 1.001)).max()))
    bend = np.abs(curve(times, 2)) / (drive.acceleration * SPLINE_MORE)
    slow = max(slow, float(np.sqrt(bend.max())))
    total = times[-1] * slow
    grid = np.append(np.arange(0.0, total, TICK_S), total)
    gain = np.abs(curve(times, 2)).max(axis=0) / slow**2
    return Driven(t=grid, q=curve(grid / slow), at=times * slow, gain=gain)
