"""Compiled genetic algorithm over tours: the edge assembly crossover.

Nagata and Kobayashi, INFORMS Journal on Computing 25(2), 2013, 346-363 (doi 10.1287/ijoc.1120.0506), in the
localised form with single AB-cycles: the edges in which two parents differ fall into cycles that take turns
between them; a child is parent A with one such cycle exchanged, its subtours joined by the cheapest
2-exchange. The kernels see a symmetric matrix `D` (n, n) and neighbour lists `NB` (n, k).
"""

import numpy as np

from scanmotion.geometry.jit import copy_into, njit, sort_in_place
from scanmotion.motion.order.salesman.local_search import EPS, random_below


@njit(cache=True)
def _links(tour: np.ndarray) -> np.ndarray:
    """The two neighbours of every city, shape (n, 2)."""
    n = len(tour)
    link = np.empty((n, 2), dtype=np.int64)
    for i in range(n):
        link[tour[i], 0] = tour[i - 1]
        link[tour[i], 1] = tour[(i + 1) % n]
    return link


@njit(cache=True)
def _open_edges(link, other, rest, degree):
    """Edges of `link` that are not in `other`, per city, into rest (n, 2) and degree (n,)."""
    for v in range(len(link)):
        degree[v] = 0
        for s in range(2):
            u = link[v, s]
            if other[v, 0] != u and other[v, 1] != u:
                rest[v, degree[v]] = u
                degree[v] += 1


@njit(cache=True)
def _take(rest, degree, v, state):
    """Draw one open edge at v, remove it at both ends, and return its other end."""
    s = random_below(state, np.int64(2)) if degree[v] == 2 else 0
    u = rest[v, s]
    degree[v] -= 1
    if s == 0:
        rest[v, 0] = rest[v, 1]
    if rest[u, 0] == v:
        rest[u, 0] = rest[u, 1]
    degree[u] -= 1
    return u


@njit(cache=True)
def _ab_cycles(link_a, link_b, state, nodes, offsets):
    """Split the differing edges into AB-cycles.

    Cycle c is nodes[offsets[c]:offsets[c + 1]]; its edges (0, 1), (2, 3).. are of A, (1, 2), (3, 4).. of B.
    Returns their number.
    """
    n = len(link_a)
    rest = np.empty((2, n, 2), dtype=np.int64)
    degree = np.empty((2, n), dtype=np.int64)
    _open_edges(link_a, link_b, rest[0], degree[0])
    _open_edges(link_b, link_a, rest[1], degree[1])
    left_at = np.full((2, n), -1, dtype=np.int64)
    path = np.empty(2 * n + 2, dtype=np.int64)
    cycles = 0
    offsets[0] = 0
    start = random_below(state, n)
    for shift in range(n):
        v0 = (start + shift) % n
        while degree[0, v0] > 0:
            path[0] = v0
            length, kind = 1, 0
            while length > 0:
                v = path[length - 1]
                left_at[kind, v] = length - 1
                v = _take(rest[kind], degree[kind], v, state)
                kind = 1 - kind
                first = left_at[kind, v]
                if first < 0:
                    path[length] = v
                    length += 1
                    continue
                begin = offsets[cycles]
                size = length - first
                for i in range(size):
                    # A cycle that begins with an edge of B is turned by one.
                    nodes[begin + i] = path[first + (i + kind) % size]
                for i in range(first, length):
                    left_at[(i - first + kind) % 2, path[i]] = -1
                cycles += 1
                offsets[cycles] = begin + size
                length = first + 1 if first > 0 else 0
    return cycles


@njit(cache=True)
def _relink(link, v, old, new):
    link[v, 0 if link[v, 0] == old else 1] = new


@njit(cache=True)
def _exchange(link, a, b, c, d, log, used):
    """Edges a-b and c-d give way to a-c and b-d; what was done goes into log at `used`, which is returned."""
    _relink(link, a, b, c)
    _relink(link, b, a, d)
    _relink(link, c, d, a)
    _relink(link, d, c, b)
    log[used, 0], log[used, 1], log[used, 2], log[used, 3] = a, b, c, d
    return used + 1


