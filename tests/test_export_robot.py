"""What ROS is given is read back by PyYAML, rosbags and mcap; a KUKA programme needs a KUKA's joints."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from exported_plan import made_by_hand

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.errors import InputError
from scanmotion.export import export_files
from scanmotion.export.source import source_from, write_files
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.plan_io.write import plan_files


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


# --- ROS ------------------------------------------------------------------------------------------


def test_yaml_is_the_message_by_pyyaml(folder, plan, tmp_path):
    from rosbags.typesys import Stores, get_typestore

    (file,) = export_files(folder, "ros", out=tmp_path)
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
    files = export_files(folder, "mcap", out=out, name="demo")
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
        export_files(folder, "mcap", out=tmp_path / "out")
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()
    # YAML needs no library.
    assert export_files(folder, "ros", out=tmp_path / "out")


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
def test_an_arm_with_other_signs_gets_no_kuka_programme(to, folder, tmp_path):
    own = Path(shutil.copytree(folder, tmp_path / "own"))
    text = (own / "robot.urdf").read_text()
    assert text.count('<axis xyz="0 0 -1"/>') == 1
    (own / "robot.urdf").write_text(text.replace('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 1"/>'))
    with pytest.raises(InputError, match="KUKA"):
        export_files(own, to, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
