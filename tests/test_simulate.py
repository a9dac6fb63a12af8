"""The scan twin against closed forms, and its noise against its settings."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.trajectory import Operation, Trajectory
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.sensing.simulator.captures import motion, true_poses, turned
from scanmotion.sensing.simulator.kernels import frame_rays, hull_rows, surely_lit
from scanmotion.sensing.simulator.range_frames import _spans
from scanmotion.sensing.simulator.simulate import (
    Captures,
    ScanErrors,
    captures_from_trajectory,
    simulate,
    still_captures,
)
from scanmotion.sensing.visibility import scene_from, sees

SCANNER = Scanner(rays=(106, 74))
ONE_EYE = replace(SCANNER, baseline=0.0)
AHEAD = np.eye(4)[None]
"""The scanner in the origin, looking along +z."""


def plate(z, half, *, centre=(0.0, 0.0), normal=-1.0):
    """A square at height z that faces -z, towards the scanner of AHEAD."""
    x, y = centre
    corners = np.array(
        [[x - half, y - half, z], [x + half, y - half, z], [x + half, y + half, z], [x - half, y + half, z]]
    )
    triangles = np.array([[0, 2, 1], [0, 3, 2]]) if normal < 0 else np.array([[0, 1, 2], [0, 2, 3]])
    return corners, triangles


def joined(*meshes):
    vertices, triangles, first = [], [], 0
    for v, t in meshes:
        vertices.append(v)
        triangles.append(t + first)
        first += len(v)
    return np.concatenate(vertices), np.concatenate(triangles)


def sphere(radius, centre, rings=160):
    theta = np.linspace(0, np.pi, rings + 1)[1:-1]
    phi = 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    T, P = np.meshgrid(theta, phi, indexing="ij")
    body = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=-1).reshape(-1, 3)
    vertices = np.vstack([body, [[0, 0, 1], [0, 0, -1]]]) * radius + centre
    w, top, bottom = len(phi), len(body), len(body) + 1
    i, j = np.meshgrid(np.arange(len(theta) - 1), np.arange(w), indexing="ij")
    a, b = (i * w + j).ravel(), (i * w + (j + 1) % w).ravel()
    c, d = a + w, b + w
    k = np.arange(w)
    last = (len(theta) - 1) * w
    caps = [
        np.column_stack([np.full(w, top), k, (k + 1) % w]),
        np.column_stack([np.full(w, bottom), last + (k + 1) % w, last + k]),
    ]
    return vertices, np.vstack([np.column_stack([a, c, b]), np.column_stack([b, c, d]), *caps])


def pixels(scanner):
    """x / z and y / z of every pixel, shape (rows * columns, 2)."""
    w, h = scanner.rays
    x = np.tan(scanner.fov[0] / 2) * ((2 * np.arange(w) + 1) / w - 1)
    y = np.tan(scanner.fov[1] / 2) * ((2 * np.arange(h) + 1) / h - 1)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def measured(mesh, scanner, X_OS=AHEAD, *, stride=1, errors=None, seed=0, **keywords):
    scene = scene_from(*mesh)
    rng = np.random.default_rng(seed)
    return simulate(
        scene,
        scanner,
        still_captures(X_OS),
        errors=errors or ScanErrors.none(),
        stride=stride,
        rng=rng,
        **keywords,
    )


def mask(scan, scanner):
    out = np.zeros(scanner.rays[0] * scanner.rays[1], bool)
    out[scan.pixel] = True
    return out


@pytest.mark.parametrize("depth", [0.41, 0.7, 0.99])
def test_plane_is_measured_over_the_whole_field(depth):
    scan = measured(plate(depth, 1.0), ONE_EYE)
    assert len(scan) == 106 * 74
    np.testing.assert_allclose(scan.depth, depth, atol=1e-6)
    length, width = SCANNER.field(depth)
    got = np.ptp(scan.points_O, axis=0)
    np.testing.assert_allclose(got[:2], [length * 105 / 106, width * 73 / 74], rtol=1e-5)


@pytest.mark.parametrize("depth", [0.395, 1.005])
def test_nothing_is_measured_out_of_range(depth):
    assert len(measured(plate(depth, 1.0), SCANNER)) == 0


def test_a_back_side_is_not_measured():
    assert len(measured(plate(0.7, 1.0, normal=1.0), SCANNER)) == 0


def test_visible_cap_of_a_sphere():
    radius, distance = 0.12, 0.62
    scan = measured(sphere(radius, (0.0, 0.0, distance)), ONE_EYE)
    d = np.column_stack([pixels(ONE_EYE), np.ones(106 * 74)])
    b, c = d @ [0, 0, distance], distance**2 - radius**2
    a = (d * d).sum(axis=1)
    root = b * b - a * c
    z = (b - np.sqrt(np.maximum(root, 0))) / a
    normal = (z[:, None] * d - [0, 0, distance]) / radius
    cosine = -(d * normal).sum(axis=1) / np.sqrt(a)
    expected = (root > 0) & (cosine >= np.cos(ONE_EYE.max_incidence))
    clear = np.abs(cosine - np.cos(ONE_EYE.max_incidence)) > 0.02
    clear |= root <= 0
    np.testing.assert_array_equal(mask(scan, ONE_EYE)[clear], expected[clear])
    assert expected.sum() > 500
    np.testing.assert_allclose(np.linalg.norm(scan.points_O - [0, 0, distance], axis=1), radius, atol=3e-5)


def test_two_eyes_see_less_of_a_sphere_by_the_projectors_incidence():
    radius, centre = 0.12, np.array([0.0, 0.0, 0.62])
    scan = measured(sphere(radius, centre), SCANNER)
    normal = (scan.points_O - centre) / radius
    for eye in (np.zeros(3), np.array([SCANNER.baseline, 0, 0])):
        line = eye - scan.points_O
        cosine = (line * normal).sum(axis=1) / np.linalg.norm(line, axis=1)
        assert cosine.min() >= np.cos(SCANNER.max_incidence) - 0.01
    one = measured(sphere(radius, centre), ONE_EYE)
    assert set(scan.pixel) < set(one.pixel)


@pytest.mark.parametrize("tilt", [55.0, 63.0, 68.0])
def test_incidence_limit_on_a_tilted_plane(tilt):
    a = np.deg2rad(tilt)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    v, t = plate(0.0, 0.5)
    scan = measured((v @ R.T + [0, 0, 0.7], t), ONE_EYE)
    normal = R @ [0, 0, -1]
    d = np.column_stack([pixels(ONE_EYE), np.ones(106 * 74)])
    cosine = -(d @ normal) / np.linalg.norm(d, axis=1)
    z = normal @ [0, 0, 0.7] / (d @ normal)
    expected = (cosine >= np.cos(ONE_EYE.max_incidence)) & (z >= 0.4) & (z <= 1.0)
    clear = np.abs(cosine - np.cos(ONE_EYE.max_incidence)) > 1e-4
    np.testing.assert_array_equal(mask(scan, ONE_EYE)[clear], expected[clear])
    assert 0 < expected.sum()


def test_shadow_of_a_block_falls_where_the_projector_is_hidden():
    far, near, half = 0.9, 0.6, 0.04
    scan = measured(joined(plate(far, 1.0), plate(near, half), plate(near, half, normal=1.0)), SCANNER)
    p = pixels(SCANNER) * far
    camera = np.abs(p * near / far).max(axis=1)
    lit = np.array([SCANNER.baseline, 0.0]) * (1 - near / far) + p * near / far
    projector = np.abs(lit).max(axis=1)
    open_ = (camera > half) & (projector > half)
    block = np.abs(pixels(SCANNER) * near).max(axis=1) < half
    clear = (np.abs(camera - half) > 1e-4) & (np.abs(projector - half) > 1e-4)
    np.testing.assert_array_equal(mask(scan, SCANNER)[clear], (open_ | block)[clear])
    assert (~open_ & ~block).sum() > 100


def test_table_hides_what_lies_under_it():
    v, t = plate(0.2, 0.05)
    part = v - [0, 0, 0.3], t
    X_OS = look_at((0.0, 0.0, 0.6), (0.0, 0.0, -1.0))[None]
    rng = np.random.default_rng(0)
    up = part[0], part[1][:, ::-1]
    bare, table = scene_from(*up), scene_from(*up, table_radius=0.5)
    assert len(simulate(bare, SCANNER, still_captures(X_OS), rng=rng)) > 0
    assert len(simulate(table, SCANNER, still_captures(X_OS), rng=rng)) == 0


def test_table_itself_is_not_measured():
    v, t = sphere(0.05, (0.0, 0.0, 0.05), rings=40)
    scene = scene_from(v, t, table_radius=0.5)
    X_OS = look_at((0.5, 0.0, 0.4), (-0.8, 0.0, -0.6))[None]
    scan = simulate(scene, SCANNER, still_captures(X_OS), rng=np.random.default_rng(0), stride=1)
    assert np.abs(np.linalg.norm(scan.points_O - [0, 0, 0.05], axis=1) - 0.05).max() < 2e-3


@pytest.mark.parametrize("stride", [2, 3])
def test_the_phases_of_a_stride_use_every_pixel_once(stride):
    mesh = sphere(0.1, (0.0, 0.0, 0.6), rings=60)
    full = measured(mesh, SCANNER)
    parts = measured(mesh, SCANNER, np.tile(AHEAD, (stride**2, 1, 1)), stride=stride)
    np.testing.assert_array_equal(np.sort(parts.pixel), full.pixel)
    order = np.argsort(parts.pixel)
    np.testing.assert_allclose(parts.depth[order], full.depth, atol=1e-7)


def test_rays_past_the_hull_are_rightly_left_out():
    mesh = sphere(0.1, (0.03, -0.02, 0.6), rings=30)
    with_hull = measured(mesh, SCANNER)
    scene = replace(scene_from(*mesh), outline=None)
    without = simulate(
        scene,
        SCANNER,
        still_captures(AHEAD),
        errors=ScanErrors.none(),
        stride=1,
        rng=np.random.default_rng(0),
    )
    np.testing.assert_array_equal(with_hull.pixel, without.pixel)
    np.testing.assert_array_equal(with_hull.points_O, without.points_O)


@given(st.integers(0, 10_000), st.integers(2, 30))
@settings(max_examples=50)
def test_hull_rows_hold_every_point_and_no_more_than_the_hull(seed, n):
    rng = np.random.default_rng(seed)
    p = np.round(rng.uniform(-1, 1, (n, 2)), 1 if seed % 2 else 6)
    rows = np.concatenate([p[:, 1], rng.uniform(-1.2, 1.2, 20)])
    low, high = hull_rows(p, rows)
    assert (low[:n] <= p[:, 0] + 1e-12).all() and (high[:n] >= p[:, 0] - 1e-12).all()
    for y, a, b in zip(rows[n:], low[n:], high[n:], strict=True):
        # The hull's slice lies between the extreme crossings of all chords.
        up, down = p[p[:, 1] >= y], p[p[:, 1] <= y]
        if len(up) == 0 or len(down) == 0:
            assert a > b
            continue
        s = (y - down[None, :, 1]) / np.maximum(up[:, None, 1] - down[None, :, 1], 1e-30)
        x = down[None, :, 0] + np.clip(s, 0, 1) * (up[:, None, 0] - down[None, :, 0])
        np.testing.assert_allclose([a, b], [x.min(), x.max()], atol=1e-9)


@pytest.mark.parametrize("depth", [0.4, 0.7, 0.95])
def test_range_noise_has_the_stated_moments(depth):
    errors = replace(ScanErrors.none(), range_noise=1.0)
    scan = measured(plate(depth + 1e-4, 1.0), ONE_EYE, np.tile(AHEAD, (10, 1, 1)), errors=errors)
    d = np.column_stack([pixels(ONE_EYE), np.ones(106 * 74)])[scan.pixel]
    along = (scan.depth - depth - 1e-4) * np.linalg.norm(d, axis=1)
    expected = 0.05e-3 * (depth / 0.4) ** 2 * np.linalg.norm(d, axis=1)
    z = along / expected
    assert abs(z.mean()) < 4 / np.sqrt(len(z))
    assert z.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(z)) + 1e-3)
    assert (z**4).mean() == pytest.approx(3.0, abs=0.15)


def test_noise_stops_growing_below_cosine_three_tenths():
    a = np.deg2rad(80.0)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    v, t = plate(0.0, 0.02)
    wide = replace(ONE_EYE, max_incidence=np.deg2rad(88.0))
    X = np.tile(AHEAD, (400, 1, 1))
    noise = measured((v @ R.T + [0, 0, 0.7], t), wide, X, errors=replace(ScanErrors.none(), range_noise=1.0))
    clean = measured((v @ R.T + [0, 0, 0.7], t), wide, X)
    np.testing.assert_array_equal(noise.pixel, clean.pixel)
    z = (noise.depth - clean.depth) / (0.05e-3 * (clean.depth / 0.4) ** 2 / 0.3)
    assert z.std() == pytest.approx(1.0, abs=5 / np.sqrt(2 * len(z)) + 0.01)


def test_frame_scale_and_pose_noise_have_the_stated_moments():
    few = replace(ONE_EYE, rays=(8, 8))
    X = np.tile(AHEAD, (3000, 1, 1))
    scaled = measured(plate(0.7, 1.0), few, X, errors=replace(ScanErrors.none(), frame_scale=1.0))
    s = np.array([scaled.depth[scaled.frame == k].mean() for k in range(0, 3000, 5)]) / 0.7 - 1
    assert np.ptp(scaled.depth[scaled.frame == 0]) < 1e-6
    assert s.std() == pytest.approx(1.5e-4, rel=0.12)
    poses = true_poses(still_captures(X), ScanErrors(), np.random.default_rng(0))
    assert poses[:, :3, 3].std(axis=0) == pytest.approx(np.full(3, 0.02e-3), rel=0.06)
    turns = np.stack([poses[:, 2, 1], poses[:, 0, 2], poses[:, 1, 0]], axis=1)
    assert turns.std(axis=0) == pytest.approx(np.full(3, np.deg2rad(0.003)), rel=0.06)


def test_a_constant_hand_eye_error_moves_all_points_against_it():
    errors = replace(ScanErrors.none(), hand_eye_m=(0.0, 0.0, 1e-3))
    scan = measured(plate(0.7, 1.0), ONE_EYE, errors=errors)
    np.testing.assert_allclose(scan.points_O[:, 2], 0.7 - 1e-3, atol=1e-6)


def test_table_errors_displace_the_object_as_their_definition_says():
    angle = np.array([0.3, -0.4, 1.0])
    captures = Captures(
        t=np.arange(3.0), X_WS=np.tile(np.eye(4), (3, 1, 1)), table_angle=angle,
        X_WT=np.eye(4), X_TO=np.eye(4), table_sense=np.array([1.0, -1.0, 0.0]),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    play = true_poses(captures, replace(ScanErrors.none(), backlash_rad=0.02), rng)
    np.testing.assert_allclose(play, np.linalg.inv(turned(angle - [0.01, -0.01, 0.0])), atol=1e-12)
    shifted = true_poses(
        captures, replace(ScanErrors.none(), axis_m=(0.002, -0.001), axis_rad=(0.01, 0.0)), rng
    )
    axis = motion(np.array([[0.002, -0.001, 0.0, 0.01, 0.0, 0.0]]))
    np.testing.assert_allclose(shifted, np.linalg.inv(axis @ turned(angle)), atol=1e-12)


def test_the_same_seed_gives_the_same_scan_and_triangles_may_be_shuffled():
    v, t = sphere(0.1, (0.0, 0.0, 0.6), rings=40)
    X = np.tile(AHEAD, (3, 1, 1))
    a = measured((v, t), SCANNER, X, errors=ScanErrors(), seed=5)
    b = measured((v, t), SCANNER, X, errors=ScanErrors(), seed=5)
    for name in ("points_O", "frame", "pixel", "depth"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    c = measured(
        (v, t[np.random.default_rng(1).permutation(len(t))]), SCANNER, X, errors=ScanErrors(), seed=5
    )
    np.testing.assert_array_equal(a.pixel, c.pixel)
    np.testing.assert_allclose(a.points_O, c.points_O, atol=1e-6)
    d = measured((v, t), SCANNER, X, errors=ScanErrors(), seed=6)
    assert len(d) != len(a) or not np.allclose(d.points_O, a.points_O, atol=1e-7)


def test_a_scan_does_not_depend_on_where_the_world_stands():
    v, t = sphere(0.1, (0.0, 0.0, 0.1), rings=40)
    X_OS = look_at((0.6, 0.0, 0.2), (-1.0, 0.0, 0.0))
    scene = scene_from(v, t)
    still = simulate(
        scene, SCANNER, still_captures(X_OS[None]), errors=ScanErrors.none(), rng=np.random.default_rng(0)
    )
    X_WT, X_TO = motion(np.array([[2.0, 0.5, 0.7, 0, 0, 0.4], [0, 0, 0.3, 0, 0, 0]]))
    X_WO = X_WT @ turned(np.array([0.8]))[0] @ X_TO
    moved = Captures(
        t=np.zeros(1), X_WS=(X_WO @ X_OS)[None], table_angle=np.array([0.8]), X_WT=X_WT, X_TO=X_TO
    )
    np.testing.assert_allclose(moved.X_OS[0], X_OS, atol=1e-12)
    other = simulate(scene, SCANNER, moved, errors=ScanErrors.none(), rng=np.random.default_rng(0))
    np.testing.assert_allclose(other.points_O, still.points_O, atol=1e-6)


def test_seen_is_the_visibility_of_each_sample_from_the_true_poses():
    v, t = sphere(0.1, (0.0, 0.0, 0.1), rings=40)
    part = Part(name="sphere", vertices=v, triangles=t)
    samples = surface_samples(part, 2000, rng=np.random.default_rng(0))
    scene = scene_from(v, t, table_radius=0.5)
    X = np.stack(
        [look_at((0.6 * np.cos(a), 0.6 * np.sin(a), 0.2), (-np.cos(a), -np.sin(a), -0.2)) for a in range(5)]
    )
    scan = simulate(scene, SCANNER, still_captures(X), samples=samples, rng=np.random.default_rng(3))
    true = true_poses(still_captures(X), ScanErrors(), np.random.default_rng(3))
    expected = sees(scene, SCANNER, true, samples.points, samples.normals).any(axis=0)
    np.testing.assert_array_equal(scan.seen, expected)
    assert 0.3 < expected.mean() < 0.95
    known = np.random.default_rng(4).random(2000) < 0.5
    again = simulate(
        scene, SCANNER, still_captures(X), samples=samples, known=known, rng=np.random.default_rng(3)
    )
    np.testing.assert_array_equal(again.seen, expected | known)
    np.testing.assert_array_equal(again.points_O, scan.points_O)


def test_range_image_and_view_directions():
    scan = measured(plate(0.7, 1.0), ONE_EYE, np.tile(AHEAD, (2, 1, 1)), stride=2)
    image = scan.range_image(1, ONE_EYE)
    assert image.shape == (74, 106)
    assert np.isfinite(image).sum() == 37 * 53 and np.nanmax(np.abs(image - 0.7)) < 1e-6
    expected = -scan.points_O / np.linalg.norm(scan.points_O, axis=1, keepdims=True)
    np.testing.assert_allclose(scan.view_directions, expected, atol=1e-6)


def test_no_captures_give_an_empty_scan():
    scan = measured(plate(0.7, 1.0), ONE_EYE, np.zeros((0, 4, 4)))
    assert len(scan) == 0 and scan.points_O.shape == (0, 3)


def trajectory(kinds=("transit", "revolution", "dwell")):
    t = np.arange(0, 3.0 + 1e-9, 0.01)
    q, qd = np.zeros((len(t), 7)), np.zeros((len(t), 7))
    q[:, 0], qd[:, 0] = np.sin(t), np.cos(t)
    turning = (t > 1.0) & (t <= 2.0)
    q[:, 6] = np.where(t <= 1, 0, np.where(turning, -((t - 1) ** 2) * (5 - 2 * t), -1.0))
    qd[turning, 6] = np.gradient(q[:, 6], t)[turning]
    operations = tuple(
        Operation(
            index=i, kind=k, viewpoints=("G0",), t_start=float(i), t_end=float(i + 1), q_start=q[100 * i],
            q_end=q[100 * i + 100],
        )
        for i, k in enumerate(kinds)
    )  # fmt: skip
    return Trajectory(t=t, q=q, qd=qd, qdd=qd, operation=np.minimum(t.astype(int), 2), operations=operations)


def poses_of(q):
    X = np.tile(np.eye(4), (len(q), 1, 1))
    X[:, 0, 3] = q[:, 0]
    return X


def test_frames_are_taken_while_operations_scan():
    c = captures_from_trajectory(trajectory(), poses_of, fps=10, X_WT=np.eye(4), X_TO=np.eye(4))
    np.testing.assert_allclose(
        c.t, np.concatenate([np.arange(11) / 10 + 1, np.arange(11) / 10 + 2]), atol=1e-12
    )
    np.testing.assert_allclose(c.X_WS[:, 0, 3], np.sin(c.t), atol=1e-8)
    assert (c.table_sense[2:] == -1).all()
    none = captures_from_trajectory(
        trajectory(("transit",) * 3), poses_of, fps=10, X_WT=np.eye(4), X_TO=np.eye(4)
    )
    assert len(none) == 0
    with pytest.raises(InputError):
        captures_from_trajectory(trajectory(), poses_of, fps=0, X_WT=np.eye(4), X_TO=np.eye(4))


def test_ways_that_need_no_shadow_ray_are_lit(lump):
    """Against shadow rays for every hit: what is sure is lit, and most of what is lit is sure."""
    scanner = replace(SCANNER, rays=(212, 148))
    scene = scene_from(lump.vertices, lump.triangles)
    lit_count = sure_count = wrong = 0
    for angle in np.linspace(0, 2 * np.pi, 9):
        for height in (0.05, 0.5):
            p = np.array([0.5 * np.cos(angle), 0.5 * np.sin(angle), height])
            X = look_at(p, np.array([0, 0, 0.1]) - p)
            pairs = zip(scanner.fov, scanner.rays, strict=True)
            columns, rows = (np.tan(f / 2) * np.linspace(-1, 1, n) for f, n in pairs)
            low, high = _spans(X, rows, scene.outline)
            rays, column, row = frame_rays(X, columns, rows, low, high)
            depth = scene.raycaster.cast_rays(rays)["t_hit"].numpy()
            hit = np.isfinite(depth)
            nearest = ((scene.outline - X[:3, 3]) @ X[:3, 2]).min()
            eye = X[:3, 3] + scanner.baseline * X[:3, 0]
            way = rays[:, :3] + np.where(hit, depth, 1.0)[:, None] * rays[:, 3:] - eye
            shadow = np.hstack([np.tile(eye, (len(way), 1)), way]).astype(np.float32)
            lit = hit & ~scene.raycaster.test_occlusions(shadow, tnear=0.0, tfar=1 - 3e-4).numpy()
            sure = surely_lit(depth, column, row, columns, high, nearest, scanner.baseline)
            lit_count, sure_count, wrong = (
                lit_count + lit.sum(),
                sure_count + sure.sum(),
                wrong + (sure & ~lit).sum(),
            )
    assert wrong <= 1e-4 * lit_count
    assert sure_count > 0.7 * lit_count


def test_what_leaves_the_field_is_taken_to_stand_at_its_least_depth():
    mesh = plate(0.7, 1.0)
    X = np.eye(4)
    columns, rows = np.linspace(-0.2, 0.2, 31), np.linspace(-0.2, 0.2, 21)
    low, high = _spans(X, rows, mesh[0])
    rays, column, row = frame_rays(X, columns, rows, low, high)
    depth = scene_from(*mesh).raycaster.cast_rays(rays)["t_hit"].numpy()
    level = surely_lit(depth, column, row, columns, high, 0.7, 0.15)
    assert level[column < 30].all()
    # A thing at 0.4 m past the last column shades x where 1 / 0.7 - x / b < 1 / 0.4 - 0.2 / b.
    shaded = columns[column] > 0.2 - 0.15 * (1 / 0.4 - 1 / 0.7)
    near = surely_lit(depth, column, row, columns, high, 0.4, 0.15)
    assert not near[shaded].any()
    assert near[columns[column] < 0.03].all()
    assert surely_lit(depth, column, row, columns, np.full(21, 0.2), 0.4, 0.15).all()
