"""Compiled exact solution and lower bound of the travelling salesman problem.

Both are of Held and Karp: dynamic programming over subsets (J. SIAM 10(1), 1962, 196-210,
doi 10.1137/0110015) and the ascent over 1-trees (Mathematical Programming 1, 1971, 6-25,
doi 10.1007/BF01584070).
"""

import numpy as np

from scanmotion.geometry.jit import copy_into, njit


@njit(cache=True)
def best_closed_tour(D: np.ndarray) -> np.ndarray:
    """Cheapest closed tour from city 0 by dynamic programming; any costs (n, n), n <= 16 or so."""
    n = len(D)
    m = n - 1
    cost = np.full((1 << m, m), np.inf)
    back = np.full((1 << m, m), -1, dtype=np.int64)
    for j in range(m):
        cost[1 << j, j] = D[0, j + 1]
    for done in range(1, 1 << m):
        for j in range(m):
            c = cost[done, j]
            if not done >> j & 1 or c == np.inf:
                continue
            for k in range(m):
                more = done | 1 << k
                if more != done and c + D[j + 1, k + 1] < cost[more, k]:
                    cost[more, k] = c + D[j + 1, k + 1]
                    back[more, k] = j
    done = (1 << m) - 1
    last = 0
    for j in range(1, m):
        if cost[done, j] + D[j + 1, 0] < cost[done, last] + D[last + 1, 0]:
            last = j
    tour = np.zeros(n, dtype=np.int64)
    for i in range(m, 0, -1):
        tour[i] = last + 1
        before = back[done, last]
        done ^= 1 << last
        last = before
    return tour


@njit(cache=True)
def _one_tree(D, price, degree, key, near):
    """Least 1-tree under prices: spanning tree of cities 1.., two edges at city 0; returns its cost."""
    n = len(D)
    total = 0.0
    for v in range(n):
        degree[v] = 0
        key[v] = np.inf
        near[v] = -1
    inside = np.zeros(n, dtype=np.bool_)
    v = 1
    inside[1] = True
    for _ in range(n - 2):
        low, nxt = np.inf, -1
        for u in range(1, n):
            if inside[u]:
                continue
            c = D[v, u] + price[v] + price[u]
            if c < key[u]:
                key[u] = c
                near[u] = v
            if key[u] < low:
                low, nxt = key[u], u
        total += low
        degree[nxt] += 1
        degree[near[nxt]] += 1
        inside[nxt] = True
        v = nxt
    one, two, i, j = np.inf, np.inf, -1, -1
    for u in range(1, n):
        c = D[0, u] + price[0] + price[u]
        if c < one:
            two, j = one, i
            one, i = c, u
        elif c < two:
            two, j = c, u
    degree[0] = 2
    degree[i] += 1
    degree[j] += 1
    return total + one + two


@njit(cache=True)
def one_tree_bound(D: np.ndarray, upper: float, rounds: int) -> float:
    """Greatest 1-tree value found by subgradient ascent: a lower bound of every closed tour.

    Args:
        D: symmetric costs, shape (n, n), n >= 3.
        upper: cost of a known tour, which sets the step.
        rounds: number of 1-trees.
    """
    n = len(D)
    price, step_before = np.zeros(n), np.zeros(n)
    degree, near = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    key = np.empty(n)
    best, scale, idle = -np.inf, 1.0, 0
    best_price = price.copy()
    for _ in range(rounds):
        value = _one_tree(D, price, degree, key, near) - 2.0 * price.sum()
        if value > best:
            idle = 0 if value - best > 1e-3 * (upper - value) else idle + 1
            best = value
            copy_into(best_price, price)
        else:
            idle += 1
        norm = 0
        for v in range(n):
            norm += (degree[v] - 2) ** 2
        if norm == 0 or scale < 1e-4:
            break
        if idle >= 8:
            scale *= 0.6
            idle = 0
            copy_into(price, best_price)
        length = scale * max(upper - value, 1e-9 * abs(upper)) / norm
        for v in range(n):
            step_before[v] = length * (0.7 * (degree[v] - 2)) + 0.3 * step_before[v]
            price[v] += step_before[v]
    return best
