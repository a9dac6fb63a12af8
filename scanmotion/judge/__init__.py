"""The judge: looks at the written files of a plan and nothing else.

It imports nothing of the planner: kinematics are products of exponentials read from the plan's URDF,
collisions are FCL's on the part's true triangles, limits and speeds finite differences of trajectory.csv.
"""

from collections.abc import Callable
from pathlib import Path

from scanmotion.judge.finding import Finding
from scanmotion.judge.limits import check_limits, check_record, check_speed
from scanmotion.judge.motion import motion_from
from scanmotion.judge.solids import check_clearance
from scanmotion.judge.views import check_operations, check_viewpoints
from scanmotion.planfile import read_json, read_plan, read_trajectory

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
    findings += check_limits(record, trajectory)
    findings += check_speed(record, trajectory, motion)
    findings += check_operations(record, trajectory)
    findings += check_viewpoints(record, trajectory, motion)
    if (folder / "summary.json").exists():
        findings += _check_summary(read_json(folder, "summary.json"), trajectory.duration)
    if trajectory.duration > record.process.budget_s:
        findings.append(
            Finding(
                code="budget",
                message=f"{trajectory.duration:.1f} s is over the budget of {record.process.budget_s:.1f} s",
                value=trajectory.duration,
                limit=record.process.budget_s,
            )
        )
    findings += check_clearance(folder, record, motion, progress=progress)
    return findings


def _check_summary(summary: object, duration: float) -> list[Finding]:
    total = summary.get("time_s", {}).get("total") if isinstance(summary, dict) else None
    if isinstance(total, int | float) and abs(total - duration) < 0.02:
        return []
    text = f"summary.json says {total} s in total, the trajectory lasts {duration:.2f} s"
    return [Finding(code="summary", message=text, value=duration, limit=duration)]
