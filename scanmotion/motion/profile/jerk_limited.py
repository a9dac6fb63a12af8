"""Time scaling of one path: the fastest s(t) inside velocity, acceleration, jerk and scanner-speed limits.

The fastest profile without a jerk limit (speed_profile.py) is averaged over two windows of time, which makes
its jerk finite. Speeds and accelerations are lowered where the jerk is still too high, and a last uniform
stretch makes every limit hold at every checked instant.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from ruckig import InputParameter, Result, Ruckig, Trajectory
from scipy.ndimage import maximum_filter1d

from scanmotion.core.errors import TimingError
from scanmotion.geometry.jit import njit
from scanmotion.motion.profile.speed_profile import (
    MARGIN,
    Derivatives,
    Limits,
    fastest_profile,
    profile_seconds,
    speed_caps,
)
from scanmotion.motion.profile.spline import JointSpline

_CHECK_S = 0.002
_LAST_CHECK_S = 0.0005
_ROUNDS = 8
_BEYOND = 0.002
_JERK_SHARE = 0.997
"""Jerk is less smooth between the checked instants than the others and needs more of a margin."""
_ENOUGH = 1.2
"""Ramps of an S-curve cost about a / j; a law that costs little more is taken at once."""


Profile = Callable[[Derivatives, np.ndarray, np.ndarray], np.ndarray]
"""A solver: derivatives, greatest (ds/dt)^2 (n,) and accelerations (n, 7) in, (ds/dt)^2 (n,) out."""


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
    caps: np.ndarray = field(repr=False)
    """What the profile was asked for: its greatest (ds/dt)^2 and the share of the accelerations, (n, 2)."""

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """The parameter s and its first three time derivatives, shape (n, 4), at times t in [0, duration]."""
        k = self.stretch
        rows = _averaged(np.clip(t, 0.0, self.duration) / k, self.knots, self.pieces, *self.windows)
        return rows / k ** np.arange(4.0)


def ruckig_law(length: float, speed: float, acceleration: float, jerk: float) -> "RuckigLaw":
    """The fastest law over `length` from rest to rest with these bounds on s (Ruckig, one axis)."""
    asked = InputParameter(1)
    asked.current_position, asked.target_position = [0.0], [length]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [speed], [acceleration], [jerk]
    solved = Trajectory(1)
    if min(length, speed, acceleration, jerk) <= 0.0:
        raise TimingError(f"no law over {length:g} with bounds {speed:g}, {acceleration:g}, {jerk:g}")
    result = Ruckig(1).calculate(asked, solved)
    if result not in (Result.Working, Result.Finished):
        raise TimingError(
            f"no law over {length:g} with bounds {speed:g}, {acceleration:g}, {jerk:g}: {result}"
        )
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
    rate = d.tcp(d.s)
    cap = speed_caps(d, rate, limits)
    floor = profile_seconds(d.s, fastest_profile(d, cap, np.tile(limits.a, (len(d.s), 1))))
    ramp = float((limits.a / limits.j).max())
    best: TimeLaw | None = None
    for share in (1.0, 1.6, 0.6):
        windows = (1.03 * share * ramp, 0.08 * share * ramp)
        law = _jerk_limited(path, d, rate, limits, cap, windows, floor)
        if best is None or law.duration < best.duration:
            best = law
        if best.duration <= floor + _ENOUGH * ramp:
            break
    assert best is not None
    return _fitted(path, d, limits, best)


def law_with(profile: Profile, path: JointSpline, d: Derivatives, limits: Limits, law: TimeLaw) -> TimeLaw:
    """The same law, its profile made by another solver of the same problem; arguments as `fastest_law`."""
    x = profile(d, law.caps[:, 0], limits.a * law.caps[:, 1:])
    return _fitted(path, d, limits, _law(d.s, x, law.windows, law.floor, law.caps))


def _fitted(path: JointSpline, d: Derivatives, limits: Limits, law: TimeLaw) -> TimeLaw:
    """The law stretched until every limit holds at closely spaced instants."""
    fine = np.interp(np.arange(4 * len(d.s) - 3) / 4, np.arange(len(d.s)), d.s)
    exact = d.tcp(fine)
    last = _excess(path, lambda s: np.interp(s, fine, exact), law, limits, _LAST_CHECK_S)
    return _stretched(law, max(float(last.factor.max()) / (1 - MARGIN / 2), 1.0))


def _jerk_limited(
    path: JointSpline,
    d: Derivatives,
    rate: np.ndarray,
    limits: Limits,
    cap: np.ndarray,
    windows: tuple[float, float],
    floor: float,
) -> TimeLaw:
    """Averages over `windows`; where a limit is passed, speed or acceleration is lowered there, by turns."""
    share = np.ones(len(d.s))
    best: TimeLaw | None = None
    for n in range(_ROUNDS):
        x = fastest_profile(d, cap, limits.a * share[:, None])
        law = _law(d.s, x, windows, floor, np.column_stack([cap, share]))
        over = _excess(path, lambda s: np.interp(s, d.s, rate), law, limits, _CHECK_S)
        stretch = float(over.factor.max()) / (1 - MARGIN / 2)
        fitted = _stretched(law, stretch)
        if best is None or fitted.duration < best.duration:
            best = fitted
        if stretch <= 1 + _BEYOND:
            break
        cap, share = _milder(d.s, x, cap, share, over, sum(windows), n == 0)
    assert best is not None
    return best


def _milder(
    s: np.ndarray,
    x: np.ndarray,
    cap: np.ndarray,
    share: np.ndarray,
    over: "_Excess",
    window: float,
    first_round: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Lower caps on (ds/dt)^2 and lower shares of the accelerations where a law is beyond the limits.

    Where a brief excess comes from an acceleration that changes its sign, a level stretch there of as long as
    the excess lasts is enough: the speed's peak is cut off, its trough is widened. Elsewhere the speed is
    lowered as far as the path's bends cause the excess, the accelerations as far as the ramps do.
    """
    step = over.t[1] - over.t[0]
    half = int(np.ceil(window / step))
    log = np.log(np.maximum(over.factor, 1.0))
    soft = log * (1 - over.bend)
    at = np.interp(over.s, s, x)
    cap = cap.copy()
    beyond = (log > _BEYOND) & (over.bend < 0.5)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], beyond, [0]]).astype(int)))
    for first, end in edges.reshape(-1, 2):
        least, most = at[first:end].min(), at[first:end].max()
        if end - first <= 2 * half and least >= 0.3 * most:
            low, high = np.searchsorted(s, [over.s[first], over.s[end - 1]])
            cap[max(low - 1, 0) : high + 1] = np.minimum(cap[max(low - 1, 0) : high + 1], least)
            if first_round:
                soft[first:end] = 0.0
    slower = np.interp(s, over.s, _running_max(log * over.bend, half))
    softer = np.interp(s, over.s, _running_max(soft, half))
    return np.minimum(cap, x * np.exp(-slower)), np.maximum(share * np.exp(-2 * softer), 0.05)


