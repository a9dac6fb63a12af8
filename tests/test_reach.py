"""Reach: answers are inside limits, free and at the pose asked for; what it refuses has a true reason."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from fcl_check import FclCell

from scanmotion.cell.build import build_cell, robot_path
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import branches, scanner_poses, wrist_shortfall
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.motion.reach.diagnosis import Change, cause_of
from scanmotion.motion.reach.find import ReachOptions, reach, reachable_mask
from scanmotion.motion.reach.ik_candidates import ik_candidates, presented, table_angles

TOLERANCE_M = 2e-4
ALL = ReachOptions(most=10**6)
COARSE = ReachOptions(most=10**6, azimuth_step=np.deg2rad(30.0), rolls=4, remedies=False)


def station(name, p, direction, *, roll=True, standoff=0.7, **slack):
    return Viewpoint(
        id=name, X_OS=look_at(np.array(p, dtype=float), np.array(direction, dtype=float)), standoff=standoff,
        step="local", kind="station", slack=Slack(roll=roll, **slack),
    )  # fmt: skip


def random_stations(n, rng, *, roll=False):
    """Views of the part from all sides, 0.5 to 0.9 m off."""
    views = []
    for k in range(n):
        u = rng.normal(size=3) * [1, 1, 0.6]
        u[2] = abs(u[2])
        u /= np.linalg.norm(u)
        tilt = rng.normal(size=3) * 0.2
        views.append(station(f"V{k}", u * rng.uniform(0.6, 1.0) + [0, 0, 0.1], tilt - u, roll=roll))
    return views


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.6, 0.33, 0.2))


@pytest.fixture(scope="module")
def checker(cell):
    return Clearance(cell)


@pytest.fixture(scope="module")
def second(cell):
    return FclCell(cell)


def test_answers_keep_limits_clearance_and_pose(cell, checker, second):
    views = random_stations(12, np.random.default_rng(0))
    served = 0
    for item in reach(cell, views, clearance=checker):
        assert (item.unreachable is None) == (len(item.q) > 0)
        assert len(item.q) == len(item.clearance) == len(item.manipulability) == len(item.X_OS) <= 96
        assert (item.q >= cell.q_min).all() and (item.q <= cell.q_max).all()
        for k in range(0, len(item.q), 12):
            q = item.q[k]
            _, X_WS, X_WO = second.frames(q)
            X_OS = np.linalg.inv(X_WO) @ X_WS
            np.testing.assert_allclose(X_OS, item.viewpoint.X_OS, atol=1e-9)
            np.testing.assert_allclose(X_OS, item.X_OS[k], atol=1e-9)
            outside, inside = second.distances(q)
            assert outside >= checker.clearance + min(item.clearance[k], 0.5) - TOLERANCE_M
            assert inside >= checker.self_clearance - TOLERANCE_M
            served += 1
    assert served > 30


def test_a_free_roll_changes_the_roll_only(cell, checker):
    found = reach(cell, [station("V", (0.7, 0.2, 0.5), (-1, -0.2, -0.4))], clearance=checker)[0]
    X = found.X_OS
    np.testing.assert_allclose(X[:, :3, 2], np.tile(found.viewpoint.direction, (len(X), 1)), atol=1e-9)
    np.testing.assert_allclose(X[:, :3, 3], np.tile(found.viewpoint.p_OS, (len(X), 1)), atol=1e-9)
    assert len(np.unique(np.round(X[:, 0, 0], 6))) > 3


def test_manipulability_is_the_least_singular_value(cell, checker, second):
    """Of the flange's Jacobian, here by Drake."""
    from pydrake.multibody.tree import JacobianWrtVariable

    found = reach(cell, random_stations(3, np.random.default_rng(3)), clearance=checker)
    for item in found:
        for q, sigma in list(zip(item.q, item.manipulability, strict=True))[:4]:
            second.frames(q)
            plant, context = second.plant, second.context
            J = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kQDot, plant.GetFrameByName("tool0"), np.zeros(3),
                plant.world_frame(), plant.world_frame(),
            )  # fmt: skip
            columns = [plant.GetJointByName(n).velocity_start() for n in second.names[:6]]
            assert sigma == pytest.approx(np.linalg.svd(J[:, columns])[1].min(), abs=1e-6)


