"""Exports are read back by readers of their own; what does not belong into a programme is refused."""

import csv
import hashlib
import json
import os
import re
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from exported_plan import made_by_hand
from fake_plan import smooth
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.core.errors import InputError, PlanFileError, ScanMotionError
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.export import FORMATS, export_files
from scanmotion.export.knots import polyline_knots, spline_knots
from scanmotion.export.krl.moves import number
from scanmotion.export.pose import abc_from_rotation, arm_for_poses
from scanmotion.export.source import source_from, write_files
from scanmotion.export.viewpoints import quaternion, read_viewpoints, rotation, write_viewpoints
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.plan_io.write import plan_files


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.2, 0.15, 0.4))


@pytest.fixture(scope="module")
def folder(cell, tmp_path_factory):
    """A plan folder without a finding of the judge; tests do not change it."""
    folder = tmp_path_factory.mktemp("plan")
    write_files(folder, plan_files(made_by_hand(cell)))
    return folder


@pytest.fixture(scope="module")
def plan(folder):
    """The plan as its files tell it."""
    return source_from(folder)


@pytest.fixture
def own(folder, tmp_path):
    """A copy to spoil."""
    return Path(shutil.copytree(folder, tmp_path / "own"))


def spoil(folder, **changed):
    """Changes entries of plan.json."""
    record = json.loads((folder / "plan.json").read_text())
    for key, value in changed.items():
        record[key] = value(record[key])
    (folder / "plan.json").write_text(json.dumps(record))


def digests(folder):
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*") if p.is_file()}


# --- all formats ----------------------------------------------------------------------------------


# RAPID and URScript are for arms that turn as theirs do: tests/test_programme_rapid.py, _urscript.py.
HERE = [to for to in FORMATS if to not in ("rapid", "urscript")]


@pytest.mark.parametrize("to", HERE)
def test_every_format_is_written_twice_alike_and_leaves_the_plan_alone(to, own, tmp_path):
    before = digests(own)
    first = export_files(own, to, name="mine")
    assert all(p.is_file() and p.resolve().is_relative_to(own.resolve()) for p in first)
    now = digests(own)
    assert {k: now[k] for k in before} == before
    assert set(now) - set(before) == {p.name for p in first}
    second = export_files(own, to, out=tmp_path / "new" / "place", name="mine")
    assert [p.name for p in second] == [p.name for p in first]
    assert [p.read_bytes() for p in second] == [p.read_bytes() for p in first]


@pytest.mark.parametrize("to", HERE)
def test_the_command_line_says_what_it_wrote(to, folder, tmp_path):
    result = CliRunner().invoke(app, ["export", str(folder), "--to", to, "--out", str(tmp_path / "o")])
    assert result.exit_code == 0, result.output
    said = [Path(line) for line in result.stdout.splitlines()]
    assert said and all(p.is_file() for p in said)
    assert {p for p in (tmp_path / "o").rglob("*") if p.is_file()} == set(said)


@pytest.mark.parametrize(
    "args, word",
    [
        (["--to", "step"], "csv, json, viewpoints, krl, krl-timed, rapid, urscript, ros, mcap"),
        (["--to", "csv", "--name", "../evil"], "--name"),
        (["--to", "json", "--name", "plan"], "plan.json"),
        (["--to", "json", "--name", "TRAJECTORY"], "TRAJECTORY.json"),
        (["--to", "csv", "--name", "con"], "--name"),
        (["--to", "krl", "--name", "scan 1"], "--name"),
        (["--to", "krl", "--name", "a-b"], "letters, digits and _"),
        (["--to", "krl", "--name", "a" * 20], "19"),
        (["--to", "krl", "--name", "cell"], "system"),
        (["--to", "krl-timed", "--name", "SPS"], "system"),
        (["--to", "krl", "--name", "p00"], "system"),
        (["--to", "krl", "--name", "ir_stopm"], "word of the language"),
        (["--to", "csv", "--dry-run"], "--dry-run"),
        (["--to", "krl-timed", "--name", "Ptp"], "word of the language"),
    ],
)
def test_refusals_are_one_line_and_write_nothing(args, word, own):
    before = digests(own)
    result = CliRunner().invoke(app, ["export", str(own), *args])
    assert result.exit_code == 2
    assert word in result.stderr and result.stderr.count("\n") == 1 and not result.stdout
    assert digests(own) == before


