"""Where and when frames are taken, and what arm, table and scanner get wrong: the inputs of the scan twin."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import InputError
from scanmotion.core.trajectory import Trajectory
from scanmotion.geometry.se3 import displacements as motion
from scanmotion.geometry.se3 import inverse_poses as inverse
from scanmotion.geometry.se3 import turns_about_z as turned


@dataclass(frozen=True, eq=False, kw_only=True)
class Captures:
    """The nominal poses of the frames: what the controller reports when each is taken."""

    t: np.ndarray
    """Times, shape (n,) [s]."""
    X_WS: np.ndarray
    """Poses of the scanner in the world, shape (n, 4, 4)."""
    table_angle: np.ndarray
    """Turntable joint E1, shape (n,) [rad]."""
    X_WT: np.ndarray
    """Pose of the turntable at angle zero, shape (4, 4)."""
    X_TO: np.ndarray
    """Pose of the object on the table, shape (4, 4)."""
    table_sense: np.ndarray | None = None
    """Sense in which the table moved last: -1, 0 or +1, shape (n,); None is 0. Backlash follows it."""
    rates: np.ndarray | None = None
    """Motion at each frame: velocity of S in W [m/s], its angular velocity in W [rad/s], table rate [rad/s],
    shape (n, 7); None where everything stands still. Latency follows it."""

    def __len__(self) -> int:
        return len(self.t)

    @property
    def X_OS(self) -> np.ndarray:
        """Nominal poses of the scanner in the object frame, shape (n, 4, 4)."""
        X_WO = self.X_WT @ turned(self.table_angle) @ self.X_TO
        return inverse(X_WO) @ self.X_WS

    def taken(self, index: np.ndarray) -> "Captures":
        """Some of the frames, shape (k,) int."""
        optional = {
            k: None if getattr(self, k) is None else getattr(self, k)[index] for k in ("table_sense", "rates")
        }
        return replace(
            self, t=self.t[index], X_WS=self.X_WS[index], table_angle=self.table_angle[index], **optional
        )

    @property
    def body_rates(self) -> np.ndarray:
        """Velocity and angular velocity of the scanner against the object, both along S, shape (n, 6)."""
        if self.rates is None:
            return np.zeros((len(self), 6))
        h = 1e-4
        before, now, after = later(self, -h).X_OS, self.X_OS, later(self, h).X_OS
        turn = Rotation.from_matrix(after[:, :3, :3] @ np.swapaxes(before[:, :3, :3], 1, 2)).as_rotvec()
        both = np.stack([after[:, :3, 3] - before[:, :3, 3], turn], axis=1) / (2 * h)
        return (both @ now[:, :3, :3]).reshape(-1, 6)


@dataclass(frozen=True, kw_only=True)
class ScanErrors:
    """What the measurement gets wrong, beside the scanner's own frame scale; all zero but the stated noise.

    The figures of the defaults are those of docs/method.md, "The scan twin".
    """

    range_noise: float = 1.0
    """Factor on the scanner's noise along the ray; 0 switches it off."""
    frame_scale: float = 1.0
    """Factor on the scanner's frame scale; 0 switches it off."""
    pose_m: float = 0.02e-3
    """Standard deviation of the scanner's position per frame and axis [m]."""
    pose_rad: float = float(np.deg2rad(0.003))
    """Standard deviation of the scanner's orientation per frame and axis [rad]."""
    hand_eye_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant displacement of the true scanner from the nominal one, along S [m]."""
    hand_eye_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant rotation vector of the true scanner against the nominal one, along S [rad]."""
    axis_m: tuple[float, float] = (0.0, 0.0)
    """Displacement of the table's true axis, along x and y of T [m]."""
    axis_rad: tuple[float, float] = (0.0, 0.0)
    """Tilt of the table's true axis about x and y of T [rad]."""
    backlash_rad: float = 0.0
    """Play of the table: the object lags by half of it behind the sense of motion [rad]."""
    latency_s: float = 0.0
    """The frame is taken so much later than its pose; what a known latency leaves uncorrected [s]."""
    jitter_s: float = 0.0
    """Standard deviation of that from frame to frame [s]."""

    @property
    def constant(self) -> bool:
        """Whether any error is the same in all frames, which calibration can find."""
        return bool(self.backlash_rad or self.latency_s) or any(
            (*self.hand_eye_m, *self.hand_eye_rad, *self.axis_m, *self.axis_rad)
        )

    def without_constants(self) -> "ScanErrors":
        """The noise alone."""
        none = ScanErrors()
        names = ("hand_eye_m", "hand_eye_rad", "axis_m", "axis_rad", "backlash_rad", "latency_s")
        return replace(self, **{n: getattr(none, n) for n in names})

    @staticmethod
    def none() -> "ScanErrors":
        """A perfect measurement."""
        return ScanErrors(range_noise=0.0, frame_scale=0.0, pose_m=0.0, pose_rad=0.0)


