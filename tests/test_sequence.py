"""The order: all placed once, rules kept, close to brute force, never under the floor."""

from dataclasses import replace
from itertools import permutations, product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import scanmotion.motion.order.sequence as mut
from scanmotion.cell.kinematics import branches, object_poses, scanner_in_object, scanner_poses
from scanmotion.core.errors import InputError
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.motion.order import lower_bound as floor_module
from scanmotion.motion.order.completeness_curve import completeness_curve
from scanmotion.motion.order.salesman.generalised_tsp import best_states
from scanmotion.motion.order.stops import natural, windings
from scanmotion.motion.order.sweeps import line_poses
from scanmotion.motion.transit_cost import (
    edge_seconds,
    jerk_limited_seconds,
    move_matrix,
    move_model,
    move_seconds,
    path_seconds,
    scanner_positions,
)

QUICK = mut.SequenceOptions(states=400, most_per_stop=24, rounds=3, effort=2_000_000)


def _viewpoint(name, azimuth, height, *, kind="station", step="local", sweep="", radius=0.8, tilt=0.0):
    n = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
    p = np.array([0.15 * np.cos(azimuth), 0.15 * np.sin(azimuth), height]) + (radius - 0.15) * n
    return Viewpoint(id=name, X_OS=look_at(p, -n), standoff=0.65, step=step, kind=kind, sweep=sweep)


def _reach(cell, viewpoint, *, angles=18, most=60):
    """Configurations without regard to collisions: table angles and two rolls, evenly thinned."""
    rows, poses = [], []
    for e1 in np.linspace(-np.pi, np.pi, angles, endpoint=False):
        for roll in (0.0, np.pi):
            turn = np.diag([np.cos(roll), np.cos(roll), 1.0, 1.0])
            X_WO = object_poses(cell, np.array([[0, 0, 0, 0, 0, 0, e1]]))[0]
            found = branches(cell, (X_WO @ viewpoint.X_OS @ turn)[None], windings=False)
            keep = found.manipulability > 0.05
            rows += [np.append(q, e1) for q in found.q[keep]]
            poses += [viewpoint.X_OS @ turn] * int(keep.sum())
    pick = np.unique(np.linspace(0, len(rows) - 1, most).astype(int)) if rows else []
    return SimpleNamespace(
        viewpoint=viewpoint,
        q=np.array([rows[i] for i in pick]).reshape(-1, 7),
        X_OS=np.array([poses[i] for i in pick]).reshape(-1, 4, 4),
        unreachable=None if rows else "out of reach",
    )


@pytest.fixture(scope="module")
def reaches(kr240_cell):
    views = [
        _viewpoint("G0", 0.0, 0.2, kind="revolution", step="global"),
        _viewpoint("G1", 0.0, 0.5, kind="revolution", step="global"),
        _viewpoint("L1", 2.0, 0.4),
        _viewpoint("L2", -1.5, 0.3, tilt=0.4),
        _viewpoint("L3", 0.4, 0.6, tilt=0.3),
    ]
    side = np.array([-np.sin(-2.5), np.cos(-2.5), 0.0])
    for k in range(3):
        view = _viewpoint(f"L4.{k + 1}", -2.5, 0.35, sweep="L4")
        X = view.X_OS.copy()
        X[:3, 3] += 0.08 * (k - 1) * side
        views.append(view.moved(X))
    return [_reach(kr240_cell, v) for v in views]


def _check_tour(cell, tour, reaches):
    """All rules that a tour keeps, whatever its order."""
    by_id = {r.viewpoint.id: r.viewpoint for r in reaches}
    served = [v for s in tour.stops for v in s.viewpoints]
    assert sorted(served + [v for v, _ in tour.unplaced]) == sorted(by_id)
    steps = [by_id[s.viewpoints[0]].step for s in tour.stops]
    assert steps == sorted(steps, key=("global", "local").index)
    for stop in tour.stops:
        for q in (stop.q_in, stop.q_out):
            assert (q >= cell.q_min - 1e-9).all() and (q <= cell.q_max + 1e-9).all()
        if stop.kind == "revolution":
            assert np.allclose(stop.q_in[:6], stop.q_out[:6])
            assert abs(stop.q_out[6] - stop.q_in[6]) == pytest.approx(2 * np.pi)
        elif stop.kind == "dwell":
            assert np.array_equal(stop.q_in, stop.q_out)
            assert _off(cell, stop.q_in, by_id[stop.viewpoints[0]]) < 1e-5
        else:
            assert np.array_equal(stop.path[0], stop.q_in) and np.array_equal(stop.path[-1], stop.q_out)
            _check_sweep(cell, stop, by_id)
    assert tour.floor <= tour.seconds + 1e-9
    model = move_model(cell)
    assert tour.seconds == pytest.approx(mut.tour_seconds(model, tour.start_q, tour.stops))


