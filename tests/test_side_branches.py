"""Solids that hang fixed on the arm by side branches: kept clear of by the planner, caught by the judge."""

import fcl
import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.build import build_cell, check_room
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.collision.pairs import ignored
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.model import TOOL
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.core.errors import CellError
from scanmotion.geometry.parts.make_part import box_part, models_dir
from scanmotion.judge import verify
from scanmotion.planning.pipeline import PlanOptions, plan

PLAIN = (models_dir() / "robots" / "kr240.urdf").read_text()
SIDES = {
    # On the base, in the arm's way; a rod across the forearm; a hose guide past the flange.
    "lamp": ("base_link", "1.40 0 1.35", "0.3 0.5 0.3"),
    "rod": ("link_3", "0.5 0 0.75", "0.05 0.05 1.0"),
    "guide": ("tool0", "0 0.28 0.1", "0.06 0.1 0.3"),
}


def with_side(name, parent, xyz, size, *, kind="fixed"):
    """The KR 240 with one more link, which carries a box."""
    return PLAIN.replace(
        "</robot>",
        f'<link name="{name}"><collision name="{name}"><origin xyz="{xyz}"/><geometry><box size="{size}"/>'
        f'</geometry></collision></link><joint name="j_{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{name}"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
        "</joint></robot>",
    )


def cell_of(urdf, folder, part=None):
    (folder / "own.urdf").write_text(urdf)
    settings = settings_from(
        {"robot": {"model": "own.urdf", "acceleration": [2.5, 1.6, 3.5, 7.4, 5.6, 9.0]}}, folder=str(folder)
    )
    return build_cell(settings, part)


@pytest.fixture(scope="module")
def planned():
    return plan(box_part(0.33, 0.2, 0.6), load_cell("kr240"), options=PlanOptions(source="box"))


@pytest.mark.parametrize("name", SIDES)
def test_the_planner_keeps_clear_of_it_and_the_judge_agrees(name, tmp_path):
    cell = cell_of(with_side(name, *SIDES[name]), tmp_path)
    made = plan(box_part(0.33, 0.2, 0.6), cell.settings, options=PlanOptions(source="box"))
    assert len(made.trajectory.operations) >= 6
    assert made.save(tmp_path / "plan") == []
    # Poses by Drake from the file as it is, distances by FCL.
    plant = MultibodyPlant(0.0)
    (instance,) = Parser(plant).AddModels(str(cell.urdf_path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    box = fcl.CollisionObject(fcl.Box(*map(float, SIDES[name][2].split())), fcl.Transform())
    X_LG = np.eye(4)
    X_LG[:3, 3] = list(map(float, SIDES[name][1].split()))
    others = [
        b for b in cell.bodies if (b.link == TOOL) == (name == "lamp") and b.name not in ("floor", name)
    ]
    others = [b for b in others if b.link in ((TOOL,) if name == "lamp" else (8, 9))]
    assert others
    least = np.inf
    for q in made.trajectory.q[::10]:
        plant.SetPositions(context, instance, q[:6])
        X = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name)).GetAsMatrix4() @ X_LG
        box.setTransform(fcl.Transform(X[:3, :3].copy(), X[:3, 3].copy()))
        X_WF = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("tool0")).GetAsMatrix4()
        frames = {TOOL: X_WF, 8: cell.X_WT, 9: np.eye(4)}
        for body in others:
            shape = fcl.Box(*body.size) if body.shape == "box" else fcl.Cylinder(*body.size[:2])
            Y = frames[body.link] @ body.X_LG
            solid = fcl.CollisionObject(shape, fcl.Transform(Y[:3, :3].copy(), Y[:3, 3].copy()))
            assert not fcl.collide(box, solid, fcl.CollisionRequest(), fcl.CollisionResult())
            least = min(least, fcl.distance(box, solid, fcl.DistanceRequest(), fcl.DistanceResult()))
    assert least > (0.004 if name == "lamp" else 0.029)


