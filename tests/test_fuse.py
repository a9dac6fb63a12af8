"""Fusion of raw points: closed forms of its noise, invariances, walls, outliers and sparse spots."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import cap, raw
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.core.viewpoint import look_at
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.fusion.fuse import RawPoints, fuse, fuse_points
from scanmotion.sensing.simulator.captures import Captures
from scanmotion.sensing.visibility import revolution_poses


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


def test_revolution_poses_and_turning_the_table_agree(lump):
    X = look_at((0.55, 0, 0.1), (-1, 0, 0))
    angle = 2 * np.pi * np.arange(12) / 12
    table = Captures(
        t=np.arange(12.0), X_WS=np.tile(X, (12, 1, 1)), table_angle=angle, X_WT=np.eye(4), X_TO=np.eye(4)
    )
    np.testing.assert_allclose(table.X_OS, revolution_poses(X, 12), atol=1e-12)
