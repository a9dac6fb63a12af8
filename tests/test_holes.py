"""Holes of clouds and meshes: closed forms, kinds, invariances, false alarms, bad input, scored cases."""

import importlib.util
import json
import subprocess
import sys
from argparse import Namespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import HoleError
from scanmotion.sensing.holes.find import hole_report_to_json, holes_from_cloud, holes_from_mesh
from scanmotion.sensing.holes.loops import box_about, loop_length, ordered_loop, roundness, vector_area
from scanmotion.sensing.holes.paper_clusters import LargestAngle, dbscan
from scanmotion.sensing.holes.sampling import even_samples

STEP = 0.002


def even_sphere(n: int, radius: float = 0.1) -> np.ndarray:
    """Fibonacci points of a sphere: even, none random."""
    i = np.arange(n) + 0.5
    z, a = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    return radius * np.stack([np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z], axis=1)


def cap_off(points: np.ndarray, axis, angle: float) -> np.ndarray:
    """The sphere without a cap of the given half angle."""
    unit = points / np.linalg.norm(points, axis=1, keepdims=True)
    return points[unit @ np.asarray(axis, float) < np.cos(angle)]


def hex_plate(half: float = 0.06) -> np.ndarray:
    """A square plate of hexagonally packed points, STEP apart."""
    i, j = np.meshgrid(np.arange(-70, 71), np.arange(-70, 71))
    xy = STEP * np.stack([i + 0.5 * (j % 2), j * np.sqrt(3) / 2], axis=-1).reshape(-1, 2)
    xy = xy[np.abs(xy).max(axis=1) < half]
    return np.column_stack([xy, np.zeros(len(xy))])


