"""Transit: straight where free, round planted obstacles, short in seconds, the same for the same seed."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanmotion.core.errors import PathError
from scanmotion.core.tour import Stop, Tour

LOW = np.radians([-40, -110, 60, -90, -100, -150, -170])
HIGH = np.radians([40, -50, 130, 90, 100, 150, 170])


class Walls:
    """A clearance checker that knows the scanner's origin only: it must keep out of some solids."""

    def __init__(self, cell, blocked):
        self.cell, self.blocked = cell, blocked
        self.checked = 0

    def free(self, q):
        from scanmotion.cell.kinematics import scanner_poses

        self.checked += len(q)
        return ~self.blocked(scanner_poses(self.cell, q)[:, :3, 3])

    fast_free = free

    def edges_free(self, qa, qb):
        return np.array(
            [
                self.free(a + np.linspace(0, 1, 25)[:, None] * (b - a)).all()
                for a, b in zip(qa, qb, strict=True)
            ]
        )

    def path_free(self, q):
        fine = np.vstack([a + np.linspace(0, 1, 6)[:, None] * (b - a) for a, b in pairwise(q)])
        free = self.free(fine)
        if free.all():
            return True, -1, ("", "")
        return False, int(np.argmin(free)) // 6, ("scanner", "wall")

    def distance(self, q):
        return (-0.1 if not self.free(q[None])[0] else 0.1), ("scanner", "wall")


def nothing(p):
    return np.zeros(len(p), dtype=bool)


def everything_between(x0, x1):
    return lambda p: (p[:, 1] > x0) & (p[:, 1] < x1)


@pytest.fixture(scope="module")
def sides(kr240_cell):
    """Two configurations with the scanner at y = +-0.45 m in front of the robot, the same height."""
    from scanmotion.cell.kinematics import branches
    from scanmotion.core.viewpoint import look_at

    ends = []
    for y in (-0.45, 0.45):
        X_WS = look_at(np.array([1.9, y, 1.3]), np.array([0.6, -y, -0.4]))
        found = branches(kr240_cell, X_WS[None], windings=False)
        home = np.asarray(kr240_cell.home)[:6]
        ends.append(np.append(found.q[np.abs(found.q - home).max(axis=1).argmin()], 0.0))
    return ends


def way_of(cell, q):
    from scanmotion.cell.kinematics import scanner_poses

    return scanner_poses(cell, q)[:, :3, 3]


def pillar(p):
    """A square pillar of 0.5 m between the two sides, as high as the robot reaches."""
    return (np.abs(p[:, 0] - 1.9) < 0.25) & (np.abs(p[:, 1]) < 0.25)


def test_free_gap_takes_the_scanners_straight_line(kr240_cell, sides, rng):
    from scanmotion.motion.transit.plan import transit

    path = transit(kr240_cell, Walls(kr240_cell, nothing), *sides, rng=rng)
    assert path.method == "line"
    p = way_of(kr240_cell, path.q)
    chord = p[-1] - p[0]
    off = np.linalg.norm(np.cross(p - p[0], chord / np.linalg.norm(chord)), axis=1)
    assert off.max() < 1e-5
    assert np.array_equal(path.q[[0, -1]], sides)
    assert path.seconds == pytest.approx(np.linalg.norm(chord) / 0.1, rel=0.03)
    # The joint line is longer.
    joint = sides[0] + np.linspace(0, 1, 300)[:, None] * (sides[1] - sides[0])
    assert np.linalg.norm(np.diff(way_of(kr240_cell, joint), axis=0), axis=1).sum() > np.linalg.norm(chord)


def test_the_driven_line_is_straight_too(kr240_cell, sides, rng):
    from scanmotion.motion.transit.drive import transit_spline
    from scanmotion.motion.transit.plan import transit

    path = transit(kr240_cell, Walls(kr240_cell, nothing), *sides, rng=rng)
    curve = transit_spline(kr240_cell, path.q)
    p = way_of(kr240_cell, curve(np.linspace(0, curve.end, 500)))
    chord = p[-1] - p[0]
    off = np.linalg.norm(np.cross(p - p[0], chord / np.linalg.norm(chord)), axis=1)
    assert off.max() < 5e-4


def test_a_planted_pillar_is_passed_by_about_the_shortest_way(kr240_cell, sides):
    from scanmotion.motion.transit.drive import transit_spline
    from scanmotion.motion.transit.plan import transit

    walls = Walls(kr240_cell, pillar)
    path = transit(kr240_cell, walls, *sides, rng=np.random.default_rng(1))
    assert path.method == "planned"
    curve = transit_spline(kr240_cell, path.q)
    p = way_of(kr240_cell, curve(np.linspace(0, curve.end, 3000)))
    assert not pillar(p).any()
    # Round the pillar's near or far corners, in the plane: 2 hypot(0.25, 0.2) + 0.5 m.
    shortest = (2 * np.hypot(0.25, 0.2) + 0.5) / 0.1
    assert shortest <= path.seconds <= 1.25 * shortest


