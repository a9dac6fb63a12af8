"""Timing: limits by finite differences, closed forms, toppra and Ruckig as independent oracles."""

import copy
import logging
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanmotion.core.errors import TimingError
from scanmotion.core.tour import Path, Stop, Tour
from scanmotion.motion.profile import toppra_profile as module
from scanmotion.motion.profile.jerk_limited import fastest_law, ruckig_law
from scanmotion.motion.profile.speed_profile import (
    Derivatives,
    Limits,
    fastest_profile,
    parameter_grid,
    profile_floor,
    speed_caps,
)
from scanmotion.motion.profile.spline import corner_cut, spline_beside, spline_through, subdivided
from scanmotion.motion.profile.toppra_profile import toppra_profile
from scanmotion.motion.timing.operations import transit_motion
from scanmotion.motion.transit import drive

LIMITS = Limits(
    v=np.array([1.8, 1.6, 1.7, 3.0, 2.3, 3.6, 1.05]),
    a=np.array([2.5, 1.6, 3.5, 7.4, 5.6, 9.0, 0.5]),
    j=np.array([25.0, 16.0, 35.0, 74.0, 56.0, 90.0, 5.0]),
    tcp=np.inf,
)
LOW = np.radians([-60, -110, 50, -90, -100, -150, -170])
HIGH = np.radians([60, -40, 130, 90, 100, 150, 170])


def joint_path(rng, vertices):
    """A curve beside a random polyline, and its derivatives; the "scanner" is its first three joints."""
    q = rng.uniform(LOW, HIGH, size=(vertices, 7))
    path = spline_beside(subdivided(q, q[:, :3]))
    s = parameter_grid(path)
    return path, derivatives(path, s, lambda x: np.linalg.norm(path(x, 1)[:, :3], axis=1))


def derivatives(path, s, tcp):
    return Derivatives(s=s, q1=path(s, 1), q2=path(s, 2), q3=path(s, 3), tcp=tcp)


def largest(q, dt, order, limit):
    return float((np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / dt**order / limit).max())


# --- curves ---------------------------------------------------------------------------------------------


def test_spline_on_a_straight_even_polyline_is_the_line(rng):
    a, b = rng.uniform(LOW, HIGH, size=(2, 7))
    control = subdivided(np.array([a, b]), np.zeros((2, 3)))
    path = spline_beside(control)
    u = np.linspace(0, path.end, 777)
    line = a + (u / path.end)[:, None] * (b - a)
    assert np.abs(path(u) - line).max() < 1e-13
    assert corner_cut(control) < 1e-12


@given(st.integers(0, 10**6), st.integers(3, 12))
@settings(max_examples=40)
def test_spline_stays_within_the_stated_distance_of_its_polygon(seed, n):
    control = np.random.default_rng(seed).normal(size=(n, 7))
    path = spline_beside(control)
    u = np.linspace(0, path.end, 20 * n)
    k = np.minimum(u.astype(int), n - 2)
    chord = control[k] + (u - k)[:, None] * (control[k + 1] - control[k])
    assert np.linalg.norm(path(u) - chord, axis=1).max() <= corner_cut(control) + 1e-12
    assert np.abs(path(np.array([0.0, path.end])) - control[[0, -1]]).max() < 1e-12


def test_a_right_angle_is_cut_by_a_sixth_of_its_second_difference():
    control = np.zeros((9, 7))
    control[:5, 0] = np.arange(-4, 1)
    control[5:, 1] = np.arange(1, 5)
    at_corner = spline_beside(control)(np.array([4.0]))[0]
    assert np.linalg.norm(at_corner) == pytest.approx(np.sqrt(2) / 6, rel=1e-12)
    assert corner_cut(control) == pytest.approx(np.sqrt(2) / 6, rel=1e-12)


