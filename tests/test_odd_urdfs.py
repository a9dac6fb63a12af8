"""Odd but legal URDFs: planner, Drake and judge see the same solids at the same places."""

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from test_pairs import drawn
from test_robot_files import PLAIN, box_stl, cell_of

from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.collision.last_word import DrakeJudge
from scanmotion.cell.kinematics import flange_poses, link_poses
from scanmotion.core.errors import CellError
from scanmotion.core.trajectory import Trajectory
from scanmotion.judge.motion import arm_from_urdf


def side(name, parent, shape, origin="", *, kind="fixed", solid="", extra=""):
    return (
        f'<link name="{name}"><collision><origin {solid}/><geometry>{shape}</geometry></collision></link>'
        f'<joint name="j_{name}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
        f"<origin {origin}/>{extra}</joint>"
    )


def named_like_ours():
    """Root `world`, links `tool` and `floor`, a joint `E1`; boxes behind the base and past the flange."""
    text = PLAIN.replace('"base_link"', '"world"').replace('"link_3"', '"tool"').replace('"A2"', '"E1"')
    more = side("behind", "world", '<box size="0.3 0.4 0.5"/>', 'xyz="-1.3 0 0.4" rpy="0 0 0.7"')
    more += side("floor", "tool0", '<box size="0.05 0.2 0.04"/>', 'xyz="0 0.36 0.08" rpy="0.3 0.2 0.1"')
    more += side("past", "floor", '<cylinder radius="0.03" length="0.2"/>', 'xyz="0 0.15 0" rpy="1.2 0 0"')
    return (
        text.replace("</robot>", more + "</robot>"),
        {"joints": ["A1", "E1", "A3", "A4", "A5", "A6"]},
        "world",
    )


def on_branches():
    """A ball and a mirrored mesh on a branch of a branch of link 3; what moves elsewhere has no solids."""
    more = side("ball", "link_3", '<sphere radius="0.12"/>', 'xyz="0.4 0 0.5" rpy="0.5 0 0"')
    mesh = '<mesh filename="wedge.stl" scale="-0.001 0.001 0.001"/>'
    more += side("mirrored", "ball", mesh, 'xyz="0 0.1 0.25" rpy="0 0.4 0"', solid='rpy="0 0 1.1"')
    for kind in ("prismatic", "planar", "continuous"):
        more += (
            f'<link name="{kind}"/><joint name="j_{kind}" type="{kind}"><parent link="link_4"/>'
            f'<child link="{kind}"/><axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="1"/>'
            "</joint>"
        )
    more += (
        '<link name="follower"/><joint name="jf" type="revolute"><parent link="link_2"/>'
        '<child link="follower"/><axis xyz="0 0 1"/><mimic joint="A6" multiplier="0.5"/>'
        '<limit lower="-9" upper="9" velocity="1" effort="1"/></joint>'
    )
    return PLAIN.replace("</robot>", more + "</robot>"), {}, "base_link"


def turned_frames():
    """The robot on a plate by a turned joint; A4 and A6 turn for ever; axes are not of length one."""
    text = PLAIN.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 3 0"/>')
    for joint in ("A4", "A6"):
        text = text.replace(f'name="{joint}" type="revolute"', f'name="{joint}" type="continuous"')
    plate = (
        '<link name="plate"><collision><origin xyz="0.2 0.1 0.05"/><geometry><box size="0.7 0.9 0.1"/>'
        '</geometry></collision></link><joint name="jp" type="fixed"><parent link="plate"/>'
        '<child link="base_link"/><origin xyz="0 0 0.1" rpy="0 0 0.6"/></joint>'
    )
    rod = side("rod", "link_1", '<cylinder radius="0.03" length="0.8"/>', 'xyz="-0.3 0.4 0.6" rpy="0.9 0 0"')
    return text.replace("</robot>", plate + rod + "</robot>"), {}, "plate"


@pytest.mark.parametrize("made", [named_like_ours, on_branches, turned_frames])
def test_all_three_see_the_same(made, tmp_path):
    text, words, root = made()
    box_stl(tmp_path / "wedge.stl", (0.1, 0.2, 0.3), at=(0.15, 0.0, 0.0), unit=0.001)
    cell = cell_of(text, tmp_path, **words)
    q = drawn(cell, 40, seed=7)
    _same_kinematics(cell, root, tmp_path, q[:10])
    _same_solids(cell, q[:6])
    free = Clearance(cell).free(q)
    assert 0 < free.sum() < len(q)
    judge = DrakeJudge(cell)
    for row, ours in zip(q, free, strict=True):
        found = judge.judge(_still(row)).findings
        assert bool(found) != bool(ours) or abs(_spare(cell, row)) < 1.5e-3


def _still(row):
    two = np.repeat(row[None], 2, axis=0)
    none, index = np.zeros_like(two), np.zeros(2, dtype=int)
    return Trajectory(t=np.array([0.0, 0.1]), q=two, qd=none, qdd=none, operation=index, operations=())


def _spare(cell, row):
    """By how much the worst pair is apart more than asked for [m]."""
    checker = Clearance(cell)
    d, pair = checker.distance(row)
    return d - checker.asked(pair)


def _same_kinematics(cell, root, folder, q):
    """The file itself, its solids left out, read by Drake alone."""
    from xml.etree import ElementTree

    tree = ElementTree.fromstring((folder / "own.urdf").read_text())
    for link in tree.iter("link"):
        for part in (*link.findall("collision"), *link.findall("visual")):
            link.remove(part)
    for joint in tree.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(ElementTree.tostring(tree, encoding="unicode"), "urdf")
    if root != "world":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for row in q:
        for name, angle in zip(cell.settings.robot.joints, row, strict=False):
            plant.GetJointByName(name).set_angle(context, angle)
        X = plant.CalcRelativeTransform(
            context, plant.GetFrameByName(root), plant.GetFrameByName("tool0")
        ).GetAsMatrix4()
        assert np.abs(cell.X_WB @ X - flange_poses(cell, row[None])[0]).max() < 1e-9


def _same_solids(cell, q):
    """The judge's reading of the recorded file: each solid's box about the same points as the planner's."""
    arm = arm_from_urdf(cell.robot.record.decode(), cell.settings.robot.joints, cell.settings.robot.flange)
    theirs = {(s.carrier, s.group) for s in arm.solids}
    names = {b.carrier.removeprefix("robot_"): b.link for b in cell.bodies if b.carrier}
    assert {(c, g) for c, g in theirs} == set(names.items())
    zero = link_poses(cell, np.zeros((1, 7)))[0]
    for solid in arm.solids:
        own = [b for b in cell.bodies if b.carrier.removeprefix("robot_") == solid.carrier]
        if solid.kind == "mesh":
            continue
        gaps = [
            np.abs(np.linalg.inv(cell.X_WB) @ zero[b.link] @ b.X_LG - solid.X_BG).max()
            for b in own
            if b.size == pytest.approx(solid.size)
        ]
        assert gaps and min(gaps) < 1e-9, solid.name


def test_what_moves_by_another_joint_is_refused_by_name(tmp_path):
    for kind in ("prismatic", "planar", "continuous"):
        text = PLAIN.replace(
            "</robot>",
            side("mover", "link_4", '<box size="0.1 0.1 0.1"/>', kind=kind,
                 extra='<axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="1" effort="1"/>')
            + "</robot>",
        )  # fmt: skip
        with pytest.raises(CellError, match="'mover' has solids and is not fixed to the chain"):
            cell_of(text, tmp_path)
