"""Time scaling of one path: the fastest s(t) inside velocity, acceleration, jerk and scanner-speed limits.

Reachability analysis (TOPP-RA: Pham and Pham 2018, doi:10.1109/TRO.2018.2819195) gives the fastest profile
without a jerk limit; two moving averages over time make its jerk finite, accelerations are lowered where
the jerk is still too high, and a last uniform stretch makes every limit hold at every checked instant.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.interpolate import CubicSpline

from scanmotion.errors import TimingError
from scanmotion.motion.spline import JointSpline

MARGIN = 5e-4
"""Share of every limit that is left unused, for what happens between the checked instants."""
_CHECK_S = 0.002
_ROUNDS = 4
_GRID = 200


@dataclass(frozen=True, eq=False, kw_only=True)
class Limits:
    """What the axes and the scanner may do; all positive."""

    v: np.ndarray
    """Greatest joint velocities, shape (7,) [rad/s]."""
    a: np.ndarray
    """Greatest joint accelerations, shape (7,) [rad/s2]."""
    j: np.ndarray
    """Greatest joint jerks, shape (7,) [rad/s3]."""
    tcp: float
    """Greatest speed of the scanner [m/s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Derivatives:
    """The path and its derivatives with respect to s on a grid."""

    s: np.ndarray
    """Increasing from 0, shape (n,)."""
    q1: np.ndarray
    """dq/ds, shape (n, 7); q2 and q3 are the second and third derivatives."""
    q2: np.ndarray
    q3: np.ndarray
    p1: np.ndarray
    """dp/ds of the scanner's origin, shape (n, 3) [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TimeLaw:
    """s(t) from rest to rest: a piecewise parabola averaged over two windows, then stretched in time."""

    duration: float
    """[s]"""
    floor: float
    """Duration of the fastest law without a jerk limit [s]."""
    stretch: float
    windows: tuple[float, float]
    knots: np.ndarray = field(repr=False)
    """Instants of the parabola's pieces before averaging, shape (n,) [s]."""
    pieces: np.ndarray = field(repr=False)
    """At each knot s and ds/dt, and d2s/dt2 of the piece that follows, shape (n, 3)."""

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """The parameter s and its first three time derivatives, shape (n, 4), at times t in [0, duration]."""
        k = self.stretch
        rows = _averaged(np.clip(t, 0.0, self.duration) / k, self.knots, self.pieces, *self.windows)
        return rows / k ** np.arange(4.0)


def parameter_grid(path: JointSpline, *, spacing: float = 1.0) -> np.ndarray:
    """Grid over [0, path.end], finer towards both ends where a law starts from rest."""
    end = path.end
    n = int(max(_GRID, 9 * (len(path.curve.c) - 3)) / spacing)
    x = np.linspace(0.0, 1.0, n + 1)
    return end * (x - 0.6 * np.sin(2 * np.pi * x) / (2 * np.pi))


def ruckig_law(length: float, speed: float, acceleration: float, jerk: float) -> "RuckigLaw":
    """The fastest law over `length` from rest to rest with these bounds on s (Ruckig, one axis)."""
    asked = InputParameter(1)
    asked.current_position, asked.target_position = [0.0], [length]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [speed], [acceleration], [jerk]
    solved = Trajectory(1)
    result = Ruckig(1).calculate(asked, solved)
    if result not in (Result.Working, Result.Finished):
        raise TimingError(f"no law over {length:g} at speed {speed:g}: {result}")
    profile = solved.profiles[0][0]
    knots = np.concatenate([[0.0], np.cumsum(profile.t)])
    pieces = np.column_stack([profile.p, profile.v, profile.a, [*profile.j, 0.0]])
    return RuckigLaw(duration=float(solved.duration), knots=knots, pieces=pieces)


@dataclass(frozen=True, eq=False, kw_only=True)
class RuckigLaw:
    """The parameter s(t) in seven stretches of constant jerk."""

    duration: float
    """[s]"""
    knots: np.ndarray
    """Where the stretches begin and the last ends, shape (8,) [s]."""
    pieces: np.ndarray
    """At each knot s and its three derivatives, shape (8, 4)."""

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """The parameter s and its first three time derivatives, shape (n, 4), at times t in [0, duration]."""
        i = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, 6)
        h = np.clip(t, 0.0, self.duration) - self.knots[i]
        s, v, a, j = self.pieces[i].T
        return np.column_stack([s + h * (v + h * (a / 2 + h * j / 6)), v + h * (a + h * j / 2), a + h * j, j])