def sphere_mesh(n: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    points = even_sphere(n)
    faces = ConvexHull(points).simplices
    normal = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    inward = np.einsum("ij,ij->i", normal, points[faces[:, 0]]) < 0
    return points, np.where(inward[:, None], faces[:, ::-1], faces)


def inner_holes(report):
    return [hole for hole in report.holes if hole.kind != "edge"]


def test_disc_cut_from_a_plate_has_its_perimeter_and_area() -> None:
    points = hex_plate()
    points = points[np.linalg.norm(points[:, :2], axis=1) > 0.02]
    (hole,) = inner_holes(holes_from_cloud(points, view_directions=np.tile([0.0, 0, 1], (len(points), 1))))
    assert hole.kind == "common"
    assert hole.perimeter == pytest.approx(2 * np.pi * 0.021, rel=0.08)
    assert hole.area == pytest.approx(np.pi * 0.021**2, rel=0.06)
    assert np.allclose(hole.center, 0, atol=STEP / 2)
    assert np.allclose(hole.normal, [0, 0, 1])
    assert np.allclose(hole.extent, [0.042, 0.042, 0], atol=STEP)
    assert (np.linalg.norm(hole.boundary[:, :2], axis=1) < 0.02 + 2 * STEP).all()


def test_the_outer_rim_of_a_plate_is_an_edge() -> None:
    report = holes_from_cloud(hex_plate(), view_directions=np.tile([0.0, 0, 1], (len(hex_plate()), 1)))
    (hole,) = report.holes
    assert hole.kind == "edge"
    assert hole.perimeter == pytest.approx(8 * 0.06, rel=0.1)
    assert hole.area == pytest.approx(4 * 0.06**2, rel=0.1)


@pytest.mark.parametrize("length", [0.045, 0.07])
def test_a_slit_is_interstitial_and_one_hole(length: float) -> None:
    points = hex_plate()
    points = points[(np.abs(points[:, 0]) > length / 2) | (np.abs(points[:, 1]) > 2 * STEP)]
    (hole,) = inner_holes(holes_from_cloud(points))
    assert hole.kind == "interstitial"
    assert hole.extent[0] == pytest.approx(length + STEP, abs=2 * STEP)
    assert abs(hole.X_OH[:3, 0] @ [1, 0, 0]) > 0.99


def test_an_island_is_told_from_a_common_hole() -> None:
    points = hex_plate()
    far = np.linalg.norm(points[:, :2], axis=1)
    (hole,) = inner_holes(holes_from_cloud(points[(far > 0.03) | (far < 0.012)]))
    assert hole.kind == "island"
    assert len(hole.islands) == 1
    assert hole.area == pytest.approx(np.pi * (0.031**2 - 0.011**2), rel=0.1)


def test_two_holes_a_few_points_apart_stay_two() -> None:
    points = hex_plate()
    for x in (-0.02, 0.02):
        points = points[np.linalg.norm(points[:, :2] - [x, 0], axis=1) > 0.015]
    assert len(inner_holes(holes_from_cloud(points))) == 2


def test_a_closed_surface_has_no_holes(rng) -> None:
    for points in (even_sphere(8000), even_samples(*sphere_mesh(), 0.003, rng=rng)[0]):
        report = holes_from_cloud(points)
        assert report.holes == () and not report.boundary_mask.any()
        assert "no hole found" in report.notes[-1]


def test_a_box_with_sharp_edges_has_no_holes(rng) -> None:
    side, sign = rng.integers(0, 3, 120000), rng.choice([-0.1, 0.1], 120000)
    dense = rng.uniform(-0.1, 0.1, (120000, 3))
    dense[np.arange(120000), side] = sign
    report = holes_from_cloud(dense, voxel=0.003)
    assert report.holes == ()


def test_thin_wall_with_a_hole_in_one_side_only() -> None:
    """Front and back 3 pitches apart: the back does not fill the front's hole."""
    plate = hex_plate()
    front = plate[np.linalg.norm(plate[:, :2], axis=1) > 0.015]
    points = np.concatenate([front, plate - [0, 0, 3 * STEP]])
    up = np.concatenate([np.tile([0.0, 0, 1], (len(front), 1)), np.tile([0.0, 0, -1], (len(plate), 1))])
    (hole,) = inner_holes(holes_from_cloud(points, view_directions=up))
    assert np.allclose(hole.center, 0, atol=STEP)
    assert hole.normal[2] > 0.99


def test_thinned_patches_are_no_holes(rng) -> None:
    points = even_sphere(20000)
    patch = (points @ [0, 0, 1.0] > 0.085) & (rng.random(20000) < 0.5)
    assert holes_from_cloud(points[~patch]).holes == ()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kept", [0.4, 0.5])
def test_patches_thinned_at_random_are_no_holes(seed: int, kept: float) -> None:
    """Removed samples form clusters, some as large as a small hole; the pitch around them tells."""
    rng = np.random.default_rng(seed)
    points = even_samples(*sphere_mesh(500), 0.0022, rng=rng)[0]
    axes = Rotation.random(3, rng=rng).as_matrix().reshape(9, 3)[[0, 1, 2]]
    patch = (points @ axes.T > 0.094).any(axis=1) & (rng.random(len(points)) > kept)
    assert holes_from_cloud(points[~patch]).holes == ()


@pytest.mark.parametrize("seed", [0, 3, 8])
def test_wide_patches_thinned_at_random_are_no_holes(seed: int) -> None:
    """The wider the patch, the more wide gaps chance leaves in it; and the scan is noisy."""
    rng = np.random.default_rng(seed)
    points = even_samples(*sphere_mesh(500), 0.0022, rng=rng)[0]
    points = points + rng.normal(0, 0.0004, points.shape)
    axes = Rotation.random(3, rng=rng).as_matrix()[:, 0]
    patch = (points @ axes.T > 0.09).any(axis=1) & (rng.random(len(points)) > 0.4)
    assert holes_from_cloud(points[~patch]).holes == ()


@pytest.mark.parametrize("seed", range(3))
def test_a_small_hole_across_a_right_angle_is_one_hole(seed: int) -> None:
    """No tangent plane at the edge of a box: the rim is cut there unless folded points take part."""
    rng = np.random.default_rng(seed)
    corner = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = ConvexHull(corner).simplices
    normal = np.cross(corner[faces[:, 1]] - corner[faces[:, 0]], corner[faces[:, 2]] - corner[faces[:, 0]])
    inward = np.einsum("ij,ij->i", normal, corner[faces].mean(axis=1)) < 0
    points = even_samples(corner, np.where(inward[:, None], faces[:, ::-1], faces), 0.0012, rng=rng)[0]
    assert holes_from_cloud(points).holes == ()
    place = np.array([0.05, 0.05, 0.01])
    cut = np.linalg.norm(points - place, axis=1) > 0.008
    (hole,) = holes_from_cloud(points[cut]).holes
    assert np.linalg.norm(hole.center - place) < 0.005
    assert hole.normal @ [1, 1, 0] > 0.9 * np.sqrt(2)
    distance = np.linalg.norm(hole.boundary - place, axis=1)
    assert (distance < 0.008 + 0.003).all()


@pytest.mark.parametrize("seed", range(3))
def test_random_sampling_is_told_from_holes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20000, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1, keepdims=True)
    assert holes_from_cloud(points).holes == ()
    (hole,) = holes_from_cloud(cap_off(points, [0, 0, 1], 0.15)).holes
    assert hole.area == pytest.approx(np.pi * (0.1 * np.sin(0.15)) ** 2, rel=0.25)


