"""A programme's file on the controller of its plan's cell: which reader, machine data and scanner."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.cell.settings.cell import CellSettings, settings_from
from scanmotion.cell.settings.programme import ProgrammeSettings
from scanmotion.core.errors import PlanFileError
from scanmotion.core.trajectory import Operation, Trajectory
from scanmotion.judge.motion import arm_from_urdf
from scanmotion.judge.programme.arm_and_table import ArmAndTable
from scanmotion.judge.programme.language.krl import read_krl
from scanmotion.judge.programme.language.rapid import read_rapid
from scanmotion.judge.programme.language.statements import Programme
from scanmotion.judge.programme.language.urscript import read_urscript
from scanmotion.judge.programme.machine import Machine
from scanmotion.judge.programme.paths import Drive
from scanmotion.judge.programme.world import Run, World
from scanmotion.plan_io.read import read_json, read_plan, read_text, read_trajectory
from scanmotion.plan_io.schema import PlanRecord

READERS: dict[str, Callable[[Path], Programme]] = {
    ".src": read_krl, ".mod": read_rapid, ".script": read_urscript,
}  # fmt: skip
"""By the ending of a programme's main file."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Controller:
    """What a programme is run on."""

    folder: Path
    programme: Programme
    record: PlanRecord
    trajectory: Trajectory
    signals: ProgrammeSettings
    mass: float
    """Of the tool by the cell's settings [kg]."""
    drive: Drive

    @property
    def dry(self) -> bool:
        """Whether the programme says that it is a dry run."""
        return any(r.startswith("DRY RUN") for r in self.programme.remarks)

    @property
    def planned(self) -> list[Operation]:
        """The plan's operations that last; the programme has a step for each."""
        t = self.trajectory
        return [o for o in t.operations if (t.operation == o.index).any()]

    @property
    def start(self) -> np.ndarray:
        """Where the plan starts, shape (7,) [deg]."""
        return np.rad2deg(self.trajectory.q[0])

    @property
    def longest_s(self) -> float:
        """What no run of the programme takes: dry, late, with a fault in each step [s]."""
        s = self.signals
        waits = (len(self.planned) + 2) * 4 * (s.ready_timeout_s + s.done_timeout_s)
        return 60 + waits + (15 if self.dry else 4) * self.trajectory.duration

    def run(self, world: World, start: np.ndarray | None = None) -> tuple[Run, dict[Any, Any]]:
        """The log of a run, and the controller's variables after it.

        Args:
            world: scanner, operator, power.
            start: where the robot stands, shape (7,) [deg]; None is where the plan starts.

        Raises:
            PlanFileError: the programme has a statement without a meaning.
        """
        low, high = self.record.limits.position_min_rad[6], self.record.limits.position_max_rad[6]
        facts: dict[Any, Any] = {
            ("$EX_AX_NUM", None, ""): 1,
            ("$SOFTN_END", 7, ""): -1e9 if low is None else float(np.rad2deg(low)) - 1e-6,
            ("$SOFTP_END", 7, ""): 1e9 if high is None else float(np.rad2deg(high)) + 1e-6,
            ("$ROBROOT", None, ""): dict.fromkeys("XYZABC", 0.0),
            "LONGEST": self.longest_s, "STEP": self.programme.step, "START_OUT": self.signals.start_out,
            "SIGNALS": self.signals,
        }  # fmt: skip
        kind = ArmAndTable if self.programme.language == "urscript" else Machine
        machine = kind(self.programme, self.drive, world, self.start if start is None else start, facts)
        run = machine.run()
        log = [machine.data.get(f"{self.programme.main}_{name}") for name in ("LT", "LQ")]
        return run, {**machine.system, "LOG": None if log[0] is None else log}


def controller_from(file: str | Path, folder: str | Path | None = None) -> Controller:
    """Reads a programme and the plan that it belongs to.

    Args:
        file: the programme's main file.
        folder: of the plan; None is where the file lies.

    Raises:
        PlanFileError: a file cannot be read, or a line of the programme is not understood.
    """
    file = Path(file)
    if file.suffix.lower() not in READERS:
        raise PlanFileError(f"{file.name}: no reader for it; known are {', '.join(READERS)}")
    folder = file.parent if folder is None else Path(folder)
    record = read_plan(folder)
    data = read_json(folder, record.cell_file)
    settings: CellSettings = settings_from(data if isinstance(data, dict) else {}, folder=str(folder))
    arm = arm_from_urdf(
        read_text(folder, record.urdf_file, limit=8 << 20), record.robot_joints, record.flange_link
    )
    own = settings.programme.kuka_speed_deg_s
    speed = np.rad2deg(np.append(arm.velocity, record.limits.velocity_rad_s[6])) if own is None else own
    programme = READERS[file.suffix.lower()](file)
    start_out = _declared_output(programme, settings.programme.start_out)
    return Controller(
        folder=folder, programme=programme, record=record, trajectory=read_trajectory(folder, record),
        signals=settings.programme.model_copy(update={"start_out": start_out}), mass=settings.tool.mass_kg,
        drive=Drive(
            arm=arm, X_FS=np.array(record.X_FS), speed=np.asarray(speed, float),
            acceleration=np.rad2deg(record.limits.acceleration_rad_s2),
        ),
    )  # fmt: skip


def _declared_output(programme: Programme, default: int) -> int:
    """The output that is on while the scanner scans: the cell's, or what the head says (--signal)."""
    for remark in programme.remarks:
        words = remark.split()
        if words[:2] == ["The", "output"] and remark.endswith("is on then.") and words[2].isdigit():
            return int(words[2])
    return default


def with_clearance(record: PlanRecord, clearance: float) -> PlanRecord:
    """The record that asks for another clearance [m]."""
    process = record.process.model_copy(update={"clearance_m": clearance})
    return record.model_copy(update={"process": process})


def driven_trajectory(controller: Controller, run: Run) -> Trajectory | None:
    """What a run drove, as a trajectory with the plan's operations; None where a step is missing."""
    operations, keep = [], run.step > 0
    if not keep.any():
        return None
    t, q, step = run.t[keep], np.deg2rad(run.q[keep]), run.step[keep]
    t = t - t[0]
    for n, o in enumerate(controller.planned, 1):
        own = np.flatnonzero(step == n)
        if len(own) < 2:
            return None
        first = max(own[0] - 1, 0)
        operations.append(
            replace(
                o,
                index=n - 1,
                t_start=float(t[first]),
                t_end=float(t[own[-1]]),
                q_start=q[first],
                q_end=q[own[-1]],
            )
        )
    distinct = np.append(True, np.diff(t) > 1e-9)
    t, q, step = t[distinct], q[distinct], step[distinct]
    qd = np.gradient(q, t, axis=0)
    return Trajectory(
        t=t, q=q, qd=qd, qdd=np.gradient(qd, t, axis=0), operation=step - 1, operations=tuple(operations)
    )  # fmt: skip
