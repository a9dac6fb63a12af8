"""Programmes for a robot are read back: KRL by a parser of the tests, ROS by PyYAML, rosbags and mcap."""

import shutil
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from exported_plan import SPEED, made_by_hand
from krl_reader import read_programme
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from scanmotion.cell.build import build_cell
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.settings import load_cell
from scanmotion.core.errors import InputError
from scanmotion.core.trajectory import Trajectory
from scanmotion.export import export_plan, krl
from scanmotion.export.source import source_from, write_files
from scanmotion.geometry.parts import box_part
from scanmotion.judge import verify
from scanmotion.plan_io.write import csv_text, plan_files

LAST_DIGIT = 0.51e-5
"""Half of the last digit of a programme's numbers [deg or mm]."""


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.2, 0.15, 0.4))


@pytest.fixture(scope="module")
def folder(cell, tmp_path_factory):
    """A plan folder without a finding of the judge; tests do not change it."""
    folder = tmp_path_factory.mktemp("plan")
    write_files(folder, plan_files(made_by_hand(cell)))
    return folder


@pytest.fixture(scope="module")
def plan(folder):
    return source_from(folder)


@pytest.fixture(scope="module")
def programmes(folder, tmp_path_factory):
    """Both manners, parsed."""
    found = {}
    for to in ("krl", "krl-timed"):
        out = tmp_path_factory.mktemp(to)
        files = export_plan(folder, to, out=out, name="scan_a")
        assert sorted(p.name for p in files) == ["scan_a.dat", "scan_a.src"]
        found[to] = read_programme(out, "scan_a")
    return found


def drake_poses(cell, degrees):
    """X_WS of configurations (n, 7) [deg] by Drake, mm for lengths."""
    drake = drake_of(cell)
    context = drake.plant.CreateDefaultContext()
    flange = drake.plant.GetFrameByName(cell.settings.robot.flange)
    found = []
    for q in drake.positions(np.deg2rad(degrees)):
        drake.plant.SetPositions(context, q)
        X = flange.CalcPoseInWorld(context).GetAsMatrix4() @ cell.X_FS
        X[:3, 3] *= 1e3
        found.append(X)
    return np.array(found)


def pose_of(values):
    """X of a FRAME's X, Y, Z, A, B, C: A about z, then B about y', then C about x''."""
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("ZYX", [values[k] for k in "ABC"], degrees=True).as_matrix()
    X[:3, 3] = [values[k] for k in "XYZ"]
    return X


# --- both manners ---------------------------------------------------------------------------------


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
def test_programme_has_the_plans_operations_start_tool_and_warning(to, programmes, plan):
    programme = programmes[to]
    assert "no controller has run this programme" in " ".join(programme.remarks)
    np.testing.assert_allclose(programme.start, np.rad2deg(plan.trajectory.q[0]), atol=LAST_DIGIT)
    X = pose_of(programme.tool)
    np.testing.assert_allclose(X[:3, 3], np.array(plan.record.X_FS)[:3, 3] * 1e3, atol=LAST_DIGIT)
    np.testing.assert_allclose(X[:3, :3], np.array(plan.record.X_FS)[:3, :3], atol=2e-7)
    operations = plan.trajectory.operations
    assert len(programme.folds) == len(operations)
    for n, (fold, o) in enumerate(zip(programme.folds, operations, strict=True), 1):
        assert fold.title.startswith(f"{n} {o.kind} {' '.join(o.viewpoints)}, {o.t_start:.3f} s")
        assert fold.title.endswith("scanner on" if o.scanning else "scanner off")


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
def test_long_programmes_are_split_into_pages_that_say_the_same(
    to, folder, programmes, tmp_path, monkeypatch
):
    longest = 2 * max(len(f.moves) for f in programmes[to].folds) + 20
    monkeypatch.setattr(krl, "LINES_A_FILE", longest)
    files = export_plan(folder, to, out=tmp_path, name="a" * 20)
    sources = [p for p in files if p.suffix == ".src"]
    assert len(sources) > 2
    for p in sources:
        assert p.stem == "a" * 20 or p.read_bytes().count(b"\n") <= longest
        assert len(p.stem) <= 24
    paged = read_programme(tmp_path, "a" * 20)
    assert paged.folds == programmes[to].folds
    np.testing.assert_array_equal(paged.start, programmes[to].start)