def test_a_joint_line_is_taken_where_the_scanners_line_is_blocked(kr240_cell, sides, rng, monkeypatch):
    from scanmotion.motion.transit import plan as mut

    # The joint line swings outwards; a thin post stands on the chord.
    joint = sides[0] + 0.5 * (sides[1] - sides[0])
    chord_mid = way_of(kr240_cell, np.array(sides)).mean(axis=0)
    apart = np.linalg.norm(way_of(kr240_cell, joint[None])[0] - chord_mid)
    assert apart > 0.02
    post = Walls(kr240_cell, lambda p: np.linalg.norm(p - chord_mid, axis=1) < 0.3 * apart)
    monkeypatch.setattr(mut, "_SLOW", 3.0)
    path = mut.transit(kr240_cell, post, *sides, rng=rng)
    assert path.method == "joint"
    assert np.array_equal(path.q, np.array(sides))


def test_the_same_seed_plans_the_same_path(kr240_cell, sides):
    from scanmotion.motion.transit.plan import transit

    first, second = (
        transit(kr240_cell, Walls(kr240_cell, pillar), *sides, rng=np.random.default_rng(7)) for _ in range(2)
    )
    assert np.array_equal(first.q, second.q)


def test_a_closed_wall_names_what_blocks_and_which_stop(kr240_cell, sides, monkeypatch):
    from scanmotion.motion.transit import plan as mut

    monkeypatch.setattr(mut, "_FEW_CHECKS", 50)
    walls = Walls(kr240_cell, everything_between(-0.2, 0.2))
    q0, q1 = sides
    stops = (
        Stop(viewpoints=("G0",), kind="dwell", q_in=q0, q_out=q0),
        Stop(viewpoints=("L1.1",), kind="dwell", q_in=q1, q_out=q1),
    )
    tour = Tour(start_q=q0, stops=stops, seconds=0.0, floor=0.0)
    with pytest.raises(PathError, match="scanner and wall") as caught:
        mut.transits(kr240_cell, walls, tour, rng=np.random.default_rng(0))
    assert caught.value.pair == ("scanner", "wall")
    assert caught.value.stop == 1
    assert caught.value.depth > 0.0


def test_transits_join_the_stops(kr240_cell, rng):
    from scanmotion.motion.transit.plan import transits

    qs = rng.uniform(LOW, HIGH, size=(5, 7))
    turned = qs + np.array([0, 0, 0, 0, 0, 0, 2 * np.pi])
    stops = tuple(
        Stop(viewpoints=(f"G{k}",), kind="revolution", q_in=qs[k], q_out=turned[k]) for k in range(1, 5)
    )
    shares = []
    paths = transits(
        kr240_cell,
        Walls(kr240_cell, nothing),
        Tour(start_q=qs[0], stops=stops, seconds=0.0, floor=0.0),
        rng=rng,
        progress=shares.append,
    )
    at = qs[0]
    for path, stop in zip(paths, stops, strict=True):
        assert np.abs(path.q[0] - at).max() < 1e-12
        assert np.abs(path.q[-1] - stop.q_in).max() < 1e-12
        at = stop.q_out
    assert shares == sorted(shares) and shares[-1] == 1.0


@given(st.integers(0, 10**6), st.sampled_from([0.05, 0.2, 0.6]))
@settings(max_examples=15)
def test_no_way_beats_the_bound_and_the_first_comes_close(kr240_cell, seed, share):
    from scanmotion.motion.timing.operations import transit_motion
    from scanmotion.motion.transit.straight_line import least_seconds, ways

    rng = np.random.default_rng(seed)
    qa = rng.uniform(LOW, HIGH)
    qb = qa + share * (rng.uniform(LOW, HIGH) - qa)
    least = float(least_seconds(kr240_cell, qa, qb)[0])
    seconds = []
    for _, q in ways(kr240_cell, qa, qb):
        assert np.array_equal(q[0], qa) and np.array_equal(q[-1], qb)
        assert (q >= kr240_cell.q_min).all() and (q <= kr240_cell.q_max).all()
        seconds.append(transit_motion(kr240_cell, q).duration)
    assert min(seconds) >= least * (1 - 1e-9)
    assert min(seconds) <= 1.1 * least + 0.6