@pytest.mark.parametrize("parent", ["base_link", *(f"link_{i}" for i in range(1, 7)), "tool0"])
def test_the_judge_catches_one_that_is_planted_in_the_part_or_the_scanner(planned, parent, tmp_path):
    folder = tmp_path / "plan"
    planned.save(folder)
    assert verify(folder) == []
    cell, q = planned.cell, planned.trajectory.q
    frames = drake_of(cell)
    k = len(q) // 2
    plant, context = frames.plant, frames.plant.CreateDefaultContext()
    plant.SetPositions(context, frames.positions(q[k][None])[0])
    X_WL = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(parent)).GetAsMatrix4()
    point = np.array([*cell.X_WT[:2, 3], cell.X_WT[2, 3] + 0.5])
    if parent == "base_link":
        point = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("tool0")).GetAsMatrix4()[:3, 3]
    p = np.linalg.inv(X_WL) @ [*point, 1.0]
    text = with_side("planted", parent, " ".join(map(str, p[:3])), "0.05 0.05 0.05")
    (folder / "robot.urdf").write_text(text)
    found = [f for f in verify(folder) if "planted" in f.where]
    assert found and found[0].code == "collision"
    # The planner's two tiers refuse the same configuration, in the part's place.
    other = cell_of(text, tmp_path, planned.part)
    checker = Clearance(other)
    assert not checker.fast_free(q[k][None])[0]
    assert not checker.exactly_free(q[k][None])[0]


def test_a_table_before_the_base_counts(planned, tmp_path):
    """The robot stands on a block that is the URDF's root; its upper arm must not come down on it."""
    block = (
        '<link name="block"><collision name="block"><origin xyz="0.9 0 0.5"/><geometry>'
        '<box size="0.4 0.4 0.9"/></geometry></collision></link><joint name="j" type="fixed">'
        '<parent link="block"/><child link="base_link"/></joint></robot>'
    )
    cell = cell_of(PLAIN.replace("</robot>", block), tmp_path)
    body = next(b for b in cell.bodies if b.name == "block")
    assert body.link == 0 and body.side
    plain = Clearance(build_cell(load_cell("kr240")))
    upper = np.deg2rad([0.0, -35.0, -30.0, 0, 20, 0, 0])[None]
    assert plain.free(upper)[0] and not Clearance(cell).free(upper)[0]
    assert not drake_of(cell).free(upper)[0]


def test_what_meets_its_neighbour_in_every_position_is_left_out_and_only_that(tmp_path):
    collar = cell_of(with_side("collar", "link_5", "0.12 0 0", "0.3 0.02 0.02"), tmp_path)
    bodies = [b for b in collar.bodies if b.link <= TOOL]
    skip = ignored(collar)
    i = next(n for n, b in enumerate(bodies) if b.name == "collar")
    left_out = {b.link for n, b in enumerate(bodies) if skip[i, n] and n != i}
    assert {5, 6} <= left_out <= {4, 5, 6, 7} and 3 not in left_out


def test_what_hangs_on_another_moving_joint_is_refused_by_name(tmp_path):
    with pytest.raises(CellError, match="'finger' has solids and is not fixed to the chain"):
        cell_of(with_side("finger", "tool0", "0 0 0.1", "0.1 0.1 0.1", kind="revolute"), tmp_path)
    # Without solids it is nothing that could touch.
    bare = with_side("finger", "tool0", "0 0 0.1", "0.1 0.1 0.1", kind="revolute")
    a, b = bare.index('<collision name="finger">'), bare.rindex("</collision>") + len("</collision>")
    cell_of(bare[:a] + bare[b:], tmp_path)


def test_a_base_in_which_the_table_turns_is_refused(tmp_path):
    cell = cell_of(with_side("lamp", "base_link", "2.0 0 0.7", "0.1 0.1 0.1"), tmp_path)
    with pytest.raises(CellError, match=r"\(lamp\) stands in table"):
        check_room(cell)
    with pytest.raises(CellError, match="stands in table_column"):
        home = {"home_deg": [0, -90, 90, 0, 0, 0]}
        check_room(build_cell(settings_from({"robot": home, "turntable": {"position_m": [0.3, 0.0]}})))