def test_holes_survive_flying_pixels_and_noise(rng) -> None:
    points = cap_off(even_sphere(20000), [1, 0, 0], 0.25)
    noisy = points + rng.normal(0, 1e-4, points.shape)
    flying = rng.uniform(-0.15, 0.15, (len(points) // 100, 3))
    report = holes_from_cloud(np.concatenate([noisy, flying]))
    big = max(report.holes, key=lambda hole: hole.area)
    assert big.area == pytest.approx(np.pi * (0.1 * np.sin(0.25)) ** 2, rel=0.15)
    assert len(report.holes) == 1


@given(seed=st.integers(0, 2**32 - 1), log_scale=st.floats(-2, 2))
@settings(max_examples=8)
def test_rigid_motion_scale_and_permutation(seed: int, log_scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = cap_off(cap_off(even_sphere(6000), [0, 0, 1], 0.3), [1, 0, 0], 0.4)
    report = holes_from_cloud(points, view_directions=points)
    R, t, k = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), 10.0**log_scale
    order = rng.permutation(len(points))
    moved = holes_from_cloud((k * points @ R.T + t)[order], view_directions=(points @ R.T)[order])
    assert len(moved.holes) == len(report.holes) == 2
    for one, two in zip(report.holes, moved.holes, strict=True):
        assert two.kind == one.kind
        assert two.perimeter == pytest.approx(k * one.perimeter, rel=0.03)
        assert two.area == pytest.approx(k**2 * one.area, rel=0.03)
        assert np.linalg.norm(two.center - (k * R @ one.center + t)) < 0.003 * k
        assert two.normal @ R @ one.normal > 0.999


def test_permuting_the_points_changes_nothing(rng) -> None:
    points = cap_off(even_sphere(6000), [0, 1, 0], 0.3) + rng.normal(0, 1e-4, (1, 3))
    order = rng.permutation(len(points))
    for options in ({}, {"mode": "paper"}):
        one = holes_from_cloud(points, view_directions=points, **options)
        two = holes_from_cloud(points[order], view_directions=points[order], **options)
        assert (one.boundary_mask[order] == two.boundary_mask).all()
        assert json.dumps(hole_report_to_json(one)) == json.dumps(hole_report_to_json(two))


def twice_scanned(rng: np.random.Generator) -> np.ndarray:
    """Range images of a sphere from above and from the side, on exact grids, cut so that holes remain."""
    i, j = np.meshgrid(np.arange(-60, 61), np.arange(-60, 61), indexing="ij")
    xy = 0.0015 * np.stack([i, j], axis=-1).reshape(-1, 2)
    xy = xy[(xy**2).sum(axis=1) < 0.085**2]
    z = np.round(np.sqrt(0.01 - (xy**2).sum(axis=1)), 5)
    above = np.column_stack([xy, z])
    side = np.column_stack([z, xy[:, ::-1]])
    both = np.concatenate([above, side[:, [0, 2, 1]] + rng.normal(0, 5e-5, (len(side), 1))])
    for axis in ([0.5, 0, 0.8], [0, 0.5, 0.8], [0.85, 0.3, 0.3]):
        both = cap_off(both, np.array(axis) / np.linalg.norm(axis), 0.15)
    return both


@pytest.mark.parametrize("seed", range(3))
def test_overlapping_range_images_give_the_same_holes_wherever_they_lie(seed: int) -> None:
    """Where the pitch is uneven points are averaged: in cells that turn with the cloud, as no grid does."""
    points = twice_scanned(np.random.default_rng(0))
    report = holes_from_cloud(points, view_directions=points)
    assert "averaged" in report.notes[0] and len(inner_holes(report)) == 3
    rng = np.random.default_rng(seed)
    R, t, order = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3), rng.permutation(len(points))
    turned = holes_from_cloud((points @ R.T + t)[order], view_directions=(points @ R.T)[order])
    assert [hole.kind for hole in turned.holes] == [hole.kind for hole in report.holes]
    for one, two in zip(report.holes, turned.holes, strict=True):
        assert two.perimeter == pytest.approx(one.perimeter, rel=1e-3)
        assert np.linalg.norm(two.center - (R @ one.center + t)) < 1e-4


def test_paper_mode_finds_the_cap() -> None:
    points = cap_off(even_sphere(6000), [0, 1, 0], 0.3)
    report = holes_from_cloud(points, by_angle=LargestAngle())
    assert any(np.linalg.norm(hole.center - [0, 0.1 * np.cos(0.3), 0]) < 0.004 for hole in report.holes)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_dbscan_against_its_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((60, 3))
    label = dbscan(points, 0.2, 4)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    core = (distance <= 0.2).sum(axis=1) >= 4
    assert ((label < 0) == ~(distance[:, core] <= 0.2).any(axis=1)).all()
    linked = (distance <= 0.2) & core[:, None] & core[None]
    assert (label[np.nonzero(linked)[0]] == label[np.nonzero(linked)[1]]).all()
    reach = linked | np.eye(60, dtype=bool)
    for _ in range(6):
        reach = (reach.astype(int) @ reach.astype(int)) > 0
    same = label[:, None] == label[None]
    assert (reach == same)[np.ix_(core, core)].all()
    order = rng.permutation(60)
    assert (dbscan(points[order], 0.2, 4) == label[order]).all()


def test_mesh_loops_are_exact() -> None:
    vertices, faces = sphere_mesh()
    away = vertices[faces].mean(axis=1) @ [0, 0, 1.0] < 0.08
    report = holes_from_mesh(vertices, faces[away])
    (hole,) = report.holes
    ends = np.concatenate([faces[away][:, [0, 1]], faces[away][:, [1, 2]], faces[away][:, [2, 0]]])
    ends, count = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    border = ends[count == 1]
    assert hole.perimeter == pytest.approx(np.linalg.norm(np.diff(vertices[border], axis=1), axis=2).sum())
    assert set(hole.indices) == set(border.ravel()) == set(np.flatnonzero(report.boundary_mask))
    assert hole.normal[2] > 0.99 and hole.kind == "common"


def test_mesh_holes_that_touch_in_a_vertex_have_one_rim() -> None:
    i, j = np.meshgrid(np.arange(8), np.arange(8), indexing="ij")
    vertices = np.column_stack([i.ravel(), j.ravel(), np.zeros(64)]).astype(float)
    corner = (i * 8 + j)[:7, :7]
    cell = np.stack([corner, corner + 8, corner + 9, corner + 1], axis=-1)
    kept = np.ones((7, 7), bool)
    kept[2, 2] = kept[3, 3] = False
    quad = cell[kept]
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    report = holes_from_mesh(vertices, faces, min_size=0.0, min_vertices=3)
    assert sorted(round(hole.area, 9) for hole in report.holes) == [2.0, 49.0]


def test_mesh_vertices_stored_once_per_triangle_are_welded() -> None:
    vertices, faces = sphere_mesh(500)
    soup = vertices[faces].reshape(-1, 3)
    report = holes_from_mesh(soup, np.arange(len(soup)).reshape(-1, 3))
    assert report.holes == () and report.tiny == ()


def test_resampled_mesh_agrees_with_its_loops() -> None:
    vertices, faces = sphere_mesh(8000)
    faces = faces[vertices[faces].mean(axis=1) @ [0, 0, 1.0] < 0.09]
    (loop,), (cloud,) = (
        holes_from_mesh(vertices, faces).holes,
        holes_from_mesh(vertices, faces, method="resample").holes,
    )
    assert np.linalg.norm(loop.center - cloud.center) < 0.005
    assert cloud.area == pytest.approx(loop.area, rel=0.1)


def test_small_loops_are_reported_as_tiny() -> None:
    vertices, faces = sphere_mesh()
    report = holes_from_mesh(vertices, faces[1:])
    assert report.holes == () and len(report.tiny) == 1
    assert "tiny" in report.notes[-1]


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_ordered_loop_of_a_convex_rim_is_its_hull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, 40)
    rim = np.stack([2 * np.cos(angle), np.sin(angle), np.zeros(40)], axis=1)
    loop = rim[ordered_loop(rim)]
    assert loop_length(loop) == pytest.approx(loop_length(rim[np.argsort(angle)]), rel=1e-9)