def fastest_law(path: JointSpline, d: Derivatives, limits: Limits) -> TimeLaw:
    """The fastest law found, rest to rest, that keeps all limits.

    Args:
        path: q(s).
        d: its derivatives on a grid over [0, path.end], see `parameter_grid`.
        limits: of axes and scanner.
    """
    cap = _speed_caps(d, limits)
    floor = _profile_seconds(d.s, _profile(d, cap, np.tile(limits.a, (len(d.s), 1))))
    ramp = float((limits.a / limits.j).max())
    best: TimeLaw | None = None
    for first in (1.0 * ramp, 1.6 * ramp, 0.6 * ramp):
        law = _jerk_limited(path, d, limits, cap, (1.03 * first, 0.2 * first), floor)
        if best is None or law.duration < best.duration:
            best = law
    assert best is not None
    return best


def floor_seconds(d: Derivatives, limits: Limits) -> float:
    """Duration of the fastest law without a jerk limit [s]."""
    return _profile_seconds(d.s, _profile(d, _speed_caps(d, limits), np.tile(limits.a, (len(d.s), 1))))


def _speed_caps(d: Derivatives, limits: Limits) -> np.ndarray:
    """Greatest (ds/dt)^2 at each grid point, the least over it and its neighbours: none is passed between."""
    rate = np.maximum((np.abs(d.q1) / limits.v).max(axis=1), np.linalg.norm(d.p1, axis=1) / limits.tcp)
    pooled = rate.copy()
    pooled[1:] = np.maximum(pooled[1:], rate[:-1])
    pooled[:-1] = np.maximum(pooled[:-1], rate[1:])
    return ((1 - MARGIN) / np.maximum(pooled, 1e-12)) ** 2


def _jerk_limited(
    path: JointSpline,
    d: Derivatives,
    limits: Limits,
    cap: np.ndarray,
    windows: tuple[float, float],
    floor: float,
) -> TimeLaw:
    """Averages over `windows`; where a limit is passed, speed or acceleration is lowered there, by turns."""
    share = np.ones(len(d.s))
    best: TimeLaw | None = None
    for _ in range(_ROUNDS):
        x = _profile(d, cap, limits.a * share[:, None])
        law = _law(d.s, x, windows, floor)
        over = excess(path, d, law, limits)
        stretch = float(over.factor.max()) / (1 - MARGIN / 2)
        fitted = _stretched(law, stretch)
        if best is None or fitted.duration < best.duration:
            best = fitted
        if stretch <= 1.002:
            break
        half = int(np.ceil(sum(windows) / (over.t[1] - over.t[0])))
        log = np.log(np.maximum(over.factor, 1.0))
        slower = _running_max(log * over.bend, half)
        softer = _running_max(log * (1 - over.bend), half)
        cap = np.minimum(cap, x * np.exp(-2 * np.interp(d.s, over.s, slower)))
        share = np.maximum(share * np.exp(-2 * np.interp(d.s, over.s, softer)), 0.05)
    assert best is not None
    return best