def test_subdivided_keeps_vertices_and_steps_small(rng):
    q = rng.uniform(LOW, HIGH, size=(5, 7))
    p = q[:, :3]
    dense = subdivided(q, p, step_rad=0.05, step_m=0.1)
    assert np.abs(np.diff(dense, axis=0)).max() <= 0.05 + 1e-12
    for vertex in q:
        assert np.abs(dense - vertex).max(axis=1).min() < 1e-12
    again = subdivided(dense, dense[:, :3], step_rad=0.05, step_m=0.1)
    assert np.array_equal(again, dense)


def test_spline_through_points_meets_them(rng):
    at = np.linspace(0, 1, 9)
    q = rng.normal(size=(9, 7))
    assert np.abs(spline_through(q, at)(at) - q).max() < 1e-12
    assert np.abs(spline_through(q[:2], at[:2])(at[:2]) - q[:2]).max() < 1e-12


# --- laws -----------------------------------------------------------------------------------------------


def toppra_seconds(path, d, limits):
    """Duration by the toppra library on the same grid."""
    toppra = pytest.importorskip("toppra")
    logging.getLogger("toppra").setLevel(logging.ERROR)
    from toppra import algorithm, constraint, interpolator

    class Curve(interpolator.AbstractGeometricPath):
        dof = 7
        waypoints = None
        path_interval = np.array([0.0, path.end])

        def __call__(self, at, order=0):
            rows = path(np.atleast_1d(at), order)
            return rows[0] if np.ndim(at) == 0 else rows

    both = [
        constraint.JointVelocityConstraint(np.column_stack([-limits.v, limits.v])),
        constraint.JointAccelerationConstraint(np.column_stack([-limits.a, limits.a])),
    ]
    solver = algorithm.TOPPRA(both, Curve(), gridpoints=d.s, solver_wrapper="seidel")
    v = solver.compute_parameterization(0, 0)[1]
    assert toppra is not None
    return float((2 * np.diff(d.s) / (v[:-1] + v[1:])).sum())


@pytest.mark.parametrize("seed", range(4))
def test_floor_agrees_with_toppra(seed):
    path, d = joint_path(np.random.default_rng(seed), 2 + seed)
    ours = profile_floor(d, LIMITS)
    theirs = toppra_seconds(path, d, LIMITS)
    # Ours takes the velocity bound over neighbouring grid points too, and leaves a margin of 0.05%.
    assert theirs <= ours * (1 + 1e-6)
    assert ours <= theirs * 1.002


@given(st.floats(0.05, 3.0), st.integers(0, 6))
@settings(max_examples=25)
def test_single_joint_is_close_to_the_jerk_limited_optimum(distance, joint):
    ends = np.zeros((2, 7))
    ends[1, joint] = distance
    path = spline_beside(subdivided(ends, np.zeros((2, 3))))
    s = parameter_grid(path)
    d = derivatives(path, s, lambda x: 0 * x)
    law = fastest_law(path, d, LIMITS)
    best = ruckig_law(distance, LIMITS.v[joint], LIMITS.a[joint], LIMITS.j[joint])
    assert best.duration <= law.duration * (1 + 1e-6)
    assert law.duration <= 1.06 * best.duration + 0.01
    v, a = LIMITS.v[joint], LIMITS.a[joint]
    free = distance / v + v / a if distance > v * v / a else 2 * np.sqrt(distance / a)
    assert law.floor == pytest.approx(free, rel=0.01)


@given(st.integers(0, 10**6), st.integers(2, 4), st.floats(0.05, 2.0))
@settings(max_examples=15)
def test_law_keeps_every_limit_and_comes_to_rest(seed, vertices, tcp):
    path, d = joint_path(np.random.default_rng(seed), vertices)
    limits = Limits(v=LIMITS.v, a=LIMITS.a, j=LIMITS.j, tcp=tcp)
    law = fastest_law(path, d, limits)
    t = np.arange(0.0, law.duration + 0.001, 0.001)
    rows = law(t)
    q = path(rows[:, 0])
    assert largest(q, 0.001, 1, limits.v) <= 1.001
    assert largest(q, 0.001, 2, limits.a) <= 1.001
    assert largest(q, 0.001, 3, limits.j) <= 1.001
    speed = np.linalg.norm(np.diff(q[:, :3], axis=0), axis=1).max() / 0.001
    assert speed <= 1.001 * tcp
    assert (np.diff(rows[:, 0]) >= -1e-12).all()
    ends = law(np.array([0.0, law.duration]))
    assert ends[0, 0] == 0.0 and ends[1, 0] == pytest.approx(path.end, abs=1e-9)
    assert np.abs(ends[:, 1:3]).max() < 1e-6
    assert law.duration >= law.floor
    for order in (0, 1):
        slope = np.gradient(rows[:, order], t)[2:-2]
        scale = max(1.0, np.abs(rows[:, order + 1]).max())
        assert np.abs(slope - rows[2:-2, order + 1]).max() < 0.05 * scale


