"""Which solver of the inverse kinematics serves an arm."""

import functools
from collections.abc import Callable

import numpy as np

from scanmotion.cell.opw import opw_arm
from scanmotion.cell.parallel import parallel_arm
from scanmotion.cell.robot import Robot, Solved
from scanmotion.errors import CellError


@functools.lru_cache(maxsize=16)
def solver_of(robot: Robot) -> Callable[[np.ndarray], Solved]:
    """The closed form for a spherical wrist or for three parallel axes.

    What is returned takes flange poses in the base, shape (n, 4, 4).

    Raises:
        CellError: the arm is of neither kind.
    """
    arm = opw_arm(robot) or parallel_arm(robot)
    if arm is None:
        raise CellError(
            f"{robot.name}: no analytic solution: that needs a spherical wrist and parallel A2 and A3, "
            "or parallel A2, A3 and A4",
            key="robot.model",
        )
    return arm
