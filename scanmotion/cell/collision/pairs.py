"""Which solids of the robot the planner does not hold against one another, solid by solid, with the reason.

Guarantee: left out are only solids that are fixed to one another, those of two links that a joint joins, and
those that touch in nearly all positions of the joints between them, inside the maker's limits, or pass one
another nearer than the clearance in nearly all of them and touch in none: no motion could mend that. The
convex pieces of a link's meshes count as one solid there. Everything else is kept apart.
"""

from dataclasses import dataclass
from itertools import combinations, product
from weakref import WeakKeyDictionary

import fcl
import numpy as np

from scanmotion.cell.arm.robot import Body, Robot, arm_poses
from scanmotion.cell.collision.shapes import box_of, fcl_object
from scanmotion.cell.model import TOOL, Cell
from scanmotion.core.support.streams import fixed_stream

NEARLY_ALWAYS = 0.95
"""Share of positions from which on a pair counts as meeting by construction.

The default of MoveIt's Setup Assistant for pairs that are "always" in collision.
"""
GUIDED_M = 1e-3
"""What neighbours but one keep: the joints between guide them past one another, often at a few mm [m]."""
_GUIDED = frozenset({(0, 2), (4, 6), (5, TOOL)})
_TRIES = {1: 24, 2: 14}
"""Angles of each joint that are tried, by the number of joints between two links; more keep them apart."""
_FIXED, _JOINED = "fixed to one another", "joined by a joint"


@dataclass(frozen=True, eq=False, kw_only=True)
class Exempt:
    """Two of the robot's solids that are not held against one another."""

    a: Body
    b: Body
    reason: str
    meets: bool
    """Whether they are left out for where they are, not for how they are joined."""


def exempt_pairs(cell: Cell) -> tuple[Exempt, ...]:
    """The pairs that are left out, each with its reason, in the order of `cell.bodies`."""
    bodies = [b for b in cell.bodies if b.link <= TOOL]
    out = []
    for a, b in combinations(bodies, 2):
        low, high = sorted((a, b), key=lambda body: body.link)
        reason = _reason(cell, low, high)
        if reason:
            out.append(Exempt(a=a, b=b, reason=reason, meets=reason not in (_FIXED, _JOINED)))
    return tuple(out)


def ignored(cell: Cell) -> np.ndarray:
    """Whether two of the robot's solids are not held against one another.

    Returns:
        shape (n, n), for those of `cell.bodies` with link <= TOOL, in their order.
    """
    bodies = [b for b in cell.bodies if b.link <= TOOL]
    of = {id(b): n for n, b in enumerate(bodies)}
    out = np.eye(len(bodies), dtype=bool)
    for pair in exempt_pairs(cell):
        i, j = of[id(pair.a)], of[id(pair.b)]
        out[i, j] = out[j, i] = True
    return out


def guided(low: Body, high: Body) -> bool:
    """Whether two solids, the second farther from the base, are neighbours but one that joints guide."""
    return (low.link, high.link) in _GUIDED and not (low.side or high.side)


def asked_of(cell: Cell, low: Body, high: Body) -> float:
    """The clearance that two of the robot's solids keep [m]."""
    own = cell.settings.process.self_clearance_m
    return min(own, GUIDED_M) if guided(low, high) else own


def guided_names(cell: Cell) -> frozenset[frozenset[str]]:
    """Pairs of links, or of a link and a solid of the tool, of which all solids are guided."""
    robot = [b for b in cell.bodies if b.link <= TOOL]
    kept: dict[frozenset[str], bool] = {}
    for a, b in combinations(robot, 2):
        low, high = sorted((a, b), key=lambda body: body.link)
        for name in (high.carrier,) if high.carrier else (high.name, "tool"):
            key = frozenset((low.carrier, name))
            kept[key] = kept.get(key, True) and guided(low, high)
    return frozenset(key for key, all_guided in kept.items() if all_guided)


def on_floor(cell: Cell, body: Body) -> bool:
    """Whether a solid is held against the floor: the base and what A1 turns stand on it by construction."""
    return body.link > 1 or body.side


def _reason(cell: Cell, low: Body, high: Body) -> str:
    """Why two solids are left out; "" where they are held against one another."""
    between = min(high.link, 6) - min(low.link, 6)
    if between == 0:
        return _FIXED
    if frozenset((low.carrier, high.carrier)) in cell.robot.joined:
        return _JOINED
    if between not in _TRIES:
        return ""
    asked = asked_of(cell, low, high)
    share = _share_near(cell.robot, _whole(cell, low), _whole(cell, high), asked)
    if share < NEARLY_ALWAYS:
        return ""
    return f"they meet in {share:.0%} of the positions of the joints between them"