EVIL = ["L1\nHALT", "L1\r;x", "a;b", "x y", "=cmd()", "", "L1\u2028PTP", "\u00e41", "a" * 41, "-1", "G1\x00"]


@pytest.mark.parametrize("evil", EVIL)
@pytest.mark.parametrize("to", FORMATS)
def test_ids_that_are_not_plain_reach_no_file(to, evil, own, tmp_path):
    def put(operations):
        operations[0]["viewpoints"] = [evil]
        return operations

    spoil(own, operations=put)
    with pytest.raises(InputError) as caught:
        export_files(own, to, out=tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_ids_of_viewpoints_are_checked_too(own, tmp_path):
    spoil(own, viewpoints=lambda views: [views[0] | {"id": "G\nHALT"}, *views[1:]])
    with pytest.raises(InputError):
        export_files(own, "viewpoints", out=tmp_path / "out")


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
@pytest.mark.parametrize("key", ["part", "robot", "software"])
def test_names_of_part_and_robot_cannot_add_lines(to, key, own, tmp_path):
    spoil(own, **{key: lambda _: "box\r\nPTP {A1 0}\nEND"})
    with pytest.raises(InputError):
        export_files(own, to, out=tmp_path)
    spoil(own, **{key: lambda _: ";FOLD b\u00fcste %{PE} {x} & \u2192"})
    export_files(own, to, out=tmp_path)
    text = (tmp_path / "scan.src").read_bytes().decode("ascii")
    line = next(x for x in text.split("\r\n") if x.startswith("; part"))
    assert "_FOLD b_ste __PE_ _x_ _ _" in line


def test_other_formats_carry_any_name_of_a_part_as_data(own, tmp_path):
    evil = 'box"]}\n- evil: &x\r\n'
    spoil(own, part=lambda _: evil, joint_names=lambda names: [evil, *names[1:]])
    files = {to: export_files(own, to, out=tmp_path) for to in ("json", "ros")}
    assert json.loads(files["json"][0].read_text())["part"] == evil
    assert yaml.load(files["ros"][0].read_text(), Loader=yaml.CSafeLoader)["joint_names"][0] == evil


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e5, -1e300])
def test_no_absurd_number_enters_a_programme(value):
    with pytest.raises(InputError):
        number(value)


