"""Moves in time: the moves that wait, what they become, where arm and table are at each instant."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.language import statements as st
from scanmotion.judge.programme.paths import TICK_S, Drive, Driven, linear, point_to_point, timed_spline
from scanmotion.judge.programme.world import Event, World

AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
BRAKE_S = 0.2
"""Time in which BRAKE brings the motion to rest on its path."""


class Ended(Exception):
    """Nobody starts the programme again, or the power is gone."""


class Left(Exception):
    """EXIT."""


class Returned(Exception):
    """RETURN."""


class Stopped(Exception):
    """A motion was stopped for an error handler."""


class Resumed(Exception):
    def __init__(self, depth: int) -> None:
        self.depth = depth


class Mover(ABC):
    """Time, joints and outputs of a run; the machine adds what statements mean."""

    def __init__(self, drive: Drive, world: World, start: np.ndarray, facts: dict[str, Any]) -> None:
        """Args: machine data, the cell, joints at the start (7,) [deg], system variables."""
        self.drive, self.world = drive, world
        self.q, self.t = np.asarray(start, float).copy(), 0.0
        self.data: dict[str, Any] = {}
        self.system: dict[Any, Any] = dict(facts)
        self.chain: list[tuple[st.Move, Any, np.ndarray, float, list[st.Assign]]] = []
        self.marks: list[st.Assign] = []
        self.events: list[Event] = []
        self.rows: list[tuple[float, np.ndarray, int, bool]] = []
        self.gains: dict[int, np.ndarray] = {}
        self.rest: tuple[np.ndarray, np.ndarray] | None = None
        self.braked = False
        self.longest = float(facts.get("LONGEST", np.inf))
        self.step_name, self.start_out = facts.get("STEP", ""), int(facts.get("START_OUT", 0))
        self.outputs: dict[int, bool] = {}

    @abstractmethod
    def value(self, node: Any) -> Any:
        """Value of an expression now."""

    @abstractmethod
    def _do_assign(self, s: st.Assign) -> None: ...

    @abstractmethod
    def _look(self) -> None:
        """Looks at the interrupts after each tick."""

    def _note(self) -> None:
        step = int(self.data.get(self.step_name) or 0)
        self.rows.append((self.t, self.q.copy(), step, self.outputs.get(self.start_out, False)))

    def _event(self, kind: str, text: str = "", number: int = 0, on: bool = False) -> None:
        self.events.append(Event(t=self.t, kind=kind, text=text, number=number, on=on))

    def _stand(self, dt: float, q: np.ndarray) -> None:
        """Time goes on, the joints are where they are told, and nothing else is looked at."""
        self.t, self.q = self.t + dt, np.asarray(q, float)
        if self.t > self.longest:
            raise PlanFileError(f"is still running after {self.longest:.0f} s, many times the plan's")
        self._note()
        if not self.world.moved(self.t, self.q):
            raise Ended

    def _tick(self, dt: float, q: np.ndarray) -> None:
        self._stand(dt, q)
        self._look()

    def _do_brake(self, s: st.Brake) -> None:
        self.braked = True
        self._event("brake")
        if self.rest is None:
            return
        t, q = self.rest
        # The speed falls evenly to nothing: half of the way that would have been driven meanwhile.
        for u in np.arange(TICK_S, BRAKE_S + 1e-9, TICK_S):
            along = u - u**2 / (2 * BRAKE_S)
            self._stand(TICK_S, np.array([np.interp(along, t, q[:, j]) for j in range(7)]))
        self.rest = None

    def _do_move(self, s: st.Move) -> None:
        target = self.value(s.target)
        if s.kind == "abs":
            return self._do_timed_move(s, target)
        if s.kind == "ptp":
            if set(target) != set(AXES):
                raise PlanFileError("the point does not have A1 to A6 and E1")
            goal: Any = np.array([float(target[a]) for a in AXES])
        else:
            if set(target) != {*"XYZABC", "E1"}:
                raise PlanFileError("the point does not have X, Y, Z, A, B, C and E1")
            goal = (pose_of(target), float(target["E1"]))
        if self.chain and self.chain[-1][0].kind != s.kind:
            raise PlanFileError("PTP and LIN cannot round one corner")
        apo = self.system.get(("$APO", None, "CPTP"), 0.0) if s.rounded else 0.0
        if s.rounded and not 0 < float(apo) <= 100:
            raise PlanFileError(f"$APO.CPTP of {apo} is no percentage")
        self.chain.append((s, goal, self._speed(), float(apo), self.marks))
        self.marks = []
        if not s.rounded:
            self._flush()

    def _do_timed_move(self, s: st.Move, target: Any) -> None:
        """A joint move that may say its seconds."""
        six, others = target
        if len(six) != 6 or len(others) != 6 or any(v != 9e9 for v in others[1:]):
            raise PlanFileError("the point is no jointtarget of six axes and a table")
        goal = np.array([*six, others[0]], float)
        seconds = np.inf if s.seconds is None else float(self.value(s.seconds))
        if not 0.01 <= seconds <= 1000 and s.seconds is not None:
            raise PlanFileError(f"a move in {seconds:g} s")
        self.chain.append((s, goal, np.full(7, 10.0), seconds, self.marks))
        self.marks = []
        if not s.rounded:
            self._flush()

    def _timed(self, chain: list[Any]) -> Driven:
        """Moves one after another, each evenly in its time; the zone's rounding is left out."""
        points = np.array([self.q, *(goal for _, goal, *_ in chain)])
        seconds = [long for *_, long, _ in chain]
        if not np.isfinite(seconds).all():
            return point_to_point(points, np.full((len(chain), 7), 10.0), np.ones(len(chain) - 1), self.drive)
        # No joint is faster than it can be: the move takes longer then.
        least = (np.abs(np.diff(points, axis=0)) / self.drive.speed).max(axis=1)
        at = np.append(0.0, np.cumsum(np.maximum(seconds, least)))
        grid = np.append(np.arange(0.0, at[-1], TICK_S), at[-1])
        q = np.column_stack([np.interp(grid, at, points[:, j]) for j in range(7)])
        self.gains.setdefault(int(self.data.get(self.step_name) or 0), np.zeros(7))
        return Driven(t=grid, q=q, at=at)

    def _speed(self) -> np.ndarray:
        found = [self.system["$VEL_AXIS", n, ""] for n in range(1, 7)] + [self.system["$VEL_EXTAX", 1, ""]]
        speed = np.array(found, float)
        if not ((speed >= 1) & (speed <= 100)).all():
            raise PlanFileError(f"a speed of {speed.min():g} to {speed.max():g} percent")
        return speed

    def _gain(self) -> np.ndarray:
        """Share of the greatest acceleration, shape (7,)."""
        found = [self.system["$ACC_AXIS", n, ""] for n in range(1, 7)] + [self.system["$ACC_EXTAX", 1, ""]]
        gain = np.array(found, float)
        if not ((gain >= 1) & (gain <= 100)).all():
            raise PlanFileError(f"an acceleration of {gain.min():g} to {gain.max():g} percent")
        return gain / 100

    def _flush(self) -> None:
        """Drives what is waiting; the last move ends exactly."""
        if not self.chain:
            return
        chain, self.chain = self.chain, []
        if chain[0][0].kind == "abs":
            driven = self._timed(chain)
        elif chain[0][0].kind == "lin":
            X_FS = pose_of(self.system["$TOOL", None, ""])
            if np.abs(X_FS - self.drive.X_FS).max() > 1e-4:
                raise PlanFileError(f"{chain[0][0].line}: LIN with another tool than the scanner")
            speed, gain = (float(self.system[k, None, "CP"]) for k in ("$VEL", "$ACC"))
            driven = linear(self.q, [goal for _, goal, *_ in chain], speed, gain, self.drive)
        else:
            points = np.array([self.q, *(goal for _, goal, *_ in chain)])
            shares = np.array([apo for *_, apo, _ in chain[:-1]])
            drive = replace(self.drive, acceleration=self.drive.acceleration * self._gain())
            driven = point_to_point(points, np.array([v for _, _, v, *_ in chain]), shares, drive)
        self._play(driven, [(i + 1, m) for i, (*_, marks) in enumerate(chain) for m in marks])

    def _do_spline(self, s: st.Spline) -> None:
        self._flush()
        points = []
        for node in s.points:
            target = self.value(node)
            if set(target) != set(AXES):
                raise PlanFileError("the point does not have A1 to A6 and E1")
            points.append([float(target[a]) for a in AXES])
        share = np.cumsum([0.0, *(float(self.value(p)) for p in s.parts)])
        if abs(share[-1] - 100) > 1e-3:
            raise PlanFileError(f"the parts of TIME_BLOCK are {share[-1]:g} percent together")
        if np.abs(np.array(points[0]) - self.q).max() > 2e-3:
            raise PlanFileError("the spline does not begin where the arm stands")
        seconds = float(self.value(s.seconds))
        drive = replace(self.drive, acceleration=self.drive.acceleration * self._gain())
        driven = timed_spline(np.array(points), share / share[-1] * seconds, self._speed(), drive)
        self.gains[int(self.data.get(self.step_name) or 0)] = np.asarray(driven.gain)
        self._play(driven, [(n, mark) for n, mark in s.marks])

    def _play(self, driven: Driven, marks: list[tuple[int, st.Assign]]) -> None:
        todo = sorted((float(driven.at[min(n, len(driven.at) - 1)]), i, m) for i, (n, m) in enumerate(marks))
        begun = self.t
        for k in range(1, len(driven.t)):
            self.rest = (driven.t[k:] - driven.t[k], driven.q[k:])
            self._tick(begun + driven.t[k] - self.t, driven.q[k])
            while todo and todo[0][0] <= driven.t[k] + 1e-9:
                self._do_assign(todo.pop(0)[2])
        self.rest = None


def pose_of(frame: dict[str, float]) -> np.ndarray:
    """X of a FRAME's X, Y, Z [mm] and A, B, C [deg], shape (4, 4) [m]."""
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("ZYX", [frame[k] for k in "ABC"], degrees=True).as_matrix()
    X[:3, 3] = [frame[k] * 1e-3 for k in "XYZ"]
    return X