def test_all_configurations_are_there(cell, checker):
    """Every branch and winding at every angle and roll that the fast tier frees, by brute force."""
    view = station("V", (0.6, -0.3, 0.5), (-1, 0.4, -0.5))
    found = reach(cell, [view], clearance=checker, options=COARSE)[0]
    angles = table_angles(cell, view.X_OS, COARSE.azimuth_step, COARSE.azimuth_range)
    X_WS, table = presented(cell, view, angles, COARSE.rolls)
    rows = set()
    for X, e1 in zip(X_WS, table, strict=True):
        solved = branches(cell, X[None], windings=False)
        for q in solved.q:
            turns = np.array(np.meshgrid(*[[-1, 0, 1]] * 6)).reshape(6, -1).T * 2 * np.pi
            wound = np.column_stack([q + turns, np.full(len(turns), e1)])
            inside = ((wound >= cell.q_min) & (wound <= cell.q_max)).all(axis=1)
            rows |= {tuple(np.round(r, 6)) for r in wound[inside] if checker.fast_free(r[None])[0]}
    assert {tuple(np.round(r, 6)) for r in found.q} == rows
    assert len(rows) > 50


def test_few_are_the_best_of_all_when_asked_for_at_once(cell, checker):
    """What is kept are the first of the order of preference that are free, whatever is looked at together."""
    views = random_stations(7, np.random.default_rng(5), roll=True)
    together = reach(cell, views, clearance=checker, options=ReachOptions(most=24))
    for view, item in zip(views, together, strict=True):
        alone = reach(cell, [view], clearance=checker, options=ReachOptions(most=24))[0]
        assert np.array_equal(alone.q, item.q)
    ordered = ik_candidates(cell, [views[0]], [table_angles(cell, views[0].X_OS, 0.2, 1.0)], 4)
    seconds = (np.abs(ordered.q[:, :6] - cell.home[:6]) / cell.v_max[:6]).max(axis=1)
    at_azimuth = np.isclose(ordered.q[:, 6], ordered.q[0, 6]) & (ordered.sigma >= 0.02)
    assert (np.diff(seconds[at_azimuth]) >= -1e-12).all()


def test_one_is_found_where_many_are(cell, checker):
    views = random_stations(30, np.random.default_rng(6))
    one = reach(cell, views, clearance=checker, options=ReachOptions(most=1, remedies=False))
    many = reach(cell, views, clearance=checker, options=ReachOptions(remedies=False))
    assert [len(a.q) > 0 for a in one] == [len(a.q) > 0 for a in many]
    assert all(len(a.q) <= 1 for a in one)


def test_a_revolution_is_free_at_every_angle(cell, checker, second):
    X = look_at(np.array([0.9, 0.0, 0.3]), np.array([-1.0, 0.0, -0.2]))
    view = Viewpoint(id="G", X_OS=X, standoff=0.6, step="global", kind="revolution", slack=Slack(roll=False))
    found = reach(cell, [view], clearance=checker)[0]
    assert len(found.q) > 10
    assert np.allclose(found.q[:, 6], 0)
    p = found.X_OS[:, :3, 3]
    assert np.allclose(np.hypot(p[:, 0], p[:, 1]), 0.9) and np.allclose(p[:, 2], 0.3)
    assert np.allclose(found.X_OS[:, 2, 2], X[2, 2])
    for q in found.q[::12]:
        for e1 in np.linspace(0, 2 * np.pi, 9):
            assert second.distances(np.append(q[:6], e1))[0] >= checker.clearance - TOLERANCE_M


def test_the_mask_agrees_with_reach(cell, checker):
    views = random_stations(20, np.random.default_rng(8))
    mask = reachable_mask(cell, np.array([v.X_OS for v in views]), clearance=checker)
    found = reach(cell, views, clearance=checker, options=ReachOptions(most=1, remedies=False))
    assert not (mask & np.array([f.unreachable is not None for f in found])).any()
    assert mask.sum() > 10


def _rows(q):
    """Configurations as a set, the table's angle by its direction."""
    return {tuple(np.round([*r[:6], np.cos(r[6]), np.sin(r[6])], 5) + 0.0) for r in q}


def mirrored_urdf(source, target):
    """The robot mirrored at its plane y = 0, so that the same angles give the mirrored pose."""
    tree = ElementTree.parse(source)
    for link in tree.getroot().iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for origin in tree.getroot().iter("origin"):
        x, y, z = map(float, origin.get("xyz", "0 0 0").split())
        r, p, w = map(float, origin.get("rpy", "0 0 0").split())
        origin.set("xyz", f"{x!r} {-y!r} {z!r}")
        origin.set("rpy", f"{-r!r} {p!r} {-w!r}")
    for axis in tree.getroot().iter("axis"):
        x, y, z = map(float, axis.get("xyz").split())
        axis.set("xyz", f"{-x!r} {y!r} {-z!r}")
    tree.write(target)