def test_one_metre_at_a_tenth_of_a_metre_per_second():
    law = ruckig_law(1.0, 0.1, 0.5, 5.0)
    assert law.duration == pytest.approx(10.3, abs=1e-9)
    t = np.linspace(0, law.duration, 10301)
    rows = law(t)
    assert np.isclose(rows[:, 1], 0.1, atol=1e-12).mean() > 0.94
    assert np.abs(np.gradient(rows[:, 0], t) - rows[:, 1])[1:-1].max() < 1e-5
    assert rows[-1] == pytest.approx([1.0, 0.0, 0.0, rows[-1, 3]], abs=1e-9)


@pytest.mark.parametrize("through", [False, True])
def test_what_a_law_is_checked_by_is_the_same_as_by_scipy(through):
    from scanmotion.motion.profile import jerk_limited as scale

    rng = np.random.default_rng(3)
    path, d = joint_path(rng, 5)
    law = fastest_law(path, d, LIMITS)
    if through:
        # A quintic, passed over the same parameters.
        path = spline_through(rng.normal(size=(12, 7)), np.linspace(0, path.end, 12))
    over = scale._excess(path, lambda s: 0.0 * s, law, LIMITS, 0.002)
    s, s1, s2, s3 = law(over.t).T[:, :, None]
    q1, q2, q3 = (path(s[:, 0], k) for k in (1, 2, 3))
    shares = np.stack(
        [
            np.abs(q1 * s1) / LIMITS.v,
            np.sqrt(np.abs(q2 * s1**2 + q1 * s2) / LIMITS.a),
            np.cbrt(np.abs(q3 * s1**3 + 3 * q2 * s1 * s2 + q1 * s3) / (0.997 * LIMITS.j)),
        ]
    )
    np.testing.assert_allclose(over.factor, shares.max(axis=(0, 2)), rtol=1e-12)


def test_a_running_maximum_is_that_of_every_window(rng):
    from scanmotion.motion.profile.jerk_limited import _running_max

    x = rng.normal(size=200)
    brute = [x[max(n - 7, 0) : n + 8].max() for n in range(200)]
    assert np.array_equal(_running_max(x, 7), brute)


def test_impossible_law_is_refused():
    with pytest.raises(TimingError):
        ruckig_law(1.0, -0.1, 0.5, 5.0)


# --- the tour -------------------------------------------------------------------------------------------


def random_tour(cell, rng, n):
    """Stops of all three kinds, near and far; transits along straight joint edges, some over a corner."""
    from scanmotion.cell.kinematics import scanner_poses, tcp_jacobian

    at = rng.uniform(LOW, HIGH)
    start, stops, paths = at, [], []
    for k in range(n):
        q_in = at + rng.choice([0.05, 0.3, 1.0]) * (rng.uniform(LOW, HIGH) - at)
        kind = ("revolution", "sweep", "dwell")[k % 3]
        q_out, path = q_in.copy(), None
        if kind == "revolution":
            q_out[6] += 2 * np.pi * (-1) ** k
        if kind == "sweep":
            path = sweep_path(scanner_poses, tcp_jacobian, cell, q_in, rng.normal(size=3) * 0.1)
            q_out = path[-1].copy()
        via = [at, q_in] if k % 2 else [at, (at + q_in) / 2 + 0.1 * rng.normal(size=7), q_in]
        stops.append(Stop(viewpoints=(f"V{k}",), kind=kind, q_in=q_in, q_out=q_out, path=path))
        paths.append(Path(q=np.array(via), seconds=0.0, method="joint"))
        at = q_out
    return Tour(start_q=start, stops=tuple(stops), seconds=0.0, floor=0.0), paths


