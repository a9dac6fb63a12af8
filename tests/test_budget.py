"""The budget: costs add up, curves are unions counted by hand, and advice comes true when it is followed."""

import itertools

import numpy as np
import pytest
from judged_plan import hand_made_plan
from judging import summarised
from test_plan import TINY

from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.tour import Stop
from scanmotion.plan_io.load import load_plan
from scanmotion.planning.pipeline import PlanOptions
from scanmotion.planning.replan import replan
from scanmotion.planning.worth.budget import Coverage, budget_record, coverage_of
from scanmotion.report.page import report_html
from scanmotion.sensing.simulator.simulate import ScanErrors, captures_from_trajectory, simulate
from scanmotion.sensing.visibility import scene_from

OPTIONS = PlanOptions(seed=5, **TINY)


@pytest.fixture(scope="module")
def made():
    return hand_made_plan()


@pytest.fixture(scope="module")
def stops(made):
    scanning = [o for o in made.trajectory.operations if o.scanning]
    sweeps = {o.index: made.trajectory.q[made.trajectory.operation == o.index] for o in scanning}
    return [
        Stop(
            viewpoints=o.viewpoints, kind=o.kind, q_in=o.q_start, q_out=o.q_end,
            path=sweeps[o.index] if o.kind == "sweep" else None,
        )
        for o in scanning
    ]  # fmt: skip


@pytest.fixture(scope="module")
def coverage():
    """Three stops over ten samples; the last adds nothing of its own."""
    masks = np.zeros((3, 10), bool)
    masks[0, :8] = masks[1, 6:] = masks[2, 2:7] = True
    return Coverage(masks=tuple(masks), whole=0.9)


def with_limit(cell, limit):
    process = cell.settings.process.model_copy(update={"budget_s": limit})
    from scanmotion.cell.build import build_cell

    return build_cell(cell.settings.model_copy(update={"process": process}), cell.part)


@pytest.fixture(scope="module")
def record(made, stops, coverage):
    return budget_record(with_limit(made.cell, 10.0), made.trajectory, stops, 9.0, coverage)


def test_costs_add_up_to_the_programme(record, made):
    assert sum(c.seconds for c in record.costliest) == pytest.approx(made.trajectory.duration, abs=0.01)
    seconds = [c.seconds for c in record.costliest]
    assert seconds == sorted(seconds, reverse=True)
    for cost in record.costliest:
        o = made.trajectory.operations[cost.operation]
        assert cost.viewpoints == list(o.viewpoints) and cost.kind == o.kind
        assert cost.seconds - cost.of_which_way == pytest.approx(o.t_end - o.t_start, abs=0.002)


def test_what_is_lost_is_what_nothing_else_sees(record):
    lost = {c.kind: c.completeness_lost_without for c in record.costliest}
    assert lost == pytest.approx({"revolution": 0.9 * 0.2, "sweep": 0.9 * 0.2, "dwell": 0.0})


def test_by_order_counts_unions(record, made, coverage):
    ends = [o.t_end for o in made.trajectory.operations if o.scanning]
    assert [p.seconds for p in record.by_order] == pytest.approx(ends, abs=0.01)
    assert [p.completeness for p in record.by_order] == pytest.approx([0.72, 0.9, 0.9])


def test_the_curve_counts_unions_of_what_is_left(record, made, stops, coverage):
    curve = record.curve
    assert curve[0].seconds == pytest.approx(made.trajectory.duration, abs=0.01)
    assert curve[0].completeness == 0.9 and not curve[0].left_out
    assert curve[-1].completeness == 0.0 and curve[-1].seconds == pytest.approx(0.0, abs=0.01)
    left = list(range(len(stops)))
    for point in curve[1:]:
        gone = [n for n in left if set(stops[n].viewpoints) == set(point.left_out)]
        assert len(gone) == 1
        left.remove(gone[0])
        union = np.any([coverage.masks[n] for n in left], axis=0).mean() if left else 0.0
        assert point.completeness == pytest.approx(0.9 * union, abs=1e-6)
    assert not left
    for a, b in itertools.pairwise(curve):
        assert a.completeness >= b.completeness and a.seconds >= b.seconds
    # What adds nothing goes first.
    assert curve[1].left_out == list(stops[2].viewpoints)


