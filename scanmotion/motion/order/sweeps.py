"""Sweeps: joint paths that carry the scanner on a straight line over the part, with the table still."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from scanmotion.motion.order.stops import Group, PathFree, ReachLike, spread_windings, stage_of, windings
from scanmotion.motion.transit_cost import MoveModel, path_seconds, placed_nodes

if TYPE_CHECKING:
    from scanmotion.cell.build import Cell

STEP_M = 0.02
"""Greatest distance of neighbouring poses of a sweep [m]."""
STRAIGHT_M = 1e-3
"""How far a viewpoint may lie beside the line through a sweep [m]."""
FLIP_RAD = 0.35
"""A greater step of an axis between neighbouring poses is a flip of configuration [rad]."""


def straight_runs(members: Sequence[ReachLike]) -> list[list[ReachLike]]:
    """Cut the viewpoints of a sweep, in their order, into runs on straight lines, passed one way."""
    runs: list[list[ReachLike]] = []
    for reach in members:
        if runs and _continues(runs[-1], reach):
            runs[-1].append(reach)
        else:
            runs.append([reach])
    return runs


def _continues(run: list[ReachLike], reach: ReachLike) -> bool:
    if len(run) == 1:
        return float(np.linalg.norm(reach.viewpoint.p_OS - run[0].viewpoint.p_OS)) > STRAIGHT_M
    p = np.array([r.viewpoint.p_OS for r in [*run, reach]])
    along = (p[-1] - p[0]) / max(float(np.linalg.norm(p[-1] - p[0])), 1e-12)
    places = (p - p[0]) @ along
    beside = np.linalg.norm(p - p[0] - places[:, None] * along, axis=1).max()
    return bool(beside <= STRAIGHT_M and (np.diff(places) > 0.0).all())


def sweep_group(
    cell: Cell,
    model: MoveModel,
    run: Sequence[ReachLike],
    e1_range: tuple[float, float],
    path_free: PathFree | None,
    most: int,
) -> Group | None:
    """All clear ways found to pass a straight run, forwards and backwards; None where there is none.

    Args:
        cell: the arm.
        model: its cost model.
        run: reaches on a straight line, in order.
        e1_range: least and greatest table position [rad].
        path_free: tells whether a joint path is clear.
        most: greatest number of paths kept, before directions and windings of the table.
    """
    if len(run) < 2:
        return None
    paths: list[np.ndarray] = []
    for path in _paths(cell, model, run, 4 * most):
        if path_free is None or bool(path_free(path)[0]):
            paths.append(path)
        if len(paths) == most:
            break
    ways: list[np.ndarray] = []
    for path in paths:
        for e in windings(float(path[0, 6]), *e1_range):
            wound = np.column_stack([path[:, :6], np.full(len(path), e)])
            ways += [wound, wound[::-1].copy()]
    if not ways:
        return None
    n = np.arange(len(ways))
    return Group(
        viewpoints=tuple(r.viewpoint.id for r in run),
        kind="sweep",
        stage=stage_of(run[0]),
        enter=placed_nodes(model, np.array([w[0] for w in ways])),
        leave=placed_nodes(model, np.array([w[-1] for w in ways])),
        seconds=np.array([path_seconds(model, w) for w in ways]),
        partner=n ^ 1,
        backward=n % 2 == 1,
        paths=tuple(ways),
    )


def _paths(cell: Cell, model: MoveModel, run: Sequence[ReachLike], most: int) -> list[np.ndarray]:
    """Joint paths without flips from the most different configurations of the first viewpoint."""
    from scanmotion.cell.kinematics import branches, object_poses

    first = run[0]
    q = np.asarray(first.q, dtype=float)
    chosen = spread_windings(model, q, most)
    line = line_poses([r.viewpoint.X_OS for r in run])
    offsets = np.linalg.inv(first.viewpoint.X_OS) @ np.asarray(first.X_OS)[chosen]
    X_WO = np.asarray(object_poses(cell, q[chosen]))
    X_WS = X_WO[:, None] @ line[None] @ offsets[:, None]
    k = len(line)
    found = branches(cell, X_WS.reshape(-1, 4, 4), windings=True)
    paths = []
    for n, way in enumerate(chosen):
        path = _followed(q[way], found.pose_index - n * k, found.q, k)
        if path is not None:
            paths.append(path)
    return paths


def line_poses(X_OS: Sequence[np.ndarray]) -> np.ndarray:
    """Poses at most 20 mm apart through poses on a line, turning evenly between them, shape (k, 4, 4)."""
    poses = [np.asarray(X_OS[0])]
    for a, b in pairwise(X_OS):
        count = max(int(np.ceil(np.linalg.norm(b[:3, 3] - a[:3, 3]) / STEP_M)), 1)
        share = np.arange(1, count + 1) / count
        turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.array([a[:3, :3], b[:3, :3]])))
        X = np.tile(np.eye(4), (count, 1, 1))
        X[:, :3, :3] = turn(share).as_matrix()
        X[:, :3, 3] = a[:3, 3] + share[:, None] * (b[:3, 3] - a[:3, 3])
        poses += list(X)
    return np.array(poses)


def _followed(start: np.ndarray, pose: np.ndarray, q: np.ndarray, count: int) -> np.ndarray | None:
    """The arm's solutions that continue `start` from pose to pose; None where one is missing or flips."""
    path = np.tile(np.asarray(start, dtype=float), (count, 1))
    for i in range(count):
        choices = q[pose == i]
        if len(choices) == 0:
            return None
        before = path[max(i - 1, 0), :6]
        gaps = np.abs(choices - before).max(axis=1)
        best = int(gaps.argmin())
        if gaps[best] > (FLIP_RAD if i else 1e-3):
            return None
        path[i, :6] = choices[best]
    path[0] = start
    return path
