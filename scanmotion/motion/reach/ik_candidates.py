"""Candidates of reach: every arm configuration of many viewpoints over table angles and rolls, best first."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import branches, scanner_in_object
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.se3 import clean_angle
from scanmotion.geometry.se3 import turns_about_z as turns_about_z

SINGULAR = 0.02
"""Configurations whose least singular value is below this come last: next to them joints race."""


@dataclass(frozen=True, eq=False, kw_only=True)
class IkCandidates:
    """Configurations inside the limits, those of one viewpoint after those of another, each best first."""

    starts: np.ndarray
    """First row of each viewpoint, and the number of rows, shape (n + 1,)."""
    q: np.ndarray
    """Shape (m, 7) [rad]; a revolution's have the table at 0."""
    sigma: np.ndarray
    """Least singular value of the arm's Jacobian, shape (m,)."""
    geometry: np.ndarray
    """The same number for rows that differ by whole turns only, shape (m,)."""

    def of(self, n: int) -> slice:
        """The rows of viewpoint n."""
        return slice(int(self.starts[n]), int(self.starts[n + 1]))


def ik_candidates(
    cell: Cell,
    viewpoints: Sequence[Viewpoint],
    angles: Sequence[np.ndarray],
    rolls: int,
    *,
    hopeless: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> IkCandidates:
    """All branches and windings of each viewpoint at its table angles [rad] and rolls.

    Args:
        cell: the cell.
        viewpoints: what is asked for.
        angles: table angles to try for each viewpoint.
        rolls: how many rolls about the optical axis, where the viewpoint leaves it free.
        hopeless: of scanner poses in W and table angles, which ones need not be solved.
    """
    poses = [presented(cell, v, a, rolls) for v, a in zip(viewpoints, angles, strict=True)]
    X_WS = np.concatenate([np.zeros((0, 4, 4)), *(X for X, _ in poses)])
    table = np.concatenate([np.zeros(0), *(t for _, t in poses)])
    owner = np.repeat(np.arange(len(poses)), [len(t) for _, t in poses])
    turns = np.array([v.kind == "revolution" for v in viewpoints], dtype=bool)
    if hopeless is not None:
        some = ~hopeless(X_WS, np.where(turns[owner], 0.0, table))
        X_WS, table, owner = X_WS[some], table[some], owner[some]
    if len(X_WS) == 0:
        starts, none = np.zeros(len(poses) + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
        return IkCandidates(starts=starts, q=np.zeros((0, 7)), sigma=np.zeros(0), geometry=none)
    solved = branches(cell, X_WS)
    owner, e1 = owner[solved.pose_index], table[solved.pose_index]
    low = cell.q_min[6]
    if np.isfinite(low):
        e1 = np.where((e1 < low) | (e1 > cell.q_max[6]), low + np.mod(e1 - low, 2 * np.pi), e1)
    q = np.column_stack([solved.q, np.where(turns[owner], 0.0, e1)])
    geometry = 8 * solved.pose_index + solved.branch
    inside = turns[owner] | (e1 <= cell.q_max[6])
    q, owner, sigma, geometry = q[inside], owner[inside], solved.manipulability[inside], geometry[inside]
    order = _preferred(cell, turns[owner], owner, q, sigma)
    counts = np.bincount(owner, minlength=len(poses))
    return IkCandidates(
        starts=np.concatenate([[0], np.cumsum(counts)]), q=q[order], sigma=sigma[order],
        geometry=geometry[order],
    )  # fmt: skip


def _preferred(
    cell: Cell, turns: np.ndarray, owner: np.ndarray, q: np.ndarray, sigma: np.ndarray
) -> np.ndarray:
    """Order of preference: the quickest from home at each azimuth in turn, singular ones last."""
    seconds = (np.abs(q[:, :6] - cell.home[:6]) / cell.v_max[:6]).max(axis=1) + 10.0 * (sigma < SINGULAR)
    azimuth = q[:, 6].copy()
    if turns.any():
        X = scanner_in_object(cell, q[turns])
        azimuth[turns] = np.arctan2(X[:, 1, 3], X[:, 0, 3])
    key = np.round(clean_angle(azimuth) / np.deg2rad(1.0)).astype(np.int64) + 1000 * owner
    order = np.lexsort((seconds, key))
    grouped = key[order]
    first = np.flatnonzero(np.append(True, grouped[1:] != grouped[:-1])) if len(order) else order
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    return np.lexsort((seconds, rank, owner))


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
    X = (cell.X_WT @ turns_about_z(angles) @ (cell.X_TO @ viewpoint.X_OS))[:, None]
    if rolls > 1:
        X = X @ turns_about_z(2 * np.pi * np.arange(rolls) / rolls)[None]
    return X.reshape(-1, 4, 4), np.repeat(angles, rolls)
