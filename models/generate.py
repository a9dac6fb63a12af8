"""Writes robots/*.urdf and their visual meshes from robot_data.py: `python models/generate.py`.

The visual meshes are convex hulls of a few discs and blocks per link, ours throughout, so that the scene
looks like the robot that it shows; collision geometry is the boxes of the data sheet's outline.
"""

from pathlib import Path

import numpy as np
from robot_data import FORWARD, ROBOTS
from robot_shapes import SHAPES, Bodies
from scipy.spatial import ConvexHull

HERE = Path(__file__).resolve().parent
LINKS = ("base_link", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6")


def visuals(name: str) -> Bodies:
    """Convex bodies of each link of a robot."""
    return SHAPES[ROBOTS[name]["shape"]](np.array(ROBOTS[name]["offsets"], float))


def obj_text(points: np.ndarray) -> str:
    """Wavefront OBJ of the convex hull with one normal per face (Drake refuses meshes without)."""
    hull = ConvexHull(points)
    corners = points[hull.simplices].copy()
    normals = hull.equations[:, :3]
    inward = (
        np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), normals)
        < 0
    )
    corners[inward] = corners[inward][:, ::-1]
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in corners.reshape(-1, 3)]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in normals]
    lines += ["f " + " ".join(f"{3 * i + j + 1}//{i + 1}" for j in range(3)) for i in range(len(normals))]
    return "\n".join(lines) + "\n"


def boxes_of(name: str) -> list[list[tuple]]:
    """Collision boxes of each link; a shortened link is shortened at its far end."""
    adjusted = []
    for i, boxes in enumerate(ROBOTS[name]["boxes"]):
        cut = ROBOTS[name]["adjust"].get(i, 0.0)
        adjusted.append(
            [
                (low, (high[0] + (cut if high[0] > 0.7 else 0.0), *high[1:]), *round_)
                for low, high, *round_ in boxes
            ]
        )
        adjusted[-1] = [
            ((low[0] + (cut if low[0] > 0.7 else 0.0), *low[1:]), high, *round_)
            for low, high, *round_ in adjusted[-1]
        ]  # fmt: skip
    return adjusted


def link_xml(name: str, i: int) -> list[str]:
    mass, com, inertia = ROBOTS[name]["inertia"][i]
    out = [f'  <link name="{LINKS[i]}">', "    <inertial>", f'      <origin xyz="{nums(com)}"/>']
    out += [f'      <mass value="{mass}"/>']
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    out += ["      <inertia " + " ".join(f'{k}="{v}"' for k, v in zip(keys, inertia, strict=True)) + "/>"]
    out += ["    </inertial>"]
    for n, (_, colour) in enumerate(visuals(name)[LINKS[i]]):
        out += [
            "    <visual>",
            f'      <geometry><mesh filename="../meshes/{name}_{LINKS[i]}_{n}.obj"/></geometry>',
        ]
        out += [
            f'      <material name="m{colour[0]:.2f}"><color rgba="{nums(colour)}"/></material>',
            "    </visual>",
        ]
    for n, (low, high, *axis) in enumerate(boxes_of(name)[i]):
        low_, high_ = np.array(low), np.array(high)
        if i == 6 and ROBOTS[name]["flange"] == FORWARD:
            shape, rpy = '<cylinder radius="0.1" length="0.04"/>', ' rpy="0 1.5707963267948966 0"'
        elif axis:
            sides = high_ - low_
            length, across = (sides[1], sides[0]) if axis == ["y"] else (sides[2], sides[0])
            shape = f'<cylinder radius="{nums((across / 2,))}" length="{nums((length,))}"/>'
            rpy = ' rpy="1.5707963267948966 0 0"' if axis == ["y"] else ""
        else:
            shape, rpy = f'<box size="{nums(high_ - low_)}"/>', ""
        out += [
            f'    <collision name="{LINKS[i]}_{n}">',
            f'      <origin xyz="{nums((low_ + high_) / 2)}"{rpy}/>',
        ]
        out += [f"      <geometry>{shape}</geometry>", "    </collision>"]
    return [*out, "  </link>"]


def nums(values: tuple | np.ndarray) -> str:
    return " ".join(f"{round(float(v), 6):g}" for v in values)


def urdf_text(name: str) -> str:
    robot = ROBOTS[name]
    out = [
        '<?xml version="1.0"?>',
        f"<!-- {robot['title']}. Written by models/generate.py; source: {robot['source']} -->",
    ]
    out += [f'<robot name="{name.replace("-", "_")}">']
    for i in range(7):
        out += link_xml(name, i)
    for i in range(6):
        low, high = np.deg2rad(robot["ranges"][i])
        out += [f'  <joint name="A{i + 1}" type="revolute">', f'    <parent link="{LINKS[i]}"/>']
        out += [f'    <child link="{LINKS[i + 1]}"/>']
        out += [
            f'    <origin xyz="{nums(robot["offsets"][i])}"/>',
            f'    <axis xyz="{nums(robot["axes"][i])}"/>',
        ]
        out += [
            f'    <limit lower="{low:.9f}" upper="{high:.9f}" velocity="{np.deg2rad(robot["velocity"][i]):.9f}" '
            f'effort="{robot["effort"][i]}"/>',
            "  </joint>",
        ]
    out += ['  <link name="tool0"/>', '  <joint name="flange" type="fixed">', '    <parent link="link_6"/>']
    out += [
        '    <child link="tool0"/>',
        f'    <origin xyz="0 0 0" rpy="{robot["flange"]}"/>',
        "  </joint>",
    ]
    return "\n".join([*out, "</robot>"]) + "\n"


def write_robot(name: str) -> None:
    """robots/NAME.urdf and its meshes."""
    (HERE / "robots" / f"{name}.urdf").write_text(urdf_text(name))
    for link, bodies in visuals(name).items():
        for n, (points, _) in enumerate(bodies):
            (HERE / "meshes" / f"{name}_{link}_{n}.obj").write_text(obj_text(points))


def facts_text() -> str:
    """robots.yaml: what a URDF has no place for."""
    out = ["# Facts of the built-in robots that a URDF does not hold. Written by models/generate.py."]
    for name, robot in ROBOTS.items():
        out += [f"{name}:", f"  title: {robot['title']}", f'  source: "{robot["source"]}"']
        out += [f"  reach_m: {robot['reach']}", f"  payload_kg: {robot['payload']}", "  acceleration_rad_s2:"]
        out += [f"    rated: {list(robot['rated'])}", f"    light: {list(robot['light'])}"]
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    (HERE / "robots" / "robots.yaml").write_text(facts_text())
    for robot_name in ROBOTS:
        write_robot(robot_name)
        print(robot_name)
