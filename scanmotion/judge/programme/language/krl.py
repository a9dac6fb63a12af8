"""Reads KRL, the subset that scanmotion writes: a line that it does not know is an error.

It shares nothing with the writer: its grammar is that of the language, and what a programme does is found by
running it (machine.py).
"""

import re
from pathlib import Path
from typing import Any

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.language.expressions import Name, Parser
from scanmotion.judge.programme.language.statements import (
    Assign,
    Brake,
    Exit,
    For,
    Halt,
    If,
    Interrupt,
    Invoke,
    Loop,
    Move,
    Nothing,
    Programme,
    Pulse,
    Resume,
    Routine,
    Spline,
    Statement,
    Trigger,
    WaitSeconds,
    WaitUntil,
)

MOST_BYTES = 16 << 20
_NAME = r"[A-Za-z_]\w*"
_HEADERS = ("&ACCESS ", "&REL ", "&PARAM ", "&COMMENT ")
_TYPES = "INT|REAL|BOOL|CHAR|E6AXIS|FRAME|LOAD|KRLMSG_T|KRLMSGPAR_T|KRLMSGOPT_T"


def read_krl(path: Path) -> Programme:
    """A programme: NAME.src, NAME.dat, and the pages that the first calls.

    Args:
        path: of NAME.src.

    Raises:
        PlanFileError: a line that is not of the subset, with the file and the line's number.
    """
    main = path.stem.upper()
    routines: dict[str, Routine] = {}
    remarks: list[str] = []
    todo, seen = [path], set()
    while todo:
        file = todo.pop()
        seen.add(file.stem.upper())
        found = _Source(file)
        remarks += found.remarks if file == path else []
        for routine, shared in found.routines():
            key = routine.name if shared else f"{file.stem.upper()}.{routine.name}"
            if key in routines:
                raise PlanFileError(f"{file.name}: {routine.name} is there twice")
            routines[key] = routine
        called = {c for r in routines.values() for c in _calls(r.body)}
        for other in sorted(path.parent.glob(f"{path.stem}_*.src")):
            if other.stem.upper() in called - seen and other not in todo:
                todo.append(other)
    if main not in routines:
        raise PlanFileError(f"{path.name}: has no DEF {path.stem} ( )")
    data, sizes = _data(path.with_suffix(".dat"), main)
    return Programme(
        language="krl", main=main, routines=routines, data=data, sizes=sizes,
        remarks=tuple(remarks), step=f"{main}_STEP",
    )  # fmt: skip


def _calls(body: tuple[Statement, ...]) -> set[str]:
    found: set[str] = set()
    for s in body:
        if isinstance(s, Invoke):
            found.add(s.name)
        for inner in _bodies(s):
            found |= _calls(inner)
    return found


def _bodies(s: Statement) -> list[tuple[Statement, ...]]:
    if isinstance(s, If):
        return [body for _, body in s.cases]
    return [s.body] if isinstance(s, Loop | For) else []


def krl_lines(path: Path) -> list[str]:
    """The lines of a programme's file.

    Raises:
        PlanFileError: missing, too large, not ASCII.
    """
    try:
        if not path.is_file():
            raise PlanFileError(f"{path}: no such file")
        if path.stat().st_size > MOST_BYTES:
            raise PlanFileError(f"{path.name}: more than {MOST_BYTES >> 20} MiB is no programme")
        return path.read_bytes().decode("ascii").replace("\r\n", "\n").split("\n")
    except UnicodeDecodeError:
        raise PlanFileError(f"{path.name}: is not plain text") from None
    except OSError as error:
        raise PlanFileError(f"{path.name}: cannot be read ({error.strerror})") from None


def _data(path: Path, main: str) -> tuple[dict[str, Any], dict[str, int]]:
    """Variables of NAME.dat with their first values, arrays empty; and the sizes of arrays."""
    found: dict[str, Any] = {}
    sizes: dict[str, int] = {}
    begun, ended = False, False
    for n, raw in enumerate(krl_lines(path), 1):
        line, where = raw.strip(), f"{path.name}:{n}"
        if not line or line.startswith((";", "&")) or line.startswith("EXT BAS"):
            continue
        if line.upper() == "ENDDAT":
            ended = True
        elif m := re.fullmatch(rf"DEFDAT ({_NAME}) PUBLIC", line, re.IGNORECASE):
            if m[1].upper() != main:
                raise PlanFileError(f"{where}: is the data of {m[1]}")
            begun = True
        elif m := re.fullmatch(rf"DECL (?:GLOBAL )?(?:{_TYPES}) ({_NAME})(?:\[(\d+)\])?(?:=(.*))?", line):
            if m[1].upper() in found:
                raise PlanFileError(f"{where}: {m[1]} is there twice")
            found[m[1].upper()] = {} if m[2] else _constant(m[3], where)
            sizes |= {m[1].upper(): int(m[2])} if m[2] else {}
        else:
            raise PlanFileError(f"{where}: {line[:60]!r} is not understood")
    if not (begun and ended):
        raise PlanFileError(f"{path.name}: {'ENDDAT' if begun else 'DEFDAT'} is missing")
    return found, sizes


