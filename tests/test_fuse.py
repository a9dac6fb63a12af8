"""Fusion, registration, calibration and files of scans: invariances, known answers, planted faults."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from scanmotion.errors import InputError, PartError
from scanmotion.part import Part
from scanmotion.partfile import read_geometry
from scanmotion.scan.assess import accuracy
from scanmotion.scan.calibrate import PARAMETERS, calibrate, corrected, errors_from
from scanmotion.scan.captures import Captures, inverse, motion, turned
from scanmotion.scan.files import (
    fuse_files,
    fuse_folder,
    fuse_measured,
    load_scan,
    save_cloud,
    save_scan,
    scans_from_poses,
)
from scanmotion.scan.fuse import Cloud, RawPoints, fuse, fuse_points
from scanmotion.scan.register import align, register, transformed
from scanmotion.scan.simulate import ScanErrors, simulate, still_captures
from scanmotion.scan.surface import deviation_mesh, surface
from scanmotion.scanner import Scanner
from scanmotion.viewpoints.coverage import revolution_poses, scene_from
from scanmotion.viewpoints.viewpoint import look_at

SCANNER = Scanner(rays=(212, 148))


def raw(points, *, camera=(0.0, 0.0, 0.7), sigma=1e-4, frames=1):
    n = len(points)
    return RawPoints(
        points=np.asarray(points, np.float32), frame=(np.arange(n) % frames).astype(np.int32),
        cameras=np.tile(np.asarray(camera, float), (frames, 1)), sigma=np.full(n, sigma, np.float32),
    )  # fmt: skip


def cap(radius, n, rng, *, noise=1e-4):
    """Points on the upper cap of a sphere about the origin."""
    u = rng.standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    u = u[u[:, 2] > 0.5]
    return u * (radius + noise * rng.standard_normal((len(u), 1)))


def bumpy(rings=90, *, size=0.1):
    """A closed lump without symmetry, its base at z = 0."""
    theta = np.linspace(0, np.pi, rings + 1)
    phi = 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    T, P = np.meshgrid(theta, phi, indexing="ij")
    u = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=-1)
    r = (
        1
        + 0.15 * np.sin(3 * u[..., 0] + 1) * np.cos(4 * u[..., 1])
        + 0.12 * np.sin(5 * u[..., 2] + 2 * u[..., 0])
    )
    vertices = (u * r[..., None] * size).reshape(-1, 3)
    w = len(phi)
    i, j = (m.ravel() for m in np.meshgrid(np.arange(rings), np.arange(w), indexing="ij"))
    a, b = i * w + j, i * w + (j + 1) % w
    triangles = np.concatenate(
        [np.column_stack([a, a + w, b])[i > 0], np.column_stack([b, a + w, b + w])[i < rings - 1]]
    )
    # The poles are many vertices at one place; one of each is kept.
    triangles[triangles < w] = 0
    triangles[triangles >= rings * w] = rings * w
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = vertices[used] - [0, 0, vertices[:, 2].min()]
    return Part(name="lump", vertices=vertices, triangles=triangles.reshape(-1, 3))


@pytest.fixture(scope="module")
def lump():
    return bumpy()


def turns(part, errors, *, seed=0, n=45):
    """Three turns of the table: level, from above, and level with the scanner rolled."""
    poses = [
        look_at((0.55, 0, 0.1), (-1, 0, 0)),
        look_at((0.4, 0, 0.45), (-1, 0, -0.9)),
        look_at((0.6, 0, 0.2), (-1, 0, -0.2), roll=np.pi / 2),
    ]
    angle = [s * 2 * np.pi * np.arange(n) / n for s in (1, -1, 1)]
    sense = np.repeat([1.0, -1.0, 1.0], n)
    captures = Captures(
        t=np.arange(3 * n) / 10, X_WS=np.repeat(poses, n, axis=0), table_angle=np.concatenate(angle),
        X_WT=np.eye(4), X_TO=np.eye(4), table_sense=sense,
    )  # fmt: skip
    scene = scene_from(part.vertices, part.triangles, table_radius=0.5)
    return simulate(scene, SCANNER, captures, errors=errors, stride=1, rng=np.random.default_rng(seed))


@pytest.fixture(scope="module")
def clean_scan(lump):
    return turns(lump, ScanErrors())


@pytest.fixture(scope="module")
def lump_cloud(clean_scan):
    return fuse([clean_scan])


def test_a_noisy_plane_is_averaged(rng):
    n, sigma, voxel = 100_000, 1e-4, 0.002
    p = np.column_stack([rng.uniform(-0.05, 0.05, (n, 2)), sigma * rng.standard_normal(n) + 0.001])
    cloud = fuse_points(raw(p, sigma=sigma))
    assert len(cloud) == 2500
    assert cloud.counts.sum() == n
    # A quadric under weights (1 - t)^2, t = (r / radius)^2 uniform on a disc of N points: the constant's
    # kernel is K = (1 - t)^2 (8 - 20 t), which has mean 1 and is blind to t, and the variance is
    # sigma^2 / N * mean of K^2 = 64/5 - 320/30 + 400 * 48/5040 of it.
    within = n / 0.1**2 * np.pi * voxel**2
    sd = sigma * np.sqrt((64 / 5 - 320 / 30 + 400 * 48 / 5040) / within)
    inner = (np.abs(cloud.points[:, :2]) < 0.05 - voxel).all(axis=1)
    height = cloud.points[inner, 2] - 0.001
    # Tukey's weights cost up to 5% of the precision; neighbours share points: some 700 are independent.
    assert height.std() == pytest.approx(1.02 * sd, rel=0.06)
    assert abs(height.mean()) < 3 * sigma / np.sqrt(n)
    # The slope by the same weights: mean of (w u)^2 over the square of the mean of w u^2 is 576 / 60.
    slope = cloud.normals[inner, :2] / cloud.normals[inner, 2:]
    assert slope.std() == pytest.approx(1.02 * sigma / voxel * np.sqrt(9.6 / within), rel=0.06)
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-9)


def test_curvature_does_not_draw_the_cloud_inwards(rng):
    p = cap(0.012, 60_000, rng)
    cloud = fuse_points(raw(p, camera=(0, 0, 10.0)))
    inner = cloud.points[cloud.points[:, 2] > 0.65 * 0.012]
    d = np.linalg.norm(inner, axis=1) - 0.012
    assert abs(d.mean()) < 1.0e-5
    # A plain mean over a disc of radius voxel / sqrt(pi) lies voxel^2 / (4 pi R) inside.
    assert abs(d.mean()) < 0.4 * 0.002**2 / (4 * np.pi * 0.012)
    np.testing.assert_allclose(
        cloud.normals, cloud.points / np.linalg.norm(cloud.points, axis=1)[:, None], atol=0.15
    )


@given(st.integers(0, 1000))
@settings(max_examples=8)
def test_the_order_of_the_points_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    p = cap(0.02, 4000, rng)
    order = rng.permutation(len(p))
    a, b = fuse_points(raw(p)), fuse_points(raw(p[order]))
    np.testing.assert_allclose(a.points, b.points, atol=1e-9)
    np.testing.assert_allclose(a.normals, b.normals, atol=1e-6)
    np.testing.assert_array_equal(a.counts, b.counts)


def test_moving_by_whole_voxels_moves_the_cloud(rng):
    p = cap(0.02, 8000, rng)
    step = np.array([16, -8, 64]) * 0.002
    a = fuse_points(raw(p))
    b = fuse_points(raw(p + step, camera=np.array([0, 0, 0.7]) + step))
    assert abs(len(a) - len(b)) <= 5
    d = np.linalg.norm((a.points + step)[:, None] - b.points[None], axis=2).min(axis=1)
    assert np.median(d) < 1e-8


def test_every_point_twice_gives_the_same_cloud_with_double_counts(rng):
    p = cap(0.02, 24_000, rng)
    a, b = fuse_points(raw(p)), fuse_points(raw(np.concatenate([p, p])))
    np.testing.assert_array_equal(2 * a.counts, b.counts)
    # Where twelve points lie about a voxel once, both fit the same quadric; fewer, and only one of them does.
    enough = np.array([len(k) for k in cKDTree(p).query_ball_point(a.points, 0.0018)]) >= 12
    assert enough.mean() > 0.97
    np.testing.assert_allclose(a.points[enough], b.points[enough], atol=1e-9)
    np.testing.assert_allclose(a.normals[enough], b.normals[enough], atol=1e-6)


def test_two_scans_fuse_as_one(clean_scan):
    half = len(clean_scan.captures) // 2
    cut = int(np.searchsorted(clean_scan.frame, half))
    c = clean_scan.captures

    def piece(points, frames, first):
        captures = replace(
            c, t=c.t[frames], X_WS=c.X_WS[frames], table_angle=c.table_angle[frames], table_sense=None
        )
        return replace(
            clean_scan, points_O=clean_scan.points_O[points], frame=clean_scan.frame[points] - first,
            depth=clean_scan.depth[points], pixel=clean_scan.pixel[points], captures=captures,
        )  # fmt: skip

    a = piece(slice(0, cut), slice(0, half), 0)
    b = piece(slice(cut, None), slice(half, None), half)
    one, two = fuse([clean_scan]), fuse([a, b])
    np.testing.assert_array_equal(one.points, two.points)
    np.testing.assert_array_equal(one.normals, two.normals)


def test_outliers_do_not_bend_the_surface(rng):
    n = 40_000
    p = np.column_stack([rng.uniform(-0.03, 0.03, (n, 2)), 1e-4 * rng.standard_normal(n)])
    bad = rng.random(n) < 0.03
    p[bad, 2] += 0.0015
    clean = np.abs(fuse_points(raw(p[~bad])).points[:, 2])
    cloud = fuse_points(raw(p))
    near = np.abs(cloud.points[:, 2]) < 0.0005
    assert near.sum() > 890
    assert np.abs(cloud.points[near, 2]).mean() < 1.5 * clean.mean()


def test_a_flying_pixel_is_dropped_and_a_sparse_patch_is_kept(rng):
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(12)), axis=-1).reshape(-1, 2) * 0.0033
    patch = np.column_stack([grid, np.full(144, 0.0005)])
    flying = np.array([[0.1, 0.1, 0.3], [-0.2, 0.1, 0.2]])
    cloud = fuse_points(raw(np.vstack([patch, flying])))
    assert len(cloud) == 144
    assert (cloud.normals[:, 2] > 0.99).all()


def test_both_sides_of_a_thin_wall_are_kept_apart(rng):
    n, wall = 30_000, 0.0015
    xy = rng.uniform(-0.03, 0.03, (2 * n, 2))
    z = 1e-4 * rng.standard_normal(2 * n) + np.repeat([0.0007, 0.0007 - wall], n)
    two = RawPoints(
        points=np.column_stack([xy, z]).astype(np.float32), frame=np.repeat([0, 1], n).astype(np.int32),
        cameras=np.array([[0, 0, 0.7], [0, 0, -0.7]]), sigma=np.full(2 * n, 1e-4, np.float32),
    )  # fmt: skip
    cloud = fuse_points(two)
    up = cloud.normals[:, 2] > 0
    assert np.abs(cloud.points[up, 2] - 0.0007).max() < 2e-4
    assert np.abs(cloud.points[~up, 2] - 0.0007 + wall).max() < 2e-4
    assert up.sum() > 850 and (~up).sum() > 850


def test_fused_twin_meets_the_accuracy_it_is_asked_for(lump, lump_cloud):
    a = accuracy(lump_cloud.points, lump)
    assert a.mean_abs < 0.10e-3
    assert a.sd_signed < 0.12e-3
    assert abs(a.mean_signed) < 0.02e-3


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, 1e-12])
def test_a_senseless_voxel_is_refused(bad):
    with pytest.raises(InputError, match="voxel"):
        fuse_points(raw(np.eye(3)), voxel=bad)


def test_nothing_to_fuse_is_an_error():
    with pytest.raises(InputError):
        fuse([])
    with pytest.raises(InputError):
        fuse_points(raw(np.zeros((0, 3))))


def wrong(degrees, millimetres, seed):
    rng = np.random.default_rng(seed)
    u, v = rng.standard_normal((2, 3))
    twist = [*(v / np.linalg.norm(v) * millimetres * 1e-3), *(u / np.linalg.norm(u) * np.deg2rad(degrees))]
    return motion(np.array([twist]))[0]


@pytest.mark.parametrize("seed", range(3))
def test_registration_undoes_a_known_motion(lump_cloud, seed):
    X = wrong(1.0, 2.0, seed)
    moved = transformed(lump_cloud, X)
    found = register(moved, lump_cloud)
    residual = transformed(moved, found.X).points - lump_cloud.points
    assert np.abs(residual).max() < 2e-6
    assert found.trusted and found.fitness > 0.95
    assert found.turn == pytest.approx(np.deg2rad(1.0), rel=1e-3)


def test_registration_of_independent_scans_of_a_part(lump, lump_cloud):
    other = fuse([turns(lump, ScanErrors(), seed=7, n=20)])
    local = other.points[:, 0] > 0.0
    piece = Cloud(**{k: getattr(other, k)[local] for k in ("points", "normals", "view_directions", "counts")})
    found = register(transformed(piece, wrong(1.0, 2.0, 3)), lump_cloud)
    back = found.X @ wrong(1.0, 2.0, 3)
    moved = piece.points @ back[:3, :3].T + back[:3, 3]
    assert np.linalg.norm(moved - piece.points, axis=1).max() < 0.05e-3
    assert found.trusted


def test_a_sphere_and_a_plane_are_not_trusted(rng):
    u = rng.standard_normal((6000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    ball = Cloud(points=0.1 * u, normals=u, view_directions=u, counts=np.ones(6000))
    xy = rng.uniform(-0.1, 0.1, (6000, 2))
    up = np.tile([0.0, 0.0, 1.0], (6000, 1))
    sheet = Cloud(
        points=np.column_stack([xy, np.zeros(6000)]), normals=up, view_directions=up, counts=np.ones(6000)
    )
    for cloud in (ball, sheet):
        other = Cloud(
            **{k: getattr(cloud, k)[::2] for k in ("points", "normals", "view_directions", "counts")}
        )
        found = register(other, cloud)
        assert not found.trusted and "free" in found.statement


def test_clouds_that_do_not_meet_are_not_trusted(lump_cloud):
    away = transformed(lump_cloud, motion(np.array([[1.0, 0, 0, 0, 0, 0]]))[0])
    found = register(away, lump_cloud)
    assert not found.trusted and found.fitness == 0.0
    assert np.array_equal(found.X, np.eye(4))


def test_all_clouds_at_once_close_the_ring(lump_cloud):
    azimuth = np.arctan2(lump_cloud.points[:, 1], lump_cloud.points[:, 0])
    names = ("points", "normals", "view_directions", "counts")
    pieces, starts = [], []
    for k in range(4):
        away = np.abs((azimuth - k * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi)
        pieces.append(Cloud(**{n: getattr(lump_cloud, n)[away < 1.1] for n in names}))
        starts.append(np.eye(4) if k == 0 else wrong(0.7, 1.5, k))
    found = align(pieces, start=np.stack(starts))
    for piece, r in zip(pieces, found, strict=True):
        assert np.abs(transformed(piece, r.X).points - piece.points).max() < 5e-6


def test_too_few_points_to_register(lump_cloud):
    few = Cloud(
        **{n: getattr(lump_cloud, n)[:20] for n in ("points", "normals", "view_directions", "counts")}
    )
    with pytest.raises(InputError, match="too few"):
        register(few, lump_cloud)


PLANTED = ScanErrors(
    hand_eye_m=(2e-4, -1e-4, 3e-4), hand_eye_rad=(5e-4, -3e-4, 2e-4), axis_m=(2e-4, -1.5e-4),
    axis_rad=(2e-4, -3e-4), backlash_rad=3e-4,
)  # fmt: skip


def test_correcting_by_the_true_errors_restores_the_clean_scan(lump):
    constant = replace(PLANTED, range_noise=0.0, frame_scale=0.0, pose_m=0.0, pose_rad=0.0)
    mended = corrected(turns(lump, constant, n=8), constant)
    a = accuracy(mended.points_O, lump)
    assert a.mean_abs < 2e-6
    X = mended.captures.X_OS
    np.testing.assert_allclose(X @ inverse(X), np.tile(np.eye(4), (24, 1, 1)), atol=1e-12)


def test_calibration_finds_planted_errors(lump, clean_scan):
    scan = turns(lump, PLANTED)
    found = calibrate([scan], points=150_000)
    assert found.rms_after < 0.75 * found.rms_before
    before, after = (
        accuracy(fuse([scan]).points, lump),
        accuracy(fuse([corrected(scan, found.errors)]).points, lump),
    )
    clean = accuracy(fuse([clean_scan]).points, lump)
    assert before.mean_abs > 0.15e-3
    assert after.mean_abs < 0.06e-3 and after.mean_abs < clean.mean_abs + 0.04e-3
    assert after.sd_signed < clean.sd_signed + 0.02e-3
    assert len(found.sd) == len(PARAMETERS) and "disagree" in found.statement


def test_calibration_leaves_a_good_scan_alone(clean_scan, lump):
    found = calibrate([clean_scan], points=100_000)
    a = accuracy(fuse([corrected(clean_scan, found.errors)]).points, lump)
    assert a.mean_abs < 0.06e-3


def test_frames_from_one_side_do_not_determine_the_table(lump):
    X = np.repeat(look_at((0.55, 0, 0.1), (-1, 0, 0))[None], 6, axis=0)
    scene = scene_from(lump.vertices, lump.triangles)
    scan = simulate(scene, SCANNER, still_captures(X), rng=np.random.default_rng(0))
    found = calibrate([scan])
    assert not found.known.any()
    assert "not determined" in found.statement
    with pytest.raises(InputError):
        corrected(scan, ScanErrors())


def test_errors_from_keeps_the_order_of_the_parameters():
    e = errors_from(np.arange(11.0))
    assert (*e.hand_eye_m, *e.hand_eye_rad, *e.axis_m, *e.axis_rad, e.backlash_rad) == tuple(range(11))


def test_surface_is_trimmed_to_the_data(lump, lump_cloud):
    seen = lump_cloud.points[:, 2] < 0.12
    cut = Cloud(
        **{n: getattr(lump_cloud, n)[seen] for n in ("points", "normals", "view_directions", "counts")}
    )
    vertices, triangles = surface(cut, depth=7)
    assert vertices[:, 2].max() < 0.12 + 0.004
    assert triangles.max() == len(vertices) - 1
    a = accuracy(vertices, lump)
    assert a.mean_abs < 0.10e-3
    corners = vertices[triangles]
    area = (
        0.5
        * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    assert area > 0.9 * len(cut) * 0.002**2 * 0.6
    again = surface(cut, depth=7)
    np.testing.assert_array_equal(vertices, again[0])


def test_deviation_mesh_colours_by_sign(lump, tmp_path):
    d = deviation_mesh(lump.vertices * [1.01, 1.01, 1.0], lump.triangles, lump, limit=2e-4)
    outside = d.distance > 1e-4
    assert outside.sum() > 0.5 * len(d.distance)
    assert (d.colors[outside, 0] > d.colors[outside, 2]).all()
    fit = deviation_mesh(lump.vertices, lump.triangles, lump)
    assert np.ptp(fit.colors) <= 3
    d.save(tmp_path / "deviation.ply")
    back = read_geometry(tmp_path / "deviation.ply")
    np.testing.assert_allclose(back.vertices, d.vertices * 1e3, atol=1e-4)
    np.testing.assert_array_equal(back.triangles, d.triangles)


def test_scans_and_clouds_survive_the_disk(clean_scan, lump_cloud, tmp_path):
    save_scan(tmp_path / "scan.npz", clean_scan)
    back = load_scan(tmp_path / "scan.npz")
    for name in ("points_O", "frame", "depth", "pixel", "seen"):
        np.testing.assert_array_equal(getattr(back, name), getattr(clean_scan, name))
    np.testing.assert_array_equal(back.captures.X_OS, clean_scan.captures.X_OS)
    save_cloud(tmp_path / "cloud.ply", lump_cloud)
    cloud = read_geometry(tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud.vertices, lump_cloud.points * 1e3, atol=1e-4)
    assert cloud.normals is not None
    assert sorted(f.name for f in tmp_path.iterdir()) == ["cloud.ply", "scan.npz"]
    for name, content in (("no.npz", None), ("bad.npz", b"nonsense"), ("cloud.ply", b"")):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError):
            load_scan(tmp_path / name)


def folder_of_scans(tmp_path, cloud, errors):
    """Four scans of the lump with a pose file whose poses are wrong by `errors`."""
    import json

    entries = {}
    azimuth = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    for k in range(4):
        X = turned(np.array([k * np.pi / 2]))[0] @ motion(np.array([[0.1, 0.2, 0.3, 0.5, 0.1, 0.0]]))[0]
        mine = np.abs((azimuth - k * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi) < 1.2
        local = inverse(X[None])[0]
        piece = transformed(Cloud(**{n: getattr(cloud, n)[mine] for n in vars(cloud)}), local)
        save_cloud(tmp_path / f"{k}.ply", piece)
        given_ = errors[k] @ X
        given_[:3, 3] *= 1e3
        view = -turned(np.array([k * np.pi / 2]))[0][:3, 0]
        entries[f"{k}.ply"] = {"T_object_scan": given_.tolist(), "nominal_view_direction": view.tolist()}
    (tmp_path / "poses.json").write_text(json.dumps({"units": "mm", "scans": entries}))


def test_a_folder_of_scans_with_poses(tmp_path, lump_cloud, lump):
    errors = [np.eye(4)] + [wrong(0.6, 1.0, k) for k in range(3)]
    folder_of_scans(tmp_path, lump_cloud, errors)
    bare = accuracy(fuse_folder(tmp_path, registered=False).cloud.points, lump)
    fused = fuse_folder(tmp_path)
    a = accuracy(fused.cloud.points, lump)
    assert bare.mean_abs > 0.2e-3 and a.mean_abs < 0.08e-3
    assert all(r.trusted for r in fused.registrations)
    lines = fuse_files([tmp_path], tmp_path / "out.ply")
    assert len(lines) == 4 and "4 scans" in lines[-1]
    assert len(read_geometry(tmp_path / "out.ply").vertices) == len(fused.cloud)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[]", "names no"),
        ('{"scans": {}}', "names no"),
        ('{"units": "furlong", "scans": {"a.ply": {}}}', "unknown unit"),
        ('{"scans": {"a.ply": {}}}', "not a pose"),
        ('{"scans": {"a.ply": {"T_object_scan": [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}}', "not a pose"),
        ('{"scans": {"../a.ply": {}}}', "lie in the folder"),
        (
            '{"scans": {"a.ply": {"T_object_scan": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}}',
            "no such file",
        ),
    ],
)
def test_a_bad_pose_file_is_named(tmp_path, text, message):
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises((InputError, PartError), match=message):
        scans_from_poses(tmp_path / "poses.json")


def test_bunny_scans_find_back_from_wrong_poses(shared_data):
    scans = scans_from_poses(shared_data / "bunny_range_scans" / "poses.json")[:6]
    reference = fuse_measured(scans, voxel=0.003)
    start = [s.X for s in scans]
    bad = []
    for k, s in enumerate(scans):
        centre = np.eye(4)
        centre[:3, 3] = s.points.mean(axis=0)
        slip = np.eye(4) if k == 0 else wrong(1.0, 2.0, k)
        bad.append(replace(s, X=s.X @ centre @ slip @ inverse(centre[None])[0]))
    found = fuse_measured(bad, voxel=0.003)
    for k, s in enumerate(scans):
        given_, best, ours = (
            s.points @ X[:3, :3].T + X[:3, 3]
            for X in (start[k], reference.registrations[k].X, found.registrations[k].X)
        )
        assert np.linalg.norm(ours - best, axis=1).mean() < 0.15e-3
        # The given poses are good to about 1 mm at this scale (0.4 mm at the scanner's).
        assert np.linalg.norm(ours - given_, axis=1).mean() < 1.2e-3
        assert found.registrations[k].trusted


def test_revolution_poses_and_turning_the_table_agree(lump):
    X = look_at((0.55, 0, 0.1), (-1, 0, 0))
    angle = 2 * np.pi * np.arange(12) / 12
    table = Captures(
        t=np.arange(12.0), X_WS=np.tile(X, (12, 1, 1)), table_angle=angle, X_WT=np.eye(4), X_TO=np.eye(4)
    )
    np.testing.assert_allclose(table.X_OS, revolution_poses(X, 12), atol=1e-12)