def _off(cell, q, viewpoint):
    """Greatest of the scanner's distance from the viewpoint and of the optical axes' difference."""
    X = scanner_in_object(cell, q[None])[0]
    return max(np.linalg.norm(X[:3, 3] - viewpoint.p_OS), np.linalg.norm(X[:3, 2] - viewpoint.direction))


def _check_sweep(cell, stop, by_id):
    first, last = by_id[stop.viewpoints[0]], by_id[stop.viewpoints[-1]]
    assert np.ptp(stop.path[:, 6]) == 0.0
    assert _off(cell, stop.q_in, first) < 1e-5 and _off(cell, stop.q_out, last) < 1e-5
    p = scanner_in_object(cell, stop.path)[:, :3, 3]
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() <= 0.02 + 1e-9
    assert np.abs(np.diff(stop.path, axis=0)).max() < 0.35
    along = (last.p_OS - first.p_OS) / np.linalg.norm(last.p_OS - first.p_OS)
    away = p - first.p_OS - ((p - first.p_OS) @ along)[:, None] * along
    assert np.abs(away).max() < 1e-5


@pytest.mark.parametrize("ordering", [mut.by_seconds, mut.by_distance])
def test_tour_keeps_the_rules(kr240_cell, reaches, ordering):
    tour = mut.sequence(
        kr240_cell,
        reaches,
        start_q=kr240_cell.home,
        ordering=ordering,
        rng=np.random.default_rng(0),
        options=QUICK,
        path_free=lambda path: (True, -1, ("", "")),
    )
    _check_tour(kr240_cell, tour, reaches)
    assert not tour.unplaced
    assert [s.kind for s in tour.stops].count("sweep") == 1
    if ordering is mut.by_distance:
        assert all(abs(s.q_in[6]) < 2 * np.pi + 1e-9 for s in tour.stops)


def test_default_is_faster_than_paper(kr240_cell, reaches):
    tours = [
        mut.sequence(
            kr240_cell,
            reaches,
            start_q=kr240_cell.home,
            ordering=way,
            rng=np.random.default_rng(0),
            options=QUICK,
        )
        for way in (mut.by_seconds, mut.by_distance)
    ]
    assert tours[0].seconds < tours[1].seconds
    assert tours[0].floor == pytest.approx(tours[1].floor, rel=1e-3)


def test_same_rng_same_tour(kr240_cell, reaches):
    runs = [
        mut.sequence(
            kr240_cell, reaches, start_q=kr240_cell.home, rng=np.random.default_rng(3), options=QUICK
        )
        for _ in range(2)
    ]
    for a, b in zip(runs[0].stops, runs[1].stops, strict=True):
        assert a.viewpoints == b.viewpoints and np.array_equal(a.q_in, b.q_in)


def test_kept_stops_stay_out(kr240_cell, reaches):
    def plan(start_q, keep):
        return mut.sequence(
            kr240_cell,
            reaches,
            start_q=start_q,
            rng=np.random.default_rng(0),
            options=QUICK,
            keep=keep,
        )

    whole = plan(kr240_cell.home, ())
    done = whole.stops[:3]
    rest = plan(done[-1].q_out, done)
    kept = {v for s in done for v in s.viewpoints}
    served = {v for s in rest.stops for v in s.viewpoints}
    assert not kept & served
    assert kept | served == {r.viewpoint.id for r in reaches}
    model = move_model(kr240_cell)
    joined = mut.tour_seconds(model, kr240_cell.home, (*done, *rest.stops))
    assert joined <= 1.1 * whole.seconds


