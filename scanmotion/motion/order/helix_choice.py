"""Which neighbouring revolutions of a tour become helices, from which table angles, in the least seconds."""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.tour import Stop
from scanmotion.geometry.rest_to_rest import jerk_limited_seconds
from scanmotion.motion.timing.helix import (
    NEAREST_M,
    TURN,
    halves,
    helix_motion,
    ramp_angle,
    table_law,
    turns_of,
    way_law,
)
from scanmotion.motion.transit.drive import positions
from scanmotion.motion.transit.plan import samples_free
from scanmotion.motion.transit.straight_line import chord

_TABLE = 6
_KEPT = 300
"""Beginnings of a tour that are looked further into."""
_SAMPLE_S = 0.01
_IDLE_S_PER_RAD = 1e-4
"""Charged for turns of the table that cost nothing: of two equal ways the quieter is taken [s/rad]."""
_STRAIGHT_M = 1e-3
"""How far the scanner may pass beside the straight line on a way [m]."""
_ASIDE_RAD = np.deg2rad(4.0)
"""By how much its direction may be farther from those at both ends than these are from each other [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Begun:
    """The first stops of a tour, joined."""

    cost: float
    """[s]"""
    angle: float
    """Where the table stands [rad]."""
    stops: tuple[Stop, ...] = ()


def joined_stops(
    cell: Cell,
    clearance: Clearance,
    start_q: np.ndarray,
    stops: Sequence[Stop],
    way_seconds: Sequence[float],
    overlap: float,
) -> tuple[Stop, ...]:
    """The stops in their order, neighbouring revolutions joined where that is free and saves seconds.

    Args:
        cell: limits, speeds and the table's range.
        clearance: the collision checker of the cell.
        start_q: where the tour starts, shape (7,) [rad].
        stops: revolutions and others.
        way_seconds: how long the transit to each stop takes [s].
        overlap: share of the arm's ways that counts for the whole turn of each viewpoint, 0..1.
    """
    ways = [_way(cell, a, b) for a, b in pairwise(stops)]
    closed = {n for n, way in enumerate(ways) if way is None}
    while True:
        made = _fastest(cell, float(start_q[_TABLE]), stops, ways, way_seconds, closed, overlap)
        blocked = _blocked(cell, clearance, made)
        if blocked is None:
            return made
        closed.add(blocked)


def _way(cell: Cell, a: Stop, b: Stop) -> np.ndarray | None:
    """The arm's way between two revolutions with the scanner on a straight line in W; None for others."""
    if a.kind != "revolution" or b.kind != "revolution":
        return None
    ends = np.array([a.q_out, b.q_in], dtype=float)
    ends[:, _TABLE] = 0.0
    p = positions(cell, ends)
    way = chord(cell, ends[0], ends[1])
    if way is None or np.linalg.norm(p[1] - p[0]) < NEAREST_M:
        return None
    path, law = way_law(cell, way)
    X_WS = scanner_poses(cell, path(law(np.linspace(0.0, law.duration, 400))[:, 0]))
    p, z = X_WS[:, :3, 3], X_WS[:, :3, 2]
    along = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
    beside = np.linalg.norm((p - p[0]) - ((p - p[0]) @ along)[:, None] * along, axis=1).max()
    first, last = (np.arccos(np.clip(z @ end, -1.0, 1.0)) for end in (z[0], z[-1]))
    # A wrist that changes over on the way would swing the scanner away from the part.
    return way if beside < _STRAIGHT_M and (first + last).max() - first[-1] < _ASIDE_RAD else None


def _fastest(
    cell: Cell,
    angle: float,
    stops: Sequence[Stop],
    ways: Sequence[np.ndarray | None],
    way_seconds: Sequence[float],
    closed: Set[int],
    overlap: float,
) -> tuple[Stop, ...]:
    """The best of what a search over the joints and the table's angles keeps, stop by stop."""
    begun: list[list[_Begun]] = [[] for _ in range(len(stops) + 1)]
    begun[0] = [_Begun(cost=0.0, angle=angle)]
    for i in range(len(stops)):
        best: dict[int, _Begun] = {}
        for b in sorted(begun[i], key=lambda b: b.cost):
            best.setdefault(round(b.angle * 1e3), b)
        kept = list(best.values())[:_KEPT]
        j = i
        while True:
            piece = _joined(cell, stops[i : j + 1], ways[i:j], overlap)
            if piece is not None:
                begun[j + 1] += [n for b in kept for n in _going_on(cell, b, piece, way_seconds[i])]
            if j + 1 == len(stops) or j in closed:
                break
            j += 1
    return min(begun[-1], key=lambda b: b.cost).stops


