"""A tiny whole trip in memory and on disk: repeatable, judged from its files, with the contract's summary."""

import json

import numpy as np
import pytest
from judging import findings_of, summarised

import scanmotion as sm
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.errors import InputError, PartError
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.judge import verify
from scanmotion.motion.reach.find import ANALYTIC, RESCUE
from scanmotion.motion.refine import REFINED
from scanmotion.plan_io.read import read_json, read_plan, read_trajectory
from scanmotion.plan_io.schema import CSV_HEADER
from scanmotion.plan_io.write import plan_files
from scanmotion.planning.pipeline import PlanOptions, plan

TINY = {"rounds": 1, "samples": 4000, "stride": 4, "voxel": 0.004}


SIZE, PIT = (0.2, 0.15, 0.2), (0.05, 0.05, 0.08)


def pitted():
    """A block with a deep narrow pit in its top: no turn sees all of it."""
    ring = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    outer, inner, top = ring * SIZE[:2], ring * PIT[:2], SIZE[2]
    layers = ((outer, 0.0), (outer, top), (inner, top), (inner, top - PIT[2]))
    vertices = np.vstack([np.column_stack([xy, np.full(4, z)]) for xy, z in layers])
    triangles = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for low in (0, 4, 8):
        for i in range(4):
            a, b = low + i, low + (i + 1) % 4
            triangles += [[a, b, b + 4], [a, b + 4, a + 4]]
    return Part(name="pitted", vertices=vertices, triangles=np.array(triangles))


def scanned_box():
    """A measured cloud of a box with a hole in its front."""
    box = box_part(0.2, 0.15, 0.25)
    samples = surface_samples(box, 20_000, rng=np.random.default_rng(3))
    p, normals = samples.points, samples.normals
    front = normals[:, 0] > 0.9
    keep = ~(front & (np.hypot(p[:, 1], p[:, 2] - 0.13) < 0.035))
    return Part(name="scanned", vertices=p[keep], triangles=np.zeros((0, 3), int), normals=normals[keep])


@pytest.fixture(scope="module")
def settings():
    return load_cell("kr240")


@pytest.fixture(scope="module")
def planned(pitted_plan):
    return pitted_plan


