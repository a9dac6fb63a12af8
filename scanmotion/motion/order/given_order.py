"""The order that a user gives: only the configuration of each stop is chosen, in the least seconds.

Guarantees: among all ways of the stops in this order, the total of transit costs and stops is least (Viterbi,
doi 10.1109/TIT.1967.1054010, over the ways of neighbouring stops).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from scanmotion.motion.order.stops import Group
from scanmotion.motion.transit_cost import MoveModel, move_matrix


def given_order(
    groups: Sequence[Group], ids: Sequence[str], model: MoveModel, start_q: np.ndarray
) -> tuple[list[int], list[int]]:
    """Indices of the groups in the order of `ids`, and the way of each in that order.

    Args:
        groups: stops with their ways.
        ids: ids of the viewpoints as they are to be visited; a sweep stands where its first viewpoint does.
        model: costs of transits.
        start_q: where the programme stands, shape (7,) [rad].
    """
    place = {id_: i for i, id_ in enumerate(ids)}
    order = sorted(range(len(groups)), key=lambda g: min(place[v] for v in groups[g].viewpoints))
    if not order:
        return [], []
    cost = move_matrix(model, start_q, groups[order[0]].enter)[0] + groups[order[0]].seconds
    best: list[np.ndarray] = []
    for before, after in pairwise(order):
        total = cost[:, None] + move_matrix(model, groups[before].leave, groups[after].enter)
        best.append(total.argmin(axis=0))
        cost = total.min(axis=0) + groups[after].seconds
    ways = [int(cost.argmin())]
    for come_from in reversed(best):
        ways.append(int(come_from[ways[-1]]))
    return order, ways[::-1]
