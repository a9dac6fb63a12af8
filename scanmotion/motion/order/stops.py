"""What a tour can be made of: each viewpoint or sweep as a group of ways to serve it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from scanmotion.core.tour import StopKind
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.mending.keys import row_keys
from scanmotion.motion.order.salesman.generalised_tsp import cheapest_apart, most_different
from scanmotion.motion.transit_cost import (
    MoveModel,
    PlacedNodes,
    move_matrix,
    placed_nodes,
    revolution_seconds,
)


class ReachLike(Protocol):
    """What the order needs to know of a viewpoint's reach (motion/reach.py makes it)."""

    @property
    def viewpoint(self) -> Viewpoint: ...

    @property
    def q(self) -> np.ndarray:
        """Collision-free configurations, shape (k, 7) [rad]."""
        ...

    @property
    def X_OS(self) -> np.ndarray:
        """The scanner's pose in O that each gives, shape (k, 4, 4)."""
        ...

    @property
    def unreachable(self) -> object | None:
        """The reason why there are none."""
        ...


PathFree = Callable[[np.ndarray], tuple[bool, int, tuple[str, str]]]
"""Whether a joint path (k, 7) is clear, as the first item of what is returned (Clearance.path_free)."""
TURN = 2 * np.pi
_REVOLUTION_ARMS = 60
"""Greatest number of arm configurations of one revolution."""
_TABLE_RAD = 0.1
"""Table angles nearer than this are taken for one when ways are chosen [rad]."""
_CLASSES = 0.6
"""Share of a group's ways that are the cheapest of their table angle, or of their arm for a revolution."""
_CHEAP = 0.85
"""Share that is chosen by cost, these among them."""
_APART_S = 0.1
"""Ways nearer to each other than this are taken for one [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Group:
    """One stop of the tour and every way found to make it."""

    viewpoints: tuple[str, ...]
    kind: StopKind
    stage: int
    """0 for the global step, 1 for the local one."""
    enter: PlacedNodes
    """Configurations on arrival, k of them."""
    leave: PlacedNodes
    """Configurations on leaving."""
    seconds: np.ndarray
    """Time that each way takes, shape (k,) [s]."""
    partner: np.ndarray
    """Index of each way passed backwards, shape (k,)."""
    backward: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether a sweep's way passes its viewpoints in reverse order, shape (k,); empty for others."""
    paths: tuple[np.ndarray, ...] = ()
    """Joint paths of a sweep, shape (k, 7) each."""

    def __len__(self) -> int:
        return len(self.seconds)

    def only(self, ways: np.ndarray) -> Group:
        """The group with some of its ways; they must hold the partner of each."""
        places = {int(w): n for n, w in enumerate(ways)}
        return replace(
            self,
            enter=self.enter[ways],
            leave=self.leave[ways],
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


def dwell_group(reach: ReachLike, model: MoveModel, e1_range: tuple[float, float]) -> Group:
    """A station: every configuration with every winding of the table."""
    rows = []
    for q in np.asarray(reach.q):
        rows += [np.append(q[:6], e) for e in windings(q[6], *e1_range)]
    q = placed_nodes(model, np.array(rows).reshape(-1, 7))
    return Group(
        viewpoints=(reach.viewpoint.id,),
        kind="dwell",
        stage=stage_of(reach),
        enter=q,
        leave=q,
        seconds=np.full(len(rows), model.dwell_s),
        partner=np.arange(len(rows)),
    )


def stage_of(reach: ReachLike) -> int:
    return 0 if reach.viewpoint.step == "global" else 1


def revolution_group(
    reach: ReachLike, model: MoveModel, e1_range: tuple[float, float], table: Sequence[float]
) -> Group:
    """A whole turn of the table from any of the `table` angles, either way round, with the arm still.

    The azimuth of such a viewpoint is free, so the arm's configurations do not depend on where the table
    stands when it begins.
    """
    arms = np.unique(np.round(np.asarray(reach.q)[:, :6], 9), axis=0)
    arms = arms[spread_windings(model, np.column_stack([arms, np.zeros(len(arms))]), _REVOLUTION_ARMS)]
    starts = np.unique(np.round(np.concatenate([windings(e, *e1_range) for e in table]), 9))
    low, high = e1_range
    turns = [(e, e + TURN) for e in starts if e + TURN <= high + 1e-9]
    turns += [(e + TURN, e) for e, _ in turns]
    if not turns:
        return _group_of_pairs(reach, model, np.empty((0, 7)), np.empty((0, 7)))
    ends = np.clip(np.array(turns), low, high)
    q = np.repeat(arms, len(ends), axis=0)
    q_in = np.column_stack([q, np.tile(ends[:, 0], len(arms))])
    q_out = np.column_stack([q, np.tile(ends[:, 1], len(arms))])
    return _group_of_pairs(reach, model, q_in, q_out)


def _group_of_pairs(reach: ReachLike, model: MoveModel, q_in: np.ndarray, q_out: np.ndarray) -> Group:
    """Ways that come in blocks of two halves, the second the first backwards."""
    k = len(q_in)
    where = {q.tobytes() + p.tobytes(): n for n, (q, p) in enumerate(zip(q_in, q_out, strict=True))}
    partner = [where[p.tobytes() + q.tobytes()] for q, p in zip(q_in, q_out, strict=True)]
    return Group(
        viewpoints=(reach.viewpoint.id,),
        kind="revolution",
        stage=stage_of(reach),
        enter=placed_nodes(model, q_in),
        leave=placed_nodes(model, q_out),
        seconds=np.full(k, revolution_seconds(model)),
        partner=np.array(partner, dtype=int),
    )


def thinned_stops(
    group: Group, model: MoveModel, most: int, before: np.ndarray | None, after: np.ndarray | None
) -> Group:
    """At most about `most` ways: those that cost least between two configurations, then the most different.

    Args:
        group: all ways.
        model: cost of motions; ways differ by the seconds of the scanner and of each axis between them.
        most: ways kept.
        before: configuration that the tour comes from, shape (7,); None where that is not known.
        after: configuration that it goes on to, shape (7,); None where that is not known.
    """
    if len(group) <= most:
        return group
    features = np.hstack([_features(model, group.enter), _features(model, group.leave)])
    # Ways that differ from their partners come in pairs, so half as many are drawn.
    drawn = most if group.kind == "dwell" else most // 2
    chosen = np.zeros(0, dtype=np.int64)
    if before is not None or after is not None:
        order = _by_cost(group, model, before, after)
        # What must not be missing: every table angle, or for a revolution, which may start at any, every arm.
        enter = group.enter.q[order]
        if group.kind == "revolution":
            classes = np.round(enter[:, :6] / _TABLE_RAD)
        else:
            classes = np.round(np.column_stack([enter[:, 6], group.leave.q[order, 6]]) / _TABLE_RAD)
        low = classes.min(axis=0)
        _, firsts = np.unique(row_keys((classes - low).astype(np.int64)), return_index=True)
        chosen = order[np.sort(firsts)][: int(_CLASSES * drawn)]
        chosen = cheapest_apart(features, order, chosen, _APART_S, int(_CHEAP * drawn))
    chosen = most_different(features, chosen, drawn)
    return group.only(np.array(sorted({w for way in chosen for w in _both(group, int(way))})))


def _by_cost(
    group: Group, model: MoveModel, before: np.ndarray | None, after: np.ndarray | None
) -> np.ndarray:
    """Ways by the seconds of getting there and on; among equals those first that turn the table least."""
    cost, turned = np.zeros(len(group)), np.zeros(len(group))
    if before is not None:
        cost += move_matrix(model, before, group.enter)[0]
        turned += np.abs(group.enter.q[:, 6] - before[6])
    if after is not None:
        cost += move_matrix(model, group.leave, after)[:, 0]
        turned += np.abs(group.leave.q[:, 6] - after[6])
    return np.lexsort((turned, np.round(cost, 3)))


def _both(group: Group, way: int) -> tuple[int, ...]:
    """A way and its partner."""
    return tuple(dict.fromkeys((way, int(group.partner[way]))))


def spread_windings(model: MoveModel, q: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most `most` configurations of (k, 7), the first and then the most different."""
    return most_different(_features(model, placed_nodes(model, q)), np.zeros(1, dtype=np.int64), most)


def _features(model: MoveModel, x: PlacedNodes) -> np.ndarray:
    return np.hstack([x.p / model.transit_speed, x.q / model.v])