def _stretched(law: TimeLaw, k: float) -> TimeLaw:
    return TimeLaw(
        duration=law.duration * k,
        floor=law.floor,
        stretch=law.stretch * k,
        windows=law.windows,
        knots=law.knots,
        pieces=law.pieces,
        caps=law.caps,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Excess:
    """How far a law is from the limits, at closely spaced instants; all of shape (n,)."""

    t: np.ndarray
    s: np.ndarray
    factor: np.ndarray
    """By how much time would have to be stretched for all limits to hold at that instant."""
    bend: np.ndarray
    """Share of the worst jerk that the path causes at even speed; the rest comes from changes of ds/dt."""


def _excess(
    path: JointSpline,
    rate: Callable[[np.ndarray], np.ndarray],
    law: TimeLaw,
    limits: Limits,
    step: float,
) -> _Excess:
    """Compares the motion under `law` with the limits every `step` seconds; `rate(s)` is |dp/ds|."""
    t = np.linspace(0.0, law.duration, max(int(law.duration / step), 40) + 1)
    rows = law(t)
    s, s1 = rows[:, 0].copy(), rows[:, 1]
    rates = np.column_stack([rows[:, 1:], s1**2, s1**3])
    bounds = np.array([limits.v, limits.a, _JERK_SHARE * limits.j, limits.j])
    curve = path.curve
    v, a, j, even = _worst(curve.t, curve.c, curve.k, np.clip(s, 0.0, path.end), rates, bounds)
    v = np.maximum(v, rate(s) * s1 / limits.tcp)
    factor = np.maximum(np.maximum(v, np.sqrt(a)), np.cbrt(j))
    return _Excess(t=t, s=s, factor=factor, bend=np.clip(even / np.maximum(j, 1e-9), 0.0, 1.0))


@njit(cache=True, error_model="numpy")
def _worst(
    knots: np.ndarray, c: np.ndarray, k: int, at: np.ndarray, rates: np.ndarray, bounds: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The greatest shares of the axes' velocities, accelerations and jerks at each instant, shape (n,) each.

    The last is the share of the jerk's limit that the axis of the greatest jerk has at even speed.

    Args:
        knots: of the spline.
        c: its coefficients, shape (m, 7).
        k: its degree.
        at: the parameter s at each instant, shape (n,).
        rates: three time derivatives of s, then the square and the cube of the first, shape (n, 5).
        bounds: of velocities, accelerations, jerks with a margin, and jerks, shape (4, 7).
    """
    n, axes = len(at), c.shape[1]
    v, a, j, even = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    basis, work, q = np.zeros((3, k + 1)), np.zeros(k + 1), np.zeros((3, axes))
    span = k
    for i in range(n):
        x = at[i]
        while span > k and x < knots[span]:
            span -= 1
        while span < len(c) - 1 and x >= knots[span + 1]:
            span += 1
        q[:] = 0.0
        for order in range(3):
            _basis(knots, x, k, span, order + 1, basis[order], work)
            for b in range(k + 1):
                weight = basis[order, b]
                for m in range(axes):
                    q[order, m] += c[span - k + b, m] * weight
        s1, s2, s3, square, cube = rates[i, 0], rates[i, 1], rates[i, 2], rates[i, 3], rates[i, 4]
        worst = -1.0
        for m in range(axes):
            v[i] = max(v[i], abs(q[0, m] * s1) / bounds[0, m])
            a[i] = max(a[i], abs(q[1, m] * square + q[0, m] * s2) / bounds[1, m])
            jerk = abs(q[2, m] * cube + 3.0 * q[1, m] * s1 * s2 + q[0, m] * s3) / bounds[2, m]
            if jerk > worst:
                worst = jerk
                j[i], even[i] = jerk, abs(q[2, m] * cube) / bounds[3, m]
    return v, a, j, even


@njit(cache=True, error_model="numpy")
def _basis(
    knots: np.ndarray, x: float, k: int, span: int, order: int, out: np.ndarray, work: np.ndarray
) -> None:
    """Derivatives of the k + 1 B-splines that do not vanish in a span, as scipy computes them (de Boor)."""
    out[0] = 1.0
    for j in range(1, k + 1):
        for n in range(j):
            work[n] = out[n]
        out[0] = 0.0
        for n in range(1, j + 1):
            high, low = knots[span + n], knots[span + n - j]
            if high == low:
                out[n] = 0.0
            elif j <= k - order:
                w = work[n - 1] / (high - low)
                out[n - 1] += w * (high - x)
                out[n] = w * (x - low)
            else:
                w = j * work[n - 1] / (high - low)
                out[n - 1] -= w
                out[n] = w


def _running_max(x: np.ndarray, half: int) -> np.ndarray:
    return maximum_filter1d(x, 2 * half + 1, mode="nearest")


def _law(
    s: np.ndarray, x: np.ndarray, windows: tuple[float, float], floor: float, caps: np.ndarray
) -> TimeLaw:
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
        caps=caps,
    )


@njit(cache=True)
def _last_not_above(knots: np.ndarray, value: float) -> int:
    """Last place of the ascending knots that is not above the value, at least 0."""
    low, high = 0, len(knots)
    while low < high:
        middle = (low + high) // 2
        if value < knots[middle]:
            high = middle
        else:
            low = middle + 1
    return max(low - 1, 0)


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
        i = _last_not_above(knots, now)
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
        for c in range(4):
            out[n, c] /= w1 * w2
        out[n, 0] += base
    return out
