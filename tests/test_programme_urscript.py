"""URScript for the built-in UR arm and the programme of its table's drive, run by the judge's machine."""

import shutil

import numpy as np
import pytest
from exported_plan import made_by_hand
from helix_plan import helix_plan, turning_cell
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.controller.simulate import Circumstances, run_programme
from scanmotion.core.errors import InputError, PlanFileError
from scanmotion.export import export_files
from scanmotion.export.source import write_files
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge import verify
from scanmotion.judge.programme.arm_and_table import DrivenTable
from scanmotion.judge.programme.check import verify_programme
from scanmotion.judge.programme.controller import controller_from
from scanmotion.judge.programme.world import ScriptedScanner
from scanmotion.plan_io.write import plan_files


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    cell = build_cell(load_cell("ur10e"), box_part(0.1, 0.08, 0.2))
    folder = tmp_path_factory.mktemp("plan")
    write_files(folder, plan_files(made_by_hand(cell)))
    assert verify(folder) == []
    return folder


@pytest.fixture(scope="module")
def script(folder, tmp_path_factory):
    files = export_files(folder, "urscript", out=tmp_path_factory.mktemp("ur"))
    assert [f.name for f in files] == ["scan.script", "scan_table.st"]
    return files[0]


def test_the_judge_finds_nothing_and_the_times_are_the_plans(script, folder):
    report = verify_programme(script, folder, clearance=False)
    assert report.findings == ()
    assert report.seconds == pytest.approx(report.planned_s, rel=0.01)
    assert max(max(d.away_deg, d.missed_deg) for d in report.deviations) < 0.02 and report.frames > 160
    turn = report.deviations[1]
    assert turn.kind == "revolution" and turn.timed and turn.end_deg < 1e-4


def test_the_command_line_judges_and_runs_a_script(script, folder, tmp_path):
    own = shutil.copytree(folder, tmp_path / "own")
    for file in script.parent.iterdir():
        shutil.copy(file, own)
    result = CliRunner().invoke(app, ["run", str(own), "--stop-at", "25"])
    assert result.exit_code == 1 and "1 steps done" in result.stdout, result.output
    (own / "scan_table.st").unlink()
    result = CliRunner().invoke(app, ["verify", str(own / "scan.script")])
    assert result.exit_code == 2 and "scan_table.st" in result.stderr and result.stderr.count("\n") == 1


def test_a_fault_stops_arm_and_table_and_the_step_is_repeated(script, folder):
    controller = controller_from(script, folder)
    scanner = ScriptedScanner(
        signals=controller.signals, faults=frozenset([1, 3]), patience=2, fault_after=1.5
    )
    run, _ = controller.run(scanner)
    assert run.ended and scanner.recordings == 5 and len(run.said("brake")) == 2
    turn = run.q[run.step == 2, 6]
    # The table turns back to where the step begins, and then all the way.
    top = int(np.argmax(np.diff(turn) < 0))
    assert 2 < turn[top] < 90 and turn[top:].min() == pytest.approx(0, abs=1e-3) and turn[-1] == 360


def test_the_arm_waits_for_a_table_that_is_not_there(script, folder):
    controller = controller_from(script, folder)
    start = controller.start.copy()
    start[6] += 3
    run, _ = controller.run(ScriptedScanner(signals=controller.signals), start)
    assert not run.ended and "table" in run.said("halt")[-1].text
    assert np.abs(run.q - start).max() == 0


def test_a_start_that_the_drive_cannot_follow_is_a_fault(script, folder):
    programme = controller_from(script, folder).programme.table
    drive = DrivenTable(programme, 3.0)
    drive.look(True, 1)
    assert drive.fault and not drive.ready(1)
    drive.look(False, 1)
    assert not drive.fault
    drive = DrivenTable(programme, 0.0)
    assert drive.ready(1)
    drive.look(True, 1)
    places = [drive.advance(t, True, 1) for t in np.arange(0.01, 18.2, 0.01)]
    assert not drive.ready(1) and places[3] == 0.0 and places[-1] == programme.steps[1].places[-1]
    drive.look(False, 1)
    assert drive.ready(1)
    # A second start of a step that is over is refused.
    drive.look(True, 1)
    assert drive.fault


def test_a_dry_run_keeps_the_scanner_off(folder, tmp_path):
    script = export_files(folder, "urscript", out=tmp_path, dry_run=True)[0]
    controller = controller_from(script, folder)
    run, _ = controller.run(ScriptedScanner(signals=controller.signals, patience=3))
    assert run.ended and not run.recording.any() and len(run.said("halt")) == 3 and run.t[-1] > 490


def test_another_arm_name_signal_or_motion_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="URScript"):
        export_files(folder, "urscript", out=tmp_path, name="While")
    with pytest.raises(InputError, match="signal 64"):
        export_files(folder, "urscript", out=tmp_path, signal=64)
    cell = turning_cell()
    write_files(tmp_path / "kuka", plan_files(helix_plan(cell)))
    with pytest.raises(InputError, match="UR arm"):
        export_files(tmp_path / "kuka", "urscript", out=tmp_path / "out")
    with pytest.raises(InputError, match="ABB"):
        export_files(folder, "rapid", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "name, old, new, word",
    [
        ("scan.script", "scan_table_go()\n    scan_hold", "scan_hold", "step 2"),
        ("scan.script", "set_payload(1.800", "set_payload(18.00", "load"),
        ("scan.script", "set_tcp(p[", "set_tcp(p[1", "tool"),
        ("scan.script", "register(34, True)", "register(38, True)", "38"),
        ("scan.script", "scan_now(3)", "scan_now(2)", "order"),
        ("scan.script", ", 0, 0, 0.01, 0.03, 500)", ", 0, 0, 0.01, 0.2, 500)", "servoj"),
        ("scan.script", "waited >= 10:", "waited >= 100:", "waited for"),
        ("scan_table.st", "T#250ms;", "T#280ms;", "instead of"),
        ("scan_table.st", "State := 9;", "State := 0;", "is not"),
        ("scan_table.st", "3:\r\nFirst := 360", "3:\r\nFirst := 36", "end"),
    ],
)  # fmt: skip
def test_planted_faults_are_found(name, old, new, word, script, folder, tmp_path):
    for file in script.parent.iterdir():
        shutil.copy(file, tmp_path)
    text = (tmp_path / name).read_bytes().decode()
    assert old in text
    (tmp_path / name).write_bytes(text.replace(old, new).encode())
    try:
        found = [str(f) for f in verify_programme(tmp_path / "scan.script", folder, clearance=False).findings]
    except PlanFileError as error:
        found = [str(error)]
    assert any(word in f for f in found), found


def test_drakes_arm_and_table_follow(script, folder):
    found = run_programme(script, folder, Circumstances(stop_at=3.0))
    assert 0 < found.lag_deg < 0.05 and found.executed.completed == 0
