"""The tour: exact small cases, proven optima, bounds that bound, determinism, reductions."""

import json
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import scanmotion.motion.order.salesman.tsp as mut
from scanmotion.core.errors import InputError
from scanmotion.motion.order.salesman.local_search import local_search, tour_cost
from scanmotion.motion.order.salesman.tour_bound import best_closed_tour, one_tree_bound


def _distances(points):
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def _value(cost, order, closed):
    total = sum(cost[a, b] for a, b in pairwise(order))
    return total + cost[order[-1], order[0]] if closed else total


def _brute_force(cost, closed, start, end):
    orders = [
        p
        for p in permutations(range(len(cost)))
        if (start is None or p[0] == start) and (end is None or p[-1] == end)
    ]
    return min(_value(cost, p, closed) for p in orders)


def _case(seed, n, symmetric):
    rng = np.random.default_rng(seed)
    cost = _distances(rng.random((n, 2))) if symmetric else rng.random((n, n))
    np.fill_diagonal(cost, 0.0)
    return cost


ENDS = [
    (True, None, None),
    (True, 2, None),
    (False, None, None),
    (False, 1, None),
    (False, None, 2),
    (False, 1, 3),
]


@pytest.mark.parametrize("exact_up_to", [12, 0])
@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(5, 7), st.booleans(), st.sampled_from(ENDS))
def test_equals_brute_force_for_all_ends(exact_up_to, seed, n, symmetric, ends):
    closed, start, end = ends
    cost = _case(seed, n, symmetric)
    options = mut.TourOptions(exact_up_to=exact_up_to)
    result = mut.tour_from_cost(
        cost, closed=closed, start=start, end=end, rng=np.random.default_rng(seed), options=options
    )
    best = _brute_force(cost, closed, start, end)
    assert sorted(result.order) == list(range(n))
    assert start is None or result.order[0] == start
    assert end is None or result.order[-1] == end
    assert result.cost == pytest.approx(_value(cost, result.order, closed), abs=1e-12)
    assert result.cost == pytest.approx(best, abs=1e-9)
    assert result.lower_bound <= best + 1e-9
    assert result.exact or exact_up_to == 0


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from(ENDS))
def test_search_finds_the_optimum_of_twelve_and_the_bound_holds(seed, symmetric, ends):
    closed, start, end = ends
    cost = _case(seed, 12, symmetric)
    best = mut.tour_from_cost(cost, closed=closed, start=start, end=end, rng=np.random.default_rng(0))
    found = mut.tour_from_cost(
        cost,
        closed=closed,
        start=start,
        end=end,
        rng=np.random.default_rng(0),
        options=mut.TourOptions(exact_up_to=0),
    )
    assert best.exact
    assert found.cost == pytest.approx(best.cost, rel=1e-9)
    assert found.lower_bound <= best.cost + 1e-9
    assert found.lower_bound >= 0.8 * best.cost


def _solve_to_optimality(cost):
    """Closed asymmetric optimum by CP-SAT's circuit constraint, proven; costs are rounded to 1e-6."""
    from ortools.sat.python import cp_model

    model = cp_model.CpModel()
    n = len(cost)
    arcs = [(i, j, model.new_bool_var(f"{i}.{j}")) for i in range(n) for j in range(n) if i != j]
    model.add_circuit(arcs)
    model.minimize(sum(round(cost[i, j] * 1e6) * x for i, j, x in arcs))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 2
    assert solver.solve(model) == cp_model.OPTIMAL
    return solver.objective_value * 1e-6


@pytest.mark.parametrize("symmetric", [True, False])
def test_equals_the_proven_optimum_of_an_independent_solver(symmetric):
    cost = _case(7, 30, symmetric)
    result = mut.tour_from_cost(cost, closed=True, rng=np.random.default_rng(1))
    best = _solve_to_optimality(cost)
    assert result.cost == pytest.approx(best, abs=30e-6)
    assert result.lower_bound <= best + 30e-6


def test_airbus_targets_reach_the_proven_optima(shared_data):
    file = json.loads((shared_data / "robotsp" / "airbus_100.json").read_text())
    targets = np.array(file["targets"])
    for n, best in file["exact_tour_m"].items():
        cost = _distances(targets[: int(n)])
        result = mut.tour_from_cost(cost, closed=True, rng=np.random.default_rng(0))
        assert result.cost == pytest.approx(best, rel=1e-6)
        assert result.lower_bound <= best * (1 + 1e-6)