def _stretched(law: TimeLaw, k: float) -> TimeLaw:
    return TimeLaw(
        duration=law.duration * k,
        floor=law.floor,
        stretch=k,
        windows=law.windows,
        knots=law.knots,
        pieces=law.pieces,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Excess:
    """How far a law is from the limits, at closely spaced instants; all of shape (n,)."""

    t: np.ndarray
    s: np.ndarray
    factor: np.ndarray
    """By how much time would have to be stretched for all limits to hold at that instant."""
    bend: np.ndarray
    """Share of the worst jerk that the path causes at even speed; the rest comes from changes of ds/dt."""


def excess(path: JointSpline, d: Derivatives, law: TimeLaw, limits: Limits) -> Excess:
    """Compares the motion under `law` with the limits every 2 ms."""
    t = np.linspace(0.0, law.duration, max(int(law.duration / _CHECK_S), 40) + 1)
    s, s1, s2, s3 = law(t).T[:, :, None]
    q1, q2, q3 = (path(s[:, 0], k) for k in (1, 2, 3))
    tcp = np.linalg.norm(CubicSpline(d.s, d.p1)(s[:, 0]) * s1, axis=1)
    v = np.maximum((np.abs(q1 * s1) / limits.v).max(axis=1), tcp / limits.tcp)
    a = (np.abs(q2 * s1**2 + q1 * s2) / limits.a).max(axis=1)
    jerk = np.abs(q3 * s1**3 + 3 * q2 * s1 * s2 + q1 * s3) / limits.j
    worst = jerk.argmax(axis=1)[:, None]
    j, even = (np.take_along_axis(k, worst, axis=1)[:, 0] for k in (jerk, np.abs(q3 * s1**3) / limits.j))
    factor = np.maximum(np.maximum(v, np.sqrt(a)), np.cbrt(j))
    return Excess(t=t, s=s[:, 0], factor=factor, bend=np.clip(even / np.maximum(j, 1e-9), 0.0, 1.0))


def _running_max(x: np.ndarray, half: int) -> np.ndarray:
    padded = np.pad(x, half, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1).max(axis=1)


def _profile(d: Derivatives, cap: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(ds/dt)^2 on the grid, rest to rest, the pointwise greatest."""
    return _forward(d.s, d.q1, d.q2, a, _controllable(d.s, d.q1, d.q2, a, cap))


def _profile_seconds(s: np.ndarray, x: np.ndarray) -> float:
    v = np.sqrt(x)
    return float((2 * np.diff(s) / np.maximum(v[:-1] + v[1:], 1e-9)).sum())


def _law(s: np.ndarray, x: np.ndarray, windows: tuple[float, float], floor: float) -> TimeLaw:
    """The profile as pieces of constant d2s/dt2, averaged over the windows."""
    v = np.sqrt(x)
    dt = 2 * np.diff(s) / np.maximum(v[:-1] + v[1:], 1e-9)
    knots = np.concatenate([[0.0], np.cumsum(dt)])
    pieces = np.column_stack([s, v, np.append(np.diff(v) / dt, 0.0)])
    return TimeLaw(
        duration=float(knots[-1]) + sum(windows),
        floor=floor,
        stretch=1.0,
        windows=windows,
        knots=knots,
        pieces=pieces,
    )


@njit(cache=True)
def _averaged(t: np.ndarray, knots: np.ndarray, pieces: np.ndarray, w1: float, w2: float) -> np.ndarray:
    """The parabola averaged over the last w1, then over the last w2 seconds, with three derivatives.

    Integrals start anew at the window's left edge and s is counted from there, so nothing cancels.
    """
    out = np.zeros((len(t), 4))
    wide, narrow = max(w1, w2), min(w1, w2)
    for n in range(len(t)):
        corners = (t[n] - wide, t[n] - narrow, t[n])
        now = t[n] - wide - narrow
        i = max(np.searchsorted(knots, now, side="right") - 1, 0)
        h = max(now - knots[i], 0.0)
        base = pieces[i, 0] + h * (pieces[i, 1] + pieces[i, 2] * h / 2)
        v = pieces[i, 1] + pieces[i, 2] * h if now > 0.0 else 0.0
        first = v
        second, integral, s = 0.0, 0.0, 0.0
        for c in range(3):
            while now < corners[c]:
                if now < knots[0]:
                    a, until = 0.0, min(knots[0], corners[c])
                elif i >= len(knots) - 1:
                    v, a, until = 0.0, 0.0, corners[c]
                else:
                    a, until = pieces[i, 2], min(knots[i + 1], corners[c])
                h = until - now
                second += h * (integral + h * (s / 2 + h * (v / 6 + a * h / 24)))
                integral += h * (s + h * (v / 2 + a * h / 6))
                s += h * (v + a * h / 2)
                v += a * h
                now = until
                while i < len(knots) - 1 and now >= knots[i + 1]:
                    i += 1
                    v = pieces[i, 1]
            sign = 1.0 if c == 2 else -1.0
            out[n, 0] += sign * second
            out[n, 1] += sign * integral
            out[n, 2] += sign * s
            out[n, 3] += sign * v
        out[n, 3] += first
        out[n] /= w1 * w2
        out[n, 0] += base
    return out


@njit(cache=True)
def _controllable(
    s: np.ndarray, q1: np.ndarray, q2: np.ndarray, a: np.ndarray, cap: np.ndarray
) -> np.ndarray:
    """Backward pass: the greatest x = (ds/dt)^2 at each grid point from which the end can be met at rest.

    In each cell u = d2s/dt2 is constant; |q1 u + q2 x| <= a is asked at both ends of the cell. The bounds on
    u are lines in x, so the greatest x at which the upper ones stay above the lower ones is the least over
    pairs of where the two lines cross.
    """
    n, m = q1.shape
    reach = np.zeros(n)
    upper = np.zeros((2 * m + 1, 2))
    lower = np.zeros((2 * m + 1, 2))
    for i in range(n - 2, -1, -1):
        h = s[i + 1] - s[i]
        best = cap[i]
        count = 0
        for end in range(2):
            for j in range(m):
                bend = q2[i + end, j]
                slope = q1[i + end, j] + (2.0 * h * bend if end else 0.0)
                limit = a[i + end, j]
                if abs(slope) < 1e-12 * max(1.0, abs(bend)):
                    if abs(bend) > 0.0:
                        best = min(best, limit / abs(bend))
                    continue
                upper[count, 0], upper[count, 1] = limit / abs(slope), -bend / slope
                lower[count, 0], lower[count, 1] = -limit / abs(slope), -bend / slope
                count += 1
        upper[count, 0], upper[count, 1] = reach[i + 1] / (2.0 * h), -1.0 / (2.0 * h)
        lower[count, 0], lower[count, 1] = 0.0, -1.0 / (2.0 * h)
        count += 1
        for k in range(count):
            for r in range(count):
                fall = lower[r, 1] - upper[k, 1]
                if fall > 0.0:
                    best = min(best, (upper[k, 0] - lower[r, 0]) / fall)
        reach[i] = max(best, 0.0)
    return reach


@njit(cache=True)
def _forward(s: np.ndarray, q1: np.ndarray, q2: np.ndarray, a: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Forward pass from rest: at each cell the greatest acceleration that stays controllable."""
    n, m = q1.shape
    x = np.zeros(n)
    for i in range(n - 1):
        h = s[i + 1] - s[i]
        u = (reach[i + 1] - x[i]) / (2.0 * h)
        for end in range(2):
            for j in range(m):
                bend = q2[i + end, j]
                slope = q1[i + end, j] + (2.0 * h * bend if end else 0.0)
                if abs(slope) >= 1e-12 * max(1.0, abs(bend)):
                    u = min(u, a[i + end, j] / abs(slope) - bend / slope * x[i])
        x[i + 1] = min(max(x[i] + 2.0 * h * u, 0.0), reach[i + 1])
    return x
