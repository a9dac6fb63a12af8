"""Where no exact pose serves, another within the slack does: it keeps the slack and the clearance."""

import math

import numpy as np
import pytest
from fcl_check import FclCell

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.ik.slack_plant import SlackPlant
from scanmotion.cell.settings.cell import settings_from
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.motion.reach import slack as module
from scanmotion.motion.reach.find import ReachOptions, reach
from scanmotion.motion.reach.slack import SlackSearch, distances, has_slack, seeds_from, variants

TOLERANCE_M = 2e-4
SLACK = Slack(standoff=(-0.05, 0.05), tilt=np.deg2rad(10.0), roll=False)
EXACT = ReachOptions(slack=False, remedies=False)
WITHIN = ReachOptions(remedies=False)


def violation(viewpoint, X_OS):
    """By how much a pose leaves the slack: off the aimed point [m], distance [m], angle [rad]."""
    aim = viewpoint.p_OS + viewpoint.standoff * viewpoint.direction
    far = (aim - X_OS[:3, 3]) @ X_OS[:3, 2]
    off = np.linalg.norm(X_OS[:3, 3] + far * X_OS[:3, 2] - aim)
    low, high = viewpoint.slack.standoff
    short = max(viewpoint.standoff + low - far, far - viewpoint.standoff - high, 0.0)
    if viewpoint.slack.roll:
        angle = math.acos(min(X_OS[:3, 2] @ viewpoint.direction, 1.0))
    else:
        angle = math.acos(min((np.trace(X_OS[:3, :3].T @ viewpoint.X_OS[:3, :3]) - 1) / 2, 1.0))
    return off, short, max(angle - viewpoint.slack.tilt, 0.0)


def view(name, r, a, h, down, slack=SLACK):
    X = look_at(np.array([r * math.cos(a), r * math.sin(a), h]), np.array([-math.cos(a), -math.sin(a), down]))
    return Viewpoint(id=name, X_OS=X, standoff=0.6, step="local", kind="station", slack=slack)


@pytest.fixture(scope="module")
def cell():
    """A table in a tunnel: a shelf over it and a wall to either side."""
    shelf = {"name": "shelf", "centre_m": [2.2, 0, 1.5], "size_m": [1.2, 1.2, 0.1]}
    walls = [
        {"name": n, "centre_m": [2.2, y, 1.2], "size_m": [1.6, 0.1, 1.0]}
        for n, y in (("l", 0.62), ("r", -0.62))
    ]
    return build_cell(settings_from({"obstacles": [shelf, *walls]}), box_part(0.3, 0.2, 0.1))


@pytest.fixture(scope="module")
def checker(cell):
    return Clearance(cell)


@pytest.fixture(scope="module")
def views():
    rng = np.random.default_rng(0)
    rows = rng.uniform([0.2, -3, 0.3, -1.5], [0.7, 3, 0.75, 0.2], (70, 4))
    return [view(f"V{k}", *row) for k, row in enumerate(rows)]


@pytest.fixture(scope="module")
def lost(cell, checker, views):
    """Viewpoints that have no exact pose."""
    return [r.viewpoint for r in reach(cell, views, clearance=checker, options=EXACT) if r.unreachable]


@pytest.fixture(scope="module")
def found(cell, checker, lost):
    return reach(cell, lost, clearance=checker, options=WITHIN)


def test_slack_serves_what_exact_poses_do_not(cell, checker, lost, found):
    second = FclCell(cell)
    served = [r for r in found if r.unreachable is None]
    assert len(lost) > 10 and len(served) > len(lost) // 2
    for item in served:
        for k in range(0, len(item.q), 8):
            q = item.q[k]
            _, X_WS, X_WO = second.frames(q)
            X_OS = np.linalg.inv(X_WO) @ X_WS
            np.testing.assert_allclose(X_OS, item.X_OS[k], atol=1e-9)
            off, short, angle = violation(item.viewpoint, X_OS)
            assert off < 1e-4 and short < 1e-4 and angle < 1e-4
            outside, inside = second.distances(q)
            assert outside >= checker.clearance - TOLERANCE_M
            assert inside >= checker.self_clearance - TOLERANCE_M
            assert (q >= cell.q_min).all() and (q <= cell.q_max).all()
            moved = np.linalg.norm(X_OS[:3, 3] - item.viewpoint.p_OS)
            assert moved > 1e-4 or np.abs(X_OS - item.viewpoint.X_OS).max() > 1e-4


