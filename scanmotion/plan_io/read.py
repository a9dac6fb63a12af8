"""A plan's files read without trust: sizes, names, numbers and their order are checked.

Guarantees: what is returned is finite, in order, and of the schema; anything else is a PlanFileError that
names the file and the place.
"""

import json
import re
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import BaseModel, JsonValue, ValidationError

from scanmotion.core.errors import PlanFileError
from scanmotion.core.summary import Summary
from scanmotion.core.trajectory import Operation, Trajectory
from scanmotion.plan_io.schema import CSV_HEADER, MAX_SAMPLES, VERSION, PlanRecord

_MAX_JSON = 256 << 20
_MOST = 1e6
"""No time [s] and no angle [deg] of a robot is beyond; what is would overflow in differences."""
_ROW = re.compile(r"[-+.,0-9eE]*,[a-z]+")


def inside(folder: Path, name: str) -> Path:
    """The path of a plain file of the folder; links that lead elsewhere are refused.

    Raises:
        PlanFileError: missing, not a plain file, or outside.
    """
    path = folder / name
    try:
        if path.resolve().parent != folder.resolve():
            raise PlanFileError(f"{name}: leads out of the plan's folder")
        if not path.exists():
            raise PlanFileError(f"{folder}: {name} is missing; is this a plan's folder?")
        if not path.is_file():
            raise PlanFileError(f"{name}: is not a file")
    except (OSError, RuntimeError, ValueError) as error:
        # Links in a circle are a RuntimeError before Python 3.13.
        raise PlanFileError(f"{name}: cannot be read ({str(error)[:80]})") from None
    return path


def read_text(folder: Path, name: str, *, limit: int = _MAX_JSON) -> str:
    """A file of the folder as text.

    Raises:
        PlanFileError: missing, outside, too large, not text.
    """
    path = inside(folder, name)
    try:
        if path.stat().st_size > limit:
            raise PlanFileError(f"{name}: more than {limit >> 20} MiB is not a plan's file")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise PlanFileError(f"{name}: is not text") from None
    except OSError as error:
        raise PlanFileError(f"{name}: cannot be read ({error.strerror})") from None


def read_json(folder: Path, name: str) -> JsonValue:
    """A JSON file of the folder.

    Raises:
        PlanFileError: not JSON, or with NaN.
    """
    text = read_text(folder, name)

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not a number of JSON")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"{name}: is not JSON ({str(error)[:120]})") from None


def read_plan(folder: str | Path) -> PlanRecord:
    """plan.json of a plan folder.

    Raises:
        PlanFileError: with the key that is wrong.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise PlanFileError(f"{folder}: no such plan folder")
    data = read_json(folder, "plan.json")
    if not isinstance(data, dict):
        raise PlanFileError("plan.json: an object is expected")
    version = data.get("version")
    if version != VERSION or not isinstance(version, int) or isinstance(version, bool):
        raise PlanFileError(f"plan.json: version {str(version)[:40]!r}; this software reads {VERSION}")
    try:
        # As JSON and strictly, so that neither "1.5" nor true is a number.
        return PlanRecord.model_validate_json(json.dumps(data), strict=True)
    except (ValidationError, RecursionError) as error:
        raise _wrong("plan.json", error) from None


def read_trajectory(folder: str | Path, record: PlanRecord) -> Trajectory:
    """trajectory.csv of a plan folder; velocities and accelerations by finite differences.

    Raises:
        PlanFileError: another header, cut short, not finite, out of order.
    """
    lines = read_text(Path(folder), "trajectory.csv").splitlines()
    if not lines or lines[0] != CSV_HEADER:
        raise PlanFileError(f"trajectory.csv: the header is not {CSV_HEADER}")
    if len(lines) > MAX_SAMPLES:
        raise PlanFileError(f"trajectory.csv: more than {MAX_SAMPLES} samples")
    kinds = [o.kind for o in record.operations]
    table: list[list[float]] = []
    operation: list[int] = []
    for n, line in enumerate(lines[1:], 2):
        numbers, index = _row(line, n, kinds)
        table.append(numbers)
        operation.append(index)
    if len(table) < 2:
        raise PlanFileError("trajectory.csv: fewer than two samples")
    values = np.array(table)
    # Written so that NaN, too, is refused.
    wrong = np.flatnonzero(~(np.abs(values) <= _MOST).all(axis=1))
    if len(wrong):
        raise PlanFileError(f"trajectory.csv: line {wrong[0] + 2} is beyond what a robot does")
    t, q = values[:, 0], np.deg2rad(values[:, 1:])
    if t[0] != 0 or (np.diff(t) <= 0).any():
        raise PlanFileError("trajectory.csv: times do not increase from 0")
    qd = np.gradient(q, t, axis=0)
    operations = tuple(
        Operation(
            index=o.index, kind=o.kind, viewpoints=o.viewpoints, t_start=o.t_start, t_end=o.t_end,
            q_start=np.array(o.q_start), q_end=np.array(o.q_end),
        )
        for o in record.operations
    )  # fmt: skip
    return Trajectory(
        t=t, q=q, qd=qd, qdd=np.gradient(qd, t, axis=0), operation=np.array(operation), operations=operations
    )


def _row(line: str, n: int, kinds: list[str]) -> tuple[list[float], int]:
    """The eight numbers and the operation of line n."""
    fields = line.split(",")
    if len(fields) != 10:
        raise PlanFileError(f"trajectory.csv: line {n} has {len(fields)} fields instead of 10")
    try:
        if not _ROW.fullmatch(line):
            # Python would read 1_0, other scripts' digits, nan and blanks too; other readers would not.
            raise ValueError
        numbers, index = [float(x) for x in fields[:8]], int(fields[8])
    except ValueError:
        raise PlanFileError(f"trajectory.csv: line {n} is not numbers and a kind") from None
    if not 0 <= index < len(kinds) or kinds[index] != fields[9]:
        text = f"operation {fields[8][:20]} {fields[9][:20]!r} is not in plan.json"
        raise PlanFileError(f"trajectory.csv: line {n}: {text}")
    return numbers, index


def read_summary(folder: Path) -> Summary:
    """summary.json.

    Raises:
        PlanFileError: it cannot be read, or a key that pages show is missing or of another type.
    """
    return checked("summary.json", Summary, read_json(folder, "summary.json"))


_Model = TypeVar("_Model", bound=BaseModel)


def checked(name: str, model: type[_Model], data: JsonValue) -> _Model:
    """The data of a file as its model has it.

    Args:
        name: of the file, for messages.
        model: what it must hold.
        data: as it was read.

    Raises:
        PlanFileError: with the key that is wrong.
    """
    try:
        return model.model_validate(data)
    except (ValidationError, RecursionError) as error:
        raise _wrong(name, error) from None


def _wrong(name: str, error: ValidationError | RecursionError) -> PlanFileError:
    text = "is nested too deeply"
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        text = f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
    return PlanFileError(f"{name}: {' '.join(text.split())[:200]}")