def sweep_path(scanner_poses, tcp_jacobian, cell, q, way, count=25):
    """Joint path of a straight line of the scanner, orientation kept (damped Newton steps)."""
    X = scanner_poses(cell, q[None])[0]
    rows = [q]
    for k in range(1, count):
        row = rows[-1].copy()
        for _ in range(20):
            now = scanner_poses(cell, row[None])[0]
            E = now[:3, :3].T @ X[:3, :3]
            turn = now[:3, :3] @ np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
            miss = np.concatenate([turn, X[:3, 3] + way * k / (count - 1) - now[:3, 3]])
            J = tcp_jacobian(cell, row[None])[0][:, :6]
            row[:6] += J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), miss)
        rows.append(row)
    return np.array(rows)


def test_scanner_speed_is_that_of_the_jacobian(kr240_cell, rng):
    from scanmotion.cell.kinematics import tcp_jacobian
    from scanmotion.motion.transit.drive import positions, speeds

    q, q1 = rng.uniform(LOW, HIGH, size=(50, 7)), rng.normal(size=(50, 7))
    p1 = np.einsum("nij,nj->ni", tcp_jacobian(kr240_cell, q)[:, 3:], q1)
    assert np.abs(speeds(kr240_cell, q, q1) - np.linalg.norm(p1, axis=1)).max() < 1e-12
    assert np.abs(positions(kr240_cell, q) - scanner(kr240_cell, q)).max() < 1e-12


@pytest.fixture(scope="module")
def timed(kr240_cell):
    from scanmotion.motion.timing.operations import time_plan

    tour, paths = random_tour(kr240_cell, np.random.default_rng(5), 9)
    return tour, paths, time_plan(kr240_cell, tour, paths, sample_s=0.001)


def scanner(cell, q):
    from scanmotion.cell.kinematics import scanner_poses

    return scanner_poses(cell, q)[:, :3, 3]


def test_tour_keeps_the_limits_by_finite_differences_of_1_ms(kr240_cell, timed):
    _, _, trajectory = timed
    q, cell = trajectory.q, kr240_cell
    assert largest(q, 0.001, 1, cell.v_max) <= 1.001
    assert largest(q, 0.001, 2, cell.a_max) <= 1.001
    assert largest(q, 0.001, 3, cell.j_max) <= 1.001
    assert (q >= cell.q_min - 1e-9).all() and (q <= cell.q_max + 1e-9).all()
    speed = np.linalg.norm(np.diff(scanner(cell, q), axis=0), axis=1) / 0.001
    assert speed.max() <= 0.1 * 1.0005


def test_written_samples_keep_the_limits_after_rounding(kr240_cell, timed):
    from scanmotion.motion.timing.operations import time_plan

    tour, paths, fine = timed
    trajectory = time_plan(kr240_cell, tour, paths)
    assert np.abs(np.diff(trajectory.t) - 0.01).max() < 1e-9
    assert np.array_equal(trajectory.t, fine.t[::10])
    assert np.abs(trajectory.q - fine.q[::10]).max() < 1e-12
    q = np.radians(np.round(np.degrees(trajectory.q), 6))
    assert largest(q, 0.01, 1, kr240_cell.v_max) <= 1.0
    assert largest(q, 0.01, 2, kr240_cell.a_max) <= 1.001
    speed = np.linalg.norm(np.diff(scanner(kr240_cell, q), axis=0), axis=1) / 0.01
    assert speed.max() <= 0.1


