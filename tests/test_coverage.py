"""What a viewpoint sees, against closed forms and a slow reference; covers against brute force."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rounds import blocked, boxes

from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.sensing import visibility as coverage
from scanmotion.sensing.greedy_cover import greedy_cover
from scanmotion.sensing.visibility import (
    GUESSED,
    free_lines,
    hemisphere,
    in_view,
    revolution_poses,
    scene_from,
    seen_by_any,
    sees,
    tangents,
    turns_see,
    visible,
)

SCANNER = Scanner()
FAR = (np.array([[9.0, 9, 9], [9.1, 9, 9], [9, 9.1, 9]]), np.array([[0, 1, 2]]))
EMPTY = scene_from(*FAR)


def plane(n, size, z=0.0):
    """Points of a horizontal square that faces up, and their normals."""
    g = (np.arange(n) + 0.5) / n * size - size / 2
    x, y = np.meshgrid(g, g)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(n * n, z)])
    return points, np.tile([0.0, 0.0, 1.0], (n * n, 1))


def sphere(n, radius, centre):
    """Points of a sphere (Fibonacci) and their normals."""
    upper = hemisphere(n)
    u = np.vstack([upper, upper * [1, 1, -1]])
    return centre + radius * u, u


def above(z, *, roll=0.0, x=0.0, y=0.0):
    return look_at(np.array([x, y, z]), np.array([0, 0, -1]), roll=roll)


def reference(blocks, scanner, X_OS, points, normals):
    """Slowly and one by one: slabs for occlusion, angles for field and incidence."""

    out = np.zeros((len(X_OS), len(points)), bool)
    for i, X in enumerate(X_OS):
        eyes = X[:3, 3], X[:3, 3] + scanner.baseline * X[:3, 0]
        for j, (p, n) in enumerate(zip(points, normals, strict=True)):
            x, y, z = X[:3, :3].T @ (p - X[:3, 3])
            ok = scanner.range[0] <= z <= scanner.range[1]
            ok = ok and abs(np.arctan2(x, z)) <= scanner.fov[0] / 2
            ok = ok and abs(np.arctan2(y, z)) <= scanner.fov[1] / 2
            for eye in eyes:
                line = (eye - p) / np.linalg.norm(eye - p)
                ok = ok and np.arccos(np.clip(line @ n, -1, 1)) <= scanner.max_incidence
                ok = ok and not blocked(blocks, p + 2e-4 * n, eye)
            out[i, j] = ok
    return out


@pytest.mark.parametrize("z", [0.45, 0.7, 0.98])
def test_the_footprint_on_a_plane_is_the_field(z):
    points, normals = plane(401, 0.6)
    seen = sees(EMPTY, SCANNER, above(z)[None], points, normals)[0]
    l, w = SCANNER.field(z)  # noqa: E741
    # At roll 0 and looking down, +x of S points along y.
    inside = (np.abs(points[:, 1]) <= l / 2) & (np.abs(points[:, 0]) <= w / 2)
    assert (seen == inside).all()
    assert seen.sum() * (0.6 / 401) ** 2 == pytest.approx(l * w, rel=0.02)


@pytest.mark.parametrize("z", [0.399, 0.401, 0.999, 1.001])
def test_the_range_is_kept(z):
    seen = sees(EMPTY, SCANNER, above(z)[None], np.zeros((1, 3)), np.array([[0, 0, 1.0]]))
    assert seen.item() == (0.4 <= z <= 1.0)


@pytest.mark.parametrize("limit", np.deg2rad([20.0, 40.0, 60.0]))
def test_the_visible_cap_of_a_sphere(limit):
    """Camera and projector at one place see where the angle of incidence is within the limit."""
    radius, d = 0.08, 0.7
    scanner = replace(SCANNER, baseline=0.0, max_incidence=limit)
    points, u = sphere(20_000, radius, [0, 0, 0])
    seen = sees(EMPTY, scanner, above(d)[None], points, u)[0]
    # The law of sines: at the rim of the cap the angle at the centre is the incidence less that at the eye.
    theta = limit - np.arcsin(radius * np.sin(limit) / d)
    assert seen.mean() == pytest.approx((1 - np.cos(theta)) / 2, rel=2e-3)
    assert (seen == (u[:, 2] >= np.cos(theta))).mean() > 0.9999


def test_the_cap_is_both_eyes_own():
    scanner = replace(SCANNER, max_incidence=np.deg2rad(50.0))
    lone = replace(scanner, baseline=0.0)
    points, u = sphere(4000, 0.08, [0, 0, 0])
    X = above(0.7)
    beside = X.copy()
    beside[:3, 3] += scanner.baseline * X[:3, 0]
    both = in_view(scanner, X, points, u)[0]
    line = beside[:3, 3] - points
    of_projector = np.einsum("ij,ij->i", line, u) >= np.cos(np.deg2rad(50.0)) * np.linalg.norm(line, axis=1)
    assert (both == (in_view(lone, X, points, u)[0] & of_projector)).all()
    assert both.sum() < in_view(lone, X, points, u)[0].sum()


@pytest.mark.parametrize("angle", np.deg2rad([0.0, 60.0, 69.5, 70.5, 89.0, 120.0]))
def test_incidence_ends_at_its_limit(angle):
    n = np.array([[np.sin(angle), 0.0, np.cos(angle)]])
    scanner = replace(SCANNER, baseline=0.0)
    assert sees(EMPTY, scanner, above(0.7)[None], np.zeros((1, 3)), n).item() == (angle <= np.deg2rad(70))


def test_the_shadow_of_a_block_is_that_of_two_lamps():
    """A block floating over a plane hides what it hides from the camera, and from the projector."""
    h, half, z = 0.1, 0.02, 0.7
    scene = scene_from(*boxes(([-half, -half, h - 1e-4], [half, half, h])))
    points, normals = plane(301, 0.3)
    X = above(z)
    seen = sees(scene, SCANNER, X[None], points, normals)[0]
    dark = np.zeros(len(points), bool)
    grow, doubt = z / (z - h), np.zeros(len(points), bool)
    for eye in (X[:3, 3], X[:3, 3] + SCANNER.baseline * X[:3, 0]):
        # Central projection of the square from the eye onto the plane.
        centre = eye[:2] * (1 - grow)
        off = np.abs(points[:, :2] - centre).max(axis=1)
        dark |= off < half * grow
        doubt |= np.abs(off - half * grow) < 3e-4
    lit = in_view(SCANNER, X, points, normals)[0]
    assert (seen == (lit & ~dark))[~doubt].all()
    assert (lit & dark).sum() > 1000 and doubt.mean() < 0.02


@pytest.mark.parametrize("pedestal", [0.0, 0.3])
def test_the_table_hides_what_is_looked_at_from_below(pedestal):
    scene = scene_from(*FAR, table_radius=0.5, table_z=-pedestal, pedestal_radius=0.05)
    eyes = np.array([[0.0, 0.3, -0.5], [0.5, 0.3, -0.2], [0.5, 0.3, 0.02]])
    free = free_lines(scene, np.tile([0.0, 0.3, 0.1], (3, 1)), eyes)
    # Straight under the disc; past its edge only where the pedestal lifts the part; above it always.
    assert free.tolist() == [False, pedestal > 0, True]
    through = free_lines(scene, np.array([[0.3, 0.0, -0.1]]), np.array([[-0.3, 0.0, -0.1]]))
    assert through.item() == (pedestal == 0) and scene.table_z == -pedestal


def test_a_guess_blocks_only_beyond_its_uncertainty():
    guess = scene_from(*boxes(([-0.1, -0.1, 0.0], [0.1, 0.1, 0.02]))).raycaster
    scene = replace(EMPTY, guess=guess)
    depth = np.array([1e-4, 0.4 * GUESSED, 0.98 * GUESSED, 1.02 * GUESSED, 3 * GUESSED])
    origins = np.column_stack([np.zeros((5, 2)), 0.02 - depth])
    up = origins * [1, 1, 0] + [0, 0, 0.7]
    assert free_lines(EMPTY, origins, up).all()
    assert free_lines(scene, origins, up).tolist() == [True, True, True, False, False]
    # Below the guess and looking away from it nothing is hidden; the origin's own length is no matter.
    assert free_lines(scene, np.array([[0, 0, -0.001]]), np.array([[0, 0, -0.5]])).item()
    assert free_lines(scene, np.array([[0, 0, 0.03]]), np.array([[0, 0, 0.031]])).item()


def test_sees_equals_the_slow_reference(rng):
    blocks = (([-0.10, -0.08, 0.0], [0.02, 0.08, 0.12]), ([0.05, -0.03, 0.0], [0.09, 0.03, 0.2]))
    vertices, triangles = boxes(*blocks)
    part = Part(name="two", vertices=vertices, triangles=triangles)
    samples = surface_samples(part, 250, rng=rng)
    u = rng.standard_normal((40, 3))
    u[:, 2] = np.abs(u[:, 2])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    eyes = u * rng.uniform(0.4, 1.0, (40, 1)) + [0, 0, 0.08]
    X = np.array(
        [
            look_at(p, rng.normal(0, 0.05, 3) + [0, 0, 0.08] - p, roll=r)
            for p, r in zip(eyes, rng.uniform(0, 6, 40), strict=True)
        ]
    )
    found = sees(scene_from(vertices, triangles), SCANNER, X, samples.points, samples.normals)
    slow = reference(blocks, SCANNER, X, samples.points, samples.normals)
    assert 0.05 < slow.mean() < 0.6
    assert (found != slow).mean() < 1e-3


@pytest.fixture(scope="module")
def lumpy():
    """A scene, poses, samples: a lump on its table under poses from all sides."""
    from scans import bumpy

    part = bumpy(30)
    samples = surface_samples(part, 1500, rng=np.random.default_rng(2))
    scene = scene_from(part.vertices, part.triangles, table_radius=0.4)
    rng = np.random.default_rng(3)
    u = rng.standard_normal((25, 3))
    u[:, 2] = np.abs(u[:, 2])
    X = np.array([look_at(0.65 * v / np.linalg.norm(v) + [0, 0, 0.1], -v) for v in u])
    return scene, X, samples.points, samples.normals


def test_one_pose_is_as_good_as_many(lumpy):
    scene, X, points, normals = lumpy
    many = sees(scene, SCANNER, X, points, normals)
    for k in (0, 7, 24):
        assert (sees(scene, SCANNER, X[k], points, normals) == many[k : k + 1]).all()


def test_seen_by_any_is_what_sees_says(lumpy):
    scene, X, points, normals = lumpy
    many = sees(scene, SCANNER, X, points, normals)
    assert (seen_by_any(scene, SCANNER, X, points, normals) == many.any(axis=0)).all()
    known = np.zeros(len(points), bool)
    known[::3] = True
    before = known.copy()
    assert (seen_by_any(scene, SCANNER, X, points, normals, seen=known) == (many.any(axis=0) | known)).all()
    assert (known == before).all()


def test_a_turn_sees_what_its_poses_see(lumpy):
    scene, X, points, normals = lumpy
    turns = turns_see(scene, SCANNER, X[:6], points, normals, poses=12)
    for k in range(6):
        one = seen_by_any(scene, SCANNER, revolution_poses(X[k], 12), points, normals)
        assert (turns[k] == one).all()


def test_many_points_are_taken_in_pieces(lumpy, monkeypatch):
    scene, X, points, normals = lumpy
    whole = sees(scene, SCANNER, X, points, normals)
    monkeypatch.setattr(coverage, "_CHUNK", 97)
    assert (sees(scene, SCANNER, X, points, normals) == whole).all()


def test_threads_say_what_one_says(lumpy, monkeypatch):
    _, X, points, normals = lumpy
    points, normals = np.tile(points, (200, 1)), np.tile(normals, (200, 1))
    assert len(X) * len(points) > 500_000
    said = []
    for count in (1, 2, 4):
        monkeypatch.setenv("OMP_NUM_THREADS", str(count))
        said.append(in_view(SCANNER, X, points, normals))
    assert said[0].any() and (said[0] == said[1]).all() and (said[0] == said[2]).all()


def test_poses_of_a_turn_keep_height_radius_and_inclination():
    X = look_at(np.array([0.5, 0.1, 0.3]), np.array([-1, 0.1, -0.4]), roll=0.3)
    poses = revolution_poses(X, 36)
    np.testing.assert_allclose(poses[0], X, atol=1e-15)
    np.testing.assert_allclose(poses[:, 2, 3], 0.3)
    np.testing.assert_allclose(np.hypot(*poses[:, :2, 3].T), np.hypot(0.5, 0.1))
    np.testing.assert_allclose(poses[:, 2, :3], np.tile(X[2, :3], (36, 1)), atol=1e-12)
    # The table turns with its right hand, so that the scanner turns the other way about the part.
    assert np.arctan2(poses[1, 1, 3], poses[1, 0, 3]) < np.arctan2(0.1, 0.5)


def test_visible_holds_all_that_allowed_poses_see(lumpy):
    scene, X, points, normals = lumpy
    can = visible(scene, SCANNER, points, normals)
    seen = sees(scene, SCANNER, X, points, normals).any(axis=0)
    assert seen.any() and not (seen & ~can).any()


def test_visible_grows_with_what_is_known_and_with_directions(lumpy):
    scene, _, points, normals = lumpy
    can = visible(scene, SCANNER, points, normals)
    known = np.arange(len(points)) % 2 == 0
    assert (visible(scene, SCANNER, points, normals, seen=known) == (can | known)).all()
    few = visible(scene, SCANNER, points, normals, directions=16)
    assert few.sum() <= can.sum()
    lone = visible(scene, replace(SCANNER, baseline=0.0), points, normals)
    assert not (can & ~lone).any()


def test_visible_knows_a_wall_from_its_inside():
    """A closed box hides its own inside and, on a table, its base; all else can be seen."""
    part = box_part(0.2, 0.2, 0.2)
    samples = surface_samples(part, 600, rng=np.random.default_rng(0))
    scene = scene_from(part.vertices, part.triangles, table_radius=0.76)
    can = visible(scene, SCANNER, samples.points, samples.normals)
    assert (can == (samples.normals[:, 2] > -0.5)).all()
    assert not visible(scene, SCANNER, samples.points, -samples.normals).any()


@pytest.mark.parametrize("n", [1, 10, 256, 5000])
def test_directions_are_even(n):
    u = hemisphere(n)
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1)
    assert (u[:, 2] > 0).all() and u[:, 2].mean() == pytest.approx(0.5)
    x, y = tangents(u)
    np.testing.assert_allclose(np.cross(x, y), u, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 8))
def test_greedy_covers_within_its_bound_of_the_best(seed, n, m):
    rng = np.random.default_rng(seed)
    matrix = rng.random((n, m)) < 0.4
    weights, cost = rng.integers(1, 5, m).astype(float), rng.uniform(0.5, 3.0, n)
    chosen = greedy_cover(matrix, weights, cost=cost)
    assert len(set(chosen)) == len(chosen)
    coverable = matrix.any(axis=0)
    assert (matrix[chosen].any(axis=0) == coverable).all() if chosen else not coverable.any()
    least = min(
        cost[list(rows)].sum()
        for k in range(n + 1)
        for rows in combinations(range(n), k)
        if (matrix[list(rows)].any(axis=0) == coverable).all()
    )
    assert least - 1e-9 <= cost[chosen].sum() <= (np.log(m) + 1) * least + 1e-9
    # None can be spared.
    for row in chosen:
        rest = [r for r in chosen if r != row]
        assert (matrix[rest].any(axis=0) != coverable).any()


def test_greedy_drops_what_later_rows_made_redundant():
    matrix = np.zeros((3, 6), bool)
    matrix[0, 1:5] = matrix[1, :3] = matrix[2, 3:] = True
    assert greedy_cover(matrix, np.ones(6)) == [1, 2]


def test_greedy_stops_at_its_target_and_at_its_most():
    matrix = np.eye(10, dtype=bool)
    weights = np.arange(1.0, 11.0)
    assert greedy_cover(matrix, weights, max_views=3) == [9, 8, 7]
    half = greedy_cover(matrix, weights, target=0.5)
    assert weights[half].sum() >= 0.5 * weights.sum() > weights[half[:-1]].sum()
    assert greedy_cover(np.zeros((4, 5), bool), np.ones(5)) == []


def test_greedy_weighs_against_cost():
    matrix = np.array([[1, 1, 1], [1, 1, 0], [0, 0, 1]], bool)
    assert greedy_cover(matrix, np.ones(3), cost=np.array([10.0, 1.0, 1.0])) == [1, 2]
    assert greedy_cover(matrix, np.ones(3), cost=np.array([1.0, 1.0, 1.0])) == [0]
