"""The local step as pure geometry: frontier, closed model, candidates and choice, without any robot."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from rounds import AROUND, COSTS, SCANNER, VOXEL, Rounds, block_with_pit, blocked, boxes, frames
from scipy.spatial import cKDTree

from scanmotion.core.errors import HoleError
from scanmotion.core.part import Part
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.sensing.closed_surface import closed_model, surface_nets, without_pinches
from scanmotion.sensing.free_space import Space
from scanmotion.sensing.visibility import hemisphere, scene_from, sees, visible
from scanmotion.views.candidate_views import CandidateOptions, candidates
from scanmotion.views.next_best_views import (
    SelectOptions,
    local_step,
)
from scanmotion.views.stepped_rotary import stepped_rotary
from scanmotion.views.targets import Targets

LONE = replace(SCANNER, baseline=0.0)
EDGE, EDGE_OF_CELLS = 0.002, VOXEL
COARSE = CandidateOptions(seeds=25, directions=60, per_seed=20)
SIZE, PIT = (0.2, 0.15, 0.2), (0.05, 0.05, 0.08)


def step_of(height):
    """Two blocks that make a stair with its riser in x = 0, its lower tread in z = 0."""
    vertices, triangles = boxes(
        ([-0.1, -0.1, -0.02], [0.1, 0.1, 0.0]), ([-0.1, -0.1, 0.0], [0.0, 0.1, height])
    )
    return Part(name="stair", vertices=vertices, triangles=triangles)


def in_middle(points):
    return (np.abs(points[:, :2]) < 0.055).all(axis=1) & (points[:, 2] > -EDGE)


def sphere_points(n, radius, centre):
    upper = hemisphere(n)
    u = np.vstack([upper, upper * [1, 1, -1]])
    return np.asarray(centre) + radius * u, u


def is_watertight(triangles):
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there, back = {tuple(e) for e in edges.tolist()}, {tuple(e[::-1]) for e in edges.tolist()}
    return there == back and len(there) == len(edges)


def volume(vertices, triangles):
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@pytest.mark.parametrize("height", [0.006, 0.01, 0.016])
@pytest.mark.parametrize("eye", [(-0.5, 0.0, 0.4), (-0.35, 0.0, 0.55)])
def test_the_frontier_of_a_stair_is_the_edge_of_its_shadow(height, eye):
    """The ray over the nosing bounds the shadow: there, and nowhere else, the frontier lies."""
    part, eye = step_of(height), np.array(eye)
    points, images = frames(part, look_at(eye, -eye)[None], LONE)
    space = Space(LONE, edge=EDGE, stride=1, table_z=-1.0)
    space.add(look_at(eye, -eye)[None], images)
    found = space.frontier(points)
    mine = in_middle(found.points)
    # In the plane y = 0: from the nosing (0, height) to the end of the shadow on the tread.
    foot = np.array([-eye[0] * height / (eye[2] - height), 0.0])
    along = foot - [0.0, height]
    reach = np.linalg.norm(along)
    along /= reach
    out = np.array([-along[1], along[0]])
    flat = found.points[mine][:, [0, 2]] - [0.0, height]
    assert mine.any()
    # A cell of unknown space beside the lit side, no deeper than the margin and a cell's half diagonal.
    off = flat @ out
    assert (off < 0.5 * EDGE).all() and (off > -2.5 * EDGE).all()
    assert (flat @ along > 0).all() and (flat @ along < reach + EDGE).all()
    assert (found.normals[mine][:, [0, 2]] @ out > 0.8).all()
    # And all of it that lies two or three cells from what was measured is found.
    s = np.linspace(0, reach, 200)
    line = np.column_stack([s * along[0], np.zeros(200), height + s * along[1]])
    gap = cKDTree(points).query(line, p=1)[0]
    line = line[(gap > 2.5 * EDGE) & (gap < 3 * EDGE)]
    assert len(line)
    assert cKDTree(found.points).query(line)[0].max() < 2 * EDGE


def test_a_second_look_from_the_other_side_closes_the_frontier():
    part, eye = step_of(0.01), np.array([-0.5, 0.0, 0.4])
    X = np.array([look_at(eye * [s, 1, 1], -eye * [s, 1, 1]) for s in (1, -1)])
    space = Space(LONE, edge=EDGE, stride=1, table_z=-1.0)
    points, images = frames(part, X[:1], LONE)
    space.add(X[:1], images)
    assert in_middle(space.frontier(points).points).any()
    more, images = frames(part, X[1:], LONE)
    space.add(X[1:], images)
    later = space.frontier(np.concatenate([points, more]))
    assert not in_middle(later.points).any()
    # Frame by frame is as good as at once.
    once = Space(LONE, edge=EDGE, stride=1, table_z=-1.0)
    once.add(X, np.concatenate([frames(part, X[k : k + 1], LONE)[1] for k in (0, 1)]))
    assert (once.passed(line_points(500)) == space.passed(line_points(500))).all()


def line_points(n):
    return np.random.default_rng(4).uniform([-0.1, -0.1, -0.02], [0.1, 0.1, 0.15], (n, 3))


def test_a_convex_part_seen_from_all_sides_has_no_frontier():
    vertices = sphere_points(1500, 0.07, [0, 0, 0])[0]
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices)
    corners = vertices[hull.simplices]
    turned = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
                       corners.mean(axis=1)) < 0  # fmt: skip
    triangles = np.where(turned[:, None], hull.simplices[:, ::-1], hull.simplices)
    part = Part(name="ball", vertices=vertices, triangles=triangles)
    u = sphere_points(20, 1.0, [0, 0, 0])[1]
    X = np.array([look_at(0.5 * d, -d) for d in u])
    points, images = frames(part, X, LONE, stride=2)
    space = Space(LONE, edge=EDGE, stride=2, table_z=-1.0)
    space.add(X, images)
    assert len(space.frontier(points).points) == 0
    # From one side the frontier stands round the cap that the incidence limit leaves.
    space = Space(LONE, edge=EDGE, stride=2, table_z=-1.0)
    points, images = frames(part, X[:1], LONE, stride=2)
    space.add(X[:1], images)
    found = space.frontier(points).points
    # The rays through the cap's rim, where incidence meets its limit, make a cone about the axis.
    line = found - 0.5 * u[0]
    length = np.linalg.norm(line, axis=1)
    angle = np.arccos(-line @ u[0] / length)
    rim = np.arcsin(0.07 * np.sin(LONE.max_incidence) / 0.5)
    assert len(found) > 50
    assert np.abs((angle - rim) * length).max() < 2.5 * EDGE


def test_passed_is_the_projection_into_the_images():
    part, eye = step_of(0.02), np.array([-0.4, 0.1, 0.5])
    X = look_at(eye, -eye)
    _, images = frames(part, X[None], LONE)
    space = Space(LONE, edge=EDGE, stride=1, table_z=-1.0)
    assert not space.passed(line_points(5)).any()
    space.add(X[None], images)
    places = line_points(4000)
    x, y, z = ((places - X[:3, 3]) @ X[:3, :3]).T
    h, w = images.shape[1:]
    u, v = x / (z * np.tan(LONE.fov[0] / 2)), y / (z * np.tan(LONE.fov[1] / 2))
    column, row = ((u + 1) / 2 * w).astype(int).clip(0, w - 1), ((v + 1) / 2 * h).astype(int).clip(0, h - 1)
    expected = (np.abs(u) < 1) & (np.abs(v) < 1) & (images[0, row, column] > z + EDGE)
    assert (space.passed(places) == expected).all() and 0.1 < expected.mean() < 0.9


@pytest.fixture(scope="module")
def ball():
    """A dense cloud of a ball of 60 mm with a bite out of its data on top."""
    points, normals = sphere_points(20_000, 0.06, [0.0, 0.0, 0.1])
    keep = normals[:, 2] < np.cos(np.deg2rad(25))
    return points[keep], normals[keep]


def test_the_closed_model_is_watertight_and_near_the_points(ball):
    points, normals = ball
    model = closed_model(points, normals, spacing=0.002, table_z=0.0)
    assert is_watertight(model.triangles)
    assert volume(model.vertices, model.triangles) == pytest.approx(4 / 3 * np.pi * 0.06**3, rel=0.05)
    assert model.area == pytest.approx(4 * np.pi * 0.06**2, rel=0.05)
    near = model.distance < model.cell
    radius = np.linalg.norm(model.centres - [0, 0, 0.1], axis=1)
    assert np.abs(radius[near] - 0.06).max() < model.cell and near.mean() > 0.85
    assert cKDTree(model.vertices).query(points)[0].max() < 1.5 * model.cell
    # What is guessed lies where the bite is.
    far = model.centres[model.distance > 2 * model.cell]
    assert len(far) and (far[:, 2] > 0.1 + 0.05 * np.cos(np.deg2rad(25))).all()
    outward = np.einsum("ij,ij->i", model.crosses, model.centres - [0, 0, 0.1])
    assert (outward > 0).mean() > 0.999


def test_the_closed_model_is_the_same_to_the_last_bit(ball):
    one, two = (closed_model(*ball, spacing=0.002) for _ in range(2))
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.triangles.tobytes() == two.triangles.tobytes()
    order = np.random.default_rng(0).permutation(len(ball[0]))
    shuffled = closed_model(ball[0][order], ball[1][order], spacing=0.002)
    assert shuffled.triangles.shape == one.triangles.shape
    np.testing.assert_allclose(shuffled.vertices, one.vertices, atol=1e-6)


def test_nothing_is_solid_under_the_table(ball):
    points, normals = ball
    upper = points[:, 2] > 0.1
    model = closed_model(points[upper], normals[upper], spacing=0.002, table_z=0.1)
    assert is_watertight(model.triangles) and model.vertices[:, 2].min() > 0.1 - 2 * model.cell
    assert volume(model.vertices, model.triangles) == pytest.approx(2 / 3 * np.pi * 0.06**3, rel=0.1)


def test_what_frames_looked_through_is_carved_from_the_guess_alone(ball):
    points, normals = ball
    whole = closed_model(points, normals, spacing=0.002)
    # A shaft straight down into the guess; the frames claim to have passed the measured wall too.
    shaft = lambda p: (np.hypot(p[:, 0], p[:, 1]) < 0.012) & (p[:, 2] > 0.11)  # noqa: E731
    carved = whole.measured(points, shaft)
    assert is_watertight(carved.triangles)
    lost = volume(whole.vertices, whole.triangles) - volume(carved.vertices, carved.triangles)
    top = whole.centres[np.hypot(*whole.centres[:, :2].T) < 0.006][:, 2].max()
    assert lost == pytest.approx(np.pi * 0.012**2 * (top - 0.11), rel=0.2)
    again = closed_model(points, normals, spacing=0.002, passed=shaft)
    assert again.vertices.tobytes() == carved.vertices.tobytes()
    all_ = whole.measured(points, lambda p: np.ones(len(p), bool))
    assert cKDTree(all_.vertices).query(points)[0].max() < 2.5 * whole.cell
    # Nothing passed, nothing changed but the distances.
    kept = whole.measured(points[::2], lambda p: np.zeros(len(p), bool))
    assert kept.vertices is whole.vertices
    np.testing.assert_allclose(kept.distance, cKDTree(points[::2]).query(whole.centres)[0])


def test_clouds_that_bound_nothing_are_refused(ball):
    points, normals = ball
    with pytest.raises(HoleError, match="49 points are too few"):
        closed_model(points[:49], normals[:49], spacing=0.002)


@pytest.mark.parametrize("seed", range(5))
def test_nets_of_noise_are_watertight(seed):
    values = np.random.default_rng(seed).standard_normal((12, 11, 10))
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = -1.0
    solid = without_pinches(values)
    assert ((solid > 0) >= (values > 0)).all()
    _, triangles = surface_nets(-solid)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert is_watertight(triangles)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_candidates_have_both_eyes_free():
    blocks = (([-0.1, -0.1, 0.0], [0.1, 0.1, 0.15]), ([-0.02, -0.15, 0.15], [0.02, 0.15, 0.3]))
    disc = ([-0.76, -0.76, -0.1], [0.76, 0.76, -1e-4])
    vertices, triangles = boxes(*blocks)
    scene = scene_from(vertices, triangles, table_radius=0.76)
    targets = np.array([[0.06, 0.0, 0.15], [-0.1, 0.02, 0.05], [0.02, 0.1, 0.2], [0.05, -0.1, 0.1]])
    normals = np.array([[0, 0, 1.0], [-1, 0, 0], [1, 0, 0], [0, -1, 0]])
    found = candidates(
        scene, SCANNER, Targets(points=targets, normals=normals, areas=np.ones(4)), solid=vertices,
        table=AROUND,
    )  # fmt: skip
    poses, turns = found.X_OS, found.turns
    stations = poses[~turns]
    assert len(stations) > 50 and turns.sum() > 50
    to = targets[None] - stations[:, None, :3, 3]
    depth = np.einsum("ijk,ik->ij", to, stations[:, :3, 2])
    beside = np.linalg.norm(to - depth[..., None] * stations[:, None, :3, 2], axis=2)
    seed = np.argmin(beside, axis=1)
    assert beside.min(axis=1).max() < 1e-9
    assert set(seed) == {0, 1, 2, 3}
    np.testing.assert_allclose(np.linalg.det(stations[:, :3, :3]), 1.0)
    for X, k in zip(stations, seed, strict=True):
        start = targets[k] + 0.001 * normals[k]
        for eye in (X[:3, 3], X[:3, 3] + SCANNER.baseline * X[:3, 0]):
            assert eye[2] > 0
            assert not blocked(blocks, start, eye)
            assert np.hypot(*eye[:2]) > 0.76 or not blocked([disc], start, eye)
    # Nearly all of them measure their seed: the rest is beyond the projector's incidence.
    seen = sees(scene, SCANNER, stations, targets, normals)
    assert seen[np.arange(len(stations)), seed].mean() > 0.9
    assert (found.sees[~turns] == seen).all()
    assert found.known.all() and found.reached.all()


def scanned(part, **options):
    rounds = Rounds(part, **options)
    rounds.turn(
        stepped_rotary(
            float(part.extent[0]), float(part.extent[1]), float(part.extent[2]), SCANNER
        ).viewpoints
    )
    return rounds


@pytest.fixture(scope="module")
def pit():
    """The pit after its global step, and after two local rounds."""
    rounds = scanned(block_with_pit(SIZE, PIT))
    before = rounds.seen.copy()
    assert rounds.cloud is not None
    first = {
        "points": rounds.cloud.points, "normals": rounds.cloud.normals,
        "space": deepcopy(rounds.space),
    }  # fmt: skip
    for _ in range(2):
        rounds.local()
    return rounds, before, first


def again(first, **given):
    """The first local step of the pit, with other wishes."""
    given = {"options": SelectOptions(candidates=COARSE), **given}
    return local_step(
        first["points"], first["normals"], (), SCANNER, spacing=VOXEL, table=AROUND, costs=COSTS,
        space=deepcopy(first["space"]), rng=np.random.default_rng(5), **given,
    )  # fmt: skip


def test_the_local_step_sees_a_pit_down_to_its_bottom(pit):
    rounds, before, _ = pit
    p = rounds.samples.points
    inside = (np.abs(p[:, :2]) < PIT[0] / 2 + 1e-4).all(axis=1) & (p[:, 2] < SIZE[2] - 1e-4)
    inside &= p[:, 2] > 0.01
    bottom = inside & (p[:, 2] < SIZE[2] - PIT[2] + 1e-4)
    can = visible(rounds.scene, SCANNER, p, rounds.samples.normals, seen=rounds.seen)
    assert can[bottom].all() and not before[bottom].any()
    assert rounds.seen[bottom].mean() > 0.98 and rounds.seen[inside & can].mean() > 0.95
    assert rounds.seen.sum() / can.sum() > 0.99 > before.sum() / can.sum()


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "least"), [((0.05, 0.05, 0.12), 0.98), ((0.09, 0.06, 0.15), 0.98)])
def test_deeper_pits_are_followed_in_three_rounds(shape, least):
    rounds = scanned(block_with_pit(SIZE, shape))
    for _ in range(3):
        rounds.local()
    p = rounds.samples.points
    can = visible(rounds.scene, SCANNER, p, rounds.samples.normals, seen=rounds.seen)
    bottom = (np.abs(p[:, :2]) < 0.024).all(axis=1) & (np.abs(p[:, 2] - SIZE[2] + shape[2]) < 1e-4)
    assert rounds.seen[bottom & can].mean() > 0.95
    assert rounds.seen.sum() / can.sum() > least


def test_a_seen_convex_part_asks_for_nothing():
    rounds = scanned(box_part(0.2, 0.15, 0.1))
    step = rounds.local()
    assert step.viewpoints == () and step.gains == ()
    assert sum(p.area for p in step.unseen) < 2e-4


def test_viewpoints_see_what_the_step_claims(pit):
    rounds, _, _ = pit
    step = rounds.steps[0]
    assert len(step.viewpoints) == len(step.gains) > 0
    assert cKDTree(step.targets).query(step.claimed)[0].max() == 0
    assert len(step.claimed) <= len(step.targets)
    assert [v.id for v in step.viewpoints] == [f"L{n}" for n in range(1, len(step.viewpoints) + 1)]
    assert all(v.step == "local" for v in step.viewpoints)


def test_claimed_targets_are_not_tried_again(pit):
    _, _, first = pit
    before = again(first)
    after = again(first, claimed=before.claimed)
    if len(after.targets):
        assert cKDTree(before.claimed).query(after.targets)[0].min() > 1.5 * before.model.cell
    nothing = again(first, claimed=before.targets)
    assert len(nothing.targets) < 0.1 * len(before.targets)


def test_the_same_draws_choose_the_same(pit):
    one, two = again(pit[2]), again(pit[2])
    assert np.array_equal([v.X_OS for v in one.viewpoints], [v.X_OS for v in two.viewpoints])
    assert np.array_equal(one.targets, two.targets) and one.gains == two.gains


def seconds_of(step):
    """What the step's viewpoints cost in their order: each its own time and the nearest way."""
    place = np.array([[np.hypot(*v.p_OS[:2]), v.p_OS[2]] for v in step.viewpoints])
    own = [COSTS.station_s if v.kind == "station" else COSTS.revolution_s for v in step.viewpoints]
    way = [
        min([0.3, *np.linalg.norm(place[:k] - place[k], axis=1)] if k else [0.3]) for k in range(len(place))
    ]
    return sum(own) + COSTS.seconds_per_metre * sum(way)


