"""Which solver of the inverse kinematics serves an arm."""

import functools
from collections.abc import Callable

import numpy as np

from scanmotion.cell.arm.robot import Robot, Solved
from scanmotion.cell.ik.opw import opw_arm
from scanmotion.cell.ik.parallel import parallel_arm
from scanmotion.cell.ik.turned_opw import turned_arm


@functools.lru_cache(maxsize=16)
def _closed_form(robot: Robot) -> Callable[[np.ndarray], Solved] | None:
    return opw_arm(robot) or parallel_arm(robot) or turned_arm(robot)


def has_closed_form(robot: Robot) -> bool:
    """Whether the arm is solved in closed form, in all its branches."""
    return _closed_form(robot) is not None


@functools.lru_cache(maxsize=16)
def solver_of(robot: Robot) -> Callable[[np.ndarray], Solved]:
    """The closed form for a spherical wrist or for three parallel axes; else Drake's search, which is slow.

    What is returned takes flange poses in the base, shape (n, 4, 4).
    """
    arm = _closed_form(robot)
    if arm is not None:
        return arm
    from scanmotion.cell.ik.numeric import NumericArm

    return NumericArm(robot)
