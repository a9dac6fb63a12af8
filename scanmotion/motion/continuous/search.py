"""The search for a continuous motion: waypoints of the arm and how long it stays, while the table turns on.

A motion is a list of nodes, scanner poses in W that are clear of the part however the table stands, with a
dwell at each. The scanner captures all the time, on the ways too. Simulated annealing lowers

    seconds + price * (share not seen, part of it for what fewer than two of the frames 0.25 s apart see)

over the nodes, their dwells, their order, and where the table turns back. It ends by work done. Frames at a
node come from masks made before, frames on a way from the tables of `sensing.sight`.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.motion.continuous.anneal import MOST, STEP_S, anneal, greedy
from scanmotion.sensing.sight import Sight, masks_of


@dataclass(frozen=True, eq=False, kw_only=True)
class Nodes:
    """Where the arm may stand or pass: node 0 is where the programme begins."""

    q: np.ndarray
    """Arm configurations, shape (n, 6) [rad]."""
    Y: np.ndarray
    """Scanner in O with the table at zero, shape (n, 4, 4)."""
    quaternion: np.ndarray
    """Orientation of each, scalar last, shape (n, 4)."""
    seconds: np.ndarray
    """Time of the way from one to another, rest to rest, infinite where there is none, shape (n, n) [s]."""
    near: np.ndarray
    """Nodes in the order of their nearness to each, shape (n, k)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TableTurning:
    """What the table may do."""

    speed: float
    """Greatest [rad/s]."""
    ramp: float
    """Time to reach it [s]."""
    start: float
    """Where it stands [rad]."""
    low: float
    high: float
    """Its range [rad]; infinite where endless."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Weighing:
    """What is weighed against the seconds."""

    price: float
    """Seconds that the whole surface is worth [s]."""
    twice: float
    """Share of it that is paid only where a place is seen in two frames at least."""
    longest: float
    """Motions that take longer are dear [s]."""
    total: int
    """How many places stand for the whole surface."""
    hard: int
    """The first so many places of the masks, a multiple of 64, stand for themselves."""
    easy: float
    """For how many places each of the others stands."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Choice:
    """A motion that was found."""

    nodes: np.ndarray
    """In order, beginning with node 0, shape (k,)."""
    dwell: np.ndarray
    """How long the arm stays at each, shape (k,) [s]."""
    sense: float
    """Sense in which the table sets out, +1 or -1."""
    first: float
    """After how far it turns back for the first time [rad]."""
    seconds: float
    """Expected duration [s]."""
    missed: float
    """Places not seen."""
    missed_twice: float
    """Places seen in fewer than two frames."""
    cost: float


def turn_masks(sight: Sight, nodes: Nodes, *, angles: int = 12) -> np.ndarray:
    """What each node sees in a whole turn of the table, shape (n, w) uint64."""
    at = 2 * np.pi * np.arange(angles) / angles
    out = np.zeros((len(nodes.Y), sight.words), np.uint64)
    for first in range(0, len(nodes.Y), 256):
        own = slice(first, first + 256)
        seen = masks_of(sight, nodes.Y[own], at)
        out[own] = np.bitwise_or.reduce(seen, axis=1)
    return out


def annealed(
    nodes: Nodes,
    sight: Sight,
    turns: np.ndarray,
    drive: TableTurning,
    weighing: Weighing,
    *,
    begin: Choice | None,
    evaluations: int,
    hot: float = 4.0,
    cold: float = 0.05,
    rng: np.random.Generator,
) -> Choice:
    """Improves a motion; the least costly one that was met.

    Args:
        nodes: where the arm may be.
        sight: of the places that count.
        turns: from `turn_masks`.
        drive: the table.
        weighing: seconds against what is seen.
        begin: a motion to begin with; None for the greedy one.
        evaluations: motions that are looked at.
        hot, cold: first and last temperature [s].
        rng: source of the random numbers.
    """
    table = _table_of(drive)
    weights = np.array(
        [
            weighing.price / weighing.total, weighing.twice, weighing.longest, weighing.hard // 64,
            weighing.easy,
        ]
    )  # fmt: skip
    seq, dwell = np.zeros(MOST, np.int64), np.zeros(MOST, np.int64)
    sense, first = 1.0, min(table[3], table[4])
    if begin is None:
        chosen = greedy(turns, nodes.seconds, weights)
        count = len(chosen)
        seq[:count] = chosen
        dwell[1:count] = round(2 * np.pi / drive.speed / STEP_S)
    else:
        count = len(begin.nodes)
        seq[:count] = begin.nodes
        dwell[:count] = np.round(begin.dwell / STEP_S)
        sense, first = begin.sense, begin.first
    arrays = (
        nodes.Y, nodes.quaternion, nodes.seconds, nodes.near,
        sight.points, sight.normals, sight.open, sight.cells, sight.field,
    )  # fmt: skip
    count, sense, first, result = anneal(
        seq, dwell, count, sense, first, arrays, turns, table, weights, evaluations, hot, cold, rng
    )
    return Choice(
        nodes=seq[:count].copy(), dwell=dwell[:count] * STEP_S, sense=sense, first=first,
        seconds=result[1], missed=float(result[2]), missed_twice=float(result[3]), cost=result[0],
    )  # fmt: skip


def _table_of(drive: TableTurning) -> np.ndarray:
    """speed, ramp, start, room upward, room downward."""
    up = min(drive.high - drive.start, 1e3)
    down = min(drive.start - drive.low, 1e3)
    return np.array([drive.speed, drive.ramp, drive.start, up, down])
