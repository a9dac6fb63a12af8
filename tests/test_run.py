"""A programme on the virtual controller: it is broken off, taken up again, and scans the same."""

import shutil

import numpy as np
import pytest
from exported_plan import made_by_hand
from scipy.spatial import cKDTree
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.controller.log import executed_from, read_executed, read_log
from scanmotion.controller.simulate import Circumstances, run_programme
from scanmotion.core.errors import InputError, PlanFileError
from scanmotion.export import export_files
from scanmotion.export.source import write_files
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge import verify
from scanmotion.plan_io.read import read_plan
from scanmotion.plan_io.resume import rest_files
from scanmotion.plan_io.write import plan_files

CLI = CliRunner()


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.2, 0.15, 0.4))


@pytest.fixture(scope="module")
def made(cell, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    write_files(folder, plan_files(made_by_hand(cell)))
    export_files(folder, "krl-timed")
    return folder


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "plan")


def frame_places(cell, folder):
    """Where the scanner was in the object's frame, and which way it looked, at each frame of a log."""
    log = read_log(folder)
    taken = log.frame > 0
    X = scanner_in_object(cell, np.deg2rad(log.q[taken]))
    return np.hstack([X[:, :3, 3], 0.3 * X[:, :3, 2]])


def resumed(folder, rest, *more):
    result = CLI.invoke(
        app, ["export", str(folder), "--rest", "--to", "krl-timed", "--out", str(rest), *more]
    )
    assert result.exit_code == 0, result.output
    assert verify(rest) == []
    result = CLI.invoke(app, ["verify", str(rest / "scan.src")])
    assert result.exit_code == 0, result.output
    result = CLI.invoke(app, ["run", str(rest), "--no-dynamics"])
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    "how", [["--stop-at", "25"], ["--stop-at", "45.5"], ["--ready", "never"], ["--done", "never"]]
)
def test_what_is_broken_off_and_taken_up_scans_the_same(how, folder, cell, tmp_path):
    assert CLI.invoke(app, ["run", str(folder), "--no-dynamics"]).exit_code == 0
    whole = frame_places(cell, folder)
    result = CLI.invoke(app, ["run", str(folder), "--no-dynamics", *how])
    assert result.exit_code == 1 and "broken off" in result.stdout
    assert not read_executed(folder).ended
    first = frame_places(cell, folder)
    resumed(folder, tmp_path / "rest")
    both = np.vstack([first, frame_places(cell, tmp_path / "rest")])
    # Each place from which the whole run took a frame has one in the two runs, within half a frame's way.
    assert cKDTree(both).query(whole)[0].max() < 0.03


def test_a_fault_is_repeated_within_the_programme(folder, cell):
    assert CLI.invoke(app, ["run", str(folder), "--no-dynamics"]).exit_code == 0
    whole = frame_places(cell, folder)
    result = CLI.invoke(app, ["run", str(folder), "--no-dynamics", "--fault", "1", "--fault", "3"])
    assert result.exit_code == 0 and "scanner fault" in result.stdout
    assert cKDTree(frame_places(cell, folder)).query(whole)[0].max() < 0.03
    assert CLI.invoke(app, ["export", str(folder), "--rest", "--to", "krl", "--out", "x"]).exit_code == 2


def test_drakes_arm_and_table_lag_by_little_and_end_where_they_should(made):
    found = run_programme(made / "scan.src", made, Circumstances(stop_at=22.0))
    assert 0 < found.lag_deg < 0.05
    assert found.executed.completed == 1
    assert np.abs(found.log.q[-1] - found.commanded[-1]).max() < 0.05


def test_a_robot_that_was_driven_away_has_a_way_back_in(made, cell, tmp_path):
    away = np.array(cell.home) + np.deg2rad([20, 5, 5, 10, -10, 0, 40])
    files = rest_files(made, 4, away)
    rest = tmp_path / "rest"
    write_files(rest, files)
    assert verify(rest) == []
    record = read_plan(rest)
    assert [o.kind for o in record.operations] == ["transit", "sweep", "transit", "dwell"]
    np.testing.assert_allclose(record.operations[0].q_start, away, atol=1e-9)
    assert {v.id for v in record.viewpoints} == {"S1", "S2", "L1.1"}


@pytest.mark.parametrize(
    "args, word",
    [
        (["--rest"], "--out"),
        (["--rest", "--out", "rest"], "no run is known"),
        (["--step", "99", "--out", "rest"], "steps 1 to 6"),
        (["--step", "2", "--out", "rest", "--at", "1,2"], "seven numbers"),
        (["--step", "2", "--out", "rest", "--at", "0,0,0,0,0,0,0"], "range"),
        (["--at", "1,2,3,4,5,6,7"], "--at"),
    ],
)
def test_what_cannot_be_taken_up_is_one_line(args, word, made, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CLI.invoke(app, ["export", str(made), "--to", "krl", *args])
    assert result.exit_code == 2 and word in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "rest").exists()


def test_logs_are_read_strictly(made, tmp_path):
    found = run_programme(made / "scan.src", made, Circumstances(stop_at=3.0), dynamics=False)
    from scanmotion.controller.log import log_text

    (tmp_path / "run.csv").write_text(log_text(found.log))
    back = read_log(tmp_path)
    np.testing.assert_allclose(back.q, found.log.q, atol=1e-6)
    np.testing.assert_array_equal(back.step, found.log.step)
    assert executed_from(back, "scan.src", ended=False).completed == 0
    for spoilt in (
        "",
        "t\n1\n",
        log_text(found.log).replace("0.0000", "nan", 1),
        log_text(found.log) + "1,2\n",
    ):
        (tmp_path / "run.csv").write_text(spoilt)
        with pytest.raises(PlanFileError):
            read_log(tmp_path)
    (tmp_path / "executed.json").write_text('{"version": 1, "completed": -1}')
    with pytest.raises(PlanFileError):
        read_executed(tmp_path)
    with pytest.raises(InputError):
        run_programme(made / "scan.src", made, Circumstances(ready="perhaps"))
