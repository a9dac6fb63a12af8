"""An arm of Universal Robots and its table, each with a programme and a clock of its own.

Assumptions, none confirmed by a controller: servoj has the joints at its target when its time is over; movej
is a straight line in joints with a trapezoidal speed; stopj slows all joints down together; the table's
profile is a cubic spline at rest at both ends; signals arrive within the cycle in which they are set.
"""

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.language import statements as st
from scanmotion.judge.programme.language.table_drive import TableProgramme, TableStep
from scanmotion.judge.programme.machine import Machine
from scanmotion.judge.programme.motions import Ended
from scanmotion.judge.programme.paths import TICK_S

CYCLE_S, LOOKAHEAD_S, GAIN = 0.01, 0.03, 500.0
"""The arguments of servoj that the machine knows the motion of."""
_MOST_JUMP_DEG = 2.5
"""Farther than that from where the joints are servoj would start with a jerk: 250 deg/s in a cycle [deg]."""


class DrivenTable:
    """The table's drive in time: it looks at the arm's signals and says whether it is ready."""

    def __init__(self, programme: TableProgramme, angle: float) -> None:
        """Args: what it runs, and where it stands [deg]."""
        self.programme, self.angle = programme, angle
        self.state, self.over, self.since = 0, 0, 0.0
        self.broken = False
        self.t = 0.0
        self.curve: CubicSpline | None = None
        self.fall: tuple[float, float] | None = None

    @property
    def moving(self) -> bool:
        """Whether it drives what a step says."""
        return self.state == 1 and self.curve is not None

    def ready(self, step: int) -> bool:
        """Its output Ready."""
        return (self.state == 0 and self._there(step)) or self.state == 5

    @property
    def fault(self) -> bool:
        """Its output Fault."""
        return self.state == 9

    def _there(self, step: int) -> bool:
        return abs(self.angle - self._step(step).first) <= self.programme.near_deg

    def _step(self, step: int) -> TableStep:
        if step not in self.programme.steps:
            raise PlanFileError(f"the table's drive has no step {step}")
        return self.programme.steps[step]

    def look(self, start: bool, step: int) -> None:
        """One cycle of its state machine."""
        known = self._step(step)
        if self.state == 5:
            self.state = 0 if step != self.over else 9 if start else 5
        if self.state == 0 and start:
            self.state, self.since, self.curve = (1 if self._there(step) else 9), self.t, None
        elif self.state == 1 and self.curve is not None and self.t >= self.since + self.curve.x[-1] - 1e-9:
            self.state, self.over, self.angle = 2, step, float(known.places[-1])
        elif self.state == 1 and not start:
            self.state, self.since = 3, self.t
            speed = 0.0 if self.curve is None else float(self.curve(max(self.t - self._begin(), 0.0), 1))
            self.fall = (self.angle, speed)
        if self.state == 2 and not start:
            self.state = 5
        if self.state == 9 and not start and not self.broken:
            self.state = 0

    def _begin(self) -> float:
        return self.since

    def advance(self, t: float, start: bool, step: int) -> float:
        """Where it is at a later time [deg]."""
        self.t = t
        known = self._step(step)
        if self.state == 1:
            if self.curve is None and t > self.since + self.programme.lag_s - 1e-9:
                if len(known.places) == 0:
                    raise PlanFileError(f"the table's drive has no way in step {step}")
                at = np.append(0.0, np.cumsum(known.seconds))
                way = np.append(known.first, known.places)
                self.curve = CubicSpline(at, way, bc_type="clamped")
                self.since += self.programme.lag_s
            if self.curve is not None:
                self.angle = float(self.curve(min(t - self.since, self.curve.x[-1])))
        elif self.state == 3:
            self._halt(t)
        elif self.state == 4:
            room = self.programme.back_deg_s * (t - self.since)
            self.since = t
            self.angle += float(np.clip(known.first - self.angle, -room, room))
            if self.angle == known.first:
                self.state = 0
        self.look(start, step)
        return self.angle

    def _halt(self, t: float) -> None:
        angle, speed = self.fall or (self.angle, 0.0)
        long = abs(speed) / self.programme.stop_deg_s2
        u = min(t - self.since, long)
        self.angle = angle + speed * u - np.sign(speed) * self.programme.stop_deg_s2 * u**2 / 2
        if u >= long:
            self.state, self.since = 4, t


