"""The profile of a transit that is emitted, by the toppra library with its Seidel solver.

Pham and Pham 2018, doi:10.1109/TRO.2018.2819195. The scanner's speed and the axes' velocities are a limit
that varies along the path, pooled over neighbouring grid points (`speed_caps`), since taken at the points
alone it is passed between them. The axes' accelerations, lowered where the jerk asks for it, are asked for at
both ends of each cell. What is compiled in speed_profile.py solves the same problem for the many ways that
are only compared; benchmarks/timing_solvers.py says what either costs.
"""

import logging
from typing import Any

import numpy as np

from scanmotion.core.errors import TimingError
from scanmotion.core.support.later import deferred
from scanmotion.motion.profile.speed_profile import Derivatives

with deferred("matplotlib.pyplot"):
    from toppra.algorithm import TOPPRA
    from toppra.constraint import DiscretizationType, LinearConstraint
    from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate
    from toppra.interpolator import AbstractGeometricPath

# toppra tells of every pass; what it cannot solve is told by an error below.
logging.getLogger("toppra").setLevel(logging.ERROR)


class _Path(AbstractGeometricPath):
    """What toppra asks of a path whose derivatives on the grid are known: its interval alone."""

    def __init__(self, s: np.ndarray, dof: int) -> None:
        self._interval, self._dof = np.array([s[0], s[-1]]), dof

    def __call__(self, path_positions: Any, order: int = 0) -> Any:
        raise NotImplementedError("the derivatives are given on the grid")

    @property
    def dof(self) -> int:
        return self._dof

    @property
    def path_interval(self) -> np.ndarray:
        return self._interval

    @property
    def waypoints(self) -> None:
        return None


class _Accelerations(LinearConstraint):
    """|q1 u + q2 x| <= a at both ends of each cell, with limits `a` (n, dof) that vary along the path."""

    def __init__(self, d: Derivatives, a: np.ndarray) -> None:
        super().__init__()
        self.dof, self._d, self._a = d.q1.shape[1], d, a
        self.identical = False
        self.set_discretization_type(DiscretizationType.Interpolation)

    def compute_constraint_params(self, path: Any, gridpoints: np.ndarray) -> Any:
        """Coefficients of toppra's canonical form."""
        n, dof = self._d.q1.shape
        F = np.tile(np.vstack([np.eye(dof), -np.eye(dof)]), (n, 1, 1))
        g = np.hstack([self._a, self._a])
        zero = np.zeros_like(self._d.q1)
        return canlinear_colloc_to_interpolate(
            self._d.q1, self._d.q2, zero, F, g, None, None, gridpoints, identical=False
        )


class _Speeds(LinearConstraint):
    """0 <= x <= cap at each grid point, with caps (n,)."""

    def __init__(self, cap: np.ndarray, dof: int) -> None:
        super().__init__()
        self.dof, self._cap = dof, cap

    def compute_constraint_params(self, path: Any, gridpoints: np.ndarray) -> Any:
        """Coefficients of toppra's canonical form."""
        bounds = np.column_stack([np.zeros_like(self._cap), self._cap])
        return None, None, None, None, None, None, bounds


def toppra_profile(d: Derivatives, cap: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(ds/dt)^2 on the grid, rest to rest, the pointwise greatest.

    Args:
        d: the path's derivatives on a grid of n points.
        cap: greatest (ds/dt)^2 at each, shape (n,).
        a: greatest joint accelerations at each, shape (n, 7) [rad/s2].

    Raises:
        TimingError: toppra finds no profile.
    """
    dof = d.q1.shape[1]
    constraints = [_Accelerations(d, a), _Speeds(cap, dof)]
    solver = TOPPRA(constraints, _Path(d.s, dof), gridpoints=d.s, solver_wrapper="seidel")
    speed = solver.compute_parameterization(0.0, 0.0)[1]
    if speed is None or not np.isfinite(speed).all():
        raise TimingError("toppra finds no profile for a transit whose limits can be kept at a standstill")
    return np.asarray(speed) ** 2
