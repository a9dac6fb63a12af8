"""The judge's distances: bounds that never lie, FCL against closed forms, shortcuts without effect."""

import itertools
from types import SimpleNamespace

import fcl
import numpy as np
import pytest
from judged_plan import Written, hand_made_files
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge import contact
from scanmotion.judge.contact import STEP_M, Block, blocks, exact_distance, separation
from scanmotion.judge.motion import arm_from_urdf, motion_at
from scanmotion.judge.solids import PART, STILL, Solid, pairs_of, solids_of
from scanmotion.plan_io.read import read_plan, read_trajectory


def random_poses(rng, n, reach):
    X = np.tile(np.eye(4), (n, 1, 1))
    X[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
    X[:, :3, 3] = rng.uniform(-reach, reach, (n, 3))
    return X


def box_distance(Xa, half_a, Xb, half_b):
    """Distance of two boxes as a bounded least-squares problem in their own coordinates."""
    A = np.hstack([Xa[:3, :3], -Xb[:3, :3]])
    bound = np.concatenate([half_a, half_b])
    return np.sqrt(2 * lsq_linear(A, Xb[:3, 3] - Xa[:3, 3], (-bound, bound), tol=1e-12).cost)


def solid(shape, half, name="a", group=1):
    return Solid(
        name=name, group=group, shape=fcl.CollisionObject(shape, fcl.Transform()), half=np.asarray(half),
        X_CG=np.eye(4),
    )  # fmt: skip


def box(half, **more):
    return solid(fcl.Box(*(2 * np.asarray(half))), half, **more)


def mesh_box(half, **more):
    part = box_part(*(2 * np.asarray(half)))
    vertices = part.vertices - (part.vertices.max(axis=0) + part.vertices.min(axis=0)) / 2
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(part.triangles))
    model.addSubModel(vertices, part.triangles)
    model.endModel()
    return solid(model, half, **more)


def at(x, y, z):
    X = np.eye(4)
    X[:3, 3] = x, y, z
    return X


# Bounds and distances


def test_the_separation_of_boxes_is_a_lower_bound_and_exact_for_overlap(rng):
    n = 400
    Xa, Xb = random_poses(rng, n, 0.5), random_poses(rng, n, 0.5)
    half_a, half_b = np.array([0.3, 0.1, 0.02]), np.array([0.15, 0.2, 0.4])
    gap = separation(Xa, half_a, Xb, half_b)
    true = np.array([box_distance(a, half_a, b, half_b) for a, b in zip(Xa, Xb, strict=True)])
    assert (gap <= true + 1e-7).all()
    clear = np.abs(gap) > 1e-6
    assert ((gap[clear] > 0) == (true[clear] > 1e-7)).all()
    assert 0.2 < (gap > 0).mean() < 0.8


def test_the_separation_along_a_face_or_two_edges_is_the_distance():
    half = np.array([0.1, 0.2, 0.3])
    face = separation(np.eye(4)[None], half, at(0.1 + 0.3 + 0.07, 0, 0)[None], half[::-1].copy())
    assert face == pytest.approx([0.07])
    # Two crossed edges: each box stands on its edge, turned by 45 deg about x and about y.
    cube = np.full(3, 0.1)
    Xa, Xb = np.eye(4), at(0, 0, 2 * 0.1 * np.sqrt(2) + 0.05)
    Xa[:3, :3] = Rotation.from_rotvec([np.pi / 4, 0, 0]).as_matrix()
    Xb[:3, :3] = Rotation.from_rotvec([0, np.pi / 4, 0]).as_matrix()
    assert separation(Xa[None], cube, Xb[None], cube) == pytest.approx([0.05])


def test_parallel_boxes_do_not_upset_the_separation():
    half = np.array([0.1, 0.1, 0.1])
    X = at(0.15, 0.15, 0.0)
    X[:3, :3] = Rotation.from_rotvec([0, 0, 1e-9]).as_matrix()
    assert separation(np.eye(4)[None], half, X[None], half)[0] < 0