def test_blocked_sweep_becomes_dwells(kr240_cell, reaches):
    tour = mut.sequence(
        kr240_cell,
        reaches,
        start_q=kr240_cell.home,
        rng=np.random.default_rng(0),
        options=QUICK,
        path_free=lambda path: (False, 0, ("scanner", "part")),
    )
    _check_tour(kr240_cell, tour, reaches)
    assert [s.kind for s in tour.stops].count("dwell") == 6


def test_unreachable_viewpoints_are_named(kr240_cell, reaches):
    lost = _reach(kr240_cell, _viewpoint("L9", 0.0, 0.4, radius=9.0))
    tour = mut.sequence(
        kr240_cell, [*reaches[:2], lost], start_q=kr240_cell.home, rng=np.random.default_rng(0), options=QUICK
    )
    assert tour.unplaced == (("L9", "out of reach"),)
    assert len(tour.stops) == 2


def test_nothing_to_do(kr240_cell):
    tour = mut.sequence(kr240_cell, [], start_q=kr240_cell.home, rng=np.random.default_rng(0))
    assert tour.stops == () and tour.seconds == 0.0 and tour.floor == 0.0


@pytest.mark.parametrize("bad", [{"start_q": np.zeros(6)}, {"start_q": np.full(7, np.nan)}])
def test_bad_input_is_one_clear_line(kr240_cell, bad):
    keywords = {"start_q": kr240_cell.home, **bad}
    with pytest.raises(InputError):
        mut.sequence(kr240_cell, [], rng=np.random.default_rng(0), **keywords)


def _brute_force(model, start_q, reaches):
    """Least seconds over all orders, dynamic programming over all configurations of each."""
    groups = [
        np.array([[*q[:6], e] for q in r.q for e in windings(q[6], -3 * np.pi, 3 * np.pi)]) for r in reaches
    ]
    first = np.cumsum([0] + [len(g) for g in groups])
    q = np.vstack(groups)
    C = move_matrix(model, q, q)
    head, tail = move_matrix(model, start_q, q)[0], np.zeros(len(q))
    states = np.empty(len(groups), dtype=np.int64)
    CT = np.ascontiguousarray(C.T)
    orders = permutations(range(len(groups)))
    return min(best_states(CT, head, tail, first, np.array(o), states) for o in orders)


@pytest.mark.parametrize("seed", range(3))
def test_close_to_brute_force_and_above_the_floor(kr240_cell, seed):
    rng = np.random.default_rng(seed)
    views = [
        _viewpoint(f"L{k}", rng.uniform(-3, 3), rng.uniform(0.2, 0.6), tilt=rng.uniform(-0.2, 0.5))
        for k in range(5)
    ]
    reaches = [_reach(kr240_cell, v, most=30) for v in views]
    model = move_model(kr240_cell)
    best = _brute_force(model, kr240_cell.home, reaches) + 5 * model.dwell_s
    tour = mut.sequence(
        kr240_cell, reaches, start_q=kr240_cell.home, rng=np.random.default_rng(0), options=QUICK
    )
    assert tour.floor <= best + 1e-9
    assert best - 1e-9 <= tour.seconds <= 1.03 * best


def test_best_states_equals_enumeration():
    rng = np.random.default_rng(0)
    first = np.array([0, 3, 5, 9])
    C, head, tail = rng.random((9, 9)), rng.random(9), rng.random(9)
    order, states = np.array([2, 0, 1]), np.empty(3, dtype=np.int64)
    found = best_states(np.ascontiguousarray(C.T), head, tail, first, order, states)
    choices = product(*(range(first[g], first[g + 1]) for g in order))
    best = min(head[a] + C[a, b] + C[b, c] + tail[c] for a, b, c in choices)
    assert found == pytest.approx(best)
    a, b, c = states
    assert head[a] + C[a, b] + C[b, c] + tail[c] == pytest.approx(best)


# --- seconds -----------------------------------------------------------------------------------------------


