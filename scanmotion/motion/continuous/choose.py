"""A continuous motion over a known surface: nodes, search, realisation, and the search again with what the
realisation has shown.

What comes out is free of collisions and inside all limits; what it sees was estimated, and is for the twin to
say.
"""

from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.core.scanner import Scanner
from scanmotion.core.tour import Stop
from scanmotion.motion.continuous.nodes import nodes_from, swept_clearance
from scanmotion.motion.continuous.options import ContinuousOptions
from scanmotion.motion.continuous.realise import Realised, Ways, blocked_at, realised
from scanmotion.motion.continuous.search import (
    Choice,
    Nodes,
    TableTurning,
    Weighing,
    annealed,
    turn_masks,
)
from scanmotion.motion.timing.path import SPARE_RAD, PathMotion
from scanmotion.sensing.sight import Sight, masks_of, sight_from, unpacked
from scanmotion.sensing.visibility import Scene

_TABLE = 6
_COARSE_NODES, _COARSE_ANGLES, _COARSE_CELLS = 240, 12, 24
_SORT_CELLS = 8


@dataclass(frozen=True, eq=False, kw_only=True)
class Continuous:
    """A motion that can be driven, and where the scanner passes."""

    stop: Stop
    motion: PathMotion
    passes: tuple[float, ...]
    """When the scanner is at each of its viewpoints [s]."""
    X_OS: np.ndarray
    """Its pose there, shape (k, 4, 4)."""
    choice: Choice


class ContinuousSearch:
    """The nodes of a cell and what they see, searched as often as is wanted."""

    def __init__(
        self,
        cell: Cell,
        clearance: Clearance,
        scene: Scene,
        scanner: Scanner,
        *,
        points: np.ndarray,
        normals: np.ndarray,
        poses: np.ndarray,
        start_q: np.ndarray,
        options: ContinuousOptions,
    ) -> None:
        """Finds nodes, and the places that decide.

        Args:
            cell: the cell, with the part.
            clearance: its checker.
            scene: what blocks sight.
            scanner: field, range, incidence, baseline.
            points: places drawn evenly on the surface in O, shape (m, 3) [m].
            normals: outward unit normals, shape (m, 3).
            poses: scanner poses about the table at azimuth zero, shape (n, 4, 4).
            start_q: where the programme stands, shape (7,) [rad].
            options: how hard to search.
        """
        self.cell, self._clearance, self.options = cell, clearance, options
        self.start_q = np.asarray(start_q, dtype=float)
        swept = swept_clearance(cell)
        self.nodes = nodes_from(cell, swept, self.start_q, poses, azimuths=np.deg2rad(options.azimuths_deg))
        self._ways = Ways(cell, swept, self.nodes, float(self.start_q[_TABLE]))
        hard, easy, self._stands_for = _places(scene, scanner, points, normals, self.nodes, options)
        self._hard, both = len(hard), np.concatenate([hard, easy])
        self.sight = sight_from(scene, scanner, points[both], normals[both])
        self.turns = turn_masks(self.sight, self.nodes)
        limits = (float(x[_TABLE]) for x in (cell.v_max, cell.a_max, cell.j_max))
        v, a, j = limits
        self._drive = TableTurning(
            speed=v, ramp=v / a + a / j, start=float(self.start_q[_TABLE]),
            low=float(cell.q_min[_TABLE]) + SPARE_RAD,
            high=float(cell.q_max[_TABLE]) - SPARE_RAD,
        )  # fmt: skip

    def found(
        self, price: float, *, rng: np.random.Generator, longest: float = np.inf, begin: Choice | None = None
    ) -> Continuous | None:
        """The best motion found at a price; None where none can be driven.

        Args:
            price: seconds that the whole surface is worth [s].
            rng: source of the random numbers.
            longest: what the programme may take [s].
            begin: a choice to begin with.
        """
        options = self.options
        weighing = Weighing(
            price=price, twice=options.twice, longest=min(longest, 1e6), total=options.places,
            hard=self._hard, easy=self._stands_for,
        )  # fmt: skip
        choice, best = begin, None
        hot, work = (4.0 if begin is None else 1.5), options.evaluations
        for _ in range(options.rounds):
            choice = annealed(
                self.nodes, self.sight, self.turns, self._drive, weighing,
                begin=choice, evaluations=work, hot=hot, rng=rng,
            )  # fmt: skip
            hot, work = 0.5, options.again
            if len(choice.nodes) < 2:
                return best
            made = realised(self.cell, self._ways, choice, self.start_q)
            off = self._learn(made)
            if made.motion is None or made.stop is None:
                continue
            blocked = blocked_at(self.cell, self._clearance, made.motion)
            if blocked is not None:
                self._forbid(made, blocked)
                continue
            best = self._placed(made, choice)
            if off < 1.0:
                break
        return best

    def _learn(self, made: Realised) -> float:
        """Takes over how long the ways take; the sum of what was wrong before [s]."""
        seconds, off = self.nodes.seconds, 0.0
        for (a, b), taken in made.seconds.items():
            off += abs(seconds[a, b] - taken) if np.isfinite(taken) else 10.0
            seconds[a, b] = seconds[b, a] = taken
        return off

    def _forbid(self, made: Realised, blocked: float) -> None:
        """Takes out the ways that the arm is on when it is blocked: they are clear of what the part sweeps,
        but corners are rounded where a node is passed.
        """
        assert made.motion is not None
        group = max(int(np.searchsorted(made.motion.leaves, blocked, side="right")) - 1, 0)
        for a, b in made.groups[group]:
            self.nodes.seconds[a, b] = self.nodes.seconds[b, a] = np.inf

    def _placed(self, made: Realised, choice: Choice) -> Continuous:
        assert made.motion is not None and made.stop is not None
        q = made.motion(np.array(made.passes))[0]
        return Continuous(
            stop=made.stop, motion=made.motion, passes=made.passes, X_OS=scanner_in_object(self.cell, q),
            choice=choice,
        )  # fmt: skip


