"""The Python API: parts from what is in hand, own viewpoints and orders, wrong types in one line, editors."""

import itertools
import subprocess
import sys

import numpy as np
import open3d as o3d
import pytest
import trimesh
from test_plan import TINY
from typer.testing import CliRunner

import scanmotion as sm
from scanmotion.cli.app import app
from scanmotion.core.errors import CellError, InputError, PartError
from scanmotion.core.viewpoint import Slack
from scanmotion.export.viewpoints import read_viewpoints
from scanmotion.motion.order.given_order import given_order
from scanmotion.motion.order.stops import dwell_group
from scanmotion.motion.transit_cost import move_matrix, move_model

BOX = trimesh.creation.box(extents=(100.0, 120.0, 140.0))


@pytest.mark.parametrize(
    "source",
    [
        BOX,
        o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(BOX.vertices), o3d.utility.Vector3iVector(BOX.faces)
        ),
        (np.asarray(BOX.vertices), np.asarray(BOX.faces)),
    ],
    ids=["trimesh", "open3d", "arrays"],
)
def test_the_same_box_from_any_hand(source):
    part = sm.part_from(source, units="mm", name="box")
    assert part.closed and len(part.triangles) == 12
    assert np.allclose(part.bounds, [[-0.05, -0.06, 0.0], [0.05, 0.06, 0.14]])


def test_a_cloud_keeps_its_normals():
    points, face = trimesh.sample.sample_surface(BOX, 3000, seed=1)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(BOX.face_normals[face])
    part = sm.part_from(cloud, units="mm")
    assert not part.is_mesh and part.normals is not None
    assert np.allclose(np.abs(part.normals).max(axis=1), 1.0)


@pytest.mark.parametrize(
    ("source", "units", "words"),
    [
        (BOX, None, "in which unit"),
        (BOX, "miles", "unknown unit"),
        (17, "mm", "cannot be made from a int"),
        (np.zeros((3, 2)), "mm", "points of shape"),
        ((np.zeros((3, 3)), np.zeros((1, 3))), "mm", "integers"),
        ((BOX.vertices, np.array([[0, 1, 99]])), "mm", "vertex 99"),
    ],
)
def test_what_is_no_part_is_refused_in_one_line(source, units, words):
    with pytest.raises(PartError, match=words) as told:
        sm.part_from(source, units=units)
    assert "\n" not in str(told.value)


def views() -> list[sm.Viewpoint]:
    places = {"front": (0.6, 0.0, 0.3), "side": (0.0, 0.6, 0.3), "back": (-0.6, 0.0, 0.3)}
    return [
        sm.Viewpoint(
            id=name, X_OS=sm.look_at(np.array(p), np.array([0, 0, 0.07]) - p), standoff=0.55, step="local",
            kind="station",
        )
        for name, p in places.items()
    ]  # fmt: skip


def test_own_viewpoints_are_visited_as_given(tmp_path):
    made = sm.plan(
        sm.part_from(BOX, units="mm"), "kr240", viewpoints=views(), order="given",
        options=sm.PlanOptions(seed=1, **TINY),
    )  # fmt: skip
    served = [v for o in made.trajectory.operations if o.kind == "dwell" for v in o.viewpoints]
    assert served == ["front", "side", "back"]
    made.save(tmp_path / "out")
    assert sm.verify(tmp_path / "out") == []


OWN = """id, x_mm, y_mm, z_mm, dx, dy, dz, standoff_mm
front, 600, 0, 300, -600, 0, -230, 550
side, 0, 600, 300, 0, -600, -230, 550
back, -600, 0, 300, 600, 0, -230, 550
"""


