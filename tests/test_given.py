"""Measured scans: how fine they are, and that their own gaps are not taken for what was missed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.sensing.closed_surface import closed_model
from scanmotion.sensing.holes.find import holes_from_cloud
from scanmotion.sensing.scans.measured_scan import cloud_from_part, spacing_of
from scanmotion.views.targets import missed

SIDES = (0.2, 0.15, 0.12)


@given(st.floats(1e-3, 1e-2), st.integers(12, 40))
@settings(max_examples=25)
def test_the_spacing_of_a_grid_is_its_pitch(pitch, n):
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    points = pitch * np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)])
    # The eighth neighbour lies across the diagonal; along the sides of the grid it is farther.
    inner = np.sqrt(2) * np.sqrt(np.pi / 8.5) * pitch
    assert inner <= spacing_of(points, least=0.0) * (1 + 1e-9) <= 1.7 * pitch
    assert spacing_of(points, least=1.0) == 1.0
    if n > 39:
        assert spacing_of(points, least=0.0) == pytest.approx(inner, rel=0.45)


@given(st.integers(0, 1000), st.floats(0.1, 10))
@settings(max_examples=15)
def test_spacing_grows_with_the_cloud_and_knows_neither_order_nor_place(seed, scale):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(300, 3)) * [1, 1, 0.01]
    one = spacing_of(points, least=0.0)
    assert spacing_of(scale * points, least=0.0) == pytest.approx(scale * one)
    assert spacing_of(rng.permutation(points) + 5.0, least=0.0) == pytest.approx(one)


def test_a_sparse_side_decides():
    rng = np.random.default_rng(0)
    dense, sparse = rng.random((8000, 3)) * [1, 1, 0], rng.random((2000, 3)) * [1, 1, 0] + [2, 0, 0]
    alone = spacing_of(sparse, least=0.0)
    assert spacing_of(np.concatenate([dense, sparse]), least=0.0) == pytest.approx(alone, rel=0.2)
    assert alone == pytest.approx(1 / np.sqrt(2000), rel=0.4)


@pytest.mark.parametrize("spacing", [0.002, 0.005])
def test_a_mesh_is_sampled_evenly_whatever_its_triangles(spacing):
    part = box_part(*SIDES)
    cloud = cloud_from_part(part, spacing=spacing)
    area = 2 * (SIDES[0] * SIDES[1] + SIDES[0] * SIDES[2] + SIDES[1] * SIDES[2])
    assert len(cloud.points) * spacing**2 == pytest.approx(area, rel=0.25)
    assert spacing_of(cloud.points, least=0.0) == pytest.approx(spacing, rel=0.3)
    again = cloud_from_part(part, spacing=spacing)
    assert again.points.tobytes() == cloud.points.tobytes()
    # Each normal is that of the side on which its point lies.
    p = cloud.points + cloud.normals * 1e-6
    outside = np.abs(p - [0, 0, SIDES[2] / 2]) > np.array(SIDES) / 2
    assert (outside.sum(axis=1) == 1).all()


def box_cloud(n, hole, rng):
    """Random points on a box, less a disc of radius `hole` on its top."""
    samples = surface_samples(box_part(*SIDES), 3 * n, rng=rng)
    pick = rng.choice(3 * n, n, replace=False)
    points, normals = samples.points[pick], samples.normals[pick]
    top = normals[:, 2] > 0.9
    cut = top & (np.linalg.norm(points[:, :2], axis=1) < hole)
    return points[~cut], normals[~cut]


def targets_of(points, normals, holes=()):
    spacing = spacing_of(points, least=0.0)
    model = closed_model(points, normals, spacing=spacing)
    return missed(model, points, spacing=spacing, holes=holes), spacing


@pytest.mark.parametrize("n", [3000, 20_000])
def test_gaps_of_random_points_are_not_missed_surface(n):
    found, _ = targets_of(*box_cloud(n, 0.0, np.random.default_rng(n)))
    assert len(found) == 0


@pytest.mark.parametrize("n", [3000, 20_000])
def test_a_disc_cut_out_is_missed_as_a_whole_and_nothing_else(n):
    radius = 0.04
    points, normals = box_cloud(n, radius, np.random.default_rng(n))
    found, spacing = targets_of(points, normals)
    assert len(found)
    flat = np.linalg.norm(found.points[:, :2], axis=1)
    assert flat.max() < radius + spacing
    # The guess over it is smooth, hardly higher than a fifth of what is gone is wide.
    assert np.abs(found.points[:, 2] - SIDES[2]).max() < max(0.25 * radius, 2 * spacing)
    inner = max(radius - 1.5 * spacing, 0.0)
    assert np.pi * inner**2 * 0.9 < found.areas.sum() < np.pi * (radius + spacing) ** 2
    # The detected hole adds nothing where the model has it already.
    report = holes_from_cloud(points, view_directions=normals)
    assert len(report.holes) == 1
    both, _ = targets_of(points, normals, report.holes)
    assert both.areas.sum() < 1.6 * np.pi * radius**2


def test_a_cloud_without_normals_gets_them():
    points, normals = box_cloud(4000, 0.0, np.random.default_rng(2))
    part = Part(name="scan", vertices=points, triangles=np.zeros((0, 3), int))
    cloud = cloud_from_part(part, spacing=0.002)
    assert np.array_equal(cloud.points, points)
    assert (np.einsum("ij,ij->i", cloud.normals, normals) > 0.5).mean() > 0.97
