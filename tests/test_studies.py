"""Studies: cases and their ids, rows that are never lost or doubled, workers that are killed, the page."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.errors import InputError
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.studies import cluster, table
from scanmotion.studies.case import FIGURES, CaseRow, poses_round, row_of
from scanmotion.studies.layout import BOUNDS, layout_keys, present_values
from scanmotion.studies.report import ranking, study_html
from scanmotion.studies.run import StudyError, StudyOptions, study
from scanmotion.studies.settings import study_from

CHEAP = {
    "kind": "viewpoints",
    "robots": ["kr240"],
    "layouts": {"grid": {"turntable.height_m": [0.6, 0.7], "pedestal.height_m": [0.0, 0.2]}},
    "parts": [{"box_mm": [330, 200, 600]}, {"box_mm": [100, 120, 140]}],
    "seeds": [0, 1, 2],
}


def row(id_: str, **figures) -> CaseRow:
    known = dict.fromkeys(FIGURES) | figures
    return CaseRow(id=id_, status="ok", reason="", figures=known, plan_sha256="", planning_s=0.0, version="0")


def test_a_grid_has_every_combination_once(tmp_path):
    made = study_from(CHEAP, folder=tmp_path)
    assert len(made.cases) == 4 * 2 * 3 == len({c.id for c in made.cases})
    assert len(made.parts) == 2
    asked = {(c.settings["turntable"]["height_m"], c.settings["pedestal"]["height_m"]) for c in made.cases}
    assert asked == {(0.6, 0.0), (0.6, 0.2), (0.7, 0.0), (0.7, 0.2)}


def test_ids_do_not_depend_on_the_order_of_the_yaml(tmp_path):
    turned = {key: CHEAP[key] for key in reversed(CHEAP)}
    assert {c.id for c in study_from(turned, folder=tmp_path).cases} == {
        c.id for c in study_from(CHEAP, folder=tmp_path).cases
    }


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robts": ["kr240"]}, "robts"),
        ({"methods": ["fastest"]}, "known: two-step"),
        ({"options": {"sampels": 3}}, "options.sampels: unknown"),
        ({"layouts": {"grid": {"turntable.hight_m": [1]}}}, "no key 'turntable.hight_m'"),
        ({"layouts": {"grid": {"turntable.height_m": [700]}}}, "is it in metres"),
        ({"layouts": {"list": [{"name": "a"}, {"name": "a"}]}}, "there twice"),
        ({"parts": [{"units": "mm"}]}, "file or box_mm"),
        ({"seeds": [-1]}, "below zero"),
        ({"seeds": list(range(200_000))}, "at most"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_planned(tmp_path, change, words):
    with pytest.raises(InputError, match=words.replace("(", "\\(")):
        study_from(CHEAP | change, folder=tmp_path)


def test_a_row_is_kept_once(tmp_path):
    case = study_from(CHEAP, folder=tmp_path).cases[0]
    with table.opened(tmp_path / "t.sqlite", make=True) as connection:
        table.add(connection, [(case, row(case.id, seconds=1.0))])
        table.add(connection, [(case, row(case.id, seconds=2.0))])
        found = table.records(connection)
    assert [r["seconds"] for r in found] == [1.0]
    assert json.loads(found[0]["settings"]) == case.settings


def test_another_file_is_no_table(tmp_path):
    (tmp_path / "t.sqlite").write_text("hello " * 500)
    with pytest.raises(InputError, match="not the table of a study"), table.opened(tmp_path / "t.sqlite"):
        pass


def test_a_bad_case_is_a_row_with_its_reason(tmp_path):
    made = study_from(CHEAP | {"kind": "plan", "parts": [{"box_mm": [9000, 200, 600]}]}, folder=tmp_path)
    found = row_of(made.cases[0], next(iter(made.parts.values())))
    assert found.status == "refused" and "table's radius" in found.reason


def test_poses_of_a_reach_study_stand_off_the_box_and_look_at_it():
    part = box_part(0.3, 0.2, 0.6)
    X_OS = poses_round(part, 0.7)
    eye, along = X_OS[:, :3, 3], X_OS[:, :3, 2]
    assert np.allclose(np.cross(part.bounds.mean(axis=0) - eye, along), 0, atol=1e-9)
    entry = eye + 0.7 * along
    gap = np.abs(entry - part.bounds.mean(axis=0)) - part.extent / 2
    assert np.allclose(gap.max(axis=1), 0, atol=1e-9)


def test_two_workers_give_the_rows_that_one_process_gives(tmp_path):
    out = study(CHEAP, options=StudyOptions(table=tmp_path / "t.sqlite", workers=2))
    assert (out.cases, out.new, out.ok) == (24, 24, 24)
    again = study(CHEAP, options=StudyOptions(table=tmp_path / "t.sqlite"))
    assert (again.new, again.ok) == (0, 24)
    made = study_from(CHEAP, folder=Path.cwd())
    with table.opened(tmp_path / "t.sqlite") as connection:
        found = {r["id"]: r for r in table.records(connection)}
    for case in made.cases:
        alone = row_of(case, made.parts[case.part_hash])
        assert {name: found[case.id][name] for name in FIGURES} == alone.figures


def _kill_own_worker(case, keep):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_case_that_kills_its_workers_is_a_row(tmp_path, monkeypatch):
    monkeypatch.setattr("scanmotion.studies.run.run_on_worker", _kill_own_worker)
    one = CHEAP | {"layouts": {}, "parts": [{"box_mm": [100, 120, 140]}], "seeds": [0]}
    out = study(one, options=StudyOptions(table=tmp_path / "t.sqlite", workers=1))
    assert (out.cases, out.ok) == (1, 0)
    with table.opened(tmp_path / "t.sqlite") as connection:
        (found,) = table.records(connection)
    assert found["status"] == "killed" and "3 times" in found["reason"]


def test_no_scheduler_at_an_address_is_one_line(tmp_path):
    options = StudyOptions(table=tmp_path / "t.sqlite", scheduler="tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="nothing answers"):
        study(CHEAP, options=options)


@pytest.mark.slow
def test_workers_and_scheduler_killed_at_random_moments_lose_no_row(tmp_path):
    """An own scheduler and two workers; workers are killed twenty times, then the scheduler once."""
    many = CHEAP | {"kind": "reach", "seeds": list(range(4))}
    path = tmp_path / "t.sqlite"
    address, processes = _cluster(tmp_path)
    code = (
        "import sys, json; from pathlib import Path; from scanmotion.studies.run import *\n"
        f"options = StudyOptions(table=Path({str(path)!r}), scheduler={address!r})\n"
        "study(json.loads(sys.argv[1]), options=options)"
    )
    runner = subprocess.Popen([sys.executable, "-c", code, json.dumps(many)])
    random = np.random.default_rng(1)
    for _ in range(20):
        time.sleep(random.uniform(0.1, 0.5))
        victims = _worker_pids(processes[1:])
        if victims:
            os.kill(int(random.choice(victims)), signal.SIGKILL)
    processes[0].kill()
    runner.wait(timeout=120)
    for process in processes:
        process.kill()
    out = study(many, options=StudyOptions(table=path, workers=2))
    assert out.ok + _killed(path) == out.cases == 32
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT count(*), count(DISTINCT id) FROM cases").fetchone() == (32, 32)


@pytest.mark.slow
def test_plans_of_a_study_are_those_of_single_plans_byte_for_byte(tmp_path):
    told = CHEAP | {"kind": "plan", "robots": ["kr240", "irb6700"], "seeds": [0]}
    told["layouts"] = {"grid": {"turntable.height_m": [0.65, 0.75]}}
    out = study(
        told, options=StudyOptions(table=tmp_path / "t.sqlite", workers=2, keep_in=tmp_path / "plans")
    )
    assert out.ok == out.cases == 8
    made = study_from(told, folder=Path.cwd())
    with table.opened(tmp_path / "t.sqlite") as connection:
        found = {r["id"]: r for r in table.records(connection)}
    for case in made.cases:
        alone = row_of(case, made.parts[case.part_hash])
        assert found[case.id]["plan_sha256"] == alone.plan_sha256 != ""
        assert (tmp_path / "plans" / case.id / "plan.json").is_file()


def _killed(path: Path) -> int:
    with table.opened(path) as connection:
        return sum(r["status"] == "killed" for r in table.records(connection))


def _cluster(folder: Path) -> tuple[str, list[subprocess.Popen]]:
    address = folder / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    told = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(address)]
    processes = [subprocess.Popen([*scheduler, *told], **quiet)]
    while not address.is_file():
        time.sleep(0.1)
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address)]
    worker += ["--nworkers", "2", "--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard"]
    processes.append(subprocess.Popen([*worker, "--local-directory", str(folder)], **quiet))
    return json.loads(address.read_text())["address"], processes


def _worker_pids(nannies: list[subprocess.Popen]) -> list[int]:
    import psutil

    found = []
    for nanny in nannies:
        for child in psutil.Process(nanny.pid).children(recursive=True):
            if "spawn" in " ".join(child.cmdline()):
                found.append(child.pid)
    return found


@given(st.lists(st.tuples(st.floats(0.5, 1.0), st.floats(10, 200)), min_size=1, max_size=12))
def test_the_front_is_what_no_other_beats(points):
    rows = [
        {
            "robot": "r", "layout": str(i), "method": "m", "part": "p", "status": "ok", "settings": "{}",
            "completeness": c, "seconds": s, "reachable": None,
        }
        for i, (c, s) in enumerate(points)
    ]  # fmt: skip
    front = {int(r.layout) for r in ranking(rows) if r.pareto}
    beaten = {
        i for i, (c, s) in enumerate(points) if any(C >= c and S <= s and (C > c or S < s) for C, S in points)
    }
    assert front == set(range(len(points))) - beaten


def test_the_page_names_the_best_and_the_failed(tmp_path):
    made = study_from(CHEAP | {"kind": "plan", "seeds": [0]}, folder=tmp_path)
    with table.opened(tmp_path / "t.sqlite", make=True) as connection:
        rows = []
        for i, case in enumerate(made.cases):
            found = row(case.id, completeness=0.99 + 0.001 * i, seconds=60.0 + i)
            rows.append((case, found))
        table.add(connection, rows[1:])
        bad = CaseRow(**(vars(rows[0][1]) | {"status": "none", "reason": "nothing <reached>"}))
        table.add(connection, [(rows[0][0], bad)])
    page = study_html(tmp_path / "t.sqlite")
    assert "nothing &lt;reached&gt;" in page and "data:image/png" in page and "http" not in page
    best = max(made.cases[2:], key=lambda c: c.id == made.cases[-1].id)
    assert best.layout in page.split("First of the ranking:")[1].split("</p>")[0]


def test_an_empty_table_has_no_page(tmp_path):
    with table.opened(tmp_path / "t.sqlite", make=True):
        pass
    with pytest.raises(InputError, match="no row yet"):
        study_html(tmp_path / "t.sqlite")


def test_a_layout_moves_the_table_along_its_line():
    base = load_cell("kr240")
    keys = layout_keys(base, present_values(base))
    assert np.allclose(keys["turntable.position_m"], base.turntable.position_m, atol=1e-4)
    far = layout_keys(base, {"distance_m": BOUNDS["distance_m"][1], "height_m": 0.5, "tilt_deg": 10.0})
    assert np.hypot(*far["turntable.position_m"]) == pytest.approx(BOUNDS["distance_m"][1], abs=1e-3)


def test_workers_are_as_many_as_the_memory_bears():
    assert cluster.worker_count(64, 1e6) == 1
    assert cluster.worker_count(2, 1e-3) == 2


def test_a_lost_scheduler_is_said(tmp_path, monkeypatch):
    class Lost:
        status, key = "cancelled", "k"

    from scanmotion.studies import run

    case = study_from(CHEAP, folder=tmp_path).cases[0]
    with pytest.raises(StudyError, match="run the study again"):
        run._row(case, Lost(), None)