@pytest.mark.parametrize("seconds", [0.0, 6.0, 12.0, np.inf])
def test_the_seconds_are_kept(pit, seconds):
    step = again(pit[2], seconds=seconds)
    if len(step.viewpoints):
        assert seconds_of(step) <= seconds + 1e-6
    else:
        assert seconds < COSTS.station_s + 0.3 * COSTS.seconds_per_metre
        assert {p.reason for p in step.unseen} >= {"not worth its seconds"}


@pytest.mark.parametrize("rate", [1e-6, 2.5e-5, 2e-4, 1.0])
def test_the_least_rate_is_kept(pit, rate):
    step = again(pit[2], options=SelectOptions(candidates=COARSE, least_rate=rate))
    for v, gain in zip(step.viewpoints, step.gains, strict=True):
        own = COSTS.station_s if v.kind == "station" else COSTS.revolution_s
        assert gain / (own + 0.1 * COSTS.seconds_per_metre) >= rate * step.model.area
    if rate == 1.0:
        assert step.viewpoints == () and len(step.claimed) == 0


def test_at_most_so_many_are_chosen(pit):
    assert (
        len(again(pit[2], options=SelectOptions(candidates=COARSE, most=1, least_rate=1e-6)).viewpoints) == 1
    )


def test_only_what_is_reached_is_chosen(pit):
    def high(X_OS):
        return X_OS[:, 2, 3] > 0.9

    step = again(pit[2], reachable=high)
    assert step.viewpoints and all(v.p_OS[2] > 0.9 for v in step.viewpoints)


