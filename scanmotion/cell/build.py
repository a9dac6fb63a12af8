"""The cell: arm, V-fixture, scanner, turntable, part and obstacles, in numpy and as a Drake plant."""

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.cell.arm.robot import Body, Robot
from scanmotion.cell.arm.robot_file import robot_from_file
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.collision.shapes import fcl_object
from scanmotion.cell.kinematics import branches
from scanmotion.cell.model import TABLE as TABLE
from scanmotion.cell.model import TOOL as TOOL
from scanmotion.cell.model import WORLD as WORLD
from scanmotion.cell.model import Cell as Cell
from scanmotion.cell.settings.cell import CellSettings, pose
from scanmotion.cell.suggest import flange_axis
from scanmotion.core.errors import CellError
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import models_dir

FLOOR_M = 8.0
_PLACES = [
    (np.deg2rad(turn), height, distance)
    for turn, distances in (
        (0, (1.0, 0.9, 1.2, 0.8)),
        (0, (0.6, 1.5, 0.45)),
        (40, (1.0, 0.7)),
        (-40, (1.0, 0.7)),
    )
    for height in (0.35, 0.5, 0.7, 0.2, 1.0)
    for distance in distances
]
"""Where a rest is sought, in this order: turn about the table's axis, height above it, distance to it [m]."""


def robot_path(settings: CellSettings) -> Path:
    """The URDF that the settings name: a built-in robot, or a file beside the cell's YAML."""
    builtin = models_dir() / "robots" / f"{settings.robot.model}.urdf"
    if settings.robot.model.replace("-", "").isalnum() and builtin.is_file():
        return builtin
    path = Path(settings.folder) / settings.robot.model
    if path.suffix != ".urdf" or not path.is_file():
        known = sorted(p.stem for p in (models_dir() / "robots").glob("*.urdf"))
        raise CellError(
            f"{settings.robot.model!r}: no such robot; known: {known}, or a .urdf", key="robot.model"
        )
    return path


@functools.cache
def robot_facts() -> dict[str, dict[str, Any]]:
    """Acceleration presets, reach, payload and source of the built-in robots (models/robots/robots.yaml)."""
    import yaml

    return yaml.safe_load((models_dir() / "robots" / "robots.yaml").read_text(encoding="utf-8"))


def robot_of(settings: CellSettings) -> Robot:
    """The arm that the settings name.

    Raises:
        CellError: it cannot be read.
    """
    robot = settings.robot
    speed = robot.velocity_deg_s
    return robot_from_file(
        robot_path(settings),
        robot.joints,
        robot.flange,
        packages=tuple((Path(settings.folder) / folder).resolve() for folder in robot.packages),
        turns=robot.endless_deg / 360,
        speed=None if speed is None else tuple(float(v) for v in np.deg2rad(speed)),
    )


def build_cell(settings: CellSettings, part: Part | None = None) -> Cell:
    """Puts the cell together.

    Args:
        settings: from `load_cell`.
        part: what stands on the table; None for an empty table.

    Raises:
        CellError: the robot's model cannot be read, or home is outside the limits.
    """
    robot = robot_of(settings)
    table = settings.turntable
    X_FZ = _outward(settings, robot)
    X_WB = pose(settings.base.position_m, np.deg2rad(settings.base.yaw_deg))
    if settings.base.X_WB is not None:
        X_WB = np.array(settings.base.X_WB)
    known = settings.calibration
    X_WT = _shifted(pose((*table.position_m, table.height_m)), (*known.axis_mm, 0.0), (*known.axis_deg, 0.0))
    limits = _limits(settings, robot)
    frame: dict[str, Any] = dict(
        settings=settings, part=part, robot=robot, X_WB=X_WB, X_FS=X_FZ @ tool_pose(settings), X_WT=X_WT,
        X_TO=pose((0.0, 0.0, settings.pedestal.height_m)), joint_names=(*robot.joints, "E1"),
        bodies=(*robot.bodies, *_tool_bodies(settings, X_FZ), *_still_bodies(settings)), **limits,
    )  # fmt: skip
    home = _home(Cell(**frame, home=np.zeros(7)))
    for values in (*limits.values(), X_WB, X_WT, frame["X_FS"], frame["X_TO"], home):
        values.setflags(write=False)
    return Cell(**frame, home=home)


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


def tool_pose(settings: CellSettings) -> np.ndarray:
    """X_FS: the V-fixture carries the scanner `arm_m` before the flange, its axis tilted about flange y.

    The scanner's long side lies in the plane of the tilt, so that it stands upright when the arm reaches
    from above.
    """
    tool = settings.tool
    if tool.X_FS is not None:
        known = settings.calibration
        return _shifted(np.array(tool.X_FS), known.hand_eye_mm, known.hand_eye_deg)
    t, r = np.deg2rad(tool.tilt_deg), np.deg2rad(tool.roll_deg)
    X_FS = np.eye(4)
    tilt = np.array([[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]])
    roll = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
    X_FS[:3, :3] = tilt @ roll
    X_FS[:3, 3] = (tool.offset_m, 0.0, tool.arm_m)
    return _shifted(X_FS, settings.calibration.hand_eye_mm, settings.calibration.hand_eye_deg)


def _shifted(X: np.ndarray, by_mm: tuple[float, ...], turn_deg: tuple[float, ...]) -> np.ndarray:
    """The pose moved along and turned about its own axes by what calibration found; untouched where it is
    nothing.
    """
    if not any((*by_mm, *turn_deg)):
        return X
    D = np.eye(4)
    D[:3, :3] = Rotation.from_rotvec(np.deg2rad(turn_deg)).as_matrix()
    D[:3, 3] = np.array(by_mm) * 1e-3
    return X @ D


