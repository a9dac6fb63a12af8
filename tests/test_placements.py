"""Several placements: what the second adds, what it costs, how it is found again, and its files."""

import json

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import scanmotion as sm
from scanmotion.cli import app
from scanmotion.core.errors import InputError
from scanmotion.plan_io.placed_folder import placed_summary, save_placed
from scanmotion.planning.context import context_from
from scanmotion.planning.placements.placing_trial import known_cloud, placing_trial, still_poses
from scanmotion.planning.placements.plan_placements import PlacementOptions, plan_placements
from scanmotion.planning.segment import silent
from scanmotion.report.placements_page import placements_html
from scanmotion.sensing.corrections.measured_placement import SHIFT, TILT, drawn_error, measured_placement
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.simulator.simulate import simulate, still_captures

COARSE = {"samples": 4000, "stride": 6, "rounds": 1}


def crooked():
    """Blocks and a ball of which no yaw looks like another."""
    tall = trimesh.creation.box((60.0, 90.0, 180.0)).apply_translation((-40, 0, 90))
    foot = trimesh.creation.box((130.0, 50.0, 45.0)).apply_translation((50, 25, 22.5))
    ball = trimesh.creation.icosphere(radius=28, subdivisions=3).apply_translation((85, 30, 60))
    return sm.part_from(trimesh.util.concatenate([tall, foot, ball]), units="mm")


@pytest.fixture(scope="module")
def placed():
    return plan_placements(
        crooked(), sm.load_cell("kr240"), options=sm.PlanOptions(seed=2, **COARSE),
        placing=PlacementOptions(most=2),
    )  # fmt: skip


def test_the_base_is_seen_in_the_second_placement(placed):
    first, second = placed.placements
    assert first.resting.name == "+z up" and second.resting.name != "+z up"
    assert placed.of_ceiling > 0.99 and second.added > 0.05
    # What stands on the table in the first placement is what the second one adds.
    assert second.resting.up[2] < 0.5
    assert sum(p.added for p in placed.placements) == pytest.approx(placed.of_ceiling, abs=1e-9)


def test_a_second_placement_is_cheap_where_the_first_is_known(placed):
    first, second = (p.plan.trajectory.duration for p in placed.placements)
    assert second < 0.8 * first
    assert placed.seconds == pytest.approx(first + second)


def test_samples_are_one_set(placed):
    first, second = placed.placements
    X = second.X_KO
    moved = first.plan.samples.points @ X[:3, :3].T + X[:3, 3]
    assert np.allclose(moved, second.plan.samples.points, atol=1e-9)
    assert (second.plan.seen >= first.plan.seen).all()


def test_the_files_are_judged_and_read_back(placed, tmp_path):
    pages = {"report.html": placements_html(placed)}
    saved = save_placed(placed, tmp_path / "out", judge=sm.verify, page=lambda p: pages)
    assert all(item.findings == () for item in saved)
    for item in placed.placements:
        assert sm.verify(tmp_path / "out" / item.name) == []
        assert sm.load_plan(tmp_path / "out" / item.name) is not None
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary == json.loads(json.dumps(placed_summary(placed, saved)))
    record = json.loads((tmp_path / "out" / "placements.json").read_text())
    X = np.array(record["placements"][1]["X_KO"])
    assert np.allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-9)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "tip the part by" in page and "http" not in page


def test_the_second_placement_is_found_again(placed):
    trial = placed.placements[1].trial
    assert trial.right and trial.found.trusted
    assert np.arccos((np.trace(trial.X_error[:3, :3]) - 1) / 2) > np.deg2rad(0.5)


@pytest.mark.slow
def test_it_is_found_again_in_twenty_draws(placed):
    second = placed.placements[1]
    known = known_cloud([(placed.placements[0].plan.cloud, np.eye(4))], second.X_KO)
    ctx = context_from(second.plan.part, second.plan.cell.settings, sm.PlanOptions(seed=2, **COARSE), silent)
    trials = [placing_trial(ctx, known, np.random.default_rng(k)) for k in range(20)]
    assert all(t.right for t in trials)
    assert all(t.right or not t.found.trusted for t in trials)


def test_a_body_of_revolution_is_not_trusted():
    vase = sm.part_from(trimesh.creation.cylinder(radius=60.0, height=200.0, sections=96), units="mm")
    ctx = context_from(vase, sm.load_cell("kr240"), sm.PlanOptions(**COARSE), silent)
    captures = still_captures(still_poses(ctx))
    scan = simulate(ctx.simulator.scene, ctx.scanner, captures, stride=6, rng=np.random.default_rng(1))
    cloud = fuse([scan], voxel=0.004)
    found = measured_placement(cloud, cloud)
    assert not found.trusted and found.other > 0.8 * found.fitness


def test_draws_stay_inside_what_is_sought(rng):
    for _ in range(50):
        X = drawn_error(rng)
        assert np.arccos(np.clip(X[2, 2], -1, 1)) <= TILT + 1e-12
        assert np.linalg.norm(X[:2, 3]) <= SHIFT + 1e-12


def test_what_cannot_be_asked_is_refused():
    part, cell = sm.box_part(0.4, 0.4, 0.02), sm.load_cell("kr240")
    with pytest.raises(InputError, match="for a mesh"):
        plan_placements(part, cell, options=sm.PlanOptions(source="box"))
    with pytest.raises(InputError, match=r"resting poses: \+z up; -z up"):
        plan_placements(
            part, cell, options=sm.PlanOptions(**COARSE), placing=PlacementOptions(ups=((0.0, 1.0, 0.0),))
        )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--placements", "9"], "from 1 to 6"),
        (["--placements", "up"], "auto, a number, or axes"),
        (["--forbid", "-z"], "only together with --placements"),
        (["--placements", "2", "--box", "100", "100", "100"], "for a mesh"),
    ],
)
def test_wrong_words_are_one_line(words, told, tmp_path):
    result = CliRunner().invoke(app, ["plan", *words, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2 and told in result.output and result.output.count("\n") == 1