def test_operations_are_contiguous_and_start_and_end_at_rest(timed):
    tour, _, trajectory = timed
    ops = trajectory.operations
    assert [o.index for o in ops] == list(range(len(ops)))
    assert [o.kind for o in ops if o.kind != "transit"] == [s.kind for s in tour.stops]
    assert ops[0].t_start == 0.0 and ops[-1].t_end == pytest.approx(trajectory.duration)
    for before, after in pairwise(ops):
        assert before.t_end == after.t_start
        assert np.abs(before.q_end - after.q_start).max() < 1e-9
    for op in ops:
        rows = np.flatnonzero(trajectory.operation == op.index)
        last = rows[-1]
        first = max(rows[0] - 1, 0)
        assert trajectory.t[first] == pytest.approx(op.t_start) and trajectory.t[last] == pytest.approx(
            op.t_end
        )
        assert np.abs(trajectory.q[first] - op.q_start).max() < 1e-9
        assert np.abs(trajectory.q[last] - op.q_end).max() < 1e-9
        assert np.abs(trajectory.qd[[first, last]]).max() < 1e-6
        assert np.abs(trajectory.qdd[[first, last]]).max() < 1e-4


def test_derivatives_belong_to_the_positions(timed):
    _, _, trajectory = timed
    slope = (trajectory.q[2:] - trajectory.q[:-2]) / 0.002
    assert np.abs(slope - trajectory.qd[1:-1]).max() < 1e-3
    slope = (trajectory.qd[2:] - trajectory.qd[:-2]) / 0.002
    assert np.abs(slope - trajectory.qdd[1:-1]).max() < 0.1