# --- timed ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
def test_an_output_is_on_while_the_scanner_scans(to, folder, programmes, tmp_path):
    files = export_plan(folder, to, out=tmp_path, signal=17)
    with_signal = read_programme(tmp_path, "scan").folds
    for fold, plain in zip(with_signal, programmes[to].folds, strict=True):
        switched = [next(iter(m.values.items())) for m in fold.moves if m.kind == "OUT"]
        if "scanner on" in fold.title:
            assert switched == [(17, True), (17, False)]
            assert fold.moves[0].kind == fold.moves[-1].kind == "OUT"
        else:
            assert switched == [] and "scanner off" in fold.title
        assert [m for m in fold.moves if m.kind != "OUT"] == plain.moves
    text = "".join(file.read_text() for file in files if file.suffix == ".src")
    assert text.index("$OUT[17]=FALSE") < text.index("PTP XSTART") and "output 17 is on then" in text


@pytest.mark.parametrize("to, signal", [("krl", 0), ("krl-timed", -3), ("krl", 10_000), ("csv", 1)])
def test_what_is_no_output_is_refused(to, signal, folder, tmp_path):
    with pytest.raises(InputError, match="--signal"):
        export_plan(folder, to, out=tmp_path / "out", signal=signal)
    assert not (tmp_path / "out").exists()


def as_trajectory(programme, plan):
    """The motion of a timed programme at the plan's instants: cubic splines at rest at their ends."""
    t, rows, start = plan.trajectory.t, [], 0.0
    here = programme.start
    for fold in programme.folds:
        end = start + fold.moves[-1].t
        inside = t[(t > start + 1e-6) & (t <= end + 1e-6)] - start
        if fold.moves[0].kind == "WAIT":
            rows.append(np.tile(here, (len(inside), 1)))
        else:
            points = np.array([m.joints for m in fold.moves])
            np.testing.assert_allclose(points[0], here, atol=2 * LAST_DIGIT)
            rows.append(CubicSpline([m.t for m in fold.moves], points, bc_type="clamped")(inside))
            here = points[-1]
        start = end
    q = np.deg2rad(np.vstack([programme.start, *rows]))
    qd = np.gradient(q, t, axis=0)
    return Trajectory(
        t=t, q=q, qd=qd, qdd=np.gradient(qd, t, axis=0), operation=plan.trajectory.operation,
        operations=plan.trajectory.operations,
    )  # fmt: skip


def test_timed_points_are_the_planned_joints_at_the_planned_times(programmes, plan):
    planned = CubicSpline(plan.trajectory.t, np.rad2deg(plan.trajectory.q))
    start = 0.0
    for fold, o in zip(programmes["krl-timed"].folds, plan.trajectory.operations, strict=True):
        assert fold.moves[-1].t == pytest.approx(o.t_end - o.t_start, abs=1.01e-4)
        if o.kind == "dwell":
            assert [m.kind for m in fold.moves] == ["WAIT"]
        else:
            times = np.array([m.t for m in fold.moves])
            assert times[0] == 0 and np.diff(times).min() > 0.029 and np.diff(times).max() < 0.27
            # Times in steps of 1e-5 percent of the block; every planned instant is a multiple of 0.1 ms.
            joints = np.array([m.joints for m in fold.moves])
            np.testing.assert_allclose(joints, planned(start + times), atol=LAST_DIGIT + 2e-4)
            exact = planned(np.round(start + times, 4))
            np.testing.assert_allclose(joints, exact, atol=2 * LAST_DIGIT)
        start += fold.moves[-1].t
    assert start == pytest.approx(plan.trajectory.duration, abs=1e-3)