def _outward(settings: CellSettings, robot: Robot) -> np.ndarray:
    """The flange with z outward in the flange of the URDF, shape (4, 4).

    Raises:
        CellError: the URDF's flange has another axis outward, and the settings do not say so.
    """
    X, said, axis = np.eye(4), settings.robot.flange_axis, flange_axis(robot)
    if said is None and axis != "z":
        hint = {
            "x": "x outward (REP-199), not z: name tool0, or write robot.flange_axis: x",
            "-z": "z inward: name a link with z outward (tool0)",
        }.get(
            axis,
            "neither z nor x along the last joint: name tool0, or write robot.flange_axis: z",
        )
        raise CellError(f"link {settings.robot.flange!r} has {hint}", key="robot.flange")
    if said == "x":
        X[:3, :3] = [[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]]
    return X


def _limits(settings: CellSettings, robot: Robot) -> dict[str, np.ndarray]:
    table = settings.turntable
    low, high = (-np.inf, np.inf) if table.endless else np.deg2rad(table.range_deg)
    preset = settings.robot.acceleration
    if isinstance(preset, str):
        facts = robot_facts().get(settings.robot.model)
        if facts is None:
            raise CellError("a robot of your own needs six values, rad/s2", key="robot.acceleration")
        preset = facts["acceleration_rad_s2"][preset]
    a = np.array([*preset, table.acceleration_rad_s2], dtype=float)
    return dict(
        q_min=np.append(robot.lower, low),
        q_max=np.append(robot.upper, high),
        v_max=np.append(robot.velocity * settings.robot.velocity_scale, table.speed_rpm * 2 * np.pi / 60),
        a_max=a,
        j_max=a / np.array([settings.robot.jerk_time_s] * 6 + [table.jerk_time_s]),
    )


def _tool_bodies(settings: CellSettings, X_FZ: np.ndarray) -> list[Body]:
    """V-fixture (a plate and two arms) and scanner housing, in the flange's frame."""
    tool, X_FS = settings.tool, tool_pose(settings)
    size = tool.scanner_size_m
    X_FG = X_FS.copy()
    # The optical centre sits on the housing's front, in the middle between camera and projector's windows.
    X_FG[:3, 3] = X_FS[:3, :3] @ np.array([settings.scanner.baseline_m / 2, 0.0, -size[2] / 2]) + X_FS[:3, 3]
    bodies = [
        Body(name="scanner", link=TOOL, shape="box", size=size, X_LG=X_FG),
        Body(
            name="fixture_plate",
            link=TOOL,
            shape="cylinder",
            size=(tool.plate_m / 2, 0.02),
            X_LG=pose((0, 0, 0.01)),
        ),
    ]
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


def _still_bodies(settings: CellSettings) -> list[Body]:
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
        X = pose(obstacle.centre_m, np.deg2rad(obstacle.yaw_deg))
        bodies.append(Body(name=obstacle.name, link=WORLD, shape="box", size=obstacle.size_m, X_LG=X))
    return bodies


def _home(cell: Cell) -> np.ndarray:
    """The settings' home, or a free rest with the scanner before the table, looking at its axis.

    At 0.1 m/s a metre to the first viewpoint costs ten seconds: the default home stands 1 m off the axis.
    """
    if cell.settings.robot.home_deg is not None:
        home = np.append(np.deg2rad(cell.settings.robot.home_deg), 0.0)
        outside = [
            n
            for n, q, a, b in zip(cell.joint_names, home, cell.q_min, cell.q_max, strict=True)
            if not a <= q <= b
        ]
        if outside:
            raise CellError(f"{outside[0]} is outside its range", key="robot.home_deg")
        return home
    toward = cell.X_WB[:3, 3] - cell.X_WT[:3, 3]
    toward[2] = 0.0
    if np.linalg.norm(toward) < 0.05:
        raise CellError("the turntable stands where the robot stands", key="turntable.position_m")
    toward /= np.linalg.norm(toward)
    checker = Clearance(replace(cell, part=None))
    touching: tuple[str, str] | None = None
    for turn, height, distance in _PLACES:
        c, d = np.cos(turn), np.sin(turn)
        side = np.array([[c, -d, 0], [d, c, 0], [0, 0, 1.0]]) @ toward
        z = -side
        X = np.eye(4)
        # Long side upright, as the global viewpoints want it.
        X[:3, :3] = np.column_stack([[0, 0, 1.0], np.cross(z, [0, 0, 1.0]), z])
        X[:3, 3] = cell.X_WT[:3, 3] + side * distance + [0, 0, height]
        flipped = X.copy()
        flipped[:3, :2] *= -1
        found = branches(cell, np.stack([X, flipped]), windings=False)
        comfort = np.abs(found.q[:, [0, 3, 5]]).sum(axis=1) + (found.manipulability < 0.05) * 10
        for q in np.column_stack([found.q, np.zeros(len(found.q))])[np.argsort(comfort, kind="stable")]:
            if checker.free(q[None])[0]:
                return q
            touching = touching or checker.distance(q)[1]
    if touching is not None:
        raise CellError(
            f"no free rest before the table was found ({touching[0]} and {touching[1]} are in the way); "
            "set robot.home_deg",
            key="robot.home_deg",
        )
    raise CellError("no rest before the table is in reach; set robot.home_deg", key="robot.home_deg")