def _constant(text: str | None, where: str) -> Any:
    from scanmotion.judge.programme.language.expressions import value_of

    if text is None:
        return None

    def none(*_: Any) -> Any:
        raise PlanFileError(f"{where}: {text[:60]!r} is no constant")

    return value_of(_parsed(text, where), none, none)


def _parsed(text: str, where: str) -> Any:
    try:
        return Parser(text).whole()
    except PlanFileError as error:
        raise PlanFileError(f"{where}: {error}") from None


def _target(text: str, where: str) -> Name:
    found = _parsed(text, where)
    if not isinstance(found, Name):
        raise PlanFileError(f"{where}: {text[:60]!r} is no variable")
    return found


class _Source:
    """The lines of one .src and how far they have been read."""

    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        self.lines: list[tuple[str, str]] = []
        self.remarks: list[str] = []
        fold: list[str] = []
        for n, raw in enumerate(krl_lines(path), 1):
            line, where = raw.strip(), f"{path.name}:{n}"
            if line.startswith(";FOLD "):
                fold.append(where)
            elif line.startswith(";ENDFOLD"):
                if not fold:
                    raise PlanFileError(f"{where}: closes no fold")
                fold.pop()
            if line.startswith(";"):
                self.remarks.append(line[1:].strip())
            elif line and not line.startswith(_HEADERS):
                self.lines.append((line, where))
        if fold:
            raise PlanFileError(f"{fold[0]}: the fold is not closed")

    def next(self) -> tuple[str, str]:
        """The next line of code.

        Raises:
            PlanFileError: the file ends.
        """
        if self.at >= len(self.lines):
            raise PlanFileError(f"{self.path.name}: ends within a routine")
        self.at += 1
        return self.lines[self.at - 1]

    def routines(self) -> list[tuple[Routine, bool]]:
        """Routines, each with whether other files see it."""
        found = []
        while self.at < len(self.lines):
            line, where = self.next()
            m = re.fullmatch(rf"(GLOBAL )?DEF ({_NAME}) \(((?: *{_NAME}:IN,?)*) ?\)", line)
            if m is None:
                raise PlanFileError(f"{where}: {line[:60]!r} stands outside of a routine")
            if not found and m[2].upper() != self.path.stem.upper():
                raise PlanFileError(f"{where}: the first routine is not {self.path.stem}")
            names = tuple(p.split(":")[0].strip().upper() for p in m[3].split(",") if p.strip())
            found.append((self._routine(m[2].upper(), names), bool(m[1]) or not found))
        return found

    def _routine(self, name: str, names: tuple[str, ...]) -> Routine:
        local, signals, body = set(names), {}, []
        while True:
            line, where = self.next()
            if line == "END":
                break
            if m := re.fullmatch(rf"(?:DECL )?(?:{_TYPES}) ({_NAME})(?:\[\d+\])?", line):
                local.add(m[1].upper())
            elif m := re.fullmatch(rf"SIGNAL ({_NAME}) \$OUT\[(\d+)\] TO \$OUT\[(\d+)\]", line):
                signals[m[1].upper()] = (int(m[2]), int(m[3]))
            else:
                body.append(self._statement(line, where))
        return Routine(
            name=name, parameters=names, local=frozenset(local), body=tuple(body), signals=signals
        )  # fmt: skip

    def _body(self, *ends: str) -> tuple[tuple[Statement, ...], str]:
        """Statements up to a line that begins with one of the words, and that line."""
        found = []
        while True:
            line, where = self.next()
            if line.split(" ")[0] in ends:
                return tuple(found), line
            if line == "END" or line.startswith(("DEF ", "GLOBAL DEF ")):
                raise PlanFileError(f"{where}: {ends[-1]} is missing before it")
            found.append(self._statement(line, where))

    def _statement(self, line: str, where: str) -> Statement:
        word = line.split(" ")[0]
        if word in ("IF", "LOOP", "SWITCH", "FOR", "PTP_SPLINE"):
            return getattr(self, f"_{word.lower()}")(line, where)
        return _simple(line, where)

    def _if(self, line: str, where: str) -> Statement:
        m = re.fullmatch(r"IF (.*) THEN", line)
        if m is None:
            raise PlanFileError(f"{where}: {line[:60]!r} is not understood")
        body, end = self._body("ELSE", "ENDIF")
        cases: list[tuple[Any, tuple[Statement, ...]]] = [(_parsed(m[1], where), body)]
        if end == "ELSE":
            cases.append((None, self._body("ENDIF")[0]))
        return If(line=where, cases=tuple(cases))

    def _loop(self, line: str, where: str) -> Statement:
        return Loop(line=where, body=self._body("ENDLOOP")[0])

    def _for(self, line: str, where: str) -> Statement:
        m = re.fullmatch(rf"FOR ({_NAME})=(.+) TO (.+)", line)
        if m is None:
            raise PlanFileError(f"{where}: {line[:60]!r} is not understood")
        return For(
            line=where, variable=m[1].upper(), first=_parsed(m[2], where), last=_parsed(m[3], where),
            body=self._body("ENDFOR")[0],
        )  # fmt: skip

    def _switch(self, line: str, where: str) -> Statement:
        what = _parsed(line[len("SWITCH ") :], where)
        empty, end = self._body("CASE", "ENDSWITCH")
        if empty:
            raise PlanFileError(f"{where}: CASE is missing")
        cases, seen = [], set()
        while end != "ENDSWITCH":
            m = re.fullmatch(r"CASE (\d+)", end)
            if m is None or m[1] in seen:
                raise PlanFileError(f"{where}: {end[:60]!r} is not understood, or there twice")
            seen.add(m[1])
            body, end = self._body("CASE", "ENDSWITCH")
            cases.append((("op", "==", what, ("num", float(m[1]))), body))
        return If(line=where, cases=tuple(cases))

    def _ptp_spline(self, line: str, where: str) -> Statement:
        points, parts, marks, seconds, started = [], [], [], None, False
        while True:
            line, here = self.next()
            if line == "ENDSPLINE":
                break
            if m := re.fullmatch(r"SPTP (.+)", line):
                points.append(_parsed(m[1], here))
            elif line == "TIME_BLOCK START" and len(points) == 1 and not started:
                started = True
            elif (m := re.fullmatch(r"TIME_BLOCK PART = (.+)", line)) and len(parts) == len(points) - 2:
                parts.append(_parsed(m[1], here))
            elif (m := re.fullmatch(r"TIME_BLOCK END = (.+)", line)) and seconds is None:
                seconds = _parsed(m[1], here)
            elif m := re.fullmatch(r"TRIGGER WHEN PATH=0 DELAY=0 DO ([^=]+)=(.+)", line):
                mark = Assign(line=here, target=_target(m[1], here), value=_parsed(m[2], here))
                marks.append((len(points), mark))
            else:
                raise PlanFileError(f"{here}: {line[:60]!r} is not understood here")
        if not started or seconds is None or len(parts) != len(points) - 1 or not parts:
            raise PlanFileError(f"{where}: the block's points and times do not fit one another")
        return Spline(
            line=where, points=tuple(points), parts=tuple(parts), seconds=seconds, marks=tuple(marks)
        )  # fmt: skip


