"""Planning round obstacles: OMPL's RRT-Connect (Kuffner and LaValle 2000), the same path for a seed."""

from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base, geometric, util

EdgeCheck = Callable[[np.ndarray, np.ndarray], bool]
"""Whether the straight joint edge between two configurations, shape (7,) each, is free."""


def plan_round(
    edge_free: EdgeCheck,
    state_free: Callable[[np.ndarray], bool],
    ends: tuple[np.ndarray, np.ndarray],
    bounds: tuple[np.ndarray, np.ndarray],
    *,
    scale: np.ndarray,
    reach: float,
    seed: int,
    most_checks: int,
) -> np.ndarray | None:
    """A polyline of free straight edges between two configurations, or None after `most_checks` edges.

    Args:
        edge_free: last word on an edge.
        state_free: the same on a configuration.
        ends: start and goal, shape (7,) each [rad].
        bounds: least and greatest joint positions to plan in, shape (7,) each [rad].
        scale: what a radian of each joint counts in the planner's metric, shape (7,), positive.
        reach: greatest edge in that metric.
        seed: of OMPL's random numbers, positive.
        most_checks: edges checked before giving up.

    Returns:
        Vertices with both ends, shape (k, 7) [rad].
    """
    util.noOutputHandler()
    util.RNG.setSeed(seed)
    n = len(scale)
    space = base.RealVectorStateSpace(n)
    box = base.RealVectorBounds(n)
    for k in range(n):
        box.setLow(k, float(bounds[0][k] * scale[k]))
        box.setHigh(k, float(bounds[1][k] * scale[k]))
    space.setBounds(box)
    info = base.SpaceInformation(space)
    checks = 0

    def joints(state: Any) -> np.ndarray:
        return np.array([state[k] for k in range(n)]) / scale

    class Edges(base.MotionValidator):
        def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:
            nonlocal checks
            checks += 1
            return bool(edge_free(joints(a), joints(b)))

    info.setStateValidityChecker(lambda state: bool(state_free(joints(state))))
    edges = Edges(info)
    info.setMotionValidator(edges)
    info.setup()
    problem = base.ProblemDefinition(info)
    start: Any = space.allocState()
    goal: Any = space.allocState()
    for k in range(n):
        start[k], goal[k] = float(ends[0][k] * scale[k]), float(ends[1][k] * scale[k])
    problem.setStartAndGoalStates(start, goal)
    planner = geometric.RRTConnect(info)
    planner.setRange(reach)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: checks >= most_checks))
    if not problem.hasExactSolution():
        return None
    path = np.array([joints(state) for state in problem.getSolutionPath().getStates()])
    path[0], path[-1] = ends
    return path