def test_operations_out_of_order_are_refused(own):
    lines = (own / "trajectory.csv").read_text().splitlines()
    last = lines[-1].rsplit(",", 2)[1:]
    lines[20] = ",".join([*lines[20].rsplit(",", 2)[:1], *last])
    (own / "trajectory.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(PlanFileError, match="order"):
        export_files(own, "csv")


def test_a_broken_write_leaves_the_old_files(tmp_path, monkeypatch):
    write_files(tmp_path, {"a.txt": "old"})

    def broken(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, {"a.txt": "new", "b.txt": b"new"})
    assert os.listdir(tmp_path) == ["a.txt"] and (tmp_path / "a.txt").read_text() == "old"


def test_a_folder_in_the_way_is_one_line(tmp_path, folder):
    (tmp_path / "scan.csv").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        export_files(folder, "csv", out=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        export_files(folder, "csv", out=tmp_path / "file" / "below")


# --- CSV and JSON ---------------------------------------------------------------------------------


def test_csv_reads_back_equal(folder, plan, tmp_path):
    (file,) = export_files(folder, "csv", out=tmp_path)
    with file.open(newline="") as text:
        rows = list(csv.DictReader(text))
    t = plan.trajectory
    axes = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
    np.testing.assert_allclose([float(r["t_s"]) for r in rows], t.t, atol=5.1e-5)
    q = np.array([[float(r[f"{a}_deg"]) for a in axes] for r in rows])
    np.testing.assert_allclose(q, np.rad2deg(t.q), atol=5.1e-9)
    qd = np.array([[float(r[f"{a}_deg_s"]) for a in axes] for r in rows])
    np.testing.assert_allclose(qd, np.rad2deg(t.qd), atol=5.1e-6)
    assert not qd[0].any() and not qd[-1].any()
    operations = [t.operations[i] for i in t.operation]
    assert [r["kind"] for r in rows] == [o.kind for o in operations]
    assert [r["scanning"] == "1" for r in rows] == [o.scanning for o in operations]
    assert [tuple(r["viewpoints"].split()) for r in rows] == [o.viewpoints for o in operations]


def test_json_reads_back_equal(folder, plan, tmp_path):
    (file,) = export_files(folder, "json", out=tmp_path)
    data, t = json.loads(file.read_text()), plan.trajectory
    for key, value, atol in (
        ("time", t.t, 5.1e-7), ("position", t.q, 5.1e-11), ("velocity", t.qd, 5.1e-9),
        ("acceleration", t.qdd, 5.1e-7),
    ):  # fmt: skip
        np.testing.assert_allclose(data[key], value, atol=atol)
    assert data["operation"] == t.operation.tolist()
    assert [o["kind"] for o in data["operations"]] == [o.kind for o in t.operations]
    assert [tuple(o["viewpoints"]) for o in data["operations"]] == [o.viewpoints for o in t.operations]
    for key, X in data["frames"].items():
        np.testing.assert_array_equal(X, getattr(plan.record, key))


# --- viewpoints -----------------------------------------------------------------------------------


def assert_same(found, views, atol):
    assert [v.id for v in found] == [v.id for v in views]
    for a, b in zip(found, views, strict=True):
        np.testing.assert_allclose(a.X_OS, b.X_OS, atol=atol)
        assert (a.step, a.kind, a.sweep, a.note) == (b.step, b.kind, b.sweep, b.note)
        assert a.standoff == pytest.approx(b.standoff, abs=1e-12)
        assert a.slack.standoff == pytest.approx(b.slack.standoff, abs=1e-12)
        assert a.slack.tilt == pytest.approx(b.slack.tilt, abs=1e-12)
        assert a.slack.roll == b.slack.roll


def test_exported_viewpoints_read_back_equal(folder, cell, tmp_path):
    files = export_files(folder, "viewpoints", out=tmp_path)
    assert [p.suffix for p in files] == [".csv", ".json"]
    views = made_by_hand(cell).viewpoints
    for file in files:
        assert_same(read_viewpoints(file), views, 1e-10)


@pytest.mark.parametrize("ending", [".csv", ".json", ".CSV"])
def test_viewpoints_of_any_attitude_read_back(ending, tmp_path, rng):
    turns = Rotation.random(40, random_state=3).as_matrix()
    # Half turns about axes and between them, where formulas for quaternions divide by zero.
    halves = Rotation.from_rotvec(np.pi * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0]]))
    views = []
    for n, R in enumerate([np.eye(3), *halves.as_matrix(), *turns]):
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, rng.normal(size=3)
        slack = Slack(standoff=(-0.05, 0.1), tilt=0.2, roll=n % 2 == 0)
        views.append(
            Viewpoint(
                id=f"L{n}.1", X_OS=X, standoff=0.4 + 0.01 * n, step="local", kind="station",
                sweep=f"S{n // 3}", slack=slack, note='one, "two", three',
            )
        )  # fmt: skip
    file = write_viewpoints(views, tmp_path / f"views{ending}")
    assert_same(read_viewpoints(file), views, 1e-11)


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(x * x for x in q) > 1e-3))
def test_quaternions_agree_with_scipy(q):
    q = np.array(q) / np.linalg.norm(q)
    R = Rotation.from_quat(q, scalar_first=True).as_matrix()
    np.testing.assert_allclose(rotation(q), R, atol=1e-14)
    np.testing.assert_allclose(rotation(quaternion(R)), R, atol=1e-13)
    assert quaternion(R)[0] >= 0


