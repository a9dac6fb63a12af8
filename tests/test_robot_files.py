"""Robots from the world outside: names, joints and meshes of real URDFs."""

import json

import numpy as np
import pytest
import yaml
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.kinematics import flange_poses
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.cell.suggest import suggestion
from scanmotion.core.errors import CellError
from scanmotion.geometry.convex import convex_pieces, hull_from
from scanmotion.geometry.parts.make_part import box_part, models_dir
from scanmotion.judge import verify
from scanmotion.judge.motion import arm_from_urdf
from scanmotion.planning.pipeline import PlanOptions, plan

PLAIN = (models_dir() / "robots" / "kr240.urdf").read_text()
RATES = [2.5, 1.6, 3.5, 7.4, 5.6, 9.0]


def cell_of(urdf, folder, part=None, **robot):
    (folder / "own.urdf").write_text(urdf)
    return build_cell(
        settings_from({"robot": {"model": "own.urdf", "acceleration": RATES} | robot}, folder=str(folder)),
        part,
    )


def box_stl(path, size, at=(0.0, 0.0, 0.0), unit=1.0):
    part = box_part(*size)
    corners = (part.vertices[part.triangles] - [0, 0, size[2] / 2] + np.array(at)) / unit
    rows = np.zeros(len(corners), np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    rows["c"] = corners
    path.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


@pytest.mark.parametrize("name", ["root_world", "link_tool", "transmission", "continuous"])
def test_real_urdfs_are_the_plain_robot(name, shared_cases, kr240_cell, rng):
    cell = build_cell(load_cell(shared_cases / "robots" / f"{name}.yaml"))
    low, high = kr240_cell.q_min[:6], kr240_cell.q_max[:6]
    q = np.column_stack([rng.uniform(low, high, (300, 6)), np.zeros(300)])
    np.testing.assert_allclose(flange_poses(cell, q), flange_poses(kr240_cell, q), atol=1e-12)
    np.testing.assert_array_equal(Clearance(cell).free(q), Clearance(kr240_cell).free(q))
    arm = arm_from_urdf(cell.robot.record.decode(), cell.settings.robot.joints, "tool0")
    assert len(arm.solids) == len(kr240_cell.robot.bodies)
    if name == "continuous":
        assert cell.q_max[5] == pytest.approx(2 * np.pi) and cell.q_min[5] == -cell.q_max[5]
        assert cell.v_max[5] == pytest.approx(2.0) and np.isinf(arm.upper[5])


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("prismatic", "joint 'A1' slides"),
        ("side_mesh", r"'package://x/s.stl' not found; name the folder that holds the package 'x'"),
        ("t05_table_on_robot", "turntable stands where the robot stands"),
    ],
)
def test_what_cannot_be_planned_is_one_line(name, line, shared_cases):
    with pytest.raises(CellError, match=line):
        build_cell(load_cell(shared_cases / "robots" / f"{name}.yaml"))


