"""Reach: for each viewpoint its collision-free configurations of arm and table, or why there are none."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.ik.choice import has_closed_form
from scanmotion.cell.kinematics import branches, scanner_in_object, scanner_poses, wrist_shortfall
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.reach.diagnosis import Remedies, Unreachable, cause_of
from scanmotion.motion.reach.ik_candidates import (
    IkCandidates,
    ik_candidates,
    presented,
    table_angles,
    turns_about_z,
)
from scanmotion.motion.reach.slack import SlackSearch, has_slack, seeds_from, variants
from scanmotion.motion.transit_cost import move_matrix, move_model

__all__ = ["Reach", "Unreachable", "reach", "reachable_mask"]

_BLOCK = 64
"""Viewpoints that are looked at together: enough to spread the cost of each call, little enough memory."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Reach:
    """What the cell can do for one viewpoint."""

    viewpoint: Viewpoint
    q: np.ndarray
    """Collision-free configurations, best first, shape (k, 7) [rad]; a revolution's have the table at 0."""
    clearance: np.ndarray
    """Lower bound of the distance to contact beyond the cell's clearances, shape (k,) [m]."""
    manipulability: np.ndarray
    """Least singular value of the arm's Jacobian, shape (k,)."""
    X_OS: np.ndarray
    """Scanner in the object that each configuration gives, shape (k, 4, 4)."""
    unreachable: Unreachable | None = None
    solver: str = ""
    """Which solver found the configurations: ANALYTIC, NUMERIC or RESCUE; empty where there are none."""


ANALYTIC = "analytic"
"""The arm's closed form: every branch and winding."""
NUMERIC = "search"
"""Drake's InverseKinematics from fixed seeds, for an arm without a closed form."""
RESCUE = "Drake, within the slack"
"""Drake's InverseKinematics with a minimum distance, where no exact pose is served."""


@dataclass(frozen=True, kw_only=True)
class ReachOptions:
    """How finely to look."""

    azimuth_step: float = np.deg2rad(10.0)
    """Step of the azimuth at which the table presents the viewpoint to the robot [rad]."""
    azimuth_range: float = np.deg2rad(110.0)
    """Greatest azimuth to either side of the robot that is tried first [rad]."""
    rolls: int = 8
    """Rolls about the optical axis, where the viewpoint leaves it free."""
    most: int = 96
    """Configurations kept for each viewpoint; few are found sooner, as fewer table angles are tried."""
    slack: bool = True
    """Whether to look at other poses within a viewpoint's slack where the exact one cannot be served."""
    remedies: bool = True
    """Whether to look for what would mend an unreachable viewpoint."""


def reach(
    cell: Cell,
    viewpoints: Sequence[Viewpoint],
    *,
    clearance: Clearance | None = None,
    options: ReachOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Reach]:
    """Every viewpoint with its configurations, or with the reason why there is none.

    A station may be served at any table angle, in all branches of the arm and all windings inside the limits.
    A revolution keeps the arm still while the table turns once: its azimuth about the table's axis is free,
    and the arm has to be clear of the part at every angle. Where no exact pose of a station serves, poses
    within its slack do: X_OS of the answer says which.

    Args:
        cell: the cell, with the part.
        viewpoints: what is asked for.
        clearance: the cell's checker; made here where None.
        options: how finely to look.
        progress: told the share done.
    """
    clearance = clearance or Clearance(cell)
    options = options or ReachOptions()
    remedies = Remedies(cell, clearance, _serves_with(options)) if options.remedies else None
    search = SlackSearch(cell, clearance)
    found: list[Reach] = []
    for first in range(0, len(viewpoints), _BLOCK):
        block = _Block(cell, list(viewpoints[first : first + _BLOCK]), clearance, options)
        block.look()
        for n in range(len(block.viewpoints)):
            found.append(block.answer(n, search))
            if progress is not None:
                progress(len(found) / len(viewpoints))
        if remedies is not None:
            found[first:] = _mended(found[first:], remedies)
    return found


def _mended(answers: list[Reach], remedies: Remedies) -> list[Reach]:
    """The answers with what would mend the unreachable ones."""
    changes = iter(remedies.of([a.viewpoint for a in answers if a.unreachable is not None]))
    return [
        a if a.unreachable is None else replace(a, unreachable=a.unreachable.mended_by(next(changes)))
        for a in answers
    ]