@pytest.mark.parametrize("make", [box, mesh_box], ids=["box", "triangles"])
def test_fcl_measures_the_distance_of_boxes(make, rng):
    half_a, half_b = np.array([0.3, 0.1, 0.02]), np.array([0.15, 0.2, 0.4])
    a, b = box(half_a), make(half_b)
    near = 0
    for Xa, Xb in zip(random_poses(rng, 150, 0.5), random_poses(rng, 150, 0.5), strict=True):
        true = box_distance(Xa, half_a, Xb, half_b)
        found = exact_distance(a, b, Xa, Xb)
        near += true > 1e-6
        if true > 1e-6:
            assert found == pytest.approx(true, abs=2e-6)
            assert exact_distance(a, b, Xa, Xb, needed=False) == 0
        elif make is box or not holds(Xa, half_a, Xb, half_b):
            assert found < 1e-6
    assert 30 < near < 120


def holds(Xa, half_a, Xb, half_b):
    """Whether box a lies inside box b, where b's surface does not touch it."""
    corners = np.array(np.meshgrid(*([[-1, 1]] * 3))).reshape(3, -1).T * half_a
    inside = (corners @ Xa[:3, :3].T + Xa[:3, 3] - Xb[:3, 3]) @ Xb[:3, :3]
    return bool((np.abs(inside) < half_b).all())


def test_fcl_measures_the_distance_of_cylinders_and_spheres():
    cylinder = solid(fcl.Cylinder(0.2, 0.5), [0.2, 0.2, 0.25])
    ball, cube = solid(fcl.Sphere(0.1), [0.1] * 3), box([0.1, 0.1, 0.1])
    for other, p, distance in (
        (ball, (0.3, 0.4, 0.1), 0.2),
        (ball, (0, 0, 0.25 + 0.1 + 0.03), 0.03),
        (cube, (0.05, 0, 0.25 + 0.1 + 0.03), 0.03),
        (cube, (0.2 + 0.1 + 0.03, 0, 0), 0.03),
    ):
        assert exact_distance(cylinder, other, np.eye(4), at(*p)) == pytest.approx(distance, abs=1e-5)
    assert exact_distance(cylinder, cube, np.eye(4), at(0.29, 0, 0)) < 0


# Which configurations are looked at


@pytest.fixture(scope="module")
def hand(tmp_path_factory):
    folder = Written(hand_made_files()).write(tmp_path_factory.mktemp("hand") / "plan")
    record = read_plan(folder)
    arm = arm_from_urdf((folder / "robot.urdf").read_text(), record.robot_joints, record.flange_link)
    return SimpleNamespace(
        folder=folder, record=record, arm=arm, solids=solids_of(folder, record, arm),
        trajectory=read_trajectory(folder, record),
    )  # fmt: skip


START = np.deg2rad([0, -60, 110, 0, 40, 0, 0])
LOW = np.deg2rad([0, -45, 105, 0, 40, 0, 0])
FOLDED = np.deg2rad([0, -128, 160, 0, 40, 0, 0])


def random_walk(hand, rng, n=40, step=0.15, start=START):
    """A short rough trajectory."""
    low = np.deg2rad([-40, -135, 60, -180, -100, -180, -400])
    high = np.deg2rad([40, -20, 165, 180, 100, 180, 400])
    q = np.empty((n, 7))
    q[0] = start
    for k in range(1, n):
        q[k] = np.clip(q[k - 1] + rng.normal(0, step, 7), low, high)
    return SimpleNamespace(t=0.01 * np.arange(n), q=q)