def test_sweeps_run_straight_at_the_scan_speed_relative_to_the_part(kr240_cell, timed):
    from scanmotion.cell.kinematics import scanner_in_object

    tour, _, trajectory = timed
    for op in trajectory.operations:
        if op.kind != "sweep":
            continue
        rows = trajectory.operation == op.index
        p = scanner_in_object(kr240_cell, trajectory.q[rows])[:, :3, 3]
        way = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
        off = (p - p[0]) - ((p - p[0]) @ way)[:, None] * way
        assert np.linalg.norm(off, axis=1).max() < 2e-5
        speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / 0.001
        assert speed.max() <= 0.1
        cruise = speed[len(speed) // 3 : -len(speed) // 3]
        assert cruise.min() >= 0.0995
        length = np.linalg.norm(p[-1] - p[0])
        assert op.t_end - op.t_start <= length / 0.1 + 0.4
    assert any(s.kind == "sweep" for s in tour.stops)


def test_a_revolution_takes_the_closed_form(kr240_cell, timed):
    _, _, trajectory = timed
    v, a, j = kr240_cell.v_max[6], kr240_cell.a_max[6], kr240_cell.j_max[6]
    closed = 2 * np.pi / v + v / a + a / j
    for op in trajectory.operations:
        if op.kind == "revolution":
            assert closed <= op.t_end - op.t_start <= closed * 1.002 + 0.01
            assert abs(op.q_end[6] - op.q_start[6]) == pytest.approx(2 * np.pi, abs=1e-9)
            assert np.abs(op.q_end[:6] - op.q_start[:6]).max() < 1e-12


def test_transits_stay_on_the_curve_beside_the_checked_path(kr240_cell, timed):
    from scanmotion.motion.transit.drive import transit_spline

    _, paths, trajectory = timed
    transits = [o for o in trajectory.operations if o.kind == "transit"]
    for op, path in zip(transits, paths, strict=True):
        curve = transit_spline(kr240_cell, path.q)
        u = np.linspace(0, curve.end, 40 * round(curve.end))
        on_curve = curve(u)
        for row in trajectory.q[trajectory.operation == op.index][::50]:
            assert np.abs(on_curve - row).max(axis=1).min() < 2e-3


def test_transit_time_is_close_to_its_way_at_the_transit_speed(kr240_cell):
    from scanmotion.motion.timing.operations import transit_motion

    rng = np.random.default_rng(8)
    total = bound = 0.0
    for _ in range(8):
        qa = rng.uniform(LOW, HIGH)
        qb = qa + 0.4 * (rng.uniform(LOW, HIGH) - qa)
        qb[6] = qa[6]
        q = qa + np.linspace(0, 1, 400)[:, None] * (qb - qa)
        way = np.linalg.norm(np.diff(scanner(kr240_cell, q), axis=0), axis=1).sum()
        motion = transit_motion(kr240_cell, np.array([qa, qb]))
        assert motion.duration >= way / 0.1 - 1e-6
        total, bound = total + motion.duration, bound + way / 0.1
    assert total <= 1.03 * bound


def test_total_is_close_to_the_floor_without_jerk_limit(kr240_cell, timed):
    from scanmotion.motion.timing.operations import motions

    tour, paths, _ = timed
    placed = list(motions(kr240_cell, tour, paths))
    assert sum(m.duration for m in placed) <= 1.06 * sum(m.floor for m in placed)


def test_the_same_tour_gives_the_same_trajectory(kr240_cell, timed):
    from scanmotion.motion.timing.operations import time_plan

    tour, paths, first = timed
    second = time_plan(kr240_cell, tour, paths, sample_s=0.001)
    assert np.array_equal(first.q, second.q) and np.array_equal(first.qdd, second.qdd)


def with_speed(cell, speed):
    other = copy.copy(cell)
    process = SimpleNamespace(
        transit_speed_m_s=speed,
        scan_speed_m_s=cell.settings.process.scan_speed_m_s,
        dwell_s=cell.settings.process.dwell_s,
    )
    object.__setattr__(other, "settings", SimpleNamespace(process=process))
    return other


@pytest.mark.parametrize("speed", [0.05, 0.5, 2.0])
def test_the_transit_speed_is_the_users(kr240_cell, speed):
    from scanmotion.motion.timing.operations import transit_motion

    cell = with_speed(kr240_cell, speed)
    rng = np.random.default_rng(2)
    for _ in range(3):
        qa, qb, qc = rng.uniform(LOW, HIGH, size=(3, 7))
        motion = transit_motion(cell, np.array([qa, qb, qc]))
        q = motion(np.arange(0, motion.duration, 0.001))[0]
        assert largest(q, 0.001, 1, cell.v_max) <= 1.001
        assert largest(q, 0.001, 2, cell.a_max) <= 1.001
        assert largest(q, 0.001, 3, cell.j_max) <= 1.001
        got = np.linalg.norm(np.diff(scanner(cell, q), axis=0), axis=1).max() / 0.001
        assert got <= 1.0005 * speed


def test_nothing_to_do_is_a_trajectory_of_one_sample(kr240_cell):
    from scanmotion.motion.timing.operations import time_plan

    tour = Tour(start_q=kr240_cell.home, stops=(), seconds=0.0, floor=0.0)
    trajectory = time_plan(kr240_cell, tour, [])
    assert trajectory.duration == 0.0 and trajectory.operations == ()


def test_a_stop_without_a_move_needs_no_transit(kr240_cell):
    from scanmotion.motion.timing.operations import time_plan

    q = np.asarray(kr240_cell.home, dtype=float)
    stop = Stop(viewpoints=("V0",), kind="dwell", q_in=q, q_out=q)
    tour = Tour(start_q=q, stops=(stop,), seconds=0.0, floor=0.0)
    shares = []
    trajectory = time_plan(
        kr240_cell, tour, [Path(q=np.array([q, q]), seconds=0.0, method="joint")], progress=shares.append
    )
    assert [o.kind for o in trajectory.operations] == ["dwell"]
    assert trajectory.duration == pytest.approx(kr240_cell.settings.process.dwell_s)
    assert shares[-1] == 1.0 and shares == sorted(shares)


def test_a_path_that_leads_elsewhere_is_refused(kr240_cell, timed):
    from scanmotion.motion.timing.operations import time_plan

    tour, paths, _ = timed
    beside = Path(q=paths[0].q + 1e-3, seconds=0.0, method="joint")
    with pytest.raises(TimingError, match="rad beside where"):
        time_plan(kr240_cell, tour, [beside, *paths[1:]])
    with pytest.raises(TimingError, match="as many paths"):
        time_plan(kr240_cell, tour, paths[1:])


def test_a_path_out_of_range_names_the_axis(kr240_cell):
    from scanmotion.motion.timing.operations import transit_motion

    q = np.array([kr240_cell.home, kr240_cell.home], dtype=float)
    q[1, 4] = kr240_cell.q_max[4] + 0.2
    with pytest.raises(TimingError, match="A5") as caught:
        transit_motion(kr240_cell, q, ("V7",))
    assert caught.value.joint == kr240_cell.joint_names[4]
    assert caught.value.value > caught.value.limit
    assert "V7" in str(caught.value)


def test_a_sweep_that_stands_still_is_refused(kr240_cell):
    from scanmotion.motion.timing.operations import time_plan

    q = np.asarray(kr240_cell.home, dtype=float)
    for path, words in ((None, "no path"), (np.array([q, q, q]), "does not move")):
        stop = Stop(viewpoints=("S1",), kind="sweep", q_in=q, q_out=q, path=path)
        tour = Tour(start_q=q, stops=(stop,), seconds=0.0, floor=0.0)
        with pytest.raises(TimingError, match=words):
            time_plan(kr240_cell, tour, [Path(q=np.array([q, q]), seconds=0.0, method="joint")])


def test_a_sweep_that_changes_the_arms_configuration_is_refused(kr240_cell, timed):
    from scanmotion.motion.timing.operations import time_plan

    tour, _, _ = timed
    stop = next(s for s in tour.stops if s.kind == "sweep")
    flipped = stop.path.copy()
    half = len(flipped) // 2
    # The same poses by the wrist's other branch from the middle on.
    flipped[half:, 3] -= np.pi * np.sign(flipped[half:, 3])
    flipped[half:, 4] *= -1
    flipped[half:, 5] -= np.pi * np.sign(flipped[half:, 5])
    assert np.abs(scanner(kr240_cell, flipped) - scanner(kr240_cell, stop.path)).max() < 1e-9
    bad = Stop(viewpoints=("S1",), kind="sweep", q_in=flipped[0], q_out=flipped[-1], path=flipped)
    tour = Tour(start_q=flipped[0], stops=(bad,), seconds=0.0, floor=0.0)
    with pytest.raises(TimingError, match="leaves its line") as caught:
        time_plan(kr240_cell, tour, [Path(q=flipped[[0, 0]], seconds=0.0, method="joint")])
    assert caught.value.value > caught.value.limit


@pytest.mark.parametrize("seed", range(3))
def test_the_emitted_profile_is_the_librarys_and_agrees_with_the_compiled_one(seed):
    """Caps and accelerations that vary along the path: two solvers, one answer."""
    rng = np.random.default_rng(seed)
    _, d = joint_path(rng, 2)
    cap = speed_caps(d, d.tcp(d.s), Limits(v=LIMITS.v, a=LIMITS.a, j=LIMITS.j, tcp=0.3))
    a = LIMITS.a * rng.uniform(0.4, 1.0, len(d.s))[:, None]
    ours, theirs = fastest_profile(d, cap, a), toppra_profile(d, cap, a)
    assert np.abs(ours - theirs).max() <= 1e-6 * ours.max()
    assert (theirs <= cap * (1 + 1e-9)).all()


def test_a_transit_that_is_emitted_is_made_by_toppra(monkeypatch, kr240_cell):
    """What toppra answers is what is driven: at half its speed the transit takes twice as long."""
    q = np.array([kr240_cell.home, kr240_cell.home + 0.3])
    once = transit_motion(kr240_cell, q).duration
    asked = []

    def slower(d, cap, a):
        asked.append(len(d.s))
        return toppra_profile(d, cap, a) / 4

    monkeypatch.setattr(module, "toppra_profile", slower)
    drive._emitted_law.cache_clear()
    twice = transit_motion(kr240_cell, q)
    drive._emitted_law.cache_clear()
    assert asked
    windows = sum(drive.transit_law(kr240_cell, q)[1].windows)
    assert twice.duration - windows == pytest.approx(2 * (once - windows), rel=0.02)