def one_view(**more):
    given = {"id": "V1", "X_OS": look_at(np.array([1.0, 0, 0.5]), np.array([-1.0, 0, 0]))}
    return Viewpoint(**given | {"standoff": 0.6, "step": "local", "kind": "station"} | more)


@pytest.mark.parametrize(
    "old, new, word",
    [
        ("id,step", "name,step", "column .name. is unknown"),
        ("V1,local", "V1,lokal", "step"),
        ("station", "stand", "kind"),
        ("600", "nan", "finite"),
        ("600", "six", "row 2"),
        ("600", "-600", "standoff_m"),
        ("600", "1e9", "standoff_m"),
        ("V1", "V 1", "id"),
        ("V1", "=V1", "id"),
        ("1000", "1e309", "finite"),
        ("1000", "1e9", "pose"),
        (",1,\n", ",yes,\n", "slack_roll"),
        (",1,\n", ",1,=1+1\n", "note"),
        (",1,\n", ",1\n", "fields"),
        (",1,\n", ',1,"open\n', "CSV"),
        ("0.5,", "0.7,", "quaternion"),
    ],
)
def test_spoilt_csv_is_one_line(old, new, word, tmp_path):
    file = write_viewpoints([one_view()], tmp_path / "v.csv")
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=word) as caught:
        read_viewpoints(file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", "{", "null", '{"version": 1}', '{"version": 2, "viewpoints": []}',
        '{"version": 1, "viewpoints": {}}', '{"version": 1, "viewpoints": []}',
        '{"version": 1, "viewpoints": [1]}', '{"version": 1, "viewpoints": [{"id": "V"}]}',
        '{"version": 1, "viewpoints": NaN}', "[" * 100_000,
    ],
)  # fmt: skip
def test_spoilt_json_is_one_line(text, tmp_path):
    file = tmp_path / "v.json"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        read_viewpoints(file)
    assert "\n" not in str(caught.value)


def test_json_with_a_sheared_pose_or_a_further_key_is_refused(tmp_path):
    file = write_viewpoints([one_view()], tmp_path / "v.json")
    data = json.loads(file.read_text())
    data["viewpoints"][0]["X_OS"][0][0] += 0.1
    file.write_text(json.dumps(data))
    with pytest.raises(InputError, match="rigid"):
        read_viewpoints(file)
    data["viewpoints"][0] = json.loads(write_viewpoints([one_view()], file).read_text())["viewpoints"][0]
    data["viewpoints"][0]["colour"] = "red"
    file.write_text(json.dumps(data))
    with pytest.raises(InputError, match="colour"):
        read_viewpoints(file)