def test_the_table_turns_beside_the_arm_within_its_own_ramps(kr240_cell, sides):
    from scanmotion.motion.timing.operations import transit_motion
    from scanmotion.motion.transit.straight_line import least_seconds, ways

    qa, qb = (side.copy() for side in sides)
    qb[6] = np.pi / 2
    even = ways(kr240_cell, qa, qb)
    assert [method for method, _ in even] == ["line", "line", "joint", "joint"]
    least = float(least_seconds(kr240_cell, qa, qb)[0])
    beside = transit_motion(kr240_cell, even[0][1]).duration
    assert beside <= least + 0.25
    # Turning evenly with the arm, the table's slow ramps would hold the arm back.
    p = np.linalg.norm(np.diff(way_of(kr240_cell, np.array([qa, qb])), axis=0))
    assert least == pytest.approx(p / 0.1)
    assert transit_motion(kr240_cell, even[-1][1]).duration > beside


def test_a_pure_table_move_takes_the_tables_time(kr240_cell, sides):
    from scanmotion.motion.timing.operations import transit_motion
    from scanmotion.motion.transit.straight_line import ways

    qa = sides[0]
    qb = qa.copy()
    qb[6] += np.pi / 2
    v, a, j = (float(x[6]) for x in (kr240_cell.v_max, kr240_cell.a_max, kr240_cell.j_max))
    closed = 2 * np.sqrt(np.pi / 2 / a) + a / j
    assert np.pi / 2 < v * v / a
    best = min(transit_motion(kr240_cell, q).duration for _, q in ways(kr240_cell, qa, qb))
    assert closed * 0.99 <= best <= closed * 1.06


# Where the straight way is blocked, one transit is planned for five to ten seconds.
@pytest.mark.parametrize("seed, goals", [(7, 3), pytest.param(4, 6, marks=pytest.mark.slow)])
def test_transits_round_a_carving_keep_the_clearance_exactly(seed, goals):
    """The driven curves, sampled anew and judged by the exact tier alone."""
    from scanmotion.cell.build import build_cell
    from scanmotion.cell.collision.clearance import Clearance
    from scanmotion.cell.kinematics import branches
    from scanmotion.cell.settings.cell import load_cell
    from scanmotion.core.viewpoint import look_at
    from scanmotion.geometry.parts.make_part import carving
    from scanmotion.motion.transit.drive import transit_spline
    from scanmotion.motion.transit.plan import transit

    cell = build_cell(load_cell("kr240"), carving())
    clearance = Clearance(cell)
    centre = cell.X_WT[:3, 3] + [0.0, 0.0, 0.1]
    rng = np.random.default_rng(seed)
    at = np.asarray(cell.home, dtype=float)
    for _ in range(goals):
        goal = None
        while goal is None:
            way = rng.normal(size=3) * [1, 1, 0.5]
            way = way / np.linalg.norm(way)
            X_WS = look_at(centre + 0.8 * way, -way, roll=rng.uniform(-np.pi, np.pi))
            q = branches(cell, X_WS[None], windings=False).q
            q = np.column_stack([q, np.full(len(q), rng.uniform(-np.pi, np.pi))])
            free = q[clearance.free(q)] if len(q) else q
            goal = free[rng.integers(len(free))] if len(free) else None
        path = transit(cell, clearance, at, goal, rng=rng)
        curve = transit_spline(cell, path.q)
        samples = curve(np.sort(rng.uniform(0.0, curve.end, 120)))
        lowered = Clearance(cell, clearance=clearance.clearance - 0.008)
        assert lowered.free(samples).all()
        assert min(lowered.distance(row)[0] for row in samples[::12]) > 0.0
        at = goal


# --- the planner ----------------------------------------------------------------------------------------


def planned(seed, blocked, checks=2000):
    from scanmotion.motion.transit.rrt_connect import plan_round

    def free(q):
        return not blocked(q)

    def edge(a, b):
        return all(free(a + f * (b - a)) for f in np.linspace(0, 1, 40))

    ends = np.full(7, -1.0), np.full(7, 1.0)
    return plan_round(
        edge,
        free,
        ends,
        (np.full(7, -2.0), np.full(7, 2.0)),
        scale=np.array([1.0, 2.0, 1.0, 1.0, 0.5, 1.0, 1.0]),
        reach=0.8,
        seed=seed,
        most_checks=checks,
    )


def slab(q):
    return abs(q[0]) < 0.2 and q[1] > -1.2


@given(st.integers(1, 2**31 - 1))
@settings(max_examples=10)
def test_planner_goes_round_a_slab(seed):
    path = planned(seed, slab)
    assert path is not None
    assert np.allclose(path[0], -1.0) and np.allclose(path[-1], 1.0)
    for a, b in pairwise(path):
        assert not any(slab(a + f * (b - a)) for f in np.linspace(0, 1, 40))
    # The only gap lies below -1.2 in the second joint.
    assert path[:, 1].min() < -1.2


def test_planner_is_deterministic_and_gives_up_after_its_checks():
    assert np.array_equal(planned(3, slab), planned(3, slab))
    assert not np.array_equal(planned(3, slab), planned(4, slab))
    calls = []

    def wall(q):
        calls.append(1)
        return abs(q[0]) < 0.2

    assert planned(3, wall, checks=100) is None
