"""Neighbours but one, by tables over the joints between them: covering spheres are too thick to tell there.

Base and link 2, link 4 and link 6, link 5 and the tool come as near to one another as the spheres' excess.
Where they are depends on one or two joints alone. The square of all angles is cut into four, again and again,
until a cell is free as a whole or `CELLS` of them make a turn. Guarantee: in a free cell the solids keep the
clearance, for what the middle has to spare is more than the way of any point inside the cell; a blocked cell
may be free in truth. A table's value is how far the nearest blocked cell is, in the measure of way by which
edges are walked, so that no edge steps over one.
"""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import fcl
import numpy as np
from scipy.ndimage import distance_transform_edt

from scanmotion.cell.arm.robot import Body, Robot
from scanmotion.cell.collision.pairs import poses_between, solid_key
from scanmotion.cell.collision.shapes import box_of, fcl_object
from scanmotion.cell.model import TOOL, Cell
from scanmotion.geometry.jit import njit

CELLS = 256
"""Cells to a turn of a joint at the finest."""
_COARSEST = 8
_STOP = 64
"""From so many cells on, a cell whose middle touches is blocked as a whole."""
_WRAP = CELLS // 4
FREE_M = 1e3
"""Value of a table without blocked cells, where nothing needs to be looked up."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NearTables:
    """What the kernels look up."""

    values: np.ndarray
    """How far the nearest blocked cell is [m], -1 in one; shape (k, CELLS, CELLS), of k pairs of links."""
    joints: np.ndarray
    """The two joints of each, twice the same where one joint is between, shape (k, 2)."""


def near_tables(
    cell: Cell, pairs: list[tuple[Body, Body]], clearance: float, reach: np.ndarray
) -> NearTables:
    """Tables for pairs of solids, one for all pairs of the same two links.

    Args:
        cell: the cell.
        pairs: the solids that are held against one another, the first nearer to the base.
        clearance: that they shall keep [m].
        reach: greatest distance of a moving point from each joint's axis, shape (7,) [m].
    """
    values, joints = [], []
    for links in sorted({(a.link, b.link) for a, b in pairs}):
        own = [(a, b) for a, b in pairs if (a.link, b.link) == links]
        blocked = _known(cell.robot, own, clearance)
        if not blocked.any():
            continue
        i, j = links[0], min(links[1], 6)
        values.append(_ways(blocked, reach[i], reach[j - 1], one=j - i == 1))
        joints.append((i, j - 1))
    return NearTables(
        values=np.array(values, np.float32).reshape(-1, CELLS, CELLS),
        joints=np.array(joints, np.int64).reshape(-1, 2),
    )


_KNOWN: WeakKeyDictionary[Robot, dict[tuple, np.ndarray]] = WeakKeyDictionary()


def _known(robot: Robot, pairs: list[tuple[Body, Body]], clearance: float) -> np.ndarray:
    """`_blocked`, worked out once for an arm and its tool."""
    known = _KNOWN.setdefault(robot, {})
    key = clearance, *((solid_key(a), solid_key(b)) for a, b in pairs)
    if key not in known:
        known[key] = _blocked(robot, pairs, clearance)
    return known[key]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Pair:
    """Two solids, and by how much one moves past the other when the joints turn."""

    low: Body
    high: Body
    first: fcl.CollisionObject
    second: fcl.CollisionObject
    balls: float
    """Sum of the radii of the spheres that hold them [m]."""
    levers: tuple[float, float]
    """Greatest distance that counts from the axis of the one joint and of the other [m]."""


def _pair(robot: Robot, low: Body, high: Body, clearance: float) -> _Pair:
    i, j = low.link, min(high.link, 6)
    X = robot.X_6F @ high.X_LG if high.link == TOOL else high.X_LG
    ball_low, ball_high = float(np.linalg.norm(box_of(low))), float(np.linalg.norm(box_of(high)))
    last = _off_axis(robot.axes[j - 1], X[:3, 3]) + ball_high
    # A point that comes near is no farther from an axis than the other solid's farthest, and the clearance.
    p = np.linalg.inv(robot.X_PJ[i])[:3] @ np.append(low.X_LG[:3, 3], 1.0)
    near = _off_axis(robot.axes[i], p) + ball_low + clearance
    if j - i == 1:
        levers = (0.0, min(last, near))
    else:
        step = float(np.linalg.norm(robot.X_PJ[j - 1, :3, 3]))
        ahead = step + float(np.linalg.norm(X[:3, 3])) + ball_high
        levers = (min(ahead, near), min(last, float(np.linalg.norm(p)) + ball_low + clearance + step))
    return _Pair(
        low=low, high=high, first=fcl_object(low, low.X_LG), second=fcl_object(high, np.eye(4)),
        balls=ball_low + ball_high, levers=levers,
    )  # fmt: skip


def _off_axis(axis: np.ndarray, p: np.ndarray) -> float:
    """Distance of a point (3,) from an axis through the origin [m]."""
    return float(np.linalg.norm(p - (p @ axis) * axis))


def _blocked(robot: Robot, pairs: list[tuple[Body, Body]], clearance: float) -> np.ndarray:
    """Cells in which a pair may come nearer than the clearance, (CELLS, CELLS); outside the limits none."""
    made = [_pair(robot, a, b, clearance) for a, b in pairs]
    i, j = pairs[0][0].link, min(pairs[0][1].link, 6)
    one = j - i == 1
    blocked = np.zeros((CELLS, CELLS), bool)
    count = _COARSEST
    cells = [(a, b) for a in range(count) for b in ([0] if one else range(count))]
    todo = np.array([(*c, p) for c in cells for p in range(len(made))], dtype=np.int64).reshape(-1, 3)
    while len(todo):
        half = np.pi / count
        todo = todo[_inside(robot, i, todo[:, 0], half) & (one | _inside(robot, j - 1, todo[:, 1], half))]
        open_, touch = _open(robot, made, todo, half, clearance, one=one)
        size = CELLS // count
        done = np.full(len(todo), count == CELLS) if count < _STOP else touch | (count == CELLS)
        for a, b, _ in todo[open_ & done]:
            rows = slice(a * size, (a + 1) * size)
            blocked[rows, slice(None) if one else slice(b * size, (b + 1) * size)] = True
        left = todo[open_ & ~done]
        parts = [(da, db) for da in (0, 1) for db in ((0,) if one else (0, 1))]
        scale = np.array([2, 1 if one else 2, 1])
        todo = np.concatenate([left * scale + [da, db, 0] for da, db in parts]) if len(left) else left
        count *= 2
    return blocked


def _inside(robot: Robot, joint: int, index: np.ndarray, half: float) -> np.ndarray:
    """Whether cells of a joint, half a cell wide, are met anywhere inside its limits."""
    middle = -np.pi + (2 * index + 1) * half
    turns = 2 * np.pi * np.ceil((robot.lower[joint] - half - middle) / (2 * np.pi))
    return middle + turns - half <= robot.upper[joint]


def _open(
    robot: Robot, made: list[_Pair], todo: np.ndarray, half: float, clearance: float, *, one: bool
) -> tuple[np.ndarray, np.ndarray]:
    """For cells and pairs (n, 3): whether the pair may come too near there, and touches in the middle."""
    open_, touch = np.zeros(len(todo), bool), np.zeros(len(todo), bool)
    for p, pair in enumerate(made):
        rows = np.flatnonzero(todo[:, 2] == p)
        if len(rows) == 0:
            continue
        i, j = pair.low.link, min(pair.high.link, 6)
        q = np.zeros((len(rows), 6))
        q[:, i] = -np.pi + (2 * todo[rows, 0] + 1) * half
        if not one:
            q[:, j - 1] = -np.pi + (2 * todo[rows, 1] + 1) * half
        X = poses_between(robot, pair.low, pair.high, q)
        needed = clearance + half * sum(pair.levers)
        apart = np.linalg.norm(X[:, :3, 3] - pair.low.X_LG[:3, 3], axis=1) - pair.balls
        for n in np.flatnonzero(apart < needed):
            R, t = np.ascontiguousarray(X[n, :3, :3]), np.ascontiguousarray(X[n, :3, 3])
            pair.second.setTransform(fcl.Transform(R, t))
            hit = fcl.collide(pair.first, pair.second, fcl.CollisionRequest(), fcl.CollisionResult())
            touch[rows[n]] = bool(hit)
            open_[rows[n]] = bool(hit) or (
                fcl.distance(pair.first, pair.second, fcl.DistanceRequest(), fcl.DistanceResult()) < needed
            )
    return open_, touch


def _ways(blocked: np.ndarray, first: float, second: float, *, one: bool) -> np.ndarray:
    """For each cell how far the nearest blocked one is in the measure of way [m]; -1 in a blocked one."""
    steps = 2 * np.pi / CELLS * np.array([first, second])
    if one:
        line = np.pad(blocked[:, 0], _WRAP, mode="wrap")
        way = np.asarray(distance_transform_edt(~line, sampling=steps[1]))[_WRAP:-_WRAP, None]
        way = np.tile(np.minimum(way, _WRAP * steps[1]) - steps[1], (1, CELLS))
    else:
        square = np.pad(blocked, _WRAP, mode="wrap")
        way = np.asarray(distance_transform_edt(~square, sampling=steps))[_WRAP:-_WRAP, _WRAP:-_WRAP]
        way = np.minimum(way, _WRAP * steps.min()) - np.linalg.norm(steps)
    return np.where(blocked, -1.0, np.maximum(way, 0.0)).astype(np.float32)


@njit(cache=True)
def way_to_blocked(q, values, joints, enough):
    """Least value of the tables at a configuration (7,), at most `enough` [m]."""
    best = enough
    for k in range(len(values)):
        a = int(np.floor((q[joints[k, 0]] / (2 * np.pi) + 0.5) % 1.0 * CELLS)) % CELLS
        b = int(np.floor((q[joints[k, 1]] / (2 * np.pi) + 0.5) % 1.0 * CELLS)) % CELLS
        best = min(best, values[k, a, b])
    return best