def _joined(
    cell: Cell, stops: Sequence[Stop], ways: Sequence[np.ndarray | None], overlap: float
) -> Stop | None:
    """Some neighbouring revolutions as one helix that starts at 0; one stop is returned as it is.

    None where the table's ramps are longer than a turn.
    """
    if len(stops) == 1:
        return stops[0]
    ramp, speed = ramp_angle(cell), float(table_law(cell, 2 * TURN).pieces[3, 1])
    if ramp > TURN:
        return None
    arms = tuple(way for way in ways if way is not None)
    turns = turns_of([halves(cell, way) for way in arms], overlap, speed, ramp)
    moving = sum(way_law(cell, way)[1].duration for way in arms)
    q_in, q_out = np.array(stops[0].q_in), np.array(stops[-1].q_out)
    q_in[_TABLE], q_out[_TABLE] = 0.0, sum(turns) + speed * moving
    return Stop(
        viewpoints=tuple(v for s in stops for v in s.viewpoints), kind="helix", q_in=q_in, q_out=q_out,
        ways=arms, turns=turns,
    )  # fmt: skip


def _going_on(cell: Cell, begun: _Begun, stop: Stop, seconds: float) -> list[_Begun]:
    """The ways to make `stop` next, its transit taking `seconds` or what the table needs."""
    model = cell.v_max[_TABLE], cell.a_max[_TABLE], cell.j_max[_TABLE]
    length = float(stop.q_out[_TABLE] - stop.q_in[_TABLE])
    own = float(jerk_limited_seconds(abs(length), *model)) if abs(length) > 0.0 else 0.0
    found = []
    for start, end in _table_ways(cell, begun.angle, stop, seconds):
        turn = abs(start - begun.angle)
        way = max(seconds, float(jerk_limited_seconds(turn, *model))) if turn > 1e-9 else seconds
        q_in, q_out = np.array(stop.q_in), np.array(stop.q_out)
        q_in[_TABLE], q_out[_TABLE] = start, end
        placed = replace(stop, q_in=q_in, q_out=q_out)
        cost = begun.cost + way + own + _IDLE_S_PER_RAD * turn
        found.append(_Begun(cost=cost, angle=end, stops=(*begun.stops, placed)))
    return found


def _table_ways(cell: Cell, angle: float, stop: Stop, seconds: float) -> list[tuple[float, float]]:
    """Where the table may start and end: any angle for what turns, its own for the rest."""
    if stop.kind not in ("revolution", "helix"):
        return [(float(stop.q_in[_TABLE]), float(stop.q_out[_TABLE]))]
    length = abs(float(stop.q_out[_TABLE] - stop.q_in[_TABLE]))
    low, high = float(cell.q_min[_TABLE]), float(cell.q_max[_TABLE])
    free = _free_turn(cell, seconds)
    found = []
    for sense in (1.0, -1.0):
        first, last = (low, high - length) if sense > 0 else (low + length, high)
        if first > last:
            continue
        wanted = np.array([angle, angle - free, angle + free, first, last])
        starts = np.unique(np.round(np.clip(wanted[np.isfinite(wanted)], first, last), 9))
        found += [(float(s), float(s) + sense * length) for s in np.clip(starts, first, last)]
    return found


def _free_turn(cell: Cell, seconds: float) -> float:
    """About what the table turns in the time that the arm needs anyway [rad]."""
    angles = np.linspace(0.0, TURN, 200)
    took = jerk_limited_seconds(angles, cell.v_max[_TABLE], cell.a_max[_TABLE], cell.j_max[_TABLE])
    return 0.9 * float(angles[took <= seconds].max(initial=0.0))


def _blocked(cell: Cell, clearance: Clearance, stops: Sequence[Stop]) -> int | None:
    """The first stop that a helix may not be joined to the next at, for the way there is blocked; or None."""
    first = 0
    for stop in stops:
        if stop.kind == "helix":
            motion = helix_motion(cell, stop)
            t = np.append(np.arange(0.0, motion.duration, _SAMPLE_S), motion.duration)
            free, k, _ = samples_free(cell, clearance, motion(t)[0])
            if not free:
                return first + max(int(np.searchsorted(motion.leaves, t[k] + _SAMPLE_S)) - 1, 0)
        first += len(stop.ways) + 1
    return None
