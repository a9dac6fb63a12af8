"""Which pose each frame was taken at: from the frames list, the controller's log, or the plan's programme.

Guarantees: a frame without a pose is refused, never guessed. Assumes: time stamps of frames and log are of
one clock, up to the offset that is given; between two lines of a log the joints move evenly.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.errors import InputError
from scanmotion.core.trajectory import Trajectory
from scanmotion.geometry.parts.make_part import UNITS
from scanmotion.sensing.simulator.captures import Captures, captures_at, captures_from_trajectory

LIST = "frames.csv"
_POSE = tuple(f"T{r}{c}" for r in range(4) for c in range(4))
_GAP_S = 0.5
"""A log with a wider gap about a frame does not say where the robot was."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One frame of a frames list."""

    file: str
    index: int | None = None
    """Of the plan's frames, from 0."""
    t: float | None = None
    """Time stamp [s]."""
    pose: np.ndarray | None = None
    """Pose of the file's frame in O, shape (4, 4) [m]."""
    looks: np.ndarray | None = None
    """Viewing direction in O, shape (3,), where the file's frame is not the scanner's."""


def read_list(path: Path) -> list[Line]:
    """Reads a frames list: CSV with a header; columns file, and index, t_s, or T00..T33 (T_object_scanner,
    mm).

    A .json is a pose file as `scanmotion fuse --poses` takes it; its view directions are heeded.

    Raises:
        InputError: unreadable, without a column `file`, or with what is no number or no pose.
    """
    if path.suffix == ".json":
        return _pose_file(path)
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: is not a frames list ({str(error)[:80]})") from None
    if not rows or "file" not in rows[0]:
        raise InputError(f"{path}: is not a frames list: a header with the column `file` is expected")
    return [_line(path, number, row) for number, row in enumerate(rows, start=2)]


def _pose_file(path: Path) -> list[Line]:
    """Lines of {"units": "mm", "scans": {FILE: {"T_object_scan": 4 x 4, "nominal_view_direction": (3,)}}}."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        unit = UNITS[told.get("units", "mm")]
        lines = []
        for name, entry in told["scans"].items():
            pose = np.array(entry["T_object_scan"], float).reshape(4, 4)
            pose[:3, 3] *= unit
            looks = entry.get("nominal_view_direction")
            looks = None if looks is None else np.array(looks, float).reshape(3)
            if not _rigid(pose) or (looks is not None and not np.linalg.norm(looks) > 1e-9):
                raise InputError(f"{path}: {name}: its pose is no rigid motion, or its direction none")
            lines.append(Line(file=name, pose=pose, looks=looks))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: is not a pose file ({str(error)[:80]})") from None
    return lines


def _line(path: Path, number: int, row: dict[str, Any]) -> Line:
    def told(key: str) -> float | None:
        text = (row.get(key) or "").strip()
        if not text:
            return None
        try:
            value = float(text)
        except ValueError:
            raise InputError(f"{path}, line {number}: {key} is {text[:20]!r}, not a number") from None
        if not np.isfinite(value):
            raise InputError(f"{path}, line {number}: {key} is not finite")
        return value

    values = [told(k) for k in _POSE]
    pose = None
    if any(v is not None for v in values):
        pose = np.array([np.nan if v is None else v for v in values]).reshape(4, 4)
        pose[:3, 3] *= 1e-3
        if not _rigid(pose):
            raise InputError(f"{path}, line {number}: T00..T33 is no rigid motion")
    index = told("index")
    if index is not None and (index < 0 or index != int(index)):
        raise InputError(f"{path}, line {number}: index {index:g} is not a count from 0")
    name = (row["file"] or "").strip()
    return Line(file=name, index=None if index is None else int(index), t=told("t_s"), pose=pose)


def _rigid(X: np.ndarray) -> bool:
    R = X[:3, :3]
    orthogonal = np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0
    return bool(np.isfinite(X).all() and orthogonal and np.allclose(X[3], [0, 0, 0, 1]))


def read_pose_log(path: Path, names: Sequence[str]) -> Trajectory:
    """Reads a controller's log: CSV with t_s and the seven joints in degrees, by name (A1..A6, E1).

    Raises:
        InputError: unreadable, a column missing, times that do not increase, or fewer than two lines.
    """
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        header = [h.strip() for h in rows[0]]
        order = [header.index(k) for k in ("t_s", *names)]
        data = np.array([[float(row[i]) for i in order] for row in rows[1:] if row])
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a log ({str(error)[:80]})") from None
    except (ValueError, IndexError) as error:
        wanted = ", ".join(("t_s", *names))
        raise InputError(
            f"{path}: a log has the columns {wanted}, joints in degrees ({str(error)[:60]})"
        ) from None
    if len(data) < 2 or not np.isfinite(data).all() or (np.diff(data[:, 0]) <= 0).any():
        raise InputError(f"{path}: at least two lines with increasing, finite times are expected")
    t, q = data[:, 0], np.deg2rad(data[:, 1:])
    qd = np.gradient(q, t, axis=0)
    return Trajectory(
        t=t, q=q, qd=qd, qdd=np.gradient(qd, t, axis=0), operation=np.zeros(len(t), int), operations=()
    )


def programme_captures(cell: Cell, trajectory: Trajectory) -> Captures:
    """All frames that a plan's programme takes, in its order."""
    return captures_from_trajectory(
        trajectory,
        lambda q: scanner_poses(cell, q),
        fps=cell.settings.process.fps,
        X_WT=cell.X_WT,
        X_TO=cell.X_TO,
    )


