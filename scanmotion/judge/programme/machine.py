"""Runs what the readers read: statements in order, moves with the controller's semantics, interrupts.

The machine looks ahead as a controller does: moves that round their corner wait for the next one, and what
stops the advance run (outputs, waits, halts, a look at the joints) makes the last of them exact.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.language import statements as st
from scanmotion.judge.programme.language.expressions import Name, member, value_of
from scanmotion.judge.programme.motions import AXES, Ended, Left, Mover, Resumed, Returned, Stopped
from scanmotion.judge.programme.paths import TICK_S, Drive
from scanmotion.judge.programme.system_variables import check_setting
from scanmotion.judge.programme.world import Run, World

_MOST_STATEMENTS, _MOST_S, _MOST_DEEP = 400_000, 20_000.0, 40


@dataclass(eq=False, kw_only=True)
class _Scope:
    routine: st.Routine
    file: str
    depth: int
    values: dict[str, Any]


@dataclass(eq=False, kw_only=True)
class _Watch:
    """An interrupt."""

    condition: Any
    routine: str
    scope: _Scope
    period: float = 0.0
    due: float = 0.0
    on: bool = False
    was: bool = False
    busy: bool = False


class Machine(Mover):
    """One run of a programme; `run` gives its log."""

    def __init__(
        self,
        programme: st.Programme,
        drive: Drive,
        world: World,
        start: np.ndarray,
        facts: dict[str, Any],
    ) -> None:
        """Args: programme, machine data, the cell, joints at the start (7,) [deg], system variables."""
        super().__init__(drive, world, start, facts)
        self.programme = programme
        self.data = {k: dict(v) if isinstance(v, dict) else v for k, v in programme.data.items()}
        self.timers: dict[int, list[float]] = {}
        self.watches: dict[int, _Watch] = {}
        self.scopes: list[_Scope] = []
        self.count, self.message = 0, ""

    # --- the run -------------------------------------------------------------------------------------

    def run(self) -> Run:
        """Runs the main routine to its end, or to where nobody goes on.

        Raises:
            PlanFileError: a statement has no meaning, or the programme does not end.
        """
        self._note()
        ended = True
        try:
            self._call(self.programme.main, [], "")
            self._flush()
        except Ended:
            ended = False
        except (Left, Returned, Resumed):
            raise PlanFileError(f"{self.programme.main}: leaves what it is not in") from None
        t, q, step, on = zip(*self.rows, strict=True)
        return Run(
            t=np.array(t), q=np.array(q), step=np.array(step), recording=np.array(on),
            events=tuple(self.events), ended=ended, gains=self.gains,
        )  # fmt: skip

    def _call(self, name: str, arguments: list[Any], at: str) -> None:
        routine = self.programme.find(name, at)
        if routine is None:
            return self._system_call(name, arguments)
        if len(arguments) != len(routine.parameters) or len(self.scopes) > _MOST_DEEP:
            raise PlanFileError(f"{name}: called with {len(arguments)} values")
        key = next(k for k, r in self.programme.routines.items() if r is routine)
        file = key.split(".")[0] if "." in key else at
        file = name if name in self.programme.routines and "." not in key and self._is_file(name) else file
        values: dict[str, Any] = dict.fromkeys(routine.local)
        values.update(zip(routine.parameters, arguments, strict=True))
        self.scopes.append(
            _Scope(routine=routine, file=file, depth=len(self.scopes), values=values)
        )  # fmt: skip
        try:
            self._body(routine.body)
        except Returned:
            pass
        except Stopped:
            if not routine.handler:
                raise
            self.chain, self.marks = [], []
            self._handled(routine.handler)
        finally:
            self.scopes.pop()

    def _handled(self, handler: tuple[st.Statement, ...]) -> None:
        try:
            self._body(handler)
        except Returned:
            pass

    def _do_raise(self, s: st.Raise) -> None:
        self._do_brake(st.Brake(line=s.line))
        self.braked = False
        raise Stopped

    def _is_file(self, name: str) -> bool:
        return name == self.programme.main or any(k.startswith(f"{name}.") for k in self.programme.routines)

    def _body(self, body: tuple[st.Statement, ...]) -> None:
        for statement in body:
            self.count += 1
            if self.count > _MOST_STATEMENTS:
                raise PlanFileError(f"{statement.line}: the programme does not end")
            try:
                getattr(self, f"_do_{type(statement).__name__.lower()}")(statement)
            except PlanFileError as error:
                text = str(error)
                raise (
                    error if ":" in text.split(" ")[0] else PlanFileError(f"{statement.line}: {text}")
                ) from None
            except (TypeError, KeyError, ValueError, IndexError, AttributeError, OverflowError):
                raise PlanFileError(f"{statement.line}: has no meaning") from None

    # --- values --------------------------------------------------------------------------------------

    def value(self, node: Any) -> Any:
        """Value of an expression now."""
        return value_of(node, self._variable, self._function)

    def _variable(self, name: Name) -> Any:
        word = name.word
        index = None if name.index is None else int(self.value(name.index))
        scope = self.scopes[-1]
        values = scope.values if word in scope.values else self.data
        if word in values:
            found = values[word] if index is None else values[word][index]
            return member(found, name.field) if name.field else found
        if word.startswith("#"):
            return word
        if word == "$IN":
            return self.world.input(int(index or 0), self.t)
        if word == "$TIMER":
            return self._timer(int(index or 0))
        if word == "$TIMER_FLAG":
            return self._timer(int(index or 0)) > 0
        if word == "$AXIS_ACT":
            self._flush()
            return self.q[AXES.index(name.field)]
        if word == "$AXIS_INT":
            return dict(zip(AXES, self.q, strict=True))
        key = (word, index, name.field)
        if key in self.system:
            return self.system[key]
        raise PlanFileError(f"{word}{'' if index is None else f'[{index}]'} is not known")

    def _function(self, name: str, arguments: list[Any]) -> Any:
        if name == "CJOINTT":
            self._flush()
            return [self.q[:6].tolist(), [float(self.q[6]), *[9e9] * 5]]
        if name == "ABS":
            return abs(arguments[0])
        if name == "SET_KRLMSG":
            if set(arguments[2]) != {1, 2, 3} or "VL_STOP" not in arguments[3]:
                raise PlanFileError("the message's parameters or options are not set")
            self._say(str(arguments[1]["MSG_TXT"]))
            return 1
        raise PlanFileError(f"the function {name} is not known")

    def _timer(self, n: int) -> float:
        """Milliseconds of a timer."""
        value, since = self.timers.get(n, [0.0, np.nan])
        return value if np.isnan(since) else value + (self.t - since) * 1e3

    def _say(self, text: str) -> None:
        self.message = text
        self._event("say", text)

    # --- statements ----------------------------------------------------------------------------------

    def _do_assign(self, s: st.Assign) -> None:
        name, value = s.target, self.value(s.value)
        index = None if name.index is None else int(self.value(name.index))
        scope, word = self.scopes[-1], name.word
        if word in scope.routine.signals:
            return self._word(*scope.routine.signals[word], int(value))
        if word == "$OUT":
            return self._output(int(index or 0), bool(value))
        if word == "$TIMER":
            running = not np.isnan(self.timers.get(int(index or 0), [0.0, np.nan])[1])
            self.timers[int(index or 0)] = [float(value), self.t if running else np.nan]
            return None
        if word == "$TIMER_STOP":
            n = int(index or 0)
            self.timers[n] = [self._timer(n), np.nan if value else self.t]
            return None
        values = scope.values if word in scope.values else self.data if word in self.data else None
        if values is None:
            check_setting(word, index, name.field, value)
            self.system[word, index, name.field] = value
        elif index is not None:
            if not 1 <= index <= self.programme.sizes.get(word, index):
                raise PlanFileError(f"{word}[{index}] is not in the array")
            values[word] = {**(values[word] or {}), index: value}
        else:
            values[word] = value
        if word == self.step_name:
            self._event("step", number=int(value))
        return None

    def _word(self, first: int, last: int, value: int) -> None:
        if not 0 <= value < 1 << (last - first + 1):
            raise PlanFileError(f"{value} does not fit into the outputs {first} to {last}")
        self._event("word", number=value, text=f"{first}..{last}")
        for n in range(first, last + 1):
            self._output(n, bool(value >> (n - first) & 1))

    def _output(self, number: int, on: bool) -> None:
        self._flush()
        self.outputs[number] = on
        self.world.output(number, on, self.t)
        self._event("output", number=number, on=on)

    def _do_if(self, s: st.If) -> None:
        for condition, body in s.cases:
            if condition is None or self.value(condition):
                return self._body(body)
        return None

    def _do_loop(self, s: st.Loop) -> None:
        try:
            while s.condition is None or self.value(s.condition):
                self._body(s.body)
                if not s.body:
                    raise PlanFileError("an empty loop")
        except Left:
            pass

    def _do_for(self, s: st.For) -> None:
        values = self.scopes[-1].values
        for i in range(int(self.value(s.first)), int(self.value(s.last)) + 1):
            values[s.variable] = i
            self._body(s.body)

    def _do_exit(self, s: st.Exit) -> None:
        raise Left

    def _do_return(self, s: st.Return) -> None:
        raise Returned

    def _do_nothing(self, s: st.Nothing) -> None:
        pass

    def _do_invoke(self, s: st.Invoke) -> None:
        scope = self.scopes[-1]
        try:
            self._call(s.name, [self.value(a) for a in s.arguments], scope.file)
        except Resumed as resumed:
            if resumed.depth != scope.depth:
                raise

    def _system_call(self, name: str, arguments: list[Any]) -> None:
        if name == "SETGO" and len(arguments) == 2:
            self._flush()
            return self._event("word", number=int(arguments[1]), text=f"{int(arguments[0])}..")
        if name != "BAS" or len(arguments) != 2 or arguments[0] not in ("#INITMOV", "#TOOL", "#BASE"):
            raise PlanFileError(f"{name} is not known")
        what, n = arguments[0], int(arguments[1])
        if what == "#TOOL":
            self.system["$TOOL", None, ""] = self.system["TOOL_DATA", n, ""]
            self.system["$LOAD", None, ""] = self.system["LOAD_DATA", n, ""]
        elif what == "#BASE":
            self.system["$BASE", None, ""] = self.system["BASE_DATA", n, ""]
        else:
            self._percent(100.0)
            for field, value in (("CP", 3.0), ("ORI1", 400.0), ("ORI2", 400.0)):
                self.system["$VEL", None, field] = value
            for field, value in (("CP", 4.5), ("ORI1", 1000.0), ("ORI2", 1000.0)):
                self.system["$ACC", None, field] = value

    def _percent(self, value: float) -> None:
        for n in range(1, 7):
            self.system["$VEL_AXIS", n, ""] = self.system["$ACC_AXIS", n, ""] = value
        self.system["$VEL_EXTAX", 1, ""] = self.system["$ACC_EXTAX", 1, ""] = value

    def _do_say(self, s: st.Say) -> None:
        self._say(str(self.value(s.text)))

    def _do_halt(self, s: st.Halt) -> None:
        self._flush()
        self._event("halt", self.message)
        if not self.world.halt(self.t, self.message):
            raise Ended

    def _do_waitseconds(self, s: st.WaitSeconds) -> None:
        self._flush()
        until = self.t + float(self.value(s.seconds))
        if until > self.t + _MOST_S:
            raise PlanFileError("waits for longer than any scan lasts")
        while self.t < until - 1e-9:
            self._tick(min(TICK_S, until - self.t), self.q)

    def _do_waituntil(self, s: st.WaitUntil) -> None:
        self._flush()
        limit = np.inf if s.timeout is None else self.t + float(self.value(s.timeout))
        late = False
        while not self.value(s.condition):
            late = self.t >= limit - 1e-9
            if late:
                break
            if self.t > _MOST_S:
                raise PlanFileError("waits for ever")
            self._tick(TICK_S, self.q)
        if s.flag is not None:
            self._do_assign(st.Assign(line=s.line, target=s.flag, value=("bool", late)))

    def _do_pulse(self, s: st.Pulse) -> None:
        index = int(self.value(s.output.index))
        self._event("pulse", number=index)

    def _do_trigger(self, s: st.Trigger) -> None:
        self.marks.append(s.mark)

    # --- interrupts ----------------------------------------------------------------------------------

    def _do_interrupt(self, s: st.Interrupt) -> None:
        if s.what == "decl":
            if s.number != 3:
                self.watches[s.number] = _Watch(
                    condition=s.condition, routine=s.routine, scope=self.scopes[-1],
                    period=0.0 if s.period is None else float(self.value(s.period)),
                )  # fmt: skip
        elif s.number != 3:
            watch = self.watches[s.number]
            watch.on, watch.due = s.what == "on", self.t + watch.period
            watch.was = watch.period == 0 and bool(self.value(watch.condition))

    def _do_resume(self, s: st.Resume) -> None:
        self.chain, self.marks = [], []
        watch = next((w for w in self.watches.values() if w.busy and w.routine == self._root()), None)
        if watch is None:
            raise PlanFileError("RESUME outside of an interrupt")
        watch.busy = False
        raise Resumed(watch.scope.depth)

    def _root(self) -> str:
        return self.scopes[-1].routine.name

    def _look(self) -> None:
        for watch in list(self.watches.values()):
            if not watch.on or watch.busy:
                continue
            if watch.period:
                fired = self.t >= watch.due - 1e-9
                watch.due += watch.period * fired
            else:
                now = bool(self.value(watch.condition))
                fired, watch.was = now and not watch.was, now
            if fired:
                self._interrupted(watch)

    def _interrupted(self, watch: _Watch) -> None:
        chain, self.chain, marks, self.marks = self.chain, [], self.marks, []
        watch.busy, self.braked = True, False
        try:
            self._call(watch.routine, [], watch.scope.file)
            self._flush()
        finally:
            watch.busy = False
        if self.braked:
            raise PlanFileError(f"{watch.routine}: brakes and does not resume")
        self.chain, self.marks = chain, marks
        watch.was = watch.period == 0 and bool(self.value(watch.condition))