def corners_of(solids, motion):
    """Corners of every solid's box in W, shape (solids, N, 8, 3)."""
    signs = np.array(np.meshgrid(*([[-1, 1]] * 3))).reshape(3, -1).T
    out = []
    for s in solids:
        X = np.broadcast_to(s.poses(motion), (len(motion.t), 4, 4))
        out.append(X[:, None, :3, 3] + (signs * s.half) @ np.swapaxes(X[:, :3, :3], 1, 2))
    return np.array(out)


def test_nothing_moves_farther_than_a_step_between_two_configurations(hand, rng):
    walk = random_walk(hand, rng)
    (block,) = blocks(hand.record, walk, hand.arm, hand.solids)
    assert block.t[0] == walk.t[0] and block.t[-1] == walk.t[-1]
    motion = motion_at(hand.arm, hand.record, block.t, block.q)
    moving = [s for s in hand.solids if s.group != STILL]
    hops = np.linalg.norm(np.diff(corners_of(moving, motion), axis=1), axis=3).max(axis=2)
    part = np.array([s.group == PART for s in moving])
    assert (hops[~part].max(axis=0) + hops[part].max(axis=0)).max() <= STEP_M
    assert block.way[-1] >= (hops[~part].max(axis=0) + hops[part].max(axis=0)).sum()
    # The way leads through every sample.
    for q in walk.q:
        near = np.argsort(np.abs(block.q - q).max(axis=1))[0]
        poses = motion_at(hand.arm, hand.record, np.zeros(2), np.array([q, block.q[near]]))
        gap = np.linalg.norm(np.diff(corners_of(moving, poses), axis=1), axis=3)
        assert gap.max() <= STEP_M


def test_a_jump_is_walked_through(hand):
    # A whole turn of the table in one sample: start and end look the same.
    walk = SimpleNamespace(t=np.array([0.0, 0.01]), q=np.zeros((2, 7)) + np.deg2rad([0, -90, 90, 0, 0, 0, 0]))
    walk.q[1, 6] += 2 * np.pi
    (block,) = blocks(hand.record, walk, hand.arm, hand.solids)
    part = next(s for s in hand.solids if s.group == PART)
    corner = float(np.linalg.norm(part.X_CG[:2, 3]) + np.linalg.norm(part.half[:2]))
    assert 2 * np.pi * corner <= block.way[-1] <= 2 * np.pi * part.radius * 1.01 + 2 * np.pi * 0.01
    assert len(block.t) >= 2 * np.pi * corner / STEP_M


def test_blocks_are_cut_where_the_last_one_ends(hand, monkeypatch, rng):
    walk = random_walk(hand, rng, n=30)
    (whole,) = blocks(hand.record, walk, hand.arm, hand.solids)
    monkeypatch.setattr(contact, "_BLOCK", 37)
    parts = list(blocks(hand.record, walk, hand.arm, hand.solids))
    assert len(parts) > 3
    for a, b in itertools.pairwise(parts):
        assert np.array_equal(a.q[-1], b.q[0]) and a.t[-1] == b.t[0]
    assert sum(p.way[-1] - p.way[0] for p in parts) == pytest.approx(whole.way[-1], rel=1e-9)


def test_a_trajectory_that_stands_still_is_one_step(hand):
    q = np.tile(np.deg2rad([0, -90, 90, 0, 0, 0, 0.0]), (50, 1))
    walk = SimpleNamespace(t=0.01 * np.arange(50), q=q)
    (block,) = blocks(hand.record, walk, hand.arm, hand.solids)
    assert len(block.t) == 2 and block.way[-1] == 0


# The verdict


def exhaustive(hand, walk, clearance):
    """Least distance of every pair over all configurations, with FCL asked for each."""
    least = {}
    for block in blocks(hand.record, walk, hand.arm, hand.solids):
        motion = motion_at(hand.arm, hand.record, block.t, block.q)
        for a, b, allowed in pairs_of(hand.solids, clearance, hand.arm.joined, {}):
            Xa, Xb = (np.broadcast_to(s.poses(motion), (len(block.t), 4, 4)) for s in (a, b))
            found = [exact_distance(a, b, Xa[k], Xb[k], needed=allowed > 0) for k in range(len(block.t))]
            if min(found) < allowed:
                least[a.name, b.name] = min(found), float(block.t[int(np.argmin(found))])
    return least