def test_a_mirrored_cell_gives_mirrored_answers(tmp_path):
    pillar = {"name": "pillar", "centre_m": [1.3, 0.8, 1.0], "size_m": [0.2, 0.2, 2.0], "yaw_deg": 15.0}
    settings = settings_from({"obstacles": [pillar]})
    mirrored_urdf(robot_path(settings), tmp_path / "mirror.urdf")
    there = settings_from(
        {
            "robot": {"model": "mirror.urdf", "acceleration": [2.5, 1.6, 3.5, 7.4, 5.6, 9.0]},
            "obstacles": [pillar | {"centre_m": [1.3, -0.8, 1.0], "yaw_deg": -15.0}],
        },
        folder=str(tmp_path),
    )
    part = box_part(0.6, 0.33, 0.2)
    cell, mirror = build_cell(settings, part), build_cell(there, part)
    M = np.diag([1.0, -1.0, 1.0, 1.0])
    views = random_stations(6, np.random.default_rng(9))
    other = [v.moved(M @ v.X_OS @ M) for v in views]
    compared = 0
    for a, b in zip(reach(cell, views, options=COARSE), reach(mirror, other, options=COARSE), strict=True):
        turned = b.q * [1, 1, 1, 1, 1, 1, -1]
        assert _rows(a.q) == _rows(turned)
        compared += len(a.q)
    assert compared > 100


def test_a_turned_cell_gives_turned_answers():
    angle = 37.0
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    pillar = {"name": "pillar", "centre_m": [1.3, 0.8, 1.0], "size_m": [0.2, 0.2, 2.0], "yaw_deg": 15.0}
    turned = pillar | {"centre_m": [1.3 * c - 0.8 * s, 1.3 * s + 0.8 * c, 1.0], "yaw_deg": 15.0 + angle}
    part = box_part(0.6, 0.33, 0.2)
    cell = build_cell(settings_from({"obstacles": [pillar]}), part)
    other = build_cell(
        settings_from(
            {
                "base": {"yaw_deg": angle},
                "turntable": {"position_m": [2.2 * c, 2.2 * s]},
                "obstacles": [turned],
            }
        ),
        part,
    )
    views = random_stations(6, np.random.default_rng(10))
    compared = 0
    for a, b in zip(reach(cell, views, options=COARSE), reach(other, views, options=COARSE), strict=True):
        q = b.q - np.array([0, 0, 0, 0, 0, 0, math.radians(angle)])
        assert _rows(a.q) == _rows(q)
        compared += len(a.q)
    assert compared > 100


def test_a_table_that_starts_elsewhere_serves_all_the_same():
    """The range of E1 is 30 .. 390 deg: angles are brought into it by whole turns."""
    part = box_part(0.6, 0.33, 0.2)
    cell = build_cell(load_cell("kr240"), part)
    narrow = build_cell(settings_from({"turntable": {"range_deg": [30.0, 390.0]}}), part)
    views = random_stations(4, np.random.default_rng(11))
    for a, b in zip(reach(cell, views, options=COARSE), reach(narrow, views, options=COARSE), strict=True):
        assert (b.q >= narrow.q_min).all() and (b.q <= narrow.q_max).all()
        assert _rows(a.q) == _rows(b.q)


def sealed(half=1.0, height=2.2):
    """Four walls and a lid around the table, from the floor, that leave no opening."""
    x, t = 2.2, 0.02
    side, along = [t, 2 * half + t, height], [2 * half + t, t, height]
    plates = [
        ("front", [x - half, 0.0, height / 2], side),
        ("back", [x + half, 0.0, height / 2], side),
        ("left", [x, half, height / 2], along),
        ("right", [x, -half, height / 2], along),
        ("lid", [x, 0.0, height], [2 * half + t, 2 * half + t, t]),
    ]
    return [{"name": name, "centre_m": centre, "size_m": size} for name, centre, size in plates]