def test_viewpoints_are_unique_and_files_known(tmp_path):
    file = write_viewpoints([one_view(), one_view()], tmp_path / "v.csv")
    with pytest.raises(InputError, match="twice"):
        read_viewpoints(file)
    with pytest.raises(InputError, match=r"\.csv or \.json"):
        write_viewpoints([one_view()], tmp_path / "v.txt")
    with pytest.raises(InputError, match="cannot be read"):
        read_viewpoints(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text"):
        read_viewpoints(tmp_path / "bytes.csv")
    for spoilt in (one_view(id="a\nb"), one_view(note="two\nlines"), one_view(sweep="@x")):
        with pytest.raises(InputError):
            write_viewpoints([spoilt], tmp_path / "w.csv")
    assert not (tmp_path / "w.csv").exists()


def test_a_spreadsheets_byte_order_mark_and_line_ends_are_read(tmp_path):
    file = write_viewpoints([one_view()], tmp_path / "v.csv")
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert_same(read_viewpoints(file), [one_view()], 1e-11)


# --- poses and knots ------------------------------------------------------------------------------


def test_arm_agrees_with_the_cells_kinematics_and_published_poses(cell, plan, rng):
    arm = arm_for_poses((plan.folder / "robot.urdf").read_text(), plan.record.robot_joints, "tool0")
    q = rng.uniform(-2, 2, (50, 7))
    poses = np.asarray(cell.X_WB) @ arm.X_BF(q) @ np.asarray(cell.X_FS)
    np.testing.assert_allclose(poses, scanner_poses(cell, q), atol=1e-9)
    # KR 240 R2900-2 at a generic pose: x, y, z in metres, A, B, C in degrees.
    X = arm.X_BF(np.deg2rad([[15, -75, 110, -20, 35, 50]]))[0]
    np.testing.assert_allclose(X[:3, 3], [1.781355, -0.428570, 1.124713], atol=1e-6)
    np.testing.assert_allclose(
        np.rad2deg(abc_from_rotation(X[:3, :3])), [-158.7481, 24.1078, -176.8023], atol=1e-4
    )
    assert np.rad2deg(arm.velocity) == pytest.approx([103, 94, 100, 170, 129, 206], abs=1e-3)


@given(st.floats(-np.pi, np.pi), st.sampled_from([-90.0, 90.0, 0.0, 33.0, -89.9999]), st.floats(-3, 3))
def test_abc_turns_back_into_the_rotation(a, b, c):
    R = Rotation.from_euler("ZYX", [a, np.deg2rad(b), c]).as_matrix()
    back = Rotation.from_euler("ZYX", abc_from_rotation(R)).as_matrix()
    np.testing.assert_allclose(back, R, atol=1e-8)


@pytest.mark.parametrize(
    "text",
    [
        "", "<robot/>", "<robot", "<robot><joint name='A1' type='revolute'/></robot>",
        '<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>',
    ],
)  # fmt: skip
def test_urdfs_without_the_chain_are_refused(text):
    with pytest.raises(PlanFileError):
        arm_for_poses(text, ("A1",), "tool0")


def test_a_urdf_that_bites_its_tail_is_refused():
    link = "<joint name='{0}' type='fixed'><parent link='{1}'/><child link='{2}'/></joint>"
    with pytest.raises(PlanFileError):
        arm_for_poses(f"<robot>{link.format('a', 'x', 'y')}{link.format('b', 'y', 'x')}</robot>", (), "x")


def test_a_straight_path_needs_two_knots_and_a_corner_three():
    line = np.linspace(0, 1, 50)[:, None] * [3.0, -2.0]
    assert polyline_knots(line, 1e-6, most=9)[0].tolist() == [0, 49]
    corner = np.vstack([line, line[-1] + np.linspace(0, 1, 20)[1:, None] * [0.0, 5.0]])
    assert polyline_knots(corner, 1e-6, most=9)[0].tolist() == [0, 49, 68]


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.1, 0.5]))
def test_polyline_keeps_its_tolerance_by_brute_force(seed, tolerance):
    path = np.cumsum(np.random.default_rng(seed).normal(size=(60, 2)), axis=0) * 0.2
    knots, rest = polyline_knots(path, tolerance, most=60)
    assert knots[0] == 0 and knots[-1] == 59 and rest <= tolerance
    for a, b in pairwise(knots):
        dense = path[a] + np.linspace(0, 1, 2001)[:, None] * (path[b] - path[a])
        for p in path[a : b + 1]:
            assert np.abs(dense - p).max(axis=1).min() <= tolerance + 1e-3


def test_knots_are_bounded_in_number():
    path = np.random.default_rng(0).normal(size=(500, 3))
    knots, rest = polyline_knots(path, 1e-6, most=40)
    assert len(knots) <= 40 and rest > 0.1


def test_a_cubic_between_rests_needs_no_inner_knot():
    t = np.linspace(0, 0.2, 21)
    s = t / 0.2
    q = np.column_stack([3 * s**2 - 2 * s**3, -7 * (3 * s**2 - 2 * s**3)])
    knots, away = spline_knots(t, q, 1e-9, longest=0.25, shortest=0.04, most=99)
    assert knots.tolist() == [0, 20] and away < 1e-12