def quick(hand, walk, clearance):
    worst = {}
    for block in blocks(hand.record, walk, hand.arm, hand.solids):
        motion = motion_at(hand.arm, hand.record, block.t, block.q)
        for a, b, allowed in pairs_of(hand.solids, clearance, hand.arm.joined, {}):
            contact._judge_pair(a, b, a.poses(motion), b.poses(motion), allowed, block, worst)
    return worst


@pytest.mark.parametrize("clearance", [0.0, 0.03, 0.15])
@pytest.mark.parametrize(
    ("start", "met"), [(START, "table"), (LOW, "part"), (FOLDED, "link_4_0")], ids=["over", "low", "folded"]
)
def test_the_verdict_is_the_exhaustive_one(hand, start, met, clearance):
    walk = random_walk(hand, np.random.default_rng(3), n=4, step=0.1, start=start)
    expected, found = exhaustive(hand, walk, clearance), quick(hand, walk, clearance)
    assert found == expected
    assert met in {name for pair, (distance, _) in expected.items() if distance < 0 for name in pair}


def test_a_pair_is_not_measured_more_often_than_it_can_change(hand, monkeypatch):
    # Two cubes 100 mm apart slide past each other; one distance settles as long a way as it has to spare.
    a, b = box([0.05] * 3), box([0.05] * 3, name="b", group=STILL)
    n = 1000
    Xa = np.tile(np.eye(4), (n, 1, 1))
    Xa[:, 1, 3] = np.linspace(0, 0.05, n)
    Xb = at(0.05 + 0.1 + 0.05, 0, 0)[None]
    block = Block(t=np.arange(n) * 0.01, q=np.zeros((n, 7)), way=Xa[:, 1, 3])
    calls = []
    monkeypatch.setattr(contact, "separation", lambda X, *rest: np.full(len(X), -1.0))
    monkeypatch.setattr(
        contact, "exact_distance", lambda *args, **more: calls.append(1) or exact_distance(*args, **more)
    )
    worst = {}
    contact._judge_pair(a, b, Xa, Xb, 0.03, block, worst)
    assert worst == {} and len(calls) == 1
    contact._judge_pair(a, b, Xa, Xb, 0.095, block, worst)
    assert worst == {} and len(calls) <= 1 + 11
    contact._judge_pair(a, b, Xa, Xb, 0.11, block, worst)
    assert worst["a", "b"][0] == pytest.approx(0.1)


def test_pairs_that_are_looked_at(hand):
    pairs = {(a.name, b.name): allowed for a, b, allowed in pairs_of(hand.solids, 0.03, hand.arm.joined, {})}
    tools = [s.name for s in hand.solids if s.group == 7]
    assert len(tools) == 4
    for name in tools:
        for other in ("part", "table", "table_column", "floor"):
            assert pairs[name, other] == 0.03
    groups = {
        (a.group, b.group)
        for a, b, allowed in pairs_of(hand.solids, 0.03, hand.arm.joined, {})
        if allowed == 0
    }
    touching = {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 7)}
    links = {(i, j) for i in range(8) for j in range(i + 1, 8)} - touching - missing(hand)
    # What turns must not touch the base, either.
    assert groups == links | {(PART, 0), (STILL, 0)}
    assert all(
        (a.group, b.name) != (1, "floor") for a, b, _ in pairs_of(hand.solids, 0.03, hand.arm.joined, {})
    )


def missing(hand):
    """Pairs with a link that has no solid."""
    there = {s.group for s in hand.solids}
    return {(i, j) for i in range(8) for j in range(i + 1, 8) if not {i, j} <= there}