def captures_from_trajectory(
    trajectory: Trajectory,
    scanner_poses_fn: Callable[[np.ndarray], np.ndarray],
    *,
    fps: float,
    X_WT: np.ndarray,
    X_TO: np.ndarray,
) -> Captures:
    """The frames taken along a trajectory: `fps` a second while an operation scans, from its first instant.

    Args:
        trajectory: joint positions over time.
        scanner_poses_fn: forward kinematics, (n, 7) [rad] -> X_WS (n, 4, 4).
        fps: frames a second.
        X_WT: pose of the table at angle zero, shape (4, 4).
        X_TO: pose of the object on the table, shape (4, 4).

    Raises:
        InputError: `fps` is not a positive number.
    """
    if not np.isfinite(fps) or fps <= 0:
        raise InputError(f"{fps} frames a second: a positive number is expected")
    spans = [(o.t_start, o.t_end) for o in trajectory.operations if o.scanning]
    # A frame that falls on the end of a span by rounding belongs to it.
    times = [a + np.arange(int((b - a) * fps + 1e-9) + 1) / fps for a, b in spans]
    t = np.clip(np.concatenate([np.zeros(0), *times]), 0.0, trajectory.duration)
    return captures_at(trajectory, t, scanner_poses_fn, X_WT=X_WT, X_TO=X_TO)


def captures_at(
    trajectory: Trajectory,
    t: np.ndarray,
    scanner_poses_fn: Callable[[np.ndarray], np.ndarray],
    *,
    X_WT: np.ndarray,
    X_TO: np.ndarray,
) -> Captures:
    """Frames taken at given times of a trajectory, or of a controller's log.

    Args:
        trajectory: joint positions and velocities over time.
        t: inside of it, shape (n,) [s].
        scanner_poses_fn: forward kinematics, (n, 7) [rad] -> X_WS (n, 4, 4).
        X_WT: pose of the table at angle zero, shape (4, 4).
        X_TO: pose of the object on the table, shape (4, 4).
    """
    path = CubicHermiteSpline(trajectory.t, trajectory.q, trajectory.qd)
    q, qd = (path(t), path(t, 1)) if len(t) else (np.zeros((0, 7)), np.zeros((0, 7)))
    X_WS = np.asarray(scanner_poses_fn(q)).reshape(-1, 4, 4)
    return Captures(
        t=t, X_WS=X_WS, table_angle=q[:, 6], X_WT=np.asarray(X_WT, float), X_TO=np.asarray(X_TO, float),
        table_sense=_sense(trajectory, t), rates=_rates(q, qd, scanner_poses_fn),
    )  # fmt: skip