def test_245_cities_stay_within_half_a_percent_of_the_bound():
    cost = _distances(np.random.default_rng(3).random((245, 2)))
    result = mut.tour_from_cost(cost, closed=True, rng=np.random.default_rng(0))
    # The Held-Karp bound itself lies up to about 0.8 % under the optimum of such instances.
    assert result.gap <= 0.012


def test_cities_on_a_circle_are_proven_best():
    angles = np.random.default_rng(0).permutation(40) * 2 * np.pi / 40
    cost = _distances(np.column_stack([np.cos(angles), np.sin(angles)]))
    result = mut.tour_from_cost(cost, closed=True, rng=np.random.default_rng(0))
    assert result.cost == pytest.approx(80 * np.sin(np.pi / 40), rel=1e-12)
    assert result.exact


def test_cities_on_a_line_with_both_ends_fixed_inside():
    x = np.arange(20.0)
    cost = np.abs(x[:, None] - x[None])
    result = mut.tour_from_cost(cost, start=5, end=12, rng=np.random.default_rng(0))
    assert result.order[0] == 5 and result.order[-1] == 12
    assert result.cost == pytest.approx(5 + 19 + 7)


def test_asymmetric_ring_is_walked_the_cheap_way():
    n = 60
    ahead = (np.arange(n)[None] - np.arange(n)[:, None]) % n
    result = mut.tour_from_cost(ahead.astype(float), closed=True, rng=np.random.default_rng(0))
    assert result.cost == n and result.exact


def test_same_rng_same_tour():
    for symmetric in (True, False):
        cost = _case(5, 80, symmetric)
        runs = [mut.tour_from_cost(cost, closed=True, rng=np.random.default_rng(9)) for _ in range(2)]
        assert np.array_equal(runs[0].order, runs[1].order)


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(5, 40))
def test_local_search_keeps_a_permutation_and_is_a_local_optimum(seed, n):
    rng = np.random.default_rng(seed)
    cost = _distances(rng.random((n, 2)))
    near = np.argsort(cost + np.diag([np.inf] * n), axis=1)[:, : n - 1].copy()
    tour = rng.permutation(n)
    before = tour_cost(cost, tour)
    pos = np.argsort(tour)
    local_search(cost, near, tour, pos)
    assert sorted(tour) == list(range(n))
    assert np.array_equal(pos, np.argsort(tour))
    after = tour_cost(cost, tour)
    assert after <= before + 1e-12
    for i in range(n - 1):
        for j in range(i + 2, n):
            turned = np.concatenate([tour[: i + 1], tour[i + 1 : j + 1][::-1], tour[j + 1 :]])
            assert tour_cost(cost, turned) >= after - 1e-9


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(4, 9), st.booleans())
def test_one_tree_bound_never_passes_the_optimum(seed, n, constant):
    cost = np.ones((n, n)) if constant else _case(seed, n, True)
    best = tour_cost(cost, best_closed_tour(cost))
    assert one_tree_bound(cost, best, 200) <= best * (1 + 1e-12)


def test_edge_sizes():
    rng = np.random.default_rng(0)
    one = mut.tour_from_cost(np.zeros((1, 1)), rng=rng)
    assert list(one.order) == [0] and one.cost == 0 and one.exact
    two = mut.tour_from_cost(np.array([[0, 3.0], [5.0, 0]]), rng=rng)
    assert list(two.order) == [0, 1] and two.cost == 3
    closed = mut.tour_from_cost(np.array([[0, 3.0], [5.0, 0]]), closed=True, start=1, rng=rng)
    assert list(closed.order) == [1, 0] and closed.cost == 8
    same = mut.tour_from_cost(np.zeros((30, 30)), closed=True, rng=rng)
    assert same.cost == 0 and same.exact


@pytest.mark.parametrize(
    ("cost", "keywords", "words"),
    [
        (np.zeros((2, 3)), {}, "square"),
        (np.zeros((0, 0)), {}, "square"),
        (np.array([[0, np.nan], [1, 0]]), {}, "from 0 to 1 is nan"),
        (np.zeros((3, 3)), {"start": 3}, "start 3"),
        (np.zeros((3, 3)), {"start": 1, "end": 1}, "both start and end"),
        (np.zeros((3, 3)), {"closed": True, "end": 1}, "closed"),
    ],
)
def test_bad_input_is_one_clear_line(cost, keywords, words):
    with pytest.raises(InputError, match=words):
        mut.tour_from_cost(cost, rng=np.random.default_rng(0), **keywords)
