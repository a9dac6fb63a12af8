"""Operations and viewpoints: order, rest, whole turns, and whether the scanner stands where it claims to."""

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Trajectory
from scanmotion.judge.motion import Motion, exponentials
from scanmotion.plan_io.schema import OperationRecord, PlanRecord, ViewpointRecord

_POSITION_M, _ANGLE = 1e-3, np.deg2rad(0.2)


def check_operations(record: PlanRecord, trajectory: Trajectory) -> list[Finding]:
    """Operations follow one another without a gap, start and end at rest, and do what their kind says."""
    findings, at = [], 0.0
    a = np.array(record.limits.acceleration_rad_s2)
    for n, o in enumerate(record.operations):
        name = f"operation {o.index} ({o.kind})"
        if o.index != n or abs(o.t_start - at) > 1e-3 or o.t_end <= o.t_start:
            text = f"{name} runs from {o.t_start:.3f} to {o.t_end:.3f} s, the one before ends at {at:.3f} s"
            findings.append(Finding(code="order", message=text, where=name, t=o.t_start))
        at = o.t_end
        where = np.flatnonzero((trajectory.t >= o.t_start - 1e-6) & (trajectory.t <= o.t_end + 1e-6))
        if len(where) < 2:
            findings.append(Finding(code="order", message=f"{name} has no samples", where=name, t=o.t_start))
            continue
        q, t = trajectory.q[where], trajectory.t[where]
        ends = max(np.abs(q[0] - o.q_start).max(), np.abs(q[-1] - o.q_end).max())
        if ends > 1e-5:
            text = f"{name} starts or ends {np.rad2deg(ends):.4f} deg from where plan.json says"
            findings.append(Finding(code="order", message=text, where=name, value=float(ends), t=float(t[0])))
        for first, second, when in ((0, 1, t[0]), (-2, -1, t[-1])):
            step = t[second] - t[first]
            move = np.abs(q[second] - q[first]) - a * step**2 - 1e-7
            if move.max() > 0:
                text = f"{name} is not at rest at {when:.2f} s"
                findings.append(Finding(code="rest", message=text, where=name, t=float(when)))
        findings += _kind(o, q, name, record)
    ends = np.array([o.t_end for o in record.operations])
    wrong = np.flatnonzero(np.searchsorted(ends, trajectory.t - 1e-6) != trajectory.operation)
    if len(wrong):
        k = int(wrong[0])
        text = f"the sample at {trajectory.t[k]:.2f} s is not in operation {trajectory.operation[k]}'s time"
        findings.append(Finding(code="order", message=text, t=float(trajectory.t[k])))
    last = record.operations[-1] if record.operations else None
    if last is not None and last.kind == "transit" and not last.viewpoints:
        away = float(np.abs(np.array(last.q_end) - record.home).max())
        if away > 1e-5:
            text = f"the way home ends {np.rad2deg(away):.3f} deg from home"
            findings.append(Finding(code="order", message=text, value=away, t=last.t_end))
    if abs(at - trajectory.duration) > 1e-3:
        text = f"the operations end at {at:.3f} s, the trajectory at {trajectory.duration:.3f} s"
        findings.append(Finding(code="order", message=text, value=trajectory.duration, limit=at))
    return findings


def _kind(o: OperationRecord, q: np.ndarray, name: str, record: PlanRecord) -> list[Finding]:
    arm = float(np.ptp(q[:, :6], axis=0).max())
    table = float(np.ptp(q[:, 6]))
    message = ""
    if o.kind == "revolution":
        if arm > 1e-5:
            message = f"{name}: the arm moves by {np.rad2deg(arm):.4f} deg"
        elif table < 2 * np.pi - 1e-4:
            message = f"{name}: the table turns {np.rad2deg(table):.2f} deg instead of 360"
    elif o.kind == "sweep" and table > 1e-5:
        message = f"{name}: the table turns by {np.rad2deg(table):.4f} deg"
    elif o.kind == "dwell":
        if max(arm, table) > 1e-5:
            message = f"{name}: something moves"
        elif o.t_end - o.t_start < record.process.dwell_s - 0.011:
            message = f"{name} lasts {o.t_end - o.t_start:.2f} s instead of {record.process.dwell_s:.2f} s"
    return [Finding(code="order", message=message, where=name, t=o.t_start)] if message else []


