"""Drake's last word on a motion: what it passes is free by FCL, what is pushed into something is caught."""

from dataclasses import replace

import numpy as np
import pytest
from fcl_check import FclCell
from judging import findings_of, summarised
from test_clearance import trough

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision import clearance
from scanmotion.cell.collision.last_word import DrakeJudge
from scanmotion.cell.collision.sphere_filter import filter_from
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import settings_from
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.motion.reach.find import ReachOptions, reach
from scanmotion.planning.pipeline import PlanOptions, plan

HOME = np.array([0.0, -2.04499919, 2.51461644, 0.0, 0.31578091, -np.pi, 0.0])
"""The scanner level before the table, free of everything [rad]."""


def moved(q: np.ndarray, step_s: float = 0.01) -> Trajectory:
    """Samples (n, 7), whatever their speed."""
    none = np.zeros_like(q)
    index = np.zeros(len(q), dtype=int)
    return Trajectory(t=step_s * np.arange(len(q)), q=q, qd=none, qdd=none, operation=index, operations=())


def straight(qa: np.ndarray, qb: np.ndarray, count: int) -> np.ndarray:
    return qa + np.linspace(0.0, 1.0, count)[:, None] * (qb - qa)


@pytest.fixture(scope="module")
def cell():
    obstacle = {"name": "pillar", "centre_m": [1.2, 0.9, 1.0], "size_m": [0.2, 0.3, 2.0], "yaw_deg": 20.0}
    return build_cell(settings_from({"obstacles": [obstacle], "pedestal": {"height_m": 0.1}}), trough())


@pytest.fixture(scope="module")
def judge(cell):
    return DrakeJudge(cell)


@pytest.fixture(scope="module")
def second(cell):
    return FclCell(cell)


@pytest.fixture(scope="module")
def in_the_trough(cell):
    """A configuration whose scanner is inside the part's hull and free of its triangles, looking down."""
    view = Viewpoint(
        id="L1", X_OS=look_at(np.array([0.0, 0.0, 0.52]), np.array([0.0, 0.0, -1.0])), standoff=0.42,
        step="local", kind="station",
    )  # fmt: skip
    found = reach(cell, [view], options=ReachOptions(most=1, remedies=False))[0]
    assert len(found.q), str(found.unreachable)
    return found.q[0]


def test_agrees_with_fcl_on_random_motions(cell, judge, second):
    """On some motions all round home, both say the same but where the clearance is kept within 1 mm."""
    rng = np.random.default_rng(4)
    process, caught = cell.settings.process, 0
    for _ in range(24):
        ends = HOME + rng.normal(size=(2, 7)) * np.array([0.35, 0.3, 0.3, 0.8, 0.6, 0.8, 2.0])
        q = straight(*np.clip(ends, cell.q_min, cell.q_max), 9)
        found = judge.judge(moved(q)).findings
        fine = np.array([second.distances(row) for row in straight(q[0], q[-1], 121)])
        worst = min((fine[:, 0] - process.clearance_m).min(), (fine[:, 1] - process.self_clearance_m).min())
        if worst < -0.004:
            assert found
            caught += 1
        elif worst > 0.004:
            assert not found, str(found[0])
    assert 3 < caught < 21


def test_a_thin_plate_between_two_samples_is_hit():
    """Neither sample touches the plate; the straight motion between them goes through it."""
    plate = {"name": "plate", "centre_m": [1.1, 0.0, 2.0], "size_m": [0.8, 0.004, 1.6], "yaw_deg": 0.0}
    cell = build_cell(settings_from({"obstacles": [plate]}), trough())
    q = np.tile(HOME, (2, 1))
    q[:, 0] = [-0.6, 0.6]
    judge = DrakeJudge(cell)
    for row in q:
        assert not judge.judge(moved(np.tile(row, (2, 1)))).findings
    found = judge.judge(moved(q)).findings
    assert found and found[0].code == "collision" and "surroundings" in found[0].where


