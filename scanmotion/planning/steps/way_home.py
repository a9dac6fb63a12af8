"""The end of a cycle: from the last operation back to where the programme starts, arm and table.

Guarantees: the way is planned and timed as every transit is, and ends at rest at home, so that the next
programme begins where this one ends. The scan's seconds, its budget and its lower bound do not count it.
"""

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.core.errors import PathError
from scanmotion.core.tour import Path, Stop, Tour
from scanmotion.core.trajectory import Trajectory
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit.plan import transit

_AT_HOME = 1e-6


def way_home(
    cell: Cell, clearance: Clearance, q: np.ndarray, *, rng: np.random.Generator
) -> tuple[Trajectory | None, str]:
    """A transit from q to the cell's home, and why there is none where there is none.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: its collision checker.
        q: where the scan ends, at rest, shape (7,) [rad].
        rng: source of the planner's random numbers.
    """
    home = np.asarray(cell.home, float)
    if np.abs(home - q).max() < _AT_HOME:
        return None, ""
    try:
        path = transit(cell, clearance, np.asarray(q, float), home, rng=rng)
    except PathError as error:
        return None, f"no collision-free way home: {error}"
    return transit_alone(cell, path), ""


def transit_alone(cell: Cell, path: Path, viewpoints: tuple[str, ...] = ()) -> Trajectory:
    """A checked path by itself as a timed trajectory of one transit.

    Args:
        cell: limits of the axes, speeds of the process.
        path: where it goes.
        viewpoints: the ids that it leads to.
    """
    # Timing takes a tour of stops; what it dwells at the end is cut off again.
    stop = Stop(viewpoints=viewpoints, kind="dwell", q_in=path.q[-1], q_out=path.q[-1])
    tour = Tour(start_q=path.q[0], stops=(stop,), seconds=path.seconds, floor=0.0)
    timed = time_plan(cell, tour, [path])
    kept = timed.operation == 0
    return Trajectory(
        t=timed.t[kept], q=timed.q[kept], qd=timed.qd[kept], qdd=timed.qdd[kept],
        operation=timed.operation[kept], operations=timed.operations[:1],
    )  # fmt: skip
