"""Order and configurations together: 170 targets in 6 configurations each, PyVRP and OR-Tools beside it.

    python benchmarks/tour_groups.py [--seconds 5] [--long 40] [--starts 4]

The targets are the feasible viewpoints of the ring of benchmarks/reach.py on the cell `kr240`, six spread
configurations each; costs are the seconds of transits between all 1,020 of them. One configuration of each
target is to be visited, from home, with no way back.

- decoupled: the shortest order over the least costs between targets, then the best configurations for it
- the genetic algorithm of the default path (order crossover, removals, 2-opt, dynamic programming), and the
  same work without crossover: its best individual improved alone
- PyVRP's client groups (`pip install pyvrp`) and OR-Tools' disjunctions, each by the clock
- a lower bound: Held and Karp's over the least costs between targets

Our searches stop by work done, and their seconds are of processor time; the others stop by the clock. Exit
status 1 where ours is worse than PyVRP's long run, or crossover does not pay on average.
"""

import argparse
import sys
import time
from itertools import pairwise

import numpy as np
from reach import MANY, ring, ring_cell

from scanmotion.cell.collision.clearance import Clearance
from scanmotion.motion.order.salesman.generalised_tsp import best_states, search
from scanmotion.motion.order.salesman.tsp import TourOptions, tour_from_cost
from scanmotion.motion.reach.find import reach
from scanmotion.motion.transit_cost import move_matrix, move_model

PER_TARGET = 6
MOST_OUT = 8
POPULATION, CHILDREN, SHAKES = 5, 10, 1500


def instance() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Costs between states (N, N), from home (N,) [s], and the first state of each group and N (m + 1,)."""
    cell = ring_cell()
    found = [r for r in reach(cell, ring(17), clearance=Clearance(cell), options=MANY) if len(r.q)]
    rows = [r.q[np.unique(np.linspace(0, len(r.q) - 1, PER_TARGET).astype(int))] for r in found]
    q, model = np.concatenate(rows), move_model(cell)
    first = np.cumsum([0, *map(len, rows)])
    return move_matrix(model, q, q), move_matrix(model, cell.home, q)[0], first


def between_groups(C: np.ndarray, head: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Least costs between groups and home, from any to which the way is free, shape (m + 1, m + 1)."""
    m = len(first) - 1
    closed = np.zeros((m + 1, m + 1))
    closed[:m, :m] = np.minimum.reduceat(np.minimum.reduceat(C, first[:-1], axis=0), first[:-1], axis=1)
    closed[m, :m] = np.minimum.reduceat(head, first[:-1])
    np.fill_diagonal(closed, 0.0)
    return closed


