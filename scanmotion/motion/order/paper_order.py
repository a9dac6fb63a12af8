"""The paper's order: a genetic algorithm on Euclidean distance, the turntable for what the arm cannot reach.

Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139), section 4: for comparison in one cell.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from scanmotion.cell.arm.robot import clean_angle
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.order.salesman.tsp import TourOptions, tour_from_cost
from scanmotion.motion.order.stops import Group

_FIXED_RAD = 1e-6
"""How far from zero the table may stand to count as not turned [rad]."""


def paper_order(
    groups: Sequence[Group],
    viewpoints: Mapping[str, Viewpoint],
    start_p_OS: np.ndarray,
    start_q: np.ndarray,
    rng: np.random.Generator,
    options: TourOptions,
) -> tuple[list[int], list[int]]:
    """The order over the groups and the way of each in that order.

    The order of each step is the shortest open way over the viewpoints' positions relative to the part, from
    where the step before ended. The table stays at angle zero; a viewpoint that has no configuration there
    gets the one that turns the table least. The first of the ways that are left is taken.

    Args:
        groups: stops with their ways.
        viewpoints: by id.
        start_p_OS: scanner's place at the start, relative to the part, shape (3,) [m].
        start_q: shape (7,) [rad].
        rng: source of the random numbers.
        options: how hard to search.
    """
    order: list[int] = []
    at = np.asarray(start_p_OS, dtype=float)
    for stage in (0, 1):
        members = [g for g, group in enumerate(groups) if group.stage == stage]
        if not members:
            continue
        places = [np.mean([viewpoints[v].p_OS for v in groups[g].viewpoints], axis=0) for g in members]
        points = np.array([at, *places])
        distances = np.linalg.norm(points[:, None] - points[None], axis=2)
        tour = tour_from_cost(distances, start=0, rng=rng, options=options)
        order += [members[n - 1] for n in tour.order[1:]]
        at = points[tour.order[-1]]
    ways, table = [], float(start_q[6])
    for g in order:
        way = _least_turned(groups[g], table)
        ways.append(way)
        table = float(groups[g].leave.q[way, 6])
    return order, ways


def _least_turned(group: Group, table: float) -> int:
    """The way that the paper's cell takes; a revolution turns on from where the table stands."""
    if group.kind == "revolution":
        return int(np.abs(group.enter.q[:, 6] - table).argmin())
    forward = ~group.backward if len(group.backward) else np.ones(len(group), dtype=bool)
    angle = group.enter.q[:, 6]
    turned = np.abs(clean_angle(angle))
    turned = np.where(forward, np.where(turned <= _FIXED_RAD, 0.0, turned), np.inf)
    # After a revolution zero is where the table stands: it is not turned back.
    way = np.round(np.abs(angle - table), 9)
    return int(np.lexsort((np.arange(len(angle)), way, turned))[0])
