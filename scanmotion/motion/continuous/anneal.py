"""Compiled: what a continuous motion costs, random changes of it, and simulated annealing over them.

Arrays instead of types, for numba. `arrays` are poses in O with the table at zero (n, 4, 4), quaternions
(n, 4), seconds of the ways (n, n), neighbours (n, k), then `Sight`'s places (3, m), normals (3, m), open
directions, cells and field. `table` is the table's speed, ramp, start, and room upward and downward;
`weights` are seconds for each place, the share paid for the second frame, the longest duration, how
many words hold places that stand for themselves, and for how many places each of the others stands.
"""

import numpy as np

from scanmotion.geometry.jit import njit
from scanmotion.motion.continuous.table_travel import MOST_PIECES, angle_at, pieces_of
from scanmotion.sensing.sight import frame_mask, turned_pose

STEP_S = 0.25
"""Time between the frames that are looked at [s]."""
BINS = 24
"""Table angles at which frames are looked at; at full speed the table turns by one in STEP_S."""
MOST = 40
"""Most nodes of a motion."""
_EASE_S = 0.15
"""The arm's ramps keep it about so long near both ends of a way [s]."""


@njit(cache=True)
def _popcount(x):
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True)
def _count(mask, weights):
    """For how many places the bits that are set stand."""
    n = 0
    for w in range(int(weights[3])):
        n += _popcount(mask[w])
    rest = 0
    for w in range(int(weights[3]), len(mask)):
        rest += _popcount(mask[w])
    return n + weights[4] * rest


@njit(cache=True)
def greedy(turns, seconds, weights):
    """Whole turns, the most worth for its seconds first, as long as one is worth its seconds."""
    n, words = turns.shape
    seen = np.zeros(words, np.uint64)
    chosen = [0]
    while len(chosen) < 12:
        best, gain_best = -1, 0.0
        for i in range(1, n):
            gain = _count(turns[i] & ~seen, weights)
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
def _look(a, b, g, k, key, arrays, near, Z, X, memo, store):
    """Remembers what is seen g fifteenths of the way from node a to node b at table angle k."""
    Y, quat, _, _, points, normals, opened, cells, field = arrays
    if len(memo) >= len(store):
        memo.clear()
    memo[key] = np.int64(len(memo))
    _between(Y[a], Y[b], quat[a], quat[b], g / 15.0, Z)
    turned_pose(Z, k * 2.0 * np.pi / BINS, X)
    frame_mask(X, points, normals, opened, cells, field, near, store[memo[key]])


@njit(cache=True)
def _cost(seq, dwell, count, sense, first, arrays, table, weights, work, memo, store, bound):
    """Cost, seconds, places missed and places not seen twice of one motion; not looked at beyond `bound`."""
    seconds, count_all = arrays[2], len(arrays[0])
    hard = 64.0 * weights[3]
    places = hard + weights[4] * (arrays[4].shape[1] - hard)
    once, twice, near, pieces, Z, X = work
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
                key = ((a * count_all + b) * 16 + g) * BINS + k
                if key not in memo:
                    _look(a, b, g, k, key, arrays, near, Z, X, memo, store)
                m = store[memo[key]]
                for w in range(words):
                    twice[w] |= once[w] & m[w]
                    once[w] |= m[w]
                frame += 1
            t = until
    seen, again = _count(once, weights), _count(twice, weights)
    missed, missed_twice = places - seen, places - again
    cost = total + late + weights[0] * ((1.0 - weights[1]) * missed + weights[1] * missed_twice)
    return cost, total, missed, missed_twice


@njit(cache=True)
def _wanted(turns, open_, weights, rng):
    """A node whose whole turn sees much of what is open: the best of some drawn at random."""
    best, gain_best = 0, 0.0
    for _ in range(60):
        i = rng.integers(1, len(turns))
        gain = _count(turns[i] & open_, weights)
        if gain > gain_best:
            best, gain_best = i, gain
    return best


@njit(cache=True)
def _moved(seq, dwell, count, near, n, wanted, rng):
    """One random change in place: the new number of nodes, or 0 where nothing can be changed.

    Where a node is `wanted`, it is put in or takes the place of another; 0 is none.
    """
    kind = rng.integers(0, 100)
    if wanted > 0:
        if count > 1 and (kind < 40 or count == MOST):
            seq[rng.integers(1, count)] = wanted
        else:
            i = rng.integers(1, count + 1)
            for k in range(count, i, -1):
                seq[k], dwell[k] = seq[k - 1], dwell[k - 1]
            seq[i], dwell[i] = wanted, rng.integers(0, 24)
            count += 1
    elif kind < 18 and count > 1:
        i = rng.integers(1, count)
        seq[i] = near[seq[i], rng.integers(0, near.shape[1])]
    elif kind < 26 and count > 1:
        seq[rng.integers(1, count)] = rng.integers(1, n)
    elif kind < 50 and count > 1:
        i = rng.integers(0, count)
        dwell[i] = max(dwell[i] + rng.integers(1, 9) * (1 if rng.random() < 0.4 else -1), 0)
    elif kind < 64 and count < MOST:
        i = rng.integers(1, count + 1)
        for k in range(count, i, -1):
            seq[k], dwell[k] = seq[k - 1], dwell[k - 1]
        beside = seq[i - 1] if rng.random() < 0.7 else seq[min(i, count - 1)]
        new = near[beside, rng.integers(0, near.shape[1])]
        seq[i] = new if rng.random() < 0.7 else rng.integers(1, n)
        dwell[i] = rng.integers(0, 30)
        count += 1
    elif kind < 76 and count > 2:
        i = rng.integers(1, count)
        for k in range(i, count - 1):
            seq[k], dwell[k] = seq[k + 1], dwell[k + 1]
        count -= 1
    elif kind < 84 and count > 2:
        i, j = rng.integers(1, count), rng.integers(1, count)
        seq[i], seq[j] = seq[j], seq[i]
        dwell[i], dwell[j] = dwell[j], dwell[i]
    elif kind < 92 and count > 3:
        i, j = rng.integers(1, count), rng.integers(1, count)
        i, j = min(i, j), max(i, j)
        while i < j:
            seq[i], seq[j] = seq[j], seq[i]
            dwell[i], dwell[j] = dwell[j], dwell[i]
            i += 1
            j -= 1
    elif count > 2:
        i, j = rng.integers(1, count), rng.integers(1, count)
        d = min(rng.integers(1, 12), dwell[i])
        dwell[i] -= d
        dwell[j] += d
    for i in range(1, count):
        if seq[i] == 0 or seq[i] == seq[i - 1]:
            return 0
    return count


@njit(cache=True)
def anneal(seq, dwell, count, sense, first, arrays, turns, table, weights, evaluations, hot, cold, rng):
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
        if rng.random() < 0.04:
            ahead = min(table[3] if sense > 0 else table[4], 40.0)
            if rng.random() < 0.3:
                new_sense = -sense
            else:
                new_first = rng.random() * ahead if rng.random() < 0.5 else ahead
        else:
            wanted = 0
            if rng.random() < 0.2:
                wanted = _wanted(turns, open_, weights, rng)
            new_count = _moved(new_seq, new_dwell, count, near, n, wanted, rng)
            if new_count == 0:
                continue
        bound = now[0] - heat * np.log(1.0 - rng.random())
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