def test_inside_the_budget_nothing_is_advised(made, stops, coverage):
    record = budget_record(with_limit(made.cell, 1000.0), made.trajectory, stops, 9.0, coverage)
    assert record.ok and record.advice == [] and record.curve


def test_over_the_budget_something_is_always_advised(made, stops, coverage):
    for limit, seen in itertools.product((1.0, 10.0, made.trajectory.duration - 0.1), (coverage, None)):
        record = budget_record(with_limit(made.cell, limit), made.trajectory, stops, 9.0, seen)
        assert not record.ok and record.advice
        assert any("no order" in a for a in record.advice) == (limit < 9.0)
        assert seen is not None or (record.curve == [] == record.by_order)


def test_coverage_is_what_the_twin_sees(made, kr240_cell):
    """Of a dwell, whose frames are all looked at: the twin without errors sees exactly the same samples."""
    from scanmotion.geometry.parts.make_part import surface_samples

    cell, part = made.cell, made.part
    samples = surface_samples(part, 3000, rng=np.random.default_rng(1))
    every = np.ones(3000, bool)
    coverage = coverage_of(part, cell, made.trajectory, samples, every, 1.0)
    table = cell.settings.turntable
    scene = scene_from(
        part.vertices, part.triangles, table_radius=table.diameter_m / 2,
        table_z=-cell.settings.pedestal.height_m, pedestal_radius=cell.settings.pedestal.diameter_m / 2,
    )  # fmt: skip
    captures = captures_from_trajectory(
        made.trajectory, lambda q: scanner_poses(cell, q), fps=10.0, X_WT=cell.X_WT, X_TO=cell.X_TO
    )
    whole = simulate(
        scene, cell.settings.scanner_model(), captures, errors=ScanErrors.none(), stride=8,
        rng=np.random.default_rng(0), samples=samples,
    ).seen  # fmt: skip
    known = np.any(coverage.masks, axis=0)
    assert known.all()
    # Frames between those looked at may add a little.
    assert 0.98 * whole.sum() <= len(known) <= whole.sum()


@pytest.fixture(scope="module")
def planned(pitted_plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("budget") / "plan"
    pitted_plan.save(folder)
    return folder, pitted_plan


def test_the_summary_agrees_with_the_plan(planned):
    _, result = planned
    budget = result.summary.budget
    assert budget.ok and budget.advice == []
    assert budget.curve[0].completeness == pytest.approx(result.completeness()["final"], abs=1e-5)
    assert budget.by_order[-1].completeness == budget.curve[0].completeness
    assert budget.by_order[-1].seconds == pytest.approx(result.trajectory.duration, abs=0.01)
    left_out = [v for p in budget.curve for v in p.left_out]
    served = [v.id for item in result.segments for v in item.served]
    assert sorted(left_out) == sorted(served)


def test_advice_comes_true(planned, tmp_path):
    """Leaving out what the curve leaves out gives about the seconds and the completeness that it says."""
    folder, result = planned
    curve = result.summary.budget.curve
    count = len(curve) // 2
    left_out = [v for p in curve[: count + 1] for v in p.left_out]
    shorter = replan(load_plan(folder), failed=left_out, options=OPTIONS)
    assert shorter.trajectory is not None
    assert shorter.trajectory.duration == pytest.approx(curve[count].seconds, rel=0.15)
    assert shorter.completeness()["final"] == pytest.approx(curve[count].completeness, abs=0.02)


def test_the_report_shows_it(planned, tmp_path):
    folder, result = planned
    late = replan(load_plan(folder), done=result.segments[0].served[0].id, budget_s=20.0, options=OPTIONS)
    late.save(tmp_path / "late")
    loaded = load_plan(tmp_path / "late")
    page, budget = report_html(loaded), loaded.summary.budget
    assert not budget.ok and budget.advice
    assert "Over the budget" in page and "costliest stops" in page and "completeness against seconds" in page
    assert summarised(late).summary.budget == budget
