"""What a programme says, whatever its language: statements that readers make and the machine obeys."""

from dataclasses import dataclass, field
from typing import Any

from scanmotion.judge.programme.language.expressions import Name


@dataclass(frozen=True, kw_only=True)
class Statement:
    """One statement; `line` is where it stands, "file:number"."""

    line: str


@dataclass(frozen=True, kw_only=True)
class Assign(Statement):
    target: Name
    value: Any


@dataclass(frozen=True, kw_only=True)
class If(Statement):
    """The first case whose condition holds."""

    cases: tuple[tuple[Any, tuple[Statement, ...]], ...]
    """Condition and body; a condition None always holds."""


@dataclass(frozen=True, kw_only=True)
class Loop(Statement):
    """Until EXIT, or while a condition holds."""

    body: tuple[Statement, ...]
    condition: Any = None


@dataclass(frozen=True, kw_only=True)
class For(Statement):
    variable: str
    first: Any
    last: Any
    body: tuple[Statement, ...]


@dataclass(frozen=True, kw_only=True)
class Exit(Statement):
    """Leaves the loop."""


@dataclass(frozen=True, kw_only=True)
class Return(Statement):
    """Leaves the routine."""


@dataclass(frozen=True, kw_only=True)
class Invoke(Statement):
    """A routine or a procedure of the system."""

    name: str
    arguments: tuple[Any, ...] = ()


@dataclass(frozen=True, kw_only=True)
class WaitSeconds(Statement):
    seconds: Any


@dataclass(frozen=True, kw_only=True)
class WaitUntil(Statement):
    condition: Any
    timeout: Any = None
    """Seconds; None waits for ever."""
    flag: Name | None = None
    """Told whether the time ran out."""


@dataclass(frozen=True, kw_only=True)
class Halt(Statement):
    """Stands until somebody starts the programme again."""


@dataclass(frozen=True, kw_only=True)
class Say(Statement):
    """A message to the operator."""

    text: Any


@dataclass(frozen=True, kw_only=True)
class Move(Statement):
    """To joints (ptp) or a pose (lin)."""

    kind: str
    target: Any
    rounded: bool = False
    seconds: Any = None
    """Where the language times its moves; else None."""
    speed: Any = None
    """As `seconds`, for languages that give it with the move: percent, or m/s."""
    zone: Any = None


@dataclass(frozen=True, kw_only=True)
class Spline(Statement):
    """Joints with the share of the block's time that each takes, and what is set when they are passed."""

    points: tuple[Any, ...]
    parts: tuple[Any, ...]
    seconds: Any
    marks: tuple[tuple[int, Assign], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Trigger(Statement):
    """An assignment when the next move ends."""

    mark: Assign


@dataclass(frozen=True, kw_only=True)
class Pulse(Statement):
    output: Name
    seconds: Any


@dataclass(frozen=True, kw_only=True)
class Interrupt(Statement):
    """decl, on, off."""

    what: str
    number: int
    condition: Any = None
    routine: str = ""
    period: Any = None
    """Seconds, where time and not a condition sets it off."""


@dataclass(frozen=True, kw_only=True)
class Brake(Statement):
    """Stops the motion; in interrupt routines."""


@dataclass(frozen=True, kw_only=True)
class Resume(Statement):
    """Leaves everything up to where the interrupt was declared."""


@dataclass(frozen=True, kw_only=True)
class Raise(Statement):
    """Stops the motion and goes on in the error handler of the routine that moves."""


@dataclass(frozen=True, kw_only=True)
class Nothing(Statement):
    """What has no effect on the motion, CONTINUE for one."""


@dataclass(frozen=True, kw_only=True)
class Routine:
    """A routine, its parameters and its own names."""

    name: str
    parameters: tuple[str, ...]
    local: frozenset[str]
    body: tuple[Statement, ...]
    handler: tuple[Statement, ...] = ()
    """What is done after Raise."""
    signals: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Words of outputs: name, first and last number."""


@dataclass(frozen=True, kw_only=True)
class Programme:
    """Everything that was read."""

    language: str
    main: str
    routines: dict[str, Routine]
    """By name, local ones as "file.name"."""
    data: dict[str, Any]
    """First values of variables."""
    sizes: dict[str, int] = field(default_factory=dict)
    """Of arrays."""
    step: str = ""
    """The variable that holds the number of the step."""
    remarks: tuple[str, ...] = ()
    table: Any = None
    """Of a table's own drive, where the arm has no axis for it."""

    def find(self, name: str, at: str) -> Routine | None:
        """The routine that `name` means in the file `at`."""
        return self.routines.get(f"{at}.{name}") or self.routines.get(name)
