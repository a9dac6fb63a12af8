"""The arms against closed forms, Drake's plant and finite differences: every branch, none outside limits."""

import functools

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.solvers import Solve

from scanmotion.cell.arm.robot import clean_angle
from scanmotion.cell.build import build_cell
from scanmotion.cell.ik.choice import solver_of
from scanmotion.cell.ik.numeric import NumericArm
from scanmotion.cell.kinematics import (
    branches,
    flange_poses,
    joint_excess,
    link_poses,
    object_poses,
    scanner_in_object,
    scanner_poses,
    tcp_jacobian,
    wrist_shortfall,
)
from scanmotion.cell.settings.cell import settings_from

SPHERICAL = ("kr240", "kr240-ultra", "kr210", "irb6700")
ROBOTS = (*SPHERICAL, "ur10e")
TURN = 2 * np.pi

# Axes and points on them at the zero pose, in base axes, and the flange there: from the lengths alone.
KUKA_W = [[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]]
ABB_W = [[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]]
UR_W = [[0, 0, 1], [0, -1, 0], [0, -1, 0], [0, -1, 0], [0, 0, -1], [0, -1, 0]]
FORWARD_FLANGE = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
"""Rows: flange z = +x, flange x = -z."""


def _kuka(a1, a2, c1, c2, c3, c4):
    p = [[0, 0, 0], [a1, 0, c1], [a1 + c2, 0, c1], *[[a1 + c2 + c3, 0, c1 - a2]] * 3]
    return KUKA_W, p, FORWARD_FLANGE, [a1 + c2 + c3 + c4, 0, c1 - a2]


def _abb(a1, a2, c1, c2, c3, c4):
    p = [[0, 0, 0], [a1, 0, c1], [a1, 0, c1 + c2], *[[a1 + c3, 0, c1 + c2 - a2]] * 3]
    return ABB_W, p, FORWARD_FLANGE, [a1 + c3 + c4, 0, c1 + c2 - a2]


def _ur(d1, a2, a3, d4, d5, d6):
    p = [[0, 0, 0], [0, 0, d1], [a2, 0, d1], [a2 + a3, 0, d1], [a2 + a3, -d4, 0], [a2 + a3, 0, d1 - d5]]
    return UR_W, p, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], [a2 + a3, -d4 - d6, d1 - d5]


