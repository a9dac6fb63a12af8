"""How sure predicted coverage and accuracy are: what is not known is drawn; visibility is asked only once.

Guarantees: every draw is one whole scan with one set of constant errors. A sample counts as seen where an
exact test of the drawn poses says so, unless so many frames see it that no draw of this size loses it.
Assumes: the unknowns are independent and normal, with the deviations that the cell's section `uncertainty`
states; nothing is calibrated or registered away; accuracy follows from the frames' displacements along the
normal, linearly.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydantic import JsonValue

from scanmotion.core.part import SurfaceSamples
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.streams import Streams, fixed_stream
from scanmotion.geometry.typed_scipy import error_function
from scanmotion.sensing.simulator.captures import Captures, ScanErrors, inverse, motion, true_poses
from scanmotion.sensing.visibility import Scene, seen_by_any, sees

_SAFE = 12
"""A sample that so many of the frames asked see from spread-out poses is seen in every draw."""
_MOST_FRAMES = 160
_SAMPLES = 8000


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """Standard deviations of what is not known when a plan is made, per axis."""

    hand_eye_m: float = 0.05e-3
    hand_eye_rad: float = float(np.deg2rad(0.005))
    axis_m: float = 0.05e-3
    axis_rad: float = float(np.deg2rad(0.003))
    backlash_rad: float = float(np.deg2rad(0.003))
    latency_s: float = 0.5e-3
    place_m: float = 1.0e-3
    """Of the part on the table."""
    place_rad: float = float(np.deg2rad(0.5))


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A prediction and where 95 % of the draws lie."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Confidence:
    """Predicted coverage and accuracy with their intervals."""

    draws: int
    completeness: Interval
    """Of what can be seen."""
    mean_abs: Interval | None
    """Mean of the absolute distance [m]; None where no accuracy is known."""

    def record(self) -> dict[str, JsonValue]:
        """For summary.json."""
        c, a = self.completeness, self.mean_abs
        return {
            "draws": self.draws,
            "completeness": {
                "value": round(c.value, 6),
                "low_95": round(c.low, 6),
                "high_95": round(c.high, 6),
            },
            "mean_abs_mm": None
            if a is None
            else {"value": _mm(a.value), "low_95": _mm(a.low), "high_95": _mm(a.high)},
            "statement": self.statement,
        }

    @property
    def statement(self) -> str:
        """One line, as "99.8 % (95 %: 99.5 to 99.9)"."""
        c = self.completeness
        told = f"{c.value:.2%} (95 %: {c.low * 100:.2f} to {c.high * 100:.2f})"
        if self.mean_abs is None:
            return told
        a = self.mean_abs
        # The simulated value is without the unknown constant errors, so it may lie below the interval.
        low, high = _mm(a.low), _mm(a.high)
        return f"{told}; with the stated uncertainties the mean error is {low:.3f} to {high:.3f} mm"


def _mm(metres: float) -> float:
    return round(metres * 1e3, 5)


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """What a plan predicts, and what its draws need."""

    scene: Scene
    scanner: Scanner
    captures: Captures
    """All frames of the programme."""
    samples: SurfaceSamples
    seen: np.ndarray
    """By the programme, shape (n,) bool."""
    visible: np.ndarray
    """By any allowed pose, shape (n,) bool."""
    noise: tuple[float, float] | None
    """Mean absolute and mean signed distance that are predicted without constant errors [m]; None where
    unknown."""


def confidence(
    it: Prediction,
    errors: ScanErrors,
    unknown: Uncertainty,
    *,
    draws: int = 24,
    seed: int = 0,
    progress: Callable[[float], None] = lambda f: None,
) -> Confidence:
    """Monte Carlo over hand-eye, table axis, backlash, latency, arm and the part's place.

    Args:
        it: what the plan predicts.
        errors: of the cell's twin; their constants are where the draws are centred.
        unknown: standard deviations about them.
        draws: at least 20.
        seed: of the draws.
        progress: told the share done.
    """
    draws = max(draws, 20)
    every = it.visible | it.seen
    few = np.flatnonzero(every)
    few = few[np.unique(np.linspace(0, len(few) - 1, min(_SAMPLES, len(few))).astype(int))]
    some = np.unique(np.linspace(0, len(it.captures) - 1, _MOST_FRAMES).astype(int))
    p, n, base = it.samples.points[few], it.samples.normals[few], it.seen[few]
    X, part = it.captures.X_OS, it.captures.taken(some)
    mask = sees(it.scene, it.scanner, X[some], p, n)
    ask = np.flatnonzero(mask.sum(axis=0) < _SAFE)
    # Poses far apart first: most samples are found early and need not be asked again.
    order = np.argsort((np.arange(len(X)) * 0.6180339887498949) % 1.0, kind="stable")
    shares, means = np.empty(draws), np.zeros(draws)
    for k in range(draws):
        rng = Streams(seed=seed).child("confidence", k)
        drawn = _drawn(errors, unknown, rng)
        place = motion(rng.standard_normal((1, 6)) * ([unknown.place_m] * 3 + [unknown.place_rad] * 3))[0]
        # A part lies on its table: it is turned and shifted, but neither lifted nor tilted.
        place = motion(np.array([[*place[:2, 3], 0.0, 0.0, 0.0, np.arctan2(place[1, 0], place[0, 0])]]))[0]
        poses = place @ true_poses(it.captures, drawn, rng)
        now = base.copy()
        now[ask] = seen_by_any(it.scene, it.scanner, poses[order], p[ask], n[ask])
        shares[k] = now.mean() if len(now) else 0.0
        if it.noise is not None:
            means[k] = _mean_abs(_displacement(part, errors, drawn, mask, p, n), it.noise)
        progress((k + 1) / draws)
    whole = float(it.seen.sum() / max(int(every.sum()), 1))
    # The draws are of some samples: their spread is laid about the value of all.
    shift = whole - (float(base.mean()) if len(base) else 0.0)
    accuracy = None
    if it.noise is not None:
        accuracy = Interval(value=it.noise[0], low=float(np.quantile(means, 0.025)), high=_high(means))
    low = float(np.clip(np.quantile(shares, 0.025) + shift, 0.0, 1.0))
    high = float(np.clip(_high(shares) + shift, 0.0, 1.0))
    return Confidence(draws=draws, completeness=Interval(value=whole, low=low, high=high), mean_abs=accuracy)


def _high(values: np.ndarray) -> float:
    return float(np.quantile(values, 0.975))


def _drawn(errors: ScanErrors, unknown: Uncertainty, rng: np.random.Generator) -> ScanErrors:
    """The stated constants with one draw of what is not known about them."""
    z = rng.standard_normal(12)

    def off(values: tuple[float, ...], sd: float, first: int) -> tuple[float, ...]:
        return tuple(v + sd * float(z[first + i]) for i, v in enumerate(values))

    return replace(
        errors,
        hand_eye_m=off(errors.hand_eye_m, unknown.hand_eye_m, 0),
        hand_eye_rad=off(errors.hand_eye_rad, unknown.hand_eye_rad, 3),
        axis_m=off(errors.axis_m, unknown.axis_m, 6),
        axis_rad=off(errors.axis_rad, unknown.axis_rad, 8),
        backlash_rad=errors.backlash_rad + unknown.backlash_rad * z[10],
        latency_s=errors.latency_s + unknown.latency_s * z[11],
    )


def _displacement(
    captures: Captures, stated: ScanErrors, drawn: ScanErrors, mask: np.ndarray, p: np.ndarray, n: np.ndarray
) -> np.ndarray:
    """By how much the draw moves each fused point along its normal, beyond the stated constants, shape (m,)
    [m].

    Args:
        captures: some of the frames, f of them.
        stated: constants that the prediction has already.
        drawn: those of the draw.
        mask: which of the frames see which points, shape (f, m).
        p: shape (m, 3) [m].
        n: shape (m, 3).
    """
    still = fixed_stream("nominal_displacement")
    none = {"pose_m": 0.0, "pose_rad": 0.0, "jitter_s": 0.0}
    X = captures.X_OS
    change = [X @ inverse(true_poses(captures, replace(e, **none), still)) for e in (drawn, stated)]
    D = change[0] - change[1]
    weight = mask / np.maximum(mask.sum(axis=0), 1)
    mean = np.einsum("fm,fij->mij", weight, D)
    moved = np.einsum("mij,mj->mi", mean[:, :3, :3], p) + mean[:, :3, 3]
    return np.einsum("mi,mi->m", moved, n)[mask.any(axis=0)]


def _mean_abs(displacement: np.ndarray, noise: tuple[float, float]) -> float:
    """Mean absolute distance where noise and bias meet a displacement of each point: the folded normal's
    mean.
    """
    mean, bias = noise
    s = max(mean * np.sqrt(np.pi / 2), 1e-9)
    mu = displacement + bias
    inside = error_function(mu / (s * np.sqrt(2)))
    return float((s * np.sqrt(2 / np.pi) * np.exp(-(mu**2) / (2 * s * s)) + mu * inside).mean())
