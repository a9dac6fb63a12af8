"""Figures of the risk sheet on a plan made by hand, against closed forms and brute force."""

import json

import numpy as np
import pytest
from exported_plan import made_by_hand
from fake_plan import trajectory_through
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import flange_poses, link_poses, scanner_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.export.source import write_files
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge.contact import exact_distance
from scanmotion.judge.motion import motion_from
from scanmotion.judge.risk.sheet import REACTION_S, UNSURE_M, risk_of
from scanmotion.judge.solids import PART, TOOL, solids_of
from scanmotion.plan_io.read import read_plan, read_trajectory
from scanmotion.plan_io.write import plan_files

SECONDS, TURN = 6.0, np.deg2rad(30)
FASTEST = 1.875 * TURN / SECONDS
"""Greatest speed of a quintic from rest to rest [rad/s]."""


@pytest.fixture(scope="module")
def part():
    return box_part(0.2, 0.15, 0.4)


@pytest.fixture(scope="module")
def cell(part):
    return build_cell(load_cell("kr240"), part)


@pytest.fixture(scope="module")
def folder(cell, tmp_path_factory):
    """A1 turns by 30 degrees there; then the table by 30 degrees."""
    plan = made_by_hand(cell)
    away = cell.home + np.array([TURN, 0, 0, 0, 0, 0, 0])
    stops = [cell.home, away, away + np.array([0, 0, 0, 0, 0, 0, TURN])]
    plan.trajectory = trajectory_through(
        stops, ["transit", "transit"], [SECONDS, SECONDS], [("G1",), ("G1",)]
    )
    plan.cycle = plan.trajectory
    folder = tmp_path_factory.mktemp("risk")
    write_files(folder, plan_files(plan))
    return folder


@pytest.fixture(scope="module")
def risk(folder):
    return risk_of(folder)


def test_speeds_and_stops_are_those_of_a_turn_about_a1(cell, risk):
    first, second = risk.operations
    axis = cell.X_WB[:2, 3]
    for name, X in (
        ("flange", flange_poses(cell, cell.home[None])),
        ("scanner", scanner_poses(cell, cell.home[None])),
    ):
        v = FASTEST * np.linalg.norm(X[0, :2, 3] - axis)
        assert first.speed_m_s[name] == pytest.approx(v, rel=1e-3)
        # v T / 2 with T = w / a grows with the square of the speed, so the fastest instant is the worst.
        brake = risk.deceleration_rad_s2[0]
        assert first.stop_m[name] == pytest.approx(v * (REACTION_S + FASTEST / brake / 2), rel=2e-3)
        assert first.stop_s == pytest.approx(REACTION_S + FASTEST / brake, rel=1e-3)
        assert first.speed_m_s["elbow"] < first.speed_m_s["anywhere"] >= v
        assert second.speed_m_s[name] < 1e-9
    assert first.speed_m_s["part"] < 1e-9
    assert second.speed_m_s["part"] == pytest.approx(FASTEST * risk.part_radius_m, rel=1e-3)
    assert risk.part_radius_m == pytest.approx(np.hypot(0.1, 0.075), rel=1e-6)


def test_the_elbow_is_on_the_axis_of_a3(cell, risk):
    p = link_poses(cell, cell.home[None])[0, 3, :3, 3]
    v = FASTEST * np.linalg.norm(p[:2] - cell.X_WB[:2, 3])
    assert risk.operations[0].speed_m_s["elbow"] == pytest.approx(v, rel=1e-3)


def test_half_the_deceleration_stops_twice_as_late(folder, risk):
    slow = risk_of(folder, deceleration=risk.deceleration_rad_s2 / 2, reaction_s=0.0)
    a, b = risk.operations[0], slow.operations[0]
    assert b.stop_s == pytest.approx(2 * (a.stop_s - REACTION_S), rel=1e-9)
    assert b.stop_m["flange"] == pytest.approx(
        2 * (a.stop_m["flange"] - REACTION_S * a.speed_m_s["flange"]), rel=1e-6
    )


