"""A helix: neighbouring revolutions in one, the arm going on to the next place while the table turns.

The scanner's speed in W is the arm's alone and the table has an axis of its own, so the two are timed apart:
the table turns by Ruckig's law from rest to rest, and in its even middle the arm follows each way from place
to place by the law of jerk_limited.py at the scanning speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.core.errors import TimingError
from scanmotion.core.tour import Stop
from scanmotion.core.trajectory import OperationKind
from scanmotion.motion.profile.jerk_limited import RuckigLaw, TimeLaw, ruckig_law
from scanmotion.motion.profile.speed_profile import MARGIN
from scanmotion.motion.profile.spline import JointSpline
from scanmotion.motion.timing.ways import Way, driven_ways
from scanmotion.motion.transit.drive import limits_of, positions, transit_law

TURN = 2 * np.pi
BORDER_S = 0.02
"""The table turns on so long for each neighbour, that a whole turn is counted by 10 ms samples too [s]."""
NEAREST_M = 0.01
"""Places nearer to each other than this are not joined: which of them the scanner is at must be plain [m]."""
_TABLE = 6
_FINE = 2000


@dataclass(frozen=True, eq=False, kw_only=True)
class HelixMotion:
    """A helix before it is placed in time; called as timing's Motion is."""

    viewpoints: tuple[str, ...]
    ends: tuple[np.ndarray, np.ndarray]
    """First and last configuration, shape (7,) [rad]."""
    table: RuckigLaw
    """The table's angle, counted from the start [rad]."""
    ways: tuple[Way, ...]
    leaves: tuple[float, ...]
    """When the arm sets out on each way [s]."""
    duration: float
    """[s]"""
    floor: float
    """Duration without a jerk limit [s]."""
    kind: OperationKind = "helix"

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations, each (n, 7), at times t; at rest after `duration`."""
        q, qd, qdd = driven_ways(self.ends[0], self.ways, self.leaves, t)
        sense = np.sign(self.ends[1][_TABLE] - self.ends[0][_TABLE])
        angle, speed, gain = self.table(np.minimum(t, self.duration)).T[:3]
        q[:, _TABLE] = self.ends[0][_TABLE] + sense * angle
        qd[:, _TABLE], qdd[:, _TABLE] = sense * speed, sense * gain
        return q, qd, qdd


def helix_motion(cell: Cell, stop: Stop) -> HelixMotion:
    """The motion of a helix.

    Raises:
        TimingError: the table's ramps leave no time for the arm's ways, or the turns do not add up.
    """
    name = ", ".join(stop.viewpoints)
    if len(stop.turns) != len(stop.ways) + 1 or not stop.ways:
        raise TimingError(f"helix {name}: {len(stop.ways)} ways and {len(stop.turns)} turns")
    table = table_law(cell, abs(float(stop.q_out[_TABLE] - stop.q_in[_TABLE])))
    speed, even, end = float(table.pieces[3, 1]), float(table.knots[3]), float(table.knots[4])
    ways = tuple(way_law(cell, way) for way in stop.ways)
    at, leaves = even + (stop.turns[0] - float(table.pieces[3, 0])) / speed, []
    for (_, law), turn in zip(ways, stop.turns[1:], strict=True):
        leaves.append(at)
        at += law.duration + turn / speed
    arrives = leaves[-1] + ways[-1][1].duration
    over = table.duration - (at + even - float(table.pieces[3, 0]) / speed)
    if leaves[0] < even - 1e-6 or arrives > end + 1e-6 or abs(over) > 1e-6:
        raise TimingError(f"helix {name}: its turns do not fit the table's {table.duration:.3f} s")
    limits = limits_of(cell, np.inf)
    return HelixMotion(
        viewpoints=stop.viewpoints, ends=(np.asarray(stop.q_in), np.asarray(stop.q_out)), table=table,
        ways=ways, leaves=tuple(leaves), duration=table.duration,
        floor=float(table.pieces[-1, 0] / speed + speed / limits.a[_TABLE]),
    )  # fmt: skip


def table_law(cell: Cell, angle: float) -> RuckigLaw:
    """The table's turn by `angle` [rad] from rest to rest."""
    limits = limits_of(cell, np.inf)
    v, a, j = ((1 - MARGIN) * float(x[_TABLE]) for x in (limits.v, limits.a, limits.j))
    return ruckig_law(angle, v, a, j)


def way_law(cell: Cell, way: np.ndarray) -> tuple[JointSpline, TimeLaw]:
    """The curve along the arm's polyline (k, 7) and its law at the scanning speed, the table still."""
    return transit_law(cell, way, tcp=float(cell.settings.process.scan_speed_m_s))


def halves(cell: Cell, way: np.ndarray) -> tuple[float, float]:
    """Seconds until the scanner is as near to the way's end as to its start, and from then on."""
    path, law = way_law(cell, way)
    t = np.linspace(0.0, law.duration, _FINE)
    p = positions(cell, path(law(t)[:, 0]))
    nearer = np.linalg.norm(p - p[-1], axis=1) <= np.linalg.norm(p - p[0], axis=1)
    middle = float(t[int(nearer.argmax())])
    return middle, law.duration - middle


def ramp_angle(cell: Cell) -> float:
    """What the table turns until it is at its greatest speed, which a turn of two whole turns reaches [rad].

    Infinite where it does not reach it within a whole turn.
    """
    table = table_law(cell, 2 * TURN)
    return float(table.pieces[3, 0]) if table.knots[4] - table.knots[3] > 1e-6 else np.inf


def turns_of(
    ways: Sequence[tuple[float, float]], overlap: float, speed: float, ramp: float
) -> tuple[float, ...]:
    """By how much the table turns while the arm stands at each of the places [rad].

    Together with `overlap` of the ways' halves next to a place that is at least a whole turn.

    Args:
        ways: seconds of both halves of each way, see `halves`.
        overlap: share of the ways that counts, 0..1; at 0 the arm stands still for a whole turn.
        speed: the table's [rad/s].
        ramp: least turn at the first and the last place, where the table's ramps are [rad].
    """
    k = len(ways) + 1
    beside = np.zeros(k)
    beside[:-1] += [a for a, _ in ways]
    beside[1:] += [b for _, b in ways]
    borders = np.full(k, 2.0)
    borders[[0, -1]] = 1.0
    least = np.zeros(k)
    least[[0, -1]] = ramp
    turns = TURN + speed * BORDER_S * borders - overlap * speed * beside
    return tuple(float(x) for x in np.maximum(turns, least))