def test_timed_programme_is_judged_like_the_plan(programmes, plan, folder, tmp_path):
    assert verify(folder) == []
    back = as_trajectory(programmes["krl-timed"], plan)
    assert np.rad2deg(np.abs(back.q - plan.trajectory.q).max()) < 0.015
    copy = Path(shutil.copytree(folder, tmp_path / "back"))
    (copy / "trajectory.json").unlink()
    (copy / "trajectory.csv").write_text(csv_text(back))
    # A cubic spline jerks at its points; everything else that the judge looks at has to hold.
    assert [str(f) for f in verify(copy) if f.code not in ("jerk", "acceleration")] == []


def test_a_planted_fault_in_the_programme_is_found_by_the_judge(programmes, plan, folder, tmp_path):
    back = as_trajectory(programmes["krl-timed"], plan)
    q = back.q.copy()
    q[:, 1] += np.deg2rad(60)
    copy = Path(shutil.copytree(folder, tmp_path / "back"))
    (copy / "trajectory.csv").write_text(csv_text(Trajectory(**{**vars(back), "q": q})))
    assert verify(copy)


# --- classic --------------------------------------------------------------------------------------


def test_classic_points_lie_on_the_planned_path_and_nothing_lies_beside(programmes, plan):
    here = programmes["krl"].start
    for fold, stretch in zip(programmes["krl"].folds, plan.stretches(), strict=True):
        path = np.rad2deg(stretch.q)
        if stretch.operation.kind in ("transit", "revolution"):
            points = np.array([here, *(m.joints for m in fold.moves)])
            assert all(m.kind == "PTP" for m in fold.moves)
            # Each point is a sample of the path, in its order.
            order = [int(np.abs(path - p).max(axis=1).argmin()) for p in points]
            order[-1] = len(path) - 1
            assert np.abs(path[order] - points).max() < 2 * LAST_DIGIT
            assert order[0] == 0 and np.all(np.diff(order) > 0)
            for (i, j), (a, b) in zip(pairwise(order), pairwise(points), strict=True):
                dense = a + np.linspace(0, 1, 4001)[:, None] * (b - a)
                away = [np.abs(dense - p).max(axis=1).min() for p in path[i : j + 1 : 3]]
                assert max(away) < 0.05 + 0.01
            assert fold.moves[-1].about == ""
        here = path[-1]


def test_classic_rounds_only_shallow_corners(programmes, plan):
    found, here = set(), programmes["krl"].start
    for fold, stretch in zip(programmes["krl"].folds, plan.stretches(), strict=True):
        moves = [m for m in fold.moves if m.kind == "PTP"]
        points = [here, *(m.joints for m in moves)]
        for move, a, b, c in zip(moves, points, points[1:], points[2:], strict=False):
            cut = np.abs(a - 2 * b + c).max() / 4
            assert (move.about == "C_PTP") == (cut <= 0.2 + 1e-4)
            found.add(move.about)
        here = np.rad2deg(stretch.q[-1])
    assert found == {"", "C_PTP"}


def test_classic_is_never_faster_than_the_plan(programmes, plan):
    fastest = np.array([103, 94, 100, 170, 129, 206, 60.0])
    here = programmes["krl"].start
    for fold, stretch in zip(programmes["krl"].folds, plan.stretches(), strict=True):
        seconds = 0.0
        for move in fold.moves:
            if move.kind == "PTP":
                speeds = np.abs(move.joints - here) / fastest
                seconds += speeds.max() / (move.percent / 100)
                here = move.joints
        peak = 100 * np.max(np.abs(stretch.qd) / np.deg2rad(fastest))
        assert all(m.percent <= max(peak + 1e-3, 1) for m in fold.moves if m.kind == "PTP")
        if stretch.operation.kind == "revolution":
            (move,) = fold.moves
            assert move.values["E1"] == pytest.approx(360, abs=LAST_DIGIT)
            # A rest-to-rest quintic is on average 1.875 times slower than its peak, a PTP never is.
            assert seconds >= stretch.duration / 1.875 * 0.999
        here = np.rad2deg(stretch.q[-1])


