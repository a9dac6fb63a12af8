"""Completeness, accuracy and signed distances against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_simulate import sphere

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.sensing.assess import accuracy, completeness, completeness_by_distance, signed_distances

R = 0.05


@pytest.fixture(scope="module")
def ball():
    vertices, triangles = sphere(R, np.zeros(3))
    return Part(name="ball", vertices=vertices, triangles=triangles)


def sheet(n, *, up=1.0, z=0.0):
    """Samples at random over a square metre at height z."""
    xy = np.random.default_rng(0).random((n, 2))
    points = np.column_stack([xy, np.full(n, z)])
    return SurfaceSamples(points=points, normals=np.tile([0.0, 0.0, up], (n, 1)), area=1.0 / n)


def grid(low, high, *, pitch=0.005, z=0.0):
    x, y = np.meshgrid(np.arange(low, high, pitch), np.arange(0, 1 + pitch, pitch))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])


def up(points, sense=1.0):
    return np.tile([0.0, 0.0, sense], (len(points), 1))


def directions(n, rng):
    u = rng.standard_normal((n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_completeness_counts(pairs):
    seen, can = np.array(pairs).T
    samples = SurfaceSamples(points=np.zeros((len(seen), 3)), normals=np.zeros((len(seen), 3)), area=0.25)
    c = completeness(samples, seen, can)
    union = sum(a or b for a, b in pairs)
    assert c.of_visible == pytest.approx(sum(seen) / union if union else 0.0)
    assert c.of_whole == pytest.approx(sum(seen) / len(seen))
    assert c.area_open == pytest.approx(0.25 * sum(b and not a for a, b in pairs))
    assert 0 <= c.of_whole <= c.of_visible + (union == 0) <= 1 + (union == 0)


@pytest.mark.parametrize(("edge", "distance"), [(0.3, 0.02), (0.5, 0.05), (0.8, 0.01)])
def test_a_half_covered_sheet_counts_its_half_and_a_seam(edge, distance):
    samples, points = sheet(40_000), grid(0.0, edge + 1e-9)
    c = completeness_by_distance(samples, points, up(points), distance=distance)
    # The last row of points reaches `distance` beyond itself, less the gap between two of them.
    assert c.of_whole == pytest.approx(points[:, 0].max() + distance, abs=0.006)
    assert c.of_visible == c.of_whole
    assert c.area_open == pytest.approx(1 - c.of_whole)


def test_only_like_facing_points_vouch():
    samples, points = sheet(4000), grid(0.0, 1.0)
    tilt = np.deg2rad(50)
    leaning = np.tile([np.sin(tilt), 0, np.cos(tilt)], (len(points), 1))
    covered = [
        completeness_by_distance(samples, points, n, distance=0.01, angle=np.deg2rad(a)).of_whole
        for n, a in ((up(points), 60), (up(points, -1.0), 60), (leaning, 60), (leaning, 45))
    ]
    assert covered == [1.0, 0.0, 1.0, 0.0]


def test_the_far_side_of_a_thin_wall_is_not_covered_by_the_near_one():
    front, back, points = sheet(3000), sheet(3000, up=-1.0, z=-0.001), grid(0.0, 1.0)
    both = SurfaceSamples(
        points=np.vstack([front.points, back.points]), normals=np.vstack([front.normals, back.normals]),
        area=front.area,
    )  # fmt: skip
    c = completeness_by_distance(both, points, up(points), distance=0.01)
    assert c.of_whole == 0.5
    facing = np.repeat([True, False], 3000)
    assert completeness_by_distance(both, points, up(points), visible=facing, distance=0.01).of_visible == 1.0


@given(st.integers(0, 10_000))
@settings(max_examples=15)
def test_against_all_pairs(seed):
    """Also where many near points are turned away and only a farther one faces the same way."""
    rng = np.random.default_rng(seed)
    samples = SurfaceSamples(points=0.02 * rng.random((60, 3)), normals=directions(60, rng), area=1.0)
    points, normals = 0.02 * rng.random((900, 3)), directions(900, rng)
    normals[rng.random(900) < 0.9] = -samples.normals.mean(axis=0) / np.linalg.norm(
        samples.normals.mean(axis=0)
    )
    limit, angle = 0.006, np.deg2rad(20.0)
    d = np.linalg.norm(samples.points[:, None] - points[None], axis=2)
    near = (d < limit) & (samples.normals @ normals.T >= np.cos(angle))
    c = completeness_by_distance(samples, points, normals, distance=limit, angle=angle)
    assert c.of_whole == pytest.approx(near.any(axis=1).mean())


@pytest.mark.parametrize("offset", [-0.4e-3, 0.0, 0.3e-3])
def test_accuracy_of_a_ball_too_large_or_too_small(ball, rng, offset):
    a = accuracy((R + offset) * directions(4000, rng), ball)
    sagitta = R * (1 - np.cos(np.pi / 320))
    assert a.mean_signed == pytest.approx(offset, abs=3 * sagitta)
    assert a.mean_abs == pytest.approx(abs(offset), abs=3 * sagitta)
    assert a.sd_signed < 2 * sagitta
    assert a.points == 4000


def test_accuracy_of_noise_is_its_moments(ball, rng):
    sigma, n = 0.2e-3, 40_000
    a = accuracy((R + sigma * rng.standard_normal((n, 1))) * directions(n, rng), ball)
    assert a.sd_signed == pytest.approx(sigma, rel=0.02)
    assert a.mean_abs == pytest.approx(sigma * np.sqrt(2 / np.pi), rel=0.02)
    assert a.p95_abs == pytest.approx(1.96 * sigma, rel=0.02)
    assert abs(a.mean_signed) < 5 * sigma / np.sqrt(n) + 5e-6


def test_the_sign_of_an_open_mesh_is_that_of_its_normals(rng):
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    part = Part(name="sheet", vertices=corners, triangles=np.array([[0, 1, 2], [0, 2, 3]]), closed=False)
    height = rng.uniform(-0.2, 0.2, 500)
    d = signed_distances(np.column_stack([rng.uniform(0.1, 0.9, (500, 2)), height]), part)
    np.testing.assert_allclose(d, height, atol=1e-6)


def test_what_cannot_be_assessed_is_refused(ball):
    cloud = Part(name="cloud", vertices=ball.vertices, triangles=np.zeros((0, 3), int))
    with pytest.raises(InputError, match="mesh"):
        accuracy(ball.vertices, cloud)
    with pytest.raises(InputError, match="no points"):
        accuracy(np.zeros((0, 3)), ball)


def test_own_samples_cover_a_part_wholly(ball):
    samples = surface_samples(ball, 4000, rng=np.random.default_rng(1))
    c = completeness_by_distance(samples, samples.points, samples.normals)
    assert c.of_whole == c.of_visible == 1.0 and c.area_open == 0.0
