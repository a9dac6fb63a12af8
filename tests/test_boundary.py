"""Boundary points and orientation: closed forms, brute force, invariances, bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import HoleError
from scanmotion.sensing.holes.boundary import (
    boundary_points,
    neighbour_radius,
    oriented_normals,
    project_on_plane,
)


def brute_gaps(points: np.ndarray, normals: np.ndarray, radius: float) -> np.ndarray:
    """Largest angle by the definition, one point at a time."""
    gaps = []
    for p, n in zip(points, normals, strict=True):
        near = points[(np.linalg.norm(points - p, axis=1) <= radius) & (np.abs(points - p).sum(axis=1) > 0)]
        foot = project_on_plane(p, n, near) - p
        x = np.linalg.svd(n[None])[2][1]
        angle = np.sort(np.arctan2(foot @ np.cross(n, x), foot @ x))
        if len(angle) < 2:
            gaps.append(2 * np.pi)
            continue
        gaps.append(float(np.diff(np.append(angle, angle[0] + 2 * np.pi)).max()))
    return np.array(gaps)


def blue_square(rng: np.random.Generator, n: int) -> np.ndarray:
    """Random points of the unit square, in space."""
    return np.column_stack([rng.random((n, 2)), np.zeros(n)])


def sphere(rng: np.random.Generator, n: int, radius: float = 0.1) -> np.ndarray:
    points = rng.normal(size=(n, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def test_projection_where_the_papers_formula_fails() -> None:
    foot = project_on_plane(np.array([1.0, 2, 3]), np.array([0.0, 1, 0]), np.array([2.0, 5, -1]))
    assert foot.tolist() == [2.0, 2.0, -1.0]


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_projection_lies_on_the_plane_and_is_nearest(seed: int) -> None:
    p, n, q = np.random.default_rng(seed).normal(size=(3, 3))
    foot = project_on_plane(p, n, q)
    assert abs((foot - p) @ n) < 1e-9
    assert np.linalg.norm(np.cross(q - foot, n)) < 1e-9 * (1 + np.linalg.norm(q - foot) * np.linalg.norm(n))


@pytest.mark.parametrize("threshold", [np.pi / 4, np.pi / 2, np.pi])
@pytest.mark.parametrize("neighbours", [10, 30, 45])
def test_equals_brute_force_over_all_neighbours(rng, threshold: float, neighbours: int) -> None:
    points = blue_square(rng, 600) @ Rotation.random(rng=rng).as_matrix().T
    normals = np.tile(np.linalg.svd(points - points.mean(axis=0))[2][2], (600, 1))
    from scipy.spatial import cKDTree

    radius = neighbour_radius(cKDTree(points), neighbours)
    mask = boundary_points(points, normals, threshold=threshold, neighbours=neighbours)
    assert (mask == (brute_gaps(points, normals, radius) > threshold)).all()


def test_a_corner_with_a_narrow_wedge_is_boundary() -> None:
    """All neighbours within 40 deg: the gap is 320 deg, which arccos would fold to 40."""
    angle = np.radians(np.linspace(-20, 20, 33))
    rays = np.stack([np.cos(angle), np.sin(angle), np.zeros(33)], axis=1)
    points = np.concatenate([np.zeros((1, 3)), *[0.01 * k * rays for k in range(1, 6)]])
    mask = boundary_points(points, np.tile([0.0, 0, 1], (len(points), 1)), radius=0.06)
    assert mask[0]


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)])
def test_exactly_axis_aligned_grids(normal) -> None:
    x, y = np.meshgrid(np.arange(15.0), np.arange(15.0))
    plane = np.column_stack([x.ravel(), y.ravel(), np.zeros(225)])
    axis = int(np.abs(normal).argmax())
    points = np.roll(plane, axis - 2, axis=1)
    mask = boundary_points(points, np.tile(np.array(normal, float), (225, 1)), radius=2.5)
    rim = ((plane[:, :2] == 0) | (plane[:, :2] == 14)).any(axis=1)
    assert (mask == rim).all()


@given(seed=st.integers(0, 2**32 - 1), log_scale=st.floats(-3, 3))
@settings(max_examples=15)
def test_moves_scales_and_permutes_with_the_points(seed: int, log_scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = sphere(rng, 400)
    points = points[points[:, 2] < 0.05]
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    mask = boundary_points(points, normals, neighbours=20)
    R, order = Rotation.random(rng=rng).as_matrix(), rng.permutation(len(points))
    moved = 10.0**log_scale * (points @ R.T + rng.normal(size=3))
    again = boundary_points(moved[order], -(normals @ R.T)[order], neighbours=20)
    assert (again == mask[order]).mean() > 0.99
    assert (boundary_points(points[order], normals[order], neighbours=20) == mask[order]).all()


def test_bad_input_is_named() -> None:
    rng = np.random.default_rng(0)
    points = sphere(rng, 100)
    with pytest.raises(HoleError, match="20 points are fewer than the 31"):
        boundary_points(points[:20], points[:20])
    with pytest.raises(HoleError, match="shape"):
        boundary_points(points[:, :2], points)
    with pytest.raises(HoleError, match="1 of 100 points are not finite"):
        boundary_points(np.where(np.arange(100)[:, None] == 3, np.nan, points), points)
    with pytest.raises(HoleError, match="normals are zero"):
        boundary_points(points, np.where(np.arange(100)[:, None] == 3, 0.0, points))
    with pytest.raises(HoleError, match="radius must be positive"):
        boundary_points(points, points, radius=0.0)


def test_a_point_far_away_changes_nothing_else(rng) -> None:
    """The grid cannot have a cell for every radius up to it."""
    points = sphere(rng, 3000)
    points = points[points[:, 2] < 0.06]
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    alone = boundary_points(points, normals, radius=0.02)
    both = boundary_points(np.vstack([points, [1e7, 0, 0]]), np.vstack([normals, [0.0, 0, 1]]), radius=0.02)
    assert both[-1] and (both[:-1] == alone).all()


def test_isolated_points_and_copies_are_boundary() -> None:
    points = np.concatenate([np.zeros((40, 3)), [[9.0, 9, 9]]])
    assert boundary_points(points, np.tile([0.0, 0, 1], (41, 1)), radius=1.0).all()


def test_normals_by_view_directions(rng) -> None:
    points = sphere(rng, 2000)
    normals = oriented_normals(points, view_directions=points)
    assert (np.einsum("ij,ij->i", normals, points) > 0.095).all()


def test_spanning_tree_orients_a_closed_surface_with_right_angles(rng) -> None:
    """A box: neighbouring normals are at right angles along its edges."""
    side = rng.integers(0, 3, 6000)
    sign = rng.choice([-1.0, 1.0], 6000)
    points = rng.uniform(-1, 1, (6000, 3))
    points[np.arange(6000), side] = sign
    normals = oriented_normals(points)
    flat = np.abs(points).max(axis=1, initial=0, where=np.arange(3) != side[:, None]) < 0.85
    assert (normals[np.arange(6000), side][flat] * sign[flat] > 0.9).mean() > 0.999


def test_spanning_tree_orients_an_exactly_planar_grid() -> None:
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    normals = oriented_normals(np.column_stack([x.ravel(), y.ravel(), np.zeros(400)]))
    assert np.allclose(normals, [0, 0, 1])


def test_spanning_tree_on_concentric_shells_ends_and_is_coherent(rng) -> None:
    """Exactly concentric shells with the same directions: each shell has one sign."""
    shell = sphere(rng, 3000)
    points = np.concatenate([shell, 0.8 * shell, 0.6 * shell])
    normals = oriented_normals(points)
    for part in np.split(np.arange(9000), 3):
        side = np.einsum("ij,ij->i", normals[part], points[part]) > 0
        assert side.mean() in (0.0, 1.0)


def test_spanning_tree_orients_every_piece_of_a_disconnected_surface(rng) -> None:
    one = sphere(rng, 1500)
    points = np.concatenate([one, one + [1.0, 0, 0], one + [0, 5.0, 0]])
    normals = oriented_normals(points)
    assert (np.einsum("ij,ij->i", normals, np.tile(one, (3, 1))) > 0).all()
