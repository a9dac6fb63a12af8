"""The cell in numpy: arm, fixture, scanner, turntable, part and obstacles, put together from its settings."""

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.cell.arm.robot import Robot
from scanmotion.cell.arm.robot_file import robot_from_file
from scanmotion.cell.arm.urdf import check_kind
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import branches
from scanmotion.cell.model import TABLE as TABLE
from scanmotion.cell.model import TOOL as TOOL
from scanmotion.cell.model import WORLD as WORLD
from scanmotion.cell.model import Cell as Cell
from scanmotion.cell.own_solids import meshes, shifted, still_bodies, tool_bodies, tool_pose
from scanmotion.cell.room import check_room as check_room
from scanmotion.cell.settings.cell import CellSettings, pose
from scanmotion.cell.suggest import flange_axis
from scanmotion.core.errors import CellError
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import models_dir

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
    check_kind(path)
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
    X_WT = shifted(pose((*table.position_m, table.height_m)), (*known.axis_mm, 0.0), (*known.axis_deg, 0.0))
    limits = _limits(settings, robot)
    read = meshes(settings, X_FZ)
    frame: dict[str, Any] = dict(
        settings=settings, part=part, robot=robot, X_WB=X_WB, X_FS=X_FZ @ tool_pose(settings), X_WT=X_WT,
        X_TO=pose((0.0, 0.0, settings.pedestal.height_m)), joint_names=(*robot.joints, "E1"),
        bodies=(*robot.bodies, *tool_bodies(settings, X_FZ), *still_bodies(settings),
                *(piece for _, pieces in read for piece in pieces)),
        meshes=tuple(mesh for mesh, _ in read), **limits,
    )  # fmt: skip
    home = _home(Cell(**frame, home=np.zeros(7)))
    for values in (*limits.values(), X_WB, X_WT, frame["X_FS"], frame["X_TO"], home):
        values.setflags(write=False)
    return Cell(**frame, home=home)


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
