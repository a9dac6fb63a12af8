"""Drake's refined poses: free, inside the slack, no nearer to anything, never slower."""

from dataclasses import replace

import numpy as np
import pytest
from fcl_check import FclCell

from scanmotion.cell.arm.robot import least_singular
from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge.views import nearest
from scanmotion.motion import refine
from scanmotion.motion.order.sequence import sequence
from scanmotion.motion.reach.find import ANALYTIC, ReachOptions, reach
from scanmotion.motion.refine import COMFORT, ENOUGH_M, keeps_slack, refined
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit.plan import transits
from scanmotion.plan_io.schema import ViewpointRecord

SLACK = Slack(standoff=(-0.02, 0.02), tilt=np.deg2rad(3.0), roll=False)


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.3, 0.2, 0.4))


@pytest.fixture(scope="module")
def checker(cell):
    return Clearance(cell)


@pytest.fixture(scope="module")
def views():
    rng, out = np.random.default_rng(3), []
    for k in range(4):
        azimuth, up = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 0.8)
        away = np.array([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)])
        X = look_at(np.array([0.0, 0.0, 0.2]) + 0.8 * away, -away)
        out.append(Viewpoint(id=f"L{k}", X_OS=X, standoff=0.6, step="local", kind="station", slack=SLACK))
    return {v.id: v for v in out}


@pytest.fixture(scope="module")
def planned(cell, checker, views):
    found = reach(cell, list(views.values()), clearance=checker, options=ReachOptions(remedies=False))
    assert all(r.solver == ANALYTIC for r in found)
    tour = sequence(cell, found, start_q=cell.home, rng=np.random.default_rng(0))
    return tour, transits(cell, checker, tour, rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def better(cell, checker, views, planned):
    return refined(cell, checker, *planned, views, rng=np.random.default_rng(1))


def test_what_is_taken_is_faster_free_and_inside_the_slack(cell, checker, views, planned, better):
    tour, paths = planned
    assert better.viewpoints
    second = FclCell(cell)
    for old, new in zip(tour.stops, better.tour.stops, strict=True):
        view = views[new.viewpoints[0]]
        if view.id not in better.viewpoints:
            assert np.array_equal(old.q_in, new.q_in)
            continue
        assert keeps_slack(cell, view, new.q_in)
        was, now = (second.distances(q) for q in (old.q_in, new.q_in))
        process = cell.settings.process
        for before, after, asked in zip(
            was, now, (process.clearance_m, process.self_clearance_m), strict=True
        ):
            assert after >= min(before, asked + ENOUGH_M) - 1e-3 and after >= asked - 2e-4
        sigma = least_singular(cell.robot, np.array([old.q_in[:6], new.q_in[:6]]))
        assert sigma[1] >= min(sigma[0], COMFORT) - 1e-9
    assert sum(p.seconds for p in better.paths) < sum(p.seconds for p in paths)
    driven = [time_plan(cell, t, p).duration for t, p in ((tour, paths), (better.tour, better.paths))]
    assert driven[1] < driven[0]


def test_the_judges_own_rule_finds_the_refined_poses_in_the_slack(cell, views, better):
    from scanmotion.cell.kinematics import scanner_in_object

    for stop in better.tour.stops:
        v = views[stop.viewpoints[0]]
        record = ViewpointRecord(
            id=v.id, X_OS=v.X_OS.tolist(), standoff_m=v.standoff, step="local", kind="station",
            slack_standoff_m=v.slack.standoff, slack_tilt_rad=v.slack.tilt,
        )  # fmt: skip
        off, angle, _ = nearest(record, scanner_in_object(cell, stop.q_in[None]))
        assert off <= 0.0 and angle <= 0.0


def test_the_same_again(cell, checker, views, planned, better):
    again = refined(cell, checker, *planned, views, rng=np.random.default_rng(1))
    assert again.viewpoints == better.viewpoints
    for a, b in zip(again.paths, better.paths, strict=True):
        assert np.array_equal(a.q, b.q)


def test_without_slack_every_pose_stays(cell, checker, views, planned):
    exact = {k: replace(v, slack=Slack(roll=False)) for k, v in views.items()}
    same = refined(cell, checker, *planned, exact, rng=np.random.default_rng(1))
    assert not same.viewpoints and all(a is b for a, b in zip(same.paths, planned[1], strict=True))


@pytest.mark.parametrize("fault", ["slower", "blocked", "outside", "too near"])
def test_a_pose_of_drakes_that_is_no_good_is_not_taken(cell, checker, views, planned, monkeypatch, fault):
    """Planted answers of the solver: the analytic pose stays."""
    from scanmotion.cell.ik.slack_plant import SlackPlant

    def answer(self, asked, seed, distance, cost):
        off = {"slower": 0.0, "blocked": 0.0, "outside": 0.2, "too near": 0.8}[fault]
        q = seed.copy()
        q[1] += off
        return q

    monkeypatch.setattr(SlackPlant, "refined", answer)
    if fault == "slower":
        monkeypatch.setattr(
            refine, "_cost", lambda *_: lambda q: (float(np.random.default_rng(0).random()), 0)
        )
    if fault == "blocked":
        monkeypatch.setattr(refine, "_better_pose", lambda cell, s, c, view, q, between: q + 1e-3)
        monkeypatch.setattr(refine, "_ways", lambda *_: None)
    same = refined(cell, checker, *planned, views, rng=np.random.default_rng(1))
    assert not same.viewpoints


def test_the_cost_has_the_derivatives_that_it_says(cell):
    rng = np.random.default_rng(2)
    a, b, q = (cell.home + rng.normal(size=7) * 0.2 for _ in range(3))
    cost = refine._cost(cell, (a, b))
    value, slope = cost(q)
    for j in range(7):
        h = 1e-5 * np.eye(7)[j]
        assert slope[j] == pytest.approx((cost(q + h)[0] - cost(q - h)[0]) / 2e-5, abs=2e-3), j
    assert np.isfinite(value)
