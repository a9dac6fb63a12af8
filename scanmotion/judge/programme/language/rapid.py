"""Reads RAPID, the subset that scanmotion writes: a line that it does not know is an error.

It shares nothing with the writer. Names and words are taken without regard to case, as RAPID does.
"""

import re
from pathlib import Path
from typing import Any

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.language import statements as st
from scanmotion.judge.programme.language.expressions import Name, Parser, value_of
from scanmotion.judge.programme.language.krl import krl_lines

_NAME = r"[A-Za-z]\w*"
_FIXED: dict[str, type[st.Statement]] = {
    "RETURN": st.Return, "STOP": st.Halt,
    "PROCERRRECOVERY\\SYNCLASTMOVEINST": st.Raise,
}  # fmt: skip


def read_rapid(path: Path) -> st.Programme:
    """A module NAME.mod whose procedure NAME is the programme.

    Raises:
        PlanFileError: a line that is not of the subset, with its number.
    """
    return _Module(path).programme()


class _Module:
    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        self.lines: list[tuple[str, str]] = []
        self.remarks: list[str] = []
        self.traps: dict[str, str] = {}
        for n, raw in enumerate(krl_lines(path), 1):
            line, where = raw.strip(), f"{path.name}:{n}"
            if line.startswith("!"):
                self.remarks.append(line[1:].strip())
            elif line:
                self.lines.append((line, where))

    def next(self) -> tuple[str, str]:
        if self.at >= len(self.lines):
            raise PlanFileError(f"{self.path.name}: ends too early")
        self.at += 1
        return self.lines[self.at - 1]

    def programme(self) -> st.Programme:
        main = self.path.stem.upper()
        line, where = self.next()
        if line.upper() != f"MODULE M_{main}":
            raise PlanFileError(f"{where}: is not the module of {self.path.stem}")
        data: dict[str, Any] = {}
        routines: dict[str, st.Routine] = {}
        while True:
            line, where = self.next()
            if line == "ENDMODULE":
                break
            if m := re.fullmatch(rf"(?:LOCAL )?(?:PERS|VAR|CONST) (\w+) ({_NAME}):=(.+);", line):
                self._fresh(m[2], data, where)
                data[m[2].upper()] = self._constant(m[3], where)
            elif m := re.fullmatch(rf"(?:LOCAL )?(PROC|TRAP) ({_NAME})(?:\((?:num ({_NAME}))?\))?", line):
                self._fresh(m[2], routines, where)
                routines[m[2].upper()] = self._routine(m[2].upper(), m[3], f"END{m[1]}")
            else:
                raise PlanFileError(f"{where}: {line[:60]!r} is not understood")
        if self.at < len(self.lines) or main not in routines:
            raise PlanFileError(f"{self.path.name}: lines after ENDMODULE, or no PROC {self.path.stem}")
        return st.Programme(
            language="rapid", main=main, routines=routines, data=data, step=f"{main}_STEP",
            remarks=tuple(self.remarks),
        )  # fmt: skip

    def _fresh(self, name: str, known: dict[str, Any], where: str) -> None:
        if name.upper() in known:
            raise PlanFileError(f"{where}: {name} is there twice")

    def _constant(self, text: str, where: str) -> Any:
        def none(*_: Any) -> Any:
            raise PlanFileError(f"{where}: {text[:60]!r} is no constant")

        return value_of(self._parsed(text, where), none, none)

    def _parsed(self, text: str, where: str) -> Any:
        try:
            return Parser(text).whole()
        except PlanFileError as error:
            raise PlanFileError(f"{where}: {error}") from None

    def _routine(self, name: str, parameter: str | None, end: str) -> st.Routine:
        names = (parameter.upper(),) if parameter else ()
        body, closed = self._body("ERROR", end)
        handler: tuple[st.Statement, ...] = ()
        if closed == "ERROR":
            for wanted in ("ClearPath;", "StartMove;"):
                line, where = self.next()
                if line != wanted:
                    raise PlanFileError(f"{where}: an error handler begins with {wanted}, not {line[:60]!r}")
            handler, _ = self._body(end)
        return st.Routine(
            name=name, parameters=names, local=frozenset(names), body=body, handler=handler
        )  # fmt: skip

    def _body(self, *ends: str) -> tuple[tuple[st.Statement, ...], str]:
        found: list[st.Statement] = []
        while True:
            line, where = self.next()
            if line in ends:
                return tuple(found), line
            if line.startswith(("END", "PROC ", "LOCAL ", "ERROR")):
                raise PlanFileError(f"{where}: {ends[-1]} is missing before it")
            if m := re.fullmatch(r"IF (.+) THEN", line):
                inner, _ = self._body("ENDIF")
                found.append(st.If(line=where, cases=((self._parsed(m[1], where), inner),)))
            elif m := re.fullmatch(r"WHILE (.+) DO", line):
                inner, _ = self._body("ENDWHILE")
                found.append(st.Loop(line=where, body=inner, condition=self._parsed(m[1], where)))
            else:
                simple = self._simple(line, where)
                counts = line.startswith("nAt:=") and found and isinstance(found[-1], st.Move)
                if counts and isinstance(simple[0], st.Assign):
                    # The pointer goes on when the robot begins to round the point, not when it is read.
                    found.insert(len(found) - 1, st.Trigger(line=where, mark=simple[0]))
                else:
                    found += simple

    def _simple(self, line: str, where: str) -> list[st.Statement]:
        if not line.endswith(";"):
            raise PlanFileError(f"{where}: {line[:60]!r} has no semicolon")
        line = line[:-1]
        if line.upper() in _FIXED:
            return [_FIXED[line.upper()](line=where)]
        if m := re.fullmatch(
            rf"MoveAbsJ (.+?)(?:\\T:=([\d.]+))?,(v\w+),(fine|zScan),({_NAME})_tool\\WObj:=({_NAME})_base",
            line,
        ):
            if {m[5].upper(), m[6].upper()} != {self.path.stem.upper()}:
                raise PlanFileError(f"{where}: another tool or work object")
            if (m[2] is None) != (m[3] == "vSlow") or m[3] not in ("vSlow", "v100"):
                raise PlanFileError(f"{where}: a move has its time or the slow speed")
            seconds = None if m[2] is None else self._parsed(m[2], where)
            return [
                st.Move(
                    line=where,
                    kind="abs",
                    target=self._parsed(m[1], where),
                    rounded=m[4] != "fine",
                    seconds=seconds,
                )
            ]
        if m := re.fullmatch(r"WaitTime (.+)", line):
            return [st.WaitSeconds(line=where, seconds=self._parsed(m[1], where))]
        if m := re.fullmatch(rf"WaitDI di(\d+),1\\MaxTime:=(.+)\\TimeFlag:=({_NAME})", line):
            signal = Name(word="$IN", index=("num", float(m[1])))
            return [
                st.WaitUntil(
                    line=where,
                    condition=signal,
                    timeout=self._parsed(m[2], where),
                    flag=Name(word=m[3].upper()),
                )
            ]
        return self._signal(line, where)

    def _signal(self, line: str, where: str) -> list[st.Statement]:
        if m := re.fullmatch(r"SetDO do(\d+),([01])", line):
            target = Name(word="$OUT", index=("num", float(m[1])))
            return [st.Assign(line=where, target=target, value=("bool", m[2] == "1"))]
        if m := re.fullmatch(r"SetGO go(\d+),(.+)", line):
            return [
                st.Invoke(
                    line=where, name="SETGO", arguments=(("num", float(m[1])), self._parsed(m[2], where))
                )
            ]
        if m := re.fullmatch(r"PulseDO\\PLength:=(.+),do(\d+)", line):
            output = Name(word="$OUT", index=("num", float(m[2])))
            return [st.Pulse(line=where, output=output, seconds=self._parsed(m[1], where))]
        if m := re.fullmatch(r'TPWrite (".*")', line):
            return [st.Say(line=where, text=self._parsed(m[1], where))]
        if m := re.fullmatch(rf"CONNECT ({_NAME}) WITH ({_NAME})", line):
            self.traps[m[1].upper()] = m[2].upper()
            return [st.Nothing(line=where)]
        if m := re.fullmatch(rf"ISignalDI di(\d+),1,({_NAME})", line):
            signal = Name(word="$IN", index=("num", float(m[1])))
            return self._declared(m[2].upper(), where, condition=signal)
        if m := re.fullmatch(rf"ITimer (.+),({_NAME})", line):
            return self._declared(m[2].upper(), where, period=self._parsed(m[1], where))
        if m := re.fullmatch(rf"(ISleep|IWatch|IDelete) ({_NAME})", line):
            what = "on" if m[1] == "IWatch" else "off"
            return [st.Interrupt(line=where, what=what, number=self._number(m[2].upper(), where))]
        if m := re.fullmatch(rf"({_NAME}):=(.+)", line):
            return [st.Assign(line=where, target=Name(word=m[1].upper()), value=self._parsed(m[2], where))]
        if m := re.fullmatch(rf"({_NAME})(?: (\w+))?", line):
            arguments = () if m[2] is None else (self._parsed(m[2], where),)
            return [st.Invoke(line=where, name=m[1].upper(), arguments=arguments)]
        raise PlanFileError(f"{where}: {line[:60]!r} is not understood")

    def _number(self, name: str, where: str) -> int:
        if name not in ("IFAULT", "IFRAME"):
            raise PlanFileError(f"{where}: {name} is no interrupt")
        return {"IFAULT": 4, "IFRAME": 5}[name]

    def _declared(self, name: str, where: str, **how: Any) -> list[st.Statement]:
        if name not in self.traps:
            raise PlanFileError(f"{where}: {name} is connected with no trap")
        n = self._number(name, where)
        decl = st.Interrupt(line=where, what="decl", number=n, routine=self.traps[name], **how)
        return [decl, st.Interrupt(line=where, what="on", number=n)]