class ArmAndTable(Machine):
    """One run of a URScript programme and of its table's."""

    def __init__(self, programme: st.Programme, *more: Any) -> None:
        """Args: the programme, and all else as Machine."""
        super().__init__(programme, *more)
        self.signals = self.system["SIGNALS"]
        if not isinstance(programme.table, TableProgramme):
            raise PlanFileError("the programme of the table's drive is missing")
        self.table = DrivenTable(programme.table, float(self.q[6]))
        self.word = 0

    def _stand(self, dt: float, q: np.ndarray) -> None:
        where = np.array(q, float)
        if self.t >= getattr(self.world, "table_fault_at", np.inf):
            self.table.state, self.table.broken = 9, True
        where[6] = self.table.advance(
            self.t + dt, self.outputs.get(self.signals.table_start_out, False), self.word
        )
        if self.table.moving:
            self._is_timed()
        super()._stand(dt, where)

    def _is_timed(self) -> None:
        self.gains.setdefault(int(self.data.get(self.step_name) or 0), np.zeros(7))

    # --- signals -------------------------------------------------------------------------------------

    def _function(self, name: str, arguments: list[Any]) -> Any:
        if name in ("READ_INPUT_BOOLEAN_REGISTER", "GET_STANDARD_DIGITAL_IN") and len(arguments) == 1:
            return self._input(_whole(arguments[0]), digital=name.startswith("GET"))
        if name == "GET_ACTUAL_JOINT_POSITIONS" and not arguments:
            return np.deg2rad(self.q[:6]).tolist()
        if name == "INTEGER_TO_BINARY_LIST" and len(arguments) == 1:
            return [bool(_whole(arguments[0]) >> i & 1) for i in range(32)]
        if name == "ABS":
            return abs(arguments[0])
        raise PlanFileError(f"the function {name.lower()} is not known")

    def _input(self, number: int, *, digital: bool) -> bool:
        _checked_signal(number, digital=digital)
        if number == self.signals.table_ready_in:
            return self.table.ready(self.word)
        if number == self.signals.table_fault_in:
            return self.table.fault
        return self.world.input(number, self.t)

    def _set(self, number: int, on: bool, *, digital: bool) -> None:
        _checked_signal(number, digital=digital)
        s = self.signals
        if s.frame_out and number == s.frame_out and not s.frame_in:
            if on and not self.outputs.get(number, False):
                self._event("pulse", number=number)
            self.outputs[number] = on
            return
        self._output(number, on)
        if number == s.table_start_out:
            self.table.look(on, self.word)
        if s.step_out and number == s.step_out + s.step_bits - 1:
            bits = range(s.step_bits)
            self.word = sum(self.outputs.get(s.step_out + i, False) << i for i in bits)
            self._event("word", number=self.word, text=f"{s.step_out}..{number}")
            self.table.look(self.outputs.get(s.table_start_out, False), self.word)

    # --- statements ----------------------------------------------------------------------------------

    def _system_call(self, name: str, arguments: list[Any]) -> None:
        known = {
            "SERVOJ": self._servo, "MOVEJ": self._movej, "STOPJ": self._stopj, "POPUP": self._popup,
            "HALT": self._end, "SET_TCP": self._tcp, "SET_PAYLOAD": self._payload,
        }  # fmt: skip
        if name in ("WRITE_OUTPUT_BOOLEAN_REGISTER", "SET_STANDARD_DIGITAL_OUT") and len(arguments) == 2:
            if not isinstance(arguments[1], bool):
                raise PlanFileError(f"{name.lower()}: on or off is expected")
            return self._set(_whole(arguments[0]), arguments[1], digital=name.startswith("SET"))
        if name not in known:
            raise PlanFileError(f"{name.lower()} is not known")
        return known[name](*arguments)

    def _servo(self, target: Any, a: float, v: float, t: float, lookahead: float, gain: float) -> None:
        if (a, v, t, lookahead, gain) != (0, 0, CYCLE_S, LOOKAHEAD_S, GAIN):
            raise PlanFileError("servoj with another cycle, lookahead time or gain")
        goal = _six(target)
        if np.abs(goal - self.q[:6]).max() > _MOST_JUMP_DEG:
            raise PlanFileError("servoj jumps")
        self._is_timed()
        self._tick(CYCLE_S, np.append(goal, self.q[6]))

    def _movej(self, target: Any, a: float, v: float) -> None:
        goal, start = _six(target), self.q[:6].copy()
        if not (0.01 <= a <= 5 and 0.01 <= v <= 1.05):
            raise PlanFileError(f"movej at {a:g} rad/s2 and {v:g} rad/s")
        far, gain, speed = np.deg2rad(np.abs(goal - start).max()), float(a), float(v)
        if far < 1e-9:
            return
        ramp = min(speed / gain, float(np.sqrt(far / gain)))
        total = far / (gain * ramp) + ramp
        for u in np.append(np.arange(TICK_S, total, TICK_S), total):
            early, late = min(u, ramp), max(u - (total - ramp), 0.0)
            way = gain * (early**2 / 2 + ramp * max(u - ramp, 0.0) - late**2 / 2)
            self._tick(min(TICK_S, u), np.append(start + way / far * (goal - start), self.q[6]))

    def _stopj(self, a: float) -> None:
        if not 0.5 <= a <= 40:
            raise PlanFileError(f"stopj with {a:g} rad/s2")
        self._event("brake")
        (t0, q0, *_), (t1, q1, *_) = self.rows[-2:] if len(self.rows) > 1 else self.rows[-1:] * 2
        speed = (q1 - q0)[:6] / max(t1 - t0, 1e-3) if t1 > t0 else np.zeros(6)
        long = float(np.abs(speed).max()) / np.rad2deg(a)
        start = self.q[:6].copy()
        for u in np.append(np.arange(TICK_S, long, TICK_S), long) if long > 1e-6 else ():
            self._stand(TICK_S, np.append(start + speed * (u - u**2 / (2 * long)), self.q[6]))

    def _popup(self, text: str, title: str, error: bool, blocking: bool) -> None:
        if blocking is not True or not isinstance(error, bool):
            raise PlanFileError("a message that nobody has to answer")
        self._say(str(text))
        self._do_halt(st.Halt(line=str(title)))

    def _end(self) -> None:
        raise Ended

    def _tcp(self, pose: Any) -> None:
        self.system["TCP"] = [float(x) for x in pose]

    def _payload(self, mass: float, centre: Any) -> None:
        self.system["PAYLOAD"] = (float(mass), [float(x) for x in centre])


def _six(target: Any) -> np.ndarray:
    """Six joints [deg] of radians."""
    found = np.rad2deg(np.array(target, float))
    if found.shape != (6,) or not np.isfinite(found).all():
        raise PlanFileError("the point has no six joints")
    return found


def _whole(value: Any) -> int:
    if isinstance(value, bool) or value != int(value):
        raise PlanFileError(f"{value} is no whole number")
    return int(value)


def _checked_signal(number: int, *, digital: bool) -> None:
    """Digital signals of the control box are 0 to 7, registers of a field bus 0 to 63."""
    if not 0 <= number <= (7 if digital else 63):
        raise PlanFileError(f"the signal {number} is none of the arm's")
