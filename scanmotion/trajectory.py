"""Operations and the timed trajectory: the nouns that timing makes and that judge, twin and exports read."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

OperationKind = Literal["transit", "revolution", "sweep", "dwell"]
SCANNING: frozenset[str] = frozenset({"revolution", "sweep", "dwell"})
"""Kinds of operation during which the scanner captures frames."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Operation:
    """A stretch of the programme that starts and ends at rest.

    transit: arm and table together, scanner off. revolution: the table turns once, the arm still, scanner on.
    sweep: the scanner on a straight line at constant speed relative to the part, table still, scanner on.
    dwell: everything still, scanner on.
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
    """Index of the operation that each sample belongs to, shape (N,); a shared instant belongs to the earlier."""
    operations: tuple[Operation, ...]

    @property
    def duration(self) -> float:
        """Total time [s]."""
        return float(self.t[-1])
