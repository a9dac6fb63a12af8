"""plan.json and the head of trajectory.csv: what they must hold. docs/results.md says what it means."""

import math
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from scanmotion.plan_io.files import PLAIN_NAME

VERSION = 1
CSV_HEADER = "t_s,A1_deg,A2_deg,A3_deg,A4_deg,A5_deg,A6_deg,E1_deg,operation,kind"
MAX_SAMPLES = 2_000_000

Vector7 = Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]
Bounds7 = Annotated[
    tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=7, max_length=7)
]  # fmt: skip
Pose = Annotated[tuple[tuple[float, ...], ...], Field(min_length=4, max_length=4)]


_PoseT = TypeVar("_PoseT")


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _rigid(X: _PoseT) -> _PoseT:
    M = np.array(X, dtype=float)
    if M.shape != (4, 4) or not np.abs(M).max() <= 1e3:
        raise ValueError("is not a rigid (4, 4) pose")
    if np.abs(M[:3, :3] @ M[:3, :3].T - np.eye(3)).max() > 1e-6:
        raise ValueError("is not a rigid (4, 4) pose")
    if np.linalg.det(M[:3, :3]) < 0 or np.abs(M[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise ValueError("is not a rigid (4, 4) pose")
    return X


class ViewpointRecord(_Record):
    """A viewpoint that the plan serves or gave up."""

    id: str = Field(max_length=100)
    X_OS: Pose
    standoff_m: float = Field(gt=0, le=100)
    step: Literal["global", "local"]
    kind: Literal["revolution", "station"]
    sweep: str = Field("", max_length=100)
    slack_standoff_m: tuple[Annotated[float, Field(le=0)], Annotated[float, Field(ge=0)]] = (0.0, 0.0)
    slack_tilt_rad: float = Field(0.0, ge=0, le=math.pi)
    slack_roll: bool = False
    note: str = Field("", max_length=1000)
    solver: str = Field("", max_length=100)
    """Which solver of the inverse kinematics found the pose that serves it."""

    _pose = field_validator("X_OS")(_rigid)


class OperationRecord(_Record):
    """One operation of the trajectory."""

    index: int = Field(ge=0)
    kind: Literal["transit", "revolution", "sweep", "dwell", "helix", "path"]
    viewpoints: tuple[str, ...]
    t_start: float = Field(ge=0)
    t_end: float = Field(ge=0)
    q_start: Vector7
    q_end: Vector7


class BodyRecord(_Record):
    """A solid that is not the part and not in the robot's URDF."""

    name: str = Field(max_length=100)
    frame: Literal["flange", "table", "world"]
    shape: Literal["box", "cylinder", "mesh"]
    size_m: tuple[float, ...] = Field(min_length=2, max_length=3)
    """Sides of a box, radius and length of a cylinder, metres to a mesh's unit along x, y and z."""
    X: Pose
    file: str = Field("", max_length=100)
    """The mesh's file in the plan's folder."""

    _pose = field_validator("X")(_rigid)

    @field_validator("file")
    @classmethod
    def _plain(cls, name: str) -> str:
        if name and (not PLAIN_NAME.fullmatch(name) or ".." in name):
            raise ValueError("is not a plain file name inside the plan's folder")
        return name


class LimitsRecord(_Record):
    """Limits of A1..A6, E1; null for an endless table's range."""

    position_min_rad: tuple[float | None, ...] = Field(min_length=7, max_length=7)
    position_max_rad: tuple[float | None, ...] = Field(min_length=7, max_length=7)
    velocity_rad_s: Bounds7
    acceleration_rad_s2: Bounds7
    jerk_rad_s3: Bounds7


class ProcessRecord(_Record):
    """What the plan has to keep."""

    scan_speed_m_s: float = Field(gt=0)
    transit_speed_m_s: float = Field(gt=0)
    fps: float = Field(gt=0)
    dwell_s: float = Field(ge=0)
    clearance_m: float = Field(ge=0)
    budget_s: float = Field(gt=0)


class PlanRecord(_Record):
    """plan.json."""

    version: Literal[1] = VERSION
    software: str = Field(max_length=100)
    robot: str = Field(max_length=100)
    part: str = Field(max_length=200)
    source: Literal["mesh", "box", "scan"]
    mode: str = Field(max_length=40)
    strategy: str = Field(max_length=40)
    seed: int
    joint_names: tuple[str, ...] = Field(min_length=7, max_length=7)
    robot_joints: tuple[str, ...] = Field(min_length=6, max_length=6)
    flange_link: str
    limits: LimitsRecord
    X_WB: Pose
    X_FS: Pose
    X_WT: Pose
    X_TO: Pose
    home: Vector7
    process: ProcessRecord
    bodies: tuple[BodyRecord, ...]
    urdf_file: str
    part_file: str
    cell_file: str
    viewpoints: tuple[ViewpointRecord, ...]
    unreachable: tuple[tuple[str, str], ...]
    operations: tuple[OperationRecord, ...]

    _poses = field_validator("X_WB", "X_FS", "X_WT", "X_TO")(_rigid)

    @field_validator("urdf_file", "part_file", "cell_file")
    @classmethod
    def _plain(cls, name: str) -> str:
        if not PLAIN_NAME.fullmatch(name) or ".." in name:
            raise ValueError("is not a plain file name inside the plan's folder")
        return name
