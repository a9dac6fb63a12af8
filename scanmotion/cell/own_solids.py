"""The cell's own solids: fixture and scanner, table, pedestal, floor and obstacles."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.cell.arm.robot import Body
from scanmotion.cell.mesh_solids import MeshSolid, mesh_solid
from scanmotion.cell.model import TABLE, TOOL, WORLD
from scanmotion.cell.settings.cell import CellSettings, pose

FLOOR_M = 8.0


def tool_pose(settings: CellSettings) -> np.ndarray:
    """X_FS: the V-fixture carries the scanner `arm_m` before the flange, its axis tilted about flange y.

    The scanner's long side lies in the plane of the tilt, so that it stands upright when the arm reaches
    from above.
    """
    tool = settings.tool
    if tool.X_FS is not None:
        known = settings.calibration
        return shifted(np.array(tool.X_FS), known.hand_eye_mm, known.hand_eye_deg)
    t, r = np.deg2rad(tool.tilt_deg), np.deg2rad(tool.roll_deg)
    X_FS = np.eye(4)
    tilt = np.array([[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]])
    roll = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
    X_FS[:3, :3] = tilt @ roll
    X_FS[:3, 3] = (tool.offset_m, 0.0, tool.arm_m)
    return shifted(X_FS, settings.calibration.hand_eye_mm, settings.calibration.hand_eye_deg)


def shifted(X: np.ndarray, by_mm: tuple[float, ...], turn_deg: tuple[float, ...]) -> np.ndarray:
    """The pose moved along and turned about its own axes by what calibration found; untouched where it is
    nothing.
    """
    if not any((*by_mm, *turn_deg)):
        return X
    D = np.eye(4)
    D[:3, :3] = Rotation.from_rotvec(np.deg2rad(turn_deg)).as_matrix()
    D[:3, 3] = np.array(by_mm) * 1e-3
    return X @ D


def tool_bodies(settings: CellSettings, X_FZ: np.ndarray) -> list[Body]:
    """V-fixture (a plate and two arms) and scanner housing, in the flange's frame, unless they are meshes."""
    tool, X_FS = settings.tool, tool_pose(settings)
    size = tool.scanner_size_m
    X_FG = X_FS.copy()
    # The optical centre sits on the housing's front, in the middle between camera and projector's windows.
    X_FG[:3, 3] = X_FS[:3, :3] @ np.array([settings.scanner.baseline_m / 2, 0.0, -size[2] / 2]) + X_FS[:3, 3]
    bodies = []
    if tool.housing_mesh is None:
        bodies.append(Body(name="scanner", link=TOOL, shape="box", size=size, X_LG=X_FG))
    if tool.fixture_mesh is not None:
        return [replace(body, X_LG=X_FZ @ body.X_LG) for body in bodies]
    plate = (tool.plate_m / 2, 0.02)
    bodies.append(
        Body(name="fixture_plate", link=TOOL, shape="cylinder", size=plate, X_LG=pose((0, 0, 0.01)))
    )
    end = X_FG[:3, 3] - X_FG[:3, 2] * size[2] / 2
    for side in (-1.0, 1.0):
        a, b = np.array([0.0, side * 0.06, 0.02]), end + np.array([0.0, side * 0.055, 0.0])
        z = (b - a) / np.linalg.norm(b - a)
        x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = np.column_stack([x, np.cross(z, x), z]), (a + b) / 2
        box = (0.03, 0.012, float(np.linalg.norm(b - a)))
        bodies.append(
            Body(name=f"fixture_arm_{'a' if side < 0 else 'b'}", link=TOOL, shape="box", size=box, X_LG=X)
        )
    return [replace(body, X_LG=X_FZ @ body.X_LG) for body in bodies]


def still_bodies(settings: CellSettings) -> list[Body]:
    """Table and pedestal in frame T (both round, so that their turning does not matter), the rest in W."""
    table, pedestal = settings.turntable, settings.pedestal
    bodies = [
        Body(
            name="table", link=TABLE, shape="cylinder", size=(table.diameter_m / 2, table.thickness_m),
            X_LG=pose((0, 0, -table.thickness_m / 2)),
        ),
        Body(
            name="table_column", link=TABLE, shape="cylinder",
            size=(min(0.25, table.diameter_m / 4), max(table.height_m - table.thickness_m, 0.01)),
            X_LG=pose((0, 0, -table.thickness_m - max(table.height_m - table.thickness_m, 0.01) / 2)),
        ),
        Body(
            name="floor", link=WORLD, shape="box", size=(2 * FLOOR_M, 2 * FLOOR_M, 0.2),
            X_LG=pose((0.0, 0.0, -0.1)),
        ),
    ]  # fmt: skip
    if pedestal.height_m > 0:
        size = (pedestal.diameter_m / 2, pedestal.height_m)
        X = pose((0, 0, pedestal.height_m / 2))
        bodies.append(Body(name="pedestal", link=TABLE, shape="cylinder", size=size, X_LG=X))
    for obstacle in settings.obstacles:
        if obstacle.size_m is not None:
            X = pose(obstacle.centre_m, np.deg2rad(obstacle.yaw_deg))
            bodies.append(Body(name=obstacle.name, link=WORLD, shape="box", size=obstacle.size_m, X_LG=X))
    return bodies


def meshes(settings: CellSettings, X_FZ: np.ndarray) -> list[tuple[MeshSolid, list[Body]]]:
    """Housing, fixture and obstacles that are meshes, each with its convex pieces.

    Raises:
        CellError: a mesh cannot be read.
    """
    tool, folder = settings.tool, Path(settings.folder)
    asked: list[tuple[str, int, str, str | None, np.ndarray, str]] = []
    if tool.housing_mesh is not None:
        X = X_FZ @ tool_pose(settings)
        asked.append(("scanner", TOOL, tool.housing_mesh, tool.mesh_unit, X, "tool.housing_mesh"))
    if tool.fixture_mesh is not None:
        asked.append(("fixture", TOOL, tool.fixture_mesh, tool.mesh_unit, X_FZ, "tool.fixture_mesh"))
    for n, obstacle in enumerate(settings.obstacles):
        if obstacle.mesh is not None:
            X = pose(obstacle.position_m or (0.0, 0.0, 0.0), np.deg2rad(obstacle.yaw_deg))
            X = X if obstacle.X_WM is None else np.array(obstacle.X_WM)
            asked.append((obstacle.name, WORLD, obstacle.mesh, obstacle.unit, X, f"obstacles.{n}.mesh"))
    return [
        mesh_solid(folder / file, name, link, file=f"cell_mesh_{n:02d}", unit=unit, X_LM=X, key=key)
        for n, (name, link, file, unit, X, key) in enumerate(asked)
    ]


def in_folder(settings: CellSettings, solids: tuple[MeshSolid, ...]) -> CellSettings:
    """The settings with their meshes by the names that they have in a plan's folder."""
    if not solids:
        return settings
    of = {(solid.link, solid.name): solid.file for solid in solids}
    own = {
        key: of[TOOL, name]
        for key, name in (("housing_mesh", "scanner"), ("fixture_mesh", "fixture"))
        if (TOOL, name) in of
    }
    obstacles = tuple(
        o if o.mesh is None else o.model_copy(update={"mesh": of[WORLD, o.name]}) for o in settings.obstacles
    )
    tool = settings.tool.model_copy(update=own)
    return settings.model_copy(update={"tool": tool, "obstacles": obstacles})
