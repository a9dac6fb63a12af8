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
from scanmotion.judge.margins import margins_of
from scanmotion.judge.motion import motion_from
from scanmotion.judge.views import check_operations, judge_viewpoints
from scanmotion.plan_io.read import read_json, read_plan, read_trajectory

__all__ = ["Finding", "margins_of", "verify"]


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
    # The budget is the scan's; what follows the last frame is the way home.
    scan_s = max((o.t_end for o in record.operations if o.kind != "transit"), default=trajectory.duration)
    findings = check_record(record, motion)
    findings += check_settings(record, read_json(folder, record.cell_file))
    findings += check_limits(record, trajectory)
    findings += check_speed(record, trajectory, motion)
    findings += check_operations(record, trajectory)
    findings += judge_viewpoints(record, trajectory, motion)
    findings += check_helices(record, trajectory, motion)
    if (folder / "summary.json").exists():
        findings += _check_summary(read_json(folder, "summary.json"), scan_s, trajectory.duration)
    if (folder / "frames.csv").exists():
        findings += check_frames(folder, record, trajectory, motion.arm)
    if (folder / "trajectory.json").exists():
        findings += _check_twin(read_json(folder, "trajectory.json"), trajectory)
    if scan_s > record.process.budget_s:
        findings.append(
            Finding(
                code="budget",
                message=f"{scan_s:.1f} s is over the budget of {record.process.budget_s:.1f} s",
                value=scan_s,
                limit=record.process.budget_s,
            )
        )
    findings += check_clearance(folder, record, trajectory, motion.arm, progress=progress)
    return findings


def _check_summary(summary: object, scan: float, cycle: float) -> list[Finding]:
    """The seconds that summary.json tells: `total` of the scan, `cycle` with the way home."""
    time = summary.get("time_s") if isinstance(summary, dict) else None
    found = []
    for key, seconds in (("total", scan), ("cycle", cycle)):
        told = time.get(key, seconds if key == "cycle" else None) if isinstance(time, dict) else None
        if isinstance(told, int | float) and abs(told - seconds) < 0.02:
            continue
        said = f"{told:g} s" if isinstance(told, int | float) else "nothing"
        what = "the scan lasts" if key == "total" else "the trajectory lasts"
        text = f"summary.json says {said} of the {key} time, {what} {seconds:.2f} s"
        found.append(Finding(code="summary", message=text, value=seconds, limit=seconds))
    return found


def _check_twin(data: object, trajectory: Trajectory) -> list[Finding]:
    """trajectory.json carries the same samples; a controller may be fed from either."""
    told = data if isinstance(data, dict) else {}
    try:
        t = np.array(told["time"], dtype=float)
        q = np.array(told["position"], dtype=float)
        same = t.shape == trajectory.t.shape and q.shape == trajectory.q.shape
        # The CSV carries 0.1 ms and 1e-8 deg.
        if same and np.abs(t - trajectory.t).max() < 1e-4 and np.abs(q - trajectory.q).max() < 1e-8:
            return []
    except (KeyError, TypeError, ValueError):
        pass
    return [Finding(code="order", message="trajectory.json and trajectory.csv do not have the same samples")]