@pytest.fixture(scope="module")
def every(folder):
    record = read_plan(folder)
    trajectory = read_trajectory(folder, record)
    motion = motion_from(folder, record, trajectory)
    return motion, solids_of(folder, record, motion.arm)


def test_the_swept_space_holds_every_corner(risk, every):
    motion, solids = every
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    a, b, c = (risk.hull.points[risk.hull.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    for s in (s for s in solids if 1 <= s.group <= TOOL):
        X = s.poses(motion)[::20]
        p = np.einsum("nij,kj->nki", X[:, :3, :3], corners * s.half) + X[:, None, :3, 3]
        p = p.reshape(-1, 3)
        low, high = np.minimum(low, p.min(axis=0)), np.maximum(high, p.max(axis=0))
        outside = np.einsum("fi,nfi->nf", normal, p[:, None] - a[None])
        assert outside.max() < 1e-3
    np.testing.assert_allclose(risk.low_m, low, atol=0.01)
    np.testing.assert_allclose(risk.high_m, high, atol=0.01)


def test_least_distances_agree_with_brute_force(risk, every):
    motion, solids = every
    robot = [s for s in solids if s.group >= 1]
    part = next(s for s in solids if s.group == PART)
    X = {id(s): s.poses(motion) for s in [*robot, part]}
    least = min(
        exact_distance(a, part, X[id(a)][n], X[id(part)][n])
        for a in robot
        for n in range(0, len(motion.t), 30)
    )
    gap = next(g for g in risk.gaps if g.around == "part")
    assert gap.distance_m - UNSURE_M <= least and gap.distance_m <= least + UNSURE_M
    assert [g.distance_m for g in risk.gaps] == sorted(g.distance_m for g in risk.gaps)
    assert {"part", "floor"} <= {g.around for g in risk.gaps}


def test_export_writes_the_sheet_beside_a_programme_and_nothing_else(folder, risk, tmp_path):
    args = ["export", str(folder), "--out", str(tmp_path / "out"), "--to"]
    assert CliRunner().invoke(app, [*args, "krl-timed"]).exit_code == 0
    assert {"scan_risk.html", "scan_risk.json", "scan_risk.ply"} <= {
        p.name for p in (tmp_path / "out").iterdir()
    }
    data = json.loads((tmp_path / "out" / "scan_risk.json").read_text())
    assert data["greatest_speed_m_s"]["flange"] == pytest.approx(
        risk.operations[0].speed_m_s["flange"], abs=1e-4
    )
    assert len(data["operations"]) == 2 and data["not_in_the_model"]
    np.testing.assert_allclose(data["swept"]["low_m"], risk.low_m, atol=1e-4)
    mesh = read_geometry(tmp_path / "out" / "scan_risk.ply")
    np.testing.assert_allclose(mesh.vertices.max(axis=0), risk.high_m, atol=1e-5)
    page = (tmp_path / "out" / "scan_risk.html").read_text()
    assert "ISO 10218-2:2025" in page and f"{risk.operations[0].speed_m_s['flange'] * 1e3:.0f}" in page
    args[3] = str(tmp_path / "bare")
    for more in (["csv"], ["krl", "--no-risk"]):
        assert CliRunner().invoke(app, [*args, *more]).exit_code == 0
    assert not [p for p in (tmp_path / "bare").iterdir() if "risk" in p.name]


def test_from_python_a_programme_has_its_sheet_too(folder, risk, tmp_path):
    import scanmotion as sm

    files = sm.export_plan(folder, "krl-timed", out=tmp_path / "a")
    assert {f.name for f in files} >= {
        "scan.src",
        "scan.dat",
        "scan_risk.html",
        "scan_risk.json",
        "scan_risk.ply",
    }
    assert not any("risk" in f.name for f in sm.export_plan(folder, "csv", out=tmp_path / "b"))
    assert not any("risk" in f.name for f in sm.export_plan(folder, "krl", out=tmp_path / "c", risk=False))
