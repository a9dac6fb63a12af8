"""Reach: for each viewpoint its collision-free configurations of arm and table, or why there are none."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.clearance import Clearance
from scanmotion.cell.kinematics import branches, scanner_in_object, wrist_shortfall
from scanmotion.cell.plant import Cell
from scanmotion.cell.robot import clean_angle
from scanmotion.motion.causes import Unreachable, cause_of
from scanmotion.viewpoints.viewpoint import Viewpoint

__all__ = ["Reach", "Unreachable", "reach", "reachable_mask"]

SINGULAR = 0.02
"""Configurations whose least singular value is below this come last: next to them joints race."""


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
    """Configurations kept for each viewpoint."""


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
    and the arm has to be clear of the part at every angle.

    Args:
        cell: the cell, with the part.
        viewpoints: what is asked for.
        clearance: the cell's checker; made here where None.
        options: how finely to look.
        progress: told the share done.
    """
    clearance = clearance or Clearance(cell)
    options = options or ReachOptions()
    found = []
    for n, viewpoint in enumerate(viewpoints):
        found.append(_reach_one(cell, viewpoint, clearance, options))
        if progress is not None:
            progress((n + 1) / len(viewpoints))
    return found


def _reach_one(cell: Cell, viewpoint: Viewpoint, clearance: Clearance, options: ReachOptions) -> Reach:
    for span in (options.azimuth_range, np.pi):
        angles = table_angles(cell, viewpoint.X_OS, options.azimuth_step, span)
        X_WS, table = presented(cell, viewpoint, angles, options.rolls)
        solved = branches(cell, X_WS)
        e1 = table[solved.pose_index]
        q = np.column_stack([solved.q, np.zeros(len(e1)) if viewpoint.kind == "revolution" else e1])
        inside = (q[:, 6] >= cell.q_min[6]) & (q[:, 6] <= cell.q_max[6])
        q, sigma = q[inside], solved.manipulability[inside]
        order = _preferred(cell, viewpoint, q, sigma)
        q, sigma = q[order], sigma[order]
        free = _free(viewpoint, clearance, q, options.most)
        if free.any():
            return _best(cell, viewpoint, clearance, q[free], sigma[free], options.most)
    empty = np.zeros((0, 7))
    return Reach(
        viewpoint=viewpoint, q=empty, clearance=np.zeros(0), manipulability=np.zeros(0),
        X_OS=np.zeros((0, 4, 4)), unreachable=cause_of(cell, viewpoint, clearance, X_WS, table, q),
    )  # fmt: skip


def table_angles(cell: Cell, X_OS: np.ndarray, step: float, span: float) -> np.ndarray:
    """Table angles that bring the scanner within `span` of the robot's side, nearest first [rad]."""
    toward = cell.X_WB[:2, 3] - cell.X_WT[:2, 3]
    robot = np.arctan2(toward[1], toward[0])
    p = X_OS[:2, 3]
    here = np.arctan2(p[1], p[0]) if np.linalg.norm(p) > 0.05 else 0.0
    count = int(np.floor(span / step + 1e-9))
    offsets = step * np.arange(-count, count + 1)
    offsets = offsets[offsets > -np.pi + 1e-9]
    offsets = offsets[np.argsort(np.abs(offsets), kind="stable")]
    return clean_angle(robot - here + offsets)


def presented(
    cell: Cell, viewpoint: Viewpoint, angles: np.ndarray, rolls: int
) -> tuple[np.ndarray, np.ndarray]:
    """Scanner poses in W at each table angle and roll, shape (n, 4, 4), and the table angle of each (n,)."""
    rolls = rolls if viewpoint.slack.roll else 1
    Z = _turns(angles)
    R = _turns(2 * np.pi * np.arange(rolls) / rolls)
    X = (cell.X_WT @ Z @ cell.X_TO @ viewpoint.X_OS)[:, None] @ R[None]
    return X.reshape(-1, 4, 4), np.repeat(angles, rolls)


def _turns(angles: np.ndarray) -> np.ndarray:
    X = np.tile(np.eye(4), (len(angles), 1, 1))
    X[:, 0, 0] = X[:, 1, 1] = np.cos(angles)
    X[:, 1, 0] = np.sin(angles)
    X[:, 0, 1] = -X[:, 1, 0]
    return X


def _free(viewpoint: Viewpoint, clearance: Clearance, q: np.ndarray, most: int) -> np.ndarray:
    """Which configurations are free; the exact tier is asked only where the fast one finds none."""
    if len(q) == 0:
        return np.zeros(0, bool)
    free = clearance.fast_free(q)
    if viewpoint.kind == "revolution":
        turned = q.copy()
        turned[:, 6] += 2 * np.pi
        where = np.flatnonzero(free)
        free[:] = False
        for first in range(0, len(where), 48):
            batch = where[first : first + 48]
            free[batch] = clearance.edges_free(q[batch], turned[batch])
            if free.sum() >= most:
                break
        return free
    if not free.any():
        spread = np.linspace(0, len(q) - 1, min(len(q), 200)).astype(int)
        free[spread] = clearance.free(q[spread])
    return free


def _best(
    cell: Cell, viewpoint: Viewpoint, clearance: Clearance, q: np.ndarray, sigma: np.ndarray, most: int
) -> Reach:
    """The first `most` configurations."""
    q, sigma = q[:most], sigma[:most]
    return Reach(
        viewpoint=viewpoint, q=q, clearance=np.maximum(clearance.margins(q), 0.0),
        manipulability=sigma, X_OS=scanner_in_object(cell, q),
    )  # fmt: skip


def _preferred(cell: Cell, viewpoint: Viewpoint, q: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Order of preference: the quickest from home at each azimuth in turn, singular ones last."""
    seconds = (np.abs(q[:, :6] - cell.home[:6]) / cell.v_max[:6]).max(axis=1) + 10.0 * (sigma < SINGULAR)
    order = np.argsort(seconds, kind="stable")
    azimuth = q[order, 6]
    if viewpoint.kind == "revolution":
        X = scanner_in_object(cell, q[order])
        azimuth = np.arctan2(X[:, 1, 3], X[:, 0, 3])
    key = np.round(clean_angle(azimuth) / np.deg2rad(1.0)).astype(int)
    rank = np.zeros(len(order), int)
    seen: dict[int, int] = {}
    for i, k in enumerate(key):
        rank[i] = seen.get(int(k), 0)
        seen[int(k)] = rank[i] + 1
    return order[np.lexsort((np.arange(len(order)), rank))]


def reachable_mask(
    cell: Cell, X_OS: np.ndarray, *, clearance: Clearance, azimuth_step: float = np.deg2rad(20.0)
) -> np.ndarray:
    """Whether each scanner pose (n, 4, 4) in O has a free configuration at some table angle, shape (n,).

    A quick answer for many candidates: fast tier only, coarse table angles, the pose's own roll.
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
        X_WS = cell.X_WT @ _turns(angles) @ cell.X_TO @ X_OS[owner]
        near = wrist_shortfall(cell, X_WS) <= 0
        solved = branches(cell, X_WS[near], windings=False)
        pose = np.flatnonzero(near)[solved.pose_index]
        q = np.column_stack([solved.q, angles[pose]])
        reached[owner[pose[clearance.fast_free(q)]]] = True
    return reached