@njit(cache=True)
def _swap_cycle(link, cycle, forward):
    """Exchange the A edges of a cycle for its B edges (`forward`) or take that back."""
    size = len(cycle)
    shift = 0 if forward else 1
    # A city can stand twice in a cycle: first mark what leaves, then fill the marks.
    for i in range(shift, size + shift, 2):
        u, v = cycle[i % size], cycle[(i + 1) % size]
        _relink(link, u, v, -1)
        _relink(link, v, u, -1)
    for i in range(1 - shift, size + 1 - shift, 2):
        u, v = cycle[i % size], cycle[(i + 1) % size]
        _relink(link, u, -1, v)
        _relink(link, v, -1, u)


@njit(cache=True)
def _stretches(cycle, pos):
    """Sorted places after which parent A is cut by the cycle, one for each of its A edges."""
    n = len(pos)
    cuts = np.empty(len(cycle) // 2, dtype=np.int64)
    for i in range(len(cuts)):
        p, q = pos[cycle[2 * i]], pos[cycle[2 * i + 1]]
        cuts[i] = p if (p + 1) % n == q else q
    sort_in_place(cuts, len(cuts))
    return cuts


@njit(cache=True)
def _stretch_of(cuts, place):
    """Index of the stretch that holds a place; stretch s runs from cuts[s - 1] + 1 to cuts[s], cyclic."""
    low, high = 0, len(cuts)
    while low < high:
        mid = (low + high) // 2
        if cuts[mid] < place:
            low = mid + 1
        else:
            high = mid
    return low if low < len(cuts) else 0


@njit(cache=True)
def _label_subtours(link, tour, pos, cuts, label, size):
    """Subtour of each stretch, and the number of cities of each subtour; returns their number."""
    n = len(pos)
    for s in range(len(cuts)):
        label[s] = -1
    subtours = 0
    for s0 in range(len(cuts)):
        if label[s0] >= 0:
            continue
        size[subtours] = 0
        s, at_end = s0, True
        while label[s] < 0:
            label[s] = subtours
            low, high = (cuts[s - 1] + 1) % n, cuts[s]
            span = (high - low) % n + 1
            size[subtours] += span
            # Leave the stretch by the end that is not where it was entered.
            out, inner = (high, (high - 1) % n) if at_end else (low, (low + 1) % n)
            v = tour[out]
            if span == 1:
                u = link[v, 1] if at_end else link[v, 0]
            else:
                u = link[v, 0] if link[v, 1] == tour[inner] else link[v, 1]
            s, at_end = _enter(link, pos, cuts, u, v)
        subtours += 1
    return subtours


@njit(cache=True)
def _enter(link, pos, cuts, u, v):
    """Stretch entered at city u from v, and whether it is left at its high end."""
    n = len(pos)
    s = _stretch_of(cuts, pos[u])
    low, high = (cuts[s - 1] + 1) % n, cuts[s]
    if low == high:
        return s, link[u, 0] == v
    return s, pos[u] == low


@njit(cache=True)
def _join_smallest(D, NB, link, pos, cuts, label, v0, best):
    """Cheapest 2-exchange that joins the subtour of city v0 to another, into best (4,); returns its gain."""
    home = label[_stretch_of(cuts, pos[v0])]
    n = len(pos)
    found = -1e300
    for width in (min(10, NB.shape[1]), n):
        u, came = v0, link[v0, 0]
        while True:
            onward = link[u, 1] if link[u, 0] == came else link[u, 0]
            for k in range(width):
                c = NB[u, k] if width < n else k
                if label[_stretch_of(cuts, pos[c])] == home:
                    continue
                for t in range(2):
                    d = link[c, t]
                    base = D[c, d] - D[u, c]
                    for b in (came, onward):
                        gain = base + D[u, b] - D[b, d]
                        if gain > found:
                            found = gain
                            best[0], best[1], best[2], best[3] = u, b, c, d
            u, came = onward, u
            if u == v0:
                break
        if found > -1e300:
            break
    return found


@njit(cache=True)
def _child(D, NB, link, tour, pos, cycle, label, size, log):
    """Turn `link` of parent A into the child by one AB-cycle; returns (gain, exchanges in the log)."""
    gain = 0.0
    m = len(cycle)
    for i in range(0, m, 2):
        gain += D[cycle[i], cycle[i + 1]] - D[cycle[i + 1], cycle[(i + 2) % m]]
    _swap_cycle(link, cycle, True)
    cuts = _stretches(cycle, pos)
    subtours = _label_subtours(link, tour, pos, cuts, label, size)
    used = 0
    best = np.empty(4, dtype=np.int64)
    while subtours > 1:
        small = 0
        for t in range(1, subtours):
            if size[t] < size[small]:
                small = t
        v0 = -1
        for s in range(len(cuts)):
            if label[s] == small:
                v0 = tour[cuts[s]]
                break
        gain += _join_smallest(D, NB, link, pos, cuts, label, v0, best)
        used = _exchange(link, best[0], best[1], best[2], best[3], log, used)
        into = label[_stretch_of(cuts, pos[best[2]])]
        size[into] += size[small]
        last = subtours - 1
        size[small] = size[last]
        for s in range(len(cuts)):
            if label[s] == small:
                label[s] = into
            if label[s] == last:
                label[s] = small
        subtours -= 1
    return gain, used


@njit(cache=True)
def _undo(link, cycle, log, used):
    """Take a child back to parent A."""
    for i in range(used - 1, -1, -1):
        a, b, c, d = log[i]
        _relink(link, a, c, b)
        _relink(link, b, d, a)
        _relink(link, c, a, d)
        _relink(link, d, b, c)
    _swap_cycle(link, cycle, False)


@njit(cache=True)
def _order_of(link, tour, pos):
    """Write the tour and the places of a child's links."""
    v, came = 0, link[0, 0]
    for i in range(len(tour)):
        tour[i] = v
        pos[v] = i
        onward = link[v, 1] if link[v, 0] == came else link[v, 0]
        v, came = onward, v


@njit(cache=True)
def cross(D, NB, tour_a, tour_b, children, state):
    """Replace tour_a by its best child with tour_b where that is shorter; returns the gain."""
    n = len(tour_a)
    link, link_b = _links(tour_a), _links(tour_b)
    nodes = np.empty(2 * n + 2, dtype=np.int64)
    offsets = np.empty(n + 2, dtype=np.int64)
    cycles = _ab_cycles(link, link_b, state, nodes, offsets)
    pos = np.empty(n, dtype=np.int64)
    for i in range(n):
        pos[tour_a[i]] = i
    label, size = np.empty(n + 1, dtype=np.int64), np.empty(n + 1, dtype=np.int64)
    log = np.empty((n + 1, 4), dtype=np.int64)
    best_gain, best_cycle = EPS, -1
    order = np.arange(cycles)
    for i in range(min(children, cycles)):
        j = i + random_below(state, cycles - i)
        order[i], order[j] = order[j], order[i]
        cycle = nodes[offsets[order[i]] : offsets[order[i] + 1]]
        gain, used = _child(D, NB, link, tour_a, pos, cycle, label, size, log)
        if gain > best_gain:
            best_gain, best_cycle = gain, order[i]
        _undo(link, cycle, log, used)
    if best_cycle < 0:
        return 0.0
    cycle = nodes[offsets[best_cycle] : offsets[best_cycle + 1]]
    _child(D, NB, link, tour_a, pos, cycle, label, size, log)
    _order_of(link, tour_a, pos)
    return best_gain


@njit(cache=True, nogil=True)
def evolve(D, NB, population, costs, generations, patience, children, state):
    """Generations of edge assembly in place until none improves for `patience` rounds; returns rounds done.

    Args:
        D: symmetric costs, shape (n, n).
        NB: nearest neighbours, shape (n, k).
        population: tours, shape (p, n).
        costs: their costs, shape (p,).
        generations: greatest number of rounds.
        patience: rounds without any improvement after which the search ends.
        children: AB-cycles tried for each pair of parents.
        state: stream of random numbers, shape (1,) uint64.
    """
    p = len(population)
    order = np.arange(p)
    first = np.empty(population.shape[1], np.int64)
    idle = 0
    for generation in range(generations):
        for i in range(p - 1, 0, -1):
            j = random_below(state, i + 1)
            order[i], order[j] = order[j], order[i]
        copy_into(first, population[order[0]])
        improved = False
        for i in range(p):
            other = population[order[i + 1]] if i + 1 < p else first
            gain = cross(D, NB, population[order[i]], other, children, state)
            costs[order[i]] -= gain
            improved |= gain > 0.0
        idle = 0 if improved else idle + 1
        if idle >= patience:
            return generation + 1
    return generations
