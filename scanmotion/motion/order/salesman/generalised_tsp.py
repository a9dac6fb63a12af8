"""Compiled search over an order of groups and one state for each: the generalised travelling salesman.

A group is something to be visited once (a dwell, a sweep, a revolution); its states are the ways to do it.
`C[s, t]` is the cost from the end of state s to the start of state t, `head[s]` that from the start of the
tour to s, `tail[s]` what is left after s. Group g owns states `first[g]`..`first[g + 1] - 1`. `partner[s]`
is state s passed backwards, so that C[s, t] == C[partner[t], partner[s]]. Groups of stage 0 come before
those of stage 1. A genetic algorithm with order crossover, whose mutation takes groups out and puts them
back where they cost least, improved by 2-opt, insertion and dynamic programming over the layers.
"""

import numpy as np

from scanmotion.geometry.jit import copy_into, njit, turn_round
from scanmotion.motion.order.salesman.local_search import EPS, random_below


@njit(cache=True)
def best_states(CT, head, tail, first, order, states):
    """Cheapest states of a given order by dynamic programming, into states (m,); returns the cost.

    `CT` is the transposed C, so that the inner loop runs along memory.
    """
    m = len(order)
    value = np.empty(len(head))
    back = np.empty(len(head), dtype=np.int64)
    for i in range(m):
        g = order[i]
        for t in range(first[g], first[g + 1]):
            if i == 0:
                value[t] = head[t]
                continue
            low, source = np.inf, -1
            p = order[i - 1]
            for s in range(first[p], first[p + 1]):
                c = value[s] + CT[t, s]
                if c < low:
                    low, source = c, s
            value[t], back[t] = low, source
    low, t = np.inf, -1
    g = order[m - 1]
    for s in range(first[g], first[g + 1]):
        if value[s] + tail[s] < low:
            low, t = value[s] + tail[s], s
    for i in range(m - 1, -1, -1):
        states[i] = t
        t = back[t] if i > 0 else t
    return low


@njit(cache=True)
def states_cost(C, head, tail, states):
    """Cost of a sequence of states."""
    total = head[states[0]] + tail[states[-1]]
    for i in range(len(states) - 1):
        total += C[states[i], states[i + 1]]
    return total


@njit(cache=True)
def _step(C, head, tail, s, t):
    """Cost from state s to t, where -1 stands for the start as s and for the end as t."""
    if s < 0:
        return head[t] if t >= 0 else 0.0
    return C[s, t] if t >= 0 else tail[s]


@njit(cache=True)
def _take_out(order, states, m, i):
    for k in range(i, m - 1):
        order[k], states[k] = order[k + 1], states[k + 1]


@njit(cache=True)
def _put_in(order, states, m, i, g, s):
    for k in range(m, i, -1):
        order[k], states[k] = order[k - 1], states[k - 1]
    order[i], states[i] = g, s


@njit(cache=True)
def _cheapest_place(C, CT, head, tail, first, stage, order, states, m, g):
    """Where, and in which state, group g costs least in a tour of m groups: (cost, place, state)."""
    low, place, state = np.inf, -1, -1
    for i in range(m + 1):
        if (i > 0 and stage[order[i - 1]] > stage[g]) or (i < m and stage[order[i]] < stage[g]):
            continue
        s = states[i - 1] if i > 0 else -1
        t = states[i] if i < m else -1
        base = _step(C, head, tail, s, t) if m > 0 else 0.0
        come = C[s] if s >= 0 else head
        go = CT[t] if t >= 0 else tail
        for x in range(first[g], first[g + 1]):
            c = come[x] + go[x] - base
            if c < low:
                low, place, state = c, i, x
    return low, place, state


@njit(cache=True)
def _insertions(C, CT, head, tail, first, stage, order, states):
    """Move each group to its cheapest place and state; returns the gain."""
    m = len(order)
    gain = 0.0
    for g in range(m):
        i = 0
        while order[i] != g:
            i += 1
        held = states[i]
        s = states[i - 1] if i > 0 else -1
        t = states[i + 1] if i + 1 < m else -1
        freed = _step(C, head, tail, s, held) + _step(C, head, tail, held, t)
        freed -= _step(C, head, tail, s, t) if m > 1 else 0.0
        _take_out(order, states, m, i)
        cost, place, state = _cheapest_place(C, CT, head, tail, first, stage, order, states, m - 1, g)
        if cost < freed - EPS:
            gain += freed - cost
            _put_in(order, states, m - 1, place, g, state)
        else:
            _put_in(order, states, m - 1, i, g, held)
    return gain


