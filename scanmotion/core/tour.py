"""Tour, Stop and Path: the nouns that order, transit and timing hand to one another."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

StopKind = Literal["revolution", "sweep", "dwell", "helix", "path"]
PathMethod = Literal["line", "joint", "planned"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Stop:
    """One thing that the scanner does with the power on, between two transits.

    A revolution turns the table once (q_out is q_in with E1 +-2 pi), a sweep follows `path` with the table
    still, a dwell stays at q_in. A helix is several revolutions in one: the table turns on while the arm goes
    from place to place along `ways`. A path goes along `ways` too and stays at each place for its dwell,
    while the table makes its `turns` one after another; neither waits for the other.
    """

    viewpoints: tuple[str, ...]
    """Ids of the viewpoints served, in the order passed."""
    kind: StopKind
    q_in: np.ndarray
    """Joint positions A1..A6, E1 on arrival, shape (7,) [rad]."""
    q_out: np.ndarray
    """Joint positions on leaving, shape (7,) [rad]."""
    path: np.ndarray | None = None
    """A sweep's dense joint path from q_in to q_out, shape (k, 7) [rad]; None otherwise."""
    ways: tuple[np.ndarray, ...] = ()
    """A helix's arm from each place to the next, polylines (k, 7) with the table's column constant [rad]."""
    turns: tuple[float, ...] = ()
    """By how much a helix's table turns while the arm stands at each of its places; a path's table, one turn
    after another, with their sense [rad]."""
    dwells: tuple[float, ...] = ()
    """How long a path's arm stays where it begins and after each of its ways [s]."""

    @property
    def places(self) -> tuple[np.ndarray, ...]:
        """Where the arm stands, shape (7,) each: on arrival and, in a helix, after each way."""
        return (self.q_in, *(way[-1] for way in self.ways))


@dataclass(frozen=True, eq=False, kw_only=True)
class Tour:
    """The stops in order, and what they are expected to cost."""

    start_q: np.ndarray
    """Where the programme starts, shape (7,) [rad]."""
    stops: tuple[Stop, ...]
    seconds: float
    """Expected duration of all operations, transits as straight edges [s]."""
    floor: float
    """A proven lower bound on the duration of any tour over these viewpoints [s]."""
    unplaced: tuple[tuple[str, str], ...] = ()
    """(id, reason) of the viewpoints that are not in the tour."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Path:
    """A collision-checked polyline in joint space."""

    q: np.ndarray
    """Vertices, straight joint edges between them, shape (k, 7) [rad]."""
    seconds: float
    """Expected duration, rest to rest [s]."""
    method: PathMethod
    """line: the scanner on a straight line in W; joint: one straight joint edge; planned: round obstacles."""
