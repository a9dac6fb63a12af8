"""The search for a continuous motion: waypoints of the arm and how long it stays, while the table turns on.

A motion is a list of nodes, scanner poses in W that are clear of the part however the table stands, with a
dwell at each. The scanner captures all the time, on the ways too. Simulated annealing lowers

    seconds + price * (share not seen, part of it for what is seen in fewer than two of the frames 0.25 s apart)

over the nodes, their dwells, their order, and where the table turns back. It ends by work done. Frames at a
node come from masks made before, frames on a way from the tables of `sensing.sight`.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.geometry.jit import njit
from scanmotion.motion.continuous.table_travel import MOST_PIECES, angle_at, pieces_of
from scanmotion.sensing.sight import Sight, frame_mask, masks_of, turned_pose

STEP_S = 0.25
"""Time between the frames that are looked at [s]."""
BINS = 24
"""Table angles at which frames are looked at; at full speed the table turns by one in STEP_S."""
MOST = 40
"""Most nodes of a motion."""
_EASE_S = 0.15
"""The arm's ramps keep it about so long near both ends of a way [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Nodes:
    """Where the arm may stand or pass: node 0 is where the programme begins."""

    q: np.ndarray
    """Arm configurations, shape (n, 6) [rad]."""
    Y: np.ndarray
    """Scanner in O with the table at zero, shape (n, 4, 4)."""
    quaternion: np.ndarray
    """Orientation of each, scalar last, shape (n, 4)."""
    seconds: np.ndarray
    """Time of the way from one to another, rest to rest, infinite where there is none, shape (n, n) [s]."""
    near: np.ndarray
    """Nodes in the order of their nearness to each, shape (n, k)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TableDrive:
    """What the table may do."""

    speed: float
    """Greatest [rad/s]."""
    ramp: float
    """Time to reach it [s]."""
    start: float
    """Where it stands [rad]."""
    low: float
    high: float
    """Its range [rad]; infinite where endless."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Weighing:
    """What is weighed against the seconds."""

    price: float
    """Seconds that the whole surface is worth [s]."""
    twice: float
    """Share of it that is paid only where a place is seen in two frames at least."""
    longest: float
    """Motions that take longer are dear [s]."""
    total: int
    """How many places stand for the whole surface; those not in the masks are taken as seen."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Choice:
    """A motion that was found."""

    nodes: np.ndarray
    """In order, beginning with node 0, shape (k,)."""
    dwell: np.ndarray
    """How long the arm stays at each, shape (k,) [s]."""
    sense: float
    """Sense in which the table sets out, +1 or -1."""
    first: float
    """After how far it turns back for the first time [rad]."""
    seconds: float
    """Expected duration [s]."""
    missed: int
    """Places not seen."""
    missed_twice: int
    """Places seen in fewer than two frames."""
    cost: float


def turn_masks(sight: Sight, nodes: Nodes, *, angles: int = 12) -> np.ndarray:
    """What each node sees in a whole turn of the table, shape (n, w) uint64."""
    at = 2 * np.pi * np.arange(angles) / angles
    out = np.zeros((len(nodes.Y), sight.words), np.uint64)
    for first in range(0, len(nodes.Y), 256):
        own = slice(first, first + 256)
        seen = masks_of(sight, nodes.Y[own], at)
        out[own] = np.bitwise_or.reduce(seen, axis=1)
    return out


def annealed(
    nodes: Nodes,
    sight: Sight,
    turns: np.ndarray,
    drive: TableDrive,
    weighing: Weighing,
    *,
    begin: Choice | None,
    evaluations: int,
    hot: float = 4.0,
    cold: float = 0.05,
    seed: int,
) -> Choice:
    """Improves a motion; the least costly one that was met.

    Args:
        nodes: where the arm may be.
        sight: of the places that count.
        turns: from `turn_masks`.
        drive: the table.
        weighing: seconds against what is seen.
        begin: a motion to begin with; None for the greedy one.
        evaluations: motions that are looked at.
        hot, cold: first and last temperature [s].
        seed: of the random numbers.
    """
    table = _table_of(drive)
    weights = np.array([weighing.price / weighing.total, weighing.twice, weighing.longest])
    seq, dwell = np.zeros(MOST, np.int64), np.zeros(MOST, np.int64)
    sense, first = 1.0, min(table[3], table[4])
    if begin is None:
        chosen = _greedy(turns, nodes.seconds, weights, 1.0 / STEP_S)
        count = len(chosen)
        seq[:count] = chosen
        dwell[1:count] = int(round(2 * np.pi / drive.speed / STEP_S))
    else:
        count = len(begin.nodes)
        seq[:count] = begin.nodes
        dwell[:count] = np.round(begin.dwell / STEP_S)
        sense, first = begin.sense, begin.first
    arrays = (
        nodes.Y, nodes.quaternion, nodes.seconds, nodes.near,
        sight.points, sight.normals, sight.open, sight.cells, sight.field,
    )  # fmt: skip
    count, sense, first, result = _anneal(
        seq, dwell, count, sense, first, arrays, turns, table, weights, evaluations, hot, cold, seed
    )
    return Choice(
        nodes=seq[:count].copy(), dwell=dwell[:count] * STEP_S, sense=sense, first=first,
        seconds=result[1], missed=int(result[2]), missed_twice=int(result[3]), cost=result[0],
    )  # fmt: skip


def _table_of(drive: TableDrive) -> np.ndarray:
    """speed, ramp, start, room upward, room downward."""
    up = min(drive.high - drive.start, 1e3)
    down = min(drive.start - drive.low, 1e3)
    return np.array([drive.speed, drive.ramp, drive.start, up, down])


@njit(cache=True)
def _popcount(x):
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True)
def _greedy(turns, seconds, weights, rate):
    """Whole turns, the most worth for its seconds first, as long as one is worth its seconds."""
    n, words = turns.shape
    seen = np.zeros(words, np.uint64)
    chosen = [0]
    while len(chosen) < 12:
        best, gain_best = -1, 0.0
        for i in range(1, n):
            gain = 0
            for w in range(words):
                gain += _popcount(turns[i, w] & ~seen[w])
            worth = gain * weights[0] - 6.0 - min(seconds[chosen[-1], i], 30.0)
            if seconds[chosen[-1], i] < 1e3 and worth > gain_best:
                best, gain_best = i, worth
        if best < 0:
            break
        chosen.append(best)
        for w in range(words):
            seen[w] |= turns[best, w]
    return np.array(chosen)


@njit(cache=True)
def _between(Ya, Yb, qa, qb, f, out):
    """Writes the pose a share f of the way from one pose to another: straight, turning evenly."""
    d = 0.0
    for k in range(4):
        d += qa[k] * qb[k]
    sign = 1.0 if d >= 0.0 else -1.0
    angle = np.arccos(min(abs(d), 1.0))
    if angle > 1e-4:
        a, b = np.sin((1.0 - f) * angle) / np.sin(angle), sign * np.sin(f * angle) / np.sin(angle)
    else:
        a, b = 1.0 - f, sign * f
    x, y, z, w = (
        a * qa[0] + b * qb[0], a * qa[1] + b * qb[1], a * qa[2] + b * qb[2], a * qa[3] + b * qb[3],
    )  # fmt: skip
    n = np.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / n, y / n, z / n, w / n
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    for k in range(3):
        out[k, 3] = (1.0 - f) * Ya[k, 3] + f * Yb[k, 3]


@njit(cache=True)
def _cost(seq, dwell, count, sense, first, arrays, table, weights, work, memo, store, bound):
    """Cost, seconds, places missed and places not seen twice of one motion; not looked at beyond `bound`."""
    Y, quat, seconds, near, points, normals, opened, cells, field = arrays
    once, twice, seen_near, pieces, Z, X = work
    words = len(once)
    total = 0.0
    for i in range(count):
        total += dwell[i] * STEP_S
        if i + 1 < count:
            s = seconds[seq[i], seq[i + 1]]
            if s > 1e3:
                return 1e9, 0.0, 0.0, 0.0
            total += s
    late = 50.0 * max(total - weights[2], 0.0)
    if total + late > bound:
        return 1e9, 0.0, 0.0, 0.0
    speed, ramp, start = table[0], table[1], table[2]
    ahead, back = (table[3], table[4]) if sense > 0 else (table[4], table[3])
    held = min(first, ahead)
    number = pieces_of(total, held, held + back, ahead + back, speed, ramp, pieces)
    if number == MOST_PIECES:
        return 1e9, 0.0, 0.0, 0.0
    once[:] = 0
    twice[:] = 0
    step = 2.0 * np.pi / BINS
    t, frame = 0.0, 0
    for i in range(count):
        a, b = seq[i], seq[i]
        until = t + dwell[i] * STEP_S
        for part in range(2):
            if part == 1:
                if i + 1 == count:
                    break
                b = seq[i + 1]
                until = t + seconds[a, b]
            takes = until - t
            while frame * STEP_S <= until + 1e-9:
                h = frame * STEP_S
                g = 0
                if part == 1:
                    f = min(max((h - t - _EASE_S) / max(takes - 2 * _EASE_S, 1e-3), 0.0), 1.0)
                    g = int(np.round(f * 15))
                angle = angle_at(h, pieces, number, sense, speed, ramp, start)
                # Frames are rounded in place and angle, so that those made before serve again.
                k = int(np.round(angle / step)) % BINS
                key = ((a * len(Y) + b) * 16 + g) * BINS + k
                if key in memo:
                    row = memo[key]
                else:
                    row = np.int64(len(memo))
                    if row >= len(store):
                        memo.clear()
                        row = np.int64(0)
                    _between(Y[a], Y[b], quat[a], quat[b], g / 15.0, Z)
                    turned_pose(Z, k * step, X)
                    frame_mask(X, points, normals, opened, cells, field, seen_near, store[row])
                    memo[key] = row
                m = store[row]
                for w in range(words):
                    twice[w] |= once[w] & m[w]
                    once[w] |= m[w]
                frame += 1
            t = until
    seen, again = 0, 0
    for w in range(words):
        seen += _popcount(once[w])
        again += _popcount(twice[w])
    missed, missed_twice = points.shape[1] - float(seen), points.shape[1] - float(again)
    cost = total + late + weights[0] * ((1.0 - weights[1]) * missed + weights[1] * missed_twice)
    return cost, total, missed, missed_twice


@njit(cache=True)
def _wanted(turns, open_):
    """A node whose whole turn sees much of what is open: the best of some drawn at random."""
    best, gain_best = 0, 0
    for _ in range(60):
        i = np.random.randint(1, len(turns))
        gain = 0
        for w in range(len(open_)):
            gain += _popcount(turns[i, w] & open_[w])
        if gain > gain_best:
            best, gain_best = i, gain
    return best


@njit(cache=True)
def _moved(seq, dwell, count, near, n, wanted):
    """One random change in place: the new number of nodes, or 0 where nothing can be changed.

    Where a node is `wanted`, it is put in or takes the place of another; 0 is none.
    """
    kind = np.random.randint(0, 100)
    if wanted > 0:
        if count > 1 and (kind < 40 or count == MOST):
            seq[np.random.randint(1, count)] = wanted
        else:
            i = np.random.randint(1, count + 1)
            for k in range(count, i, -1):
                seq[k], dwell[k] = seq[k - 1], dwell[k - 1]
            seq[i], dwell[i] = wanted, np.random.randint(0, 24)
            count += 1
    elif kind < 18 and count > 1:
        i = np.random.randint(1, count)
        seq[i] = near[seq[i], np.random.randint(0, near.shape[1])]
    elif kind < 26 and count > 1:
        seq[np.random.randint(1, count)] = np.random.randint(1, n)
    elif kind < 50 and count > 1:
        i = np.random.randint(0, count)
        dwell[i] = max(dwell[i] + np.random.randint(1, 9) * (1 if np.random.random() < 0.4 else -1), 0)
    elif kind < 64 and count < MOST:
        i = np.random.randint(1, count + 1)
        for k in range(count, i, -1):
            seq[k], dwell[k] = seq[k - 1], dwell[k - 1]
        beside = seq[i - 1] if np.random.random() < 0.7 else seq[min(i, count - 1)]
        new = near[beside, np.random.randint(0, near.shape[1])]
        seq[i] = new if np.random.random() < 0.7 else np.random.randint(1, n)
        dwell[i] = np.random.randint(0, 30)
        count += 1
    elif kind < 76 and count > 2:
        i = np.random.randint(1, count)
        for k in range(i, count - 1):
            seq[k], dwell[k] = seq[k + 1], dwell[k + 1]
        count -= 1
    elif kind < 84 and count > 2:
        i, j = np.random.randint(1, count), np.random.randint(1, count)
        seq[i], seq[j] = seq[j], seq[i]
        dwell[i], dwell[j] = dwell[j], dwell[i]
    elif kind < 92 and count > 3:
        i, j = np.random.randint(1, count), np.random.randint(1, count)
        i, j = min(i, j), max(i, j)
        while i < j:
            seq[i], seq[j] = seq[j], seq[i]
            dwell[i], dwell[j] = dwell[j], dwell[i]
            i += 1
            j -= 1
    elif count > 2:
        i, j = np.random.randint(1, count), np.random.randint(1, count)
        d = min(np.random.randint(1, 12), dwell[i])
        dwell[i] -= d
        dwell[j] += d
    for i in range(1, count):
        if seq[i] == 0 or seq[i] == seq[i - 1]:
            return 0
    return count


@njit(cache=True)
def _anneal(seq, dwell, count, sense, first, arrays, turns, table, weights, evaluations, hot, cold, seed):
    np.random.seed(seed)
    near = arrays[3]
    n, words = len(near), (arrays[4].shape[1] + 63) // 64
    work = (
        np.zeros(words, np.uint64), np.zeros(words, np.uint64), np.zeros(arrays[4].shape[1], np.bool_),
        np.zeros((MOST_PIECES, 3)), np.eye(4), np.eye(4),
    )  # fmt: skip
    memo = {np.int64(-1): np.int64(0)}
    store = np.zeros((60000, words), np.uint64)
    now = _cost(seq, dwell, count, sense, first, arrays, table, weights, work, memo, store, 1e9)
    open_ = ~work[0]
    best, best_seq, best_dwell = now, seq.copy(), dwell.copy()
    best_count, best_sense, best_first = count, sense, first
    new_seq, new_dwell = seq.copy(), dwell.copy()
    for step in range(evaluations):
        heat = hot * (cold / hot) ** (step / evaluations)
        new_seq[:] = seq
        new_dwell[:] = dwell
        new_sense, new_first, new_count = sense, first, count
        if np.random.random() < 0.04:
            ahead = min(table[3] if sense > 0 else table[4], 40.0)
            if np.random.random() < 0.3:
                new_sense = -sense
            else:
                new_first = np.random.random() * ahead if np.random.random() < 0.5 else ahead
        else:
            wanted = 0
            if np.random.random() < 0.2:
                wanted = _wanted(turns, open_)
            new_count = _moved(new_seq, new_dwell, count, near, n, wanted)
            if new_count == 0:
                continue
        bound = now[0] - heat * np.log(1.0 - np.random.random())
        made = _cost(
            new_seq, new_dwell, new_count, new_sense, new_first, arrays, table, weights, work, memo, store,
            bound,
        )  # fmt: skip
        if made[0] <= bound:
            open_[:] = ~work[0]
            seq[:] = new_seq
            dwell[:] = new_dwell
            count, sense, first, now = new_count, new_sense, new_first, made
            if now[0] < best[0]:
                best, best_count, best_sense, best_first = now, count, sense, first
                best_seq[:] = seq
                best_dwell[:] = dwell
    seq[:] = best_seq
    dwell[:] = best_dwell
    return best_count, best_sense, best_first, best
