"""Completeness against seconds: what a shorter programme would still see."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.core.tour import Stop, Tour
from scanmotion.motion.transit_cost import MoveModel, move_matrix, stop_seconds


@dataclass(frozen=True, eq=False, kw_only=True)
class CurvePoint:
    """A tour with some stops left out."""

    seconds: float
    """Expected duration [s]."""
    completeness: float
    """Share of the samples that are seen, 0..1."""
    dropped: tuple[str, ...]
    """Viewpoints left out so far, in the order in which they were."""


def completeness_curve(
    coverage: Mapping[str, np.ndarray],
    seconds: Tour,
    *,
    model: MoveModel,
    weights: np.ndarray | None = None,
    before: np.ndarray | None = None,
) -> tuple[CurvePoint, ...]:
    """The whole tour, then the tour with one more stop left out each time, down to none.

    The stop left out is the one that loses the least completeness for each second that it saves; the order of
    the others is kept, so each point's seconds could be lowered a little by ordering again.

    Args:
        coverage: for each viewpoint's id, which samples it sees, shape (m,) bool.
        seconds: the tour.
        model: cost of its motions.
        weights: what each sample counts, shape (m,); None for all alike.
        before: samples seen before the tour, shape (m,) bool.
    """
    stops = list(seconds.stops)
    rows = [_seen(coverage, stop) for stop in stops]
    if not rows and before is None:
        return (CurvePoint(seconds=0.0, completeness=0.0, dropped=()),)
    m = len(rows[0]) if rows else len(np.asarray(before))
    share = np.full(m, 1.0) if weights is None else np.asarray(weights, dtype=float)
    share = share / max(float(share.sum()), 1e-300)
    base = np.zeros(m, dtype=int) if before is None else np.asarray(before).astype(int)
    counts = base + np.sum(rows, axis=0, dtype=int) if rows else base
    total, dropped = seconds.seconds, ()
    points = [CurvePoint(seconds=total, completeness=float(share[counts > 0].sum()), dropped=())]
    while stops:
        saved = _savings(model, seconds.start_q, stops)
        lost = np.array([float(share[(counts == 1) & row].sum()) for row in rows])
        worst = int((lost / np.maximum(saved, 1e-9)).argmin())
        total -= float(saved[worst])
        counts = counts - rows.pop(worst)
        dropped = (*dropped, *stops.pop(worst).viewpoints)
        points.append(
            CurvePoint(seconds=max(total, 0.0), completeness=float(share[counts > 0].sum()), dropped=dropped)
        )
    return tuple(points)


def _seen(coverage: Mapping[str, np.ndarray], stop: Stop) -> np.ndarray:
    return np.any([np.asarray(coverage[v], dtype=bool) for v in stop.viewpoints], axis=0)


def _savings(model: MoveModel, start_q: np.ndarray, stops: Sequence[Stop]) -> np.ndarray:
    """Seconds that leaving out each stop saves, shape (n,)."""
    saved = np.empty(len(stops))
    for i, stop in enumerate(stops):
        before = stops[i - 1].q_out if i > 0 else np.asarray(start_q, dtype=float)
        saved[i] = move_matrix(model, before, stop.q_in)[0, 0] + stop_seconds(model, stop)
        if i + 1 < len(stops):
            after = stops[i + 1].q_in
            saved[i] += move_matrix(model, stop.q_out, after)[0, 0] - move_matrix(model, before, after)[0, 0]
    return saved