def test_loop_measures_of_a_rectangle() -> None:
    x = np.concatenate(
        [
            np.linspace(0, 3, 30, endpoint=False),
            np.full(10, 3),
            np.linspace(3, 0, 30, endpoint=False),
            np.zeros(10),
        ]
    )
    y = np.concatenate(
        [
            np.zeros(30),
            np.linspace(0, 1, 10, endpoint=False),
            np.ones(30),
            np.linspace(1, 0, 10, endpoint=False),
        ]
    )
    R = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix()
    loop = np.stack([x, y, np.zeros(80)], axis=1) @ R.T + [5, 6, 7]
    assert loop_length(loop) == pytest.approx(8)
    assert np.allclose(vector_area(loop), 3 * R[:, 2])
    assert roundness(loop) == pytest.approx(0.5 / np.sqrt(3 / np.pi), rel=0.05)
    X_OH, extent = box_about(loop, R[:, 2])
    assert np.allclose(extent, [3, 1, 0], atol=1e-9)
    assert np.allclose(X_OH[:3, 3], R @ [1.5, 0.5, 0] + [5, 6, 7])
    assert np.allclose(X_OH[:3, :3].T @ X_OH[:3, :3], np.eye(3)) and np.linalg.det(X_OH[:3, :3]) > 0


