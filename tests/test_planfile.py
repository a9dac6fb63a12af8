"""The plan folder: read back as written, read without trust, written as a whole or not at all."""

import copy
import errno
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from judged_plan import Written, hand_made_files, hand_made_plan

from scanmotion.core.errors import PlanFileError, ScanMotionError
from scanmotion.judge import verify
from scanmotion.plan_io import files as plan_folder
from scanmotion.plan_io import read as plan_reader
from scanmotion.plan_io.files import atomic_folder
from scanmotion.plan_io.read import read_json, read_plan, read_text, read_trajectory
from scanmotion.plan_io.schema import CSV_HEADER, PlanRecord
from scanmotion.plan_io.write import csv_text, json_text, plan_files, plan_record


@pytest.fixture(scope="module")
def plan():
    return hand_made_plan()


@pytest.fixture(scope="module")
def files(plan):
    return plan_files(plan)


@pytest.fixture
def folder(files, tmp_path):
    return atomic_folder(tmp_path / "plan", files)


@pytest.fixture
def data(files):
    return json.loads(files["plan.json"])


def put(folder, data):
    text = data if isinstance(data, str) else json.dumps(data)
    (folder / "plan.json").write_text(text)
    return folder


def changed(data, path, value):
    """A copy with the value at a dotted path replaced, or taken out where the value is `...`."""
    data = copy.deepcopy(data)
    at, *rest = path.split(".")[::-1]
    inner = data
    for key in rest[::-1]:
        inner = inner[int(key) if isinstance(inner, list) else key]
    key = int(at) if isinstance(inner, list) else at
    if value is ...:
        del inner[key]
    else:
        inner[key] = value
    return data


# Round trip


def test_the_record_comes_back_as_it_was(plan, folder):
    assert read_plan(folder) == plan_record(plan)
    assert json_text(read_plan(folder)) == (folder / "plan.json").read_text()


def test_the_trajectory_comes_back_to_the_last_decimal(plan, folder):
    found = read_trajectory(folder, read_plan(folder))
    assert np.abs(found.t - plan.trajectory.t).max() <= 0.5e-4 + 1e-9
    assert np.abs(np.rad2deg(found.q - plan.trajectory.q)).max() <= 0.5e-8 + 1e-12
    assert np.array_equal(found.operation, plan.trajectory.operation)
    assert np.abs(found.qd - plan.trajectory.qd).max() < 0.02
    for a, b in zip(found.operations, plan.trajectory.operations, strict=True):
        assert (a.index, a.kind, a.viewpoints) == (b.index, b.kind, b.viewpoints)
        assert np.array_equal(a.q_start, b.q_start) and a.t_end == pytest.approx(b.t_end, abs=1e-6)
    assert csv_text(found) == (folder / "trajectory.csv").read_text()


def test_the_json_trajectory_has_the_samples_in_si(plan, folder):
    data = read_json(folder, "trajectory.json")
    assert np.abs(np.array(data["position"]) - plan.trajectory.q).max() < 1e-9
    assert np.abs(np.array(data["velocity"]) - plan.trajectory.qd).max() < 1e-7
    assert data["joint_names"] == ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]


def test_the_header_is_the_contracts(folder):
    first = (folder / "trajectory.csv").read_text().split("\n")[0]
    assert first == "t_s,A1_deg,A2_deg,A3_deg,A4_deg,A5_deg,A6_deg,E1_deg,operation,kind" == CSV_HEADER


def test_no_number_is_minus_zero(plan):
    assert "-0.00000000" not in csv_text(plan.trajectory)


def test_the_same_plan_twice_gives_the_same_bytes(files):
    again = hand_made_files()
    assert set(again) == set(files)
    for name, content in files.items():
        assert again[name] == content, name


# plan.json, strictly


