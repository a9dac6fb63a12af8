"""Reads URScript, the subset that scanmotion writes: a line that it does not know is an error.

It shares nothing with the writer. Beside NAME.script the programme of the table's drive is read.
"""

import re
from pathlib import Path
from typing import Any

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.language import statements as st
from scanmotion.judge.programme.language.expressions import Name, Parser
from scanmotion.judge.programme.language.krl import krl_lines
from scanmotion.judge.programme.language.table_drive import read_table_drive

_NAME = r"[A-Za-z_]\w*"
_ENDS = re.compile(r"(?:end|else:|elif .+:)$")
_KEYWORDS = {"movej": ["a", "v"], "popup": ["title", "error", "blocking"]}
"""Arguments that are given by name, in this order; all others have no names."""


def read_urscript(path: Path) -> st.Programme:
    """A programme NAME.script whose function NAME runs the scan, and NAME_table.st.

    Raises:
        PlanFileError: a line that is not of the subset, with its number.
    """
    table = path.with_name(f"{path.stem}_table.st")
    return _Script(path).programme(read_table_drive(table, krl_lines(table)))


class _Script:
    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        self.lines: list[tuple[str, str]] = []
        self.remarks: list[str] = []
        self.routines: dict[str, st.Routine] = {}
        self.shared: set[str] = set()
        for n, raw in enumerate(krl_lines(path), 1):
            line, where = raw.strip(), f"{path.name}:{n}"
            if line.startswith("#"):
                self.remarks.append(line[1:].strip())
            elif line:
                self.lines.append((line, where))

    def next(self) -> tuple[str, str]:
        if self.at >= len(self.lines):
            raise PlanFileError(f"{self.path.name}: ends too early")
        self.at += 1
        return self.lines[self.at - 1]

    def programme(self, table: Any) -> st.Programme:
        main = self.path.stem.upper()
        line, where = self.next()
        if line != f"def {self.path.stem}():":
            raise PlanFileError(f"{where}: is not the function {self.path.stem}")
        for name in re.findall(rf"^\s*global ({_NAME}) =", "\n".join(x for x, _ in self.lines), re.MULTILINE):
            self.shared.add(name.upper())
        local: set[str] = set()
        body, _ = self._body(local, "end")
        if self.at < len(self.lines):
            raise PlanFileError(f"{self.lines[self.at][1]}: stands behind the end of {self.path.stem}")
        self.routines[main] = st.Routine(name=main, parameters=(), local=frozenset(local), body=body)
        return st.Programme(
            language="urscript", main=main, routines=self.routines, data=dict.fromkeys(self.shared),
            step=f"{main}_STEP", remarks=tuple(self.remarks), table=table,
        )  # fmt: skip

    def _function(self, line: str, where: str) -> None:
        m = re.fullmatch(rf"def ({_NAME})\(((?:{_NAME}(?:, )?)*)\):", line)
        if m is None:
            raise PlanFileError(f"{where}: {line[:60]!r} is not understood")
        name = m[1].upper()
        if name in self.routines or name == self.path.stem.upper():
            raise PlanFileError(f"{where}: {m[1]} is there twice")
        parameters = tuple(x.strip().upper() for x in m[2].split(",") if x.strip())
        local = set(parameters)
        body, _ = self._body(local, "end")
        self.routines[name] = st.Routine(
            name=name, parameters=parameters, local=frozenset(local), body=body
        )  # fmt: skip

    def _body(self, local: set[str], *ends: str) -> tuple[tuple[st.Statement, ...], str]:
        found: list[st.Statement] = []
        while True:
            line, where = self.next()
            if line in ends:
                return tuple(found), line
            if _ENDS.match(line):
                raise PlanFileError(f"{where}: {line!r} closes nothing")
            if line.startswith("def "):
                self._function(line, where)
            elif m := re.fullmatch(r"if (.+):", line):
                inner, end = self._body(local, "end", "else:")
                cases: list[tuple[Any, tuple[st.Statement, ...]]] = [(self._parsed(m[1], where), inner)]
                if end == "else:":
                    cases.append((None, self._body(local, "end")[0]))
                found.append(st.If(line=where, cases=tuple(cases)))
            elif m := re.fullmatch(r"while (.+):", line):
                inner, _ = self._body(local, "end")
                found.append(st.Loop(line=where, body=inner, condition=self._parsed(m[1], where)))
            else:
                found.append(self._simple(line, where, local))

    def _simple(self, line: str, where: str, local: set[str]) -> st.Statement:
        if line == "halt":
            return st.Invoke(line=where, name="HALT")
        if m := re.fullmatch(rf"(global |local |)({_NAME}) = (.+)", line):
            name = m[2].upper()
            if m[1] == "local ":
                local.add(name)
            elif m[1] == "" and name not in local:
                raise PlanFileError(f"{where}: {m[2]} is neither declared here nor global")
            return st.Assign(line=where, target=Name(word=name), value=self._parsed(m[3], where))
        if m := re.fullmatch(rf"({_NAME})\((.*)\)", line):
            return self._call(m[1], m[2], where)
        raise PlanFileError(f"{where}: {line[:60]!r} is not understood")

    def _call(self, name: str, inside: str, where: str) -> st.Statement:
        plain = re.sub(r'"[^"]*"', '""', inside)
        given = re.findall(rf"({_NAME})=(?!=)", plain)
        if given != _KEYWORDS.get(name, []):
            raise PlanFileError(f"{where}: {name} with the arguments {', '.join(given) or 'without names'}")
        for word in given:
            inside = re.sub(rf", {word}=(?!=)", ", ", inside)
        if name == "sleep":
            return st.WaitSeconds(line=where, seconds=self._parsed(inside, where))
        # A pose is six numbers, as joints are.
        call = self._parsed(f"{name}({inside.replace('p[', '[')})", where)
        return st.Invoke(line=where, name=name.upper(), arguments=tuple(call[2]))

    def _parsed(self, text: str, where: str) -> Any:
        try:
            return Parser(text).whole()
        except PlanFileError as error:
            raise PlanFileError(f"{where}: {error}") from None