def test_json_is_in_the_files_units_and_frame() -> None:
    vertices, faces = sphere_mesh()
    faces = faces[vertices[faces].mean(axis=1) @ [0, 0, 1.0] < 0.08]
    report = holes_from_mesh(vertices, faces)
    X_OI = np.eye(4)
    X_OI[:3, :3] = 1e-3 * Rotation.from_rotvec([np.pi / 2, 0, 0]).as_matrix()
    X_OI[:3, 3] = [0.1, 0.2, 0.3]
    (metres,), (placed,) = (
        hole_report_to_json(report)["holes"],
        hole_report_to_json(report, Namespace(X_OI=X_OI))["holes"],
    )
    back = np.array(placed["boundary_points"]) @ X_OI[:3, :3].T + X_OI[:3, 3]
    assert np.allclose(back, metres["boundary_points"])
    assert placed["perimeter"] == pytest.approx(1e3 * metres["perimeter"])
    assert placed["area"] == pytest.approx(1e6 * metres["area"])
    assert np.linalg.norm(placed["normal"]) == pytest.approx(1)
    assert hole_report_to_json(report, "mm")["holes"][0]["extent"] == pytest.approx(
        list(1e3 * report.holes[0].extent)
    )
    with pytest.raises(HoleError, match="furlong"):
        hole_report_to_json(report, "furlong")


