"""Pruning: what is left out was not worth its seconds, and nothing else is lost."""

from dataclasses import replace

import numpy as np
import pytest
from judging import summarised
from test_legs import views  # noqa: F401
from test_plan import TINY, pitted

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.planning.context import context_from
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.pipeline import global_step, plan_from
from scanmotion.planning.segment import costs, segment_from, silent, with_left_out
from scanmotion.planning.state import begin, extend
from scanmotion.planning.steps.local_rounds import local_rounds
from scanmotion.planning.steps.prune import not_worth, prune, stop_masks, stops_seen
from scanmotion.sensing.visibility import revolution_poses, scene_from, seen_by_any

REASON = "not worth its seconds: it adds "


@pytest.fixture(scope="module")
def box():
    """A box, its cell, its surface and a segment over a turn and stations."""
    part = box_part(0.2, 0.15, 0.25)
    cell = build_cell(load_cell("kr240"), part)
    scene = scene_from(part.vertices, part.triangles, table_radius=0.76)
    return cell, scene, surface_samples(part, 3000, rng=np.random.default_rng(1))


@pytest.fixture(scope="module")
def segment(box, views):  # noqa: F811
    cell, _, _ = box
    fixed = [replace(v, slack=Slack(roll=False)) for v in views]
    return segment_from(cell, Clearance(cell), fixed, cell.home, rng=np.random.default_rng(3))


def test_masks_are_what_the_poses_asked_for_see(box, segment):
    cell, scene, samples = box
    every = np.arange(len(samples.points))
    masks = stop_masks(cell, segment.trajectory, scene, samples, every)
    by_id = {v.id: v for v in segment.served}
    assert len(masks) == len(segment.tour.stops) >= 3
    for stop, mask in zip(segment.tour.stops, masks, strict=True):
        view = by_id[stop.viewpoints[0]]
        X = revolution_poses(view.X_OS, 360) if view.kind == "revolution" else view.X_OS[None]
        expected = seen_by_any(scene, cell.settings.scanner_model(), X, samples.points, samples.normals)
        # A turn takes a sixth of those frames, and begins where the table stands.
        assert (mask != expected).mean() < (0.01 if view.kind == "revolution" else 0.001)
    few = every[::7]
    for mask, some in zip(masks, stop_masks(cell, segment.trajectory, scene, samples, few), strict=True):
        assert (mask[few] == some).all()


@pytest.mark.parametrize("rate", [0.0, 1e-3, 5e-3, 2e-2, 10.0])
def test_what_stays_is_worth_its_seconds_and_what_goes_is_not(box, segment, rate):
    cell, scene, samples = box
    every = np.arange(len(samples.points))
    out = not_worth(stops_seen(cell, [segment], scene, samples, every), len(every), rate=rate)
    masks = dict(zip([s.viewpoints[0] for s in segment.tour.stops],
                     stop_masks(cell, segment.trajectory, scene, samples, every), strict=True))  # fmt: skip
    seconds = dict(zip(masks, costs(cell, segment.tour, segment.trajectory), strict=True))

    def adds(name, among):
        others = [masks[k] for k in among if k != name]
        return (masks[name] & ~np.any([*others, np.zeros(len(every), bool)], axis=0)).mean()

    kept = [k for k in masks if k not in out]
    assert all(adds(k, kept) >= rate * seconds[k] for k in kept)
    # Each that went was not worth it beside those that were still there.
    left = list(masks)
    for name, reason in out.items():
        assert reason.startswith(REASON) and adds(name, left) < rate * seconds[name]
        assert f"{adds(name, left):.3%} in {seconds[name]:.1f} s" in reason
        left.remove(name)
    if rate in (0.0, 10.0):
        assert len(out) == (len(masks) if rate else 0)


def test_a_merged_segment_knows_all_of_its_viewpoints(segment):
    gone = segment.reaches[1].viewpoint.id
    new = replace(segment, reaches=(segment.reaches[0], *segment.reaches[2:]))
    earlier = replace(segment, unreachable=())
    merged = with_left_out(new, [earlier], {gone: "too dear"})
    assert [r.viewpoint.id for r in merged.reaches] == [r.viewpoint.id for r in segment.reaches]
    assert merged.unreachable == ((gone, "too dear"),)