@njit(cache=True)
def _reversals(C, head, tail, partner, stage, order, states):
    """2-opt inside each stage, states passed backwards by their partners; returns the gain."""
    m = len(order)
    gain = 0.0
    for i in range(m - 1):
        for j in range(i + 1, m):
            if stage[order[j]] != stage[order[i]]:
                break
            s = states[i - 1] if i > 0 else -1
            t = states[j + 1] if j + 1 < m else -1
            old = _step(C, head, tail, s, states[i]) + _step(C, head, tail, states[j], t)
            new = _step(C, head, tail, s, partner[states[j]]) + _step(C, head, tail, partner[states[i]], t)
            if new < old - EPS:
                gain += old - new
                turn_round(order, i, j)
                turn_round(states, i, j)
                for k in range(i, j + 1):
                    states[k] = partner[states[k]]
    return gain


@njit(cache=True)
def improve(C, CT, head, tail, first, partner, stage, order, states):
    """To a local optimum of insertions, 2-opt and dynamic programming, in place; returns the cost."""
    cost = best_states(CT, head, tail, first, order, states)
    while True:
        gain = _reversals(C, head, tail, partner, stage, order, states)
        gain += _insertions(C, CT, head, tail, first, stage, order, states)
        now = best_states(CT, head, tail, first, order, states)
        if now >= cost - 1e-9 or gain == 0.0:
            return min(now, cost)
        cost = now


@njit(cache=True)
def _rebuild(C, CT, head, tail, first, stage, order, states, m, groups, rng):
    """Put `groups` back into a tour of m groups, in random order, each where it costs least."""
    for k in range(len(groups)):
        j = k + random_below(rng, len(groups) - k)
        groups[k], groups[j] = groups[j], groups[k]
        g = groups[k]
        _, place, state = _cheapest_place(C, CT, head, tail, first, stage, order, states, m, g)
        _put_in(order, states, m, place, g, state)
        m += 1


@njit(cache=True)
def _shaken(C, CT, head, tail, first, stage, order, states, most, rng):
    """Take 1..most groups out, neighbours or scattered, and put them back."""
    m = len(order)
    count = 1 + random_below(rng, most)
    groups = np.empty(count, dtype=np.int64)
    together = random_below(rng, np.int64(2)) == 0
    at = random_below(rng, m)
    for k in range(count):
        i = at % (m - k) if together else random_below(rng, m - k)
        groups[k] = order[i]
        _take_out(order, states, m - k, i)
    _rebuild(C, CT, head, tail, first, stage, order, states, m - count, groups, rng)


@njit(cache=True)
def _crossed(stage, order_a, states_a, order_b, states_b, order, states, rng):
    """Order crossover: a stretch of A keeps its places, the other groups of its stage follow B's order."""
    m = len(order)
    i, j = random_below(rng, m), random_below(rng, m)
    i, j = min(i, j), max(i, j)
    kept = np.zeros(m, dtype=np.bool_)
    for k in range(i, j + 1):
        kept[order_a[k]] = True
    # Both parents hold the groups of stage 0 in front, so B's others fill the free places stage by stage.
    b = 0
    for k in range(m):
        if i <= k <= j:
            order[k], states[k] = order_a[k], states_a[k]
            continue
        while kept[order_b[b]]:
            b += 1
        order[k], states[k] = order_b[b], states_b[b]
        b += 1


@njit(cache=True)
def _mutated(C, CT, head, tail, first, partner, stage, order, states, cost, shakes, most, rng):
    """Repeated shaking, keeping what is no worse, then a local optimum; returns the cost."""
    trial, trial_states = np.empty(len(order), np.int64), np.empty(len(order), np.int64)
    for _ in range(shakes):
        copy_into(trial, order)
        copy_into(trial_states, states)
        _shaken(C, CT, head, tail, first, stage, trial, trial_states, most, rng)
        now = states_cost(C, head, tail, trial_states)
        if now <= cost + EPS:
            if now < cost - EPS:
                now = best_states(CT, head, tail, first, trial, trial_states)
            copy_into(order, trial)
            copy_into(states, trial_states)
            cost = now
    return min(cost, improve(C, CT, head, tail, first, partner, stage, order, states))


