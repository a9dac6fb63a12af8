"""What the fast tier calls free is free, what it calls blocked beyond doubt is blocked, by FCL."""

from itertools import pairwise

import numpy as np
import pytest
from fcl_check import FclCell

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import PAD_M, Clearance
from scanmotion.cell.collision.pairs import GUIDED_M
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import box_part

TOLERANCE_M = 2e-4
"""How far FCL's iterative distances are trusted."""


def trough() -> Part:
    """A closed U of boxes, 0.6 m long with a gap of 0.5 m: its hull fills the gap."""
    bars = [((-0.3, 0.3), (-0.3, 0.3), (0.0, 0.1)), ((-0.3, 0.3), (-0.3, -0.25), (0.1, 0.6))]
    bars.append(((-0.3, 0.3), (0.25, 0.3), (0.1, 0.6)))
    box = box_part(1.0, 1.0, 1.0)
    vertices, triangles = [], []
    for n, bar in enumerate(bars):
        low, high = np.array(bar).T
        vertices.append(low + (box.vertices - box.bounds[0]) * (high - low))
        triangles.append(box.triangles + n * len(box.vertices))
    return Part(name="trough", vertices=np.concatenate(vertices), triangles=np.concatenate(triangles))


@pytest.fixture(scope="module")
def cell():
    obstacle = {"name": "pillar", "centre_m": [1.2, 0.9, 1.0], "size_m": [0.2, 0.3, 2.0], "yaw_deg": 20.0}
    return build_cell(settings_from({"obstacles": [obstacle], "pedestal": {"height_m": 0.1}}), trough())


@pytest.fixture(scope="module")
def checker(cell):
    return Clearance(cell)


@pytest.fixture(scope="module")
def second(cell):
    return FclCell(cell)


@pytest.fixture(scope="module")
def rows(cell):
    """Configurations all over the range, and as many with the scanner about the part."""
    rng = np.random.default_rng(1)
    wide = rng.uniform(cell.q_min[:6], cell.q_max[:6], (150, 6))
    near = cell.home[:6] + rng.normal(size=(150, 6)) * np.array([0.3, 0.4, 0.4, 1.0, 0.8, 1.0])
    q = np.clip(np.concatenate([wide, near]), cell.q_min[:6], cell.q_max[:6])
    return np.column_stack([q, rng.uniform(-np.pi, np.pi, len(q))])


@pytest.fixture(scope="module")
def truth(second, rows):
    return np.array([second.distances(q) for q in rows])


def test_margins_never_exceed_the_distance(checker, second, rows, truth):
    """Neighbours but one aside, which are always near and count by the way to where they are too near."""
    margins = checker.margins(rows)
    apart = np.array([second.distances(q, near=False) for q in rows])
    excess = np.minimum(apart[:, 0] - checker.clearance, apart[:, 1] - checker.self_clearance) - PAD_M
    free = margins >= 0
    assert (truth[free, 1] >= checker.self_clearance - TOLERANCE_M).all()
    assert 30 < free.sum() < len(rows) - 30
    assert (margins[free] <= np.minimum(excess[free], 0.5) + TOLERANCE_M).all()


def test_blocked_beyond_doubt_is_blocked(checker, rows, truth):
    blocked = checker.surely_blocked(rows)
    keeps = (truth[:, 0] >= checker.clearance) & (truth[:, 1] >= checker.self_clearance)
    assert blocked.sum() > 30
    assert not (blocked & keeps).any()


def test_free_agrees_with_fcl(checker, rows, truth):
    free = checker.free(rows)
    slack = np.minimum(truth[:, 0] - checker.clearance, truth[:, 1] - checker.self_clearance)
    clear = np.abs(slack) > TOLERANCE_M
    assert clear.sum() > 0.95 * len(rows)
    assert (free == (slack > 0))[clear].all()


def test_distance_is_that_of_fcl(cell, checker, rows, truth):
    """Of the pair that keeps its own clearance worst, and `asked` says which clearance that is."""
    kinds = set()
    for q, (outside, inside) in list(zip(rows, truth, strict=True))[::3]:
        distance, pair = checker.distance(q)
        assert all(pair)
        excess = min(outside - checker.clearance, inside - checker.self_clearance)
        if min(outside, inside) < 0:
            assert distance <= TOLERANCE_M
        elif excess < 0.5:
            assert distance - checker.asked(pair) == pytest.approx(excess, abs=1e-3)
            kinds.add(checker.asked(pair))
    assert checker.clearance in kinds and kinds <= {checker.clearance, checker.self_clearance, GUIDED_M}
    assert len(kinds) > 1


