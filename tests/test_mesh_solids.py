"""Obstacles, housing and fixture as meshes: seen by filter, Drake and judge, each by true shape or more."""

import json

import numpy as np
import pytest
from test_last_word import moved
from test_robot_files import box_stl

from scanmotion.cell.build import build_cell, check_room
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.collision.last_word import DrakeJudge
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.kinematics import flange_poses, scanner_poses
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.core.errors import CellError
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge import verify
from scanmotion.plan_io.load import load_plan
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.pipeline import plan

PART = box_part(0.2, 0.16, 0.15)


def two_walls(path, gap):
    """Two walls of 0.1 m with a gap between them, as one file of two bodies, in millimetres."""
    lines, first = [], 1
    for y in (-(gap + 0.1) / 2, (gap + 0.1) / 2):
        box = box_part(0.4, 0.1, 1.0)
        lines += [f"v {1e3 * x} {1e3 * (v + y)} {1e3 * z}" for x, v, z in box.vertices.tolist()]
        lines += [f"f {a + first} {b + first} {c + first}" for a, b, c in box.triangles.tolist()]
        first += len(box.vertices)
    path.write_text("\n".join(lines) + "\n")


def drawn(cell, count, seed=0):
    rng = np.random.default_rng(seed)
    near = cell.home[:6] + rng.normal(size=(count, 6)) * np.array([0.5, 0.4, 0.4, 1.0, 0.8, 1.0])
    return np.column_stack([np.clip(near, cell.q_min[:6], cell.q_max[:6]), np.zeros(count)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("meshes")


def settings_with(folder, **data):
    return settings_from(data, folder=str(folder))


@pytest.mark.parametrize("kind", ["stl", "obj"])
def test_a_box_as_a_mesh_is_the_box(folder, kind):
    """The same cabinet as a mesh in millimetres, turned and moved, and as a box."""
    if kind == "stl":
        box_stl(folder / "cabinet.stl", (0.5, 0.3, 1.2), unit=0.001)
        low = 0.0
    else:
        box = box_part(0.5, 0.3, 1.2)
        lines = [f"v {1e3 * x} {1e3 * y} {1e3 * z}" for x, y, z in box.vertices.tolist()]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in box.triangles.tolist()]
        (folder / "cabinet.obj").write_text("\n".join(lines))
        low = -0.6
    at = [1.1, 1.0, 1.2 + low]
    mesh = {"name": "cabinet", "mesh": f"cabinet.{kind}", "unit": "mm", "position_m": at, "yaw_deg": 30.0}
    plain = {"name": "cabinet", "centre_m": [1.1, 1.0, 1.2], "size_m": [0.5, 0.3, 1.2], "yaw_deg": 30.0}
    a = build_cell(settings_with(folder, obstacles=[mesh]), PART)
    b = build_cell(settings_with(folder, obstacles=[plain]), PART)
    q = drawn(b, 300)
    free = Clearance(b).free(q)
    assert 20 < free.sum() < 280
    np.testing.assert_array_equal(drake_of(a).free(q), drake_of(b).free(q))
    np.testing.assert_array_equal(Clearance(a).free(q), free)
    assert not (Clearance(a).fast_free(q) & ~free).any()
    assert not (Clearance(a).surely_blocked(q) & free).any()


def test_bodies_of_a_mesh_are_taken_one_by_one(folder):
    """Between two walls of one file there is room, as between two boxes."""
    two_walls(folder / "walls.obj", gap=1.2)
    walls = {"name": "walls", "mesh": "walls.obj", "unit": "mm", "position_m": [1.2, 0.0, 1.6]}
    boxes = [
        {"name": f"w{n}", "centre_m": [1.2, y, 2.1], "size_m": [0.4, 0.1, 1.0]}
        for n, y in enumerate((-0.65, 0.65))
    ]
    a = build_cell(settings_with(folder, obstacles=[walls]))
    b = build_cell(settings_with(folder, obstacles=boxes))
    assert [body.name for body in a.bodies if body.mesh] == ["walls_0", "walls_1"]
    q = drawn(b, 200, seed=2)
    free = Clearance(b).free(q)
    assert free[:1].size and 10 < free.sum() < 190
    np.testing.assert_array_equal(Clearance(a).free(q), free)


@pytest.fixture(scope="module")
def planned(folder):
    """Housing and fixture as meshes of the size of ours, and a post of the cell's CAD."""
    box_stl(folder / "housing.stl", (0.262, 0.158, 0.063), at=(0.075, 0.0, -0.0315), unit=0.001)
    box_stl(folder / "fixture.stl", (0.1, 0.1, 0.15), at=(0.0, 0.0, 0.075), unit=0.001)
    box_stl(folder / "post.stl", (0.1, 0.1, 1.5), at=(0.0, 0.0, 0.75), unit=0.001)
    settings = settings_with(
        folder, tool={"housing_mesh": "housing.stl", "fixture_mesh": "fixture.stl", "mesh_unit": "mm"},
        obstacles=[{"name": "post", "mesh": "post.stl", "unit": "mm", "position_m": [1.0, 1.6, 0.0]}],
    )  # fmt: skip
    made = plan(PART, settings, options=PlanOptions(source="box"))
    assert made.save(folder / "plan") == [] and made.last_word.findings == ()
    return made


def test_the_plans_folder_holds_the_meshes_and_loads_again(planned, folder):
    data = json.loads((folder / "plan" / "plan.json").read_text())
    meshes = {b["name"]: b["file"] for b in data["bodies"] if b["shape"] == "mesh"}
    assert sorted(meshes) == ["fixture", "post", "scanner"]
    assert all((folder / "plan" / file).is_file() for file in meshes.values())
    again = load_plan(folder / "plan")
    assert [b.name for b in again.cell.bodies] == [b.name for b in planned.cell.bodies]
    assert verify(folder / "plan") == []


@pytest.mark.parametrize("what", ["post", "scanner", "fixture"])
def test_planted_collisions_are_caught_by_each_of_the_three(planned, folder, what):
    """The post where the scanner passes; a spike on housing or fixture that reaches into the part."""
    q = planned.trajectory.q
    k = int(np.argmax(np.linalg.norm(q - q[0], axis=1)))
    cell = planned.cell
    X_WS, X_WF = scanner_poses(cell, q[[k]])[0], flange_poses(cell, q[[k]])[0]
    data = json.loads((folder / "plan" / "plan.json").read_text())
    file = next(b["file"] for b in data["bodies"] if b["name"] == what)
    middle = np.array([*cell.X_WT[:2, 3], cell.X_WT[2, 3] + 0.07])
    frame = {"post": np.eye(4), "scanner": X_WS, "fixture": X_WF}[what]
    at = X_WS[:3, 3] if what == "post" else middle
    p = np.linalg.inv(frame) @ [*at, 1.0]
    p = p[:3] - ([1.0, 1.6, 0.0] if what == "post" else 0.0)
    other = folder / f"planted_{what}"
    other.mkdir()
    for source in (folder / "plan").iterdir():
        (other / source.name).write_bytes(source.read_bytes())
    box_stl(other / file, (0.06, 0.06, 0.06), at=p, unit=0.001)
    found = [f for f in verify(other) if f.code == "collision"]
    assert found and any(what in f.where for f in found)
    # The planner's cell, made from the same folder.
    spoilt = build_cell(
        settings_from(json.loads((other / "cell.json").read_text()), folder=str(other)).model_copy(
            update={"folder": str(other)}
        ),
        PART,
    )
    row = q[[k]]
    assert not Clearance(spoilt).fast_free(row)[0] and not Clearance(spoilt).free(row)[0]
    assert DrakeJudge(spoilt).judge(moved(np.repeat(row, 2, axis=0))).findings


@pytest.mark.parametrize(
    ("obstacle", "line"),
    [
        ({"name": "a", "mesh": "post.stl"}, "a mesh has no unit: write unit: mm, or m"),
        ({"name": "a"}, "a box needs centre_m and size_m"),
        ({"name": "a", "mesh": "none.stl", "unit": "mm"}, "none.stl: no such file beside the cell's YAML"),
        ({"name": "a", "mesh": "a.step", "unit": "mm"}, r"a.step: is not read; .stl, .obj, .ply, .dae are"),
        ({"name": "a", "mesh": "post.stl", "unit": "m"}, "is it in millimetres"),
        ({"name": "a", "mesh": "post.stl", "unit": "m", "size_m": [1, 1, 1]}, "are a box's"),
    ],
)
def test_what_is_wrong_with_a_mesh_is_one_line(planned, folder, obstacle, line):
    with pytest.raises(CellError, match=line) as caught:
        build_cell(settings_with(folder, obstacles=[obstacle]))
    assert "\n" not in str(caught.value)


def test_a_mesh_in_which_the_table_turns_is_refused(planned, folder):
    mesh = {"name": "post", "mesh": "post.stl", "unit": "mm", "position_m": [2.2, 0.5, 0.0]}
    with pytest.raises(CellError, match="post stands in the turntable"):
        check_room(
            build_cell(settings_with(folder, obstacles=[mesh], robot={"home_deg": [0, -90, 90, 0, 0, 0]}))
        )


def test_without_meshes_the_settings_are_as_they_were():
    assert build_cell(load_cell("kr240")).meshes == ()
