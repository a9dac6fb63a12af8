"""The committed models are what generate.py writes, and hold the published masses, inertias and limits."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.arm.robot_file import robot_from_file
from scanmotion.cell.build import robot_facts
from scanmotion.cell.settings.cell import builtin_cells, load_cell

MODELS = Path(__file__).resolve().parents[1] / "models"
ROBOTS = ("kr240", "kr240-ultra", "kr210", "irb6700", "ur10e")
JOINTS = tuple(f"A{i}" for i in range(1, 7))


@pytest.fixture(scope="module")
def generate():
    sys.path.insert(0, str(MODELS))
    try:
        yield importlib.import_module("generate")
    finally:
        sys.path.remove(str(MODELS))


def committed(folder, *suffixes):
    return {p.name: p.read_bytes() for p in (MODELS / folder).iterdir() if p.suffix in suffixes}


def test_generate_writes_the_committed_files_byte_for_byte(generate, tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "HERE", tmp_path)
    (tmp_path / "robots").mkdir()
    (tmp_path / "meshes").mkdir()
    for name in generate.ROBOTS:
        generate.write_robot(name)
    (tmp_path / "robots" / "robots.yaml").write_text(generate.facts_text())
    for folder, suffixes in (("robots", (".urdf", ".yaml")), ("meshes", (".obj",))):
        written = {p.name: p.read_bytes() for p in (tmp_path / folder).iterdir()}
        assert written.keys() == committed(folder, *suffixes).keys()
        for name, data in committed(folder, *suffixes).items():
            assert written[name] == data, name


# Facts: link masses [kg], base to link 6.
MASSES = {
    "kr240": (225.96, 367.37, 250.56, 191.53, 47.94, 23.69, 12.25),
    "kr240-ultra": (225.96, 367.37, 250.56, 191.53, 47.94, 23.69, 12.25),
    "kr210": (226, 363, 232, 190, 42, 17, 6.6),
    "ur10e": (4.0, 7.37, 13.05, 3.99, 2.1, 1.98, 0.62),
}
# Facts: centre of mass and Ixx, Iyy, Izz, Ixy, Ixz, Iyz about it, KR 240 R2900-2.
KR240_INERTIA = (
    ((-0.059, 0.002, 0.203), (9.03, 12.82, 14.28, 0.18, -0.27, 0.01)),
    ((0.028, -0.011, -0.104), (14.50, 33.02, 31.78, -4.38, -1.95, 0.21)),
    ((0.578, -0.198, 0.001), (6.75, 82.49, 82.88, 6.95, 0.57, 0.17)),
    ((0.173, -0.038, 0.075), (3.64, 21.49, 21.89, -1.12, -0.96, -0.53)),
    ((1.048, 0.030, 0.0), (0.246, 1.571, 1.640, -0.248, 0.0, 0.0)),
    ((0.062, 0.042, 0.0), (0.249, 0.291, 0.348, 0.070, 0.0, 0.0)),
    ((-0.045, 0.0, 0.0), (0.048, 0.037, 0.037, 0.0, 0.0, 0.0)),
)
# Facts: ranges and speeds [deg, deg/s].
KUKA = [(-185, 185), (-140, -5), (-120, 168), (-350, 350), (-122.5, 122.5), (-350, 350)]
RANGES = {
    "kr240": KUKA,
    "kr240-ultra": [*KUKA[:2], (-120, 155), *KUKA[3:]],
    "kr210": [*KUKA[:4], (-125, 125), KUKA[5]],
    "irb6700": [(-170, 170), (-65, 85), (-180, 70), (-300, 300), (-130, 130), (-360, 360)],
    "ur10e": [(-360, 360), (-360, 360), (-180, 180), (-360, 360), (-360, 360), (-360, 360)],
}
SPEEDS = {
    "kr240": (103, 94, 100, 170, 129, 206),
    "kr240-ultra": (105, 101, 107, 136, 129, 206),
    "kr210": (117, 111, 112, 179, 172, 220),
    "irb6700": (100, 90, 90, 170, 120, 190),
    "ur10e": (120, 120, 180, 180, 180, 180),
}
REACH = {"kr240": 2.9003, "kr240-ultra": 2.8956, "kr210": 2.701, "irb6700": 2.654, "ur10e": 1.3}
RATED = {
    "kr240": (1.508, 0.643, 1.707, 5.061, 5.144, 6.232),
    "kr240-ultra": (1.60, 1.18, 1.25, 5.27, 5.02, 5.14),
    "kr210": (1.98, 1.26, 2.57, 7.04, 1.76, 1.87),
    "ur10e": (5.0,) * 6,
}


def plant_of(name):
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModels(str(MODELS / "robots" / f"{name}.urdf"))
    plant.Finalize()
    return plant


def links_of(plant):
    joints = [plant.GetJointByName(j) for j in JOINTS]
    return [joints[0].parent_body(), *(j.child_body() for j in joints)]


@pytest.mark.parametrize("name", MASSES)
def test_masses_are_the_published_ones(name):
    got = [b.default_mass() for b in links_of(plant_of(name))]
    assert np.abs(np.array(got) - MASSES[name]).max() < 0.0051


@pytest.mark.parametrize("name", ["kr240", "kr240-ultra"])
def test_inertias_are_the_published_ones(name):
    for body, (com, tensor) in zip(links_of(plant_of(name)), KR240_INERTIA, strict=True):
        spatial = body.default_spatial_inertia()
        about = spatial.Shift(spatial.get_com()).CalcRotationalInertia()
        assert np.allclose(spatial.get_com(), com, atol=1e-9)
        assert np.allclose([*about.get_moments(), *about.get_products()], tensor, atol=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_inertias_are_those_of_solids(name):
    """Positive moments, none above the sum of the others; and a body that is no larger than its boxes."""
    robot = robot_from_file(MODELS / "robots" / f"{name}.urdf", JOINTS, "tool0")
    for i, body in enumerate(links_of(plant_of(name))):
        spatial = body.default_spatial_inertia()
        assert spatial.IsPhysicallyValid()
        size = np.linalg.norm(np.ptp(corners(robot, i), axis=0))
        about = spatial.Shift(spatial.get_com()).CalcRotationalInertia()
        assert about.get_moments().max() <= spatial.get_mass() * size**2 / 2


def corners(robot, link):
    """Corners of the collision bodies of a link, in its frame."""
    from scanmotion.cell.collision.sphere_filter import box_of

    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    bodies = [b for b in robot.bodies if b.link == link]
    return np.concatenate([signs * box_of(b) @ b.X_LG[:3, :3].T + b.X_LG[:3, 3] for b in bodies])


@pytest.mark.parametrize("name", ROBOTS)
def test_the_centre_of_mass_is_inside_the_outline(name):
    robot = robot_from_file(MODELS / "robots" / f"{name}.urdf", JOINTS, "tool0")
    for i, body in enumerate(links_of(plant_of(name))):
        points = corners(robot, i)
        com = body.default_spatial_inertia().get_com()
        assert (com >= points.min(axis=0) - 0.01).all() and (com <= points.max(axis=0) + 0.01).all(), i


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_are_the_published_ones(name):
    robot = robot_from_file(MODELS / "robots" / f"{name}.urdf", JOINTS, "tool0")
    low, high = np.rad2deg(robot.lower), np.rad2deg(robot.upper)
    assert np.abs(np.column_stack([low, high]) - RANGES[name]).max() < 1e-5
    assert np.abs(np.rad2deg(robot.velocity) - SPEEDS[name]).max() < 1e-5


@pytest.mark.parametrize("name", ROBOTS)
def test_facts_beside_the_urdf(name):
    facts = robot_facts()[name]
    assert facts["reach_m"] == REACH[name]
    assert facts["payload_kg"] > 0 and len(facts["source"]) > 20
    if name in RATED:
        assert np.allclose(facts["acceleration_rad_s2"]["rated"], RATED[name])
    assert min(facts["acceleration_rad_s2"]["light"]) > 0
    assert ("composed" in facts["title"]) == (name == "kr240-ultra")


@pytest.mark.parametrize("name", ["kr240", "kr240-ultra"])
def test_published_reach_is_the_wrist_with_a2_at_its_stop(name):
    """KUKA's reach: horizontal, of the wrist centre, A2 at -5 deg at most (facts 1.0)."""
    robot = robot_from_file(MODELS / "robots" / f"{name}.urdf", JOINTS, "tool0")
    from scanmotion.cell.arm.robot import arm_poses

    a3 = np.linspace(robot.lower[2], robot.upper[2], 4001)
    q = np.zeros((len(a3), 6))
    q[:, 1], q[:, 2] = robot.upper[1], a3
    assert arm_poses(robot, q)[:, 5, 0, 3].max() == pytest.approx(REACH[name], abs=5e-4)


