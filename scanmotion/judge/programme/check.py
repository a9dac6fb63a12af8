"""Judges an exported programme as it stands in its file: by running it, in good and in bad circumstances.

What is promised holds for the file that was read, under the motion semantics that paths.py states. Comments
and the wording of messages are not judged, nor a change that moves no joint farther than compare.py allows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.judge.contact import check_clearance
from scanmotion.judge.limits import check_speed
from scanmotion.judge.motion import motion_at
from scanmotion.judge.programme.bad_circumstances import bad_circumstances, strange_outputs
from scanmotion.judge.programme.compare import Deviation, path_deviations
from scanmotion.judge.programme.controller import (
    Controller,
    controller_from,
    driven_trajectory,
    with_clearance,
)
from scanmotion.judge.programme.frames_and_load import frames_and_load
from scanmotion.judge.programme.world import Run, ScriptedScanner
from scanmotion.judge.views import judge_viewpoints

SPEED_MORE, GAIN_MORE = 1.03, 1.25
"""By how much speeds and the accelerations of splines may exceed the plan's limits."""
MOVING = ("transit", "sweep", "helix", "path")
"""Kinds of operation in which the scanner's speed is judged."""
_FRAME_S = 0.012
"""Frames come with the controller's cycle."""


@dataclass(frozen=True, kw_only=True)
class ProgrammeReport:
    """What was found about a programme."""

    findings: tuple[Finding, ...]
    deviations: tuple[Deviation, ...]
    seconds: float
    """From the first step's start to the last step's end, with a scanner that answers at once."""
    planned_s: float
    frames: int
    """Frames that the programme triggers; 0 where it does not."""


def verify_programme(
    file: str | Path,
    folder: str | Path | None = None,
    *,
    clearance: bool = True,
    progress: Callable[[float], None] | None = None,
) -> ProgrammeReport:
    """Judges a programme against the plan that it was made from.

    Args:
        file: its main file.
        folder: of the plan; None is where the file lies.
        clearance: whether what was driven is tried for collisions too, which takes longest.
        progress: told the share done.

    Raises:
        PlanFileError: the plan or the programme cannot be read.
    """
    controller = controller_from(file, folder)
    scanner = ScriptedScanner(signals=controller.signals, patience=10_000 if controller.dry else 0)
    run, system = controller.run(scanner)
    found, findings = path_deviations(controller, run)
    if not run.ended:
        text = (run.said("say") or run.said("halt"))[-1].text if run.said("halt") else "the programme stops"
        findings.insert(0, Finding(code="order", message=f"it does not come to its end: {text}"))
    findings += (
        _signals(controller, run) + frames_and_load(controller, run, system) + _log(controller, run, system)
    )
    findings += _motion(controller, run, found, clearance, progress)
    if not findings and not controller.dry:
        findings += bad_circumstances(controller, run)
    own = run.t[run.step > 0]
    return ProgrammeReport(
        findings=tuple(findings), deviations=tuple(found),
        seconds=float(own[-1] - own[0]) if len(own) else 0.0, planned_s=controller.trajectory.duration,
        frames=len(run.said("pulse")),
    )  # fmt: skip


def _signals(controller: Controller, run: Run) -> list[Finding]:
    """The scanner records while it should and not otherwise, frame by frame; the word tells the step."""
    findings = []
    s = controller.signals
    moving = np.append(False, np.abs(np.diff(run.q, axis=0)).max(axis=1) > 1e-6)
    for n, o in enumerate(controller.planned, 1):
        own = run.step == n
        should = o.scanning and not controller.dry and s.start_out > 0
        wrong = own & moving & (run.recording != should)
        if wrong.any() or (should and not (own & run.recording).any()):
            state, when = "off" if should else "on", run.t[wrong.argmax()]
            text = f"step {n} ({o.kind}): the scanner is {state} at {when:.2f} s"
            findings.append(Finding(code="order", message=text, where=f"step {n}"))
        if should and s.frame_out and not s.frame_in:
            findings += _frames(controller, run, n, n in run.gains)
    begun = sum(e.on for e in run.said("output") if e.number == s.start_out)
    scans = 0 if controller.dry else sum(o.scanning for o in controller.planned)
    if s.start_out and begun != scans:
        text = f"the scanner records {begun} times, {scans} steps scan"
        findings.append(Finding(code="order", message=text))
    if run.recording[-1] or (run.recording & (run.step == 0)).any():
        findings.append(Finding(code="order", message="the scanner is on outside of the steps"))
    words = [e.number for e in run.said("word") if e.number]
    if s.step_out:
        span = f"{s.step_out}..{s.step_out + s.step_bits - 1}"
        steps = [e.number for e in run.said("step") if e.number]
        if words != steps or any(not span.startswith(e.text) for e in run.said("word")):
            text = f"the outputs {span} do not tell the step's number"
            findings.append(Finding(code="order", message=text))
    return findings + strange_outputs(controller, run)


