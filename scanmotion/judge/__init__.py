"""The judge: looks at the written files of a plan and nothing else.

It imports nothing of the planner: kinematics are products of exponentials read from the plan's URDF,
collisions are FCL's on the part's true triangles, limits and speeds finite differences of trajectory.csv.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Trajectory
from scanmotion.judge.contact import check_clearance
from scanmotion.judge.frames import check_frames
from scanmotion.judge.helix import check_helices
from scanmotion.judge.limits import check_limits, check_record, check_settings, check_speed
from scanmotion.judge.motion import motion_from
from scanmotion.judge.views import check_operations, check_viewpoints
from scanmotion.plan_io.read import read_json, read_plan, read_trajectory

__all__ = ["Finding", "verify"]


def verify(folder: str | Path, *, progress: Callable[[float], None] | None = None) -> list[Finding]:
    """Judges a plan folder from its files alone.

    Args:
        folder: what `scanmotion plan` wrote.
        progress: told the share done.

    Returns:
        one Finding for each promise that is broken; empty where all hold.

    Raises:
        PlanFileError: the files cannot be read.
    """
    folder = Path(folder)
    record = read_plan(folder)
    trajectory = read_trajectory(folder, record)
    motion = motion_from(folder, record, trajectory)
    findings = check_record(record, motion)
    findings += check_settings(record, read_json(folder, record.cell_file))
    findings += check_limits(record, trajectory)
    findings += check_speed(record, trajectory, motion)
    findings += check_operations(record, trajectory)
    findings += check_viewpoints(record, trajectory, motion)
    findings += check_helices(record, trajectory, motion)
    if (folder / "summary.json").exists():
        findings += _check_summary(read_json(folder, "summary.json"), trajectory.duration)
    if (folder / "frames.csv").exists():
        findings += check_frames(folder, record, trajectory, motion.arm)
    if (folder / "trajectory.json").exists():
        findings += _check_twin(read_json(folder, "trajectory.json"), trajectory)
    if trajectory.duration > record.process.budget_s:
        findings.append(
            Finding(
                code="budget",
                message=f"{trajectory.duration:.1f} s is over the budget of {record.process.budget_s:.1f} s",
                value=trajectory.duration,
                limit=record.process.budget_s,
            )
        )
    findings += check_clearance(folder, record, trajectory, motion.arm, progress=progress)
    return findings


def _check_summary(summary: object, duration: float) -> list[Finding]:
    time = summary.get("time_s") if isinstance(summary, dict) else None
    total = time.get("total") if isinstance(time, dict) else None
    if isinstance(total, int | float) and abs(total - duration) < 0.02:
        return []
    told = f"{total:g} s" if isinstance(total, int | float) else "nothing"
    text = f"summary.json says {told} of the total time, the trajectory lasts {duration:.2f} s"
    return [Finding(code="summary", message=text, value=duration, limit=duration)]


def _check_twin(data: object, trajectory: Trajectory) -> list[Finding]:
    """trajectory.json carries the same samples; a controller may be fed from either."""
    try:
        t = np.array(data["time"], dtype=float)  # type: ignore[index]
        q = np.array(data["position"], dtype=float)  # type: ignore[index]
        same = t.shape == trajectory.t.shape and q.shape == trajectory.q.shape
        # The CSV carries 0.1 ms and 1e-8 deg.
        if same and np.abs(t - trajectory.t).max() < 1e-4 and np.abs(q - trajectory.q).max() < 1e-8:
            return []
    except (KeyError, TypeError, ValueError):
        pass
    return [Finding(code="order", message="trajectory.json and trajectory.csv do not have the same samples")]
