"""What a tour can be made of: each viewpoint or sweep as a group of ways to serve it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from scanmotion.motion.seconds import MoveModel, revolution_seconds, scanner_positions
from scanmotion.motion.tour import StopKind

if TYPE_CHECKING:
    from scanmotion.motion.reach import Reach

PathFree = Callable[[np.ndarray], tuple]
"""Whether a joint path (k, 7) is clear, as the first item of what is returned (Clearance.path_free)."""
TURN = 2 * np.pi


@dataclass(frozen=True, eq=False, kw_only=True)
class Group:
    """One stop of the tour and every way found to make it."""

    viewpoints: tuple[str, ...]
    kind: StopKind
    stage: int
    """0 for the global step, 1 for the local one."""
    q_in: np.ndarray
    """Configurations on arrival, shape (k, 7) [rad]."""
    q_out: np.ndarray
    """Configurations on leaving, shape (k, 7) [rad]."""
    seconds: np.ndarray
    """Time that each way takes, shape (k,) [s]."""
    partner: np.ndarray
    """Index of each way passed backwards, shape (k,)."""
    backward: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether a sweep's way passes its viewpoints in reverse order, shape (k,); empty for others."""
    paths: tuple[np.ndarray, ...] = ()
    """Joint paths of a sweep, shape (k, 7) each."""

    def only(self, ways: np.ndarray) -> Group:
        """The group with some of its ways; they must hold the partner of each."""
        places = {int(w): n for n, w in enumerate(ways)}
        return replace(
            self,
            q_in=self.q_in[ways],
            q_out=self.q_out[ways],
            seconds=self.seconds[ways],
            partner=np.array([places[int(self.partner[w])] for w in ways]),
            backward=self.backward[ways] if len(self.backward) else self.backward,
            paths=tuple(self.paths[w] for w in ways) if self.paths else (),
        )


def natural(name: str) -> tuple:
    """Sort key in which L1.2 comes before L1.10."""
    return tuple((0, int(s)) if s.isdigit() else (1, s) for s in re.split(r"(\d+)", name) if s)


def windings(angle: float, low: float, high: float) -> np.ndarray:
    """All angles equal to `angle` up to whole turns inside [low, high] [rad]."""
    first, last = np.ceil((low - angle) / TURN - 1e-9), np.floor((high - angle) / TURN + 1e-9)
    return np.clip(angle + TURN * np.arange(first, last + 1), low, high)


def dwell_group(reach: Reach, model: MoveModel, e1_range: tuple[float, float]) -> Group:
    """A station: every configuration with every winding of the table."""
    rows = []
    for q in np.asarray(reach.q):
        rows += [np.append(q[:6], e) for e in windings(q[6], *e1_range)]
    q = np.array(rows).reshape(-1, 7)
    return Group(
        viewpoints=(reach.viewpoint.id,),
        kind="dwell",
        stage=stage_of(reach),
        q_in=q,
        q_out=q,
        seconds=np.full(len(q), model.dwell_s),
        partner=np.arange(len(q)),
    )


def stage_of(reach: Reach) -> int:
    return 0 if reach.viewpoint.step == "global" else 1


def revolution_group(
    reach: Reach, model: MoveModel, e1_range: tuple[float, float], table: Sequence[float]
) -> Group:
    """A whole turn of the table from any of the `table` angles, either way round, with the arm still.

    The azimuth of such a viewpoint is free, so the arm's configurations do not depend on where the table
    stands when it begins.
    """
    arms = np.unique(np.round(np.asarray(reach.q)[:, :6], 9), axis=0)
    starts = np.unique(np.round(np.concatenate([windings(e, *e1_range) for e in table]), 9))
    low, high = e1_range
    turns = [(e, e + TURN) for e in starts if e + TURN <= high + 1e-9]
    turns += [(e + TURN, e) for e, _ in turns]
    if not turns:
        return _group_of_pairs(reach, np.empty((0, 7)), np.empty((0, 7)), 0.0)
    ends = np.clip(np.array(turns), low, high)
    q = np.repeat(arms, len(ends), axis=0)
    q_in = np.column_stack([q, np.tile(ends[:, 0], len(arms))])
    q_out = np.column_stack([q, np.tile(ends[:, 1], len(arms))])
    return _group_of_pairs(reach, q_in, q_out, revolution_seconds(model))


def _group_of_pairs(reach: Reach, q_in: np.ndarray, q_out: np.ndarray, seconds: float) -> Group:
    """Ways that come in blocks of two halves, the second the first backwards."""
    k = len(q_in)
    where = {q.tobytes() + p.tobytes(): n for n, (q, p) in enumerate(zip(q_in, q_out, strict=True))}
    partner = [where[p.tobytes() + q.tobytes()] for q, p in zip(q_in, q_out, strict=True)]
    return Group(
        viewpoints=(reach.viewpoint.id,),
        kind="revolution",
        stage=stage_of(reach),
        q_in=q_in,
        q_out=q_out,
        seconds=np.full(k, seconds),
        partner=np.array(partner, dtype=int),
    )


def thinned(group: Group, model: MoveModel, most: int, near: np.ndarray) -> Group:
    """At most about `most` ways: those nearest to the configurations `near` (n, 7), then the most different.

    Differences are in seconds: of the scanner at its transit speed, of each axis at its greatest speed.
    """
    if len(group.q_in) <= most:
        return group
    x, y = _features(model, group.q_in), _features(model, group.q_out)
    chosen: list[int] = []
    for target in _features(model, np.atleast_2d(near)):
        gap = np.minimum(np.abs(x - target).max(axis=1), np.abs(y - target).max(axis=1))
        gap[chosen] = np.inf
        if len(chosen) < most:
            chosen += [w for w in _both(group, int(gap.argmin())) if w not in chosen]
    # Ways that differ from their partners come in pairs, so half as many are drawn.
    drawn = most if group.kind == "dwell" else most // 2
    chosen = _most_different(np.hstack([x, y]), chosen, drawn)
    return group.only(np.array(sorted({w for way in chosen for w in _both(group, way)})))


def _both(group: Group, way: int) -> tuple[int, ...]:
    """A way and its partner."""
    return tuple(dict.fromkeys((way, int(group.partner[way]))))


def spread(model: MoveModel, q: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most `most` configurations of (k, 7), the first and then the most different."""
    return np.array(_most_different(_features(model, q), [0], most))


def _most_different(features: np.ndarray, chosen: list[int], most: int) -> list[int]:
    """Add to `chosen` the row that is farthest from all chosen ones, until there are `most`."""
    chosen = list(chosen) or [0]
    distance = np.full(len(features), np.inf)
    for row in chosen:
        distance = np.minimum(distance, np.abs(features - features[row]).max(axis=1))
    while len(chosen) < min(most, len(features)):
        row = int(distance.argmax())
        if distance[row] <= 1e-9:
            break
        chosen.append(row)
        distance = np.minimum(distance, np.abs(features - features[row]).max(axis=1))
    return chosen


def _features(model: MoveModel, q: np.ndarray) -> np.ndarray:
    return np.hstack([scanner_positions(model, q) / model.transit_speed, q / model.v])