@pytest.mark.parametrize("name", ["world", "tool", "floor", "part", "stand", "turntable"])
def test_names_of_the_file_do_not_meet_ours(name, tmp_path, kr240_cell, rng):
    text = PLAIN.replace('"link_3"', f'"{name}"').replace('"A1"', '"E1"').replace("link_3_", f"{name}_")
    cell = cell_of(text, tmp_path, joints=["E1", "A2", "A3", "A4", "A5", "A6"])
    assert len(set(cell.joint_names)) == 7
    q = np.column_stack([rng.uniform(kr240_cell.q_min[:6], kr240_cell.q_max[:6], (200, 6)), np.zeros(200)])
    np.testing.assert_array_equal(drake_of(cell).free(q), drake_of(kr240_cell).free(q))
    np.testing.assert_array_equal(Clearance(cell).free(q), Clearance(kr240_cell).free(q))


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="A1"/>', "joint 'A2' mimics another"),
        ('name="A3" type="revolute"', 'name="A3" type="planar"', "joint 'A3' moves in a plane"),
        ('name="A3" type="revolute"', 'name="A3" type="fixed"', "joint 'A3' is fixed"),
        ('<link name="link_2">', '<link name="link_1"/><link name="link_2">', "link 'link_1' is there twice"),
        ("<robot name", '<xacro:x xmlns:xacro="x"/><robot name', "not a readable URDF"),
    ],
)
def test_joints_that_are_not_six_turning_ones_are_refused_by_name(old, new, line, tmp_path):
    assert old in PLAIN
    with pytest.raises(CellError, match=line):
        cell_of(PLAIN.replace(old, new, 1), tmp_path)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.sdf", "a.sdf: SDF is not read as a robot, a URDF is; convert it first"),
        ("a.xml", "a.xml: MJCF is not read as a robot"),
        ("a.dmd.yaml", "a.dmd.yaml: a file of Drake's directives is not read as a robot"),
        ("a.urdf.xacro", r"is xacro; expand it first \(xacro a.urdf.xacro > my.urdf\)"),
    ],
)
def test_other_descriptions_are_one_line_each(name, line, tmp_path):
    (tmp_path / name).write_text("<sdf/>")
    with pytest.raises(CellError, match=line):
        build_cell(settings_from({"robot": {"model": name}}, folder=str(tmp_path)))
    with pytest.raises(CellError, match=line):
        suggestion(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("turntable: {position_m: [2,2, 0,0]}", "2 values are expected, not 4; a decimal comma makes two"),
        ("turntable: {height_m: 0,7}", "a decimal comma ends a value: write a point"),
        ("turntable:\n  height_m: 0,7", "write a decimal point, not a comma"),
    ],
)
def test_decimal_commas_are_one_line(text, line):
    with pytest.raises(CellError, match=line):
        settings_from(yaml.safe_load(text))


def test_a_rail_is_refused_by_name(tmp_path):
    rail = (
        '<link name="rail"/><joint name="track" type="prismatic"><parent link="rail"/>'
        '<child link="base_link"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="2" velocity="1" effort="1"/></joint></robot>'
    )
    with pytest.raises(CellError, match=r"'track' .*a rail.*make it fixed where it stands"):
        cell_of(PLAIN.replace("</robot>", rail), tmp_path)
    seven = {"joints": ["track", "A1", "A2", "A3", "A4", "A5", "A6"]}
    with pytest.raises(CellError, match="six turning joints are expected, not 7"):
        settings_from({"robot": seven})


@pytest.mark.parametrize("unit", [1.0, 0.001])
def test_meshes_count_for_planner_drake_and_judge(unit, tmp_path):
    """The lamp as an STL of a package: the same lamp as a box."""
    (tmp_path / "mine" / "meshes").mkdir(parents=True)
    box_stl(tmp_path / "mine" / "meshes" / "lamp.stl", (0.3, 0.5, 0.3), unit=unit)
    geometry = f'<mesh filename="package://mine/meshes/lamp.stl" scale="{unit} {unit} {unit}"/>'
    side = (
        '<link name="lamp"><collision><origin xyz="1.40 0 1.35"/><geometry>{}</geometry></collision></link>'
        '<joint name="lj" type="fixed"><parent link="base_link"/><child link="lamp"/></joint></robot>'
    )
    part = box_part(0.33, 0.2, 0.6)
    mesh = cell_of(PLAIN.replace("</robot>", side.format(geometry)), tmp_path, part)
    (tmp_path / "box").mkdir()
    box = cell_of(PLAIN.replace("</robot>", side.format('<box size="0.3 0.5 0.3"/>')), tmp_path / "box", part)
    rng = np.random.default_rng(1)
    q = np.column_stack([rng.uniform(box.q_min[:6], box.q_max[:6], (400, 6)), np.zeros(400)])
    q[:200, 0] *= 0.1
    np.testing.assert_array_equal(Clearance(mesh).free(q), Clearance(box).free(q))
    made = plan(part, mesh.settings, options=PlanOptions(source="box"))
    folder = tmp_path / "plan"
    assert made.save(folder) == []
    # The judge reads the folder's mesh himself: planted where the scanner passes, it is caught.
    data = json.loads((folder / "plan.json").read_text())
    assert data["urdf_file"] == "robot.urdf" and (folder / "robot_mesh_00.stl").is_file()
    X_WF = flange_poses(mesh, made.trajectory.q[[len(made.trajectory.q) // 2]])[0]
    box_stl(folder / "robot_mesh_00.stl", (0.3, 0.5, 0.3), X_WF[:3, 3] - [1.4, 0, 1.35], unit)
    assert any(f.code == "collision" and "lamp" in f.where for f in verify(folder))


def test_convex_pieces_hold_the_mesh_and_are_tighter_than_its_hull(rng):
    bar, foot = box_part(0.1, 0.1, 1.0), box_part(0.8, 0.1, 0.1)
    vertices = np.concatenate([bar.vertices, foot.vertices + [0.35, 0, 0]])
    triangles = np.concatenate([bar.triangles, foot.triangles + len(bar.vertices)])
    pieces = convex_pieces(vertices, triangles)
    whole = hull_from(vertices)
    assert sum(p.volume for p in pieces) < 0.75 * whole.volume
    corners = vertices[triangles[rng.integers(0, len(triangles), 3000)]]
    points = np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), 3000), corners)
    held = np.zeros(len(points), bool)
    for piece in pieces:
        a, b, c = (piece.points[piece.faces[:, k]] for k in range(3))
        n = np.cross(b - a, c - a)
        held |= ((points @ n.T - np.einsum("ni,ni->n", n, a)) <= 1e-9).all(axis=1)
    assert held.all()
    assert whole.volume == pytest.approx(hull_from(whole.points).volume)