def test_every_mesh_is_a_closed_convex_body_that_a_urdf_shows():
    shown = set()
    for path in (MODELS / "robots").glob("*.urdf"):
        shown |= set(re.findall(r"meshes/([\w-]+\.obj)", path.read_text()))
    assert shown == {p.name for p in (MODELS / "meshes").glob("*.obj")}
    for name in shown:
        mesh = trimesh.load(MODELS / "meshes" / name, force="mesh")
        mesh.merge_vertices(merge_norm=True)
        assert mesh.is_watertight and mesh.volume > 0, name
        assert mesh.volume == pytest.approx(mesh.convex_hull.volume, rel=2e-3), name


@pytest.mark.parametrize("name", ROBOTS)
def test_each_robot_has_a_cell_that_starts_free_and_sees_the_table(name):
    from scanmotion.cell.build import build_cell
    from scanmotion.cell.collision.clearance import Clearance
    from scanmotion.cell.kinematics import scanner_poses

    assert name in builtin_cells()
    cell = build_cell(load_cell(name))
    assert cell.settings.robot.model == name
    assert (cell.home >= cell.q_min).all() and (cell.home <= cell.q_max).all()
    assert Clearance(cell).free(cell.home[None]).all()
    X = scanner_poses(cell, cell.home[None])[0]
    ahead = cell.X_WT[:3, 3] - X[:3, 3]
    across = ahead - (ahead @ X[:3, 2]) * X[:3, 2]
    assert ahead @ X[:3, 2] > 0.2 and np.linalg.norm(across[:2]) < 0.05


def test_facts_file_is_plain_yaml():
    assert set(yaml.safe_load((MODELS / "robots" / "robots.yaml").read_text())) == set(ROBOTS)