def _serves_with(options: ReachOptions) -> Callable[[Cell, Clearance, list[Viewpoint]], np.ndarray]:
    """A coarser look whose poses are all among those of `options`: what it finds, reach finds there."""
    coarse = ReachOptions(
        azimuth_step=3 * options.azimuth_step, azimuth_range=options.azimuth_range,
        rolls=max(options.rolls // 2, 1) if options.rolls % 2 == 0 else options.rolls, most=1,
    )  # fmt: skip

    def serves(cell: Cell, clearance: Clearance, viewpoints: list[Viewpoint]) -> np.ndarray:
        block = _Block(cell, viewpoints, clearance, coarse)
        block.look()
        return np.array([bool(kept) for kept in block.kept])

    return serves


class _Block:
    """Some viewpoints that are looked at together."""

    def __init__(
        self, cell: Cell, viewpoints: list[Viewpoint], clearance: Clearance, options: ReachOptions
    ) -> None:
        self.cell, self.viewpoints, self.clearance, self.options = cell, viewpoints, clearance, options
        step = options.azimuth_step
        self.angles = [table_angles(cell, v.X_OS, step, np.pi) for v in viewpoints]
        self.near = len(table_angles(cell, np.eye(4), step, options.azimuth_range))
        self.kept: list[list[np.ndarray]] = [[] for _ in viewpoints]
        """Free configurations with their singular values, (k, 8)."""
        self.tried: list[list[np.ndarray]] = [[] for _ in viewpoints]
        """Configurations that the fast tier refused, one for each geometry, (k, 8)."""

    def look(self) -> None:
        """Fast tier at ever more table angles; the far side only where the near one serves none."""
        size = max(2, self.options.most // 4)
        first = 0
        while first < max((len(a) for a in self.angles), default=0):
            last = first + size
            if first < self.near:
                last = min(last, self.near)
            todo = [n for n in range(len(self.viewpoints)) if self._wanting(n, first)]
            if not todo:
                break
            self._wave(todo, first, last)
            first, size = last, 2 * size

    def _wanting(self, n: int, first: int) -> bool:
        count = sum(len(k) for k in self.kept[n])
        return count < (self.options.most if first < self.near else 1)

    def _wave(self, todo: list[int], first: int, last: int) -> None:
        views = [self.viewpoints[n] for n in todo]
        angles = [self.angles[n][first:last] for n in todo]
        found = ik_candidates(
            self.cell, views, angles, self.options.rolls, hopeless=self.clearance.tool_blocked
        )
        free = self.clearance.first_free(found.q, found.starts, found.geometry, self.options.most)
        for i, n in enumerate(todo):
            rows = found.of(i)
            q, ok = np.column_stack([found.q[rows], found.sigma[rows]]), free[rows]
            if self.viewpoints[n].kind == "revolution":
                ok = self._whole_turn(found, rows)
            if ok.any():
                self.kept[n].append(q[ok])
            else:
                _, once = np.unique(found.geometry[rows], return_index=True)
                self.tried[n].append(q[np.sort(once)])

    def _whole_turn(self, found: IkCandidates, rows: slice) -> np.ndarray:
        """Which rows stay free while the table turns once, until enough of them do."""
        q = found.q[rows]
        ok = self.clearance.fast_free(q)
        where = np.flatnonzero(ok)
        ok[:] = False
        for first in range(0, len(where), 48):
            batch = where[first : first + 48]
            turned = q[batch].copy()
            turned[:, 6] += 2 * np.pi
            ok[batch] = self.clearance.edges_free(q[batch], turned)
            if ok.sum() >= self.options.most:
                break
        return ok

    def answer(self, n: int, search: SlackSearch) -> Reach:
        """What was found for viewpoint n; the exact tier is asked only where the fast one finds nothing."""
        viewpoint = self.viewpoints[n]
        if self.kept[n]:
            return self._reach(viewpoint, np.concatenate(self.kept[n]))
        tried = np.concatenate(self.tried[n]) if self.tried[n] else np.zeros((0, 8))
        exact, solver = self._exact(tried) if viewpoint.kind == "station" else tried[:0], ""
        if len(exact) == 0 and self.options.slack and has_slack(viewpoint):
            exact, solver = self._within_slack(viewpoint, search)
        if len(exact):
            return self._reach(viewpoint, exact, solver=solver)
        for angles in (self.angles[n][:3], self.angles[n]):
            if len(tried) == 0:
                # The tool itself is in the way everywhere, or the arm does not go there.
                found = ik_candidates(self.cell, [viewpoint], [angles], self.options.rolls)
                tried = np.column_stack([found.q, found.sigma])
        X_WS, table = presented(self.cell, viewpoint, self.angles[n], self.options.rolls)
        cause = cause_of(self.cell, viewpoint, self.clearance, X_WS, table, tried[:, :7])
        return self._reach(viewpoint, tried[:0], cause)

    def _within_slack(self, viewpoint: Viewpoint, search: SlackSearch) -> tuple[np.ndarray, str]:
        """Free rows at other poses within the slack, and their solver: analytic ones, else one of Drake's."""
        few = replace(self.options, most=max(self.options.most // 8, 1))
        others = _Block(self.cell, variants(self.cell, viewpoint), self.clearance, few)
        others.look()
        kept = [rows[: few.most] for found in others.kept for rows in found]
        if kept:
            return np.concatenate(kept)[: self.options.most], ""
        tried = np.concatenate([np.zeros((0, 8)), *(rows for found in others.tried for rows in found)])[:, :7]
        if len(tried) == 0:
            return np.zeros((0, 8)), ""
        q = search.solve(viewpoint, seeds_from(tried, self.clearance.surely_blocked(tried)))
        if q is None:
            return np.zeros((0, 8)), ""
        solved = branches(self.cell, scanner_poses(self.cell, q[None]))
        off = np.abs(solved.q - q[:6]).max(axis=1)
        # At the edge of a limit rounding may lose the branch: such a place is called singular.
        sigma = solved.manipulability[np.argmin(off)] if len(off) and off.min() < 1e-3 else 0.0
        return np.append(q, sigma)[None], RESCUE

    def _exact(self, tried: np.ndarray) -> np.ndarray:
        """The rows that the exact tier calls free, `most` of them at most."""
        found, size = [tried[:0]], max(16, self.options.most)
        for first in range(0, len(tried), size):
            batch = tried[first : first + size]
            found.append(batch[self.clearance.exactly_free(batch[:, :7])])
            if sum(map(len, found)) >= self.options.most:
                break
        return np.concatenate(found)

    def _reach(
        self, viewpoint: Viewpoint, rows: np.ndarray, cause: Unreachable | None = None, solver: str = ""
    ) -> Reach:
        rows = rows[: self.options.most]
        q = np.ascontiguousarray(rows[:, :7])
        if len(q):
            solver = solver or (ANALYTIC if has_closed_form(self.cell.robot) else NUMERIC)
        return Reach(
            viewpoint=viewpoint, q=q, clearance=np.maximum(self.clearance.margins(q), 0.0),
            manipulability=rows[:, 7].copy(), X_OS=scanner_in_object(self.cell, q), unreachable=cause,
            solver=solver,
        )  # fmt: skip


def reachable_mask(
    cell: Cell,
    X_OS: np.ndarray,
    *,
    clearance: Clearance,
    azimuth_step: float = np.deg2rad(20.0),
    near_q: np.ndarray | None = None,
    within_s: float = np.inf,
) -> np.ndarray:
    """Whether each scanner pose (n, 4, 4) in O has a free configuration at some table angle, shape (n,).

    A quick answer for many candidates: fast tier only, coarse table angles, the pose's own roll.

    Args:
        cell: the cell.
        X_OS: poses, shape (n, 4, 4).
        clearance: the collision checker of the cell.
        azimuth_step: between table angles [rad].
        near_q: configurations that the tour passes in any case, shape (k, 7) [rad]; None for none.
        within_s: a configuration counts if the arm gets there in this time from one of `near_q`: on its way
            to another winding or branch the scanner may travel metres [s].
    """
    X_OS = np.asarray(X_OS, dtype=float).reshape(-1, 4, 4)
    reached = np.zeros(len(X_OS), bool)
    per_pose = [table_angles(cell, X, azimuth_step, np.deg2rad(100.0)) for X in X_OS]
    waves = max((len(a) for a in per_pose), default=0)
    # A few angles at a time: most candidates are settled by the angles nearest to the robot.
    for first in range(0, waves, 3):
        todo = np.flatnonzero(~reached)
        if len(todo) == 0:
            break
        owner = np.concatenate([np.full(len(per_pose[i][first : first + 3]), i) for i in todo])
        angles = np.concatenate([per_pose[i][first : first + 3] for i in todo])
        X_WS = cell.X_WT @ turns_about_z(angles) @ cell.X_TO @ X_OS[owner]
        near = wrist_shortfall(cell, X_WS) <= 0
        solved = branches(cell, X_WS[near], windings=False)
        pose = np.flatnonzero(near)[solved.pose_index]
        q = np.column_stack([solved.q, angles[pose]])
        if near_q is not None:
            close = _arm_seconds(cell, near_q, q) <= within_s
            q, pose = q[close], pose[close]
        reached[owner[pose[clearance.fast_free(q)]]] = True
    return reached


def _arm_seconds(cell: Cell, near_q: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Least time from one of near_q (k, 7) to each q (n, 7) with the table at rest, shape (n,) [s]."""
    model, least = move_model(cell), np.full(len(q), np.inf)
    if len(q) == 0:
        return least
    for start in near_q:
        end = q.copy()
        for j in range(6):
            wound = end[:, j] + 2 * np.pi * np.round((start[j] - end[:, j]) / (2 * np.pi))
            inside = (wound >= cell.q_min[j]) & (wound <= cell.q_max[j])
            end[inside, j] = wound[inside]
        end[:, 6] = start[6]
        least = np.minimum(least, move_matrix(model, start[None], end)[0])
    return least
