"""Runs an exported programme in time against a simulated scanner, with arm and table in Drake's Simulator.

What a programme does is found by the judge's machine; where arm and table really are meanwhile is found by
Drake behind position control. The frames are taken where they really are.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanmotion.controller.log import Executed, RunLog, executed_from
from scanmotion.core.errors import InputError
from scanmotion.judge.programme.controller import READERS, Controller, controller_from
from scanmotion.judge.programme.world import Run, ScriptedScanner
from scanmotion.plan_io.load import cell_of

ANSWERS = ("at-once", "late", "never")
LATE_SHARE = 1.5
"""A late answer takes this many time-outs."""


@dataclass(frozen=True, kw_only=True)
class Circumstances:
    """What goes wrong in a run."""

    ready: str = "at-once"
    done: str = "at-once"
    faults: tuple[int, ...] = ()
    """Recordings, counted from 1, that a fault of the scanner breaks off."""
    stop_at: float = np.inf
    """When the power goes [s]."""
    patience: int = 100
    """How often somebody presses start after a halt."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Simulated:
    """A run and what was left behind."""

    log: RunLog
    executed: Executed
    commanded: np.ndarray
    """Joints that the controller commanded, shape (n, 7) [deg]."""
    said: tuple[str, ...]
    """Messages and halts, with their times."""

    @property
    def lag_deg(self) -> float:
        """Greatest distance of a joint from where it is told to be."""
        return float(np.abs(self.log.q - self.commanded).max())


def programme_in(folder: Path) -> Path:
    """The programme's main file in a plan's folder.

    Raises:
        InputError: there is none, or more than one.
    """
    found = sorted(p for p in folder.glob("*") if p.suffix.lower() in READERS)
    found = [p for p in found if not p.stem[-4:-3] == "_" or not p.stem[-3:].isdigit()]
    if len(found) != 1:
        names = ", ".join(p.name for p in found) or "none"
        raise InputError(
            f"{folder}: one exported programme is expected, there are: {names}; name it (--programme)"
        )
    return found[0]


def run_programme(
    file: str | Path,
    folder: str | Path,
    circumstances: Circumstances | None = None,
    *,
    start: np.ndarray | None = None,
    dynamics: bool = True,
) -> Simulated:
    """Runs a programme from where the robot stands.

    Args:
        file: the programme's main file.
        folder: of its plan.
        circumstances: what goes wrong.
        start: joints (7,) [deg]; None is the plan's start.
        dynamics: whether arm and table are simulated; else they are where they are told to be.

    Raises:
        PlanFileError: plan or programme cannot be read.
        InputError: an answer that no scanner gives.
    """
    how = circumstances or Circumstances()
    if how.ready not in ANSWERS or how.done not in ANSWERS:
        raise InputError(f"a scanner answers {', '.join(ANSWERS)}")
    controller = controller_from(file, folder)
    scanner = _scanner(controller, how)
    run, _ = controller.run(scanner, start)
    real = run.q
    if dynamics and len(run.t) > 2:
        from scanmotion.controller.plant import tracked

        fresh = np.append(True, np.diff(run.t) > 1e-9)
        found = tracked(cell_of(Path(folder), controller.record)[1], run.t[fresh], np.deg2rad(run.q[fresh]))
        real = np.rad2deg(np.column_stack([np.interp(run.t, run.t[fresh], found[:, j]) for j in range(7)]))
    log = _log(run, real)
    reason = "" if run.ended else _reason(run, how)
    executed = executed_from(log, Path(file).name, ended=run.ended, reason=reason)
    said = tuple(
        f"{e.t:.2f} s: {e.kind} {e.text}".strip() for e in run.events if e.kind in ("say", "halt", "brake")
    )
    return Simulated(log=log, executed=executed, commanded=run.q, said=said)


def _scanner(controller: Controller, how: Circumstances) -> ScriptedScanner:
    s = controller.signals
    scanner = ScriptedScanner(
        signals=s, faults=frozenset(how.faults), patience=how.patience, stop_at=how.stop_at
    )
    if how.ready == "never":
        scanner.ready_after, scanner.patience = np.inf, 0
    elif how.ready == "late":
        never, _ = controller.run(ScriptedScanner(signals=s, ready_after=np.inf))
        scanner.ready_after = never.t[-1] + (LATE_SHARE - 1) * s.ready_timeout_s
    if how.done == "never":
        scanner.done_after, scanner.patience = np.inf, 0
    elif how.done == "late":
        scanner.late_done = LATE_SHARE * s.done_timeout_s
    return scanner


def _reason(run: Run, how: Circumstances) -> str:
    if run.t[-1] >= how.stop_at - 0.02:
        return f"the power went at {run.t[-1]:.2f} s"
    halts = run.said("halt")
    return halts[-1].text if halts else "the programme halts"


def _log(run: Run, real: np.ndarray) -> RunLog:
    frame = np.zeros(len(run.t), int)
    pulses = [e.t for e in run.said("pulse")]
    for n, t in enumerate(pulses, 1):
        frame[int(np.clip(np.searchsorted(run.t, t - 1e-9), 0, len(run.t) - 1))] = n
    return RunLog(t=run.t, q=real, step=run.step, recording=run.recording, frame=frame)