WRONG = {
    "version": [2, 0, -1, "1", 1.0, True, None, [1], {}, ..., 10**30],
    "seed": ["0", 1.5, None, ..., True],
    "robot": [3, None, ..., "x" * 101],
    "source": ["cloud", 1],
    "joint_names": [["A1"] * 6, ["A1"] * 8, "A1..A7", [1] * 7, ...],
    "X_WB": [[], [[1, 0, 0, 0]] * 4, [[1, 0], [0, 1]], "unit", None, ...],
    "X_WB.0.0": [-1.0, 1.001, "1", 1e300, None],
    "X_FS.0.3": [1e4, 10**400],
    "X_TO.3.3": [2.0],
    "home": [[0.0] * 6, [0.0] * 8, [None] * 7],
    "limits.velocity_rad_s.0": [0.0, -1.0, "2", None],
    "limits.jerk_rad_s3.6": [-5.0, 0],
    "limits.acceleration_rad_s2": [[1.0] * 6],
    "limits.position_min_rad.1": ["-1"],
    "process.clearance_m": [-0.01, "0.03", True, ...],
    "process.budget_s": [0, -1],
    "process.scan_speed_m_s": [0.0],
    "process.surprise": [1],
    "surprise": [1],
    "bodies.0.shape": ["cone", "sphere"],
    "bodies.0.size_m": [[0.1], [0.1] * 4, "0.1"],
    "bodies.0.frame": ["scanner"],
    "viewpoints.0.X_OS.1.3": ["0", 2e3],
    "viewpoints.0.standoff_m": [0, -0.6, 101, "0.6"],
    "viewpoints.0.slack_tilt_rad": [-0.1, 4.0],
    "viewpoints.0.slack_standoff_m": [[0.1, 0.2], [-0.2, -0.1], [0.0]],
    "viewpoints.0.kind": ["pan"],
    "viewpoints.0.id": [None, 7, "x" * 101],
    "viewpoints.0.extra": [0],
    "operations.0.kind": ["wait", None],
    "operations.0.index": [-1, 0.5, "0"],
    "operations.0.t_start": [-1.0],
    "operations.0.q_end": [[0.0] * 6],
    "operations.0.viewpoints": ["G1", [1]],
    "unreachable": [[["L1"]], [["L1", "r", "s"]], "L1"],
    "urdf_file": ["../robot.urdf", "/etc/passwd", "a/b", "..", "", ".hidden", "a\\b", "x..y", "a\nb", "a\0"],
    "part_file": ["../part.ply", "C:part.ply"],
    "cell_file": ["cell.json/../../x"],
}


@pytest.mark.parametrize("path", WRONG)
def test_a_wrong_value_is_refused_with_its_key(folder, data, path):
    for value in WRONG[path]:
        with pytest.raises(PlanFileError, match=r"plan\.json: ") as caught:
            read_plan(put(folder, changed(data, path, value)))
        message = str(caught.value)
        assert "\n" not in message and len(message) < 300
        assert path.split(".")[0] in message


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
@pytest.mark.parametrize(
    "path", ["home.2", "process.budget_s", "viewpoints.0.X_OS.0.3", "operations.1.t_end"]
)
def test_what_is_no_finite_number_is_refused(folder, data, path, word):
    text = json.dumps(changed(data, path, 123456.75)).replace("123456.75", word)
    with pytest.raises(PlanFileError, match=r"plan\.json"):
        read_plan(put(folder, text))


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "3", "null", '"plan"', "{'version': 1}", '{"version": 1}', "[" * 100_000, '{"a":' * 5000,
     "9" * 5000, '{"version": 1, "seed": ' + "9" * 5000 + "}", "\ufeff{}"],
    ids=range(13),
)  # fmt: skip
def test_what_is_no_plan_is_refused(folder, text):
    with pytest.raises(PlanFileError, match=r"plan\.json"):
        read_plan(put(folder, text))


