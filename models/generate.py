"""Writes robots/*.urdf and their visual meshes from robot_data.py: `python models/generate.py`.

The visual meshes are convex hulls of a few discs and blocks per link, ours throughout, so that the scene
looks like the robot that it shows; collision geometry is the boxes of the data sheet's outline.
"""

from pathlib import Path

import numpy as np
from robot_data import KR240_BOXES, KR240_INERTIA, ROBOTS
from scipy.spatial import ConvexHull

HERE = Path(__file__).resolve().parent
ORANGE, BLACK, GREY = (1.0, 0.36, 0.02, 1.0), (0.10, 0.10, 0.11, 1.0), (0.55, 0.56, 0.58, 1.0)
LINKS = ("base_link", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6")


def disc(centre: tuple, axis: str, radius: float, length: float, n: int = 28) -> np.ndarray:
    """Corners of a bevelled cylinder along x, y or z, shape (4 n, 3)."""
    t = np.arange(n) / n * 2 * np.pi
    bevel = min(0.08 * radius, 0.2 * length)
    rings = [(radius - bevel, -length / 2), (radius, -length / 2 + bevel)]
    rings += [(radius, length / 2 - bevel), (radius - bevel, length / 2)]
    points = np.concatenate([np.stack([r * np.cos(t), r * np.sin(t), np.full(n, h)], 1) for r, h in rings])
    order = {"x": (2, 0, 1), "y": (0, 2, 1), "z": (0, 1, 2)}[axis]
    return points[:, order] + np.asarray(centre)


def block(low: tuple, high: tuple, bevel: float = 0.03) -> np.ndarray:
    """Corners of a box with bevelled edges."""
    low_, high_ = np.asarray(low, float), np.asarray(high, float)
    points = []
    for axis in range(3):
        inset = np.full(3, bevel)
        inset[axis] = 0.0
        a, b = low_ + inset, high_ - inset
        points += [[(a, b)[i][0], (a, b)[j][1], (a, b)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return np.array(points)


def visuals(name: str) -> dict[str, list[tuple[np.ndarray, tuple]]]:
    """Convex bodies (corner points, colour) of each link in its frame."""
    offsets = np.array(ROBOTS[name]["offsets"], float)
    arm, up, fore, wrist = offsets[2][0], offsets[3][2], offsets[4][0], offsets[5][0]
    y = -0.21
    return {
        "base_link": [
            (block((-0.50, -0.36, 0), (0.37, 0.36, 0.06)), BLACK),
            (disc((0, 0, 0.19), "z", 0.33, 0.28), ORANGE),
            (block((-0.55, -0.19, 0.06), (-0.1, 0.19, 0.30)), BLACK),
        ],
        "link_1": [
            (disc((0, 0, -0.25), "z", 0.33, 0.18), ORANGE),
            (np.concatenate([disc((0.33, -0.02, 0), "y", 0.21, 0.30), disc((0.02, -0.02, -0.2), "z", 0.27, 0.1)]), ORANGE),
            (disc((0.33, -0.30, 0), "y", 0.16, 0.26), BLACK),
            (disc((-0.38, -0.05, -0.08), "z", 0.13, 0.36), BLACK),
        ],
        "link_2": [
            (np.concatenate([disc((0, y, 0), "y", 0.19, 0.24), disc((arm, y, 0), "y", 0.14, 0.18)]), ORANGE),
            (np.concatenate([disc((0.1, y - 0.2, 0), "x", 0.05, 0.2), disc((arm - 0.1, y - 0.2, 0), "x", 0.05, 0.1)]), BLACK),
        ],
        "link_3": [
            (np.concatenate([disc((0, 0, 0), "y", 0.15, 0.24), disc((0.05, 0, up), "x", 0.19, 0.36)]), ORANGE),
            (np.concatenate([disc((0.2, 0, up), "x", 0.18, 0.1), disc((0.70, 0, up), "x", 0.12, 0.1)]), ORANGE),
            (disc((-0.28, 0.08, up + 0.02), "x", 0.11, 0.26), BLACK),
            (disc((-0.25, -0.10, up + 0.02), "x", 0.08, 0.24), BLACK),
        ],
        "link_4": [
            (np.concatenate([disc((0.72, 0, 0), "x", 0.12, 0.06), disc((fore - 0.16, 0, 0), "x", 0.10, 0.1)]), ORANGE),
            (np.concatenate([disc((fore - 0.15, 0, 0), "x", 0.085, 0.05), disc((fore, 0, 0), "y", 0.085, 0.13)]), ORANGE),
        ],
        "link_5": [
            (disc((0, 0.07, 0), "y", 0.10, 0.10), BLACK),
            (np.concatenate([disc((0.02, 0, 0), "x", 0.095, 0.1), disc((wrist - 0.05, 0, 0), "x", 0.09, 0.05)]), ORANGE),
        ],
        "link_6": [(disc((-0.02, 0, 0), "x", 0.09, 0.04), GREY)],
    }  # fmt: skip


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
    for i, boxes in enumerate(KR240_BOXES):
        cut = ROBOTS[name]["adjust"].get(i, 0.0)
        adjusted.append(
            [(low, (high[0] + (cut if high[0] > 0.7 else 0.0), *high[1:])) for low, high in boxes]
        )
        adjusted[-1] = [
            ((low[0] + (cut if low[0] > 0.7 else 0.0), *low[1:]), high) for low, high in adjusted[-1]
        ]  # fmt: skip
    return adjusted


def link_xml(name: str, i: int) -> list[str]:
    mass, com, inertia = KR240_INERTIA[i]
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
    for n, (low, high) in enumerate(boxes_of(name)[i]):
        low_, high_ = np.array(low), np.array(high)
        if i == 6:
            shape, rpy = '<cylinder radius="0.1" length="0.04"/>', ' rpy="0 1.5707963267948966 0"'
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
    flange = robot["offsets"][6] if len(robot["offsets"]) > 6 else (0, 0, 0)
    out += ['  <link name="tool0"/>', '  <joint name="flange" type="fixed">', '    <parent link="link_6"/>']
    out += [
        '    <child link="tool0"/>',
        f'    <origin xyz="{nums(flange)}" rpy="0 1.5707963267948966 0"/>',
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