SCREWS = {
    "kr240": _kuka(0.330, -0.115, 0.645, 1.350, 1.220, 0.240),
    "kr240-ultra": _kuka(0.350, 0.041, 0.675, 1.350, 1.200, 0.240),
    "kr210": _kuka(0.330, -0.115, 0.645, 1.150, 1.220, 0.215),
    "irb6700": _abb(0.320, -0.200, 0.780, 1.135, 1.1825, 0.200),
    "ur10e": _ur(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
}


def product_of_exponentials(name, q):
    """Flange in the base, shape (4, 4), by the exponentials of the axes' twists."""
    from scipy.linalg import expm

    w, p, R, tip = SCREWS[name]
    X = np.eye(4)
    for axis, point, angle in zip(np.array(w, float), np.array(p, float), q, strict=True):
        twist = np.zeros((4, 4))
        twist[:3, :3] = np.cross(np.eye(3), axis)
        twist[:3, 3] = -np.cross(axis, point)
        X = X @ expm(twist * angle)
    zero = np.eye(4)
    zero[:3, :3], zero[:3, 3] = R, tip
    return X @ zero


@functools.cache
def cell_of(name):
    """The robot at the origin, so that base and world are one."""
    return build_cell(settings_from({"robot": robot_of(name)}))


def robot_of(name):
    return {"model": name, "home_deg": [0, -90, 90, 0, 0, 0] if name.startswith("kr") else [0] * 6}


def random_q(cell, n, seed=0, margin=0.0):
    low, high = cell.q_min[:6] + margin, cell.q_max[:6] - margin
    return np.random.default_rng(seed).uniform(low, high, (n, 6))


def pose_error(cell, found, X):
    return np.abs(scanner_poses(cell, found.q) - X[found.pose_index]).max(initial=0.0)


def nearest(found, q):
    """For each row of q, how far the nearest of its answers is, in the greatest joint."""
    out = np.full(len(q), np.inf)
    np.minimum.at(out, found.pose_index, np.abs(found.q - q[found.pose_index]).max(axis=1))
    return out


FORWARD = {
    ("kr240", (0, 0, 0, 0, 0, 0)): (3.140, 0, 0.760),
    ("kr240", (0, -90, 90, 0, 0, 0)): (1.790, 0, 2.110),
    ("kr240", (15, -75, 110, -20, 35, 50)): (1.781355, -0.428570, 1.124713),
    ("kr240-ultra", (0, 0, 0, 0, 0, 0)): (3.140, 0, 0.634),
    ("kr240-ultra", (0, -90, 90, 0, 0, 0)): (1.790, 0, 1.984),
    ("kr240-ultra", (15, -75, 110, -20, 35, 50)): (1.698420, -0.406347, 1.038397),
    ("kr210", (0, 0, 0, 0, 0, 0)): (2.915, 0, 0.760),
    ("kr210", (0, -90, 90, 0, 0, 0)): (1.765, 0, 1.910),
}


@pytest.mark.parametrize(("name", "degrees"), FORWARD)
def test_forward_kinematics_of_the_published_poses(name, degrees):
    X = flange_poses(cell_of(name), np.deg2rad([degrees]))[0]
    assert np.abs(X[:3, 3] - FORWARD[name, degrees]).max() < 1e-6


@pytest.mark.parametrize("name", ["kr240", "kr240-ultra"])
def test_generic_pose_in_kuka_angles(name):
    # The facts' A, B, C [deg]: turns about z, y', x''.
    a, b, c = np.deg2rad([-158.7481, 24.1078, -176.8023])
    R = flange_poses(cell_of(name), np.deg2rad([[15, -75, 110, -20, 35, 50]]))[0, :3, :3]
    got = np.arctan2(R[1, 0], R[0, 0]), np.arcsin(-R[2, 0]), np.arctan2(R[2, 1], R[2, 2])
    assert np.abs(np.array(got) - (a, b, c)).max() < np.deg2rad(1e-4)


@pytest.mark.parametrize("name", ROBOTS)
def test_forward_kinematics_is_the_product_of_exponentials(name):
    cell = cell_of(name)
    q = random_q(cell, 50)
    want = np.array([product_of_exponentials(name, row) for row in q])
    assert np.abs(flange_poses(cell, q) - want).max() < 1e-9


@functools.cache
def plant_of(name):
    cell = cell_of(name)
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModels(str(cell.urdf_path))
    root = plant.GetJointByName("A1").parent_body()
    plant.WeldFrames(plant.world_frame(), root.body_frame())
    plant.Finalize()
    return plant


@pytest.mark.parametrize("name", ROBOTS)
def test_every_link_stands_where_drake_puts_it(name):
    cell, plant = cell_of(name), plant_of(name)
    context = plant.CreateDefaultContext()
    q = random_q(cell, 20, seed=1)
    ours = link_poses(cell, q)
    for i, row in enumerate(q):
        plant.SetPositions(context, row)
        for link in range(1, 7):
            body = plant.GetJointByName(f"A{link}").child_body()
            theirs = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4()
            assert np.abs(ours[i, link] - theirs).max() < 1e-9


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_are_those_that_drake_reads(name):
    cell, plant = cell_of(name), plant_of(name)
    assert np.allclose(cell.q_min[:6], plant.GetPositionLowerLimits(), atol=1e-9)
    assert np.allclose(cell.q_max[:6], plant.GetPositionUpperLimits(), atol=1e-9)
    assert np.allclose(cell.v_max[:6], plant.GetVelocityUpperLimits(), atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_inverse_holds_the_configuration_that_it_came_from(name):
    cell = cell_of(name)
    q = random_q(cell, 300, seed=2)
    X = scanner_poses(cell, q)
    found = branches(cell, X)
    assert pose_error(cell, found, X) < 1e-8
    assert nearest(found, q).max() < 1e-6


@pytest.mark.parametrize("name", ROBOTS)
def test_answers_are_inside_the_limits_and_all_their_windings_are_there(name):
    cell = cell_of(name)
    X = scanner_poses(cell, random_q(cell, 60, seed=3))
    found, bare = branches(cell, X), branches(cell, X, windings=False)
    assert (found.q >= cell.q_min[:6]).all() and (found.q <= cell.q_max[:6]).all()
    assert (bare.q >= cell.q_min[:6]).all() and (bare.q <= cell.q_max[:6]).all()
    # Brute force: all whole turns of all joints that stay inside.
    for i in range(len(X)):
        rows = found.q[found.pose_index == i]
        want = 0
        for q in bare.q[bare.pose_index == i]:
            turns = TURN * np.arange(-2, 3)
            want += np.prod([
                ((t + turns >= low) & (t + turns <= high)).sum()
                for t, low, high in zip(q, cell.q_min, cell.q_max, strict=False)
            ])  # fmt: skip
        assert len(rows) == want
        assert len(np.unique(rows.round(6), axis=0)) == want


def drake_answers(name, X_WF, seeds):
    """Configurations that Drake's InverseKinematics finds for a flange pose, polished by Newton steps."""
    cell, plant, found = cell_of(name), plant_of(name), []
    flange = plant.GetFrameByName("tool0")
    for seed in seeds:
        ik = InverseKinematics(plant)
        p, R = X_WF[:3, 3], RotationMatrix(X_WF[:3, :3])
        ik.AddPositionConstraint(flange, [0, 0, 0], plant.world_frame(), p - 1e-4, p + 1e-4)
        ik.AddOrientationConstraint(flange, RotationMatrix(), plant.world_frame(), R, 1e-3)
        result = Solve(ik.prog(), seed)
        if not result.is_success():
            continue
        q = result.GetSolution(ik.q())
        for _ in range(8):
            X = flange_poses(cell, q[None])[0]
            turn = RigidTransform(X_WF).rotation().multiply(RotationMatrix(X[:3, :3]).inverse()).ToAngleAxis()
            J = flange_jacobian(cell, q)
            q = q + np.linalg.solve(J, np.append(turn.angle() * turn.axis(), X_WF[:3, 3] - X[:3, 3]))
        if np.abs(flange_poses(cell, q[None])[0] - X_WF).max() < 1e-9:
            found.append(q)
    return found


def flange_jacobian(cell, q):
    links = link_poses(cell, q[None])[0]
    tip = flange_poses(cell, q[None])[0, :3, 3]
    w = np.einsum("kij,kj->ki", links[1:, :3, :3], cell.robot.axes)
    return np.concatenate([w, np.cross(w, tip - links[1:, :3, 3])], axis=1).T


@pytest.mark.parametrize("name", ROBOTS)
def test_what_drake_finds_is_among_the_branches(name):
    cell = cell_of(name)
    q = random_q(cell, 6, seed=4, margin=0.05)
    X = flange_poses(cell, q)
    found = branches(cell, X @ cell.X_FS)
    count = 0
    for i in range(len(q)):
        ours = found.q[found.pose_index == i]
        for theirs in drake_answers(name, X[i], random_q(cell, 6, seed=10 + i)):
            if (theirs < cell.q_min[:6]).any() or (theirs > cell.q_max[:6]).any():
                continue
            count += 1
            assert np.abs(ours - theirs).max(axis=1).min() < 1e-5
    assert count >= 6


@pytest.mark.parametrize("name", ROBOTS)
def test_jacobian_is_the_difference_quotient(name):
    cell = cell_of(name)
    q = np.column_stack([random_q(cell, 20, seed=5, margin=0.01), np.zeros(20)])
    J = tcp_jacobian(cell, q)
    step = 1e-6
    for i in range(7):
        d = np.zeros(7)
        d[i] = step
        ahead, behind = scanner_poses(cell, q + d), scanner_poses(cell, q - d)
        linear = (ahead - behind)[:, :3, 3] / (2 * step)
        turn = (ahead - behind)[:, :3, :3] @ np.swapaxes(scanner_poses(cell, q)[:, :3, :3], 1, 2) / (2 * step)
        angular = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        assert np.abs(J[:, 3:, i] - linear).max() < 1e-7
        assert np.abs(J[:, :3, i] - angular).max() < 1e-7


@pytest.mark.parametrize("name", ROBOTS)
def test_manipulability_is_the_least_singular_value(name):
    cell = cell_of(name)
    found = branches(cell, scanner_poses(cell, random_q(cell, 20, seed=6)))
    want = [np.linalg.svd(flange_jacobian(cell, q), compute_uv=False)[-1] for q in found.q]
    assert np.abs(found.manipulability - want).max() < 1e-7


@functools.cache
def elbow_straight(name):
    """A3 [rad] at which the wrist is farthest from A2: by the facts' lengths."""
    w, p, _, _ = SCREWS[name]
    shoulder, elbow, wrist = (np.array(p[i], float)[[0, 2]] for i in (1, 2, 3))
    upper, fore = elbow - shoulder, wrist - elbow
    # About +y x turns towards -z: an angle in the plane (x, z) falls as A3 grows.
    angle = np.arctan2(fore[1], fore[0]) - np.arctan2(upper[1], upper[0])
    return clean_angle(np.array(angle * w[2][1])).item()


def test_elbow_straight_angle_is_the_published_one():
    assert abs(np.rad2deg(elbow_straight("kr240"))) == pytest.approx(5.385, abs=1e-3)


@pytest.mark.parametrize("off", [0.0, 1e-9, -1e-9])
@pytest.mark.parametrize("name", ROBOTS)
def test_straight_elbow_is_solved(name, off):
    cell = cell_of(name)
    q = random_q(cell, 400, seed=7)
    q[:, 2] = elbow_straight(name) + off
    X = scanner_poses(cell, q)
    found = branches(cell, X)
    assert pose_error(cell, found, X) < 1e-7
    # A wrist that is 1e-10 m off the edge of the reach is 2e-5 rad off in the elbow, more in the hand.
    off = np.abs(found.q - q[found.pose_index])
    best = np.full(len(q), np.inf)
    np.minimum.at(best, found.pose_index, off[:, :3].max(axis=1))
    assert best.max() < 1e-4
    assert nearest(found, q).max() < 0.01


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-8, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("name", ROBOTS)
def test_singular_wrist_is_solved(name, size):
    """With A5 at zero A4 and A6 turn about one axis: the rest is the answer (A1 on a UR)."""
    cell = cell_of(name)
    q = random_q(cell, 400, seed=8)
    q[:, 4] = size
    X = scanner_poses(cell, q)
    found = branches(cell, X)
    assert pose_error(cell, found, X) < 1e-6
    rest = [0, 1, 2, 4] if name in SPHERICAL else [0, 4]
    off = np.abs(found.q - q[found.pose_index])[:, rest].max(axis=1)
    best = np.full(len(q), np.inf)
    np.minimum.at(best, found.pose_index, off)
    # On a UR the free angle of A6 is tried in steps: an arm that is all but stretched may be missed.
    assert np.mean(best < 1e-6) >= (1.0 if name in SPHERICAL else 0.99)
    if size >= 1e-5:
        assert nearest(found, q).max() < 1e-6


@pytest.mark.parametrize("name", SPHERICAL)
def test_wrist_on_the_axis_of_a1_is_solved(name):
    """A1 is free there: answers exist, all exact."""
    from scipy.optimize import brentq

    cell = cell_of(name)
    q = []
    for row in random_q(cell, 200, seed=9):

        def x(a2, row=row):
            return link_poses(cell, np.array([[0, a2, *row[2:]]]))[0, 5, 0, 3]

        grid = np.linspace(cell.q_min[1], cell.q_max[1], 12)
        values = [x(a) for a in grid]
        for a, b, va, vb in zip(grid, grid[1:], values, values[1:], strict=False):
            if va * vb < 0:
                q.append([row[0], brentq(x, a, b, xtol=1e-15), *row[2:]])
                break
    q = np.array(q)
    assert len(q) > 50
    found = branches(cell, scanner_poses(cell, q))
    assert pose_error(cell, found, scanner_poses(cell, q)) < 1e-8
    assert set(found.pose_index) == set(range(len(q)))


@pytest.mark.parametrize("name", ROBOTS)
def test_out_of_reach_says_by_how_much(name):
    """Beyond the stretched arm by d, the wrist falls short by d."""
    cell = cell_of(name)
    q = random_q(cell, 20, seed=11)
    q[:, 2] = elbow_straight(name)
    links = link_poses(cell, q)
    reach = links[:, 5 if name in SPHERICAL else 4, :3, 3] - links[:, 2, :3, 3]
    along = links[:, 2, :3, :3] @ cell.robot.axes[1]
    reach -= (reach * along).sum(axis=1)[:, None] * along
    away = reach / np.linalg.norm(reach, axis=1)[:, None]
    for d in (0.001, 0.05, 0.3):
        X = scanner_poses(cell, q)
        X[:, :3, 3] += d * away
        short = wrist_shortfall(cell, X)
        # Another shoulder may come nearer than the one that is stretched.
        assert (short <= d + 1e-6).all()
        assert (short > 1e-9).any()
        if name in SPHERICAL:
            assert (np.abs(short - d) < 0.02 * d + 1e-6).mean() > 0.3
        assert set(branches(cell, X).pose_index).isdisjoint(np.flatnonzero(short > 1e-9))


@pytest.mark.parametrize("name", ROBOTS)
def test_joint_excess_names_the_joint_that_was_bent_too_far(name):
    """Limits narrowed about a configuration with no second branch inside."""
    from dataclasses import replace

    cell = cell_of(name)
    q = random_q(cell, 1, seed=12, margin=0.3)
    low, high = cell.q_min.copy(), cell.q_max.copy()
    low[:6], high[:6] = q[0] - 0.05, q[0] + 0.05
    low[3], high[3] = q[0, 3] + 0.02, q[0, 3] + 0.12
    tight = replace(cell, q_min=low, q_max=high)
    X = scanner_poses(cell, q)
    assert len(branches(tight, X).q) == 0
    joint, excess, index = joint_excess(tight, X)
    assert (joint, index) == (3, 0)
    assert excess == pytest.approx(0.02, abs=1e-6)


def test_scanner_in_object_undoes_the_table():
    cell = cell_of("kr240")
    q = np.column_stack([random_q(cell, 30, seed=13), np.linspace(-9, 9, 30)])
    X = object_poses(cell, q) @ scanner_in_object(cell, q)
    assert np.abs(X - scanner_poses(cell, q)).max() < 1e-12
    quarter = object_poses(cell, np.array([[0, 0, 0, 0, 0, 0, np.pi / 2]]))[0]
    assert np.allclose(quarter[:3, 0], [0, 1, 0]) and np.allclose(quarter[:3, 3], cell.X_WT[:3, 3])


@pytest.mark.parametrize("yaw", [0.0, 37.0, -120.0])
@pytest.mark.parametrize("name", ROBOTS)
def test_a_turned_and_moved_cell_gives_the_same_joints(name, yaw):
    """The base somewhere else and the poses with it: nothing changes for the arm."""
    from scanmotion.cell.settings.cell import pose

    cell = cell_of(name)
    place = (0.4, -1.2, 0.3)
    base = {"position_m": place, "yaw_deg": yaw}
    moved = build_cell(settings_from({"robot": robot_of(name), "base": base}))
    X = scanner_poses(cell, random_q(cell, 30, seed=14))
    a, b = branches(cell, X), branches(moved, pose(place, np.deg2rad(yaw)) @ X)
    assert (a.pose_index == b.pose_index).all() and (a.branch == b.branch).all()
    assert np.abs(a.q - b.q).max() < 1e-6


@pytest.mark.parametrize("name", SPHERICAL)
def test_a_mirrored_pose_has_the_mirrored_joints(name):
    """The arm is its own mirror image in the plane y = 0, but for the signs of A1, A4 and A6."""
    cell = cell_of(name)
    q = random_q(cell, 100, seed=15)
    X = flange_poses(cell, q)
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    mirrored = mirror @ X @ mirror
    a, b = branches(cell, X @ cell.X_FS), branches(cell, mirrored @ cell.X_FS)
    flip = np.array([-1, 1, 1, -1, 1, -1])
    for i in range(len(q)):
        ours, theirs = a.q[a.pose_index == i] * flip, b.q[b.pose_index == i]
        assert len(ours) == len(theirs)
        gap = np.abs(ours[:, None] - theirs[None]).max(axis=2)
        assert gap.min(axis=1).max() < 1e-6


def other_urdf(folder):
    """An arm that no closed form serves: the KR 240 with A5 beside the forearm's axis and askew."""
    from scanmotion.geometry.parts.make_part import models_dir

    text = (models_dir() / "robots" / "kr240.urdf").read_text()
    moved = text.replace('<origin xyz="1.22 0 0"/>', '<origin xyz="1.22 0.05 0.08" rpy="0.1 0 0.2"/>')
    assert moved != text
    path = folder / "other.urdf"
    path.write_text(moved.replace("../meshes", str(models_dir() / "meshes")))
    return path


def test_any_other_arm_is_solved_by_search(tmp_path):
    other_urdf(tmp_path)
    home = [0, -90, 90, 0, 0, 0]
    robot = {"model": "other.urdf", "acceleration": [1, 1, 1, 1, 1, 1], "home_deg": home}
    cell = build_cell(settings_from({"robot": robot}, folder=str(tmp_path)))
    assert isinstance(solver_of(cell.robot), NumericArm)
    q = random_q(cell, 12, seed=16, margin=0.2)
    X = scanner_poses(cell, q)
    found = branches(cell, X)
    assert pose_error(cell, found, X) < 1e-9
    assert (found.q >= cell.q_min[:6]).all() and (found.q <= cell.q_max[:6]).all()
    assert len(set(found.pose_index)) >= 11
    again = branches(cell, X)
    assert (again.q == found.q).all()
    far = X.copy()
    far[:, 0, 3] += 9.0
    assert len(branches(cell, far).q) == 0 and (wrist_shortfall(cell, far) > 0).all()


@pytest.mark.parametrize("name", ["kr240", "ur10e"])
def test_search_finds_only_what_the_closed_form_knows(name):
    cell = cell_of(name)
    X = flange_poses(cell, random_q(cell, 8, seed=17, margin=0.1))
    exact, searched = solver_of(cell.robot)(X).joints, NumericArm(cell.robot)(X).joints
    count = 0
    for ours, theirs in zip(exact, searched, strict=True):
        for q in theirs[np.isfinite(theirs[:, 0])]:
            count += 1
            gap = np.abs(clean_angle(ours - q + 1e-9)).max(axis=1)
            assert np.nanmin(gap) < 1e-6
    assert count >= 12
