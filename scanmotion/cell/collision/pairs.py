"""Which solids of the robot the planner does not hold against one another, by solid.

Guarantees: a solid that hangs on a link by a side branch is left out of no pair but with what is fixed to
it, and with what it meets in every position of the joints between the two.
"""

from itertools import product

import fcl
import numpy as np

from scanmotion.cell.arm.robot import Body, Robot, arm_poses
from scanmotion.cell.collision.shapes import fcl_object
from scanmotion.cell.model import TOOL, Cell

IGNORED_PAIRS = frozenset({(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (0, 2), (4, 6), (6, 7), (5, 7)})
"""Links that touch by construction, or whose boxes meet where the robot's bodies do not (robots.md 1.5).

The tool turns about A6 before link 5 only, at a distance that its fixture sets. This is for the links that
the joints themselves join, not for what hangs on them.
"""
_TRIES = {1: 24, 2: 9}
"""Angles of a joint that are tried, by the number of joints between two links."""


def ignored(cell: Cell) -> np.ndarray:
    """Whether two of the robot's solids are not held against one another.

    Returns:
        shape (n, n), for those of `cell.bodies` with link <= TOOL, in their order.
    """
    bodies = [b for b in cell.bodies if b.link <= TOOL]
    out = np.zeros((len(bodies), len(bodies)), bool)
    meet: dict[tuple[int, str, int, str], bool] = {}
    for i, a in enumerate(bodies):
        for j, b in enumerate(bodies[:i]):
            first, second = sorted((a, b), key=lambda body: body.link)
            between = min(second.link, 6) - min(first.link, 6)
            if between == 0:
                skip = True
            elif not (a.side or b.side):
                skip = (first.link, second.link) in IGNORED_PAIRS
            elif between in _TRIES:
                key = first.link, first.carrier, second.link, second.carrier
                if key not in meet:
                    meet[key] = _always_meet(cell.robot, *(_of(cell, body) for body in (first, second)))
                skip = meet[key]
            else:
                skip = False
            out[i, j] = out[j, i] = skip
    return out


def on_floor(cell: Cell, body: Body) -> bool:
    """Whether a solid is held against the floor: the base and what A1 turns stand on it by construction."""
    return body.link > 1 or body.side


def _of(cell: Cell, body: Body) -> list[Body]:
    """The solids that the same link of the URDF carries."""
    return [b for b in cell.bodies if (b.link, b.carrier) == (body.link, body.carrier)]


def _always_meet(robot: Robot, low: list[Body], high: list[Body]) -> bool:
    """Whether solids of two links touch in every position that is tried of the joints between them."""
    i, j = low[0].link, min(high[0].link, 6)
    steps = [np.linspace(robot.lower[k], robot.upper[k], _TRIES[j - i]) for k in range(i, j)]
    q = np.zeros((_TRIES[j - i] ** (j - i), 6))
    q[:, i:j] = list(product(*steps))
    poses = arm_poses(robot, q)
    X_ij = np.linalg.inv(poses[:, i]) @ poses[:, j]
    if high[0].link == TOOL:
        X_ij = X_ij @ robot.X_6F
    return all(_meet(low, high, X) for X in X_ij)


def _meet(low: list[Body], high: list[Body], X: np.ndarray) -> bool:
    first, second = [fcl_object(b, b.X_LG) for b in low], [fcl_object(b, X @ b.X_LG) for b in high]
    return any(
        fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()) for a in first for b in second
    )


def ignored_carriers(cell: Cell) -> list[tuple[str, str]]:
    """The same by links of the URDF (empty for the tool), for an engine that judges by bodies."""
    bodies, skip = [b for b in cell.bodies if b.link <= TOOL], ignored(cell)
    kept = {
        frozenset((a.carrier, b.carrier))
        for (i, a), (j, b) in product(enumerate(bodies), repeat=2)
        if i != j and not skip[i, j]
    }
    names = sorted({b.carrier for b in bodies})
    return [(a, b) for n, a in enumerate(names) for b in names[:n] if frozenset((a, b)) not in kept]
