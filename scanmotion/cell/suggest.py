"""A first cell for an arm of one's own: its chain, its flange, a layout in proportion to its reach.

What a URDF does not say (accelerations, where the table stands) is guessed, and each guess is said in the
YAML that comes out.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanmotion.cell.arm.robot import Robot, arm_poses
from scanmotion.cell.arm.robot_file import ends_of_six, robot_from_file
from scanmotion.cell.ik.choice import solver_of
from scanmotion.core.errors import CellError

_KR240_REACH_M = 2.575
"""Shoulder to wrist of the KR 240, for which the default cell was laid out."""
_RAMP_S = 0.6
"""Guessed time from rest to full speed: that of the KR 240's light preset, roughly."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Suggestion:
    """A cell's YAML and what was found on the way."""

    yaml: str
    told: tuple[str, ...]
    """One line each."""


def flange_axis(robot: Robot) -> str:
    """Which axis of the flange's frame points outward along A6: "z", "-z", "x", "-x", or "other"."""
    axis = robot.X_6F[:3, :3].T @ robot.axes[5]
    frames = arm_poses(robot, np.zeros((1, 6)))[0]
    a5 = frames[5, :3, :3] @ robot.axes[4]
    X_BF = frames[6] @ robot.X_6F
    out = X_BF[:3, 3] - frames[5, :3, 3]
    out = X_BF[:3, :3].T @ (out - (out @ a5) * a5)
    for name, k in (("z", 2), ("x", 0)):
        if abs(axis[k]) > 1 - 1e-6:
            return f"-{name}" if out[k] < -1e-3 else name
    return "other"


def suggestion(path: Path, packages: tuple[str, ...] = ()) -> Suggestion:
    """Reads an arm and writes down a cell for it.

    Args:
        path: the URDF.
        packages: folders in which package:// is sought, as they shall stand in the YAML.

    Raises:
        CellError: no arm with six turning joints is in the file, or it cannot be read.
    """
    folders = tuple((path.parent / p).resolve() for p in packages)
    ends = ends_of_six(path, folders)
    speed, told = None, []
    try:
        robot_from_file(path, ends[0][1], ends[0][0], packages=folders)
    except CellError as error:
        if error.key != "robot.velocity_deg_s":
            raise
        told.append(f"{str(error).partition('; ')[0].partition(': ')[2]}: 90 deg/s are put in their place")
        speed = (float(np.deg2rad(90.0)),) * 6
    robots = [robot_from_file(path, joints, link, packages=folders, speed=speed) for link, joints in ends]
    robot, axis = _flange(robots)
    link, joints = ends[robots.index(robot)]
    closed = type(solver_of(robot)).__name__ != "NumericArm"
    search = "no closed form: solved by search, slow, and branches may be missed"
    endless = np.abs(robot.upper - robot.lower - 4 * np.pi) < 1e-9
    told += [
        f"chain: {', '.join(joints)} to {link}",
        "closed form found: all branches" if closed else search,
        *(f"{n}: 360 deg each way (robot.endless_deg)" for n, e in zip(joints, endless, strict=True) if e),
        "accelerations are not in a URDF: full speed in 0.6 s is guessed",
        *robot.notes,
    ]  # fmt: skip
    return Suggestion(yaml=_yaml(path, robot, joints, link, axis, packages, speed), told=tuple(told))


def _flange(robots: list[Robot]) -> tuple[Robot, str]:
    """The end that serves as flange: tool0, else one with z outward, else one with x outward."""
    found = [(robot, flange_axis(robot)) for robot in robots]
    for robot, axis in found:
        if axis == "z" and robot.flange == "tool0":
            return robot, axis
    for wanted in ("z", "x"):
        for robot, axis in reversed(found):
            if axis == wanted:
                return robot, axis
    known = ", ".join(robot.flange for robot in robots)
    raise CellError(
        f"none of the links past the sixth joint ({known}) has z or x outward", key="robot.flange"
    )


def _reach(robot: Robot) -> tuple[float, float]:
    """Shoulder to wrist, stretched, and the shoulder's height above the base [m]."""
    frames = arm_poses(robot, np.zeros((1, 6)))[0, 1:]
    axis = frames[1, :3, :3] @ robot.axes[1]

    def flat(v: np.ndarray) -> float:
        return float(np.linalg.norm(v - (v @ axis) * axis))

    p = frames[:, :3, 3]
    return flat(p[2] - p[1]) + flat(p[4] - p[2]), float(p[1, 2])


def _yaml(
    path: Path, robot: Robot, joints: tuple[str, ...], link: str, axis: str, packages: tuple[str, ...],
    speed: tuple[float, ...] | None,
) -> str:  # fmt: skip
    reach, shoulder = _reach(robot)
    large = reach > 0.7 * _KR240_REACH_M
    rates = ", ".join(f"{v / _RAMP_S:.2f}" for v in robot.velocity)
    lines = [
        f"# A cell for {robot.name}, to be put right: what is a guess says so.",
        f"name: {path.stem[:60]}",
        "robot:",
        f"  model: {path.name}",
        f"  joints: [{', '.join(joints)}]",
        f"  flange: {link}",
        f"  acceleration: [{rates}]  # rad/s2; a guess: full speed in {_RAMP_S:g} s. The maker knows",
    ]
    lines += ["  flange_axis: x  # outward, by REP-199"] if axis == "x" else []
    lines += [f"  packages: [{', '.join(packages)}]"] if packages else []
    lines += (
        [f"  velocity_deg_s: [{', '.join('90' for _ in speed)}]  # a guess: the URDF has none"]
        if speed
        else []
    )
    base = 0.0 if large else max(0.95 - shoulder, 0.0)
    if base > 0.0:
        lines += ["base:", f"  position_m: [0.0, 0.0, {base:.3f}]  # a guess: on a pillar"]
        lines += [
            "obstacles:",
            "  - name: pillar",
            f"    centre_m: [0.0, 0.0, {(base - 0.05) / 2:.3f}]",
            f"    size_m: [0.16, 0.16, {max(base - 0.05, 0.01):.3f}]",
        ]
    lines += [] if large else ["tool:", "  arm_m: 0.2", "  plate_m: 0.08"]
    lines += [
        "turntable:  # a guess, in proportion to the arm's reach",
        f"  position_m: [{0.855 * reach:.2f}, 0.0]",
        f"  height_m: {0.7 if large else 0.5}",
        f"  diameter_m: {1.52 if reach > 2.2 else 0.6}",
    ]
    lines += [] if large else ["process:", "  standoff_m: 0.45"]
    return "\n".join(lines) + "\n"
