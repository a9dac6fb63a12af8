"""The twin's errors as settings, what calibration in the trip buys, and the files of the scans."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from judging import summarised
from scans import SCANNER, bumpy, turns
from test_plan import TINY, pitted
from typer.testing import CliRunner

from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.cli import app
from scanmotion.cli.plans.summarising import twin_rows
from scanmotion.core.errors import CellError, InputError
from scanmotion.core.summary import Summary
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.judge import verify
from scanmotion.plan_io.load import load_plan
from scanmotion.plan_io.read import read_summary
from scanmotion.plan_io.scans.measured import calibration_record, surface_record
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.sensing.assess import signed_distances
from scanmotion.sensing.corrections.calibration import PARAMETERS, Calibration, errors_from
from scanmotion.sensing.corrections.corrected_scan import Corrections, corrected_scan, moved
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.scans.scan_files import load_scan
from scanmotion.sensing.simulator.captures import ScanErrors, motion
from scanmotion.sensing.simulator.simulate import simulate, still_captures

OPTIONS = {**TINY, "seed": 5}
SCAN_FILES = {"cloud.ply", "deviation.ply", "frames-1.npz"}


def test_a_cell_that_says_nothing_has_the_stated_noise():
    for name in ("kr240", "ur10e"):
        errors = ScanErrors(**load_cell(name).twin_errors())
        assert errors == ScanErrors() and not errors.constant


def test_every_error_of_the_twin_is_a_setting():
    told = {
        "pose_mm": 0.5, "pose_deg": 0.1, "range_noise": 2, "frame_scale": 3, "hand_eye_mm": [1, -2, 3],
        "hand_eye_deg": [0.1, 0.2, -0.3], "axis_mm": [-0.5, 0.25], "axis_deg": [0.4, -0.5],
        "backlash_deg": 0.6, "latency_ms": -2.0, "jitter_ms": 0.25,
    }  # fmt: skip
    found = settings_from({"twin": told}).twin_errors()
    assert set(found) == {f.name for f in fields(ScanErrors)}
    deg = math.pi / 180
    assert ScanErrors(**found).constant
    for name, expected in {
        "range_noise": 2.0, "frame_scale": 3.0, "pose_m": 5e-4, "pose_rad": 0.1 * deg,
        "hand_eye_m": (1e-3, -2e-3, 3e-3), "hand_eye_rad": (0.1 * deg, 0.2 * deg, -0.3 * deg),
        "axis_m": (-5e-4, 2.5e-4), "axis_rad": (0.4 * deg, -0.5 * deg), "backlash_rad": 0.6 * deg,
        "latency_s": -2e-3, "jitter_s": 2.5e-4,
    }.items():  # fmt: skip
        assert found[name] == pytest.approx(expected, rel=1e-12), name


@pytest.mark.parametrize("key", ["hand_eye_m", "hand_eye_rad", "axis_m", "axis_rad"])
def test_one_constant_error_is_enough(key):
    none = ScanErrors()
    assert replace(none, **{key: (*getattr(none, key)[:-1], -1e-9)}).constant
    assert replace(none, backlash_rad=1e-9).constant
    assert not replace(none, pose_m=1.0, range_noise=5.0).constant


@pytest.mark.parametrize(
    ("twin", "key", "word"),
    [
        ({"axis_mm": [50, 0]}, "twin.axis_mm.0", "millimetres"),
        ({"pose_mm": -1}, "twin.pose_mm", "below"),
        ({"pose_mm": 20}, "twin.pose_mm", "millimetres"),
        ({"axis_mm": [0, 0, 0]}, "twin.axis_mm", "2 values are expected"),
        ({"axis_mm": 0.5}, "twin.axis_mm", "tuple"),
        ({"axis_m": [0, 0]}, "twin.axis_m", "unknown; known: [axis_deg"),
        ({"hand_eye_deg": [0, 0, 3]}, "twin.hand_eye_deg.2", "degrees"),
        ({"hand_eye_deg": [0, 0, "1 deg"]}, "twin.hand_eye_deg.2", "number"),
        ({"backlash_deg": float("nan")}, "twin.backlash_deg", "finite"),
        ({"range_noise": True}, "twin.range_noise", "number"),
    ],
    ids=str,
)
def test_a_wrong_error_is_refused_with_its_key(twin, key, word):
    with pytest.raises(CellError) as caught:
        settings_from({"twin": twin})
    assert caught.value.key == key and word in str(caught.value) and "\n" not in str(caught.value)


# One trip calibrated, one not, one again: the table's axis is 0.5 mm off.


@pytest.fixture(scope="module")
def planted():
    return settings_from({**load_cell("kr240").model_dump(mode="json"), "twin": {"axis_mm": [0.5, 0.0]}})


@pytest.fixture(scope="module")
def lumps(planted, tmp_path_factory):
    folder, part = tmp_path_factory.mktemp("lumps"), bumpy(60)
    asked = PlanOptions(keep_scans=True, surface=True, **OPTIONS)
    made = plan(part, planted, options=asked)
    made.save(folder / "mended")
    plan(part, planted, options=asked).save(folder / "again")
    plan(part, planted, options=replace(asked, calibrate=False, keep_scans=False)).save(folder / "left")
    return made, folder


def summary_of(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


def test_calibration_makes_the_trip_several_times_more_accurate(lumps):
    mended, left = (summary_of(lumps[1] / name) for name in ("mended", "left"))
    assert left["accuracy"]["mean_abs_mm"] > 0.25
    assert mended["accuracy"]["mean_abs_mm"] < left["accuracy"]["mean_abs_mm"] / 5
    assert mended["accuracy"]["surface"]["mean_abs_mm"] < left["accuracy"]["surface"]["mean_abs_mm"] / 4
    assert left["calibration"] is None and left["registration"] == []
    # What was seen, and so what was planned, comes from the true poses in both.
    assert mended["completeness"] == left["completeness"]
    found = mended["calibration"]["global_cloud"]
    assert found["before"]["mean_abs_mm"] == pytest.approx(left["accuracy"]["mean_abs_mm"], abs=0.02)
    assert found["after"]["mean_abs_mm"] < 0.06


def test_the_estimate_is_the_planted_error_within_its_stated_uncertainty(lumps, planted):
    found = summary_of(lumps[1] / "mended")["calibration"]
    for key in ("hand_eye_mm", "hand_eye_deg", "axis_mm", "axis_deg"):
        off = np.subtract(found["estimated"][key], getattr(planted.twin, key))
        assert (np.abs(off) < 4 * np.array(found["sd"][key])).all(), key
    assert abs(found["estimated"]["backlash_deg"]) < 4 * found["sd"]["backlash_deg"]
    assert found["estimated"]["axis_mm"][0] == pytest.approx(0.5, abs=0.1)
    assert found["disagreement_mm"]["after"] < found["disagreement_mm"]["before"]
    assert found["applied"] and found["undetermined"] == [] and "disagree" in found["statement"]


def test_the_same_command_writes_the_same_bytes(lumps):
    one, two = (
        {p.name: p.read_bytes() for p in (lumps[1] / name).iterdir()} for name in ("mended", "again")
    )  # fmt: skip
    assert set(one) == set(two) and set(one) >= SCAN_FILES
    assert [name for name in sorted(one) if one[name] != two[name]] in ([], ["summary.json"])
    a, b = (summary_of(lumps[1] / name) for name in ("mended", "again"))
    assert {**a, "planning_s": 0} == {**b, "planning_s": 0}
    assert not SCAN_FILES & {p.name for p in (lumps[1] / "left").iterdir()}


def test_judge_and_readers_pass_over_the_scans(lumps):
    made, folder = lumps
    assert verify(folder / "mended") == []
    assert load_plan(folder / "mended").trajectory.duration == made.trajectory.duration


def test_saved_scans_hold_what_was_fused(lumps):
    made, folder = lumps
    cloud = read_geometry(folder / "mended" / "cloud.ply").vertices * 1e-3
    np.testing.assert_allclose(cloud, made.cloud.points, atol=1e-7)
    back = [load_scan(folder / "mended" / f"frames-{i + 1}.npz") for i in range(len(made.scans))]
    for a, b in zip(back, made.scans, strict=True):
        np.testing.assert_array_equal(a.points_O, b.points_O)
        np.testing.assert_array_equal(a.captures.X_OS, b.captures.X_OS)
    again = fuse(back, voxel=TINY["voxel"])
    np.testing.assert_array_equal(again.points, made.cloud.points)


def test_the_deviation_mesh_lies_on_the_part(lumps):
    made, folder = lumps
    mesh = read_geometry(folder / "mended" / "deviation.ply")
    assert len(mesh.triangles) > 1000
    d = np.abs(signed_distances(mesh.vertices * 1e-3, made.part))
    assert np.median(d) < 0.1e-3
    stated = summary_of(folder / "mended")["accuracy"]["surface"]
    assert stated["triangles"] == len(mesh.triangles)
    assert set(stated) == {
        "mean_abs_mm", "sd_signed_mm", "mean_signed_mm", "triangles", "from_truth",
    }  # fmt: skip


def test_local_rounds_are_registered_and_said_so(planted):
    made = plan(pitted(), planted, options=PlanOptions(keep_scans=True, **OPTIONS))
    summary = summarised(made).summary.document()
    found = summary["registration"]
    assert len(found) == len(made.scans) - 1 >= 1
    for item in found:
        assert made.segments[item["round"] - 1].step == "local"
        assert 0 < item["rms_mm"] < 0.5 and 0 < item["fitness"] <= 1
        assert item["statement"].startswith("trusted" if item["trusted"] else "not to be trusted")
    assert set(summary["accuracy"]) == {"mean_abs_mm", "sd_signed_mm", "mean_signed_mm"}
    assert summary["accuracy"]["mean_abs_mm"] < 0.12
    json.dumps(summary, allow_nan=False)


def test_without_constant_errors_nothing_is_estimated_or_kept():
    made = plan(bumpy(30), load_cell("kr240"), options=PlanOptions(**{**OPTIONS, "rounds": 0}))
    assert made.corrections is None and made.scans == ()
    summary = summarised(made).summary
    assert summary.calibration is None and summary.registration == []


def test_options_win_over_the_cells_errors(planted):
    told = PlanOptions(errors=ScanErrors.none(), **{**OPTIONS, "rounds": 0})
    made = plan(bumpy(30), planted, options=told)
    assert made.corrections is None
    assert made.accuracy().mean_abs < 0.02e-3


@pytest.mark.parametrize("source", ["box", "scan"])
@pytest.mark.parametrize("option", ["calibrate", "surface", "keep_scans"])
def test_what_the_twin_does_not_scan_cannot_be_asked_for(source, option):
    with pytest.raises(InputError, match=f"{source} is not scanned"):
        PlanOptions(source=source, **{option: True})


@pytest.mark.parametrize("option", ["--calibrate", "--surface", "--save-scans"])
def test_the_command_refuses_what_a_box_cannot_give(option, tmp_path):
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["plan", "--box", "200", "200", "200", option, "--out", str(out)])
    assert result.exit_code == 2 and "a box is not scanned" in result.output
    assert not out.exists()


def test_the_final_table_shows_what_calibration_bought(lumps):
    mended, left = (dict(twin_rows(read_summary(lumps[1] / name))) for name in ("mended", "left"))
    assert set(mended) == {"of the surface", "calibration"} and set(left) == {"of the surface"}
    found = summary_of(lumps[1] / "mended")["calibration"]["global_cloud"]
    for key in ("before", "after"):
        assert f"{found[key]['mean_abs_mm']:.3f}" in mended["calibration"]
    item = {
        "round": 2, "rms_mm": 0.1, "fitness": 1.0, "uncertainty_mm": 0.01, "shift_mm": 0.2, "turn_deg": 0.0,
        "trusted": True, "statement": "trusted: yes",
    }  # fmt: skip
    told = summary_of(lumps[1] / "left") | {"registration": [item]}
    assert ("round 2 on the cloud", "trusted: yes") in twin_rows(Summary.model_validate(told))


# Corrections by themselves.


def test_a_moved_scan_shows_the_same_range_images(lump):
    scan = turns(lump, ScanErrors(), n=4)
    X = motion(np.array([[1e-3, -2e-3, 5e-4, 0.01, -0.02, 0.03]]))[0]
    there = moved(scan, X)
    np.testing.assert_allclose(there.captures.X_OS, X @ scan.captures.X_OS, atol=1e-12)
    p = np.column_stack([there.points_O, np.ones(len(there))])
    p_S = np.einsum("nij,nj->ni", np.linalg.inv(there.captures.X_OS)[there.frame], p)
    np.testing.assert_allclose(p_S[:, 2], scan.depth, atol=1e-6)
    assert np.array_equal(there.pixel, scan.pixel)


def test_a_later_scan_is_put_back_where_it_belongs(lump, lump_cloud):
    later = turns(lump, ScanErrors(), seed=3, n=6)
    X = motion(np.array([[6e-4, -4e-4, 5e-4, 2e-3, -1e-3, 2e-3]]))[0]
    better, known = corrected_scan(
        moved(later, X), lump_cloud, Corrections(), part=lump, voxel=0.002, index=1
    )
    ((index, found),) = known.registrations
    assert index == 1 and found.trusted
    off = np.linalg.norm(better.points_O.astype(float) - later.points_O, axis=1)
    assert off.max() < 0.1e-3 < np.linalg.norm(moved(later, X).points_O - later.points_O, axis=1).mean()


def test_a_scan_that_can_slide_stays_where_it_is():
    plate = box_part(0.4, 0.4, 0.05)
    X = np.stack([look_at((x, 0.0, 0.7), (0, 0, -1)) for x in (0.0, 0.01, -0.01)])
    first, later = (simulate(plate, SCANNER, still_captures(X), rng=np.random.default_rng(k)) for k in (0, 1))
    cloud = fuse([first])
    shifted = moved(later, motion(np.array([[5e-4, 0, 0, 0, 0, 0]]))[0])
    inner, known = corrected_scan(shifted, cloud, Corrections(), part=plate, voxel=0.002, index=2)
    ((_, found),) = known.registrations
    assert not found.trusted and "free" in found.statement
    np.testing.assert_array_equal(inner.points_O, shifted.points_O)


def test_one_turn_tells_the_errors_not_apart_and_is_left_alone(lump):
    X = np.stack([look_at((0.7 * np.cos(a), 0.7 * np.sin(a), 0.1), (-np.cos(a), -np.sin(a), 0))
                  for a in np.linspace(0, 2 * np.pi, 24, endpoint=False)])  # fmt: skip
    scan = simulate(lump, SCANNER, still_captures(X), rng=np.random.default_rng(0))
    same, known = corrected_scan(scan, None, Corrections(), part=lump, voxel=0.002, index=0)
    assert same is scan
    record = calibration_record(known).model_dump()
    assert not record["applied"] and record["statement"].endswith("nothing is corrected")
    assert record["undetermined"] and record["global_cloud"]["before"] == record["global_cloud"]["after"]


def test_an_empty_or_lonely_scan_is_left_alone(lump, lump_cloud):
    away = look_at((0.7, 0, 0.1), (1, 0, 0))[None]
    empty = simulate(lump, SCANNER, still_captures(away), rng=np.random.default_rng(0))
    assert len(empty) == 0
    nothing = Corrections()
    for cloud in (None, lump_cloud):
        same, known = corrected_scan(empty, cloud, nothing, part=lump, voxel=0.002, index=1)
        assert same is empty and known is nothing
    one = simulate(
        lump, SCANNER, still_captures(look_at((0.7, 0, 0.1), (-1, 0, 0))[None]),
        rng=np.random.default_rng(0),
    )  # fmt: skip
    # A single frame overlaps nothing: there is nothing to calibrate from.
    same, known = corrected_scan(one, None, Corrections(), part=lump, voxel=0.002, index=0)
    assert same is one and known.calibration is None and known.registrations == ()


def test_the_surface_is_assessed_both_ways():
    """A box grown by 0.1 mm on all sides: both distances are 0.1 mm but at the edges, where they differ."""
    box, grown = box_part(0.2, 0.2, 0.2), box_part(0.2002, 0.2002, 0.2002)
    grown = replace(grown, vertices=grown.vertices - [0, 0, 1e-4])
    points = surface_samples(box, 5000, rng=np.random.default_rng(0)).points
    found = surface_record((grown.vertices, grown.triangles), box, points)
    assert found.mean_abs_mm == pytest.approx(0.1, abs=1e-3)
    assert found.mean_signed_mm == pytest.approx(0.1, abs=1e-3)
    assert found.sd_signed_mm < 5e-3
    assert found.from_truth["mean_abs_mm"] == pytest.approx(0.1, abs=1e-3)
    assert found.triangles == 12
    assert surface_record((grown.vertices, grown.triangles), box).from_truth is None


def test_what_calibration_states_can_be_written_into_a_cell():
    theta = np.array([1e-4, -2e-4, 3e-4, 1e-3, 2e-3, -1e-3, 5e-4, -5e-4, 1e-3, -1e-3, 1e-3, 2e-3])
    found = Calibration(
        errors=errors_from(theta), sd=np.abs(theta), known=theta > 0, rms_before=2e-4, rms_after=1e-4,
        statement="",
    )  # fmt: skip
    record = calibration_record(Corrections(calibration=found)).model_dump()
    assert record["undetermined"] == [p for p, t in zip(PARAMETERS, theta, strict=True) if t < 0]
    assert record["disagreement_mm"] == {"before": 0.2, "after": 0.1}
    for key, expected in (("estimated", theta), ("sd", np.abs(theta))):
        e = settings_from({"twin": record[key]}).twin_errors()
        told = [
            *e["hand_eye_m"],
            *e["hand_eye_rad"],
            *e["axis_m"],
            *e["axis_rad"],
            e["backlash_rad"],
            e["latency_s"],
        ]
        np.testing.assert_allclose(told, expected, atol=2e-8)
    assert calibration_record(None) is None and calibration_record(Corrections()) is None