def test_bytes_that_are_no_text_are_refused(folder):
    (folder / "plan.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PlanFileError, match="not text"):
        read_plan(folder)


@pytest.mark.parametrize("name", ["plan.json", "trajectory.csv", "robot.urdf", "part.ply", "cell.json"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(PlanFileError, match=f"{name} is missing"):
        verify(folder)


@pytest.mark.parametrize("name", ["plan.json", "trajectory.csv", "robot.urdf", "part.ply", "cell.json"])
def test_a_folder_or_pipe_in_a_files_place_is_refused(folder, name):
    (folder / name).unlink()
    (folder / name).mkdir()
    with pytest.raises(PlanFileError, match=f"{name}: is not a file"):
        verify(folder)
    (folder / name).rmdir()
    os.mkfifo(folder / name)
    with pytest.raises(PlanFileError, match=f"{name}: is not a file"):
        verify(folder)


@pytest.mark.parametrize("name", ["plan.json", "trajectory.csv", "robot.urdf", "part.ply", "cell.json"])
def test_a_link_out_of_the_folder_is_refused(folder, tmp_path, name):
    outside = tmp_path / name
    (folder / name).rename(outside)
    (folder / name).symlink_to(outside)
    with pytest.raises(PlanFileError, match=f"{name}: leads out"):
        verify(folder)


def test_links_in_a_circle_are_refused(folder):
    (folder / "plan.json").unlink()
    (folder / "plan.json").symlink_to("plan.json")
    with pytest.raises(PlanFileError, match=r"plan\.json"):
        read_plan(folder)


def test_a_link_to_the_folder_is_followed(folder, tmp_path):
    (tmp_path / "link").symlink_to(folder)
    assert verify(tmp_path / "link") == []


def test_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "nowhere", tmp_path / "file"):
        with pytest.raises(PlanFileError, match="no such plan folder"):
            read_plan(path)


def test_a_file_too_large_is_refused_before_it_is_read(folder):
    with (folder / "plan.json").open("r+b") as file:
        file.truncate(1 << 40)
    with pytest.raises(PlanFileError, match="256 MiB"):
        read_plan(folder)
    with pytest.raises(PlanFileError, match="0 MiB"):
        read_text(folder, "robot.urdf", limit=10)


# trajectory.csv, strictly


def rows(folder, edit):
    path = folder / "trajectory.csv"
    lines = path.read_text().split("\n")
    path.write_text("\n".join(edit(lines)))
    return read_trajectory(folder, read_plan(folder))


FIELDS = {
    "nan": (3, "nan"), "inf": (3, "inf"), "minus infinity": (3, "-Infinity"), "empty": (3, ""),
    "underscore": (3, "1_0"), "other digits": (3, "\u0663"), "blank": (3, " 1.0"), "hexadecimal": (3, "0x10"),
    "huge": (3, "1e300"), "beyond float": (3, "1e999"), "quoted": (3, '"1.0"'), "word": (3, "one"),
    "late": (0, "1e7"), "backwards": (0, "0.0000"), "the same time": (0, "0.0300"), "negative": (0, "-1.0"),
    "operation 1.0": (8, "1.0"), "operation unknown": (8, "6"), "operation negative": (8, "-1"),
    "operation huge": (8, "9" * 400),
    "kind": (9, "sweep"), "kind empty": (9, ""), "kind capital": (9, "Transit"),
}  # fmt: skip


@pytest.mark.parametrize("name", FIELDS)
def test_a_wrong_field_is_refused(folder, name):
    at, word = FIELDS[name]

    def edit(lines):
        fields = lines[5].split(",")
        fields[at] = word
        return [*lines[:5], ",".join(fields), *lines[6:]]

    with pytest.raises(PlanFileError, match=r"trajectory\.csv: ") as caught:
        rows(folder, edit)
    assert "line 6" in str(caught.value) or "times do not increase" in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "edit",
    [
        lambda lines: [],
        lambda lines: lines[:1],
        lambda lines: lines[:2],
        lambda lines: lines[1:],
        lambda lines: [lines[0].upper(), *lines[1:]],
        lambda lines: [lines[0].replace("A2_deg,A3", "A3_deg,A2"), *lines[1:]],
        lambda lines: [*lines[:9], lines[9][:-9], *lines[10:]],
        lambda lines: [*lines[:9], lines[9] + ",", *lines[10:]],
        lambda lines: [*lines[:9], "", *lines[9:]],
        lambda lines: [*lines[:9], lines[9] + "\0", *lines[10:]],
        lambda lines: [*lines[:9], '"' + "1" * 200_000, *lines[10:]],
        lambda lines: [*lines[:3], lines[4], lines[3], *lines[5:]],
        lambda lines: [lines[0], *lines[2:]],
    ],
    ids=range(13),
)
def test_a_damaged_table_is_refused(folder, edit):
    with pytest.raises(PlanFileError, match=r"trajectory\.csv: "):
        rows(folder, edit)


def test_lines_that_end_in_another_way_are_read(folder):
    expected = read_trajectory(folder, read_plan(folder))
    found = rows(folder, lambda lines: [line + "\r" for line in lines[:-1]] + [""])
    assert np.array_equal(found.q, expected.q)


def test_too_many_samples_are_refused(folder, monkeypatch):
    monkeypatch.setattr(plan_reader, "MAX_SAMPLES", 100)
    with pytest.raises(PlanFileError, match="more than 100 samples"):
        read_trajectory(folder, read_plan(folder))


WORDS = (b"", b"-", b"9", b"e9", b"\0", b"\xff", b",", b'"', b"{", b"nan", b"\n", b"1e308")


@settings(max_examples=120)
@given(st.data())
def test_damaged_folders_are_judged_or_refused(draw):
    """Any damage ends in findings or in one error of ours; nothing else escapes."""
    written = small_files()
    name = draw.draw(st.sampled_from(["plan.json", "trajectory.csv", "robot.urdf", "part.ply", "cell.json"]))
    content = written[name]
    content = bytearray(content if isinstance(content, bytes) else content.encode())
    for _ in range(draw.draw(st.integers(1, 3))):
        at = draw.draw(st.integers(0, max(len(content) - 1, 0)))
        word = draw.draw(
            st.sampled_from(
                [b"", b"-", b"9", b"e9", b"\0", b"\xff", b",", b'"', b"{", b"nan", b"\n", b"1e308"]
            )
        )
        cut = draw.draw(st.integers(0, 12))
        content[at : at + cut] = word
    with tempfile.TemporaryDirectory() as work:
        target = Path(work) / "plan"
        target.mkdir()
        for other, text in written.items():
            (target / other).write_bytes(text if isinstance(text, bytes) else text.encode())
        (target / name).write_bytes(bytes(content))
        try:
            verify(target)
        except ScanMotionError as error:
            assert "\n" not in str(error)


_SMALL: dict = {}


def small_files():
    """The hand-made plan cut down to its dwell, so that one judgement takes milliseconds."""
    if not _SMALL:
        written = Written(hand_made_files())
        for o in range(5):
            written.drop(written.rows_of(o))
        written.operation[:] = 0
        written.table[:, 0] -= written.table[0, 0]
        written.plan["operations"] = [{**written.plan["operations"][5], "index": 0}]
        written.agree()
        written.plan["unreachable"] = [[n, "left out"] for n in ("G1", "S1", "S2", "S3")]
        _SMALL.update(written.files)
        assert "frames.csv" not in _SMALL
        _SMALL["trajectory.csv"], _SMALL["plan.json"] = written.text(), json.dumps(written.plan)
    return _SMALL


def test_the_small_plan_passes(tmp_path):
    assert verify(atomic_folder(tmp_path / "small", small_files())) == []


# Written as a whole or not at all


def listing(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def left_behind(folder):
    return [p.name for p in folder.parent.iterdir() if p.name.startswith(".")]


NEW = {"plan.json": "{}", "other.txt": "new"}


@pytest.mark.parametrize("exchange", [True, False])
def test_a_new_plan_takes_the_old_ones_place(folder, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(plan_folder, "_exchanged", lambda a, b: False)
    atomic_folder(folder, NEW)
    assert listing(folder) == {"plan.json": b"{}", "other.txt": b"new"}
    assert left_behind(folder) == []


def test_folders_above_are_made(tmp_path):
    target = atomic_folder(tmp_path / "a" / "b" / "plan", NEW)
    assert listing(target) == {"plan.json": b"{}", "other.txt": b"new"}


def test_a_full_disk_leaves_the_old_plan(folder, monkeypatch):
    before, write = listing(folder), type(folder).write_bytes

    def full(path, data):
        if path.name == "other.txt":
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(type(folder), "write_bytes", full)
    with pytest.raises(PlanFileError, match="No space left"):
        atomic_folder(folder, NEW)
    assert listing(folder) == before and left_behind(folder) == []


def test_a_rename_that_fails_puts_the_old_plan_back(folder, monkeypatch):
    before, replace = listing(folder), os.replace

    def failing(a, b):
        if str(a).endswith("new"):
            raise OSError(errno.EACCES, "Permission denied")
        return replace(a, b)

    monkeypatch.setattr(plan_folder, "_exchanged", lambda a, b: False)
    monkeypatch.setattr(os, "replace", failing)
    with pytest.raises(PlanFileError, match="Permission denied"):
        atomic_folder(folder, NEW)
    assert listing(folder) == before and left_behind(folder) == []


def test_an_error_of_another_kind_leaves_the_old_plan(folder):
    before = listing(folder)
    with pytest.raises(TypeError):
        atomic_folder(folder, {**NEW, "third": None})
    assert listing(folder) == before and left_behind(folder) == []


def test_a_killed_run_leaves_one_of_the_two_plans(tmp_path):
    # A process rewrites the folder without end and is killed at odd moments.
    target = tmp_path / "plan"
    code = (
        "import sys\nfrom scanmotion.plan_io.files import atomic_folder\nn = 0\n"
        "while True:\n    n += 1\n"
        "    atomic_folder(sys.argv[1], {'plan.json': str(n), 'a': str(n) * 20000, 'b': str(n)})\n"
        "    print(n, flush=True)\n"
    )
    for wait in (0.0, 0.013, 0.031):
        run = subprocess.Popen([sys.executable, "-c", code, str(target)], stdout=subprocess.PIPE)
        assert run.stdout is not None
        run.stdout.readline()
        time.sleep(wait)
        run.send_signal(signal.SIGKILL)
        run.wait()
        run.stdout.close()
        found = listing(target)
        number = found["plan.json"].decode()
        assert found == {"plan.json": number.encode(), "a": (number * 20000).encode(), "b": number.encode()}


@pytest.mark.parametrize("name", ["../out.txt", "/tmp/x", "a/b", "", ".", "..", ".x"])
def test_files_are_written_inside_only(folder, name):
    before = listing(folder)
    with pytest.raises(PlanFileError, match="plain file name"):
        atomic_folder(folder, {**NEW, name: "x"})
    assert listing(folder) == before


def test_what_is_not_a_plan_is_never_replaced(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    atomic_folder(home, NEW)
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.txt").write_text("years of work")
    file = tmp_path / "file"
    file.write_text("x")
    for target in (other, file):
        with pytest.raises(PlanFileError, match="left as it is"):
            atomic_folder(target, NEW)
    assert listing(other) == {"chapter.txt": b"years of work"} and file.read_text() == "x"


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(PlanFileError, match="cannot be written"):
        atomic_folder(tmp_path / "file" / "below", NEW)


def test_a_link_to_a_plan_stays_a_link(folder, tmp_path):
    link = tmp_path / "latest"
    link.symlink_to(folder)
    atomic_folder(link, NEW)
    assert link.is_symlink() and listing(folder)["other.txt"] == b"new"


def test_the_schema_is_frozen(folder):
    record = read_plan(folder)
    with pytest.raises(ValueError, match="frozen"):
        record.seed = 3  # type: ignore[misc]
    assert PlanRecord.model_config["extra"] == "forbid"
