"""Positions, velocities, accelerations and jerks by finite differences; the scanner's speed; rest."""

import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Trajectory
from scanmotion.judge.motion import Motion
from scanmotion.plan_io.schema import PlanRecord

_ROUNDING = np.deg2rad(0.5e-8)
"""Half of the last decimal that trajectory.csv carries [rad]."""
LONGEST_STEP_S = 0.0101


def check_record(record: PlanRecord, motion: Motion) -> list[Finding]:
    """Whether the limits that the plan states are those of the robot that it names."""
    findings = []
    arm, limits = motion.arm, record.limits
    for i, name in enumerate(record.joint_names[:6]):
        low, high = limits.position_min_rad[i], limits.position_max_rad[i]
        stated = (low, high, limits.velocity_rad_s[i])
        if low is None or high is None or low < arm.lower[i] - 1e-6 or high > arm.upper[i] + 1e-6:
            text = (
                f"{name}: the plan states the range {low} .. {high}, "
                f"the URDF {arm.lower[i]:.4f} .. {arm.upper[i]:.4f}"
            )
            findings.append(Finding(code="limits", message=text, where=name))
        if stated[2] > arm.velocity[i] * (1 + 1e-6):
            text = f"{name}: the plan states {stated[2]:.4f} rad/s, the URDF {arm.velocity[i]:.4f} rad/s"
            findings.append(
                Finding(
                    code="limits", message=text, where=name, value=stated[2], limit=float(arm.velocity[i])
                )
            )
    return findings


def check_limits(record: PlanRecord, trajectory: Trajectory) -> list[Finding]:
    """Joint positions and their first three derivatives against the stated limits."""
    findings = []
    t, q, limits = trajectory.t, trajectory.q, record.limits
    steps = np.diff(t)
    if steps.max() > LONGEST_STEP_S:
        text = f"samples are up to {steps.max() * 1e3:.1f} ms apart, 10 ms are promised"
        findings.append(Finding(code="sampling", message=text, value=float(steps.max()), limit=0.01))
    low = np.array([-np.inf if v is None else v for v in limits.position_min_rad])
    high = np.array([np.inf if v is None else v for v in limits.position_max_rad])
    over = np.maximum(low - q, q - high) - 1e-6
    for j in np.flatnonzero(over.max(axis=0) > 0):
        k = int(np.argmax(over[:, j]))
        text = f"{record.joint_names[j]} passes its range by {np.rad2deg(over[k, j]):.3f} deg at {t[k]:.2f} s"
        findings.append(
            Finding(
                code="position", message=text, where=record.joint_names[j], value=float(q[k, j]),
                limit=float(high[j] if q[k, j] > high[j] else low[j]), t=float(t[k]),
            )
        )  # fmt: skip
    value, at = q, t
    bounds = (
        ("velocity", limits.velocity_rad_s, "deg/s", 1.001),
        ("acceleration", limits.acceleration_rad_s2, "deg/s2", 1.01),
        ("jerk", limits.jerk_rad_s3, "deg/s3", 1.05),
    )
    noise = np.full((len(t), 1), _ROUNDING)
    for code, bound, unit, tolerance in bounds:
        width = np.diff(at)
        value = np.diff(value, axis=0) / width[:, None]
        at = (at[1:] + at[:-1]) / 2
        # Kept by row: a single short step must not excuse the others.
        noise = (noise[1:] + noise[:-1]) / width[:, None]
        if len(value) == 0:
            break
        ratio = (np.abs(value) - noise) / np.array(bound)
        findings += _over(code, ratio, value, bound, at, record, unit, tolerance)
    return findings


def _over(code, ratio, value, bound, at, record, unit, tolerance) -> list[Finding]:
    findings = []
    for j in np.flatnonzero(ratio.max(axis=0) > tolerance):
        k = int(np.argmax(ratio[:, j]))
        name, found, limit = record.joint_names[j], abs(float(value[k, j])), float(bound[j])
        text = f"{name}: {np.rad2deg(found):.2f} {unit} at {at[k]:.2f} s, {np.rad2deg(limit):.2f} allowed"
        findings.append(
            Finding(code=code, message=text, where=name, value=found, limit=limit, t=float(at[k]))
        )
    return findings


def check_speed(record: PlanRecord, trajectory: Trajectory, motion: Motion) -> list[Finding]:
    """The scanner's speed: in W during transits, helices and paths, relative to the part in sweeps."""
    findings = []
    steps = np.diff(trajectory.t)
    world = np.linalg.norm(np.diff(motion.X_WS[:, :3, 3], axis=0), axis=1) / steps
    part = np.linalg.norm(np.diff(motion.X_OS[:, :3, 3], axis=0), axis=1) / steps
    kinds = np.array([record.operations[o].kind for o in trajectory.operation[1:]])
    process = record.process
    for kind, speed, limit in (
        ("transit", world, process.transit_speed_m_s),
        ("sweep", part, process.scan_speed_m_s),
        ("dwell", world, 1e-4),
        ("revolution", world, 1e-4),
        ("helix", world, process.scan_speed_m_s),
        ("path", world, process.scan_speed_m_s),
    ):
        found = np.where(kinds == kind, speed, 0.0)
        k = int(np.argmax(found))
        if found[k] > limit * 1.001 + 1e-6:
            text = (
                f"the scanner moves at {found[k]:.4f} m/s in a {kind} at {trajectory.t[k]:.2f} s, "
                f"{limit:g} m/s allowed"
            )
            findings.append(
                Finding(
                    code="tcp_speed", message=text, where=kind, value=float(found[k]), limit=limit,
                    t=float(trajectory.t[k]),
                )
            )  # fmt: skip
    return findings


def check_settings(record: PlanRecord, cell: object) -> list[Finding]:
    """Whether plan.json promises what the cell's settings beside it ask for.

    Args:
        record: plan.json.
        cell: the settings as read from the folder, not trusted to have any shape.
    """
    settings = cell if isinstance(cell, dict) else {}
    process, table = settings.get("process"), settings.get("turntable")
    wanted: list[tuple[str, object, float]] = []
    if isinstance(process, dict):
        stated = record.process.model_dump()
        wanted += [(f"process.{k}", process.get(k), v) for k, v in stated.items()]
    if isinstance(table, dict):
        rpm = table.get("speed_rpm")
        speed = rpm * 2 * np.pi / 60 if isinstance(rpm, int | float) else None
        wanted += [
            ("turntable.speed_rpm", speed, record.limits.velocity_rad_s[6]),
            ("turntable.acceleration_rad_s2", table.get("acceleration_rad_s2"),
             record.limits.acceleration_rad_s2[6]),
        ]  # fmt: skip
    if len(wanted) < 8:
        return [Finding(code="limits", message=f"{record.cell_file}: not a cell's settings")]
    findings = []
    for key, asked, said in wanted:
        if not isinstance(asked, int | float) or abs(asked - said) > 1e-9 * max(1.0, abs(said)):
            text = f"{key}: plan.json has {said:g} where {record.cell_file} asks for {asked}"
            findings.append(Finding(code="limits", message=text, where=key, value=said))
    return findings