def test_flange_poses_are_drakes(tmp_path, rng):
    cell = cell_of(PLAIN, tmp_path)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(cell.urdf_path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for q in rng.uniform(cell.q_min[:6], cell.q_max[:6], (20, 6)):
        plant.SetPositions(context, q)
        X = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("tool0")).GetAsMatrix4()
        assert np.abs(X - flange_poses(cell, q[None])[0]).max() < 1e-12


def test_a_flange_with_x_outward_is_asked_about_and_taken_when_said(tmp_path, kr240_cell):
    """REP-199: `flange` has x outward, `tool0` z."""
    flange = (
        '<link name="flange"/><joint name="jf" type="fixed"><parent link="tool0"/><child link="flange"/>'
        "{}</joint></robot>"
    )
    text = PLAIN.replace("</robot>", flange.format('<origin rpy="0 -1.5707963267948966 0"/>'))
    with pytest.raises(
        CellError, match=r"x outward .REP-199., not z: name tool0, or write robot.flange_axis: x"
    ):
        cell_of(text, tmp_path, flange="flange")
    cell = cell_of(text, tmp_path, flange="flange", flange_axis="x")
    q = kr240_cell.home[None]
    from scanmotion.cell.kinematics import scanner_poses

    np.testing.assert_allclose(scanner_poses(cell, q), scanner_poses(kr240_cell, q), atol=1e-12)
    np.testing.assert_array_equal(Clearance(cell).free(q), Clearance(kr240_cell).free(q))
    inward = PLAIN.replace("</robot>", flange.format('<origin rpy="3.141592653589793 0 0"/>'))
    with pytest.raises(CellError, match="z inward"):
        cell_of(inward, tmp_path, flange="flange")


def test_the_default_rest_is_a_free_one(shared_cases):
    cell = build_cell(load_cell(shared_cases / "robots" / "t12_base_high.yaml"))
    assert Clearance(cell).free(cell.home[None])[0]
    walls = [
        {"name": f"wall {n}", "centre_m": [2.2 + x, y, 1.6], "size_m": [0.6, 0.6, 1.6]}
        for n, (x, y) in enumerate([(-1.2, 0.0), (-1.1, 0.6), (-1.1, -0.6), (0, 1.2), (0, -1.2)])
    ]
    with pytest.raises(CellError, match=r"no free rest before the table was found \(.* are in the way\)"):
        build_cell(settings_from({"obstacles": walls}))


def test_robots_add_writes_a_cell_that_can_be_used(tmp_path):
    from typer.testing import CliRunner

    from scanmotion.cli import app

    text = PLAIN.replace('velocity="1.797689130"', 'velocity="0"')
    (tmp_path / "my.urdf").write_text(text)
    done = CliRunner().invoke(app, ["robots", "add", str(tmp_path / "my.urdf")])
    assert "chain: A1, A2, A3, A4, A5, A6 to tool0" in done.output and "closed form found" in done.output
    assert "ready" in done.output
    cell = build_cell(load_cell(tmp_path / "my.yaml"))
    assert cell.settings.robot.flange == "tool0"
    again = CliRunner().invoke(app, ["robots", "add", str(tmp_path / "my.urdf")])
    assert "is there already" in (again.output + str(again.exception))
