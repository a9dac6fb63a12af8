"""How far a run leaves the plan: each step's joints against the planned path, and its seconds."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Operation
from scanmotion.judge.motion import motion_at
from scanmotion.judge.programme.controller import Controller
from scanmotion.judge.programme.world import Run

DENSE_DEG = 0.02
"""The planned path is resampled so that no joint moves farther between two of its points."""
TIMED_DEG, ROUNDED_DEG, SCAN_DEG = 0.05, 0.30, 0.06
"""How far a joint may be from the path: in a timed spline, where corners are rounded, while scanning."""
LONGER, LONGER_DEG = 0.002, 0.3
"""How much longer or shorter the way of the joint that goes farthest may be: a share, and in degrees."""
FASTER = 1.03
TIMED_S, TIMED_SHARE = 0.06, 0.01
"""By how much a timed step's seconds may differ; the handshake is part of a step that scans."""
_MOST_POINTS = 400_000


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """One step of the programme against its operation of the plan."""

    step: int
    kind: str
    timed: bool
    away_deg: float
    """Greatest distance of a joint from the planned path."""
    missed_deg: float
    """Greatest distance of the planned path from what was driven."""
    away_mm: float
    """Greatest distance of scanner, wrist or elbow from where the nearest planned joints have them."""
    longer_deg: float
    """By how much the way is longer than planned, in the joint that moves farthest at each instant."""
    seconds: float
    planned_s: float
    faster: float
    """Greatest speed of a joint, as a share of its greatest, against the same of the plan."""
    end_deg: float
    """How far the step ends from where the operation ends."""


def path_deviations(
    controller: Controller, run: Run, *, wider_deg: float = 0.0
) -> tuple[list[Deviation], list[Finding]]:
    """Each step against the plan, and what is farther off than it may be, by `wider_deg` more."""
    found, findings = [], []
    planned = controller.planned
    told = [e.number for e in run.said("step")]
    order = [n for n in told if n]
    if order != list(range(1, len(planned) + 1)):
        text = f"the steps run in the order {order[:20]}, the plan has 1 to {len(planned)}"
        findings.append(Finding(code="order", message=text))
    if run.ended and told[-1:] != [0]:
        findings.append(Finding(code="order", message="the step's number is not 0 at the end"))
    for n, o in enumerate(planned, 1):
        own = np.flatnonzero(run.step == n)
        if len(own) == 0:
            findings.append(_step_finding(n, o, "is missing"))
            continue
        rows = slice(max(own[0] - 1, 0), own[-1] + 1)
        if np.diff(own).max(initial=1) > 1:
            findings.append(_step_finding(n, o, "runs twice"))
        deviation = _compared(controller, run, n, o, rows)
        found.append(deviation)
        findings += _judged(deviation, o, wider_deg)
    return found, findings


def dense_path(q: np.ndarray) -> np.ndarray:
    """A path (n, 7) [deg] with points at most DENSE_DEG apart in every joint."""
    parts = np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1) / DENSE_DEG).clip(1)
    parts = (parts * min(1.0, _MOST_POINTS / parts.sum())).clip(1)
    at = np.append(0.0, np.cumsum(parts))
    fine = np.arange(int(at[-1]) + 1)
    return np.column_stack([np.interp(fine, at, q[:, j]) for j in range(q.shape[1])])