def test_classic_scanner_is_never_faster_than_the_plan(programmes, plan, cell):
    fastest = np.array([103, 94, 100, 170, 129, 206, 60.0])
    here, compared = programmes["krl"].start, 0
    for fold, stretch in zip(programmes["krl"].folds, plan.stretches(), strict=True):
        if stretch.operation.kind == "transit":
            places = drake_poses(cell, np.rad2deg(stretch.q[::5]))[:, :3, 3]
            planned = (np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(stretch.t[::5])).max()
            for move in fold.moves:
                seconds = (np.abs(move.joints - here) / fastest).max() / (move.percent / 100)
                way = drake_poses(cell, here + np.linspace(0, 1, 5)[:, None] * (move.joints - here))
                speed = np.linalg.norm(np.diff(way[:, :3, 3], axis=0), axis=1).max() * 4 / seconds
                assert speed <= 1.02 * planned or move.percent == 1
                here, compared = move.joints, compared + 1
        here = np.rad2deg(stretch.q[-1])
    assert compared >= 15


def test_classic_dwell_waits_as_planned(programmes, plan):
    fold = programmes["krl"].folds[-1]
    assert [m.kind for m in fold.moves] == ["WAIT"]
    assert fold.moves[0].t == pytest.approx(0.5, abs=1e-4)


