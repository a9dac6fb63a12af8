"""The plan folder on disk: strict schemas, written as a whole or not at all, read without trust."""

import ctypes
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from scanmotion.core.errors import PlanFileError
from scanmotion.core.trajectory import Operation, Trajectory

VERSION = 1
CSV_HEADER = "t_s,A1_deg,A2_deg,A3_deg,A4_deg,A5_deg,A6_deg,E1_deg,operation,kind"
MAX_SAMPLES = 2_000_000
_MAX_JSON = 256 << 20
_MOST = 1e6
"""No time [s] and no angle [deg] of a robot is beyond; what is would overflow in differences."""
_ROW = re.compile(r"[-+.,0-9eE]*,[a-z]+")
_AT_FDCWD, _EXCHANGE = -100, 2
"""Linux: paths relative to the working directory; renameat2's RENAME_EXCHANGE."""
_PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")

Vector7 = Annotated[tuple[float, ...], Field(min_length=7, max_length=7)]
Bounds7 = Annotated[
    tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=7, max_length=7)
]  # fmt: skip
Pose = Annotated[tuple[tuple[float, ...], ...], Field(min_length=4, max_length=4)]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _rigid(X: Any) -> Any:
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
    shape: Literal["box", "cylinder"]
    size_m: tuple[float, ...] = Field(min_length=2, max_length=3)
    X: Pose

    _pose = field_validator("X")(_rigid)


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
        if not _PLAIN_NAME.fullmatch(name) or ".." in name:
            raise ValueError("is not a plain file name inside the plan's folder")
        return name


def atomic_folder(target: str | Path, files: Mapping[str, bytes | str], *, mark: str = "plan.json") -> Path:
    """Writes a folder of files so that a killed run leaves the old folder or the new one, never a mixture.

    Args:
        target: a new folder, an empty one, or a plan's folder, which is replaced.
        files: contents by plain file name.
        mark: name of the file by which a folder that may be replaced is known.

    Raises:
        PlanFileError: the folder cannot be written, or holds what is not such a folder.
    """
    target = Path(os.path.realpath(target))
    for name in files:
        if not _PLAIN_NAME.fullmatch(name):
            raise PlanFileError(f"{name!r} is not a plain file name")
    try:
        if target.exists() and not (target.is_dir() and _replaceable(target, mark)):
            raise PlanFileError(f"{target}: holds something that is not a plan; it is left as it is")
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise PlanFileError(f"{target}: cannot be written ({error.strerror})") from None
    try:
        fresh = work / "new"
        fresh.mkdir()
        for name, content in files.items():
            data = content.encode("utf-8") if isinstance(content, str) else content
            (fresh / name).write_bytes(data)
        _take_place(fresh, target, work / "old")
    except OSError as error:
        raise PlanFileError(f"{target}: cannot be written ({error.strerror})") from None
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return target


def _replaceable(folder: Path, mark: str) -> bool:
    return (folder / mark).is_file() or not any(folder.iterdir())


def _take_place(fresh: Path, target: Path, old: Path) -> None:
    """Puts `fresh` where `target` is, in one step where the system has one."""
    if not target.exists():
        os.replace(fresh, target)
        return
    if _exchanged(fresh, target):
        return
    # Two steps elsewhere: in between, the old folder lies beside the target under its temporary name.
    os.replace(target, old)
    try:
        os.replace(fresh, target)
    except OSError:
        os.replace(old, target)
        raise


def _exchanged(a: Path, b: Path) -> bool:
    """Whether the two folders have changed places by Linux's renameat2."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    return rename(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _EXCHANGE) == 0


def json_text(record: BaseModel | Mapping[str, Any]) -> str:
    """JSON, one value a line, keys in the schema's order."""
    data = record.model_dump(mode="json") if isinstance(record, BaseModel) else dict(record)
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def csv_text(trajectory: Trajectory) -> str:
    """trajectory.csv: seconds with 4 decimals, degrees with 8."""
    kinds = [o.kind for o in trajectory.operations]
    degrees = np.rad2deg(trajectory.q)
    # Adding zero turns -0.0 into 0.0.
    rows = (
        f"{t:.4f}," + ",".join(f"{round(v, 8) + 0.0:.8f}" for v in q) + f",{o},{kinds[o]}"
        for t, q, o in zip(trajectory.t, degrees, trajectory.operation, strict=True)
    )
    return CSV_HEADER + "\n" + "\n".join(rows) + "\n"


def trajectory_json(trajectory: Trajectory, joint_names: tuple[str, ...]) -> str:
    """trajectory.json: the same samples in SI units with velocities and accelerations."""
    return json.dumps(
        {
            "version": VERSION,
            "joint_names": list(joint_names),
            "units": {"time": "s", "position": "rad", "velocity": "rad/s", "acceleration": "rad/s2"},
            "time": np.round(trajectory.t, 6).tolist(),
            "position": np.round(trajectory.q, 10).tolist(),
            "velocity": np.round(trajectory.qd, 8).tolist(),
            "acceleration": np.round(trajectory.qdd, 6).tolist(),
            "operation": trajectory.operation.tolist(),
        }
    )