def test_spline_knots_keep_their_distances():
    t = np.linspace(0, 4, 401)
    q = 40 * np.sin(12 * smooth(t / 4)[0])[:, None]
    knots, away = spline_knots(t, q, 1e-3, longest=0.25, shortest=0.04, most=600)
    gaps = np.diff(t[knots])
    assert gaps.min() >= 0.04 - 1e-9 and gaps.max() <= 0.26
    assert away <= 1e-2
    few, _ = spline_knots(t, q, 1e-6, longest=0.25, shortest=0.04, most=20)
    assert len(few) <= 20


def test_commands_of_the_page_run(folder, tmp_path, monkeypatch):
    """All but `plan`, whose folder is there already, in the page's order: what is broken off is taken up."""
    page = Path(__file__).resolve().parents[1] / "docs" / "exports.md"
    known = ("scanmotion export ", "scanmotion run ", "scanmotion verify rest")
    lines = [x for x in page.read_text().splitlines() if x.startswith(known)]
    assert {x.split()[4] for x in lines if " export " in x and "--rest" not in x} == set(HERE)
    assert sum("--rest" in x for x in lines) == 1
    shutil.copytree(folder, tmp_path / "statue")
    monkeypatch.chdir(tmp_path)
    for line in lines:
        more = ["--no-dynamics"] if " run " in line else []
        result = CliRunner().invoke(app, [*line.split()[1:], *more])
        # A run that loses its power says so by its status.
        assert result.exit_code == (1 if "--stop-at" in line else 0), (line, result.output)
    assert (tmp_path / "rest" / "scan.src").is_file()


def test_the_page_names_every_column_and_topic():
    from scanmotion.export import csv_file, ros, viewpoints

    text = (Path(__file__).resolve().parents[1] / "docs" / "exports.md").read_text()
    for name in (*viewpoints.HEADER, ros.TRAJECTORY, ros.STATES, ros.SCANNING):
        assert f"`{name}`" in text, name
    for name in csv_file.HEADER:
        ends = {name, name.replace("A1", "E1")} if name[0] in "AE" else {name}
        assert any(f"`{x}`" in text for x in ends) or name[:2] in ("A2", "A3", "A4", "A5", "A6"), name


WORDS = ("nan", "inf", "1e308", "-1", "", "x", "\n", "null", "[]", '"a"', ",", "A1", "\u2028", "=", "999999")


def mutated(text, rng):
    """A number or a stretch of the text replaced by a word."""
    for _ in range(rng.integers(1, 4)):
        i = int(rng.integers(len(text)))
        word = WORDS[rng.integers(len(WORDS))]
        found = re.compile(r"-?\d+(\.\d*)?(e-?\d+)?").search(text, i) if rng.random() < 0.7 else None
        a, b = found.span() if found else (i, i + int(rng.integers(0, 40)))
        text = text[:a] + word + text[b:]
    return text


def test_mutated_plans_are_exported_or_refused_in_one_line(own, tmp_path, rng):
    rows = (own / "trajectory.csv").read_text().splitlines()
    (own / "trajectory.csv").write_text("\n".join([rows[0], *rows[1::100], rows[-1]]) + "\n")
    whole = {name: (own / name).read_text() for name in ("trajectory.csv", "plan.json", "robot.urdf")}
    refused = 0
    for n in range(280):
        name = list(whole)[n % 3]
        (own / name).write_text(mutated(whole[name], rng))
        try:
            export_files(own, FORMATS[n % 7], out=tmp_path / "out")
        except ScanMotionError as error:
            assert "\n" not in str(error)
            refused += 1
        (own / name).write_text(whole[name])
    assert 50 < refused < 280


@pytest.mark.parametrize("ending", [".csv", ".json"])
def test_mutated_viewpoints_are_read_or_refused_in_one_line(ending, tmp_path, rng):
    file = write_viewpoints([one_view(), one_view(id="V2", sweep="S")], tmp_path / f"v{ending}")
    text, refused = file.read_text(), 0
    for _ in range(500):
        file.write_text(mutated(text, rng))
        try:
            assert all(np.isfinite(v.X_OS).all() for v in read_viewpoints(file))
        except InputError as error:
            assert "\n" not in str(error)
            refused += 1
    assert 50 < refused < 500