def test_move_model_has_the_cells_kinematics(kr240_cell):
    model = move_model(kr240_cell)
    q = np.random.default_rng(0).uniform(-2, 2, (50, 7))
    assert np.abs(scanner_positions(model, q) - scanner_poses(kr240_cell, q)[:, :3, 3]).max() < 1e-12


def test_moves_take_no_less_than_any_limit_allows(kr240_cell):
    rng = np.random.default_rng(1)
    qa, qb = rng.uniform(-1, 1, (2, 200, 7))
    model = move_model(kr240_cell)
    seconds = edge_seconds(kr240_cell, qa, qb)
    d = np.abs(qb - qa)
    way = np.linalg.norm(scanner_positions(model, qb) - scanner_positions(model, qa), axis=1)
    assert (seconds >= way / model.transit_speed).all()
    assert (seconds >= (d / model.v).max(axis=1)).all()
    assert np.allclose(seconds, move_seconds(model, qb, qa))
    assert np.allclose(np.diag(move_matrix(model, qa, qb)), seconds)
    assert (edge_seconds(kr240_cell, qa, qa) == 0.0).all()


@settings(max_examples=100)
@given(*(st.floats(-3, 1) for _ in range(4)))
def test_jerk_limited_seconds_equal_ruckig(length, v, a, j):
    from ruckig import InputParameter, Ruckig, Trajectory

    length, v, a, j = 10.0**length, 10.0**v, 10.0**a, 10.0 ** (j + 1)
    asked, solved = InputParameter(1), Trajectory(1)
    asked.current_position, asked.target_position = [0.0], [length]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [v], [a], [j]
    Ruckig(1).calculate(asked, solved)
    assert float(jerk_limited_seconds(length, v, a, j)) == pytest.approx(solved.duration, rel=1e-6)


def test_sweep_seconds_are_length_over_speed_and_ramps(kr240_cell, reaches):
    tour = mut.sequence(
        kr240_cell, reaches[5:], start_q=kr240_cell.home, rng=np.random.default_rng(0), options=QUICK
    )
    model = move_model(kr240_cell)
    (sweep,) = tour.stops
    assert 0.16 / model.scan_speed < path_seconds(model, sweep.path) < 0.16 / model.scan_speed + 0.5


# --- floor -------------------------------------------------------------------------------------------------


def _ends(model, points, stages=None, free=()):
    n = len(points)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    azimuth[list(free)] = np.nan
    return floor_module.Ends(
        radius=np.hypot(points[:, 0], points[:, 1]),
        height=points[:, 2],
        azimuth=azimuth,
        slack=np.zeros(n),
        stage=np.array([-1] + [1] * (n - 1) if stages is None else stages),
        mate=np.arange(n),
    )


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_pair_floor_is_the_least_over_a_dense_sweep_of_table_turns(kr240_cell, seed):
    model = move_model(kr240_cell)
    points = np.random.default_rng(seed).uniform(-1, 1, (2, 3))
    least = floor_module.least_pair_seconds(model, _ends(model, points))[0, 1]
    turns = np.linspace(-np.pi, np.pi, 20001)
    c, s = np.cos(turns), np.sin(turns)
    moved = np.column_stack([c * points[1, 0] - s * points[1, 1], s * points[1, 0] + c * points[1, 1]])
    way = np.hypot(np.linalg.norm(moved - points[0, :2], axis=1), points[1, 2] - points[0, 2])
    table = jerk_limited_seconds(np.abs(turns), model.v[6], model.a[6], model.j[6])
    arm = floor_module.travel_seconds(model, way, model.transit_speed)
    dense = float(np.maximum(arm, table).min())
    assert least <= dense + 1e-9
    assert least >= dense - 2e-3


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.booleans())
def test_order_floor_never_passes_brute_force(kr240_cell, seed, ascend):
    model = move_model(kr240_cell)
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (6, 3))
    ends = _ends(model, points, stages=np.array([-1, 0, 0, 1, 1, 1]), free=(1, 2))
    pair = floor_module.least_pair_seconds(model, ends)
    best = min(
        sum(pair[a, b] for a, b in zip((0, *g, *h), (*g, *h), strict=False))
        for g in permutations((1, 2))
        for h in permutations((3, 4, 5))
    )
    before = floor_module.EXACT_UP_TO
    try:
        floor_module.EXACT_UP_TO = 0 if ascend else before
        found = floor_module.least_transit_seconds(ends, pair)
    finally:
        floor_module.EXACT_UP_TO = before
    assert found <= best + 1e-9
    assert found >= (0.85 if ascend else 1.0) * best - 1e-9