def test_in_a_sealed_box_every_viewpoint_has_its_reason():
    settings = settings_from({"obstacles": sealed()})
    cell = build_cell(settings, box_part(0.3, 0.2, 0.1))
    walls = {"front", "back", "left", "right", "lid"}
    views = [
        station(f"V{k}", (0.35 * math.cos(a), 0.35 * math.sin(a), h), (-math.cos(a), -math.sin(a), -0.3))
        for k, (a, h) in enumerate((a, h) for a in np.linspace(0, 2 * np.pi, 5)[:-1] for h in (0.2, 0.5))
    ]
    X = look_at(np.array([0.35, 0.0, 0.4]), np.array([-1.0, 0.0, -0.4]))
    views.append(Viewpoint(id="G", X_OS=X, standoff=0.4, step="global", kind="revolution"))
    found = reach(cell, views)
    assert len(found) == len(views)
    for item in found:
        assert item.unreachable is not None and item.unreachable.cause == "collision", item.unreachable
        pair = re.match(r"(\S+) and (\S+) (touch|come within)", item.unreachable.detail)
        assert pair is not None and pair[2] in walls, item.unreachable.detail
        assert item.unreachable.change is None and "no pedestal height" in item.unreachable.remedy


def test_out_of_reach_says_by_how_much_and_which_way(cell, checker):
    """Against the closed form: the wrist's distance from A2 less the straight arm's length."""
    c2, fore, c4 = 1.350, math.hypot(1.220, 0.115), 0.240
    low = Slack(roll=False)
    up = Viewpoint(
        id="up", X_OS=look_at(np.array([0.3, 0, 4.0]), np.array([0, 0, -1.0])), standoff=0.7, step="local",
        kind="station", slack=low,
    )  # fmt: skip
    lost = reach(cell, [up], clearance=checker)[0].unreachable
    assert lost is not None and lost.cause == "out_of_reach"
    said = re.search(r"(\d+) mm (farther out|closer in).*table at (-?\d+) deg", lost.detail)
    assert said is not None and said[2] == "farther out"
    angles = table_angles(cell, up.X_OS, ReachOptions().azimuth_step, np.pi)
    X_WF = presented(cell, up, angles, 1)[0] @ np.linalg.inv(cell.X_FS)
    wrist = X_WF[:, :3, 3] - c4 * X_WF[:, :3, 2]
    short = np.hypot(np.hypot(wrist[:, 0], wrist[:, 1]) - 0.330, wrist[:, 2] - 0.645) - c2 - fore
    assert float(said[1]) == pytest.approx(short.min() * 1e3, abs=1.0)
    assert short[np.argmin(np.abs(np.rad2deg(angles) - float(said[3])))] == pytest.approx(
        short.min(), abs=2e-3
    )


def test_too_near_to_the_base_is_closer_in():
    """A UR's wrist cannot come nearer to A1 than its own offset; by how much is true both ways."""
    cell = build_cell(load_cell("ur10e"))
    checker = Clearance(cell)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[:3, 3] = [0.02, 0.0, 0.6]
    X_WS = cell.X_WB @ down @ cell.X_FS
    short = float(wrist_shortfall(cell, X_WS[None])[0])
    assert short > 0.01
    view = station("V", (0.0, 0.0, 0.5), (0, 0, -1))
    lost = cause_of(cell, view, checker, X_WS[None], np.zeros(1), np.zeros((0, 7)))
    assert lost.cause == "out_of_reach" and f"{short * 1e3:.0f} mm closer in" in lost.detail
    for way, solved in ((1.05 * short, True), (0.9 * short, False)):
        moved = X_WS.copy()
        moved[:3, 3] += way * cell.X_WB[:3, 0]
        assert (wrist_shortfall(cell, moved[None])[0] <= 0) == solved


def limited(tmp_path, joint, low, high):
    settings = load_cell("kr240")
    tree = ElementTree.parse(robot_path(settings))
    for link in tree.getroot().iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for element in tree.getroot().iter("joint"):
        if element.get("name") == joint:
            element.find("limit").set("lower", str(math.radians(low)))
            element.find("limit").set("upper", str(math.radians(high)))
    tree.write(tmp_path / "limited.urdf")
    robot = {"model": "limited.urdf", "acceleration": [2.5, 1.6, 3.5, 7.4, 5.6, 9.0]}
    home = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0]
    home[int(joint[1]) - 1] = (low + high) / 2
    return settings_from({"robot": robot | {"home_deg": home}}, folder=str(tmp_path))


