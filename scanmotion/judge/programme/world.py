"""What stands around a controller: inputs, outputs, somebody who presses start; and the log of a run."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from scanmotion.cell.settings.programme import ProgrammeSettings


class World(Protocol):
    """What a programme can ask of and tell the cell."""

    def input(self, number: int, t: float) -> bool:
        """Whether a digital input is on."""
        ...

    def output(self, number: int, on: bool, t: float) -> None:
        """A digital output changes."""
        ...

    def halt(self, t: float, said: str) -> bool:
        """The programme halts after the message; whether somebody starts it again."""
        ...

    def moved(self, t: float, q: np.ndarray) -> bool:
        """The arm and the table are here now (7,) [deg]; whether the programme goes on."""
        ...


@dataclass(eq=False, kw_only=True)
class ScriptedScanner:
    """A scanner that does as it should, but for what it is told to get wrong."""

    signals: ProgrammeSettings
    ready_after: float = 0.0
    """Seconds until it is ready; infinite for never."""
    done_after: float = 0.05
    """Seconds after the end of a recording until it says that it is done; infinite for never."""
    late_done: float = 0.0
    """The same for the first recording, where it is not 0."""
    faults: frozenset[int] = frozenset()
    """Recordings, counted from 1, that a fault breaks off `fault_after` seconds after they began."""
    fault_after: float = 0.3
    fault_lasts: float = 0.5
    fault_times: tuple[float, ...] = ()
    """Seconds into each recording at which its fault comes, instead of `fault_after`."""
    table_fault_at: float = np.inf
    """When a drive of the table of its own has a fault [s]."""
    patience: int = 0
    """How often somebody starts the programme again after a halt."""
    stop_at: float = np.inf
    """When the power goes [s]."""
    on: dict[int, bool] = field(default_factory=dict)
    recordings: int = 0
    """How many have begun."""
    _began: float = -np.inf
    _ended: float = -np.inf

    def input(self, number: int, t: float) -> bool:
        """Ready until a fault, done for a while after a recording, fault for a while."""
        s = self.signals
        after = self.fault_after
        if self.recordings <= len(self.fault_times) and self.recordings:
            after = self.fault_times[self.recordings - 1]
        broken = self.recordings in self.faults and 0 <= t - self._began - after < self.fault_lasts
        if number == s.ready_in:
            return t >= self.ready_after and not broken
        if number == s.done_in:
            late = self.late_done if self.recordings == 1 and self.late_done else self.done_after
            return not self._recording and t >= self._ended + late
        if number == s.fault_in:
            return broken
        return number == s.table_ready_in

    @property
    def _recording(self) -> bool:
        return self.on.get(self.signals.start_out, False)

    def output(self, number: int, on: bool, t: float) -> None:
        """Begins and ends recordings."""
        if number == self.signals.start_out and on != self._recording:
            if on:
                self.recordings, self._began = self.recordings + 1, t
            else:
                self._ended = t
        self.on[number] = on

    def halt(self, t: float, said: str) -> bool:
        """Somebody acknowledges as long as patience lasts."""
        self.patience -= 1
        return self.patience >= 0

    def moved(self, t: float, q: np.ndarray) -> bool:
        """Goes on until the power goes."""
        return t < self.stop_at


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something that happened: say, halt, output, pulse, step, brake, interrupt."""

    t: float
    kind: str
    text: str = ""
    number: int = 0
    on: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """The log of a run."""

    t: np.ndarray
    """Shape (n,) [s]."""
    q: np.ndarray
    """Shape (n, 7) [deg]."""
    step: np.ndarray
    """Number of the step, shape (n,); 0 before the first and after the last."""
    recording: np.ndarray
    """Whether the scanner was told to record, shape (n,)."""
    events: tuple[Event, ...]
    ended: bool
    """Whether the programme came to its end."""
    gains: dict[int, np.ndarray]
    """Greatest accelerations of the timed splines by step, shape (7,) [deg/s2]."""

    def said(self, kind: str) -> list[Event]:
        """The events of a kind."""
        return [e for e in self.events if e.kind == kind]