@pytest.fixture(scope="module")
def saved(planned, tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "plan"
    return folder, planned.save(folder)


def test_the_pitted_block_is_closed_and_its_faces_point_outwards():
    part = pitted()
    corners = part.vertices[part.triangles]
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(np.prod(SIZE) - np.prod(PIT))
    edges = part.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there, back = {tuple(e) for e in edges.tolist()}, {tuple(e[::-1]) for e in edges.tolist()}
    assert there == back and len(there) == len(edges)


def test_both_steps_are_planned(planned):
    steps = {v.step for v in planned.viewpoints}
    assert steps == {"global", "local"}
    assert {o.kind for o in planned.trajectory.operations} >= {"transit", "revolution"}


def test_the_local_step_scans_more(planned):
    shares = planned.completeness()
    assert 0 < shares["after_global"] < shares["final"] <= 1
    assert shares["final_of_whole"] <= shares["final"]


def test_every_viewpoint_is_served_or_has_a_reason(planned):
    served = {v for o in planned.trajectory.operations if o.scanning for v in o.viewpoints}
    given_up = dict(planned.left_out)
    assert all(reason for reason in given_up.values())
    assert {v.id for v in planned.viewpoints} == served | (set(given_up) & {v.id for v in planned.viewpoints})
    assert not served & set(given_up)


def test_the_trajectory_is_continuous_and_starts_at_home(planned):
    t = planned.trajectory
    assert np.allclose(t.q[0], planned.cell.home)
    assert np.abs(np.diff(t.q, axis=0)).max() <= planned.cell.v_max.max() * 0.01 * 1.001
    for a, b in zip(t.operations, t.operations[1:], strict=False):
        assert np.abs(a.q_end - b.q_start).max() < 1e-9 and a.t_end == b.t_start


def test_the_judge_finds_nothing(saved, planned):
    folder, findings = saved
    assert findings == findings_of(planned) == verify(folder) == []


def test_findings_are_those_that_the_judge_finds_in_the_folder(settings, planned, saved, tmp_path):
    tight = settings.model_copy(update={"process": settings.process.model_copy(update={"budget_s": 5.0})})
    late = plan(box_part(0.2, 0.15, 0.3), tight, options=PlanOptions(source="box", **TINY))
    found = late.save(tmp_path / "late")
    assert [f.code for f in found] == ["budget"]
    assert found == findings_of(late) == verify(tmp_path / "late")
    summary = read_json(tmp_path / "late", "summary.json")
    assert summary["findings"] == [str(f) for f in found]
    assert summary["budget"]["limit_s"] == 5.0 and not summary["budget"]["ok"]
    assert summary["budget"]["advice"]


def test_the_summary_has_the_contracts_keys(saved, planned):
    summary = read_json(saved[0], "summary.json")
    assert set(summary) >= {
        "viewpoints", "completeness", "accuracy", "time_s", "budget", "findings", "planning_s",
    }  # fmt: skip
    assert set(summary["viewpoints"]) == {"global", "local", "unreachable", "not_worth", "solvers"}
    assert set(summary["viewpoints"]["solvers"]) == {v.id for s in planned.segments for v in s.served}
    assert set(summary["viewpoints"]["solvers"].values()) <= {ANALYTIC, RESCUE, REFINED}
    assert summary["drake"]["findings"] == 0 < summary["drake"]["checked"]
    assert all(set(u) == {"id", "reason"} for u in summary["viewpoints"]["unreachable"])
    assert set(summary["completeness"]) == {"after_global", "final", "final_of_whole"}
    assert set(summary["accuracy"]) == {"mean_abs_mm", "sd_signed_mm", "mean_signed_mm"}
    assert set(summary["time_s"]) == {"total", "arm", "table", "sweep", "dwell", "floor", "cycle"}
    assert set(summary["budget"]) == {"limit_s", "ok", "costliest", "by_order", "curve", "advice"}
    assert summary["findings"] == []
    assert summary["planning_s"]["total"] >= max(v for k, v in summary["planning_s"].items() if k != "total")
    # The margins are the judge's, of the written files.
    told = {k: v for k, v in summary.items() if k != "margins"}
    assert "margins" in summary
    assert timeless(told) == timeless(json.loads(json.dumps(planned.summary.document())))
    assert {type(v) for v in leaves(planned.summary.document())} <= {str, int, float, bool, type(None)}


def timeless(summary):
    """A summary without the seconds that planning took."""
    return {k: v for k, v in summary.items() if k != "planning_s"}


def leaves(value):
    """The values of a document that hold no others."""
    if isinstance(value, dict | list):
        inner = value.values() if isinstance(value, dict) else value
        return [leaf for item in inner for leaf in leaves(item)]
    return [value]


def test_the_summary_counts_what_the_plan_holds(saved, planned):
    summary, record = read_json(saved[0], "summary.json"), read_plan(saved[0])
    trajectory = read_trajectory(saved[0], record)
    time = summary["time_s"]
    # What is written is the cycle: the scan, and the way home behind it.
    assert time["cycle"] == pytest.approx(trajectory.duration, abs=1e-3)
    assert time["total"] == pytest.approx(max(o.t_end for o in record.operations if o.viewpoints), abs=1e-3)
    assert time["arm"] + time["table"] + time["sweep"] + time["dwell"] == pytest.approx(
        time["total"], abs=0.01
    )
    assert 0 < time["floor"] <= time["total"]
    served = {v for o in record.operations if o.kind != "transit" for v in o.viewpoints}
    for step in ("global", "local"):
        assert summary["viewpoints"][step] == sum(
            v.step == step and v.id in served for v in record.viewpoints
        )
    assert summary["budget"]["ok"] == (time["total"] <= record.process.budget_s)
    assert 0 < summary["accuracy"]["mean_abs_mm"] < 0.3


def test_the_folder_holds_the_contracts_files(saved):
    folder, _ = saved
    names = {p.name for p in folder.iterdir()}
    assert names >= {"plan.json", "summary.json", "trajectory.csv", "trajectory.json"}
    assert (folder / "trajectory.csv").read_text().startswith(CSV_HEADER + "\n")
    record = read_json(folder, "plan.json")
    assert {"version", "X_WB", "X_FS", "X_WT", "joint_names", "limits", "viewpoints", "operations"} <= set(
        record
    )
    assert all({"viewpoints", "q_start", "q_end", "t_start", "t_end"} <= set(o) for o in record["operations"])


def test_the_same_seed_gives_the_same_bytes(settings, planned):
    again = plan(pitted(), settings, options=PlanOptions(seed=5, **TINY))
    first, second = plan_files(planned), plan_files(again)
    assert first["trajectory.csv"] == second["trajectory.csv"]
    assert {k for k in first if first[k] != second[k]} == set()
    assert timeless(planned.summary.document()) == timeless(summarised(again).summary.document())


@pytest.mark.slow
def test_another_seed_gives_another_plan_that_passes_too(settings, planned, tmp_path):
    other = plan(pitted(), settings, options=PlanOptions(seed=6, **TINY))
    assert other.save(tmp_path / "other") == []
    assert not np.array_equal(other.samples.points, planned.samples.points)


def test_a_box_needs_the_global_step_only(settings, tmp_path):
    told = []
    boxed = plan(
        box_part(0.3, 0.2, 0.25), settings, options=PlanOptions(source="box", **TINY),
        progress=lambda stage, share: told.append((stage, share)),
    )  # fmt: skip
    assert {v.step for v in boxed.viewpoints} == {"global"}
    assert boxed.cloud is None and boxed.holes is None and boxed.samples is None
    assert boxed.save(tmp_path / "box") == []
    summary = read_json(tmp_path / "box", "summary.json")
    assert set(summary["completeness"].values()) == set(summary["accuracy"].values()) == {None}
    assert summary["viewpoints"]["global"] > 0 == summary["viewpoints"]["local"]
    assert read_plan(tmp_path / "box").source == "box"
    assert {stage for stage, _ in told} >= {"reach", "order", "transit", "timing"}
    assert all(0 <= share <= 1 for _, share in told)


def test_a_measured_scan_needs_the_local_step_only(settings, tmp_path):
    part = scanned_box()
    local = plan(part, settings, options=PlanOptions(source="scan", **TINY))
    assert {v.step for v in local.viewpoints} == {"local"}
    assert len(local.holes.holes) >= 1
    nearest = min(np.linalg.norm(h.center - [0.1, 0.0, 0.13]) for h in local.holes.holes)
    assert nearest < 0.02
    # Some viewpoint looks at the hole from its side.
    toward = np.array([[0.1, 0.0, 0.13]]) - np.array([v.p_OS for v in local.viewpoints])
    aligned = np.einsum("ni,ni->n", toward, np.array([v.direction for v in local.viewpoints]))
    assert (aligned / np.linalg.norm(toward, axis=1)).max() > np.cos(np.deg2rad(15))
    assert local.save(tmp_path / "scan") == []
    assert verify(tmp_path / "scan") == []


@pytest.mark.parametrize("key", ["source", "mode", "strategy", "turntable"])
@pytest.mark.parametrize("word", ["", "Mesh", "fast", "axis ", None, 3])
def test_unknown_words_are_refused(key, word):
    with pytest.raises(InputError, match=f"unknown {key} .*known: "):
        PlanOptions(**{key: word})


def test_the_twin_needs_a_mesh(settings):
    cloud = Part(
        name="cloud", vertices=np.random.default_rng(0).random((50, 3)) * 0.1, triangles=np.zeros((0, 3), int)
    )
    with pytest.raises(PartError, match="point cloud"):
        plan(cloud, settings, options=PlanOptions(**TINY))


@pytest.mark.parametrize("size", [(2.0, 0.3, 0.3), (0.3, 0.3, 1.5)])
def test_what_does_not_fit_is_refused(settings, size):
    with pytest.raises(PartError):
        plan(box_part(*size), settings, options=PlanOptions(source="box", **TINY))


def test_the_public_names_plan_and_judge(settings, tmp_path):
    public = sm.plan(box_part(0.2, 0.15, 0.3), settings, options=PlanOptions(source="box", **TINY))
    public.save(tmp_path / "public")
    assert sm.verify(tmp_path / "public") == []


def test_a_plan_ends_at_home_and_the_scans_seconds_do_not_count_the_way(pitted_plan):
    cycle = pitted_plan.cycle
    last = cycle.operations[-1]
    assert last.kind == "transit" and last.viewpoints == ()
    np.testing.assert_allclose(last.q_end, pitted_plan.cell.home, atol=1e-6)
    np.testing.assert_array_equal(cycle.q[0], pitted_plan.cell.home)
    time_s = pitted_plan.time_s()
    assert time_s["total"] == cycle.operations[-2].t_end == pitted_plan.trajectory.duration
    assert time_s["cycle"] == pytest.approx(cycle.duration) and time_s["cycle"] > time_s["total"]
    assert time_s["floor"] <= time_s["total"]