_KNOWN: WeakKeyDictionary[Robot, dict[tuple, float]] = WeakKeyDictionary()
"""Shares that were measured already: an arm stands in many layouts."""


def solid_key(body: Body) -> tuple:
    """What a solid is and where, for finding it again."""
    points = b"" if body.points is None else body.points.tobytes()
    return body.link, body.shape, body.size, body.X_LG.tobytes(), points


def _whole(cell: Cell, body: Body) -> list[Body]:
    """All pieces of the meshes of a solid's link, or the solid alone."""
    if body.shape != "hull":
        return [body]
    return [
        b
        for b in cell.bodies
        if b.shape == "hull" and (b.link, b.carrier, b.mesh) == (body.link, body.carrier, body.mesh)
    ]


def _share_near(robot: Robot, low: list[Body], high: list[Body], clearance: float) -> float:
    """Share of positions in which two solids, each in pieces, are nearer than a clearance.

    It is exact from `NEARLY_ALWAYS` on; below, counting stops when that cannot be reached any more.
    """
    known = _KNOWN.setdefault(robot, {})
    key = tuple(map(solid_key, low)), tuple(map(solid_key, high)), clearance
    if key not in known:
        known[key] = _counted(robot, low, high, clearance)
    return known[key]


def _counted(robot: Robot, low: list[Body], high: list[Body], clearance: float) -> float:
    tries = _TRIES[min(high[0].link, 6) - low[0].link]
    count = tries ** (min(high[0].link, 6) - low[0].link)
    order = fixed_stream("pairs").permutation(count)
    pairs = []
    for a, b in product(low, high):
        X = positions_between(robot, a, b, tries)[order]
        apart = np.linalg.norm(X[:, :3, 3] - a.X_LG[:3, 3], axis=1)
        close = apart <= np.linalg.norm(box_of(a)) + np.linalg.norm(box_of(b)) + clearance
        pairs.append((X, close, fcl_object(a, a.X_LG), fcl_object(b, np.eye(4))))
    misses, apart, most = 0, 0, (1 - NEARLY_ALWAYS) * count
    for n in range(count):
        met = touched = False
        for k, (X, close, first, second) in enumerate(pairs):
            if not (close[n] and solids_near(first, second, X[n], clearance)):
                continue
            met = True
            touched = touched or solids_near(first, second, X[n], min(clearance, GUIDED_M))
            if touched:
                # What touches once touches again soon: it is asked first from now on.
                pairs.insert(0, pairs.pop(k))
                break
        misses += not met
        apart += not touched
        # What is always too near must touch always or never: else there are positions to keep off.
        if misses > most or most < apart < n + 1:
            return 0.0
    return 1.0 - misses / count


def positions_between(robot: Robot, low: Body, high: Body, tries: int) -> np.ndarray:
    """Poses of a solid in the link of another, over the joints between them, shape (n, 4, 4).

    Args:
        robot: the arm.
        low: the solid nearer to the base.
        high: the other one, one or two joints on.
        tries: angles of each joint, at the middles of equal parts of its range.
    """
    i, j = low.link, min(high.link, 6)
    share = (np.arange(tries) + 0.5) / tries
    angles = [robot.lower[k] + share * (robot.upper[k] - robot.lower[k]) for k in range(i, j)]
    q = np.zeros((tries ** (j - i), 6))
    q[:, i:j] = np.stack(np.meshgrid(*angles, indexing="ij"), axis=-1).reshape(-1, j - i)
    return poses_between(robot, low, high, q)


def poses_between(robot: Robot, low: Body, high: Body, q: np.ndarray) -> np.ndarray:
    """Poses of a solid in the link of another at configurations (n, 6), shape (n, 4, 4)."""
    poses = arm_poses(robot, q)
    X = np.linalg.inv(poses[:, low.link]) @ poses[:, min(high.link, 6)]
    if high.link == TOOL:
        X = X @ robot.X_6F
    return X @ high.X_LG


def solids_near(
    first: fcl.CollisionObject, second: fcl.CollisionObject, X: np.ndarray, clearance: float
) -> bool:
    """Whether the second object, put at X, is nearer to the first than a clearance."""
    second.setTransform(fcl.Transform(np.ascontiguousarray(X[:3, :3]), np.ascontiguousarray(X[:3, 3])))
    if fcl.collide(first, second, fcl.CollisionRequest(), fcl.CollisionResult()):
        return True
    return bool(fcl.distance(first, second, fcl.DistanceRequest(), fcl.DistanceResult()) < clearance)