def inside(folder: Path, name: str) -> Path:
    """The path of a plain file of the folder; links that lead elsewhere are refused.

    Raises:
        PlanFileError: missing, not a plain file, or outside.
    """
    path = folder / name
    try:
        if path.resolve().parent != folder.resolve():
            raise PlanFileError(f"{name}: leads out of the plan's folder")
        if not path.exists():
            raise PlanFileError(f"{folder}: {name} is missing; is this a plan's folder?")
        if not path.is_file():
            raise PlanFileError(f"{name}: is not a file")
    except (OSError, RuntimeError, ValueError) as error:
        # Links in a circle are a RuntimeError before Python 3.13.
        raise PlanFileError(f"{name}: cannot be read ({str(error)[:80]})") from None
    return path


def read_text(folder: Path, name: str, *, limit: int = _MAX_JSON) -> str:
    """A file of the folder as text.

    Raises:
        PlanFileError: missing, outside, too large, not text.
    """
    path = inside(folder, name)
    try:
        if path.stat().st_size > limit:
            raise PlanFileError(f"{name}: more than {limit >> 20} MiB is not a plan's file")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise PlanFileError(f"{name}: is not text") from None
    except OSError as error:
        raise PlanFileError(f"{name}: cannot be read ({error.strerror})") from None


def read_json(folder: Path, name: str) -> Any:
    """A JSON file of the folder.

    Raises:
        PlanFileError: not JSON, or with NaN.
    """
    text = read_text(folder, name)

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not a number of JSON")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"{name}: is not JSON ({str(error)[:120]})") from None


def read_plan(folder: str | Path) -> PlanRecord:
    """plan.json of a plan folder.

    Raises:
        PlanFileError: with the key that is wrong.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise PlanFileError(f"{folder}: no such plan folder")
    data = read_json(folder, "plan.json")
    if not isinstance(data, dict):
        raise PlanFileError("plan.json: an object is expected")
    version = data.get("version")
    if version != VERSION or not isinstance(version, int) or isinstance(version, bool):
        raise PlanFileError(f"plan.json: version {str(version)[:40]!r}; this software reads {VERSION}")
    try:
        # As JSON and strictly, so that neither "1.5" nor true is a number.
        return PlanRecord.model_validate_json(json.dumps(data), strict=True)
    except (ValidationError, RecursionError) as error:
        text = str(error)
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            text = f"{'.'.join(str(p) for p in first['loc'])}: {first['msg']}"
        raise PlanFileError(f"plan.json: {' '.join(text.split())[:200]}") from None


def read_trajectory(folder: str | Path, record: PlanRecord) -> Trajectory:
    """trajectory.csv of a plan folder; velocities and accelerations by finite differences.

    Raises:
        PlanFileError: another header, cut short, not finite, out of order.
    """
    lines = read_text(Path(folder), "trajectory.csv").splitlines()
    if not lines or lines[0] != CSV_HEADER:
        raise PlanFileError(f"trajectory.csv: the header is not {CSV_HEADER}")
    if len(lines) > MAX_SAMPLES:
        raise PlanFileError(f"trajectory.csv: more than {MAX_SAMPLES} samples")
    kinds = [o.kind for o in record.operations]
    table, operation = [], []
    for n, line in enumerate(lines[1:], 2):
        numbers, index = _row(line, n, kinds)
        table.append(numbers)
        operation.append(index)
    if len(table) < 2:
        raise PlanFileError("trajectory.csv: fewer than two samples")
    values = np.array(table)
    # Written so that NaN, too, is refused.
    wrong = np.flatnonzero(~(np.abs(values) <= _MOST).all(axis=1))
    if len(wrong):
        raise PlanFileError(f"trajectory.csv: line {wrong[0] + 2} is beyond what a robot does")
    t, q = values[:, 0], np.deg2rad(values[:, 1:])
    if t[0] != 0 or (np.diff(t) <= 0).any():
        raise PlanFileError("trajectory.csv: times do not increase from 0")
    qd = np.gradient(q, t, axis=0)
    operations = tuple(
        Operation(
            index=o.index, kind=o.kind, viewpoints=o.viewpoints, t_start=o.t_start, t_end=o.t_end,
            q_start=np.array(o.q_start), q_end=np.array(o.q_end),
        )
        for o in record.operations
    )  # fmt: skip
    return Trajectory(
        t=t, q=q, qd=qd, qdd=np.gradient(qd, t, axis=0), operation=np.array(operation), operations=operations
    )


def _row(line: str, n: int, kinds: list[str]) -> tuple[list[float], int]:
    """The eight numbers and the operation of line n."""
    fields = line.split(",")
    if len(fields) != 10:
        raise PlanFileError(f"trajectory.csv: line {n} has {len(fields)} fields instead of 10")
    try:
        if not _ROW.fullmatch(line):
            # Python would read 1_0, other scripts' digits, nan and blanks too; other readers would not.
            raise ValueError
        numbers, index = [float(x) for x in fields[:8]], int(fields[8])
    except ValueError:
        raise PlanFileError(f"trajectory.csv: line {n} is not numbers and a kind") from None
    if not 0 <= index < len(kinds) or kinds[index] != fields[9]:
        text = f"operation {fields[8][:20]} {fields[9][:20]!r} is not in plan.json"
        raise PlanFileError(f"trajectory.csv: line {n}: {text}")
    return numbers, index