def test_a_file_of_own_viewpoints_needs_few_columns_in_any_order(tmp_path):
    file = tmp_path / "own.csv"
    file.write_text(OWN)
    for read, made in zip(read_viewpoints(file), views(), strict=True):
        assert read.id == made.id and read.kind == "station" and read.slack == Slack()
        assert np.allclose(read.X_OS, made.X_OS, atol=1e-12)
    rows = [line.split(",") for line in OWN.splitlines()]
    file.write_text("\n".join(",".join(reversed(row)) for row in rows) + "\n")
    assert [v.id for v in read_viewpoints(file)] == ["front", "side", "back"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (", standoff_mm", ", standof_mm", "column 'standof_mm' is unknown"),
        (", dz,", ", qz,", "not both"),
        ("z_mm, ", "x_mm, ", "column x_mm is there twice"),
        ("-600, 0, -230, 550\nside", "0, 0, 0, 550\nside", "row 2: dx, dy, dz is not a direction"),
    ],
)
def test_a_wrong_file_of_viewpoints_is_one_line(tmp_path, old, new, words):
    file = tmp_path / "own.csv"
    assert old in OWN
    file.write_text(OWN.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as told:
        read_viewpoints(file)
    assert "\n" not in str(told.value)


def test_the_command_visits_own_viewpoints_as_the_file_has_them(tmp_path):
    (tmp_path / "own.csv").write_text(OWN)
    words = [
        "plan",
        "--box",
        "100",
        "120",
        "140",
        "--viewpoints",
        str(tmp_path / "own.csv"),
        "--order",
        "given",
    ]
    run = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out"), "--no-html", "--quiet"])
    assert run.exit_code == 0, run.output
    operations = sm.load_plan(tmp_path / "out").trajectory.operations
    assert [v for o in operations if o.kind == "dwell" for v in o.viewpoints] == ["front", "side", "back"]
    assert sm.verify(tmp_path / "out") == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--order", "given"], "only together with --viewpoints"),
        (["--viewpoints", "own.csv", "--order", "best"], "fastest or given"),
        (["--viewpoints", "own.csv", "--placements", "2"], "not together with --placements"),
        (["--viewpoints", "missing.csv"], "no such file"),
    ],
)
def test_contradictions_with_own_viewpoints_are_one_line(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.csv").write_text(OWN)
    run = CliRunner().invoke(app, ["plan", "--box", "100", "120", "140", *words])
    assert run.exit_code == 2 and message in run.output
    assert len(run.output.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"viewpoints": []}, "there is none"),
        ({"viewpoints": ["front"]}, "a str is no Viewpoint"),
        ({"viewpoints": [*views(), views()[0]]}, "'front' is there twice"),
        ({"viewpoints": views(), "order": "random"}, "known: fastest, given"),
    ],
)
def test_wrong_viewpoints_are_refused(changed, words):
    with pytest.raises(InputError, match=words):
        sm.plan(sm.box_part(0.1, 0.12, 0.14), "kr240", **changed)


def test_a_wrong_cell_is_one_line():
    with pytest.raises(CellError, match="a int is no cell"):
        sm.plan(sm.box_part(0.1, 0.12, 0.14), 7)


def test_ways_of_a_given_order_are_the_best_by_brute_force(kr240_cell, rng):
    model = move_model(kr240_cell)
    found = sm.reach(kr240_cell, views())
    groups = [dwell_group(r, model, (-6.0, 6.0)) for r in found]
    few = [g.only(rng.choice(len(g), size=min(6, len(g)), replace=False)) for g in groups]
    start = kr240_cell.home

    def cost(ways) -> float:
        total = move_matrix(model, start, few[0].enter)[0, ways[0]] + few[0].seconds[ways[0]]
        for a, b, w, v in zip(few, few[1:], ways, ways[1:], strict=False):
            total += move_matrix(model, a.leave, b.enter)[w, v] + b.seconds[v]
        return float(total)

    order, ways = given_order(few, [r.viewpoint.id for r in found], model, start)
    assert order == [0, 1, 2]
    every = itertools.product(*(range(len(g)) for g in few))
    assert cost(ways) == pytest.approx(min(cost(w) for w in every), abs=1e-9)


def test_viewpoints_as_arrays_and_tables(pitted_plan):
    table, views = pitted_plan.viewpoints.to_dataframe(), pitted_plan.viewpoints
    assert list(table["id"]) == [v.id for v in views] and views.X_OS.shape == (len(views), 4, 4)
    assert np.allclose(table[["x_m", "y_m", "z_m"]], views.X_OS[:, :3, 3])
    assert np.allclose(np.linalg.norm(table[["dx", "dy", "dz"]], axis=1), 1.0)
    assert views._repr_html_().count("<tr>") == len(views) + 1
    empty = type(views)()
    assert empty.X_OS.shape == (0, 4, 4) and len(empty.to_dataframe()) == 0


def test_a_trajectory_as_a_table(pitted_plan):
    trajectory = pitted_plan.trajectory
    table = trajectory.to_dataframe(pitted_plan.cell.joint_names)
    assert np.array_equal(table[list(pitted_plan.cell.joint_names)].to_numpy(), trajectory.q)
    scanning = sum(o.t_end - o.t_start for o in trajectory.operations if o.scanning)
    assert table.loc[table["scanning"], "t"].diff().fillna(0).clip(upper=0.011).sum() <= scanning + 1e-6
    assert set(table["kind"]) == {o.kind for o in trajectory.operations}


def test_short_names_for_people():
    assert repr(sm.box_part(0.1, 0.12, 0.14)) == "Part('box', 12 triangles, 100 x 120 x 140 mm)"
    assert repr(views()[0]) == "Viewpoint('front', station, at (600, 0, 300) mm, 550 mm off)"


def test_editors_see_the_public_names(tmp_path):
    """pyright infers types of all public names from the package as it is installed."""
    script = tmp_path / "user.py"
    lines = ["import scanmotion as sm", "plan = sm.plan(sm.carving(), sm.load_cell('kr240'))"]
    lines += ["reveal_type(plan)", "plan.nothing_like_it"]
    lines += [f"sm.{name}" for name in sm.__all__]
    script.write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, str(script)]
    out = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stdout
    assert 'Type of "plan" is "Plan"' in out, out
    errors = [line for line in out.splitlines() if " error:" in line]
    assert len(errors) == 1 and "nothing_like_it" in errors[0], out