def genetic(C: np.ndarray, head: np.ndarray, first: np.ndarray, seed: int, *, crossover: bool) -> float:
    """Seconds of the tour that the default path's search finds; without crossover with the same work."""
    rng, m, n = np.random.default_rng(seed), len(first) - 1, len(head)
    population, children, shakes = POPULATION, CHILDREN, SHAKES
    if not crossover:
        population, children, shakes = 1, 0, SHAKES * (POPULATION + CHILDREN)
    seeds = np.array([rng.permutation(m) for _ in range(population)])
    return search(
        C, np.ascontiguousarray(C.T), head, np.zeros(n), first, np.arange(n), np.zeros(m, np.int64), seeds,
        children, shakes, max(1, min(MOST_OUT, m // 2)), np.array([seed + 1], dtype=np.uint64),
    )[2]  # fmt: skip


def decoupled(C: np.ndarray, head: np.ndarray, first: np.ndarray) -> float:
    """The order first, over the least costs, then the configurations."""
    m = len(first) - 1
    tour = tour_from_cost(between_groups(C, head, first), closed=True, start=m, rng=np.random.default_rng(0))
    order, states = np.array(tour.order[1:]), np.empty(m, dtype=np.int64)
    return best_states(np.ascontiguousarray(C.T), head, np.zeros(len(head)), first, order, states)


def pyvrp_tour(C: np.ndarray, head: np.ndarray, first: np.ndarray, seconds: float) -> float | None:
    """PyVRP with one client group a target; None where it is not installed."""
    try:
        from pyvrp import Model
        from pyvrp.stop import MaxRuntime
    except ImportError:
        return None
    model, scale, n = Model(), 1000, len(head)
    start = model.add_location(0, 0)
    model.add_depot(start)
    groups = [model.add_client_group(required=True) for _ in range(len(first) - 1)]
    owner = np.repeat(np.arange(len(groups)), np.diff(first))
    places = [model.add_location(0, 0) for _ in range(n)]
    for place, g in zip(places, owner, strict=True):
        model.add_client(place, required=False, group=groups[g])
    model.add_vehicle_type(1)
    for i in range(n):
        model.add_edge(start, places[i], distance=round(float(head[i]) * scale))
        model.add_edge(places[i], start, distance=0)
        for j in np.flatnonzero(owner != owner[i]):
            model.add_edge(places[i], places[j], distance=round(float(C[i, j]) * scale))
    found = model.solve(stop=MaxRuntime(seconds), seed=0, display=False)
    return float(found.cost()) / scale if found.is_feasible() else np.inf


def or_tools_groups(C: np.ndarray, head: np.ndarray, first: np.ndarray, seconds: int) -> float:
    """OR-Tools' routing solver with one disjunction a target and guided local search."""
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    n = len(head)
    whole = np.zeros((n + 1, n + 1), dtype=int)
    whole[:n, :n] = np.round(C * 1000)
    whole[n, :n] = np.round(head * 1000)
    rows = whole.tolist()
    manager = pywrapcp.RoutingIndexManager(n + 1, 1, n)
    routing = pywrapcp.RoutingModel(manager)

    def step(i: int, j: int) -> int:
        return rows[manager.IndexToNode(i)][manager.IndexToNode(j)]

    routing.SetArcCostEvaluatorOfAllVehicles(routing.RegisterTransitCallback(step))
    for a, b in pairwise(first):
        routing.AddDisjunction([manager.NodeToIndex(int(i)) for i in range(a, b)], 10**7, 1)
    asked = pywrapcp.DefaultRoutingSearchParameters()
    asked.first_solution_strategy = routing_enums_pb2.FirstSolutionStrategy.PATH_CHEAPEST_ARC
    asked.local_search_metaheuristic = routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    asked.time_limit.seconds = seconds
    solution = routing.SolveWithParameters(asked)
    return np.inf if solution is None else solution.ObjectiveValue() / 1000


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--seconds", type=int, default=5)
    asked.add_argument("--long", type=int, default=40)
    asked.add_argument("--starts", type=int, default=4)
    given = asked.parse_args()
    C, head, first = instance()
    closed, m = between_groups(C, head, first), len(first) - 1
    bound = tour_from_cost(
        closed, closed=True, start=m, rng=np.random.default_rng(0), options=TourOptions(bound_rounds=300)
    ).lower_bound
    print(f"{m} targets, {len(head)} configurations; lower bound {bound:.1f} s")
    print(f"decoupled: {decoupled(C, head, first):.1f} s")
    genetic(C[:12, :12], head[:12], np.array([0, 6, 12]), 0, crossover=True)
    mean = {}
    for crossover in (True, False):
        began, costs = time.process_time(), []
        for seed in range(given.starts):
            costs.append(genetic(C, head, first, seed, crossover=crossover))
        took, name = (time.process_time() - began) / given.starts, "with" if crossover else "without"
        mean[crossover] = float(np.mean(costs))
        print(
            f"ours {name} crossover: mean {mean[crossover]:.1f} s, least {min(costs):.1f}, "
            f"greatest {max(costs):.1f}; {took:.1f} s of CPU each"
        )
    print(f"OR-Tools, {given.seconds} s: {or_tools_groups(C, head, first, given.seconds):.1f} s")
    theirs = None
    for seconds in (given.seconds, given.long):
        theirs = pyvrp_tour(C, head, first, seconds)
        told = "not installed" if theirs is None else f"{theirs:.1f} s"
        print(f"PyVRP's client groups, {seconds} s: {told}")
    return int(mean[True] > mean[False] or (theirs is not None and mean[True] > theirs))


if __name__ == "__main__":
    sys.exit(main())
