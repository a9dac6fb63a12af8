"""What a programme does when something is wrong: the robot is elsewhere, the scanner late or faulty."""

import numpy as np

from scanmotion.core.finding import Finding
from scanmotion.judge.programme.compare import path_deviations
from scanmotion.judge.programme.controller import Controller
from scanmotion.judge.programme.world import Run, ScriptedScanner

OFF_START_DEG = 2.0
"""Where the programme must not begin to move: this far from the start."""
BACK_MORE_DEG = 0.1
"""How much farther from the path the way back after a fault may be: from where the brakes hold one line leads
to the last counted point."""
_STOPPED_S = 1.0
"""So long after a fault of its table an arm stands still."""


def strange_outputs(controller: Controller, run: Run) -> list[Finding]:
    """Outputs that the cell's settings do not give to the programme, and frames while nothing records."""
    s = controller.signals
    allowed = {s.start_out, *range(s.step_out, s.step_out + s.step_bits * bool(s.step_out))}
    if controller.programme.language == "urscript":
        allowed.add(s.table_start_out)
    strange = sorted({e.number for e in run.said("output")} - allowed)
    if s.start_out and s.frame_out:
        on = False
        for e in run.events:
            on = e.on if e.kind == "output" and e.number == s.start_out else on
            if e.kind == "pulse" and not on:
                text = f"a frame is asked for at {e.t:.2f} s, while the scanner does not record"
                return [Finding(code="order", message=text)]
    if not strange:
        return []
    text = f"it switches the outputs {strange}, the cell has none there"
    return [Finding(code="order", message=text)]


def bad_circumstances(controller: Controller, good: Run) -> list[Finding]:
    """What the programme does when it begins elsewhere, and when the scanner is not ready, done or well."""
    findings, s = [], controller.signals
    for j in range(7):
        start = controller.start.copy()
        start[j] += OFF_START_DEG
        run, _ = controller.run(ScriptedScanner(signals=s), start)
        if np.abs(run.q - start).max() > 1e-9 or run.ended or not _spoke(run):
            text = f"it begins with {controller.record.joint_names[j]} {OFF_START_DEG:g} deg from the start"
            findings.append(Finding(code="order", message=text, where="start"))
    if s.ready_in:
        findings += _times_out(controller, "ready", s.ready_timeout_s)
    if s.done_in:
        findings += _times_out(controller, "done", s.done_timeout_s)
    if s.fault_in:
        seconds = _recordings(controller, good)
        findings += _faults(controller, [min(x / 2, 2.0) for x in seconds])
        if not findings:
            findings += _faults(controller, [0.85 * x for x in seconds])
    if controller.programme.language == "urscript":
        findings += _lost_table(controller)
    return findings


def _spoke(run: Run) -> bool:
    """Whether the operator was told something before the halt."""
    return bool(run.said("halt")) and bool(run.said("say")) and len(run.said("halt")[-1].text) > 5


def _times_out(controller: Controller, what: str, limit: float) -> list[Finding]:
    """A scanner that answers late: a message after the time-out, and a new wait when it was acknowledged."""
    run, _ = controller.run(_late(controller, what))
    halts = run.said("halt")
    moves = np.flatnonzero(np.abs(np.diff(run.q, axis=0)).max(axis=1) > 1e-9) + 1
    before = [run.t[moves[run.t[moves] <= h.t][-1]] for h in halts[:1] if (run.t[moves] <= h.t).any()]
    still = halts[0].t - (before[0] if before else run.t[0]) if halts else 0.0
    if run.ended and _spoke(run) and len(halts) == 1 and -0.02 <= still - limit < 0.5:
        return strange_outputs(controller, run)
    text = f"a scanner that is late to be {what} is waited for {still:.1f} s, not {limit:g} s and a message"
    return [Finding(code="order", message=text, where="handshake")]


def _late(controller: Controller, what: str) -> ScriptedScanner:
    """A scanner that takes one and a half time-outs for the first recording."""
    s = controller.signals
    if what == "done":
        return ScriptedScanner(signals=s, late_done=1.5 * s.done_timeout_s, patience=1)
    never, _ = controller.run(ScriptedScanner(signals=s, ready_after=np.inf))
    arrived = never.t[-1] - s.ready_timeout_s
    return ScriptedScanner(signals=s, ready_after=arrived + 1.5 * s.ready_timeout_s, patience=1)


def _recordings(controller: Controller, run: Run) -> list[float]:
    """How long each recording of a run lasts [s]."""
    told = [e for e in run.said("output") if e.number == controller.signals.start_out]
    begun = [(e.t, next((x.t for x in told[i:] if not x.on), run.t[-1])) for i, e in enumerate(told) if e.on]
    return [float(b - a) for a, b in begun]


def _faults(controller: Controller, times: list[float]) -> list[Finding]:
    """A fault in each step that scans: a stop, a message, the way back along what was driven, and again.

    Args:
        controller: what the programme runs on.
        times: when, after the start of its recording, each step's fault comes [s].
    """
    planned = controller.planned
    # Every second recording is broken off: each step once, and its repetition goes well.
    scanner = ScriptedScanner(
        signals=controller.signals, faults=frozenset(range(1, 2 * len(times), 2)), patience=len(times),
        fault_times=tuple(max(float(x), 0.05) for x in np.repeat(times, 2)),
    )  # fmt: skip
    run, _ = controller.run(scanner)
    findings = strange_outputs(controller, run)
    counts = {len(run.said(kind)) for kind in ("brake", "halt")}
    if not run.ended or scanner.recordings != 2 * len(times) or counts != {len(times)}:
        text = "a fault of the scanner does not lead to a stop, a message, the way back and a new try"
        findings.append(Finding(code="order", message=text, where="handshake"))
    found, more = path_deviations(controller, run, wider_deg=BACK_MORE_DEG)
    # The steps take longer and go farther, by the way back; their place is what counts.
    findings += [f for f in more if " deg longer " not in f.message and f.code != "time"]
    if len(found) != len(planned):
        text = "a fault of the scanner loses a step"
        findings.append(Finding(code="order", message=text, where="handshake"))
    return findings


def _lost_table(controller: Controller) -> list[Finding]:
    """A fault of the table's own drive in the middle of a step: the arm stops, and says so, for good."""
    turning = [o for o in controller.planned if abs(o.q_end[6] - o.q_start[6]) > 1e-3]
    if not turning:
        return []
    at = (turning[0].t_start + turning[0].t_end) / 2
    run, _ = controller.run(ScriptedScanner(signals=controller.signals, table_fault_at=at))
    halts = [i for i, e in enumerate(run.events) if e.kind == "halt"]
    on: dict[int, bool] = {}
    for e in run.events[: halts[-1]] if halts else ():
        on |= {e.number: e.on} if e.kind == "output" else {}
    s = controller.signals
    late = run.q[run.t > at + _STOPPED_S]
    stands = len(late) == 0 or np.abs(late - late[0]).max() < 1e-6
    off = not on.get(s.start_out, False) and not on.get(s.table_start_out, False)
    if not run.ended and _spoke(run) and len(halts) == 1 and stands and off:
        return strange_outputs(controller, run)
    text = "a fault of the table's drive does not stop the arm with its outputs off and a message"
    return [Finding(code="order", message=text, where="handshake")]