def _rates(q: np.ndarray, qd: np.ndarray, scanner_poses_fn: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Rates of Captures, shape (n, 7), by central differences along the joint velocities (n, 7)."""
    if not len(q):
        return np.zeros((0, 7))
    h = 1e-4
    before, after = (np.asarray(scanner_poses_fn(q + s * h * qd)).reshape(-1, 4, 4) for s in (-1, 1))
    turn = Rotation.from_matrix(after[:, :3, :3] @ np.swapaxes(before[:, :3, :3], 1, 2)).as_rotvec()
    moved = np.hstack([after[:, :3, 3] - before[:, :3, 3], turn]) / (2 * h)
    return np.hstack([moved, qd[:, 6:]])


def later(captures: Captures, dt: np.ndarray | float) -> Captures:
    """The captures as they are `dt` after their stamps: poses moved on at their rates, the stamps kept.

    Args:
        captures: with rates; without them nothing moves.
        dt: one for each frame or one for all [s].
    """
    if captures.rates is None:
        return captures
    dt = np.broadcast_to(np.asarray(dt, float), (len(captures),))
    step = captures.rates * dt[:, None]
    X_WS = captures.X_WS.copy()
    X_WS[:, :3, 3] += step[:, :3]
    X_WS[:, :3, :3] = Rotation.from_rotvec(step[:, 3:6]).as_matrix() @ X_WS[:, :3, :3]
    return replace(captures, X_WS=X_WS, table_angle=captures.table_angle + step[:, 6])


def joined_captures(captures: Sequence[Captures]) -> Captures:
    """The frames of several scans of one cell in a row; times go on as they are.

    Raises:
        InputError: there are none.
    """
    if not captures:
        raise InputError("no captures to join")
    first = captures[0]
    optional = {}
    for name in ("table_sense", "rates"):
        values = [getattr(c, name) for c in captures]
        optional[name] = None if any(v is None for v in values) else np.concatenate(values)
    stacked = {k: np.concatenate([getattr(c, k) for c in captures]) for k in ("t", "X_WS", "table_angle")}
    return Captures(X_WT=first.X_WT, X_TO=first.X_TO, **stacked, **optional)


def still_captures(X_OS: np.ndarray, *, fps: float = 10.0) -> Captures:
    """Captures at given poses in the object frame, the table at rest in the world's origin.

    Args:
        X_OS: shape (n, 4, 4).
        fps: spaces the times.
    """
    n = len(X_OS)
    return Captures(
        t=np.arange(n) / fps, X_WS=np.asarray(X_OS, float), table_angle=np.zeros(n), X_WT=np.eye(4),
        X_TO=np.eye(4),
    )  # fmt: skip


def _sense(trajectory: Trajectory, t: np.ndarray) -> np.ndarray:
    """Sense of the table's last motion at each time; it is kept while the table rests."""
    speed = np.where(np.abs(trajectory.qd[:, 6]) > 1e-6, np.sign(trajectory.qd[:, 6]), 0.0)
    last = np.maximum.accumulate(np.where(speed != 0, np.arange(len(speed)), 0))
    at = np.clip(np.searchsorted(trajectory.t, t, side="left"), 0, len(speed) - 1)
    return speed[last][at]


def true_poses(captures: Captures, errors: ScanErrors, rng: np.random.Generator) -> np.ndarray:
    """Where the scanner really stands in the object frame when each frame is taken, shape (n, 4, 4)."""
    n = len(captures)
    noise = rng.standard_normal((n, 6)) * ([errors.pose_m] * 3 + [errors.pose_rad] * 3)
    if errors.latency_s or errors.jitter_s:
        jitter = errors.jitter_s * rng.standard_normal(n) if errors.jitter_s else 0.0
        captures = later(captures, errors.latency_s + jitter)
    hand_eye = motion(np.array([[*errors.hand_eye_m, *errors.hand_eye_rad]]))
    axis = motion(np.array([[*errors.axis_m, 0.0, *errors.axis_rad, 0.0]]))
    sense = np.zeros(n) if captures.table_sense is None else captures.table_sense
    angle = captures.table_angle - 0.5 * errors.backlash_rad * sense
    X_WO = captures.X_WT @ axis @ turned(angle) @ captures.X_TO
    return inverse(X_WO) @ captures.X_WS @ motion(noise) @ hand_eye