def _frames(controller: Controller, run: Run, n: int, timed: bool) -> list[Finding]:
    """Frames of a step: on the cell's output, 1 / fps apart, and as many as the plan takes."""
    own = run.t[(run.step == n) & run.recording]
    if len(own) == 0:
        return []
    pulses = [e for e in run.said("pulse") if own[0] - 1e-6 <= e.t <= own[-1] + 1e-6]
    apart = np.diff([e.t for e in pulses])
    every = 1 / controller.record.process.fps
    o = controller.planned[n - 1]
    expected = (o.t_end - o.t_start if timed else own[-1] - own[0]) / every
    text = ""
    if any(e.number != controller.signals.frame_out for e in pulses):
        text = f"the frames are not pulses of output {controller.signals.frame_out}"
    elif abs(len(pulses) - expected) > 2.5 or (len(apart) and np.abs(apart - every).max() > _FRAME_S):
        text = f"{len(pulses)} frames instead of {expected:.0f}, {every:.3f} s apart"
    return [Finding(code="order", message=f"step {n}: {text}", where=f"step {n}")] if text else []


def _log(controller: Controller, run: Run, system: dict[Any, Any]) -> list[Finding]:
    """A KUKA programme keeps each frame's time and joints."""
    logged = system.get("LOG")
    pulses = run.said("pulse")
    if controller.programme.language != "krl" or logged is None or not pulses:
        return []
    times, joints = logged
    told = set(range(1, len(pulses) + 1))
    if set(times) == told == set(joints) and all(
        np.abs(np.array(list(joints[i].values())) - run.q[np.searchsorted(run.t, e.t - 1e-9)]).max() < 1e-6
        for i, e in enumerate(pulses, 1)
    ):
        return []
    return [Finding(code="order", message=f"the log has {len(times)} of {len(pulses)} frames", where="log")]


def _motion(
    controller: Controller,
    run: Run,
    found: list[Deviation],
    clearance: bool,
    progress: Callable[[float], None] | None,
) -> list[Finding]:
    """Ranges, speeds, accelerations, viewpoints and clearance of what was driven."""
    limits, findings = controller.record.limits, []
    low = np.array([-np.inf if v is None else np.rad2deg(v) for v in limits.position_min_rad])
    high = np.array([np.inf if v is None else np.rad2deg(v) for v in limits.position_max_rad])
    fastest, gain = np.rad2deg(limits.velocity_rad_s), np.rad2deg(limits.acceleration_rad_s2)
    step = np.diff(run.t)
    steady = step > 1e-4
    qd = np.abs(np.diff(run.q, axis=0))[steady] / step[steady, None]
    for j, name in enumerate(controller.record.joint_names):
        if (run.q[:, j] < low[j] - 1e-3).any() or (run.q[:, j] > high[j] + 1e-3).any():
            findings.append(Finding(code="position", message=f"{name} leaves its range", where=name))
        if qd[:, j].max(initial=0.0) > fastest[j] * SPEED_MORE + 0.01:
            text = f"{name}: {qd[:, j].max():.2f} deg/s, {fastest[j]:.2f} allowed"
            findings.append(Finding(code="velocity", message=text, where=name))
        for n, most in run.gains.items():
            if most[j] > gain[j] * GAIN_MORE + 0.5:
                text = f"step {n}: {name} at {most[j]:.1f} deg/s2, {gain[j]:.1f} allowed"
                findings.append(Finding(code="acceleration", message=text, where=name))
    driven = driven_trajectory(controller, run)
    if driven is None:
        return findings
    record = _with_operations(controller, driven)
    motion = motion_at(controller.drive.arm, record, driven.t, driven.q)
    process = record.process
    more = process.model_copy(
        update={
            "scan_speed_m_s": process.scan_speed_m_s * SPEED_MORE + 1e-3,
            "transit_speed_m_s": process.transit_speed_m_s * SPEED_MORE + 1e-3,
        }
    )
    loose = record.model_copy(update={"process": more})
    kept = [f for f in check_speed(loose, driven, motion) if f.where in MOVING]
    findings += kept + judge_viewpoints(record, driven, motion)
    if clearance and not findings:
        away = max((d.away_mm for d in found), default=0.0) * 1e-3
        if away > process.clearance_m / 2:
            text = f"the path leaves the plan's by {away * 1e3:.1f} mm, more than half of the clearance"
            findings.append(Finding(code="clearance", message=text, value=away))
        asked = with_clearance(record, max(process.clearance_m - away, 1e-4))
        findings += check_clearance(controller.folder, asked, driven, controller.drive.arm, progress=progress)
    return findings


def _with_operations(controller: Controller, driven: Any) -> Any:
    """plan.json with the times at which the operations were driven."""
    planned = [controller.record.operations[o.index] for o in controller.planned]
    operations = tuple(
        p.model_copy(update={"index": o.index, "t_start": o.t_start, "t_end": o.t_end})
        for p, o in zip(planned, driven.operations, strict=True)
    )
    return controller.record.model_copy(update={"operations": operations})


def summary_of(report: ProgrammeReport) -> dict[str, Any]:
    """The report as plain values, for JSON."""
    return {
        "ok": not report.findings,
        "findings": [str(f) for f in report.findings],
        "seconds": round(report.seconds, 3),
        "planned_s": round(report.planned_s, 3),
        "frames": report.frames,
        "steps": [{k: _plain(v) for k, v in vars(d).items()} for d in report.deviations],
    }


def _plain(value: Any) -> Any:
    return round(value, 5) if isinstance(value, float) else value
