"""The public tour: the best order over a matrix of costs, with a lower bound.

A genetic algorithm with edge assembly crossover over tours improved by 2-opt and Or-opt. Open tours, fixed
ends and asymmetric costs are reduced to a closed tour over symmetric costs, so one search and one bound serve
all. Searches stop by work done, never by time.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from scanmotion.core.errors import InputError
from scanmotion.motion.order.salesman.edge_assembly import evolve
from scanmotion.motion.order.salesman.local_search import (
    directed_population,
    directed_search,
    first_population,
    tour_cost,
)
from scanmotion.motion.order.salesman.tour_bound import best_closed_tour, one_tree_bound


@dataclass(frozen=True, kw_only=True)
class TourOptions:
    """How hard to search; every number counts work, none counts seconds."""

    exact_up_to: int = 12
    """Greatest number of cities that is solved exactly by dynamic programming."""
    population: int = 60
    """Tours kept by the genetic algorithm."""
    generations: int = 200
    """Greatest number of rounds of crossover."""
    patience: int = 2
    """Rounds without any improvement after which the search ends."""
    children: int = 30
    """Exchanges tried for each pair of parents."""
    neighbours: int = 10
    """Nearest cities that the local search considers."""
    bound_rounds: int = 300
    """1-trees of the lower bound; 0 leaves the assignment bound alone."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TourResult:
    """An order, what it costs, and what any order costs at least."""

    order: np.ndarray
    """Indices of all cities in the order of the tour, shape (n,)."""
    cost: float
    """Sum of the costs along the order, and back to its first city where the tour is closed."""
    lower_bound: float
    """No tour with the same ends costs less."""
    exact: bool
    """Whether the tour is proven best: by enumeration, or because the bound meets it (to 1e-9 of it)."""

    @property
    def gap(self) -> float:
        """(cost - lower_bound) / cost; 0 for a tour that costs nothing."""
        return (self.cost - self.lower_bound) / abs(self.cost) if self.cost else 0.0


def tour_from_cost(
    cost: np.ndarray,
    *,
    closed: bool = False,
    start: int | None = None,
    end: int | None = None,
    rng: np.random.Generator,
    options: TourOptions | None = None,
) -> TourResult:
    """The cheapest order over all cities that was found, with a lower bound.

    Args:
        cost: cost[i, j] of going from i to j, shape (n, n); finite; need not be symmetric. The diagonal is
            not read.
        closed: whether the tour returns to its first city.
        start: first city; None for any. A closed tour is only turned so that it begins there.
        end: last city of an open tour; None for any.
        rng: source of the random numbers; the same state gives the same tour.
        options: how hard to search.

    Raises:
        InputError: the matrix is not square and finite, or start or end is not one of its cities.
    """
    options = options or TourOptions()
    cost = _check(cost, closed, start, end)
    n = len(cost)
    if n <= 1 or (n == 2 and closed):
        order = np.arange(n)
        value = _walk(cost, order, closed)
        return TourResult(order=_from_start(order, start), cost=value, lower_bound=value, exact=True)
    ring = cost if closed else _with_depot(cost, start, end)
    seed = np.uint64(rng.integers(0, 2**63))
    if n <= options.exact_up_to:
        tour = best_closed_tour(ring)
    elif np.array_equal(ring, ring.T):
        tour = _symmetric_tour(ring, seed, options)
    else:
        tour = _asymmetric_tour(ring, seed, options)
    order = _from_start(tour, start) if closed else _opened(tour, start, end)
    value = _walk(cost, order, closed)
    if n <= options.exact_up_to:
        return TourResult(order=order, cost=value, lower_bound=value, exact=True)
    bound = min(value, _lower_bound(ring, tour, options) - (_walk(ring, tour, True) - value))
    exact = value - bound <= 1e-9 * abs(value)
    return TourResult(order=order, cost=value, lower_bound=bound, exact=exact)


def _check(cost: np.ndarray, closed: bool, start: int | None, end: int | None) -> np.ndarray:
    cost = np.array(cost, dtype=float)
    if cost.ndim != 2 or cost.shape[0] != cost.shape[1] or len(cost) == 0:
        raise InputError(f"costs must be a square matrix of at least one city, got shape {cost.shape}")
    np.fill_diagonal(cost, 0.0)
    if not np.isfinite(cost).all():
        i, j = np.argwhere(~np.isfinite(cost))[0]
        raise InputError(f"costs must be finite, but that from {i} to {j} is {cost[i, j]}")
    for name, city in (("start", start), ("end", end)):
        if city is not None and not 0 <= city < len(cost):
            raise InputError(f"{name} {city} is not one of the {len(cost)} cities")
    if closed and end is not None:
        raise InputError("a closed tour has no end of its own")
    if end is not None and end == start and len(cost) > 1:
        raise InputError(f"an open tour cannot both start and end in city {start}")
    return cost


def _walk(cost: np.ndarray, order: np.ndarray, closed: bool) -> float:
    total = float(cost[order[:-1], order[1:]].sum())
    return total + float(cost[order[-1], order[0]]) if closed else total


