"""Every fault that is planted in a plan's files is found by the judge, and a plan without one passes."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from judged_plan import Written, hand_made_files
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import flange_poses, scanner_poses
from scanmotion.cell.settings.cell import builtin_cells, load_cell
from scanmotion.core.errors import PlanFileError
from scanmotion.judge import verify
from scanmotion.judge.limits import check_limits
from scanmotion.judge.motion import arm_from_urdf, exponentials, motion_at
from scanmotion.plan_io.read import read_plan, read_trajectory

ROOT = Path(__file__).resolve().parents[1] / "scanmotion"
TRANSIT, REVOLUTION, TO_SWEEP, SWEEP, TO_DWELL, DWELL = range(6)
AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")


@pytest.fixture(scope="module")
def files():
    return hand_made_files()


@pytest.fixture
def written(files):
    return Written(files)


@pytest.fixture(scope="module")
def box_cell():
    return build_cell(load_cell("kr240"))


def codes(findings):
    return {f.code for f in findings}


def spoiled(written, tmp_path):
    return verify(written.write(tmp_path / "plan"))


def moved(X, *, by=(0, 0, 0), turn=(0, 0, 0)):
    """X moved and turned in its own frame [m, deg]."""
    Y = np.eye(4)
    Y[:3, :3] = Rotation.from_rotvec(turn, degrees=True).as_matrix()
    Y[:3, 3] = by
    return (np.array(X) @ Y).tolist()


def view(written, name):
    return next(v for v in written.plan["viewpoints"] if v["id"] == name)


# The unspoiled plan


def test_the_unspoiled_plan_passes(written, tmp_path):
    assert spoiled(written, tmp_path) == []


def test_all_kinds_of_operation_are_in_it(written):
    assert {o["kind"] for o in written.plan["operations"]} == {"transit", "revolution", "sweep", "dwell"}


def test_the_judge_reports_its_progress(written, tmp_path):
    seen = []
    verify(written.write(tmp_path / "plan"), progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 1.0


# Collisions


def bump(written, operation, offset_deg, *, width=100):
    """A smooth excursion to configuration + offset in the middle of an operation."""
    rows = written.rows_of(operation)
    middle = rows[len(rows) // 2 - width : len(rows) // 2 + width + 1]
    shape = np.sin(np.linspace(0, np.pi, len(middle))) ** 2
    written.deg[middle] += shape[:, None] * np.asarray(offset_deg)
    return middle


def toward(written, cell, row, p_W):
    """Change of the six joints [deg] that brings the scanner's origin to p_W from where that row has it."""
    q = np.deg2rad(written.deg[row])

    def miss(x):
        here = scanner_poses(cell, np.append(q[:6] + x, q[6])[None])
        return np.append((np.asarray(here)[0, :3, 3] - p_W) * 10, 1e-3 * x)

    x = least_squares(miss, np.zeros(6)).x
    assert np.linalg.norm(miss(x)[:3]) < 0.05
    return np.append(np.rad2deg(x), 0.0)


