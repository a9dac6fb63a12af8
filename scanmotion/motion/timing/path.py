"""A path: the arm goes from place to place and rests at some, the table turns on and back, both at once.

The scanner's speed in W is the arm's alone and the table has an axis of its own, so the two are timed apart:
the arm follows each of its ways by the law of jerk_limited.py at the scanning speed, the table turns by
Ruckig's laws from rest to rest. Guarantee: each axis and the scanner keep their limits at every instant. That
the two do not meet is for the caller to check on the motion itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.core.errors import TimingError
from scanmotion.core.tour import Stop
from scanmotion.core.trajectory import OperationKind
from scanmotion.motion.profile.jerk_limited import RuckigLaw
from scanmotion.motion.timing.helix import table_law, way_law
from scanmotion.motion.timing.ways import Way, driven_ways
from scanmotion.motion.transit.drive import limits_of
from scanmotion.motion.transit_cost import jerk_limited_seconds

_TABLE = 6
SPARE_RAD = 1e-3
"""The table stays this far inside its range, so that rounding does not take it beyond [rad]."""
_LEAST_TURN = 1e-3
"""A table's turn that is smaller is left out [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PathMotion:
    """A path before it is placed in time; called as timing's Motion is."""

    viewpoints: tuple[str, ...]
    ends: tuple[np.ndarray, np.ndarray]
    """First and last configuration, shape (7,) [rad]."""
    ways: tuple[Way, ...]
    """The arm's."""
    leaves: tuple[float, ...]
    """When the arm sets out on each way [s]."""
    turns: tuple[tuple[float, RuckigLaw], ...]
    """The table's, one after another: their sense and law."""
    duration: float
    """[s]"""
    floor: float
    """Duration without a jerk limit [s]."""
    kind: OperationKind = "path"

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations, each (n, 7), at times t; at rest after `duration`."""
        q, qd, qdd = driven_ways(self.ends[0], self.ways, self.leaves, t)
        angle = np.full(len(t), self.ends[0][_TABLE])
        speed, gain = np.zeros(len(t)), np.zeros(len(t))
        begin = 0.0
        for sense, law in self.turns:
            rows = law(np.clip(t - begin, 0.0, law.duration))
            on = (t >= begin) & (t <= begin + law.duration)
            angle += sense * rows[:, 0]
            speed[on], gain[on] = sense * rows[on, 1], sense * rows[on, 2]
            begin += law.duration
        q[:, _TABLE], qd[:, _TABLE], qdd[:, _TABLE] = angle, speed, gain
        return q, qd, qdd


def path_motion(cell: Cell, stop: Stop) -> PathMotion:
    """The motion of a path.

    Raises:
        TimingError: ways and dwells do not go together, or the table leaves its range.
    """
    name = ", ".join(stop.viewpoints)
    if len(stop.dwells) != len(stop.ways) + 1:
        raise TimingError(f"path {name}: {len(stop.ways)} ways and {len(stop.dwells)} dwells")
    ways = tuple(way_law(cell, way) for way in stop.ways)
    leaves, t = [], stop.dwells[0]
    for (_, law), dwell in zip(ways, stop.dwells[1:], strict=True):
        leaves.append(t)
        t += law.duration + dwell
    turns = tuple(
        (float(np.sign(turn)), table_law(cell, abs(turn))) for turn in stop.turns if abs(turn) > _LEAST_TURN
    )
    at = float(stop.q_in[_TABLE]) + np.concatenate([[0.0], np.cumsum(stop.turns)])
    if at.min() < cell.q_min[_TABLE] - 1e-6 or at.max() > cell.q_max[_TABLE] + 1e-6:
        raise TimingError(
            f"path {name}: the table leaves its range", joint=cell.joint_names[_TABLE],
            value=float(np.abs(at).max()), limit=float(cell.q_max[_TABLE]),
        )  # fmt: skip
    end = np.array(stop.ways[-1][-1] if stop.ways else stop.q_in, dtype=float)
    end[_TABLE] = float(stop.q_in[_TABLE]) + sum(sense * law.pieces[-1, 0] for sense, law in turns)
    table = sum(law.duration for _, law in turns)
    arm = sum(stop.dwells) + sum(law.floor for _, law in ways)
    return PathMotion(
        viewpoints=stop.viewpoints, ends=(np.array(stop.q_in, dtype=float), end), ways=ways,
        leaves=tuple(leaves), turns=turns, duration=max(t, table),
        floor=max(arm, _table_floor(cell, stop.turns)),
    )  # fmt: skip


def _table_floor(cell: Cell, turns: Sequence[float]) -> float:
    """How long the table's turns take without a jerk limit [s]."""
    limits, angle = limits_of(cell, np.inf), np.abs(turns)
    v, a = float(limits.v[_TABLE]), float(limits.a[_TABLE])
    return float(np.where(angle > v * v / a, angle / v + v / a, 2.0 * np.sqrt(angle / a)).sum())


def turns_in(cell: Cell, seconds: float, angle: float, sense: float, first: float) -> tuple[float, ...]:
    """The table's turns [rad], as far as it comes in a time, back and forth inside its range.

    Args:
        cell: the table's limits and range.
        seconds: how long it may take [s].
        angle: where the table stands [rad].
        sense: in which it sets out, +1 or -1.
        first: after how far it turns back for the first time [rad].
    """
    low, high = float(cell.q_min[_TABLE]) + SPARE_RAD, float(cell.q_max[_TABLE]) - SPARE_RAD
    turns: list[float] = []
    while seconds > 0.2:
        room = high - angle if sense > 0 else angle - low
        room = min(room, first) if not turns else room
        turn = min(room, _angle_within(cell, seconds))
        if turn > _LEAST_TURN:
            turns.append(sense * turn)
            seconds -= table_law(cell, turn).duration
            angle += sense * turn
        elif turns and room > _LEAST_TURN:
            break
        else:
            first = np.inf
            turns.append(0.0)
        sense = -sense
        if len(turns) > 40:
            break
    return tuple(turn for turn in turns if turn)


def _angle_within(cell: Cell, seconds: float) -> float:
    """The greatest turn of the table from rest to rest in a time [rad]."""
    low, high = 0.0, float(cell.v_max[_TABLE]) * seconds
    limits = limits_of(cell, np.inf)
    v, a, j = (0.9994 * float(x[_TABLE]) for x in (limits.v, limits.a, limits.j))
    for _ in range(50):
        middle = 0.5 * (low + high)
        if middle > 0 and float(jerk_limited_seconds(middle, v, a, j)) <= seconds:
            low = middle
        else:
            high = middle
    return low