def test_reasons_are_true(pit):
    first = pit[2]
    free, bound = again(first), again(first, reachable=lambda X: np.zeros(len(X), bool))
    assert "cannot be reached" not in {p.reason for p in free.unseen}
    assert bound.viewpoints == () and len(bound.claimed) == 0
    by_reason = {}
    for patch in bound.unseen:
        by_reason[patch.reason] = by_reason.get(patch.reason, 0.0) + patch.area
    assert set(by_reason) <= {"cannot be seen", "cannot be reached"}
    assert by_reason["cannot be reached"] > 1e-4
    # What can be seen when all is reached is just what cannot be reached when nothing is.
    unseen = sum(p.area for p in free.unseen if p.reason == "cannot be seen")
    assert by_reason.get("cannot be seen", 0.0) == pytest.approx(unseen)
    total = sum(p.area for p in bound.unseen)
    assert sum(p.area for p in free.unseen) < total
    areas = [p.area for p in bound.unseen]
    assert areas == sorted(areas, reverse=True)


def test_a_shaft_that_no_eye_can_enter_is_listed_as_such():
    """18 mm wide and 190 mm deep: camera and projector, 150 mm apart, never see its bottom together."""
    rounds = scanned(block_with_pit(SIZE, (0.018, 0.018, 0.19)))
    for _ in range(2):
        rounds.local()
    p = rounds.samples.points
    deep = (np.abs(p[:, :2]) < 0.00901).all(axis=1) & (p[:, 2] < 0.14) & (p[:, 2] > 0.001)
    assert deep.sum() > 50
    assert not visible(rounds.scene, SCANNER, p[deep], rounds.samples.normals[deep]).any()
    near = [q for q in rounds.steps[-1].unseen if np.hypot(*q.center[:2]) < 0.012 and q.center[2] < 0.2]
    assert near and max(near, key=lambda q: q.area).reason == "cannot be seen"


def test_gains_are_what_each_adds_alone(pit):
    """Together they weigh no more than the targets that are claimed."""
    step = again(pit[2])
    assert all(g > 0 for g in step.gains)
    weight = EDGE_OF_CELLS**2 * len(step.claimed)
    assert sum(step.gains) <= max(weight, step.model.area * len(step.claimed) / 10_000) + 1e-9


def test_the_pitted_block_is_what_it_says():
    part = block_with_pit(SIZE, PIT)
    assert is_watertight(part.triangles)
    assert volume(part.vertices, part.triangles) == pytest.approx(np.prod(SIZE) - np.prod(PIT))
