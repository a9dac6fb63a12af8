"""A job from files alone: planned, scanned by the twin, added, planned again, fused; whole when killed."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scans import bumpy
from test_plan import PIT, pitted
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.cli import app
from scanmotion.core.errors import InputError
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.files.ply_write import write_ply
from scanmotion.geometry.parts.make_part import part_from_file, surface_samples
from scanmotion.job import store
from scanmotion.job.adding import AddOptions, add_frames
from scanmotion.job.frame_files import Intrinsics, depth_npz, frame_points, intrinsics_of
from scanmotion.job.model import errors_of, model_of
from scanmotion.job.poses import Line, posed, programme_captures, read_list, read_pose_log
from scanmotion.job.store import load_job
from scanmotion.plan_io.load import load_plan
from scanmotion.sensing.assess import accuracy, covered_samples


def run(*args, code=0):
    result = CliRunner().invoke(app, ["job", *map(str, args)])
    assert result.exit_code == code, result.output
    return json.loads(result.stdout) if "--json" in args else result.output


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """The block with a pit, as a file in millimetres."""
    part, path = pitted(), tmp_path_factory.mktemp("truth") / "block.ply"
    write_ply(path, part.vertices * 1e3, triangles=part.triangles)
    return path


@pytest.fixture(scope="module")
def first(tmp_path_factory, block):
    """A job with its global programme and the frames that the twin took along it."""
    folder = tmp_path_factory.mktemp("jobs") / "block"
    run("new", folder, "--robot", "kr240", "--box", "200", "150", "200", "--json")
    run("add", folder, "--simulate", block, "--stride", "6", "--json")
    return folder


@pytest.fixture
def job(first, tmp_path):
    """A copy that may be changed."""
    return Path(shutil.copytree(first, tmp_path / "job"))


def test_the_loop_closes_from_files_alone(job, block):
    state = run("status", job, "--json")
    assert state["plans"] and len(state["frames"]) == 1 and "next" in state["to_do"]
    before = model_of(load_job(job))
    found = run("next", job, "--json")
    assert found["plan"] == "plan-2" and found["frames"] > 0 and found["findings"] == []
    added = run("add", job, "--simulate", block, "--stride", "6", "--json")
    assert added["added"] == found["frames"] and added["poses from"] == "the log"
    told = run("report", job, "--reference", block, "--json")
    after = model_of(load_job(job))
    # Of the pit, which no turn sees wholly, the second programme shows more.
    samples = surface_samples(pitted(), 20_000, rng=np.random.default_rng(0))
    pit = (np.abs(samples.points[:, :2]) < np.array(PIT[:2]) / 2 + 1e-6).all(axis=1) & (
        samples.points[:, 2] > 0.01
    )
    shown = [
        covered_samples(samples, m.cloud.points, m.cloud.normals, distance=0.004, angle=1.0)[pit].mean()
        for m in (before, after)
    ]
    assert shown[1] > shown[0] + 0.05 and told["completeness"] > 0.75
    assert told["mean_abs_mm"] < 0.12 and len(told["segments"]) == 2
    page = (job / "report.html").read_text()
    assert page.count("data:image/png") == 3
    out = job.parent / "model.ply"
    run("model", job, "--out", out)
    points = read_geometry(out).vertices * 1e-3
    assert accuracy(points, pitted()).mean_abs < 0.12e-3


def test_the_same_frames_twice_are_noticed(job, first):
    folder = first / "scanner" / "plan-1"
    told = run("add", job, folder, "--log", folder / "log.csv", "--json")
    assert told["added"] == 0 and told["had already"] == len(list(folder.glob("*.ply")))
    assert len(load_job(job).record.batches) == 1


def test_killed_before_the_record_the_job_is_as_before(job, first, monkeypatch):
    before = (job / "job.json").read_bytes()
    one = sorted((first / "scanner" / "plan-1").glob("*.ply"))[3]
    other = job / "new-00003.ply"
    raw = read_geometry(one).vertices
    write_ply(other, raw[:-1])
    real = store.replaced

    def dies(path, data):
        if path.name == "job.json":
            raise KeyboardInterrupt
        real(path, data)

    monkeypatch.setattr(store, "replaced", dies)
    with pytest.raises(KeyboardInterrupt):
        add_frames(load_job(job), [other], AddOptions())
    monkeypatch.undo()
    assert (job / "job.json").read_bytes() == before
    assert (job / "frames-2.npz").is_file() and len(load_job(job).scans()) == 1
    done = add_frames(load_job(job), [other], AddOptions())
    assert done.frames == 1 and len(load_job(job).scans()) == 2


def test_index_time_and_log_give_one_pose(first):
    job = load_job(first)
    cell = build_cell(job.settings)
    plan = load_plan(job.plan_folder(1))
    every = programme_captures(cell, plan.trajectory)
    k = np.array([0, 7, len(every) - 1])
    by_index = [Line(file=f"{i}", index=int(i)) for i in k]
    by_time = [Line(file=f"{i}", t=float(every.t[i]) - 5.0) for i in k]
    by_pose = [Line(file=f"{i}", pose=every.X_OS[i]) for i in k]
    log = read_pose_log(first / "scanner" / "plan-1" / "log.csv", cell.joint_names)
    found = [
        posed(by_index, cell, plan.trajectory, None)[0],
        posed(by_time, cell, plan.trajectory, None, offset_s=5.0)[0],
        posed(by_time, cell, None, log, offset_s=5.0)[0], posed(by_pose, cell, None, None)[0],
    ]  # fmt: skip
    for captures in found:
        np.testing.assert_allclose(captures.X_OS, every.X_OS[k], atol=2e-5)
    np.testing.assert_allclose(found[2].rates, every.rates[k], atol=2e-3)


@pytest.mark.parametrize(("line", "word"), [
    (Line(file="a"), "nothing says where"), (Line(file="a", index=10_000), "takes"),
    (Line(file="a", t=1e6), "outside"),
])  # fmt: skip
def test_a_frame_without_a_pose_is_refused(first, line, word):
    job = load_job(first)
    with pytest.raises(InputError, match=word):
        posed([line], build_cell(job.settings), load_plan(job.plan_folder(1)).trajectory, None)


@pytest.mark.parametrize(("text", "word"), [
    ("name,index\na.ply,1\n", "column `file`"), ("file,index\na.ply,x\n", "line 2"),
    ("file,index\na.ply,-1\n", "count"),
    ("file,t_s\na.ply,nan\n", "finite"), ("file,T00\na.ply,1\n", "rigid"),
])  # fmt: skip
def test_a_wrong_list_is_refused_with_its_line(tmp_path, text, word):
    (tmp_path / "frames.csv").write_text(text)
    with pytest.raises(InputError, match=word):
        read_list(tmp_path / "frames.csv")


def test_depth_images_and_clouds_bring_the_same_points(tmp_path, rng):
    scanner = load_cell("kr240").scanner_model()
    camera = intrinsics_of(scanner)
    depth = np.full((scanner.rays[1], scanner.rays[0]), np.nan)
    depth[10:20, 30:50] = 0.6 + 0.01 * rng.random((10, 20))
    (tmp_path / "a.npz").write_bytes(depth_npz(depth, camera))
    p = frame_points(tmp_path / "a.npz", unit=1e-3, intrinsics=Intrinsics(fx=1, fy=1, cx=0, cy=0))
    # The closed form of the pixels' rays that the twin uses.
    x = np.tan(scanner.fov[0] / 2) * ((2 * np.arange(30, 50) + 1) / scanner.rays[0] - 1)
    np.testing.assert_allclose(p[:20, 0] / p[:20, 2], x, atol=1e-6)
    write_ply(tmp_path / "a.ply", p * 1e3)
    np.testing.assert_allclose(frame_points(tmp_path / "a.ply", unit=1e-3, intrinsics=camera), p, atol=1e-6)
    image = np.rint(np.nan_to_num(depth) / 1e-4).astype(np.uint16)
    png(tmp_path / "a.png", image)
    q = frame_points(tmp_path / "a.png", unit=1e-3, intrinsics=Intrinsics(**{**vars(camera), "unit_m": 1e-4}))
    np.testing.assert_allclose(q, p, atol=6e-5)
    png(tmp_path / "b.png", (image // 256).astype(np.uint8))
    with pytest.raises(InputError, match="16 bits"):
        frame_points(tmp_path / "b.png", unit=1e-3, intrinsics=camera)
    (tmp_path / "c.e57").write_bytes(b"x")
    with pytest.raises(InputError, match="E57"):
        frame_points(tmp_path / "c.e57", unit=1e-3, intrinsics=camera)


def png(path, image):
    """A grey PNG of 8 or 16 bits, written by its specification."""
    import struct
    import zlib

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    h, w = image.shape
    rows = b"".join(
        b"\0" + row.tobytes() for row in image.astype(">u2" if image.dtype == np.uint16 else "u1")
    )
    head = struct.pack(">IIBBBBB", w, h, 8 * image.dtype.itemsize, 0, 0, 0, 0)
    data = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )
    path.write_bytes(data)


def test_doors_refuse_in_one_line(tmp_path, first, block):
    for args in (
        ("status", tmp_path), ("new", first, "--box", "100", "100", "100"), ("add", first),
        ("add", first, tmp_path / "none.ply"), ("add", first, block, "--simulate", block), ("next", tmp_path),
    ):  # fmt: skip
        assert run(*args, code=2).count("\n") == 1


def test_a_calibrated_cell_places_scanner_and_axis():
    told = {"hand_eye_mm": [0.2, -0.1, 0.3], "hand_eye_deg": [0.01, 0.02, -0.03], "axis_mm": [0.4, -0.2]}
    plain, known = load_cell("kr240"), None
    known = settings_from({**plain.model_dump(mode="json"), "calibration": told})
    a, b = build_cell(plain), build_cell(known)
    from scanmotion.sensing.simulator.captures import inverse, motion

    e = errors_of(told)
    np.testing.assert_allclose(
        a.X_FS @ motion(np.array([[*e.hand_eye_m, *e.hand_eye_rad]]))[0], b.X_FS, atol=1e-12
    )
    shift = (inverse(a.X_WT[None])[0] @ b.X_WT)[:3, 3]
    np.testing.assert_allclose(shift, [4e-4, -2e-4, 0], atol=1e-12)


def test_scans_with_given_poses_and_directions_make_a_job(tmp_path, shared_data):
    """Ten range scans of the bunny from their pose file alone."""
    folder = shared_data / "bunny_range_scans"
    job = tmp_path / "bunny"
    run("new", job, "--box", "160", "130", "160", "--json")
    names = json.loads((folder / "poses.json").read_text())["scans"]
    files = [folder / n for n in names]
    told = run("add", job, *files, "--frames", folder / "poses.json", "--json")
    assert told["added"] == len(names) and told["poses from"] == "the frames list's poses"
    model = model_of(load_job(job))
    bunny = part_from_file(shared_data / "stanford_bunny.ply", place="keep")
    d = accuracy(model.cloud.points, bunny)
    assert d.mean_abs < 0.6e-3


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A job in a cell whose scanner, table and clock are off, with the frames of its global step."""
    import yaml

    folder = tmp_path_factory.mktemp("planted")
    told = load_cell("kr240").model_dump(mode="json")
    told["twin"] |= {
        "axis_mm": [0.6, -0.3],
        "hand_eye_mm": [0.2, 0.0, -0.5],
        "latency_ms": 2.0,
        "backlash_deg": 0.02,
    }
    (folder / "cell.yaml").write_text(yaml.safe_dump(told))
    part = bumpy(60)
    write_ply(folder / "lump.ply", part.vertices * 1e3, triangles=part.triangles)
    sides = [str(v) for v in np.ceil(part.extent * 1e3)]
    run("new", folder / "job", "--cell", folder / "cell.yaml", "--box", *sides, "--json")
    run("add", folder / "job", "--simulate", folder / "lump.ply", "--stride", "4", "--json")
    return folder