def test_bad_clouds_are_refused_by_name() -> None:
    points = even_sphere(200)
    with pytest.raises(HoleError, match="2 points are fewer than the 31"):
        holes_from_cloud(points[:2])
    with pytest.raises(HoleError, match="10 distinct points"):
        holes_from_cloud(np.tile(points[:10], (20, 1)))
    with pytest.raises(HoleError, match="not finite"):
        holes_from_cloud(np.where(np.arange(200)[:, None] == 7, np.inf, points))
    with pytest.raises(HoleError, match="mode"):
        holes_from_cloud(points, mode="fast")
    with pytest.raises(HoleError, match="eps"):
        holes_from_cloud(cap_off(even_sphere(2000), [0, 0, 1], 0.5), eps=-1.0)
    with pytest.raises(HoleError, match="view directions"):
        holes_from_cloud(points, view_directions=points[:5])


def test_bad_meshes_are_refused_by_name() -> None:
    vertices, faces = sphere_mesh(100)
    with pytest.raises(HoleError, match="no triangles"):
        holes_from_mesh(vertices, np.zeros((0, 3), int))
    with pytest.raises(HoleError, match=r"within 0 \.\. 99"):
        holes_from_mesh(vertices, faces + 1)
    with pytest.raises(HoleError, match="degenerate"):
        holes_from_mesh(vertices, np.zeros((4, 3), int))
    with pytest.raises(HoleError, match="not finite"):
        holes_from_mesh(np.where(np.arange(100)[:, None] == 0, np.nan, vertices), faces)


def test_points_on_a_line_have_no_surface() -> None:
    report = holes_from_cloud(np.outer(np.linspace(0, 1, 100), [1.0, 2, 3]))
    assert report.holes == () and "line" in report.notes[0]


def test_two_points_many_times_are_refused() -> None:
    with pytest.raises(HoleError, match="2 distinct points"):
        holes_from_cloud(np.repeat([[0.0, 0, 0], [1.0, 0, 0]], 40, axis=0))


def test_deprecated_arguments_mean_the_papers_search() -> None:
    points = cap_off(even_sphere(2000), [0, 0, 1], 0.5)
    with pytest.deprecated_call():
        old = holes_from_cloud(points, mode="paper", eps=0.2)
    new = holes_from_cloud(points, by_angle=LargestAngle(eps=0.2))
    assert np.array_equal(old.boundary_mask, new.boundary_mask) and old.boundary_mask.any()
    with pytest.deprecated_call():
        old = holes_from_cloud(points, min_points=4)
    wide = LargestAngle(neighbours=30, threshold=np.pi / 2, min_points=4)
    new = holes_from_cloud(points, by_angle=wide)
    assert np.array_equal(old.boundary_mask, new.boundary_mask) and old.boundary_mask.any()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("by_angle", [None, LargestAngle()])
def test_an_exact_plane_has_its_edge_only(axis: int, by_angle: LargestAngle | None) -> None:
    """All heights equal to the last bit, normals along an axis: where Open3D's test finds nothing."""
    plane = np.roll(hex_plate(), axis - 2, axis=1)
    found = holes_from_cloud(plane, by_angle=by_angle).holes
    outer = max(found, key=lambda hole: hole.perimeter)
    assert outer.kind == "edge"
    assert np.allclose(outer.extent, [0.12, 0.12, 0], atol=2 * STEP)
    assert np.allclose(np.abs(outer.normal), np.eye(3)[axis], atol=1e-9)
    if by_angle is None:
        assert len(found) == 1 and outer.perimeter == pytest.approx(8 * 0.06, rel=0.1)


def test_copies_change_nothing_but_a_note() -> None:
    points = cap_off(even_sphere(4000), [0, 0, 1], 0.3)
    once, twice = holes_from_cloud(points), holes_from_cloud(np.concatenate([points, points]))
    assert np.allclose(once.holes[0].boundary, twice.holes[0].boundary)
    assert f"{len(points)} duplicate" in twice.notes[0]