@njit(cache=True)
def _parent(costs, rng):
    """The cheaper of two drawn at random."""
    a, b = random_below(rng, len(costs)), random_below(rng, len(costs))
    return a if costs[a] <= costs[b] else b


@njit(cache=True)
def _standing(costs, cost):
    """The cheapest, the dearest, and how near the nearest of the costs (p,) is to one."""
    best, worst, nearest = 0, 0, abs(costs[0] - cost)
    for k in range(1, len(costs)):
        best = k if costs[k] < costs[best] else best
        worst = k if costs[k] > costs[worst] else worst
        nearest = min(nearest, abs(costs[k] - cost))
    return best, worst, nearest


@njit(cache=True, nogil=True)
def search(C, CT, head, tail, first, partner, stage, seeds, generations, shakes, most, rng):
    """Genetic algorithm over orders and states; returns (order, states, cost).

    Args:
        C: costs between states, shape (N, N).
        CT: the same transposed, contiguous.
        head: costs from the start, shape (N,).
        tail: costs to the end, shape (N,).
        first: first state of each group and N, shape (m + 1,).
        partner: each state passed backwards, shape (N,).
        stage: 0 or 1 for each group, shape (m,).
        seeds: first population, orders that keep the stages, shape (p, m); changed in place.
        generations: children made.
        shakes: removals tried on each child.
        most: greatest number of groups taken out at once.
        rng: stream of random numbers, shape (1,) uint64.
    """
    p, m = seeds.shape
    states = np.empty((p, m), dtype=np.int64)
    costs = np.empty(p)
    for k in range(p):
        costs[k] = improve(C, CT, head, tail, first, partner, stage, seeds[k], states[k])
        costs[k] = _mutated(
            C, CT, head, tail, first, partner, stage, seeds[k], states[k], costs[k], shakes, most, rng
        )
    child, child_states = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    for _ in range(generations):
        a, b = _parent(costs, rng), _parent(costs, rng)
        _crossed(stage, seeds[a], states[a], seeds[b], states[b], child, child_states, rng)
        cost = best_states(CT, head, tail, first, child, child_states)
        cost = _mutated(
            C, CT, head, tail, first, partner, stage, child, child_states, cost, shakes, most, rng
        )
        best, worst, nearest = _standing(costs, cost)
        if cost < costs[worst] - EPS and nearest > EPS:
            copy_into(seeds[worst], child)
            copy_into(states[worst], child_states)
            costs[worst] = cost
    best, worst, nearest = _standing(costs, 0.0)
    copy_into(child, seeds[best])
    copy_into(child_states, states[best])
    return child, child_states, costs[best]


@njit(cache=True)
def _gap(features, a, b):
    low = 0.0
    for i in range(features.shape[1]):
        low = max(low, abs(features[a, i] - features[b, i]))
    return low


@njit(cache=True)
def cheapest_apart(features, order, chosen, apart, most):
    """Add the first rows of `order` that lie `apart` from all chosen ones until there are `most`."""
    out = np.empty(max(most, len(chosen)), dtype=np.int64)
    copy_into(out, chosen)
    count = len(chosen)
    for row in order:
        if count >= most:
            break
        free = True
        for k in range(count):
            if _gap(features, row, out[k]) <= apart:
                free = False
                break
        if free:
            out[count] = row
            count += 1
    return out[:count]


@njit(cache=True)
def most_different(features, chosen, most):
    """Add the row that is farthest from all chosen ones, until there are `most` or none differs."""
    n = len(features)
    out = np.zeros(max(most, len(chosen), 1), dtype=np.int64)
    copy_into(out, chosen)
    count = max(len(chosen), 1)
    distance = np.empty(n)
    for i in range(n):
        distance[i] = np.inf
    for k in range(min(most, n)):
        if k >= count:
            row = 0
            for i in range(1, n):
                row = i if distance[i] > distance[row] else row
            if distance[row] <= 1e-9:
                break
            out[k] = row
            count += 1
        for i in range(n):
            distance[i] = min(distance[i], _gap(features, i, out[k]))
    return out[:count]
