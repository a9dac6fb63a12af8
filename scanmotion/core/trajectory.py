"""Operations and the timed trajectory: the nouns that timing makes and that judge, twin and exports read."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from scanmotion.core.support.dataframe import dataframe

OperationKind = Literal["transit", "revolution", "sweep", "dwell", "helix", "path"]
SCANNING: frozenset[str] = frozenset({"revolution", "sweep", "dwell", "helix", "path"})
"""Kinds of operation during which the scanner captures frames."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Operation:
    """A stretch of the programme that starts and ends at rest.

    transit: arm and table together, scanner off. revolution: the table turns once, the arm still, scanner on.
    sweep: the scanner on a straight line at constant speed relative to the part, table still, scanner on.
    dwell: everything still, scanner on. helix: the table turns on in one sense, a whole turn or more for each
    viewpoint, while the arm goes on straight from one to the next, scanner on. path: arm and table
    move at once, each as it likes, scanner on.
    """

    index: int
    kind: OperationKind
    viewpoints: tuple[str, ...]
    """Ids that this operation serves, in the order passed; for a transit, the ids that it leads to."""
    t_start: float
    t_end: float
    q_start: np.ndarray
    """Joint positions A1..A6, E1, shape (7,) [rad]."""
    q_end: np.ndarray

    @property
    def scanning(self) -> bool:
        return self.kind in SCANNING


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """Joint positions and their derivatives over time; joints in the order A1..A6, E1."""

    t: np.ndarray
    """Times from 0, increasing, at most 10 ms apart, shape (N,) [s]."""
    q: np.ndarray
    """Shape (N, 7) [rad]."""
    qd: np.ndarray
    """Shape (N, 7) [rad/s]."""
    qdd: np.ndarray
    """Shape (N, 7) [rad/s2]."""
    operation: np.ndarray
    """Index of the operation that each sample belongs to (N,); a shared instant belongs to the earlier."""
    operations: tuple[Operation, ...]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.t[-1])

    def to_dataframe(self, joint_names: Sequence[str] = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")) -> Any:
        """A pandas DataFrame, a row a sample: t [s], joints [rad], operation, its kind, whether it scans.

        Args:
            joint_names: of the seven joints, as `plan.cell.joint_names` has them.

        Raises:
            InputError: pandas is not installed.
        """
        kinds = np.array([o.kind for o in self.operations])
        scans = np.array([o.scanning for o in self.operations])
        joints = dict(zip(joint_names, self.q.T, strict=True))
        index = {
            "operation": self.operation,
            "kind": kinds[self.operation],
            "scanning": scans[self.operation],
        }
        return dataframe({"t": self.t, **joints, **index})


def joined(first: Trajectory, second: Trajectory) -> Trajectory:
    """The two in one, the second beginning where and when the first ends.

    Raises:
        ValueError: the second does not start in the first's last configuration.
    """
    gap = float(np.abs(first.q[-1] - second.q[0]).max())
    if gap > 1e-6:
        raise ValueError(f"the second trajectory starts {gap:.2g} rad away from the end of the first")
    shift, count = first.duration, len(first.operations)
    operations = tuple(
        replace(o, index=o.index + count, t_start=o.t_start + shift, t_end=o.t_end + shift)
        for o in second.operations
    )
    return Trajectory(
        t=np.concatenate([first.t, second.t[1:] + shift]),
        q=np.concatenate([first.q, second.q[1:]]),
        qd=np.concatenate([first.qd, second.qd[1:]]),
        qdd=np.concatenate([first.qdd, second.qdd[1:]]),
        operation=np.concatenate([first.operation, second.operation[1:] + count]),
        operations=first.operations + operations,
    )


def piece(whole: Trajectory, first: int, last: int) -> Trajectory:
    """The operations `first` to `last` by themselves, from time 0: what `joined` puts together."""
    rows = np.flatnonzero((whole.operation >= first) & (whole.operation <= last))
    # A shared instant belongs to the earlier operation.
    begin = rows[0] if first == 0 else max(rows[0] - 1, 0)
    span = slice(begin, rows[-1] + 1)
    t0 = whole.operations[first].t_start
    operations = tuple(
        replace(o, index=o.index - first, t_start=o.t_start - t0, t_end=o.t_end - t0)
        for o in whole.operations[first : last + 1]
    )
    return Trajectory(
        t=whole.t[span] - whole.t[begin], q=whole.q[span], qd=whole.qd[span], qdd=whole.qdd[span],
        operation=np.maximum(whole.operation[span] - first, 0), operations=operations,
    )  # fmt: skip
