"""One continuous motion: sight by directions, the table's travel, limits, the search, a judged plan."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_plan import TINY, pitted

from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.errors import InputError
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import look_at
from scanmotion.export import export_files
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.geometry.parts.revolved import swept_part
from scanmotion.judge import verify
from scanmotion.judge.programme.check import verify_programme
from scanmotion.judge.views import _around
from scanmotion.motion.continuous.options import ContinuousOptions
from scanmotion.motion.continuous.table_travel import MOST_PIECES, angle_at, pieces_of
from scanmotion.motion.timing.path import turns_in
from scanmotion.plan_io.read import read_json
from scanmotion.plan_io.save import judged
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.planning.replan import replan
from scanmotion.planning.state import PlanState
from scanmotion.planning.steps.continuous import better_motion
from scanmotion.sensing.sight import grid_cell_of, masks_of, octahedral, sight_from, unpacked
from scanmotion.sensing.visibility import revolution_poses, scene_from, sees

FEW = ContinuousOptions(places=4000, hard=1200, evaluations=400, again=100, rounds=3, azimuths_deg=(0.0,))


@pytest.fixture(scope="module")
def moving():
    """A block with a pit, scanned by one motion that was hardly searched for."""
    options = PlanOptions(seed=5, motion="continuous", search=FEW, **TINY)
    return plan(pitted(), load_cell("kr240"), options=options)


def test_every_direction_falls_into_its_own_cell():
    d = octahedral(24)
    assert [grid_cell_of(*v, 24) for v in d] == list(range(24 * 24))
    assert np.allclose(np.linalg.norm(d, axis=1), 1.0)


def test_sight_by_directions_agrees_with_rays():
    part = pitted()
    scanner = load_cell("kr240").scanner_model()
    s = surface_samples(part, 3000, rng=np.random.default_rng(1))
    scene = scene_from(part.vertices, part.triangles, table_radius=0.5)
    sight = sight_from(scene, scanner, s.points, s.normals)
    X = look_at(np.array([0.62, 0.1, 0.45]), np.array([-1.0, -0.1, -0.5]), roll=0.4)
    masks = masks_of(sight, X[None], 2 * np.pi * np.arange(30) / 30)
    ours = unpacked(masks[0], len(s.points))
    true = sees(scene, scanner, revolution_poses(X, 30), s.points, s.normals)
    assert true.any(axis=1).all()
    assert (ours != true).mean() < 0.003


def test_a_convex_part_hides_nothing_but_its_far_side():
    box, scanner = box_part(0.2, 0.15, 0.2), load_cell("kr240").scanner_model()
    s = surface_samples(box, 2000, rng=np.random.default_rng(2))
    top = s.normals[:, 2] > 0.9
    sight = sight_from(scene_from(box.vertices, box.triangles), scanner, s.points[top], s.normals[top])
    X = look_at(np.array([0.3, 0.0, 0.7]), np.array([-0.3, 0.0, -0.5]))
    assert unpacked(masks_of(sight, X[None], np.zeros(1))[0, 0], int(top.sum())).all()


def test_the_swept_solid_holds_the_part_at_every_angle(lump):
    swept = swept_part(lump)
    low, high = swept.bounds
    assert low[2] == pytest.approx(lump.bounds[0, 2]) and high[2] == pytest.approx(lump.bounds[1, 2])
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(swept.vertices.astype(np.float32), swept.triangles.astype(np.uint32))
    for angle in np.linspace(0.0, 6.0, 7):
        c, s = np.cos(angle), np.sin(angle)
        p = lump.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
        assert scene.compute_signed_distance(p.astype(np.float32)).numpy().max() < 1e-5


@pytest.mark.parametrize("total", [1.0, 5.0, 14.0, 40.0, 75.0])
def test_the_search_and_the_drive_agree_on_the_tables_angle(kr240_cell, total):
    cell = kr240_cell
    v, a, j = (float(x[6]) for x in (cell.v_max, cell.a_max, cell.j_max))
    ramp, room, first = v / a + a / j, float(cell.q_max[6]), 9.0
    pieces = np.zeros((MOST_PIECES, 3))
    n = pieces_of(total, first, first + room, 2 * room, v, ramp, pieces)
    angles = np.array([angle_at(t, pieces, n, 1.0, v, ramp, 0.0) for t in np.linspace(0, total, 2000)])
    assert np.abs(angles).max() <= room + 1e-9
    assert np.abs(np.diff(angles)).max() <= v * total / 1999 * 1.0001
    turns = turns_in(cell, total, 0.0, 1.0, first)
    # Both leave the same room: ramps differ in shape, not in angle.
    assert abs(sum(turns) - angles[-1]) < 0.35
    assert np.abs(np.cumsum(turns)).max() <= room + 1e-9


def test_a_continuous_plan_passes_the_judge(moving, saved):
    assert judged(moving, judge=verify).findings == ()
    (operation,) = moving.trajectory.operations
    assert operation.kind == "path" and operation.scanning
    assert moving.completeness()["final"] > 0.9
    assert moving.time_s()["floor"] <= moving.time_s()["total"]
    told = read_json(saved, "summary.json")["motion"]
    assert told["kind"] == "continuous" and told["seconds"] == pytest.approx(operation.t_end, abs=0.02)
    assert verify(saved) == []


def test_the_motion_starts_at_home_and_keeps_its_limits(moving):
    t, cell = moving.trajectory, moving.cell
    assert np.allclose(t.q[0], cell.home)
    assert np.abs(t.qd[[0, -1]]).max() < 1e-9
    for values, limit in ((t.qd, cell.v_max), (t.qdd, cell.a_max)):
        assert (np.abs(values) <= limit * (1 + 1e-6)).all()
    # The derivatives are those of the positions.
    assert np.abs(np.gradient(t.q, t.t, axis=0)[2:-2] - t.qd[2:-2]).max() < 5e-3


def test_the_judge_sees_a_path_that_is_driven_too_fast(moving):
    t, faster = moving.trajectory, 0.6
    (o,) = t.operations
    quick = replace(
        t, t=t.t * faster, qd=t.qd / faster, qdd=t.qdd / faster**2,
        operations=(replace(o, t_end=o.t_end * faster),),
    )  # fmt: skip
    codes = {f.code for f in judged(replace(moving, trajectory=quick), judge=verify).findings}
    assert {"tcp_speed", "velocity"} <= codes


def test_the_judge_misses_a_viewpoint_that_a_path_does_not_pass(moving):
    segment = moving.segments[0]
    away = segment.reaches[0].viewpoint
    X = away.X_OS.copy()
    X[2, 3] += 0.02
    reaches = (replace(segment.reaches[0], viewpoint=away.moved(X)), *segment.reaches[1:])
    wrong = replace(moving, segments=(replace(segment, reaches=reaches),))
    assert any(f.code == "viewpoint" and f.where == away.id for f in judged(wrong, judge=verify).findings)


@pytest.fixture(scope="module")
def saved(moving, tmp_path_factory):
    folder = tmp_path_factory.mktemp("moving") / "plan"
    moving.save(folder)
    return folder


def test_classic_krl_drives_the_motion_in_small_moves_slower_than_the_plan(saved, tmp_path):
    report = verify_programme(main_of(export_files(saved, "krl", out=tmp_path)), saved, clearance=False)
    assert report.findings == ()
    path = report.deviations[0]
    assert path.kind == "path" and not path.timed and max(path.away_deg, path.missed_deg) < 0.04
    # No joint is faster than the plan at its fastest; whole percentages and exact stops cost some time.
    assert path.faster < 1.005 and 1.0 < path.seconds / path.planned_s < 1.4


@pytest.fixture(scope="module")
def timed(saved, tmp_path_factory):
    """The motion as a timed programme."""
    return export_files(saved, "krl-timed", out=tmp_path_factory.mktemp("krl"))


def main_of(files):
    return next(f for f in files if f.name == "scan.src")


def test_a_timed_programme_drives_the_motion_and_every_viewpoint_of_it(timed, saved):
    report = verify_programme(main_of(timed), saved)
    # Faults of the scanner in the middle of the motion, and its way back, are among what is tried.
    assert report.findings == ()
    path = report.deviations[0]
    assert path.kind == "path" and max(path.away_deg, path.missed_deg) < 0.02
    assert path.seconds == pytest.approx(path.planned_s, rel=0.005)


def test_a_way_back_that_leaves_the_motion_is_found(timed, saved, tmp_path):
    for file in timed:
        text, changed = file.read_bytes().decode(), ""
        for line in text.split("\r\n"):
            on_the_way_back = line.startswith("PTP {A1 ") and "_AT>=" in changed[-60:]
            changed += (line.replace("PTP {A1 ", "PTP {A1 1") if on_the_way_back else line) + "\r\n"
        (tmp_path / file.name).write_bytes(changed[:-2].encode())
    before = {f.name: f.read_bytes() for f in timed}
    assert any((tmp_path / name).read_bytes() != data for name, data in before.items())
    assert verify_programme(tmp_path / "scan.src", saved, clearance=False).findings


def test_a_path_between_two_samples_is_turned_as_a_rotation():
    X = np.tile(np.eye(4), (3, 1, 1))
    for k in range(3):
        X[k, :3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.02 * k]).as_matrix()
        X[k, 0, 3] = 0.003 * k
    between = _around(X, 1)
    assert np.allclose(between[:, :3, :3] @ np.swapaxes(between[:, :3, :3], 1, 2), np.eye(3), atol=1e-12)
    angle = Rotation.from_matrix(between[:, :3, :3]).as_rotvec()[:, 2]
    assert np.allclose(angle, 0.02 / 0.003 * between[:, 0, 3], atol=1e-9)


def asked_of(**options):
    return cast(Any, SimpleNamespace(options=PlanOptions(motion="auto", **options), budget_s=60.0))


def programme_state(seconds, seen, motion=None):
    """A state whose twin has seen some of 1000 samples."""
    t = np.array([0.0, seconds])
    trajectory = Trajectory(
        t=t, q=np.zeros((2, 7)), qd=np.zeros((2, 7)), qdd=np.zeros((2, 7)),
        operation=np.zeros(2, dtype=int), operations=(),
    )  # fmt: skip
    return PlanState(
        seen=np.arange(1000) < seen, evidence=cast(Any, None), trajectory=trajectory, motion=motion,
        visible=np.ones(1000, bool),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("moving", "still", "options", "kept"),
    [
        ((28.0, 990), (43.0, 990), {}, "continuous"),
        ((28.0, 989), (43.0, 990), {}, "stops"),
        ((43.0, 999), (43.0, 990), {}, "stops"),
        ((28.0, 985), (43.0, 990), {"completeness": 0.98}, "continuous"),
        ((28.0, 970), (43.0, 990), {"completeness": 0.98}, "stops"),
        ((59.0, 995), (43.0, 990), {"fill": True}, "continuous"),
        ((59.0, 990), (43.0, 990), {"fill": True}, "stops"),
        ((70.0, 999), (43.0, 990), {"fill": True}, "stops"),
    ],
)
def test_auto_keeps_the_one_that_sees_no_less_in_fewer_seconds(moving, still, options, kept):
    found = better_motion(
        asked_of(**options), programme_state(*moving, motion={"kind": "continuous"}), programme_state(*still)
    )
    assert found.duration == (moving if kept == "continuous" else still)[0]
    assert found.motion is not None and found.motion["kind"] == kept
    assert str(found.motion["note"]).startswith(f"{kept} (") and "rather than" in str(found.motion["note"])


@pytest.mark.parametrize("motion", ["continuous", "auto"])
def test_where_no_motion_can_be_driven_stops_are_planned_and_the_plan_says_so(motion, tmp_path):
    # Behind the table the arm reaches nothing.
    nowhere = replace(FEW, azimuths_deg=(180.0,))
    options = PlanOptions(seed=5, motion=motion, search=nowhere, **TINY)
    made = plan(box_part(0.2, 0.15, 0.2), load_cell("kr240"), options=options)
    assert made.trajectory is not None
    assert "path" not in {o.kind for o in made.trajectory.operations}
    made.save(tmp_path / "plan")
    told = cast(dict, read_json(tmp_path / "plan", "summary.json"))["motion"]
    assert told["kind"] == "stops" and "no continuous motion can be driven" in told["note"]


def test_csv_carries_the_motion_as_it_is(saved, moving, tmp_path):
    (file,) = export_files(saved, "csv", out=tmp_path)
    assert len(file.read_text().splitlines()) == len(moving.cycle.t) + 1


@pytest.mark.parametrize("done", ["", "P1"])
def test_a_motion_is_not_taken_up_in_its_middle(done, moving):
    with pytest.raises(InputError, match="cannot be taken up in its middle"):
        replan(moving, done=done)


@pytest.mark.parametrize(
    "told",
    [
        {"motion": "continuous", "source": "box"},
        {"motion": "continuous", "mode": "paper"},
        {"motion": "continuous", "helix": True},
        {"motion": "slow"},
        {"completeness": 0.9},
        {"motion": "continuous", "completeness": 1.5},
    ],
)
def test_what_cannot_be_asked_for_is_refused(told):
    with pytest.raises(InputError):
        PlanOptions(**told)
