"""The nodes of a continuous motion: arm configurations that look at the part and are clear as it turns."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.cell.arm.robot import inverse_poses
from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import branches, scanner_poses
from scanmotion.geometry.parts.revolved import swept_part
from scanmotion.motion.continuous.search import Nodes
from scanmotion.motion.transit_cost import PlacedNodes, move_matrix, move_model, placed_nodes

SINGULAR = 0.02
"""Configurations whose least singular value is below this are no nodes: next to them joints race."""
_WRIST_RAD = 2.6
"""Ways on which A4 or A6 turns farther are not taken: the scanner would look aside."""


def swept_clearance(cell: Cell) -> Clearance:
    """The checker of the cell with all that the part sweeps in place of the part."""
    assert cell.part is not None
    return Clearance(replace(cell, part=swept_part(cell.part)))


def nodes_from(
    cell: Cell,
    clearance: Clearance,
    start_q: np.ndarray,
    poses: np.ndarray,
    *,
    azimuths: np.ndarray,
    kept: int = 2,
    near: int = 24,
) -> Nodes:
    """Nodes for scanner poses about the table, in the branch of the arm in which the programme begins.

    Args:
        cell: the cell, with the part.
        clearance: `swept_clearance` of it.
        start_q: where the programme begins, shape (7,) [rad].
        poses: scanner poses in O at azimuth zero, shape (n, 4, 4); the azimuth about the table is free.
        azimuths: those that are tried, about the robot's side of the table, shape (k,) [rad].
        kept: of each pose, so many azimuths are kept, the nearest to the start first.
        near: neighbours noted of each node.
    """
    model = move_model(cell)
    toward = cell.X_WB[:2, 3] - cell.X_WT[:2, 3]
    side = np.arctan2(toward[1], toward[0]) + azimuths
    Z = np.tile(np.eye(4), (len(side), 1, 1))
    Z[:, :3, :3] = Rotation.from_rotvec(side[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    X_WS = (cell.X_WT @ Z[None] @ cell.X_TO @ poses[:, None]).reshape(-1, 4, 4)
    owner = np.repeat(np.arange(len(poses)), len(side))
    hopeful = np.flatnonzero(~clearance.tool_blocked(X_WS, np.zeros(len(X_WS))))
    solved = branches(cell, X_WS[hopeful])
    q = np.column_stack([solved.q, np.full(len(solved.q), start_q[6])])
    owner, pose = owner[hopeful[solved.pose_index]], hopeful[solved.pose_index]
    start = placed_nodes(model, start_q[None])
    alike = (placed_nodes(model, q).branch == start.branch[0]) & (solved.manipulability > SINGULAR)
    q, owner, pose = q[alike], owner[alike], pose[alike]
    seconds = move_matrix(model, start_q[None], q)[0]
    order = np.lexsort((seconds, owner))
    chosen: list[int] = []
    for rows in np.split(order, np.flatnonzero(np.diff(owner[order])) + 1):
        free = rows[:24][clearance.fast_free(q[rows[:24]])] if len(rows) else rows
        _, once = np.unique(pose[free], return_index=True)
        chosen += [int(r) for r in free[np.sort(once)][:kept]]
    arm = np.vstack([start_q[None], q[chosen]])
    return _tied(cell, arm, placed_nodes(model, arm), near)


def _tied(cell: Cell, q: np.ndarray, at: PlacedNodes, near: int) -> Nodes:
    """Nodes at the configurations q (n, 7) with the times between them."""
    seconds = move_matrix(move_model(cell), at, at)
    for k in (3, 5):
        seconds[np.abs(q[:, None, k] - q[None, :, k]) > _WRIST_RAD] = np.inf
    # Through A5 = 0 the wrist flips.
    seconds[np.sign(q[:, None, 4]) != np.sign(q[None, :, 4])] = np.inf
    np.fill_diagonal(seconds, np.inf)
    X_WO = cell.X_WT @ cell.X_TO
    Y = inverse_poses(X_WO) @ scanner_poses(cell, q)
    order = np.argsort(seconds[:, 1:], axis=1, kind="stable")[:, :near] + 1
    return Nodes(
        q=np.ascontiguousarray(q[:, :6]), Y=np.ascontiguousarray(Y),
        quaternion=Rotation.from_matrix(Y[:, :3, :3]).as_quat(), seconds=seconds,
        near=np.ascontiguousarray(order),
    )  # fmt: skip