def _places(
    scene: Scene,
    scanner: Scanner,
    points: np.ndarray,
    normals: np.ndarray,
    nodes: Nodes,
    options: ContinuousOptions,
) -> tuple[np.ndarray, np.ndarray, float]:
    """The places that the search looks at, by index: those that fewest nodes see, of those that any sees, and
    every so many of the rest; and for how many each of these stands.
    """
    sight: Sight = sight_from(scene, scanner, points, normals, cells=_COARSE_CELLS)
    some = nodes.Y[1 :: max(1, len(nodes.Y) // _COARSE_NODES)]
    at = 2 * np.pi * np.arange(_COARSE_ANGLES) / _COARSE_ANGLES
    seen = masks_of(sight, some, at)
    share = unpacked(np.bitwise_or.reduce(seen, axis=1), len(points)).mean(axis=0)
    order = np.argsort(share, kind="stable")
    order = order[share[order] > 0.0]
    few = 64 * (min(options.hard, len(order)) // 64)
    hard, rest = order[:few], order[few:]
    easy = rest[:: max(1, len(rest) // options.easy)]
    stands_for = len(rest) / max(len(easy), 1)
    return _side_by_side(points, normals, hard), _side_by_side(points, normals, easy), stands_for


def _side_by_side(points: np.ndarray, normals: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Neighbours next to each other: the tests of a frame then mostly go the same way."""
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cell = np.floor((points[which] - low) / size * (_SORT_CELLS - 0.01)).astype(int)
    side = (normals[which] > 0) @ np.array([1, 2, 4])
    return which[np.lexsort((cell[:, 0], cell[:, 1], cell[:, 2], side))]


def numbered_views(found: Continuous, names: tuple[str, ...]) -> Continuous:
    """The same with other ids of its viewpoints."""
    return replace(
        found, stop=replace(found.stop, viewpoints=names), motion=replace(found.motion, viewpoints=names)
    )