def posed(
    lines: Sequence[Line],
    cell: Cell,
    trajectory: Trajectory | None,
    log: Trajectory | None,
    *,
    offset_s: float = 0.0,
) -> tuple[Captures, str]:
    """Captures of the frames, one for each line, and where their poses came from.

    What is nearest to the measurement wins: poses in the list, then the log at the time stamps, then the
    programme at the time stamps, then the programme's frame of that index.

    Args:
        lines: of the frames.
        cell: whose kinematics the joints go through.
        trajectory: of the plan; None where there is none.
        log: of the controller; None where there is none.
        offset_s: added to the time stamps of the frames to give the log's, or the programme's, time [s].

    Raises:
        InputError: a frame without a pose.
    """
    t = np.array([np.nan if line.t is None else line.t for line in lines]) + offset_s
    if all(line.pose is not None for line in lines):
        return _given(lines, np.nan_to_num(t), cell), "the frames list's poses"
    timed = np.isfinite(t).all()
    if log is not None:
        if not timed:
            raise InputError("a log needs the frames' time stamps: a frames list with the column t_s")
        _check_log(log, t, lines)
        return captures_at(
            log, t, lambda q: scanner_poses(cell, q), X_WT=cell.X_WT, X_TO=cell.X_TO
        ), "the log"
    if trajectory is None:
        raise InputError("frames need poses: a frames list with T00..T33, a log, or a plan of this job")
    if timed:
        late = np.flatnonzero((t < -1e-6) | (t > trajectory.duration + 1e-6))
        if len(late):
            raise InputError(
                f"{lines[late[0]].file}: its time {t[late[0]]:.3f} s is outside of the programme's "
                f"0 to {trajectory.duration:.3f} s"
            )
        found = captures_at(trajectory, t, lambda q: scanner_poses(cell, q), X_WT=cell.X_WT, X_TO=cell.X_TO)
        return found, "the programme at the time stamps"
    return _indexed(lines, programme_captures(cell, trajectory)), "the programme's frames by index"


def _given(lines: Sequence[Line], t: np.ndarray, cell: Cell) -> Captures:
    X_OS = np.stack([line.pose for line in lines if line.pose is not None])
    return Captures(
        t=t, X_WS=cell.X_WT @ cell.X_TO @ X_OS, table_angle=np.zeros(len(t)), X_WT=cell.X_WT, X_TO=cell.X_TO
    )


def _check_log(log: Trajectory, t: np.ndarray, lines: Sequence[Line]) -> None:
    """Refuses frames about which the log says nothing."""
    at = np.searchsorted(log.t, t)
    for k in np.flatnonzero((t < log.t[0]) | (t > log.t[-1])):
        raise InputError(
            f"{lines[int(k)].file}: {t[k]:.3f} s is outside of the log, {log.t[0]:.3f} to {log.t[-1]:.3f} s"
        )
    after = np.clip(at, 1, len(log.t) - 1)
    for k in np.flatnonzero(log.t[after] - log.t[after - 1] > _GAP_S):
        raise InputError(
            f"{lines[int(k)].file}: the log has a gap of more than {_GAP_S:g} s about {t[k]:.3f} s"
        )


def _indexed(lines: Sequence[Line], captures: Captures) -> Captures:
    index = []
    for line in lines:
        if line.index is None:
            raise InputError(f"{line.file}: no pose, time stamp or index: nothing says where it was taken")
        if line.index >= len(captures):
            raise InputError(
                f"{line.file}: index {line.index}, but the programme takes {len(captures)} frames"
            )
        index.append(line.index)
    return captures.taken(np.array(index))