def scored(shared_tools, truth, report, tmp_path) -> dict:
    """The score of the tool that cut the holes."""
    spec = importlib.util.spec_from_file_location("hole_cases", shared_tools / "hole_cases.py")
    assert spec and spec.loader
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    pred = tmp_path / "pred.json"
    pred.write_text(json.dumps(hole_report_to_json(report, "mm")))
    return tool.score(Namespace(truth=str(truth), pred=str(pred), tol=2.0, min_f1=0.5))


CASES = ("hammer_cloud", "nefertiti_cloud", "relief_cloud", "ugolino_cloud", "hermes_mesh", "nefertiti_mesh")


@pytest.mark.parametrize("name", CASES)
def test_cut_cases(name: str, shared_data, shared_tools, tmp_path) -> None:
    import open3d as o3d

    path = shared_data / "holes" / f"{name}.ply"
    if name.endswith("mesh"):
        mesh = o3d.io.read_triangle_mesh(str(path))
        report = holes_from_mesh(np.asarray(mesh.vertices) * 1e-3, np.asarray(mesh.triangles))
    else:
        report = holes_from_cloud(np.asarray(o3d.io.read_point_cloud(str(path)).points) * 1e-3)
    result = scored(shared_tools, path.with_suffix(".json"), report, tmp_path)
    assert result["hole_precision"] >= 0.95 and result["hole_recall"] >= 0.95
    assert result["point_precision"] >= 0.9 and result["point_recall"] >= 0.9
    assert result["false_on_decoys"] == 0


@pytest.mark.parametrize("name", ["hammer_cloud", "hermes_mesh"])
def test_the_command_writes_the_contract_in_the_files_units(
    name: str, shared_data, shared_tools, tmp_path
) -> None:
    from typer.testing import CliRunner

    from scanmotion.cli import app

    truth = shared_data / "holes" / f"{name}.json"
    out = tmp_path / "holes.json"
    result = CliRunner().invoke(app, ["holes", str(truth.with_suffix(".ply")), "--out", str(out), "--show"])
    assert result.exit_code == 0, result.output
    assert out.with_suffix(".png").read_bytes()[:4] == b"\x89PNG"
    written = json.loads(out.read_text())
    for hole in written["holes"]:
        assert set(hole) == {
            "boundary_points", "kind", "center", "normal", "extent", "perimeter", "area"
        }  # fmt: skip
        assert hole["kind"] in ("edge", "common", "interstitial", "island")
        loop = np.array(hole["boundary_points"])
        assert loop_length(loop) == pytest.approx(hole["perimeter"], rel=1e-6)
        assert np.linalg.norm(hole["normal"]) == pytest.approx(1)
        assert (np.abs(loop - hole["center"]).max(axis=0) <= max(hole["extent"])).all()
    spec = importlib.util.spec_from_file_location("hole_cases", shared_tools / "hole_cases.py")
    assert spec and spec.loader
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    score = tool.score(Namespace(truth=str(truth), pred=str(out), tol=2.0, min_f1=0.5))
    assert score["hole_precision"] == score["hole_recall"] == 1.0
    assert score["point_precision"] >= 0.9 and score["point_recall"] >= 0.9


FRESH = (
    ("hermes", 3.0, 0.1, "round:3:5-14 slit:2:3-5x20-40 interstitial:2:2.5-4x30-60"),
    ("hammer", 1.0, 0.15, "round:4:4-12 blob:2:5-10 slit:2:3-5x15-30"),
    ("nefertiti_bust", 3.0, 0.0, "round:4:4-12 blob:2:5-10 slit:2:3-5x15-30 interstitial:1:3-4x25-45"),
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [71, 72])
@pytest.mark.parametrize(("name", "spacing", "noise", "kinds"), FRESH)
def test_freshly_cut_cases(
    name: str, spacing: float, noise: float, kinds: str, seed: int, shared_data, shared_tools, tmp_path
) -> None:
    """Other objects, seeds, spacings and kinds than the stored cases, with four decoys each."""
    import open3d as o3d

    options = f"--mode cloud --spacing {spacing} --noise {noise} --decoys 4 --seed {seed} --holes {kinds}"
    prefix = tmp_path / "case"
    tool, source = str(shared_tools / "hole_cases.py"), str(shared_data / f"{name}.ply")
    command = [sys.executable, tool, "cut", source, str(prefix)]
    subprocess.run([*command, *options.split()], check=True, capture_output=True)
    report = holes_from_cloud(np.asarray(o3d.io.read_point_cloud(f"{prefix}.ply").points) * 1e-3)
    result = scored(shared_tools, prefix.with_suffix(".json"), report, tmp_path)
    assert result["hole_precision"] >= 0.95 and result["hole_recall"] >= 0.95
    assert result["point_precision"] >= 0.9 and result["point_recall"] >= 0.9
    assert result["false_on_decoys"] == 0


