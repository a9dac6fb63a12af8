"""The scene: its shapes, its motion, its page in a real browser, and where it listens."""

import os
import socket
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import screenshot
from fake_plan import fake_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import scanmotion.report.scene as mut
from scanmotion.cell.kinematics import flange_poses
from scanmotion.cli.app import app
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.parts.make_part import box_part, carving
from scanmotion.report.figures import shapes, sight
from scanmotion.report.scene_overlay import with_overlay
from scanmotion.sensing.visibility import scene_from, sees


@pytest.fixture(scope="module")
def plan(kr240_cell):
    return fake_plan(kr240_cell)


@pytest.fixture(scope="module")
def page(plan, tmp_path_factory):
    file = tmp_path_factory.mktemp("scene") / "scene.html"
    file.write_text(mut.scene_html(plan), encoding="utf-8")
    return file


def areas(mesh):
    a, b, c = (mesh[0][mesh[1][:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_a_tube_keeps_its_distance(rng):
    t = np.linspace(0, 6, 80)
    line = np.column_stack([np.cos(t), np.sin(t), 0.1 * t])
    vertices, triangles = shapes.tube(line, 0.01)
    nearest = np.linalg.norm(vertices[:, None] - line[None], axis=2).min(axis=1)
    np.testing.assert_allclose(nearest, 0.01, atol=1e-9)
    assert triangles.shape == (79 * 6, 3) and triangles.max() == len(vertices) - 1


@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 3), min_size=2, max_size=6))
@settings(max_examples=50)
def test_a_tube_is_finite_whatever_the_line(points):
    vertices, _ = shapes.tube(np.array(points), 0.01)
    assert np.isfinite(vertices).all()


def test_a_label_has_the_asked_height():
    vertices, triangles = shapes.label("H", 0.1)
    assert np.ptp(vertices[:, 2]) == pytest.approx(0.1, rel=0.15)
    assert np.abs(vertices[:, 1]).max() < 0.01 and len(triangles) > 0
    wide = shapes.label("L12.3", 0.1)[0]
    assert np.ptp(wide[:, 0]) > 3 * np.ptp(vertices[:, 0])


@pytest.mark.parametrize("depth, sides", [(0.4, (0.2144, 0.1483)), (1.0, (0.5359, 0.3707))])
def test_the_field_drawn_is_that_of_table_1(depth, sides):
    edges = shapes.field_edges(Scanner(), 0.2, depth)
    corners = edges.reshape(-1, 3)
    far = corners[corners[:, 2] == depth]
    np.testing.assert_allclose(np.ptp(far, axis=0)[:2], sides, atol=1e-4)
    vertices, triangles = shapes.field_faces(Scanner(), depth)
    np.testing.assert_allclose(np.ptp(vertices[1:, :2], axis=0), sides, atol=1e-4)
    assert len(triangles) == 4


def test_a_part_is_cut_fine_without_changing_its_surface():
    part = box_part(0.3, 0.2, 0.1)
    mesh = shapes.paintable(part, edge=0.01, most=50_000)
    assert len(mesh[1]) <= 50_000
    assert areas(mesh).sum() == pytest.approx(2 * (0.06 + 0.03 + 0.02), rel=1e-12)
    corners = mesh[0][mesh[1]]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.01 + 1e-12
    normals = shapes.shading_normals(mesh)
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0)


def test_a_fine_part_is_thinned():
    part = carving()
    mesh = shapes.paintable(part, most=5000)
    assert 2000 < len(mesh[1]) <= 5000
    full = areas((part.vertices, part.triangles)).sum()
    assert areas(mesh).sum() == pytest.approx(full, rel=0.05)


def test_surface_appears_when_a_frame_first_sees_it(plan):
    ends, first = sight.first_sight(plan)
    assert (np.diff(ends) > 0).all() and len(ends) == 8 + 1  # eight seconds of turning, one short dwell
    np.testing.assert_array_equal(first >= 0, plan.seen)
    # Nothing that only the local round has seen appears in the global step.
    only_local = plan.seen & ~plan.segments[0].seen
    t, X_OS = sight._poses(plan.cell, plan.trajectory)
    part, table = plan.part, plan.cell.settings.turntable
    scene = scene_from(part.vertices, part.triangles, table_radius=table.diameter_m / 2, table_z=0.0)
    points, normals = plan.samples.points, plan.samples.normals
    spans = sight._slices(plan)[1]
    before = np.zeros(len(points), bool)
    for k, span in enumerate(spans):
        now = sees(scene, Scanner(), X_OS[sight._frames(t, *span)], points, normals).any(axis=0)
        fresh = now & ~before & plan.seen
        assert (first[fresh] == k).all()
        before |= now
    never = plan.seen & ~before
    assert (first[never & only_local] == 8).all() and (first[never & ~only_local] == 7).all()


def test_the_arm_drawn_stands_where_kinematics_says(kr240_cell, rng):
    cell = kr240_cell
    low, high = np.maximum(cell.q_min, -4), np.minimum(cell.q_max, 4)
    q = rng.uniform(low, high, size=(20, 7))
    bodies = mut._Bodies(cell)
    drawn = bodies.poses(q)["cell/tool"]
    np.testing.assert_allclose(drawn, flange_poses(cell, q), atol=1e-9)