def test_scanner_cannot_start_faster_than_the_floor_says(kr240_cell):
    model = move_model(kr240_cell)
    jerk = floor_module.scanner_jerk(model)
    q = np.random.default_rng(0).uniform(kr240_cell.q_min[:6], kr240_cell.q_max[:6], (3000, 6))
    t, dq = 0.01, 1e-6
    q = np.column_stack([q, np.zeros(3000)])
    for signs in ((1, 1, 1, 1, 1, 1), (1, -1, 1, -1, 1, -1), (1, 1, -1, 1, 1, 1)):
        rate = np.append(np.array(signs) * model.j[:6] * t * t / 2, 0.0)
        step = scanner_positions(model, q + dq * rate) - scanner_positions(model, q)
        assert np.linalg.norm(step, axis=1).max() / dq <= jerk * t * t / 2 * (1 + 1e-6)


def test_slack_lowers_the_floor(kr240_cell, reaches):
    def floor_of(slack):
        loose = [
            SimpleNamespace(**{**vars(r), "viewpoint": replace(r.viewpoint, slack=slack)}) for r in reaches
        ]
        return mut.sequence(
            kr240_cell, loose, start_q=kr240_cell.home, rng=np.random.default_rng(0), options=QUICK
        ).floor

    assert floor_of(Slack(standoff=(-0.05, 0.05), tilt=0.1)) < floor_of(Slack()) - 1.0


# --- small parts -------------------------------------------------------------------------------------------


def test_windings_stay_inside():
    assert np.allclose(windings(0.5, -7.0, 7.0), [0.5 - 2 * np.pi, 0.5, 0.5 + 2 * np.pi])
    assert np.allclose(windings(np.pi, -np.pi, np.pi), [-np.pi, np.pi])
    assert len(windings(2.0, -1.0, 1.0)) == 0


def test_natural_order_of_ids():
    assert sorted(["L1.10", "L1.2", "G0", "L2.1"], key=natural) == ["G0", "L1.2", "L1.10", "L2.1"]


def test_line_poses_are_straight_and_dense():
    a = look_at(np.array([0.8, -0.1, 0.3]), np.array([-1.0, 0.1, 0.0]))
    b = look_at(np.array([0.8, 0.23, 0.35]), np.array([-1.0, -0.1, 0.0]))
    X = line_poses([a, b])
    assert np.allclose(X[0], a) and np.allclose(X[-1], b)
    gaps = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1)
    assert gaps.max() <= 0.02 and np.ptp(gaps) < 1e-12


def test_completeness_curve_falls_with_seconds(kr240_cell, reaches):
    tour = mut.sequence(
        kr240_cell, reaches, start_q=kr240_cell.home, rng=np.random.default_rng(0), options=QUICK
    )
    rng = np.random.default_rng(0)
    coverage = {r.viewpoint.id: rng.random(500) < 0.3 for r in reaches}
    model = move_model(kr240_cell)
    curve = completeness_curve(coverage, tour, model=model)
    assert curve[0].seconds == tour.seconds and curve[0].dropped == ()
    assert curve[0].completeness == pytest.approx(np.any(list(coverage.values()), axis=0).mean())
    assert curve[-1].completeness == 0.0 and curve[-1].seconds == pytest.approx(0.0, abs=1e-6)
    seconds, shares = [p.seconds for p in curve], [p.completeness for p in curve]
    assert all(np.diff(seconds) <= 1e-9) and all(np.diff(shares) <= 1e-12)
    for point in curve:
        left = [s for s in tour.stops if not set(s.viewpoints) & set(point.dropped)]
        assert point.seconds == pytest.approx(mut.tour_seconds(model, tour.start_q, left), abs=1e-6)