@pytest.mark.parametrize(
    ("body", "at"), [("part", (2.2, 0.0, 0.95)), ("table", (2.0, 0.5, 0.68)), ("floor", (1.6, 1.2, 0.0))]
)
@pytest.mark.parametrize("operation", [TRANSIT, TO_DWELL])
def test_a_stretch_that_leads_into_something_is_a_collision(written, tmp_path, box_cell, body, at, operation):
    rows = written.rows_of(operation)
    middle = bump(written, operation, toward(written, box_cell, rows[len(rows) // 2], np.array(at)))
    found = [f for f in spoiled(written, tmp_path) if f.code == "collision"]
    assert any(body in f.where.split(", ") for f in found)
    assert all(written.t[middle[0]] <= f.t <= written.t[middle[-1]] for f in found)


def test_the_arm_folded_into_itself_is_a_collision(written, tmp_path):
    rows = written.rows_of(TRANSIT)
    q = written.deg[rows[len(rows) // 2]]
    bump(written, TRANSIT, [0, -130 - q[1], 165 - q[2], 0, 0, 0, 0])
    found = {f.where for f in spoiled(written, tmp_path) if f.code == "collision"}
    assert any(not set(w.split(", ")) & {"part", "table", "table_column", "floor"} for w in found)


def test_a_collision_between_two_samples_is_found(written, tmp_path):
    rows = written.rows_of(TO_DWELL)
    k = rows[len(rows) // 2]
    # From one sample to the next A1 swings by 60 deg; a thin plate stands half-way.
    written.deg[k:, 0] += 60.0
    record = read_plan(Written(hand_made_files()).write(tmp_path / "clean"))
    arm = arm_from_urdf(
        (tmp_path / "clean" / "robot.urdf").read_text(), record.robot_joints, record.flange_link
    )
    half_way = np.deg2rad((written.deg[k - 1] + written.deg[k]) / 2)[None]
    p = motion_at(arm, record, np.zeros(1), half_way).X_WS[0, :3, 3]
    plate = {"name": "plate", "frame": "world", "shape": "box", "size_m": [0.002, 0.002, 0.002]}
    written.plan["bodies"].append(
        {**plate, "X": [[1, 0, 0, p[0]], [0, 1, 0, p[1]], [0, 0, 1, p[2]], [0, 0, 0, 1]]}
    )
    found = [f for f in spoiled(written, tmp_path) if "plate" in f.where]
    assert "collision" in codes(found)
    assert all(written.t[k - 1] < f.t < written.t[k] for f in found if f.code == "collision")
    # At the samples themselves the plate is far away.
    ends = motion_at(arm, record, np.zeros(2), np.deg2rad(written.deg[k - 1 : k + 1])).X_WS[:, :3, 3]
    assert np.linalg.norm(ends - p, axis=1).min() > 0.5


@pytest.mark.parametrize(("gap", "expected"), [(0.0, "collision"), (0.028, "clearance"), (0.0305, None)])
def test_the_clearance_is_measured(written, tmp_path, gap, expected):
    # A cube that hangs behind the scanner where it dwells, its face at a known distance.
    rows = written.rows_of(DWELL)
    for o in (0, 1, 2, 3, 4):
        written.drop(written.rows_of(o))
    written.plan["operations"] = [{**written.plan["operations"][DWELL], "index": 0}]
    written.operation[:] = 0
    written.table[:, 0] -= written.table[0, 0]
    written.agree()
    written.plan["unreachable"] = [[n, "left out"] for n in ("G1", "S1", "S2", "S3")]
    assert len(rows) == len(written.table)
    folder = written.write(tmp_path / "plan")
    record = read_plan(folder)
    arm = arm_from_urdf((folder / "robot.urdf").read_text(), record.robot_joints, record.flange_link)
    motion = motion_at(arm, record, np.zeros(1), np.deg2rad(written.deg[:1]))
    scanner = next(b for b in record.bodies if b.name == "scanner")
    side, X = 0.05, np.eye(4)
    X[0, 3] = scanner.size_m[0] / 2 + gap + side / 2 - (1e-4 if gap == 0 else 0)
    X = motion.X_WF[0] @ np.array(scanner.X) @ X
    cube = {"name": "cube", "frame": "world", "shape": "box", "size_m": [side] * 3, "X": X.tolist()}
    written.plan["bodies"].append(cube)
    found = spoiled(written, tmp_path)
    if expected is None:
        assert found == []
        return
    (finding,) = [f for f in found if f.where == "scanner, cube"]
    assert finding.code == expected
    if expected == "clearance":
        assert finding.value == pytest.approx(gap, abs=1e-6)


# Speed of the scanner


@pytest.mark.parametrize("operation", [TRANSIT, TO_SWEEP, SWEEP, TO_DWELL])
def test_a_scanner_at_12_centimetres_per_second_is_found(written, tmp_path, box_cell, operation):
    own = written.rows_of(operation)
    X = np.asarray(scanner_poses(box_cell, np.deg2rad(written.deg[own])))
    fastest = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1).max() / 0.01
    whole = written.rows_with_start(operation)
    duration = written.t[whole[-1]] - written.t[whole[0]]
    written.retimed(operation, round(duration * fastest / 0.12, 2))
    (finding,) = spoiled(written, tmp_path)
    assert finding.code == "tcp_speed"
    assert finding.value == pytest.approx(0.12, rel=0.01)
    assert finding.where == written.plan["operations"][operation]["kind"]


@pytest.mark.parametrize("operation", [TRANSIT, SWEEP])
def test_a_retimed_stretch_below_the_limit_passes(written, tmp_path, operation):
    own = written.rows_with_start(operation)
    written.retimed(operation, round(written.t[own[-1]] - written.t[own[0]], 2) + 0.5)
    assert spoiled(written, tmp_path) == []


def test_a_transit_that_is_called_a_revolution_does_not_hide_its_speed(written, tmp_path):
    written.plan["operations"][TRANSIT]["kind"] = "revolution"
    assert {"tcp_speed", "order"} <= codes(spoiled(written, tmp_path))


# Limits of the seven axes


def limit_of(written, name, axis):
    return np.array(written.plan["limits"][name])[axis]


@pytest.mark.parametrize("axis", range(7), ids=AXES)
@pytest.mark.parametrize(
    ("order", "expected"),
    [
        (3, {"jerk"}),
        (2, {"jerk", "acceleration"}),
        (1, {"jerk", "acceleration", "velocity"}),
    ],
)
def test_one_sample_off_breaks_the_limits_of_its_axis(written, tmp_path, axis, order, expected):
    # One sample off by d makes the differences d/h, 2d/h2 and 3d/h3.
    name, weight = {1: ("velocity_rad_s", 1), 2: ("acceleration_rad_s2", 2), 3: ("jerk_rad_s3", 3)}[order]
    d = 1.15 * limit_of(written, name, axis) * 0.01**order / weight
    k = written.rows_of(TRANSIT)[40]
    written.deg[k, axis] += np.rad2deg(d)
    found = [
        f for f in spoiled(written, tmp_path) if f.code in ("position", "velocity", "acceleration", "jerk")
    ]
    assert codes(found) == expected
    assert {f.where for f in found} == {AXES[axis]}
    assert all(abs(f.t - written.t[k]) <= 0.02 for f in found)
    worst = next(f for f in found if f.code == {1: "velocity", 2: "acceleration", 3: "jerk"}[order])
    assert worst.value > 1.05 * worst.limit


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("axis", range(7), ids=AXES)
def test_a_passed_range_is_found(written, tmp_path, axis, side):
    bound = limit_of(written, "position_min_rad" if side < 0 else "position_max_rad", axis)
    k = written.rows_of(TO_SWEEP)[60]
    written.deg[k, axis] = np.rad2deg(bound) + side * 0.01
    found = [f for f in spoiled(written, tmp_path) if f.code == "position"]
    assert [f.where for f in found] == [AXES[axis]]
    assert found[0].t == pytest.approx(written.t[k])


@pytest.mark.parametrize("axis", range(7), ids=AXES)
@pytest.mark.parametrize(
    ("order", "code", "name"),
    [
        (1, "velocity", "velocity_rad_s"),
        (2, "acceleration", "acceleration_rad_s2"),
        (3, "jerk", "jerk_rad_s3"),
    ],
)
def test_limits_are_sharp(written, tmp_path, axis, order, code, name):
    # q = c t^n / n! has a constant n-th derivative, and the others stay below their limits for a while.
    t = np.arange(6 if order == 3 else 24) * 0.01
    for share, expected in ((1.07, [code]), (0.995, [])):
        value = share * limit_of(written, name, axis)
        start = np.deg2rad(written.deg[0])
        q = np.tile(start, (len(t), 1))
        q[:, axis] += value * t**order / (1, 1, 2, 6)[order] * (-1 if start[axis] > 1 else 1)
        written.table, written.operation = np.column_stack([t, np.rad2deg(q)]), np.zeros(len(t), int)
        folder = written.write(tmp_path / "plan")
        record = read_plan(folder)
        found = check_limits(record, read_trajectory(folder, record))
        assert [(f.code, f.where) for f in found] == [(c, AXES[axis]) for c in expected]


def test_a_short_step_elsewhere_excuses_nothing(written, tmp_path):
    # Rounding of the file weighs more over short steps; that must count where they are alone.
    d = 1.3 * limit_of(written, "jerk_rad_s3", 0) * 1e-6 / 3
    written.deg[written.rows_of(TRANSIT)[40], 0] += np.rad2deg(d)
    rest = written.rows_of(DWELL)[5]
    for n in (1, 2):
        row = written.table[rest].copy()
        row[0] += n * 1e-4
        written.table = np.insert(written.table, rest + n, row, axis=0)
        written.operation = np.insert(written.operation, rest + n, DWELL)
    assert ("jerk", "A1") in {(f.code, f.where) for f in spoiled(written, tmp_path)}


def test_limits_that_the_plan_invents_are_found(written, tmp_path):
    limits = written.plan["limits"]
    limits["velocity_rad_s"][2] *= 1.1
    limits["position_max_rad"][0] += 0.1
    limits["velocity_rad_s"][6] *= 1.1
    found = [f for f in spoiled(written, tmp_path) if f.code == "limits"]
    assert {f.where for f in found} == {"A3", "A1", "turntable.speed_rpm"}


@pytest.mark.parametrize(
    "key", ["scan_speed_m_s", "transit_speed_m_s", "fps", "dwell_s", "clearance_m", "budget_s"]
)
def test_promises_that_differ_from_the_cell_are_found(written, tmp_path, key):
    written.plan["process"][key] *= 1.01
    found = spoiled(written, tmp_path)
    assert ("limits", f"process.{key}") in {(f.code, f.where) for f in found}


# Viewpoints


@pytest.mark.parametrize("name", ["G1", "S2", "L1"])
def test_a_missed_viewpoint_is_found(written, tmp_path, name):
    for o in written.plan["operations"]:
        o["viewpoints"] = [v for v in o["viewpoints"] if v != name]
    found = spoiled(written, tmp_path)
    assert [(f.code, f.where) for f in found] == [("viewpoint", name)]
    written.plan["unreachable"] = [[name, "out of reach"]]
    assert spoiled(written, tmp_path) == []


def test_a_viewpoint_both_served_and_given_up_is_found(written, tmp_path):
    written.plan["unreachable"] = [["L1", "out of reach"]]
    assert [(f.code, f.where) for f in spoiled(written, tmp_path)] == [("viewpoint", "L1")]


def test_an_unknown_viewpoint_and_a_doubled_one_are_found(written, tmp_path):
    written.plan["operations"][DWELL]["viewpoints"] = ["L1", "L9"]
    written.plan["viewpoints"].append(dict(view(written, "L1")))
    found = spoiled(written, tmp_path)
    assert codes(found) == {"viewpoint"} and len(found) == 2


OFF = {
    "5 mm along x": {"by": (0.005, 0, 0)},
    "5 mm along y": {"by": (0, 0.005, 0)},
    "5 mm along z": {"by": (0, 0, 0.005)},
    "1 deg about x": {"turn": (1, 0, 0)},
    "1 deg about y": {"turn": (0, 1, 0)},
    "1 deg about z": {"turn": (0, 0, 1)},
}


# Along x and y of the scanner the sweep passes S2 elsewhere.
@pytest.mark.parametrize(
    ("name", "off"),
    [(n, off) for n in ("G1", "S2", "L1") for off in OFF if n != "S2" or off[-1] == "z" or "deg" in off],
)
def test_a_pose_that_is_off_is_found(written, tmp_path, name, off):
    v = view(written, name)
    v["X_OS"] = moved(v["X_OS"], **OFF[off])
    assert [(f.code, f.where) for f in spoiled(written, tmp_path)] == [("viewpoint", name)]


@pytest.mark.parametrize("name", ["G1", "S2", "L1"])
def test_a_pose_within_what_is_tolerated_passes(written, tmp_path, name):
    v = view(written, name)
    v["X_OS"] = moved(v["X_OS"], by=(0.0003, 0.0003, 0.0003), turn=(0.05, 0.05, 0.05))
    assert spoiled(written, tmp_path) == []


@pytest.mark.parametrize("azimuth", [-170.0, 1.0, 93.3])
def test_the_azimuth_of_a_revolution_is_free_and_of_a_station_not(written, tmp_path, azimuth):
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0, 0, azimuth], degrees=True).as_matrix()
    g, s = view(written, "G1"), view(written, "L1")
    g["X_OS"] = (turn @ np.array(g["X_OS"])).tolist()
    assert spoiled(written, tmp_path) == []
    s["X_OS"] = (turn @ np.array(s["X_OS"])).tolist()
    assert [(f.code, f.where) for f in spoiled(written, tmp_path)] == [("viewpoint", "L1")]


def about_aim(X, standoff, *, tilt=0.0, change=0.0):
    """X tilted about the aimed point [deg] and set back by `change` [m]."""
    X = np.array(moved(X, by=(0, 0, standoff)))
    return moved(moved(X, turn=(tilt, 0, 0)), by=(0, 0, -standoff - change))


@pytest.mark.parametrize(
    ("tilt", "change", "side", "fine"),
    [
        (0.0, 0.0, 0.0, True),
        (9.5, 0.0, 0.0, True),
        (0.0, 0.045, 0.0, True),
        (-9.5, -0.045, 0.0, True),
        (11.0, 0.0, 0.0, False),
        (0.0, 0.055, 0.0, False),
        (0.0, -0.055, 0.0, False),
        (0.0, 0.0, 0.005, False),
        (5.0, 0.02, 0.005, False),
    ],
)
def test_slack_lets_the_scanner_tilt_and_step_back_but_not_look_aside(
    written, tmp_path, tilt, change, side, fine
):
    v = view(written, "L1")
    v["slack_standoff_m"], v["slack_tilt_rad"] = (-0.05, 0.05), np.deg2rad(10)
    v["X_OS"] = moved(about_aim(v["X_OS"], v["standoff_m"], tilt=tilt, change=change), by=(side, 0, 0))
    v["standoff_m"] += change
    found = spoiled(written, tmp_path)
    assert [(f.code, f.where) for f in found] == ([] if fine else [("viewpoint", "L1")])


def test_free_roll_is_free(written, tmp_path):
    v = view(written, "L1")
    v["X_OS"] = moved(v["X_OS"], turn=(0, 0, 75))
    assert codes(spoiled(written, tmp_path)) == {"viewpoint"}
    v["slack_roll"] = True
    assert spoiled(written, tmp_path) == []


def test_a_revolution_served_by_a_dwell_is_found(written, tmp_path):
    view(written, "L1")["kind"] = "revolution"
    assert [(f.code, f.where) for f in spoiled(written, tmp_path)] == [("viewpoint", "L1")]


def test_poses_follow_from_the_urdf_alone(written, tmp_path):
    text = written.files["robot.urdf"].decode()
    at = text.index("<joint")
    start = text.index('xyz="', at) + 5
    end = text.index('"', start)
    x, y, z = text[start:end].split()
    written.files["robot.urdf"] = f"{text[:start]}{x} {y} {float(z) + 0.005:.6f}{text[end:]}".encode()
    assert {f.where for f in spoiled(written, tmp_path) if f.code == "viewpoint"} == {
        "G1", "S1", "S2", "S3", "L1",
    }  # fmt: skip


# Order, operations, time


def test_a_sweep_passed_the_other_way_is_found(written, tmp_path):
    written.plan["operations"][SWEEP]["viewpoints"] = ["S3", "S2", "S1"]
    found = spoiled(written, tmp_path)
    assert codes(found) == {"order"}


def test_two_stops_exchanged_are_found(written, tmp_path):
    o = written.plan["operations"]
    o[REVOLUTION]["viewpoints"], o[DWELL]["viewpoints"] = ["L1"], ["G1"]
    assert {(f.code, f.where) for f in spoiled(written, tmp_path)} >= {
        ("viewpoint", "G1"),
        ("viewpoint", "L1"),
    }


def test_operations_out_of_order_are_found(written, tmp_path):
    o = written.plan["operations"]
    o[TRANSIT]["index"], o[TO_SWEEP]["index"] = TO_SWEEP, TRANSIT
    assert "order" in codes(spoiled(written, tmp_path))


def test_samples_in_another_operation_are_found(written, tmp_path):
    written.operation[written.rows_of(TO_SWEEP)[50:60]] = TRANSIT
    assert [f.code for f in spoiled(written, tmp_path)] == ["order"]


def test_a_dwell_too_short_is_found(written, tmp_path):
    written.drop(written.rows_of(DWELL)[10:20])
    last = written.rows_of(DWELL)
    written.table[last, 0] = written.t[last[0] - 1] + 0.01 * np.arange(1, len(last) + 1)
    written.agree()
    (finding,) = spoiled(written, tmp_path)
    assert finding.code == "order" and "0.20 s instead of 0.30 s" in finding.message


def test_a_dwell_that_moves_is_found(written, tmp_path):
    rows = written.rows_of(DWELL)[5:25]
    written.deg[rows, 0] += 0.01 * np.sin(np.linspace(0, np.pi, len(rows))) ** 2
    assert {"order", "tcp_speed"} <= codes(spoiled(written, tmp_path))


@pytest.mark.parametrize(("turn", "fine"), [(359.0, False), (300.0, False), (361.0, True)])
def test_a_revolution_of_less_than_a_turn_is_found(written, tmp_path, turn, fine):
    own, back = written.rows_of(REVOLUTION), written.rows_of(TO_SWEEP)
    start = written.deg[own[0] - 1, 6]
    written.deg[own, 6] = start + (written.deg[own, 6] - start) * turn / 360
    # The transit after it brings the table where it would have been.
    s = np.linspace(0, 1, len(back) + 1)[1:]
    written.deg[back, 6] += (turn - 360) * (1 - (10 * s**3 - 15 * s**4 + 6 * s**5))
    written.agree()
    found = spoiled(written, tmp_path)
    if fine:
        assert found == []
    else:
        assert [f.code for f in found if "turns" in f.message] == ["order"]
        assert f"{turn:.2f} deg instead of 360" in " ".join(f.message for f in found)


def test_an_arm_that_moves_in_a_revolution_is_found(written, tmp_path):
    rows = written.rows_of(REVOLUTION)
    written.deg[rows, 3] += 0.05 * np.sin(np.linspace(0, np.pi, len(rows))) ** 4
    assert "the arm moves" in " ".join(f.message for f in spoiled(written, tmp_path))


def test_a_table_that_turns_in_a_sweep_is_found(written, tmp_path):
    rows = written.rows_of(SWEEP)
    written.deg[rows, 6] += 0.05 * np.sin(np.linspace(0, np.pi, len(rows))) ** 4
    assert "the table turns by" in " ".join(f.message for f in spoiled(written, tmp_path))


def test_an_operation_that_does_not_stop_is_found(written, tmp_path):
    # The boundary between transit and revolution is moved to where the arm is still on its way.
    rows = written.rows_of(TRANSIT)
    written.operation[rows[-80:]] = REVOLUTION
    written.agree()
    assert {"rest", "order", "tcp_speed"} <= codes(spoiled(written, tmp_path))


def test_a_jump_between_operations_is_found(written, tmp_path):
    # A whole turn of the table: every viewpoint and every distance stays as it was.
    after = np.flatnonzero(written.operation >= TO_DWELL)
    written.deg[after, 6] -= 360.0
    written.agree()
    found = spoiled(written, tmp_path)
    assert ("velocity", "E1") in {(f.code, f.where) for f in found}


def test_coarse_samples_are_found(written, tmp_path):
    rows = written.rows_of(TO_SWEEP)
    written.drop(rows[20:120:2])
    assert "sampling" in codes(spoiled(written, tmp_path))


def test_finer_samples_pass(written, tmp_path):
    fine = np.arange(0, 2 * len(written.t) - 1) / 2
    whole = np.arange(len(written.t))
    table = CubicSpline(whole, written.table)(fine)
    table[::2] = written.table
    table[:, 0] = np.round(fine * 0.01, 4)
    written.table = table
    written.operation = written.operation[np.ceil(fine).astype(int)]
    written.files.pop("trajectory.json")
    assert spoiled(written, tmp_path) == []


def test_the_budget(written, tmp_path):
    total = written.t[-1]
    for limit, expected in ((total + 0.1, set()), (total - 0.1, {"budget"})):
        written.plan["process"]["budget_s"] = limit
        cell = json.loads(written.files["cell.json"])
        cell["process"]["budget_s"] = limit
        written.files["cell.json"] = json.dumps(cell)
        assert codes(spoiled(written, tmp_path)) == expected


# Files that disagree, files that are not what they say


def test_a_plan_that_disagrees_with_its_trajectory_is_found(files, tmp_path):
    def shifted(key, by):
        written = Written(files)
        value = written.plan["operations"][SWEEP][key]
        written.plan["operations"][SWEEP][key] = (
            value + by if np.isscalar(value) else [value[0] + by, *value[1:]]
        )
        return codes(spoiled(written, tmp_path))

    assert "order" in shifted("q_start", 1e-4)
    assert "order" in shifted("q_end", -1e-4)
    assert "order" in shifted("t_start", 0.05)
    assert "order" in shifted("t_end", -0.05)


def test_an_operation_left_out_is_found(written, tmp_path):
    gone = written.rows_of(TO_DWELL)
    written.drop(gone)
    assert {"order", "sampling"} <= codes(spoiled(written, tmp_path))


def test_two_trajectories_that_differ_are_found(written, tmp_path):
    twin = json.loads(written.files["trajectory.json"])
    twin["position"][100][2] += 1e-6
    written.files["trajectory.json"] = json.dumps(twin)
    assert [f.code for f in spoiled(written, tmp_path)] == ["order"]
    for broken in ({}, [1], {"time": [0, 1], "position": [[0] * 7] * 2}, {"time": "x", "position": None}):
        written.files["trajectory.json"] = json.dumps(broken)
        assert [f.code for f in spoiled(written, tmp_path)] == ["order"]


@pytest.mark.parametrize("summary", [{"time_s": {"total": 12.0}}, {}, [], {"time_s": {"total": "x"}}])
def test_a_summary_with_another_time_is_found(written, tmp_path, summary):
    written.files["summary.json"] = json.dumps({"time_s": {"total": round(float(written.t[-1]), 3)}})
    assert spoiled(written, tmp_path) == []
    written.files["summary.json"] = json.dumps(summary)
    # One for the scan's seconds; one more for the cycle's, where nothing at all is told.
    assert set(codes(spoiled(written, tmp_path))) == {"summary"}


def test_settings_of_another_shape_are_found(written, tmp_path):
    for broken in ([], {"process": 3}, {"process": {}, "turntable": {"speed_rpm": "x"}}):
        written.files["cell.json"] = json.dumps(broken)
        assert codes(spoiled(written, tmp_path)) == {"limits"}


def refused(written, tmp_path, match):
    with pytest.raises(PlanFileError, match=match):
        spoiled(written, tmp_path)


def test_a_tampered_header_is_refused(written, tmp_path):
    written.header = written.header.replace("A1_deg", "A1_rad")
    refused(written, tmp_path, "header")


def test_a_tampered_kind_or_operation_is_refused(written, tmp_path):
    text = written.text
    for old, new in (
        (",1,revolution", ",1,dwell"),
        (",1,revolution", ",77,revolution"),
        (",5,dwell", ",-1,dwell"),
    ):
        written.text = lambda old=old, new=new: text().replace(old, new, 1)
        refused(written, tmp_path, "not in plan.json|not numbers")


@pytest.mark.parametrize(
    "broken", ["", "<robot/>", "<robot", "<!DOCTYPE x [<!ENTITY a 'b'>]><robot>&a;</robot>"]
)
def test_a_broken_urdf_is_refused(written, tmp_path, broken):
    written.files["robot.urdf"] = broken
    refused(written, tmp_path, "URDF")


@pytest.mark.parametrize(
    ("old", "new"),
    [('axis xyz="0 0 -1"', 'axis xyz="0 0 0"'), ('lower="', 'lower="nan'), ('upper="', 'upper="-9')],
)
def test_a_urdf_with_senseless_numbers_is_refused(written, tmp_path, old, new):
    text = written.files["robot.urdf"].decode()
    assert old in text
    written.files["robot.urdf"] = text.replace(old, new)
    refused(written, tmp_path, "URDF")


def test_a_part_without_triangles_is_refused(written, tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {c}\n" for c in "xyz")
    written.files["part.ply"] = head + "end_header\n0 0 0\n"
    refused(written, tmp_path, "part.ply")


@pytest.mark.parametrize("gap, touches", [(0.004, True), (0.024, True), (0.027, False)])
def test_a_pillar_that_the_turning_part_hits_is_found(written, tmp_path, gap, touches):
    """The part is 0.2 x 0.15 m: standing still its side is 0.1 m off the axis, its corners draw 0.125 m."""
    pillar = np.eye(4)
    pillar[:3, 3] = np.array(written.plan["X_WT"])[:3, 3] + [0.1 + gap + 0.02, 0.0, 0.05]
    written.plan["bodies"].append(
        {
            "name": "pillar",
            "frame": "world",
            "shape": "box",
            "size_m": [0.04, 0.002, 0.08],
            "X": pillar.tolist(),
        }
    )
    found = verify(written.write(tmp_path / "plan"))
    assert any(f.code == "collision" and f.where == "part, pillar" for f in found) == touches


def test_bodies_of_impossible_size_are_refused(written, tmp_path):
    for size in ([0.1, -0.1, 0.1], [0.1, 0.1], [0.1, 0.0, 0.1]):
        written.plan["bodies"][0]["size_m"] = size
        refused(written, tmp_path, "sizes")


# Independence


def test_the_judge_imports_nothing_of_what_it_judges():
    def imports(path):
        names = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {a.name for a in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names |= {node.module, *(f"{node.module}.{a.name}" for a in node.names)}
        return names

    todo, seen, outside = [*(ROOT / "judge").rglob("*.py")], set(), set()
    while todo:
        path = todo.pop()
        if path in seen:
            continue
        seen.add(path)
        for name in imports(path):
            file = ROOT.parent.joinpath(*name.split("."))
            inner = [p for p in (file.with_suffix(".py"), file / "__init__.py") if p.is_file()]
            todo += inner
            if not name.startswith("scanmotion"):
                outside.add(name.split(".")[0])
    settings = {
        p for p in seen if p.relative_to(ROOT).parts[:2] in (("cell", "__init__.py"), ("cell", "settings"))
    }
    rooms = {p.relative_to(ROOT).parts[0] for p in seen - settings}
    assert rooms <= {"__init__.py", "judge", "core", "geometry", "plan_io"}
    assert "fcl" in outside
    # numba compiles loops of the files' readers, which planner and judge share.
    assert not outside & {"pydrake", "py_opw_kinematics", "ompl", "open3d", "toppra"}


def test_judging_loads_neither_the_planner_nor_drake():
    code = (
        "import sys, scanmotion.judge\n"
        "rooms = ('motion', 'cell', 'sensing', 'views', 'planning')\n"
        "bad = {'pydrake', *('scanmotion.' + r for r in rooms)}\n"
        "print(sorted(bad & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("name", builtin_cells())
def test_own_kinematics_agree_with_the_cells(name, files, tmp_path, rng):
    cell = build_cell(load_cell(name))
    record = read_plan(Written(files).write(tmp_path / "plan"))
    record = record.model_copy(
        update={
            k: tuple(map(tuple, np.asarray(getattr(cell, k)).tolist()))
            for k in ("X_WB", "X_FS", "X_WT", "X_TO")
        }
    )
    arm = arm_from_urdf(cell.urdf_path.read_text(), cell.settings.robot.joints, cell.settings.robot.flange)
    low = np.where(np.isfinite(cell.q_min), cell.q_min, -10)
    high = np.where(np.isfinite(cell.q_max), cell.q_max, 10)
    q = rng.uniform(low, high, (300, 7))
    motion = motion_at(arm, record, np.arange(300.0), q)
    assert np.abs(motion.X_WF - flange_poses(cell, q)).max() < 1e-9
    assert np.abs(motion.X_WS - scanner_poses(cell, q)).max() < 1e-9
    turn = Rotation.from_rotvec(q[:, 6:] * [0, 0, 1]).as_matrix()
    assert np.abs(motion.X_WO[:, :3, :3] - np.asarray(cell.X_WT)[:3, :3] @ turn).max() < 1e-12
    assert np.abs(arm.lower - cell.q_min[:6]).max() < 1e-9 and np.abs(arm.upper - cell.q_max[:6]).max() < 1e-9
    assert (np.asarray(cell.v_max)[:6] <= arm.velocity * (1 + 1e-9)).all()


def test_own_kinematics_give_the_published_pose(files, tmp_path):
    # facts of the KR 240 R2900-2: flange at the generic pose 15, -75, 110, -20, 35, 50 deg.
    record = read_plan(Written(files).write(tmp_path / "plan"))
    arm = arm_from_urdf(
        (tmp_path / "plan" / "robot.urdf").read_text(), record.robot_joints, record.flange_link
    )
    q = np.deg2rad([[15, -75, 110, -20, 35, 50, 0], [0, 0, 0, 0, 0, 0, 0], [0, -90, 90, 0, 0, 0, 0]])
    X = np.linalg.inv(np.array(record.X_WB)) @ motion_at(arm, record, np.arange(3.0), q).X_WF
    assert np.abs(X[0, :3, 3] - [1.781355, -0.428570, 1.124713]).max() < 1e-6
    assert np.abs(X[1:, :3, 3] - [[3.140, 0, 0.760], [1.790, 0, 2.110]]).max() < 1e-9
    # KUKA's A, B, C are turns about z, y', x''.
    abc = Rotation.from_matrix(X[0, :3, :3]).as_euler("ZYX", degrees=True)
    assert np.abs(abc - [-158.7481, 24.1078, -176.8023]).max() < 1e-3


def test_exponentials_are_those_of_matrices(rng):
    from scipy.linalg import expm

    for _ in range(20):
        w = rng.normal(size=3)
        w, v, angle = w / np.linalg.norm(w), rng.normal(size=3), rng.uniform(-9, 9)
        S = np.zeros((4, 4))
        S[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
        S[:3, 3] = v
        assert np.abs(exponentials(np.r_[w, v], np.array([angle]))[0] - expm(S * angle)).max() < 1e-12
