"""From chosen nodes to ways of the arm: straight for the scanner, in one branch, clear of all that turns."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import branches
from scanmotion.core.tour import Stop
from scanmotion.motion.continuous.search import Choice, Nodes
from scanmotion.motion.timing.helix import way_law
from scanmotion.motion.timing.path import PathMotion, path_motion, turns_in
from scanmotion.motion.timing.spline import STEP_M, STEP_RAD
from scanmotion.motion.transit.drive import positions, transit_spline
from scanmotion.motion.transit.plan import samples_free
from scanmotion.motion.transit.straight_line import chord

_TABLE = 6
_JUMP_RAD = 4 * STEP_RAD
"""A greater joint step between neighbouring points of a way is another branch of the arm [rad]."""
_PASSING_S = 0.3
"""A node at which the arm would stay for less is passed without a rest [s]."""
_SAMPLE_S = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class Realised:
    """A choice as a motion of arm and table, or the ways that cannot be driven."""

    stop: Stop | None
    motion: PathMotion | None
    passes: tuple[float, ...]
    """When the scanner is at each node but the first [s]."""
    seconds: dict[tuple[int, int], float]
    """How long each way takes, infinite where it is blocked, by its two nodes [s]."""


class Ways:
    """Ways of the arm between nodes, made once each."""

    def __init__(self, cell: Cell, clearance: Clearance, nodes: Nodes, table: float) -> None:
        """`clearance` is that of all that the part sweeps; `table` is the table's angle at the start."""
        self._cell, self._clearance, self.nodes, self._table = cell, clearance, nodes, table
        self._made: dict[tuple[int, int], np.ndarray | None] = {}

    def __call__(self, a: int, b: int) -> np.ndarray | None:
        """The polyline (k, 7) from node a to node b; None where it is blocked."""
        if (a, b) not in self._made:
            self._made[a, b] = self._way(a, b)
            made = self._made[a, b]
            self._made[b, a] = None if made is None else made[::-1].copy()
        return self._made[a, b]

    def _way(self, a: int, b: int) -> np.ndarray | None:
        q = np.column_stack([self.nodes.q[[a, b]], np.full(2, self._table)])
        for way in (self._straight(a, b, q), chord(self._cell, q[0], q[1])):
            if way is not None:
                path = transit_spline(self._cell, way)
                at = np.linspace(0.0, path.end, 2 * round(path.end) + 1)
                if samples_free(self._cell, self._clearance, path(at))[0]:
                    return way
        return None

    def _straight(self, a: int, b: int, q: np.ndarray) -> np.ndarray | None:
        """The scanner on a straight line, turning evenly, by the inverse kinematics of one branch."""
        Y = self.nodes.Y[[a, b]]
        length = float(np.linalg.norm(Y[1, :3, 3] - Y[0, :3, 3]))
        n = int(np.ceil(max(length / STEP_M, np.abs(q[1] - q[0]).max() / STEP_RAD, 4.0)))
        f = np.linspace(0.0, 1.0, n + 1)
        X = np.tile(np.eye(4), (n + 1, 1, 1))
        X[:, :3, 3] = Y[0, :3, 3] + f[:, None] * (Y[1, :3, 3] - Y[0, :3, 3])
        X[:, :3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(Y[:, :3, :3]))(f).as_matrix()
        solved = branches(self._cell, self._cell.X_WT @ self._cell.X_TO @ X)
        way = np.empty((n + 1, 7))
        way[:] = q[0]
        for k in range(1, n + 1):
            mine = solved.q[solved.pose_index == k]
            if len(mine) == 0:
                return None
            off = np.abs(mine - way[k - 1, :6]).max(axis=1)
            best = int(off.argmin())
            if off[best] > _JUMP_RAD:
                return None
            way[k, :6] = mine[best]
        if np.abs(way[-1] - q[1]).max() > 1e-4:
            return None
        way[-1] = q[1]
        return way


def realised(cell: Cell, ways: Ways, choice: Choice, start_q: np.ndarray, names: Sequence[str]) -> Realised:
    """The choice as a motion; a node at which the arm hardly stays is passed without a rest.

    Args:
        cell: limits of the axes, scanning speed.
        ways: between the nodes.
        choice: what was chosen.
        start_q: where the programme stands, shape (7,) [rad].
        names: ids of the viewpoints, one for each node but the first.
    """
    pairs = [(int(a), int(b)) for a, b in zip(choice.nodes[:-1], choice.nodes[1:], strict=True)]
    made = [ways(a, b) for a, b in pairs]
    seconds = {
        pair: np.inf if way is None else way_law(cell, way)[1].duration
        for pair, way in zip(pairs, made, strict=True)
    }
    if any(way is None for way in made):
        return Realised(stop=None, motion=None, passes=(), seconds=seconds)
    groups: list[list[np.ndarray]] = []
    dwells = [float(choice.dwell[0])]
    for n, way in enumerate(made):
        assert way is not None
        if n > 0 and choice.dwell[n] < _PASSING_S:
            groups[-1].append(way[1:])
        else:
            groups.append([way])
            if n > 0:
                dwells.append(float(choice.dwell[n]))
    dwells.append(float(choice.dwell[-1]))
    arm = tuple(np.concatenate(group) for group in groups)
    laws = [way_law(cell, way)[1] for way in arm]
    total = sum(dwells) + sum(law.duration for law in laws)
    turns = turns_in(cell, total, float(start_q[_TABLE]), choice.sense, choice.first)
    q_out = np.array(arm[-1][-1], dtype=float)
    q_out[_TABLE] = start_q[_TABLE] + sum(turns)
    stop = Stop(
        viewpoints=tuple(names), kind="path", q_in=np.array(start_q, dtype=float), q_out=q_out,
        ways=arm, turns=turns, dwells=tuple(dwells),
    )  # fmt: skip
    motion = path_motion(cell, stop)
    return Realised(
        stop=replace(stop, q_out=motion.ends[1]), motion=motion,
        passes=tuple(_passes(cell, motion, ways.nodes, choice, [len(g) for g in groups])), seconds=seconds,
    )  # fmt: skip


def _passes(cell: Cell, motion: PathMotion, nodes: Nodes, choice: Choice, counts: list[int]) -> list[float]:
    """When the arm is in the middle of its stay at each node, or nearest to a node that it passes [s]."""
    places = (cell.X_WT @ cell.X_TO @ nodes.Y[choice.nodes[1:]])[:, :3, 3]
    ends = [*motion.leaves[1:], motion.duration]
    found: list[float] = []
    for (path, law), leave, count, end in zip(motion.ways, motion.leaves, counts, ends, strict=True):
        t = np.arange(0.0, law.duration, _SAMPLE_S)
        p = positions(cell, path(law(t)[:, 0]))
        after = 0
        for _ in range(count - 1):
            away = np.linalg.norm(p[after:] - places[len(found)], axis=1)
            after += int(away.argmin())
            found.append(leave + float(t[after]))
        found.append(0.5 * (leave + law.duration + end))
    # The trajectory is sampled on whole hundredths: there the scanner is exactly where it is said to be.
    return [round(x / _SAMPLE_S) * _SAMPLE_S for x in found]


def free(cell: Cell, clearance: Clearance, motion: PathMotion) -> bool:
    """Whether the motion keeps all clearances to the part as it turns, between its samples too."""
    t = np.append(np.arange(0.0, motion.duration, _SAMPLE_S), motion.duration)
    return samples_free(cell, clearance, motion(t)[0])[0]