def test_frames_hold_every_operations_ends(plan):
    trajectory = plan.trajectory
    index = mut.frame_times(trajectory)
    t = trajectory.t[index]
    assert (np.diff(index) > 0).all() and np.diff(t).max() <= 0.1 + 0.011
    for o in trajectory.operations:
        assert np.abs(t - o.t_start).min() < 0.006 and np.abs(t - o.t_end).min() < 0.006


@given(st.lists(st.integers(0, 2), min_size=1, max_size=40))
@settings(max_examples=60)
def test_unchanged_frames_can_be_left_out(values):
    values = np.array(values, float)[:, None, None]
    kept = mut._changes(values)
    t = np.arange(len(values))
    # Linear interpolation between what is kept gives every frame back, as the browser does it.
    np.testing.assert_allclose(np.interp(t, kept, values[kept, 0, 0]), values[:, 0, 0])


def test_names_cannot_break_out_of_the_page(plan):
    name = "</script><script>alert(1)</script>"
    first, *rest = plan.trajectory.operations
    told = replace(plan.trajectory, operations=(replace(first, viewpoints=(name,)), *rest))
    bad = replace(plan, trajectory=told, part=replace(plan.part, name=name))
    overlay = with_overlay("<body></body>", bad)
    assert "<script>alert" not in overlay
    assert overlay.count("<script>") == overlay.count("</script>") == 1


@pytest.fixture(scope="module")
def shot(page):
    return screenshot(page, fragment="#t=7&view=cell")


def test_the_page_in_a_browser(shot):
    image, asked = shot
    assert asked == set()
    pixels = image.reshape(-1, 3).astype(int)
    assert len(np.unique(pixels // 16, axis=0)) > 200, "the page is blank"
    orange = (pixels[:, 0] > 150) & (pixels[:, 1] > 40) & (pixels[:, 1] < 130) & (pixels[:, 2] < 60)
    assert orange.mean() > 0.01, "no robot in sight"


def seen_blue(image):
    """Pixels of the part in the colour of what the global step has seen; the legend left out."""
    r, g, b = image[:, 400:].astype(int).transpose(2, 0, 1)
    return ((b > r + 60) & (b > g + 25) & (g > r + 20)).sum()


def test_the_table_turns_and_the_part_is_coloured_as_it_is_seen(page, shot):
    early, _ = screenshot(page, fragment="#t=3.2")
    late, _ = screenshot(page, fragment="#t=13.4")
    assert seen_blue(early) < 0.2 * seen_blue(late) and seen_blue(late) > 500
    cell, _ = screenshot(page, fragment="#t=13.4&view=cell")
    assert seen_blue(late) > 3 * seen_blue(cell), "the object is large"
    # Only the right part of the picture: the legend on the left shows the time.
    differs = np.abs(cell[:, 400:].astype(int) - shot[0][:, 400:]).max(axis=2) > 40
    assert differs.sum() > 200


def test_viewpoints_that_are_left_out_are_behind_a_switch(page):
    assert "1 viewpoint left out" in page.read_text() and "viewpoint out of reach" in page.read_text()
    hidden, shown = (screenshot(page, fragment=f"#t=7&view=cell{more}")[0] for more in ("", "&left-out"))
    hidden, shown = hidden[:, 400:].astype(int), shown[:, 400:].astype(int)
    differs = np.abs(shown - hidden).max(axis=2) > 40
    # What appears is red: green and blue are taken away from a light background.
    assert differs.sum() > 100 and ((hidden - shown)[differs][:, 1:].mean(axis=0) > 60).all()
    assert abs((hidden - shown)[differs][:, 0].mean()) < 60


def test_a_cell_is_drawn_before_anything_is_planned(tmp_path):
    file = tmp_path / "cell.html"
    run = CliRunner().invoke(app, ["cell", "show", "kr240", "--box", "200", "150", "400", "--out", str(file)])
    assert run.exit_code == 0 and "scanmotion plan --robot kr240" in run.output
    image, asked = screenshot(file, fragment="#view=cell")
    r, g, b = image.reshape(-1, 3).astype(int).T
    assert asked == set() and ((r > 150) & (g > 40) & (g < 130) & (b < 60)).mean() > 0.01, "no robot in sight"
    run = CliRunner().invoke(app, ["cell", "show", "none.yaml", "--out", str(file)])
    assert run.exit_code == 2 and len(run.output.strip().splitlines()) == 1


def listening_addresses():
    """Addresses on which this process listens, from the kernel's own tables."""
    own = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = os.readlink(entry)
        except OSError:
            continue
        if target.startswith("socket:["):
            own.add(target[8:-1])
    found = set()
    for table, family in (("tcp", socket.AF_INET), ("tcp6", socket.AF_INET6)):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[3] == "0A" and columns[9] in own:
                packed = bytes.fromhex(columns[1].split(":")[0])
                words = struct.unpack(f"<{len(packed) // 4}I", packed)
                found.add(socket.inet_ntop(family, struct.pack(f">{len(words)}I", *words)))
    return found


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux's /proc")
def test_the_live_scene_listens_on_loopback_only(plan):
    scene = mut.live_scene(plan)
    found = listening_addresses()
    assert found and found <= {"127.0.0.1", "::1"}
    assert "localhost" in scene.web_url()
