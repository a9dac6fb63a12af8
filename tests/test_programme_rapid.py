"""RAPID for the built-in ABB robot: run by the judge's machine as the plan is, with faults found."""

from dataclasses import replace

import numpy as np
import pytest
from exported_plan import made_by_hand

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.errors import InputError
from scanmotion.export import export_files
from scanmotion.export.knots import timed_knots
from scanmotion.export.source import write_files
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge.programme.check import verify_programme
from scanmotion.judge.programme.controller import controller_from
from scanmotion.judge.programme.world import ScriptedScanner
from scanmotion.plan_io.write import plan_files


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    cell = build_cell(load_cell("irb6700"), box_part(0.2, 0.15, 0.4))
    folder = tmp_path_factory.mktemp("plan")
    write_files(folder, plan_files(made_by_hand(cell)))
    return folder


@pytest.fixture(scope="module")
def module(folder, tmp_path_factory):
    (file,) = export_files(folder, "rapid", out=tmp_path_factory.mktemp("rapid"))
    return file


def test_the_judge_finds_nothing_and_the_times_are_the_plans(module, folder):
    report = verify_programme(module, folder, clearance=False)
    assert report.findings == ()
    assert report.seconds == pytest.approx(report.planned_s, rel=0.01)
    assert max(d.away_deg for d in report.deviations) < 0.05 and report.frames > 160


def test_tool_table_and_lines(module, folder):
    data = module.read_bytes()
    text = data.decode("ascii")
    assert data.count(b"\r\n") == data.count(b"\n") and text.startswith("MODULE M_scan\r\n")
    controller = controller_from(module, folder)
    tool = controller.programme.data["SCAN_TOOL"]
    X = np.array(controller.record.X_FS)
    np.testing.assert_allclose(tool[1][0], X[:3, 3] * 1e3, atol=1e-3)
    assert tool[2][0] == controller.mass and "9E9,9E9,9E9,9E9,9E9]" in text


def test_a_fault_leads_back_and_is_repeated(module, folder):
    controller = controller_from(module, folder)
    scanner = ScriptedScanner(signals=controller.signals, faults=frozenset([1, 3]), patience=2)
    run, _ = controller.run(scanner)
    assert run.ended and scanner.recordings == 5 and len(run.said("brake")) == 2


def test_a_dry_run_keeps_the_scanner_off(folder, tmp_path):
    (file,) = export_files(folder, "rapid", out=tmp_path, dry_run=True)
    controller = controller_from(file, folder)
    run, _ = controller.run(ScriptedScanner(signals=controller.signals, patience=3))
    assert run.ended and not run.recording.any() and len(run.said("halt")) == 3 and run.t[-1] > 400


def test_another_arm_or_name_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="RAPID"):
        export_files(folder, "rapid", out=tmp_path, name="While")
    kuka = tmp_path / "kuka"
    cell = build_cell(load_cell("kr240"), box_part(0.2, 0.15, 0.4))
    write_files(kuka, plan_files(made_by_hand(cell)))
    with pytest.raises(InputError, match="ABB"):
        export_files(kuka, "rapid", out=tmp_path / "out")


def test_knots_in_time_follow_the_motion(rng):
    t = np.arange(0, 5, 0.01)
    q = np.column_stack([np.sin(t * w) * a for w, a in ((1.3, 20), (0.4, 90), (2.2, 5))])
    k = timed_knots(t, q, 0.05, shortest=0.05, longest=0.5)
    back = np.column_stack([np.interp(t, t[k], q[k, j]) for j in range(3)])
    assert k[0] == 0 and k[-1] == len(t) - 1 and np.diff(t[k]).max() <= 0.5 + 1e-9
    assert np.abs(back - q).max() < 0.05


def test_a_continuous_motion_is_driven_and_goes_back_through_the_points_it_has_passed(tmp_path):
    """The line of the sweep as a motion of kind `path`; a fault leads back through counted points."""
    cell = build_cell(load_cell("irb6700"), box_part(0.2, 0.15, 0.4))
    made = made_by_hand(cell)
    operations = tuple(
        replace(o, kind="path" if o.kind == "sweep" else o.kind) for o in made.trajectory.operations
    )
    made.trajectory = made.cycle = replace(made.trajectory, operations=operations)
    write_files(tmp_path, plan_files(made))
    (file,) = export_files(tmp_path, "rapid")
    assert verify_programme(file, clearance=False).findings == ()
    controller = controller_from(file)
    scanner = ScriptedScanner(signals=controller.signals, faults=frozenset([2]), patience=1, fault_after=1.5)
    run, _ = controller.run(scanner)
    assert run.ended and scanner.recordings == 4 and len(run.said("brake")) == 1