@pytest.mark.parametrize(("joint", "low", "high"), [("A5", -3.0, 3.0), ("A3", -120.0, -100.0)])
def test_a_limit_names_its_joint(tmp_path, joint, low, high):
    cell = build_cell(limited(tmp_path, joint, low, high), box_part(0.3, 0.2, 0.1))
    view = station("V", (0.5, 0.0, 0.4), (-1.0, 0.0, -0.5), roll=False)
    lost = reach(cell, [view])[0].unreachable
    assert lost is not None and lost.cause == "joint_limit"
    said = re.match(r"(A\d) would pass its limit by ([\d.]+) deg", lost.detail)
    assert said is not None and said[1] == joint
    wide = build_cell(load_cell("kr240"), cell.part)
    angles = table_angles(cell, view.X_OS, ReachOptions().azimuth_step, np.pi)
    q = branches(wide, presented(cell, view, angles, 1)[0]).q[:, int(joint[1]) - 1]
    least = np.maximum(np.maximum(math.radians(low) - q, q - math.radians(high)), 0).min()
    assert float(said[2]) == pytest.approx(math.degrees(least), abs=0.06)


def test_a_collision_names_the_pair():
    block = {"name": "block", "centre_m": [2.2, 0.0, 1.5], "size_m": [1.2, 1.2, 0.3]}
    cell = build_cell(settings_from({"obstacles": [block]}), box_part(0.3, 0.2, 0.1))
    lost = reach(cell, [station("V", (0.0, 0.0, 0.8), (0, 0, -1))])[0].unreachable
    assert lost is not None and lost.cause == "collision"
    assert re.match(r"\S+ and block touch", lost.detail), lost.detail


def test_remedies_are_true():
    """The proposed change is made to the settings, and the viewpoint is then reached, free by FCL."""
    shelf = {"name": "shelf", "centre_m": [2.2, 0.0, 1.62], "size_m": [1.4, 1.4, 0.1]}
    low = build_cell(settings_from({"obstacles": [shelf]}), box_part(0.3, 0.2, 0.1))
    far = build_cell(settings_from({"turntable": {"position_m": [3.3, 0.0]}}), box_part(0.3, 0.2, 0.1))
    rng = np.random.default_rng(12)
    proposed = 0
    for cell in (low, far):
        views = [
            station(
                f"V{k}", (r * math.cos(a), r * math.sin(a), h), (-math.cos(a), -math.sin(a), t), roll=False
            )
            for k, (r, a, h, t) in enumerate(rng.uniform([0.0, -3, 0.0, -3], [0.8, 3, 1.4, 0.5], (25, 4)))
        ]
        for item in reach(cell, views):
            if item.unreachable is None or item.unreachable.change is None:
                continue
            change = item.unreachable.change
            assert str(change) in item.unreachable.remedy
            settings = cell.settings
            x, y = settings.turntable.position_m
            table = settings.turntable.model_copy(update={"position_m": (x + change.shift_m, y)})
            pedestal = settings.pedestal.model_copy(
                update={"height_m": settings.pedestal.height_m + change.raise_m}
            )
            changed = build_cell(
                settings.model_copy(update={"turntable": table, "pedestal": pedestal}), cell.part
            )
            mended = reach(changed, [item.viewpoint])[0]
            assert mended.unreachable is None, item.unreachable
            if proposed % 4 == 0:
                assert FclCell(changed).distances(mended.q[0])[0] >= 0.03 - TOLERANCE_M
            proposed += 1
    assert proposed >= 5


def test_a_change_says_what_it_is(cell):
    assert str(Change(raise_m=0.2)) == "a pedestal 200 mm higher"
    assert str(Change(shift_m=-0.4)) == "the table 400 mm closer"
    moved = Change(shift_m=0.2).applied(cell)
    np.testing.assert_allclose(moved.X_WT[:3, 3], [2.4, 0.0, 0.7])
    np.testing.assert_allclose(Change(raise_m=0.3).applied(cell).X_TO[2, 3], 0.3)


def test_nothing_is_asked_for(cell, checker):
    assert reach(cell, [], clearance=checker) == []
    assert len(reachable_mask(cell, np.zeros((0, 4, 4)), clearance=checker)) == 0


def test_scanner_poses_are_those_of_drake(cell, second):
    rng = np.random.default_rng(13)
    q = rng.uniform(-2, 2, (20, 7))
    for row, X in zip(q, scanner_poses(cell, q), strict=True):
        np.testing.assert_allclose(second.frames(row)[1], X, atol=1e-12)