@pytest.fixture(scope="module")
def found():
    """Both steps on the pitted block, before and after the local one, with all the time of the world."""
    ctx = context_from(pitted(), load_cell("kr240"), PlanOptions(seed=1, **TINY), silent)
    before = global_step(ctx, begin(ctx))
    return ctx, before, local_rounds(ctx, before)


@pytest.fixture(scope="module")
def padded(found):
    """A round more, that looks where all has been seen."""
    ctx, before, after = found
    useless = tuple(
        Viewpoint(
            id=f"U{k}", X_OS=look_at([0.6 * np.cos(a), 0.6 * np.sin(a), 0.2], [-np.cos(a), -np.sin(a), -0.2]),
            standoff=0.6, step="local", kind="station", slack=Slack(roll=True),
        )
        for k, a in enumerate((0.3, 2.0))
    )  # fmt: skip
    return ctx, before, extend(ctx, after, useless, step="local", rng=np.random.default_rng(0))


def test_useless_viewpoints_go_and_what_is_seen_stays(padded):
    ctx, before, after = padded
    pruned = prune(ctx, before=before, after=after)
    assert [r.step for r in pruned.segments] == ["global", "local"] and pruned.searched == after.segments
    left_out = dict(pruned.segments[-1].unreachable)
    assert {"U0", "U1"} <= set(left_out) and all(left_out[u].startswith(REASON) for u in ("U0", "U1"))
    assert pruned.duration < after.duration - 2.0
    assert pruned.seen.mean() > after.seen.mean() - 0.002
    # The global segment stays as it is.
    n = len(before.trajectory.t)
    assert pruned.trajectory.q[:n].tobytes() == after.trajectory.q[:n].tobytes()
    made = summarised(plan_from(ctx, pruned))
    ids = [v.id for v in made.viewpoints]
    assert len(ids) == len(set(ids)) and {"U0", "U1"} <= set(ids)
    summary = made.summary
    assert summary.findings == []
    assert [r.step for r in summary.searched] == ["global", "local", "local"]
    assert len(summary.rounds) == 2
    # What was seen once can be seen, also where the pruned programme does not see it.
    assert made.visible[after.seen].all()
    # Nothing is left to prune.
    assert prune(ctx, before=before, after=pruned).trajectory is pruned.trajectory


def test_pruning_changes_neither_of_its_values(padded):
    ctx, before, after = padded
    told = [(s.segments, s.trajectory, s.seen.tobytes(), s.scans, s.cloud) for s in (before, after)]
    first = prune(ctx, before=before, after=after)
    second = prune(ctx, before=before, after=after)
    assert first.trajectory.q.tobytes() == second.trajectory.q.tobytes()
    assert told == [(s.segments, s.trajectory, s.seen.tobytes(), s.scans, s.cloud) for s in (before, after)]


@pytest.mark.parametrize("share", [0.9, 0.5, 0.1])
def test_a_programme_is_brought_inside_its_budget(found, share):
    ctx, before, after = found
    first, whole = before.duration, after.duration
    assert whole > first + 1.0
    budget = first + share * (whole - first)
    process = ctx.settings.process.model_copy(update={"budget_s": budget})
    poor = replace(ctx, settings=ctx.settings.model_copy(update={"process": process}))
    pruned = prune(poor, before=before, after=after)
    assert pruned.duration <= budget
    reasons = [r for _, r in pruned.segments[-1].unreachable]
    assert any(r.startswith(("no seconds are left for it in the budget: it adds", REASON)) for r in reasons)
    assert pruned.seen.sum() >= before.seen.sum()


def test_without_pruning_the_rounds_stay_as_they_were_found(found):
    ctx, before, after = found
    kept = prune(replace(ctx, method=replace(ctx.method, prunes=False)), before=before, after=after)
    assert kept is after and kept.searched == ()