def test_classic_sweep_is_one_line_at_the_planned_speed(programmes, plan, cell):
    n = next(i for i, o in enumerate(plan.trajectory.operations) if o.kind == "sweep")
    (move,) = programmes["krl"].folds[n].moves
    stretch = plan.stretches()[n]
    assert move.kind == "LIN" and move.about == ""
    assert move.speed == pytest.approx(0.999 * SPEED, rel=0.01)
    assert move.values["E1"] == pytest.approx(330, abs=LAST_DIGIT)
    # $BASE is the robot's base, $TOOL the scanner: Drake says where that is at the sweep's last joints.
    end = np.rad2deg(stretch.q[-1])
    X = np.linalg.inv(cell.X_WB) @ drake_poses(cell, end[None])[0]
    np.testing.assert_allclose(pose_of(move.values), X, atol=2e-5)
    # The other way: the joints at which the scanner is there, sought from the sweep's first joints.
    target = np.asarray(cell.X_WB) @ pose_of(move.values)

    def miss(six):
        found = drake_poses(cell, np.append(six, move.values["E1"])[None])[0]
        turn = Rotation.from_matrix(found[:3, :3].T @ target[:3, :3]).as_rotvec()
        return np.concatenate([found[:3, 3] - target[:3, 3], 1e3 * turn])

    solved = least_squares(miss, np.rad2deg(stretch.q[0, :6]), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose(solved.x, end[:6], atol=1e-4)


# --- ROS ------------------------------------------------------------------------------------------


def test_yaml_is_the_message_by_pyyaml(folder, plan, tmp_path):
    from rosbags.typesys import Stores, get_typestore

    (file,) = export_plan(folder, "ros", out=tmp_path)
    data, t = yaml.load(file.read_text(), Loader=yaml.CSafeLoader), plan.trajectory
    kinds = get_typestore(Stores.ROS2_HUMBLE).types
    fields = kinds["trajectory_msgs/msg/JointTrajectory"].__dataclass_fields__
    assert set(data) == set(fields) - {"__msgtype__"}
    point = kinds["trajectory_msgs/msg/JointTrajectoryPoint"].__dataclass_fields__
    assert all(set(p) == set(point) - {"__msgtype__"} for p in data["points"])
    assert data["joint_names"] == list(plan.record.joint_names)
    times = [p["time_from_start"]["sec"] + p["time_from_start"]["nanosec"] * 1e-9 for p in data["points"]]
    np.testing.assert_allclose(times, t.t, atol=1e-9)
    assert all(0 <= p["time_from_start"]["nanosec"] < 10**9 for p in data["points"])
    for key, value, atol in (
        ("positions", t.q, 5.1e-11), ("velocities", t.qd, 5.1e-9), ("accelerations", t.qdd, 5.1e-7),
    ):  # fmt: skip
        np.testing.assert_allclose([p[key] for p in data["points"]], value, atol=atol)
    # Controllers refuse a trajectory that ends in motion.
    assert not any(data["points"][0]["velocities"]) and not any(data["points"][-1]["velocities"])


@pytest.fixture(scope="module")
def bag(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("bag")
    files = export_plan(folder, "mcap", out=out, name="demo")
    assert [p.name for p in files] == ["demo_bag.mcap", "metadata.yaml"]
    return out / "demo_bag"


def check_messages(messages, plan):
    """What a reader made of the bag: (topic, nanoseconds, message) in order of time."""
    t = plan.trajectory
    states = [(ns, m) for topic, ns, m in messages if topic == "/joint_states"]
    np.testing.assert_allclose([ns * 1e-9 for ns, _ in states], t.t, atol=1e-9)
    np.testing.assert_array_equal([list(m.position) for _, m in states], t.q)
    np.testing.assert_array_equal([list(m.velocity) for _, m in states], t.qd)
    (whole,) = [m for topic, _, m in messages if topic == "/joint_trajectory"]
    assert list(whole.joint_names) == list(plan.record.joint_names)
    np.testing.assert_array_equal([list(p.positions) for p in whole.points], t.q)
    np.testing.assert_array_equal([list(p.accelerations) for p in whole.points], t.qdd)
    stamps = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in whole.points]
    assert stamps == [ns for ns, _ in states]
    on = [(round(ns * 1e-9, 3), m.data) for topic, ns, m in messages if topic == "/scanner_on"]
    o = t.operations
    assert [o[i].kind for i in (1, 3, 5)] == ["revolution", "sweep", "dwell"]
    expected = [(0.0, False)]
    for i in (1, 3, 5):
        expected += [(o[i].t_start, True), (o[i].t_end, False)]
    assert [state for _, state in on] == [state for _, state in expected]
    np.testing.assert_allclose([at for at, _ in on], [at for at, _ in expected], atol=1.1e-3)


def test_bag_is_read_by_rosbags(bag, plan):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        messages = [(c.topic, ns, reader.deserialize(raw, c.msgtype)) for c, ns, raw in reader.messages()]
    check_messages(messages, plan)


def test_mcap_file_alone_is_read_by_the_mcap_library(bag, plan):
    from mcap_ros2.reader import read_ros2_messages

    messages = [
        (m.channel.topic, m.log_time_ns, m.ros_msg) for m in read_ros2_messages(str(bag / "demo_bag.mcap"))
    ]
    check_messages(messages, plan)


def test_without_the_library_one_line_says_what_to_install(folder, tmp_path, monkeypatch):
    for name in ("rosbags", "rosbags.rosbag2", "rosbags.typesys"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"pip install 'scanmotion\[ros\]'") as caught:
        export_plan(folder, "mcap", out=tmp_path / "out")
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()
    # YAML needs no library.
    assert export_plan(folder, "ros", out=tmp_path / "out")


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
def test_an_arm_with_other_signs_gets_no_kuka_programme(to, folder, tmp_path):
    own = Path(shutil.copytree(folder, tmp_path / "own"))
    text = (own / "robot.urdf").read_text()
    assert text.count('<axis xyz="0 0 -1"/>') == 1
    (own / "robot.urdf").write_text(text.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 1"/>'))
    with pytest.raises(InputError, match="KUKA"):
        export_plan(own, to, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
