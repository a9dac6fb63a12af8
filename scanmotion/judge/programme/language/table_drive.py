"""Reads the programme of a table's drive: where it is when in each step, and one form of state machine.

The drive's programme is Structured Text. Its tables of times and places are read; the rest has to be, line by
line, the state machine that table.py of the judge runs, with its numbers.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PlanFileError

_NUMBER = r"(-?\d+(?:\.\d+)?)"
_BEFORE = """PROGRAM {name} / VAR_INPUT / Start : BOOL; / ArmRuns : BOOL; / Step : INT; / END_VAR / VAR_OUTPUT
/ Ready : BOOL; / Fault : BOOL; / END_VAR / VAR_IN_OUT / Table : AXIS_REF; / END_VAR / VAR / State : INT := 0;
/ Over : INT := 0; / There : BOOL; / First : LREAL; / Way : MC_TP_REF; / Late : TON;
/ Profile : MC_PositionProfile; / Stand : MC_Halt; / Back : MC_MoveAbsolute; / END_VAR / CASE Step OF"""
_AFTER = """END_CASE; / Late(IN := Start AND (State = 1), PT := T#<lag>ms);
/ Profile(Axis := Table, TimePosition := Way, Execute := Late.Q AND (State = 1));
/ Stand(Axis := Table, Execute := (State = 3) OR (State = 9), Deceleration := <stop>);
/ Back(Axis := Table, Position := First, Velocity := <back>, Execute := (State = 4));
/ There := ABS(Table.ActPos - First) <= <near>; / CASE State OF / 0: / IF Start AND There THEN State := 1;
/ ELSIF Start THEN State := 9; END_IF; / 1: / IF Profile.Error OR NOT ArmRuns THEN State := 9;
/ ELSIF Profile.Done THEN State := 2; Over := Step; / ELSIF NOT Start THEN State := 3; END_IF; / 2:
/ IF NOT Start THEN State := 5; END_IF; / 3: / IF Stand.Error OR NOT ArmRuns THEN State := 9;
/ ELSIF Stand.Done THEN State := 4; END_IF; / 4: / IF Back.Error OR NOT ArmRuns THEN State := 9;
/ ELSIF Back.Done THEN State := 0; END_IF; / 5: / IF Step <> Over THEN State := 0;
/ ELSIF Start THEN State := 9; END_IF; / 9: / IF NOT Start AND ArmRuns THEN State := 0; END_IF; / END_CASE;
/ Ready := ((State = 0) AND There) OR (State = 5); / Fault := (State = 9); / END_PROGRAM"""


@dataclass(frozen=True, eq=False, kw_only=True)
class TableStep:
    """What the table does in one step."""

    first: float
    """Where it begins [deg]."""
    seconds: np.ndarray
    """Of each piece, shape (k,); k is 0 where it stands."""
    places: np.ndarray
    """At the end of each piece, shape (k,) [deg]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TableProgramme:
    """The programme of a table's drive."""

    steps: dict[int, TableStep]
    lag_s: float
    """How long after the signal a step begins."""
    near_deg: float
    """How far from a step's first place the drive is still ready."""
    back_deg_s: float
    stop_deg_s2: float


def read_table_drive(path: Path, lines: list[str]) -> TableProgramme:
    """A drive's programme.

    Args:
        path: of the file, for messages and the programme's name.
        lines: of the file.

    Raises:
        PlanFileError: a line that is not of the form, with its number.
    """
    code = [(x.strip(), n) for n, x in enumerate(lines, 1)]
    code = [(x, n) for x, n in code if x and not (x.startswith("(*") and x.endswith("*)"))]
    before = [x.strip() for x in _BEFORE.format(name=path.stem).replace("\n", " ").split(" / ")]
    after = [x.strip() for x in _AFTER.replace("\n", " ").split(" / ")]
    if len(code) < len(before) + len(after):
        raise PlanFileError(f"{path.name}: is too short for a table's programme")
    _matched(path, code[: len(before)], before)
    numbers = _matched(path, code[-len(after) :], after)
    steps = _steps(path, code[len(before) : -len(after)])
    return TableProgramme(
        steps=steps, lag_s=numbers["lag"] / 1e3, near_deg=numbers["near"], back_deg_s=numbers["back"],
        stop_deg_s2=numbers["stop"],
    )  # fmt: skip


def _matched(path: Path, code: list[tuple[str, int]], wanted: list[str]) -> dict[str, float]:
    """The numbers where the lines are as they have to be."""
    found: dict[str, float] = {}
    for (line, n), form in zip(code, wanted, strict=True):
        name = re.search(r"<(\w+)>", form)
        pattern = re.escape(form)
        if name:
            pattern = pattern.replace(re.escape(name[0]), _NUMBER)
        m = re.fullmatch(pattern, line)
        if m is None:
            raise PlanFileError(f"{path.name}:{n}: {line[:60]!r} is not {form[:60]!r}")
        if name:
            found[name[1]] = float(m[1])
    return found


def _steps(path: Path, code: list[tuple[str, int]]) -> dict[int, TableStep]:
    found: dict[int, TableStep] = {}
    at = 0
    while at < len(code):
        line, n = code[at]
        number = re.fullmatch(r"(\d+):", line)
        first = re.fullmatch(rf"First := {_NUMBER};", code[at + 1][0]) if at + 1 < len(code) else None
        if number is None or first is None or int(number[1]) in found:
            raise PlanFileError(f"{path.name}:{n}: a step's number and first place are expected, once")
        at += 2
        seconds, places = [], []
        count = re.fullmatch(r"Way\.Number_of_pairs := (\d+);", code[at][0]) if at < len(code) else None
        if count:
            at += 1
            for k in range(1, int(count[1]) + 1):
                pair = [x for x, _ in code[at : at + 2]]
                a = re.fullmatch(
                    rf"Way\.MC_TP_Array\[{k}\]\.delta_time := T#(\d+)ms;", pair[0] if pair else ""
                )
                b = re.fullmatch(
                    rf"Way\.MC_TP_Array\[{k}\]\.position := {_NUMBER};", pair[-1] if pair else ""
                )
                if a is None or b is None or int(a[1]) <= 0:
                    raise PlanFileError(f"{path.name}:{n}: step {number[1]}: pair {k} is not time and place")
                seconds.append(int(a[1]) / 1e3)
                places.append(float(b[1]))
                at += 2
        found[int(number[1])] = TableStep(
            first=float(first[1]), seconds=np.array(seconds), places=np.array(places)
        )  # fmt: skip
    return found
