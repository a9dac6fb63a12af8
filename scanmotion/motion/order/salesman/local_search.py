"""Compiled local search of tours: 2-opt and Or-opt with neighbour lists and a work list.

The kernels see a closed tour over a symmetric cost matrix `D` (n, n) with neighbour lists `NB` (n, k),
nearest first; tsp.py reduces every other problem to this one.
"""

import numpy as np

from scanmotion.geometry.jit import copy_into, njit

EPS = 1e-10


@njit(cache=True)
def random_below(state: np.ndarray, n: int | np.int64):
    """Next whole number in [0, n) of the splitmix64 stream in `state`, shape (1,) uint64."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.int64((z ^ (z >> np.uint64(31))) % np.uint64(n))


@njit(cache=True)
def _reverse(tour: np.ndarray, pos: np.ndarray, i: int, j: int) -> None:
    """Reverse the stretch of places i..j (cyclic); the shorter side is turned, which comes to the same."""
    n = len(tour)
    inside = (j - i) % n + 1
    if 2 * inside > n:
        i, j, inside = (j + 1) % n, (i - 1) % n, n - inside
    for _ in range(inside // 2):
        a, b = tour[i], tour[j]
        tour[i], tour[j] = b, a
        pos[b], pos[a] = i, j
        i = i + 1 if i + 1 < n else 0
        j = j - 1 if j > 0 else n - 1


@njit(cache=True)
def _two_opt_city(D, NB, tour, pos, a, touched):
    """First improving 2-opt move that breaks an edge at city a; returns its gain, 0 for none."""
    n = len(tour)
    for side in range(2):
        step = 1 if side == 0 else n - 1
        b = tour[(pos[a] + step) % n]
        d_ab = D[a, b]
        for k in range(NB.shape[1]):
            c = NB[a, k]
            g = d_ab - D[a, c]
            if g <= EPS:
                break
            d = tour[(pos[c] + step) % n]
            gain = g + D[c, d] - D[b, d]
            if c != b and d != a and gain > EPS:
                if side == 0:
                    _reverse(tour, pos, pos[b], pos[c])
                else:
                    _reverse(tour, pos, pos[c], pos[b])
                touched[0], touched[1], touched[2], touched[3] = a, b, c, d
                return gain
    return 0.0


@njit(cache=True)
def _or_opt_city(D, NB, tour, pos, a, touched):
    """First improving move of a stretch of 1..3 cities that ends in city a to a near neighbour of a."""
    n = len(tour)
    for length in range(1, min(4, n - 2)):
        for side in range(2):
            step = 1 if side == 0 else n - 1
            e = tour[(pos[a] + step * (length - 1)) % n]
            p = tour[(pos[a] + n - step) % n]
            q = tour[(pos[e] + step) % n]
            freed = D[p, a] + D[e, q] - D[p, q]
            for k in range(NB.shape[1]):
                c = NB[a, k]
                if freed - D[a, c] <= EPS:
                    break
                if (pos[c] - pos[a]) * (1 if side == 0 else -1) % n < length:
                    continue
                for beyond in range(2):
                    d = tour[(pos[c] + (step if beyond == 0 else n - step)) % n]
                    if (d == a or d == e) or (c == p and d == q) or (c == q and d == p):
                        continue
                    gain = freed + D[c, d] - D[a, c] - D[e, d]
                    if gain > EPS:
                        _move_stretch(tour, pos, a, e, c, d, side, beyond)
                        touched[0], touched[1], touched[2] = a, e, p
                        touched[3], touched[4], touched[5] = q, c, d
                        return gain
    return 0.0


@njit(cache=True)
def _move_stretch(tour, pos, a, e, c, d, side, beyond):
    """Move the stretch a..e between the neighbours c and d so that a touches c and e touches d."""
    n = len(tour)
    length = ((pos[e] - pos[a]) if side == 0 else (pos[a] - pos[e])) % n + 1
    first, last = (a, e) if side == 0 else (e, a)
    # In tour direction the stretch goes between `low` and `high`.
    forward_gap = (beyond == 0) == (side == 0)
    low, high = (c, d) if forward_gap else (d, c)
    held = np.empty(length, dtype=tour.dtype)
    for i in range(length):
        held[i] = tour[(pos[first] + i) % n]
    ahead = (pos[low] - pos[last]) % n
    behind = (pos[first] - pos[high]) % n
    if ahead <= behind:
        place = pos[first]
        for i in range(ahead):
            tour[(place + i) % n] = tour[(place + length + i) % n]
        for i in range(ahead):
            pos[tour[(place + i) % n]] = (place + i) % n
        base = (place + ahead) % n
    else:
        place = pos[last]
        for i in range(behind):
            tour[(place - i) % n] = tour[(place - length - i) % n]
        for i in range(behind):
            pos[tour[(place - i) % n]] = (place - i) % n
        base = (place - behind - length + 1) % n
    keep = (low == c) == (first == a)
    for i in range(length):
        city = held[i] if keep else held[length - 1 - i]
        tour[(base + i) % n] = city
        pos[city] = (base + i) % n


@njit(cache=True)
def local_search(D: np.ndarray, NB: np.ndarray, tour: np.ndarray, pos: np.ndarray) -> None:
    """2-opt and Or-opt with neighbour lists and a work list, in place, to a local optimum."""
    n = len(tour)
    queue = tour.copy()
    waiting = np.ones(n, dtype=np.bool_)
    head, size = 0, n
    touched = np.empty(6, dtype=np.int64)
    while size > 0:
        a = queue[head]
        head = head + 1 if head + 1 < n else 0
        size -= 1
        waiting[a] = False
        while True:
            count = 4
            gain = _two_opt_city(D, NB, tour, pos, a, touched)
            if gain == 0.0:
                count = 6
                gain = _or_opt_city(D, NB, tour, pos, a, touched)
            if gain == 0.0:
                break
            for i in range(count):
                c = touched[i]
                if not waiting[c] and c != a:
                    waiting[c] = True
                    queue[(head + size) % n] = c
                    size += 1


@njit(cache=True)
def tour_cost(D: np.ndarray, tour: np.ndarray):
    """Cost of the closed tour."""
    total = D[tour[-1], tour[0]]
    for i in range(len(tour) - 1):
        total += D[tour[i], tour[i + 1]]
    return total


@njit(cache=True)
def first_population(D: np.ndarray, NB: np.ndarray, size: int, state: np.ndarray) -> np.ndarray:
    """`size` local optima from random tours, shape (size, n)."""
    n = len(D)
    population = np.empty((size, n), dtype=np.int64)
    pos = np.empty(n, dtype=np.int64)
    for p in range(size):
        tour = np.arange(n)
        for i in range(n - 1, 0, -1):
            j = random_below(state, i + 1)
            tour[i], tour[j] = tour[j], tour[i]
        for i in range(n):
            pos[tour[i]] = i
        local_search(D, NB, tour, pos)
        copy_into(population[p], tour)
    return population


@njit(cache=True)
def _swap_neighbours(tour: np.ndarray, pos: np.ndarray, i: int, first: int, second: int) -> None:
    """Exchange the stretch of `first` cities at place i with the `second` cities after it."""
    n = len(tour)
    held = np.empty(first, dtype=tour.dtype)
    for k in range(first):
        held[k] = tour[(i + k) % n]
    for k in range(second):
        tour[(i + k) % n] = tour[(i + first + k) % n]
    for k in range(first):
        tour[(i + second + k) % n] = held[k]
    for k in range(first + second):
        pos[tour[(i + k) % n]] = (i + k) % n


@njit(cache=True)
def _exchange_after(C, leave, reach, tour, pos, a):
    """First improving exchange of two neighbouring stretches, the first of which follows city a."""
    n = len(tour)
    b = tour[(pos[a] + 1) % n]
    for k in range(leave.shape[1]):
        d = leave[a, k]
        g = C[a, b] - C[a, d]
        if g <= EPS:
            break
        first = (pos[d] - pos[b]) % n
        if first == 0:
            continue
        c = tour[(pos[d] + n - 1) % n]
        g += C[c, d]
        for m in range(reach.shape[1]):
            e = reach[b, m]
            second = (pos[e] - pos[d]) % n + 1
            if e == a or first + second >= n or C[e, b] > g + C[e, tour[(pos[e] + 1) % n]]:
                continue
            f = tour[(pos[e] + 1) % n]
            if g + C[e, f] - C[e, b] - C[c, f] > EPS:
                _swap_neighbours(tour, pos, pos[b], first, second)
                return True
    return False


@njit(cache=True)
def directed_search(C: np.ndarray, leave: np.ndarray, reach: np.ndarray, tour: np.ndarray) -> np.ndarray:
    """Local optimum under exchanges of neighbouring stretches, which turn none round: for asymmetric costs.

    Args:
        C: costs, shape (n, n).
        leave: cheapest cities to go to from each, shape (n, k).
        reach: cheapest cities to come from to each, shape (n, k).
        tour: closed tour, shape (n,), changed in place and returned.
    """
    n = len(tour)
    pos = np.empty(n, dtype=np.int64)
    for i in range(n):
        pos[tour[i]] = i
    settled, a = 0, tour[0]
    while settled < n:
        settled = 0 if _exchange_after(C, leave, reach, tour, pos, a) else settled + 1
        a = tour[(pos[a] + 1) % n]
    return tour


@njit(cache=True)
def _nearest_unvisited(C, tour):
    """Write the tour that starts in tour[0] and always goes to the cheapest city left."""
    n = len(tour)
    v = tour[0]
    left = np.ones(n, dtype=np.bool_)
    for i in range(n):
        tour[i] = v
        left[v] = False
        low, nxt = np.inf, v
        for u in range(n):
            if left[u] and C[v, u] < low:
                low, nxt = C[v, u], u
        v = nxt


@njit(cache=True)
def directed_population(C, leave, reach, size, state):
    """`size` local optima of `directed_search`, one in ten from a nearest-city tour, shape (size, n)."""
    n = len(C)
    population = np.empty((size, n), dtype=np.int64)
    for p in range(size):
        tour = population[p]
        for i in range(n):
            j = random_below(state, i + 1)
            tour[i] = tour[j]
            tour[j] = i
        if p % 10 == 9:
            _nearest_unvisited(C, tour)
        directed_search(C, leave, reach, tour)
    return population