_FIXED: dict[str, type[Statement]] = {
    "EXIT": Exit, "HALT": Halt, "BRAKE": Brake, "RESUME": Resume, "CONTINUE": Nothing,
}  # fmt: skip


def _simple(line: str, where: str) -> Statement:
    """A statement of one line."""
    if line in _FIXED:
        return _FIXED[line](line=where)
    if m := re.fullmatch(r"PTP (.+?)( C_PTP)?", line):
        return Move(line=where, kind="ptp", target=_parsed(m[1], where), rounded=bool(m[2]))
    if m := re.fullmatch(r"LIN (.+?)( C_DIS)?", line):
        return Move(line=where, kind="lin", target=_parsed(m[1], where), rounded=bool(m[2]))
    if m := re.fullmatch(r"WAIT SEC (.+)", line):
        return WaitSeconds(line=where, seconds=_parsed(m[1], where))
    if m := re.fullmatch(r"WAIT FOR (.+)", line):
        return WaitUntil(line=where, condition=_parsed(m[1], where))
    if m := re.fullmatch(r"(?:GLOBAL )?INTERRUPT DECL (\d+) WHEN (.+) DO (\w+) \( \)", line):
        return Interrupt(
            line=where, what="decl", number=int(m[1]), condition=_parsed(m[2], where), routine=m[3].upper()
        )  # fmt: skip
    if m := re.fullmatch(r"INTERRUPT (ON|OFF) (\d+)", line):
        return Interrupt(line=where, what=m[1].lower(), number=int(m[2]))
    if m := re.fullmatch(r"TRIGGER WHEN DISTANCE=1 DELAY=0 DO ([^=]+)=(.+)", line):
        mark = Assign(line=where, target=_target(m[1], where), value=_parsed(m[2], where))
        return Trigger(line=where, mark=mark)
    if m := re.fullmatch(r"PULSE \((\$OUT\[\d+\]),TRUE,(.+)\)", line):
        return Pulse(line=where, output=_target(m[1], where), seconds=_parsed(m[2], where))
    if m := re.fullmatch(rf"({_NAME}) \((.*)\)", line):
        inside = _parsed(f"F({m[2].strip()})", where)
        return Invoke(line=where, name=m[1].upper(), arguments=tuple(inside[2]))
    if m := re.fullmatch(r"([$A-Za-z_][^=<>]*)=(.+)", line):
        return Assign(line=where, target=_target(m[1], where), value=_parsed(m[2], where))
    raise PlanFileError(f"{where}: {line[:60]!r} is not understood")
