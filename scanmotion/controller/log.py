"""The log of a run and what a plan's folder knows of it: the same form for a real controller's log.

run.csv has a row each 10 ms: time, joints, the step's number, whether the scanner records, and the frame's
number where one is taken. executed.json says how far the last run came and where the robot stands.
"""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from scanmotion.core.errors import PlanFileError
from scanmotion.plan_io.read import read_json, read_text
from scanmotion.plan_io.write import json_text

LOG, EXECUTED = "run.csv", "executed.json"
AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
HEADER = ("t_s", *(f"{a}_deg" for a in AXES), "step", "recording", "frame")
Angle = Annotated[float, Field(ge=-1e6, le=1e6)]


@dataclass(frozen=True, eq=False, kw_only=True)
class RunLog:
    """What was driven."""

    t: np.ndarray
    """Shape (n,) [s]."""
    q: np.ndarray
    """Shape (n, 7) [deg]."""
    step: np.ndarray
    """Shape (n,); 0 outside of the steps."""
    recording: np.ndarray
    """Shape (n,) bool."""
    frame: np.ndarray
    """Number of the frame that is taken, from 1; 0 where none is, shape (n,)."""


class Executed(BaseModel):
    """executed.json."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    version: Literal[1] = 1
    programme: str = Field(max_length=100)
    completed: int = Field(ge=0)
    """Steps that are done, from the first on."""
    ended: bool
    """Whether the programme came to its end."""
    q_deg: tuple[Angle, ...] = Field(min_length=7, max_length=7)
    """Where the robot stands."""
    reason: str = Field("", max_length=300)
    """Why it was broken off."""


def log_text(log: RunLog) -> str:
    """run.csv."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEADER)
    for i in range(len(log.t)):
        frame = int(log.frame[i])
        rows.writerow(
            [f"{log.t[i]:.4f}", *(f"{v:.6f}" for v in log.q[i] + 0.0), int(log.step[i]),
             int(log.recording[i]), frame or ""]
        )  # fmt: skip
    return text.getvalue()


def read_log(folder: Path, name: str = LOG) -> RunLog:
    """A log of this form, simulated or a controller's.

    Raises:
        PlanFileError: it cannot be read, or is of another form.
    """
    rows = list(csv.reader(io.StringIO(read_text(folder, name))))
    if not rows or tuple(rows[0]) != HEADER or len(rows) < 2:
        raise PlanFileError(f"{name}: the first line is not {','.join(HEADER)}, or no row follows")
    try:
        table = np.array([[float(x or 0) for x in row] for row in rows[1:]])
        if table.shape[1] != len(HEADER) or not np.isfinite(table).all():
            raise ValueError
    except ValueError:
        raise PlanFileError(f"{name}: a row is not {len(HEADER)} numbers") from None
    return RunLog(
        t=table[:, 0], q=table[:, 1:8], step=table[:, 8].astype(int), recording=table[:, 9] > 0,
        frame=table[:, 10].astype(int),
    )  # fmt: skip


def executed_from(log: RunLog, programme: str, *, ended: bool, reason: str = "") -> Executed:
    """How far a run came: the steps before the one that was broken off are done."""
    last = int(log.step.max(initial=0)) if ended else max(int(log.step[-1]) - 1, 0)
    if not ended and log.step[-1] == 0:
        last = 0
    return Executed(
        programme=programme, completed=last, ended=ended, q_deg=tuple(log.q[-1].tolist()), reason=reason[:300]
    )  # fmt: skip


def executed_text(executed: Executed) -> str:
    """executed.json."""
    return json_text(executed)


def read_executed(folder: str | Path) -> Executed:
    """What the folder knows of the last run.

    Raises:
        PlanFileError: nothing was run, or the file is not what belongs there.
    """
    folder = Path(folder)
    if not (folder / EXECUTED).exists():
        raise PlanFileError(f"{folder}: no run is known; say where to go on (--step N)")
    data: Any = read_json(folder, EXECUTED)
    try:
        return Executed.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"])
        raise PlanFileError(f"{EXECUTED}: {where}: {' '.join(first['msg'].split())[:120]}") from None