def test_calibration_finds_what_was_planted_and_writes_a_cell_that_scans_better(planted):
    job = load_job(planted / "job")
    # As it stands on the table: centred.
    part = part_from_file(planted / "lump.ply")
    before = accuracy(model_of(job).cloud.points, part)
    out = planted / "calibrated.yaml"
    result = CliRunner().invoke(app, ["calibrate", str(planted / "job"), "--write-cell", str(out), "--json"])
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record["determined"] and record["applied"]
    after = accuracy(model_of(load_job(planted / "job")).cloud.points, part)
    assert after.mean_abs < before.mean_abs / 5
    truth = {"axis_mm": [0.6, -0.3], "hand_eye_mm": [0.2, 0.0, -0.5], "latency_ms": 2.0, "backlash_deg": 0.02}
    for key, value in truth.items():
        off = np.abs(np.atleast_1d(record["estimated"][key]) - np.atleast_1d(value))
        assert (off < 4 * np.atleast_1d(record["sd"][key]) + 1e-6).all(), (key, record)
    known = load_cell(out)
    # In the new cell the frames lie right as they come: nothing is corrected afterwards.
    sides = [str(v) for v in np.ceil(part.extent * 1e3)]
    run("new", planted / "again", "--cell", out, "--box", *sides, "--json")
    run("add", planted / "again", "--simulate", planted / "lump.ply", "--stride", "4", "--json")
    better = accuracy(model_of(load_job(planted / "again")).cloud.points, part)
    assert better.mean_abs < before.mean_abs / 5
    assert known.calibration.latency_ms == pytest.approx(record["estimated"]["latency_ms"], abs=1e-6)


def test_calibrate_plan_proposes_turns_that_tell(tmp_path):
    part = bumpy(40)
    write_ply(tmp_path / "lump.ply", part.vertices * 1e3, triangles=part.triangles)
    args = ["calibrate", "plan", "--part", str(tmp_path / "lump.ply"), "--turns", "3", "--json"]
    result = CliRunner().invoke(app, args)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert len(told["turns"]) == 3 and told["determined"]
    senses = {t.split(" deg, ")[-1].split()[0] for t in told["turns"]}
    assert senses == {"forward", "backward"}
    assert max(told["expected_sd"]["axis_mm"]) < 0.2 and told["expected_sd"]["latency_ms"] < 1.5