@pytest.mark.parametrize(("name", "count"), [("stanford_bunny", 5), ("lion_statue", 1), ("sea_vase", 6)])
def test_significant_loops_of_real_scans(name: str, count: int, shared_data) -> None:
    import open3d as o3d

    mesh = o3d.io.read_triangle_mesh(str(shared_data / f"{name}.ply"))
    report = holes_from_mesh(np.asarray(mesh.vertices) * 1e-3, np.asarray(mesh.triangles))
    truth = json.loads((shared_data / "gt" / f"{name}_loops.json").read_text())
    significant = sorted(loop["perimeter_mm"] for loop in truth["loops"] if loop["significant"])
    assert len(report.holes) == count
    assert np.allclose(sorted(1e3 * hole.perimeter for hole in report.holes), significant, atol=0.01)
    assert len(report.holes) + len(report.tiny) == truth["n_loops"]


def range_scans(folder, names) -> tuple[np.ndarray, np.ndarray]:
    """Merged range scans in the object's frame [m] and the directions to their sensors."""
    import open3d as o3d

    poses = json.loads((folder / "poses.json").read_text())["scans"]
    points, toward = [], []
    for name in names:
        X = np.array(poses[name]["T_object_scan"])
        own = np.asarray(o3d.io.read_point_cloud(str(folder / name)).points)
        points.append((own @ X[:3, :3].T + X[:3, 3]) * 1e-3)
        toward.append(np.tile(-np.array(poses[name]["nominal_view_direction"]), (len(own), 1)))
    return np.concatenate(points), np.concatenate(toward)


def test_range_scans_show_what_they_did_not_see(shared_data) -> None:
    """Four scans: each unseen patch lies in a hole. All ten: the five loops of the real object, no more."""
    folder = shared_data / "bunny_range_scans"
    truth = json.loads((folder / "coverage_gt.json").read_text())["subset_4"]
    points, toward = range_scans(folder, truth["scans"])
    holes = holes_from_cloud(points, view_directions=toward).holes
    for patch in truth["patches"]:
        centre, reach = 1e-3 * np.array(patch["centre"]), 0.5e-3 * patch["equiv_diameter_mm"]
        assert any(np.linalg.norm(hole.boundary - centre, axis=1).min() < reach + 0.012 for hole in holes)
    assert len(holes) <= len(truth["patches"]) + 1


@pytest.mark.slow
@pytest.mark.parametrize("turn", [[0.0, 0, 0], [0.4, -0.2, 0.7]])
def test_all_range_scans_leave_the_true_openings(turn: list[float], shared_data) -> None:
    """However the object lies: narrow sparse ground between two openings does not join them."""
    folder = shared_data / "bunny_range_scans"
    names = json.loads((folder / "poses.json").read_text())["scans"]
    R = Rotation.from_rotvec(turn).as_matrix()
    points, toward = range_scans(folder, names)
    holes = holes_from_cloud(points @ R.T, view_directions=toward @ R.T).holes
    truth = json.loads((shared_data / "gt" / "stanford_bunny_loops.json").read_text())
    real = [1e-3 * np.array(loop["centre"]) for loop in truth["loops"] if loop["significant"]]
    assert len(holes) == len(real) == 5
    for centre in real:
        assert min(np.linalg.norm(R.T @ hole.center - centre) for hole in holes) < 0.02