def _compared(controller: Controller, run: Run, n: int, o: Operation, rows: slice) -> Deviation:
    t = controller.trajectory
    samples = np.flatnonzero(t.operation == o.index)
    plan = dense_path(np.rad2deg(t.q[max(samples[0] - 1, 0) : samples[-1] + 1]))
    driven = run.q[rows]
    dense = dense_path(driven)
    away, nearest = cKDTree(plan).query(driven, p=np.inf)
    missed, _ = cKDTree(dense).query(plan[:: max(len(plan) // 4000, 1)], p=np.inf)
    return Deviation(
        step=n, kind=o.kind, timed=n in run.gains, away_deg=float(away.max()), missed_deg=float(missed.max()),
        away_mm=_millimetres(controller, driven, plan[nearest]),
        longer_deg=_length(driven) - _length(plan), faster=_faster(controller, run, rows, samples),
        seconds=float(run.t[rows][-1] - run.t[rows][0]), planned_s=o.t_end - o.t_start,
        end_deg=float(np.abs(driven[-1] - np.rad2deg(o.q_end)).max()),
    )  # fmt: skip


def _faster(controller: Controller, run: Run, rows: slice, samples: np.ndarray) -> float:
    t = run.t[rows]
    step = np.diff(t)
    steady = step > 1e-4
    now = np.abs(np.diff(run.q[rows], axis=0))[steady] / step[steady, None] / controller.drive.speed
    plan = np.rad2deg(np.abs(controller.trajectory.qd[samples])) / controller.drive.speed
    return float(now.max(initial=0.0) / max(plan.max(initial=0.0), 0.01))


def _length(q: np.ndarray) -> float:
    return float(np.abs(np.diff(q, axis=0)).max(axis=1).sum())


def _millimetres(controller: Controller, a: np.ndarray, b: np.ndarray) -> float:
    """Greatest distance of scanner, wrist and elbow between two series of joints."""
    step = max(len(a) // 500, 1)
    places = []
    for q in (a[::step], b[::step]):
        motion = motion_at(controller.drive.arm, controller.record, np.arange(len(q)), np.deg2rad(q))
        # Link frames are displacements: the elbow's place is where the third link carries its joint's axis.
        places.append(
            np.stack(
                [motion.X_WS[:, :3, 3], motion.X_WF[:, :3, 3], _joint(controller, motion.X_WL, 3)], axis=1
            )
        )
    return 1e3 * float(np.linalg.norm(places[0] - places[1], axis=2).max())


def _joint(controller: Controller, X_WL: np.ndarray, i: int) -> np.ndarray:
    """A point of joint i's axis in W, shape (n, 3)."""
    w, v = controller.drive.arm.screws[i, :3], controller.drive.arm.screws[i, 3:]
    return X_WL[:, i, :3, :3] @ np.cross(w, v) + X_WL[:, i, :3, 3]


def _judged(d: Deviation, o: Operation, wider: float) -> list[Finding]:
    """What of a step is farther from the plan than it may be."""
    findings = []
    allowed = (TIMED_DEG if d.timed else SCAN_DEG if o.scanning else ROUNDED_DEG) + wider
    for value, what in (
        (d.away_deg, "leaves the planned path"),
        (d.missed_deg, "leaves out a part of the path"),
    ):
        if value > allowed:
            text = f"{what} by {value:.3f} deg ({d.away_mm:.1f} mm), {allowed:g} deg are allowed"
            findings.append(_step_finding(d.step, o, text, value=np.deg2rad(value)))
    if d.end_deg > 2e-3:
        findings.append(_step_finding(d.step, o, f"ends {d.end_deg:.4f} deg from where the plan does"))
    if abs(d.longer_deg) > LONGER_DEG + LONGER * abs(_length(np.rad2deg([o.q_start, o.q_end]))):
        text = f"the way is {d.longer_deg:.2f} deg longer than planned"
        findings.append(_step_finding(d.step, o, text))
    slowest = 0.35 if d.kind == "dwell" else np.inf
    if abs(d.seconds - d.planned_s) > slowest:
        text = f"takes {d.seconds:.2f} s instead of {d.planned_s:.2f} s"
        findings.append(_step_finding(d.step, o, text, code="time", value=d.seconds))
    if d.faster > FASTER and not d.timed and d.kind != "sweep":
        text = f"is {d.faster:.2f} times as fast as the plan at its fastest"
        findings.append(_step_finding(d.step, o, text, code="velocity", value=d.faster))
    if d.timed and abs(d.seconds - d.planned_s) > TIMED_S + TIMED_SHARE * d.planned_s:
        text = f"takes {d.seconds:.2f} s instead of {d.planned_s:.2f} s"
        findings.append(_step_finding(d.step, o, text, code="time", value=d.seconds))
    return findings


def _step_finding(n: int, o: Operation, text: str, *, code: str = "path", value: float = 0.0) -> Finding:
    name = f"step {n} ({o.kind} {' '.join(o.viewpoints[:3])})"
    return Finding(code=code, message=f"{name} {text}", where=f"step {n}", value=value, t=o.t_start)