def test_what_has_an_exact_pose_keeps_it(cell, checker, views, lost):
    names = {v.id for v in lost}
    exact = [v for v in views if v.id not in names][:10]
    for item in reach(cell, exact, clearance=checker, options=WITHIN):
        np.testing.assert_allclose(item.X_OS, np.tile(item.viewpoint.X_OS, (len(item.q), 1, 1)), atol=1e-9)


def test_the_constrained_search_adds_to_the_grid(cell, checker, lost, monkeypatch):
    """Some are served by InverseKinematics alone; the answers are the same the second time."""
    calls = []
    solve = SlackSearch.solve

    def noted(self, viewpoint, seeds):
        q = solve(self, viewpoint, seeds)
        calls.append((viewpoint, seeds, q))
        return q

    monkeypatch.setattr(SlackSearch, "solve", noted)
    first = reach(cell, lost, clearance=checker, options=WITHIN)
    solved = [c for c in calls if c[2] is not None]
    assert solved
    for viewpoint, _, q in solved:
        item = next(r for r in first if r.viewpoint.id == viewpoint.id)
        assert np.array_equal(item.q, q[None]) and item.manipulability[0] > 0
        assert checker.free(q[None])[0]
    again = reach(cell, [c[0] for c in solved], clearance=checker, options=WITHIN)
    for (_, _, q), item in zip(solved, again, strict=True):
        assert np.array_equal(item.q, q[None])


def test_the_search_is_bounded(cell, checker, lost, monkeypatch):
    tries = []
    monkeypatch.setattr(SlackPlant, "solve", lambda self, *a: tries.append(a))
    seeds = np.tile(cell.home, (50, 1))
    assert SlackSearch(cell, checker).solve(lost[0], seeds) is None
    assert 0 < len(tries) <= 2 * module.TRIES


def test_just_inside_a_collision_the_search_backs_off(cell, checker):
    """The scanner is raised until its last exact pose is lost; from there a little slack is enough."""
    low = view("V", 0.35, 0.3, 0.4, -1.2, Slack(standoff=(-0.05, 0.05), tilt=np.deg2rad(10.0)))
    before = touching = low
    for height in np.arange(0.4, 0.8, 0.01):
        X = low.X_OS.copy()
        X[2, 3] = height
        before, touching = touching, low.moved(X)
        if reach(cell, [touching], clearance=checker, options=EXACT)[0].unreachable:
            break
    free = reach(cell, [before], clearance=checker, options=EXACT)[0].q
    assert len(free)
    q = SlackSearch(cell, checker).solve(touching, seeds_from(free, np.zeros(len(free), bool)))
    assert q is not None and checker.free(q[None])[0]
    second = FclCell(cell)
    _, X_WS, X_WO = second.frames(q)
    assert max(violation(touching, np.linalg.inv(X_WO) @ X_WS)) < 1e-4
    assert second.distances(q)[0] >= checker.clearance - TOLERANCE_M


def test_variants_are_within_the_slack(cell):
    viewpoint = view("V", 0.5, 1.0, 0.5, -0.5)
    others = variants(cell, viewpoint)
    assert len(others) == 3 * 9 - 1
    for other in others:
        assert max(violation(viewpoint, other.X_OS)) < 1e-9
        assert not has_slack(other)
    near_only = view("V", 0.5, 1.0, 0.5, -0.5, Slack(standoff=(-0.5, 1.0), roll=False))
    low, high = cell.settings.scanner.range_m
    assert distances(cell, near_only) == (0.6, low, high)
    assert len(variants(cell, near_only)) == 2


def test_what_has_no_slack_is_left_alone(cell, checker, lost):
    bare = [v.moved(v.X_OS) for v in lost[:3]]
    bare = [Viewpoint(**{**vars(v), "slack": Slack(roll=False)}) for v in bare]
    assert not any(has_slack(v) for v in bare)
    assert all(r.unreachable for r in reach(cell, bare, clearance=checker, options=WITHIN))
    turning = Viewpoint(**{**vars(lost[0]), "kind": "revolution"})
    assert not has_slack(turning)


def test_seeds_prefer_what_may_be_free_and_differ_in_the_table():
    q = np.zeros((6, 7))
    q[:, 0] = np.arange(6)
    q[:, 6] = [0.0, 0.0, 1.0, 1.0, 2.0, 3.0]
    blocked = np.array([True, False, True, True, False, True])
    assert seeds_from(q, blocked, 3)[:, 0].tolist() == [1.0, 4.0, 2.0]
    assert seeds_from(q[:2], blocked[:2], 3)[:, 0].tolist() == [1.0, 0.0]
