"""frames.csv and frames.json: where the scanner stands, by the plan, when it takes each frame.

Scanning software that is told the pose of each frame needs no markers. The poses are nominal: the plan's
joints at the frame's instant through the cell's kinematics. At 60 deg/s a point 0.34 m off the table's axis
moves 0.36 m/s, so a frame that comes 1 ms late is 0.36 mm off.
"""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import JsonValue

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.trajectory import Operation, Trajectory
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.typed_scipy import hermite_at, quaternions_from_rotations
from scanmotion.sensing.simulator.captures import captures_from_trajectory

VERSION = 1
_POSE = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
HEADER: tuple[str, ...] = (
    "index", "t_s", "operation", "kind", "viewpoint", "E1_deg", *(f"A{i}_deg" for i in range(1, 7)),
    *(f"OS_{k}" for k in _POSE), *(f"WS_{k}" for k in _POSE),
)  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameTable:
    """The frames of a programme in their order."""

    t: np.ndarray
    """Since the programme's start, shape (n,) [s]."""
    operation: np.ndarray
    """Index of the operation, shape (n,)."""
    kind: tuple[str, ...]
    viewpoint: tuple[str, ...]
    """Id of the viewpoint that a frame serves; where an operation serves several, of the nearest."""
    q: np.ndarray
    """Joints A1..A6, E1, shape (n, 7) [rad]."""
    X_OS: np.ndarray
    """Scanner in the object's frame, shape (n, 4, 4) [m]."""
    X_WS: np.ndarray
    """Scanner in the world, shape (n, 4, 4) [m]."""


def frame_table(trajectory: Trajectory, viewpoints: Sequence[Viewpoint], cell: Cell) -> FrameTable:
    """The frames that a trajectory takes: at the cell's rate, from the first instant of what scans.

    Args:
        trajectory: of the plan.
        viewpoints: of the plan.
        cell: with the scanner's rate and the kinematics.
    """
    captures = captures_from_trajectory(
        trajectory, lambda q: scanner_poses(cell, q), fps=cell.settings.process.fps, X_WT=cell.X_WT,
        X_TO=cell.X_TO,
    )  # fmt: skip
    X_OS, views = captures.X_OS, {v.id: v for v in viewpoints}
    ends = np.array([o.t_end for o in trajectory.operations if o.scanning])
    scans = [o for o in trajectory.operations if o.scanning]
    # A frame on the border of two operations that scan is the later one's first.
    own = [_owner(scans, ends, float(t)) for t in captures.t]
    names: list[str] = []
    for k, i in enumerate(own):
        ids = [v for v in scans[i].viewpoints if v in views]
        away = [np.linalg.norm(views[v].X_OS[:3, 3] - X_OS[k, :3, 3]) for v in ids]
        names.append(ids[int(np.argmin(away))] if ids else "")
    q = hermite_at(trajectory.t, trajectory.q, trajectory.qd, captures.t)
    return FrameTable(
        t=captures.t, operation=np.array([scans[i].index for i in own], int),
        kind=tuple(scans[i].kind for i in own), viewpoint=tuple(names), q=q.reshape(-1, 7), X_OS=X_OS,
        X_WS=captures.X_WS,
    )  # fmt: skip


def _owner(scans: Sequence[Operation], ends: np.ndarray, t: float) -> int:
    i = int(np.searchsorted(ends, t - 1e-9))
    nearer = i + 1 < len(scans) and t >= scans[i + 1].t_start - 1e-9
    return min(i + 1 if nearer else i, len(scans) - 1)


def frame_files(
    trajectory: Trajectory, viewpoints: Sequence[Viewpoint], cell: Cell
) -> dict[str, bytes | str]:
    """frames.csv (mm, degrees, unit quaternions) and frames.json (m, rad, 4x4 matrices)."""
    table = frame_table(trajectory, viewpoints, cell)
    return {"frames.csv": frames_csv(table), "frames.json": frames_json(table)}


def frames_csv(table: FrameTable) -> str:
    """One row a frame."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEADER)
    degrees = np.round(np.rad2deg(table.q), 6) + 0.0
    os_, ws = pose_columns(table.X_OS), pose_columns(table.X_WS)
    for i in range(len(table.t)):
        rows.writerow(
            [
                i, f"{table.t[i]:.4f}", table.operation[i], table.kind[i], table.viewpoint[i],
                f"{degrees[i, 6]:.6f}", *(f"{v:.6f}" for v in degrees[i, :6]),
                *(f"{v:.7f}" for v in os_[i]), *(f"{v:.7f}" for v in ws[i]),
            ]
        )  # fmt: skip
    return text.getvalue()


def pose_columns(X: np.ndarray) -> np.ndarray:
    """x, y, z [mm] and the unit quaternion w, x, y, z of poses, w >= 0, shape (n, 7)."""
    turned = quaternions_from_rotations(X[:, :3, :3])
    return np.round(np.column_stack([X[:, :3, 3] * 1e3, turned]), 7) + 0.0


def frames_json(table: FrameTable) -> str:
    """One document with an entry a frame."""
    entries: list[dict[str, JsonValue]] = [
        {
            "index": i, "t": round(float(table.t[i]), 6), "operation": int(table.operation[i]),
            "kind": table.kind[i], "viewpoint": table.viewpoint[i], "q": _told(table.q[i]),
            "X_OS": _told(table.X_OS[i]), "X_WS": _told(table.X_WS[i]),
        }
        for i in range(len(table.t))
    ]  # fmt: skip
    head = {"version": VERSION, "units": {"t": "s", "q": "rad", "pose": "m"}}
    return json.dumps({**head, "frames": entries}, allow_nan=False) + "\n"


def _told(a: np.ndarray) -> list[JsonValue]:
    return [*(np.round(a, 9) + 0.0).tolist()]
