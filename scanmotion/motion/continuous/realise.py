"""From chosen nodes to ways of the arm: straight for the scanner, in one branch, clear of all that turns."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import branches, scanner_poses
from scanmotion.core.tour import Stop
from scanmotion.motion.continuous.search import Choice, Nodes
from scanmotion.motion.profile.spline import STEP_M, STEP_RAD
from scanmotion.motion.timing.helix import way_law
from scanmotion.motion.timing.path import PathMotion, path_motion, turns_in
from scanmotion.motion.transit.drive import transit_spline
from scanmotion.motion.transit.plan import samples_free
from scanmotion.motion.transit.straight_line import chord

_TABLE = 6
_JUMP_RAD = 4 * STEP_RAD
"""A greater joint step between neighbouring points of a way is another branch of the arm [rad]."""
_ASIDE_RAD = np.deg2rad(8.0)
"""By how much its direction may be farther from those at both ends than these are from each other [rad]."""
_PASSING_S = 0.3
"""A node at which the arm would stay for less is passed without a rest [s]."""
_SAMPLE_S = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class Realised:
    """A choice as a motion of arm and table, or the ways that cannot be driven."""

    stop: Stop | None
    motion: PathMotion | None
    passes: tuple[float, ...]
    """When the arm is in the middle of each of its rests, the last one being the end [s]."""
    groups: tuple[tuple[tuple[int, int], ...], ...]
    """Pairs of nodes of the ways between two rests."""
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
            if way is not None and self._looks_between(a, b, way):
                path = transit_spline(self._cell, way)
                at = np.linspace(0.0, path.end, 2 * round(path.end) + 1)
                if samples_free(self._cell, self._clearance, path(at))[0]:
                    return way
        return None

    def _looks_between(self, a: int, b: int, way: np.ndarray) -> bool:
        """Whether the scanner looks on the way where the search takes it to look."""
        z = scanner_poses(self._cell, way)[:, :3, 2]
        first, last = (np.arccos(np.clip(z @ end, -1.0, 1.0)) for end in (z[0], z[-1]))
        return bool((first + last).max() - first[-1] < _ASIDE_RAD)

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


def realised(cell: Cell, ways: Ways, choice: Choice, start_q: np.ndarray) -> Realised:
    """The choice as a motion; a node at which the arm hardly stays is passed without a rest.

    Args:
        cell: limits of the axes, scanning speed.
        ways: between the nodes.
        choice: what was chosen.
        start_q: where the programme stands, shape (7,) [rad].
    """
    pairs = [(int(a), int(b)) for a, b in zip(choice.nodes[:-1], choice.nodes[1:], strict=True)]
    made = [ways(a, b) for a, b in pairs]
    seconds = {
        pair: np.inf if way is None else way_law(cell, way)[1].duration
        for pair, way in zip(pairs, made, strict=True)
    }
    if any(way is None for way in made):
        return Realised(stop=None, motion=None, passes=(), groups=(), seconds=seconds)
    groups: list[list[np.ndarray]] = []
    tied: list[list[tuple[int, int]]] = []
    dwells = [float(choice.dwell[0])]
    for n, way in enumerate(made):
        assert way is not None
        if n > 0 and choice.dwell[n] < _PASSING_S:
            groups[-1].append(way[1:])
            tied[-1].append(pairs[n])
        else:
            groups.append([way])
            tied.append([pairs[n]])
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
        viewpoints=tuple(str(k + 1) for k in range(len(arm))), kind="path",
        q_in=np.array(start_q, dtype=float), q_out=q_out, ways=arm, turns=turns, dwells=tuple(dwells),
    )  # fmt: skip
    motion = path_motion(cell, stop)
    return Realised(
        stop=replace(stop, q_out=motion.ends[1]), motion=motion,
        passes=tuple(_rests(motion)), groups=tuple(tuple(pairs) for pairs in tied), seconds=seconds,
    )  # fmt: skip


def _rests(motion: PathMotion) -> list[float]:
    """When the arm is in the middle of its rest after each way [s].

    On whole hundredths: the trajectory is sampled there, so the scanner is exactly where it is said to be.
    """
    arrives = [leave + law.duration for (_, law), leave in zip(motion.ways, motion.leaves, strict=True)]
    ends = [*motion.leaves[1:], motion.duration]
    return [round(0.5 * (a + b) / _SAMPLE_S) * _SAMPLE_S for a, b in zip(arrives, ends, strict=True)]


def blocked_at(cell: Cell, clearance: Clearance, motion: PathMotion) -> float | None:
    """When the motion first comes too near to something, the part as it turns too [s]; None where it is
    clear, between its samples too.
    """
    t = np.append(np.arange(0.0, motion.duration, _SAMPLE_S), motion.duration)
    clear, k, _ = samples_free(cell, clearance, motion(t)[0])
    return None if clear else float(t[k])