def test_the_part_is_judged_by_its_triangles_not_by_its_hull(cell, judge, second, in_the_trough):
    """Inside the hull and clear of the triangles is free; pushed into the wall it touches the part."""
    still = judge.judge(moved(np.tile(in_the_trough, (3, 1))))
    assert still.by_triangles > 0 and not still.findings
    turned = np.tile(in_the_trough, (2, 1))
    turned[1, 6] += 0.6
    turned[1, 0] += 0.25
    truth = min(second.distances(row)[0] for row in straight(*turned, 200))
    assert truth <= 0.0
    found = judge.judge(moved(turned)).findings
    assert any(f.code == "collision" and "trough" in f.where for f in found)


def test_what_comes_too_near_is_told_with_its_distance(cell, judge, second):
    """The arm bends down until it is nearer to something than the clearance but does not touch it."""
    low, high, q = 0.0, 0.0, HOME.copy()

    def at(x: float) -> np.ndarray:
        row = q.copy()
        row[1] += x
        return row

    while second.distances(at(high))[0] > 0.015:
        low, high = high, high + 0.02
        assert high < 1.5
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if second.distances(at(middle))[0] > 0.015 else (low, middle)
    found = judge.judge(moved(straight(q, at(low), 40))).findings
    assert [f.code for f in found] == ["clearance"]
    assert found[0].value == pytest.approx(0.015, abs=3e-4)


def test_the_arm_against_itself(cell, judge):
    """A folded arm that touches itself is caught with the names of both links."""
    rng, q = np.random.default_rng(0), None
    second = FclCell(cell)
    for _ in range(4000):
        row = np.append(rng.uniform(cell.q_min[:6], cell.q_max[:6]), 0.0)
        world, own = second.distances(row)
        if own <= 0.0 and world > 0.1:
            q = row
            break
    assert q is not None
    found = judge.judge(moved(np.tile(q, (2, 1)))).findings
    assert found and all(f.code == "collision" for f in found)


def test_one_sample_and_none_of_motion(cell, judge):
    one = judge.judge(moved(HOME[None]))
    assert one.findings == () and one.way_m == 0.0


def test_an_obstacle_that_the_plan_does_not_know(cell, judge):
    """The same motion, judged in a cell with an obstacle in its way that the planner's cell has not."""
    q = np.tile(HOME, (30, 1))
    q[:, 0] += np.linspace(0.0, -0.8, 30)
    assert judge.judge(moved(q)).findings == ()
    box = {"name": "post", "centre_m": [0.75, 1.0, 1.9], "size_m": [0.3, 0.3, 1.9], "yaw_deg": 0.0}
    settings = settings_from({"obstacles": [box], "pedestal": {"height_m": 0.1}})
    other = build_cell(settings, replace(trough(), name="part"))
    found = DrakeJudge(other).judge(moved(q)).findings
    assert found and found[0].code == "collision"


def test_a_plan_whose_filter_is_blind_to_an_obstacle_fails_its_check(monkeypatch):
    """The obstacle stands in the scanner's way; Drake's word is in the findings, and the exit status is 1."""
    part, options = box_part(0.2, 0.15, 0.2), PlanOptions(source="box")
    free = plan(part, settings_from({}), options=options)
    assert free.last_word is not None and free.last_word.findings == () and free.last_word.checked > 100
    assert free.trajectory is not None
    p = scanner_poses(free.cell, free.trajectory.q)[:, :3, 3]
    way = np.linalg.norm(p - p[0], axis=1)
    at = p[int(np.argmin(np.abs(way - way.max() / 2)))]
    box = {"name": "post", "centre_m": [float(x) for x in at], "size_m": [0.1] * 3, "yaw_deg": 0.0}

    def blind(cell, *args, **kwargs):
        seen = replace(cell, bodies=tuple(b for b in cell.bodies if b.name != "post"))
        return filter_from(seen, *args, **kwargs)

    monkeypatch.setattr(clearance, "filter_from", blind)
    planned = plan(part, settings_from({"obstacles": [box]}), options=options)
    assert planned.last_word is not None and planned.last_word.findings
    assert any("Drake" in str(f) for f in findings_of(planned))
    summary = summarised(planned).summary
    assert summary.drake.findings > 0 and not summary.passes