def judge_viewpoints(record: PlanRecord, trajectory: Trajectory, motion: Motion) -> list[Finding]:
    """Every viewpoint is served where it asked for, in the order claimed, or stands among the unreachable."""
    findings = []
    views = {v.id: v for v in record.viewpoints}
    if len(views) < len(record.viewpoints):
        findings.append(Finding(code="viewpoint", message="two viewpoints have the same id"))
    served: set[str] = set()
    for o in record.operations:
        if o.kind == "transit":
            continue
        where = np.flatnonzero((trajectory.t >= o.t_start - 1e-6) & (trajectory.t <= o.t_end + 1e-6))
        last = -1
        for name in o.viewpoints:
            if name not in views:
                text = f"operation {o.index} serves {name!r}, which is not among the viewpoints"
                findings.append(Finding(code="viewpoint", message=text, where=name, t=o.t_start))
                continue
            served.add(name)
            turns = views[name].kind == "revolution"
            if o.kind not in ("revolution", "helix") if turns else o.kind == "helix":
                text = f"{name} asks for a {views[name].kind}, operation {o.index} is a {o.kind}"
                findings.append(Finding(code="viewpoint", message=text, where=name, t=o.t_start))
            if len(where) == 0:
                continue
            off, angle, k = nearest(views[name], motion.X_OS[where])
            if o.kind == "path" and max(off, angle) > 0:
                # Passed at speed, and maybe between two samples.
                off, angle, _ = nearest(views[name], _around(motion.X_OS[where], k))
            if off > 0 or angle > 0:
                text = (
                    f"{name}: the scanner comes no closer than {(off + _POSITION_M) * 1e3:.1f} mm and "
                    f"{np.rad2deg(angle + _ANGLE):.2f} deg in operation {o.index}"
                )
                findings.append(
                    Finding(code="viewpoint", message=text, where=name, value=off, t=float(o.t_start))
                )
            elif o.kind in ("sweep", "helix", "path") and k < last:
                text = f"{name} is passed out of order in operation {o.index}"
                findings.append(Finding(code="order", message=text, where=name, t=float(o.t_start)))
            last = max(last, k)
    given_up = {name for name, _ in record.unreachable}
    for name in sorted(set(views) - served - given_up):
        text = f"{name} is neither served nor among the unreachable"
        findings.append(Finding(code="viewpoint", message=text, where=name))
    for name in sorted(served & given_up):
        text = f"{name} is served and among the unreachable"
        findings.append(Finding(code="viewpoint", message=text, where=name))
    return findings


def _around(X: np.ndarray, k: int, parts: int = 20) -> np.ndarray:
    """Poses (n, 4, 4) from the sample before k to the one after it, moved and turned evenly in between."""
    share = np.linspace(0.0, 1.0, parts + 1)
    rows = [X[k : k + 1]]
    for i in range(max(k - 1, 0), min(k + 1, len(X) - 1)):
        turn = Rotation.from_matrix(X[i, :3, :3].T @ X[i + 1, :3, :3]).as_rotvec()
        part = X[i] + share[:, None, None] * (X[i + 1] - X[i])
        part[:, :3, :3] = X[i, :3, :3] @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
        rows.append(part)
    return np.concatenate(rows)


def nearest(view: ViewpointRecord, X_OS: np.ndarray) -> tuple[float, float, int]:
    """By how much position and angle stay outside what the viewpoint allows, and at which sample least."""
    X = np.array(view.X_OS)
    if view.kind == "revolution":
        X_OS = _turned(X_OS, X, view.standoff_m, 2 if view.slack_roll else 0)
    p_S, z_S, z = X_OS[:, :3, 3], X_OS[:, :3, 2], X[:3, 2]
    tilt = np.arccos(np.clip(z_S @ z, -1, 1))
    # The allowed axis that is nearest to the scanner's own: it turns about the aimed point.
    kept = np.minimum(tilt, view.slack_tilt_rad)
    axis = np.sin(tilt - kept)[:, None] * z + np.sin(kept)[:, None] * z_S
    axis = np.where(tilt[:, None] > 1e-6, axis / np.maximum(np.sin(tilt), 1e-9)[:, None], z_S)
    low, high = view.slack_standoff_m
    aim = X[:3, 3] + view.standoff_m * z
    far = np.clip(np.sum((aim - p_S) * axis, axis=1), view.standoff_m + low, view.standoff_m + high)
    off = np.linalg.norm(p_S - (aim - far[:, None] * axis), axis=1) - _POSITION_M
    angle = tilt - view.slack_tilt_rad - _ANGLE
    if not view.slack_roll:
        trace = np.einsum("nij,ij->n", X_OS[:, :3, :3], X[:3, :3])
        angle = np.maximum(angle, np.arccos(np.clip((trace - 1) / 2, -1, 1)) - view.slack_tilt_rad - _ANGLE)
    k = int(np.argmin(np.maximum(off / _POSITION_M, angle / _ANGLE)))
    return float(off[k]), float(angle[k]), k


def _turned(X_OS: np.ndarray, X: np.ndarray, reach: float, first: int) -> np.ndarray:
    """Each pose turned about the table's axis as near to X as it comes, since any azimuth will do.

    What is brought together is the scanner's origin and the tips of its axes from the `first`, `reach`
    long, so that a scanner on the axis itself has an azimuth too. Where its roll is free, the tip of z
    alone counts.
    """
    tips = reach * np.eye(3)[first:]
    ours = np.concatenate([X_OS[:, None, :3, 3], X_OS[:, None, :3, 3] + tips @ _T(X_OS[:, :3, :3])], axis=1)
    wanted = np.concatenate([X[None, :3, 3], X[None, :3, 3] + tips @ X[:3, :3].T])
    dot = np.einsum("nkx,kx->n", ours[..., :2], wanted[:, :2])
    cross = (ours[..., 0] * wanted[:, 1] - ours[..., 1] * wanted[:, 0]).sum(axis=1)
    return exponentials(np.array([0, 0, 1.0, 0, 0, 0]), np.arctan2(cross, dot)) @ X_OS


def _T(R: np.ndarray) -> np.ndarray:
    return np.swapaxes(R, -1, -2)
