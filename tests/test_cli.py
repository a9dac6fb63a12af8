"""The command line: help, statuses, files, and what a user sees."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from scanmotion.cli import app
from scanmotion.cli.plans.summarising import next_rows, summary_rows
from scanmotion.core.summary import Summary

COMMANDS = (
    "plan", "verify", "show", "export", "holes", "viewpoints", "reach", "robots", "fuse", "compare",
    "cell init",
    "cell check",
)  # fmt: skip
HEAVY = ("open3d", "pydrake", "matplotlib", "numba", "scipy", "numpy", "ompl", "pydantic")


def run(*args):
    return CliRunner().invoke(app, [str(a) for a in args])


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command):
    result = run(*command.split(), "--help")
    assert result.exit_code == 0
    assert f"Example: scanmotion {command}" in " ".join(result.output.split())


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom scanmotion.cli import app\n"
        "try:\n    app(['--help'])\nexcept SystemExit:\n    pass\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stderr.strip() == "[]"


def test_version():
    import scanmotion

    assert run("--version").output.split() == ["scanmotion", scanmotion.__version__]


def test_no_command_shows_help():
    result = run()
    assert result.exit_code == 2
    assert "Usage" in result.output


def test_robots_lists_the_builtin_cells_with_their_sources():
    from scanmotion.cell.settings.cell import builtin_cells

    rows = json.loads(run("robots", "--json").output)
    assert [row["name"] for row in rows] == list(builtin_cells())
    assert all(row["source"] for row in rows)
    lines = run("robots").output.splitlines()
    assert len(lines) == len(rows) + 1


def test_cell_init_writes_what_cell_check_accepts(tmp_path):
    file = tmp_path / "my.yaml"
    assert run("cell", "init", file).exit_code == 0
    checked = run("cell", "check", file)
    assert checked.exit_code == 0, checked.output
    assert len(checked.output.splitlines()) == 1 + 7

    from scanmotion.cell.settings.cell import load_cell

    mine, builtin = load_cell(file), load_cell("kr240")
    assert mine.model_dump() == builtin.model_dump()


def test_cell_init_overwrites_nothing(tmp_path):
    file = tmp_path / "my.yaml"
    file.write_text("mine")
    assert run("cell", "init", file).exit_code == 2
    assert file.read_text() == "mine"


def test_viewpoints_of_the_papers_worked_example():
    result = run("viewpoints", "--box", 330, 200, 600, "--mode", "paper", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    places = {v["id"]: np.array(v["X_OS"])[:3, 3] * 1e3 for v in found["viewpoints"]}
    expected = [(771.218, 0, 950), (865, 0, 300), (865, 0, 0)]
    for place in expected:
        assert min(np.abs(p - place).max() for p in places.values()) < 1.0, places
    # VPn looks from below the table's top and is left out with a reason.
    assert found["dropped"]


def test_viewpoints_are_written_and_read_back(tmp_path):
    from scanmotion.export.viewpoints import read_viewpoints

    said = json.loads(run("viewpoints", "--box", 330, 200, 600, "--json").stdout)["viewpoints"]
    for name in ("views.csv", "views.json"):
        out = tmp_path / name
        assert run("viewpoints", "--box", 330, 200, 600, "--out", out).exit_code == 0
        found = read_viewpoints(out)
        assert [v.id for v in found] == [v["id"] for v in said]
        for a, b in zip(found, said, strict=True):
            np.testing.assert_allclose(a.X_OS, b["X_OS"], atol=1e-10)
            assert (a.step, a.kind, a.sweep) == (b["step"], b["kind"], b["sweep"])
            assert a.standoff == pytest.approx(b["standoff_m"])


def test_holes_of_a_sheet_with_a_square_cut_out(tmp_path, rng, monkeypatch):
    points = rng.random((40_000, 2)) * 200 - 100
    inside = (np.abs(points) < 25).all(axis=1)
    file, out = tmp_path / "sheet.xyz", tmp_path / "holes.json"
    sheet = points[~inside]
    # Slightly curved: an exact plane has no side. Off the origin: the answer is in the file's own frame.
    place = np.array([300.0, -50.0, 20.0])
    rows = np.column_stack([sheet, 0.001 * (sheet**2).sum(axis=1)]) + place
    np.savetxt(file, rows, fmt="%.4f")
    monkeypatch.chdir(tmp_path)
    result = run("holes", file, "--out", out, "--show")
    assert result.exit_code == 0, result.output
    holes = json.loads(out.read_text())["holes"]
    near = [h for h in holes if np.abs(np.array(h["center"]) - place).max() < 10 and max(h["extent"]) < 80]
    assert len(near) == 1
    assert near[0]["extent"][:2] == pytest.approx([50, 50], abs=10)
    rim = np.array(near[0]["boundary_points"]) - place
    assert (np.abs(rim[:, :2]).max(axis=1) < 32).all() and (np.abs(rim[:, :2]).max(axis=1) > 22).all()
    assert (tmp_path / "holes.png").read_bytes()[:4] == b"\x89PNG"


def test_holes_do_not_depend_on_the_unit(tmp_path, rng):
    points = rng.random((20_000, 2)) * 200 - 100
    keep = np.hypot(*points.T) > 30
    rows = np.column_stack([points, 0.001 * (points**2).sum(axis=1)])[keep]
    found = []
    for name, scale in (("mm.xyz", 1.0), ("m.xyz", 1e-3)):
        np.savetxt(tmp_path / name, rows * scale, fmt="%.9f")
        result = run("holes", tmp_path / name, "--json")
        assert result.exit_code == 0, result.output
        found.append([np.array(h["extent"]) / scale for h in json.loads(result.stdout)["holes"]])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-3)


def test_fuse_brings_posed_scans_into_one_frame(tmp_path, rng):
    from scanmotion.geometry.parts.make_part import part_from_file

    # Two halves of a bowl, each in a frame of its own.
    disc = rng.random((30_000, 2)) * 200 - 100
    disc = disc[np.hypot(*disc.T) < 100]
    bowl = np.column_stack([disc, 0.004 * (disc**2).sum(axis=1) + 30])
    angle = np.deg2rad(40)
    X = np.eye(4)
    X[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    X[:3, 3] = 15, -7, 300
    poses = {"a.xyz": X.tolist(), "b.xyz": np.eye(4).tolist()}
    for name, half in (("a.xyz", bowl[bowl[:, 0] < 10]), ("b.xyz", bowl[bowl[:, 0] > -10])):
        own = np.linalg.inv(poses[name])
        np.savetxt(tmp_path / name, half @ own[:3, :3].T + own[:3, 3], fmt="%.5f")
    up = {"nominal_view_direction": [0, 0, -1]}
    record = {"scans": {name: {"T_object_scan": pose} | up for name, pose in poses.items()}}
    (tmp_path / "poses.json").write_text(json.dumps(record))
    out = tmp_path / "fused.ply"
    result = run("fuse", tmp_path, "--poses", tmp_path / "poses.json", "--out", out)
    assert result.exit_code == 0, result.output
    fused = part_from_file(out, place="keep")
    x, y, z = fused.vertices.T * 1e3
    np.testing.assert_allclose(z, 0.004 * (x**2 + y**2) + 30, atol=0.05)
    assert np.hypot(x, y).max() > 97 and x.min() < -95 and x.max() > 95
    slope = np.column_stack([-0.008 * x, -0.008 * y, np.ones(len(x))])
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    assert np.median((slope * fused.normals).sum(axis=1)) > 0.999


def test_reach_gives_configurations_or_a_cause():
    result = run("reach", "--box", 330, 200, 600, "--json")
    assert result.exit_code == 0, result.output
    for item in json.loads(result.stdout):
        assert (item["configurations"] > 0) == (item["unreachable"] is None)


def test_reach_draws_a_map_and_counts(tmp_path):
    picture = tmp_path / "map.png"
    result = run("reach", "--box", 330, 200, 600, "--map", picture)
    assert result.exit_code == 0, result.output
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert "viewpoints can be reached" in result.stdout


@pytest.mark.slow
def test_reach_sweep_says_where_to_put_the_robot():
    result = run("reach", "--box", 330, 200, 600, "--sweep", "--json")
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)
    assert len(rows) == 12 and all(0 <= row["share"] <= 1 for row in rows)
    assert max(row["share"] for row in rows) > 0.5


DOCUMENT = {
    "rounds": [],
    "viewpoints": {"global": 2, "local": 5, "unreachable": [{"id": "L1", "reason": "too far"}]},
    "completeness": {"after_global": 0.91, "final": 0.9995, "final_of_whole": 0.95},
    "accuracy": {"mean_abs_mm": 0.08, "sd_signed_mm": None, "mean_signed_mm": 0.0},
    "time_s": {"total": 70.0, "arm": 40.0, "table": 16.0, "sweep": 10.0, "dwell": 4.0, "floor": 66.0},
    "budget": {"limit_s": 152.0, "ok": True},
    "findings": [],
    "planning_s": {"total": 9.0},
}


def summary(**changed) -> Summary:
    return Summary.model_validate(DOCUMENT | changed)


def test_final_table_says_everything():
    text = dict(summary_rows(summary()))
    assert text["completeness, of what can be seen"] == "99.95%"
    assert "152" in text["time"] and "70.0 s" in text["time"]
    assert text["of which [s]"] == "arm 40.0, table 16.0, sweep 10.0, dwell 4.0"
    assert "1 unreachable" in text["viewpoints"]
    assert "not known" in text["accuracy"]


def test_without_a_model_one_line_says_so():
    nothing = {"after_global": None, "final": None, "final_of_whole": None}
    text = dict(summary_rows(summary(completeness=nothing)))
    assert text["completeness"].startswith("not known")
    assert sum("not known" in value for value in text.values()) == 1


@pytest.mark.parametrize(("model", "to"), [("kr240", "krl-timed"), ("irb6700", "rapid"), ("my.urdf", "ros")])
def test_the_table_ends_with_what_comes_next(tmp_path, model, to):
    (tmp_path / "cell.json").write_text(json.dumps({"robot": {"model": model}}))
    commands = [command for _, command in next_rows(summary(), tmp_path)]
    assert commands[-1] == f"scanmotion export {tmp_path} --to {to}"
    assert len(next_rows(summary(findings=["too fast"]), tmp_path)) == 2, "a plan that fails is not exported"


def test_a_plan_passes_only_without_findings_and_in_time():
    assert summary().passes
    assert not summary(findings=["too fast"]).passes
    assert not summary(budget=DOCUMENT["budget"] | {"limit_s": 10.0, "ok": False}).passes


def test_findings_read_as_lines():
    told = summary(findings=["A2 too fast", {"kind": "speed", "value": 3}])
    assert told.finding_lines == ["A2 too fast", "kind speed, value 3"]


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    from scanmotion.cli.inputs import write_text

    file = tmp_path / "scene.html"
    write_text(file, "old")

    def broken(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(KeyboardInterrupt):
        write_text(file, "new")
    assert file.read_text() == "old"
    assert os.listdir(tmp_path) == ["scene.html"]


# What the stage does that Ctrl-C meets: nothing; fail, as an import of compiled code does; drop it, as a
# callback of compiled code does, so that only the next report of progress can end the work.
MET = {
    "python": "time.sleep(60)",
    "an import": "try:\n        time.sleep(60)\n    except KeyboardInterrupt:\n        import no_such",
    "a callback": "class A:\n        def __del__(self): time.sleep(60)\n    A()\n    a[2]('x', 0.5)",
}


@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
@pytest.mark.parametrize("met", MET)
def test_ctrl_c_ends_with_130_and_leaves_nothing(met, tmp_path):
    out = tmp_path / "plan"
    # Waits inside the pipeline until the signal arrives. A shell's background job starts deaf to it.
    code = (
        "import signal, time, scanmotion.cli.plans.planning as p\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"def planned(*a, **k):\n    print('ready', flush=True)\n    {MET[met]}\n"
        "p.part_and_source = lambda *a, **k: (None, 'mesh')\n"
        "p.New.planned = lambda self, progress: planned(None, None, progress)\n"
        "from scanmotion.__main__ import main\n"
        "main()"
    )
    command = [sys.executable, "-c", code, "plan", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline().strip() == "ready"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err == ""
    assert not out.exists()


def test_many_viewpoints_that_are_too_dear_share_a_line():
    from scanmotion.cli.plans.summarising import left_out_rows
    from scanmotion.core.summary import LeftOut

    dear = [LeftOut(id=f"L{k}", reason=f"not worth its seconds: it adds 0.00{k}% in 1.0 s") for k in range(5)]
    far = LeftOut(id="G1", reason="out of reach by 0.2 m")
    assert left_out_rows([far], dear[:3]) == [(u.id, u.reason) for u in [far, *dear[:3]]]
    rows = left_out_rows([far], dear)
    assert rows == [("G1", far.reason), ("5 others", "not worth their seconds; summary.json lists them")]