def test_link_1_is_judged_against_obstacles():
    """A post beside the turning column, where the base is not; the floor under it counts not."""
    post = {"name": "post", "centre_m": [0.0, 0.62, 0.42], "size_m": [0.05, 0.05, 0.84]}
    cell = build_cell(settings_from({"obstacles": [post]}))
    checker = Clearance(cell)
    seen = set()
    second = FclCell(cell)
    for a1 in np.deg2rad(np.arange(-180, 181, 10.0)):
        q = np.append([a1, -1.2, 1.6, 0.0, 0.5], [0.0, 0.0])
        outside, _ = second.distances(q)
        if abs(outside - checker.clearance) < TOLERANCE_M:
            continue
        assert checker.free(q[None])[0] == drake_of(cell).free(q[None])[0] == (outside > checker.clearance)
        if outside < checker.clearance:
            seen.add(checker.distance(q)[1])
    assert "link_1" in {pair[0] for pair in seen} and {pair[1] for pair in seen} == {"post"}


def test_tool_blocked_means_blocked(cell, checker, rows):
    hopeless = checker.tool_blocked(scanner_poses(cell, rows), rows[:, 6])
    assert hopeless.sum() > 5
    assert not checker.free(rows[hopeless]).any()


def test_free_edges_are_free_all_along(checker, second, rows):
    free = rows[checker.fast_free(rows)]
    qa, qb = free[:-1], free[:-1] + 0.15 * (free[1:] - free[:-1])
    ok = checker.edges_free(qa, qb)
    assert ok.sum() > 20
    for a, b in list(zip(qa[ok], qb[ok], strict=True))[:12]:
        for t in np.linspace(0, 1, 9):
            outside, inside = second.distances(a + t * (b - a))
            assert outside >= checker.clearance - TOLERANCE_M
            assert inside >= checker.self_clearance - TOLERANCE_M


def test_path_free_names_the_blocked_edge_and_the_pair(checker, rows):
    free = rows[checker.free(rows)]
    blocked = rows[~checker.free(rows)]
    ok, edge, pair = checker.path_free(np.array([free[0], free[0], blocked[0]]))
    assert not ok and edge == 1 and all(pair)
    assert checker.path_free(np.array([free[0], free[0]]))[0]


def test_a_notch_is_free_and_its_hull_is_not(cell, checker, second):
    """The scanner over the trough's floor, between its walls: Drake's hull of the part would forbid it."""
    from scanmotion.cell.ik.slack_plant import SlackPlant
    from scanmotion.core.viewpoint import Viewpoint, look_at
    from scanmotion.motion.reach.find import reach

    view = Viewpoint(
        id="V", X_OS=look_at(np.array([0, 0, 0.45]), np.array([0, 0, -1.0])), standoff=0.35, step="local",
        kind="station",
    )  # fmt: skip
    found = reach(cell, [view], clearance=checker)[0]
    assert found.unreachable is None
    assert second.distances(found.q[0])[0] >= checker.clearance - TOLERANCE_M
    hull = SlackPlant(cell, part="hull")
    hull.plant.SetPositions(hull.context, hull.positions(found.q[0]))
    port = hull.plant.get_geometry_query_input_port()
    assert port.Eval(hull.context).ComputePointPairPenetration()


def test_a_checker_like_another_is_as_one_of_its_own(cell, checker, rows):
    settings = cell.settings
    table = settings.turntable.model_copy(update={"position_m": (2.0, 0.3), "height_m": 0.6})
    moved = build_cell(settings.model_copy(update={"turntable": table}), cell.part)
    shared, own = Clearance(moved, like=checker), Clearance(moved)
    np.testing.assert_allclose(shared.margins(rows), own.margins(rows), atol=1e-12)
    assert not np.array_equal(shared.margins(rows), checker.margins(rows))


def test_first_free_stops_at_enough_and_knows_windings(cell, checker, rows):
    q = np.repeat(rows[:60], 2, axis=0)
    q[1::2, 3] += 2 * np.pi
    geometry, starts = np.repeat(np.arange(60), 2), np.array([0, 40, 40, 120])
    free = checker.fast_free(q)
    assert np.array_equal(free[::2], free[1::2])
    assert np.array_equal(checker.first_free(q, starts, geometry, 10**6), free)
    some = checker.first_free(q, starts, geometry, 5)
    for a, b in pairwise(starts):
        expected = np.flatnonzero(free[a:b])[:5]
        assert np.array_equal(np.flatnonzero(some[a:b]), expected)


def test_without_a_part_nothing_is_said_of_it():
    cell = build_cell(load_cell("kr240"))
    checker = Clearance(cell)
    assert checker.free(cell.home[None])[0]
    assert "part" not in checker.distance(cell.home)[1]
