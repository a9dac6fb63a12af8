"""frames.csv against the trajectory: as many frames as promised, each where its joints say."""

import csv
import io
from pathlib import Path

import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import SCANNING, Trajectory
from scanmotion.judge.motion import UrdfArm, motion_at
from scanmotion.plan_io.read import read_text
from scanmotion.plan_io.schema import PlanRecord

_Q_DEG, _PLACE_MM = 0.01, 0.01


def check_frames(folder: Path, record: PlanRecord, trajectory: Trajectory, arm: UrdfArm) -> list[Finding]:
    """Times, joints and poses of the frames, by the judge's own kinematics.

    Raises:
        PlanFileError: frames.csv cannot be read.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(read_text(folder, "frames.csv"))))
        t = np.array([float(r["t_s"]) for r in rows])
        q = np.array([[float(r[f"{a}_deg"]) for a in (*(f"A{i}" for i in range(1, 7)), "E1")] for r in rows])
        places = np.array([[float(r[f"{f}_{k}_mm"]) for f in ("OS", "WS") for k in "xyz"] for r in rows])
        operations = [int(r["operation"]) for r in rows]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        text = f"frames.csv is not what belongs there ({type(error).__name__})"
        return [Finding(code="frames", message=text)]
    spans = [o.t_end - o.t_start for o in record.operations if o.kind in SCANNING]
    expected = sum(int(span * record.process.fps + 1e-6) + 1 for span in spans)
    found = []
    # Rounding of a span's end may add or lose a frame.
    if abs(len(t) - expected) > len(spans):
        text = f"frames.csv has {len(t)} frames, {expected} are taken"
        found.append(Finding(code="frames", message=text, value=len(t), limit=expected))
    if len(t) == 0:
        return found
    scan = [0 <= i < len(record.operations) and record.operations[i].kind in SCANNING for i in operations]
    planned = np.column_stack([np.interp(t, trajectory.t, trajectory.q[:, j]) for j in range(7)])
    motion = motion_at(arm, record, t, np.deg2rad(q))
    own = np.hstack([motion.X_OS[:, :3, 3], motion.X_WS[:, :3, 3]]) * 1e3
    off = np.abs(np.rad2deg(planned) - q).max(axis=1)
    wrong = (off > _Q_DEG) | (np.abs(own - places).max(axis=1) > _PLACE_MM) | ~np.array(scan)
    for k in np.flatnonzero(wrong)[:3]:
        text = f"frame {k} at {t[k]:.3f} s is not where the trajectory has the scanner"
        found.append(Finding(code="frames", message=text, where=f"frame {k}", t=float(t[k])))
    return found
