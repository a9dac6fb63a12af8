"""Margins against brute force over every configuration, finite differences and the planner's kinematics."""

import json

import numpy as np
import pytest
from judged_plan import hand_made_files, hand_made_plan

from scanmotion.cell.kinematics import flange_poses, scanner_poses
from scanmotion.core.summary import MarginsSummary
from scanmotion.judge.contact import blocks, exact_distance
from scanmotion.judge.margins import jacobians, margins_of
from scanmotion.judge.motion import arm_of, motion_at
from scanmotion.judge.solids import PART, pairs_of, solids_of
from scanmotion.plan_io.read import read_plan, read_trajectory
from scanmotion.report.words import margin_rows


@pytest.fixture(scope="module")
def made():
    return hand_made_plan()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("margins")
    for name, data in hand_made_files().items():
        (out / name).write_bytes(data if isinstance(data, bytes) else data.encode())
    return out


@pytest.fixture(scope="module")
def margins(folder):
    return margins_of(folder)


@pytest.fixture(scope="module")
def read(folder):
    record = read_plan(folder)
    return record, read_trajectory(folder, record), arm_of(folder, record)


def test_least_distances_are_those_of_brute_force(folder, margins, read):
    """Every pair at every 40th configuration: none is nearer, and the named one is as near as is said."""
    record, trajectory, arm = read
    solids = solids_of(folder, record, arm)
    pairs = [p for p in pairs_of(solids, 1.0, arm.joined, {}) if p[2] > 0]
    q = np.concatenate([b.q for b in blocks(record, trajectory, arm, solids)])[::40]
    motion = motion_at(arm, record, np.arange(len(q), dtype=float), q)
    poses = {id(s): np.broadcast_to(s.poses(motion), (len(q), 4, 4)) for s in solids}
    for told, of_part in ((margins.to_object, True), (margins.to_surroundings, False)):
        near = min(
            exact_distance(a, b, poses[id(a)][n], poses[id(b)][n])
            for a, b, _ in pairs
            if (PART in (a.group, b.group)) is of_part
            for n in range(len(q))
        )
        # Between two of these configurations nothing moves by more than 40 steps of 4 mm.
        assert near - 0.16 <= told.mm * 1e-3 <= near + 1e-6
        row = np.array([np.interp(told.t_s, trajectory.t, trajectory.q[:, j]) for j in range(7)])
        there = motion_at(arm, record, np.zeros(1), row[None])
        named = [(a, b) for a, b, _ in pairs if (a.name, b.name) == (told.a, told.b)]
        again = min(exact_distance(a, b, a.poses(there)[0], b.poses(there)[0]) for a, b in named)
        assert again == pytest.approx(told.mm * 1e-3, abs=5e-4)


def test_the_nearest_joint_is_the_nearest(margins, made):
    spare = np.minimum(made.trajectory.q - made.cell.q_min, made.cell.q_max - made.trajectory.q)[:, :6]
    assert margins.joint_limit.deg == pytest.approx(np.rad2deg(spare.min()), abs=2e-3)


def test_speeds_are_finite_differences_of_the_planners_poses(margins, made):
    t, q = made.trajectory.t, made.trajectory.q
    poses = {"flange": flange_poses(made.cell, q), "scanner": scanner_poses(made.cell, q)}
    for name, X in poses.items():
        speed = np.linalg.norm(np.gradient(X[:, :3, 3], t, axis=0), axis=1)
        assert getattr(margins.fastest, name).value == pytest.approx(speed.max(), rel=2e-3)
    # The elbow turns about A1 and A2 only, nearer to them than the flange stretched out.
    assert 0 < margins.fastest.elbow.value < 3.0


def test_the_jacobian_is_the_derivative_of_the_flange(read, rng):
    record, _, arm = read
    q, h = rng.uniform(-1, 1, 7), 1e-6
    J = jacobians(motion_at(arm, record, np.zeros(1), q[None]))[0]
    for i in range(6):
        step = h * np.eye(7)[i]
        X = motion_at(arm, record, np.zeros(2), np.array([q - step, q + step])).X_WF
        turn = (X[1, :3, :3] - X[0, :3, :3]) / (2 * h) @ ((X[0, :3, :3] + X[1, :3, :3]) / 2).T
        w = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
        np.testing.assert_allclose(J[:3, i], w, atol=1e-6)
        np.testing.assert_allclose(J[3:, i], (X[1, :3, 3] - X[0, :3, 3]) / (2 * h), atol=1e-6)


def test_margins_are_a_document_and_rows(margins):
    again = MarginsSummary.model_validate(json.loads(margins.model_dump_json()))
    assert again == margins and 7 <= len(margin_rows(again)) <= 8
    assert margins.singularity.value > 0


def test_verify_tells_margins_where_it_is_asked(folder, margins):
    from typer.testing import CliRunner

    from scanmotion.cli import app

    plain = json.loads(CliRunner().invoke(app, ["verify", str(folder), "--json"]).stdout)
    asked = json.loads(CliRunner().invoke(app, ["verify", str(folder), "--margins", "--json"]).stdout)
    assert "margins" not in plain
    assert MarginsSummary.model_validate(asked["margins"]) == margins
