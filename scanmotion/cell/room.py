"""Whether what turns has room: nothing stands in the table's top or in what the part sweeps."""

import numpy as np

from scanmotion.cell.collision.shapes import fcl_object
from scanmotion.cell.model import TABLE, WORLD, Cell
from scanmotion.cell.settings.cell import pose
from scanmotion.core.errors import CellError


def check_room(cell: Cell) -> None:
    """Refuses an obstacle, or a solid fixed to the robot's base, in which the table or what is on it turns.

    What turns is taken as round: the table's top, and the circle that the part's farthest point draws.

    Raises:
        CellError: with the obstacle.
    """
    table, p_WT = cell.settings.turntable, cell.X_WT[:3, 3]
    turning = [("the turntable", table.diameter_m / 2, p_WT[2] - table.thickness_m, p_WT[2])]
    if cell.part is not None:
        p_TO = cell.part.vertices @ cell.X_TO[:3, :3].T + cell.X_TO[:3, 3]
        radius, z = float(np.hypot(p_TO[:, 0], p_TO[:, 1]).max()), p_TO[:, 2] + p_WT[2]
        turning.append(("the part as it turns", radius, float(z.min()), float(z.max())))
    _check_base(cell, turning)
    for number, obstacle in enumerate(cell.settings.obstacles):
        if obstacle.size_m is None or obstacle.centre_m is None:
            _check_mesh(cell, number, obstacle.name, turning)
            continue
        X = pose(obstacle.centre_m, np.deg2rad(obstacle.yaw_deg))
        half = np.array(obstacle.size_m) / 2
        axis = np.abs(X[:3, :3].T @ (p_WT - X[:3, 3]))
        away = float(np.hypot(*np.maximum(axis[:2] - half[:2], 0.0)))
        for what, radius, low, high in turning:
            height = min(high, X[2, 3] + half[2]) - max(low, X[2, 3] - half[2])
            if away < radius - 1e-6 and height > 1e-6:
                raise CellError(
                    f"{obstacle.name} stands in {what}: {away * 1e3:.0f} mm from the axis, "
                    f"{radius * 1e3:.0f} mm are swept",
                    key=f"obstacles.{number}",
                )


def _check_base(cell: Cell, turning: list[tuple[str, float, float, float]]) -> None:
    """Refuses a robot that stands in what turns: (name, radius, least and greatest height) [m]."""
    import fcl

    standing = [(b.name, b.size, cell.X_WT @ b.X_LG) for b in cell.bodies if b.link == TABLE]
    for what, radius, low, high in turning:
        middle = pose((*cell.X_WT[:2, 3], (low + high) / 2))
        standing.append((what, (radius - 1e-6, high - low - 2e-6), middle))
    for what, size, X_WG in standing:
        turns = fcl.CollisionObject(fcl.Cylinder(*size), fcl.Transform(X_WG[:3, :3], X_WG[:3, 3]))
        for body in cell.bodies:
            if body.link != 0:
                continue
            solid = fcl_object(body, cell.X_WB @ body.X_LG)
            if fcl.collide(solid, turns, fcl.CollisionRequest(), fcl.CollisionResult()):
                raise CellError(
                    f"the robot's base ({body.name}) stands in {what}: move the one or the other",
                    key="turntable.position_m",
                )


def _check_mesh(cell: Cell, number: int, name: str, turning: list[tuple[str, float, float, float]]) -> None:
    """Refuses a mesh in which something turns: (name, radius, least and greatest height) [m]."""
    import fcl

    for what, radius, low, high in turning:
        X = pose((*cell.X_WT[:2, 3], (low + high) / 2))
        size = radius - 1e-6, max(high - low - 2e-6, 1e-6)
        turns = fcl.CollisionObject(fcl.Cylinder(*size), fcl.Transform(X[:3, :3], X[:3, 3]))
        for body in cell.bodies:
            if body.link != WORLD or body.mesh != name:
                continue
            solid = fcl_object(body, body.X_LG)
            if fcl.collide(solid, turns, fcl.CollisionRequest(), fcl.CollisionResult()):
                raise CellError(f"{name} stands in {what}", key=f"obstacles.{number}")
