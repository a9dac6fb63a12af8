"""ROS 2: trajectory_msgs/JointTrajectory as YAML, and as a rosbag2 folder with an MCAP file."""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.export.job import ExportJob, Files
from scanmotion.export.source import Source

FRAME = "base_link"
TRAJECTORY, STATES, SCANNING = "/joint_trajectory", "/joint_states", "/scanner_on"


def yaml_files(job: ExportJob) -> Files:
    """One JointTrajectory message as ROS 2 tools print and read it (`ros2 topic pub` takes it)."""
    source, name = job.source, job.name
    names = ", ".join(json.dumps(n) for n in source.record.joint_names)
    lines = [
        "# trajectory_msgs/msg/JointTrajectory, rad, rad/s, rad/s2",
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        f"  frame_id: {FRAME}",
        f"joint_names: [{names}]",
        "points:",
    ]
    t = source.trajectory
    for row in zip(_nanoseconds(source), t.q, t.qd, t.qdd, strict=True):
        ns, q, qd, qdd = row
        lines += [
            f"- positions: {_numbers(q, 10)}",
            f"  velocities: {_numbers(qd, 8)}",
            f"  accelerations: {_numbers(qdd, 6)}",
            "  effort: []",
            f"  time_from_start: {{sec: {ns // 10**9}, nanosec: {ns % 10**9}}}",
        ]
    return {f"{name}.yaml": "\n".join(lines) + "\n"}


def bag_files(job: ExportJob) -> Files:
    """A rosbag2 folder `<name>_bag`: the trajectory, the joint states over time, and when the scanner is on.

    Raises:
        InputError: the library rosbags is missing.
    """
    source, name = job.source, job.name
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            "--to mcap needs the library rosbags, which is missing: pip install 'scanmotion[ros]'"
        ) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    folder = f"{name}_bag"
    with tempfile.TemporaryDirectory() as work:
        bag = Path(work) / folder
        with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            _write_messages(writer, store, source)
        return {f"{folder}/{p.name}": p.read_bytes() for p in sorted(bag.iterdir())}


def _write_messages(writer: Any, store: Any, source: Source) -> None:
    """The trajectory stands at time zero; readers sort what follows by its time."""
    kinds = store.types
    topics = {
        topic: (writer.add_connection(topic, kind, typestore=store), kind)
        for topic, kind in (
            (TRAJECTORY, "trajectory_msgs/msg/JointTrajectory"),
            (STATES, "sensor_msgs/msg/JointState"),
            (SCANNING, "std_msgs/msg/Bool"),
        )
    }

    def write(topic: str, ns: int, message: Any) -> None:
        connection, kind = topics[topic]
        writer.write(connection, ns, store.serialize_cdr(message, kind))

    names, t = list(source.record.joint_names), source.trajectory
    write(TRAJECTORY, 0, _trajectory(kinds, source))
    for ns, q, qd in zip(_nanoseconds(source), t.q, t.qd, strict=True):
        state = kinds["sensor_msgs/msg/JointState"](
            header=_header(kinds, ns), name=names, position=q, velocity=qd, effort=np.zeros(0)
        )
        write(STATES, ns, state)
    for ns, on in _switches(source):
        write(SCANNING, ns, kinds["std_msgs/msg/Bool"](data=on))


def _switches(source: Source) -> list[tuple[int, bool]]:
    """Instants [ns] at which the scanner goes on or off, the start and the end among them."""
    states = [(round(float(s.t[0]) * 1e9), s.operation.scanning) for s in source.stretches()]
    states.append((round(source.trajectory.duration * 1e9), False))
    return [state for i, state in enumerate(states) if i == 0 or state[1] != states[i - 1][1]]


def _trajectory(kinds: Any, source: Source) -> Any:
    t = source.trajectory
    point, duration = (
        kinds["trajectory_msgs/msg/JointTrajectoryPoint"],
        kinds["builtin_interfaces/msg/Duration"],
    )
    return kinds["trajectory_msgs/msg/JointTrajectory"](
        header=_header(kinds, 0),
        joint_names=list(source.record.joint_names),
        points=[
            point(
                positions=q, velocities=qd, accelerations=qdd, effort=np.zeros(0),
                time_from_start=duration(sec=ns // 10**9, nanosec=ns % 10**9),
            )
            for ns, q, qd, qdd in zip(_nanoseconds(source), t.q, t.qd, t.qdd, strict=True)
        ],
    )  # fmt: skip


def _header(kinds: Any, ns: int) -> Any:
    stamp = kinds["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME)


def _nanoseconds(source: Source) -> list[int]:
    return [round(float(t) * 1e9) for t in source.trajectory.t]


def _numbers(values: np.ndarray, digits: int) -> str:
    # Fixed notation: YAML 1.1 reads 1e-05 as text.
    return "[" + ", ".join(f"{v:.{digits}f}" for v in np.round(values, digits) + 0.0) + "]"