def _with_depot(cost: np.ndarray, start: int | None, end: int | None) -> np.ndarray:
    """An extra city, last, between end and start: free to reach, and paid to touch the fixed ends."""
    n = len(cost)
    ring = np.zeros((n + 1, n + 1))
    ring[:n, :n] = cost
    # A tour that ignores a fixed end gains less than four greatest costs by it.
    reward = 4.0 * np.ptp(cost) + 1e-6
    if start is not None:
        ring[n, start] -= reward
    if end is not None:
        ring[end, n] -= reward
    if np.array_equal(cost, cost.T):
        # Either direction of a symmetric tour will do, so that the reduced problem stays symmetric.
        ring[:n, n] = ring[n, :n] = np.minimum(ring[:n, n], ring[n, :n])
    return ring


def _from_start(tour: np.ndarray, start: int | None) -> np.ndarray:
    first = 0 if start is None else int(start)
    return np.roll(tour, -int(np.flatnonzero(tour == first)[0]))


def _opened(tour: np.ndarray, start: int | None, end: int | None) -> np.ndarray:
    """Cut a closed tour at the depot, its greatest index, and turn it so that the fixed ends are right."""
    order = np.roll(tour, -int(np.argmax(tour)))[1:]
    wrong = (start is not None and order[0] != start) or (end is not None and order[-1] != end)
    return order[::-1].copy() if wrong else order


def _neighbours(D: np.ndarray, count: int) -> np.ndarray:
    """Nearest cities of each city, nearest first, shape (n, k)."""
    away = D.copy()
    np.fill_diagonal(away, np.inf)
    k = min(count, len(D) - 1)
    near = np.argpartition(away, k - 1, axis=1)[:, :k] if k < len(D) - 1 else np.argsort(away, axis=1)[:, :k]
    ranks = np.argsort(np.take_along_axis(away, near, axis=1), axis=1, kind="stable")
    return np.ascontiguousarray(np.take_along_axis(near, ranks, axis=1))


def _evolved(
    D: np.ndarray, near: np.ndarray, population: np.ndarray, state: np.ndarray, options: TourOptions
):
    costs = np.array([tour_cost(D, tour) for tour in population])
    evolve(D, near, population, costs, options.generations, options.patience, options.children, state)
    return population[int(np.argmin([tour_cost(D, tour) for tour in population]))]


def _symmetric_tour(D: np.ndarray, seed: np.uint64, options: TourOptions) -> np.ndarray:
    state = np.array([seed], dtype=np.uint64)
    near = _neighbours(D, options.neighbours)
    return _evolved(D, near, first_population(D, near, options.population, state), state, options)


def _asymmetric_tour(ring: np.ndarray, seed: np.uint64, options: TourOptions) -> np.ndarray:
    n = len(ring)
    state = np.array([seed], dtype=np.uint64)
    leave, reach = _neighbours(ring, options.neighbours), _neighbours(ring.T, options.neighbours)
    population = directed_population(ring, leave, reach, options.population, state)
    D, _ = _doubled(ring)
    pairs = np.stack([population, population + n], axis=2).reshape(len(population), 2 * n)
    best = _evolved(D, _neighbours(D, options.neighbours), pairs, state, options)
    arrivals = np.flatnonzero(best < n)
    forward = best[(arrivals[0] + 1) % (2 * n)] == best[arrivals[0]] + n
    tour = best[arrivals] if forward else best[arrivals][::-1]
    return directed_search(ring, leave, reach, tour.copy())


def _doubled(ring: np.ndarray) -> tuple[np.ndarray, float]:
    """Symmetric costs over arrivals 0..n-1 and departures n..2n-1, and the reward of each fixed pair.

    Jonker and Volgenant, Operations Research Letters 2(4), 1983, 161-163 (doi 10.1016/0167-6377(83)90048-2).
    """
    n = len(ring)
    reward = (n + 1) * float(np.ptp(ring)) + 1e-6
    D = np.full((2 * n, 2 * n), ring.max() + reward)
    D[n:, :n] = ring
    D[:n, n:] = ring.T
    pair = np.arange(n)
    D[pair, pair + n] = D[pair + n, pair] = -reward
    return D, reward


def _lower_bound(ring: np.ndarray, tour: np.ndarray, options: TourOptions) -> float:
    """A bound of closed tours over `ring`, whose best known tour is given."""
    upper = _walk(ring, tour, True)
    if np.array_equal(ring, ring.T):
        return one_tree_bound(ring, upper, max(1, options.bound_rounds))
    barred = ring.copy()
    np.fill_diagonal(barred, ring.max() + len(ring) * np.ptp(ring) + 1.0)
    rows, columns = linear_sum_assignment(barred)
    bound = float(barred[rows, columns].sum())
    if options.bound_rounds:
        D, reward = _doubled(ring)
        paid = reward * len(ring)
        bound = max(bound, one_tree_bound(D, upper - paid, options.bound_rounds) + paid)
    return bound
