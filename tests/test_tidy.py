"""The twin's last word: what is left out was not worth its seconds, and nothing else is lost."""

from dataclasses import replace

import numpy as np
import pytest
from test_legs import views  # noqa: F401
from test_plan import TINY, pitted

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings import load_cell
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts import box_part, surface_samples
from scanmotion.planning.pipeline import PlanOptions, Trip
from scanmotion.planning.prune import not_worth, stop_masks, stops_seen
from scanmotion.planning.segment import costs, leg_from, silent, with_left_out
from scanmotion.sensing.visibility import revolution_poses, scene_from, seen_by_any

REASON = "not worth its seconds: it adds "


@pytest.fixture(scope="module")
def box():
    """A box, its cell, its surface and a leg over a turn and stations."""
    part = box_part(0.2, 0.15, 0.25)
    cell = build_cell(load_cell("kr240"), part)
    scene = scene_from(part.vertices, part.triangles, table_radius=0.76)
    return cell, scene, surface_samples(part, 3000, rng=np.random.default_rng(1))


@pytest.fixture(scope="module")
def leg(box, views):  # noqa: F811
    cell, _, _ = box
    fixed = [replace(v, slack=Slack(roll=False)) for v in views]
    return leg_from(cell, Clearance(cell), fixed, cell.home, rng=np.random.default_rng(3))


def test_masks_are_what_the_poses_asked_for_see(box, leg):
    cell, scene, samples = box
    every = np.arange(len(samples.points))
    masks = stop_masks(cell, leg.trajectory, scene, samples, every)
    by_id = {v.id: v for v in leg.served}
    assert len(masks) == len(leg.tour.stops) >= 3
    for stop, mask in zip(leg.tour.stops, masks, strict=True):
        view = by_id[stop.viewpoints[0]]
        X = revolution_poses(view.X_OS, 360) if view.kind == "revolution" else view.X_OS[None]
        expected = seen_by_any(scene, cell.settings.scanner_model(), X, samples.points, samples.normals)
        # A turn takes a sixth of those frames, and begins where the table stands.
        assert (mask != expected).mean() < (0.01 if view.kind == "revolution" else 0.001)
    few = every[::7]
    for mask, some in zip(masks, stop_masks(cell, leg.trajectory, scene, samples, few), strict=True):
        assert (mask[few] == some).all()


@pytest.mark.parametrize("rate", [0.0, 1e-3, 5e-3, 2e-2, 10.0])
def test_what_stays_is_worth_its_seconds_and_what_goes_is_not(box, leg, rate):
    cell, scene, samples = box
    every = np.arange(len(samples.points))
    out = not_worth(stops_seen(cell, [leg], scene, samples, every), len(every), rate=rate)
    masks = dict(zip([s.viewpoints[0] for s in leg.tour.stops],
                     stop_masks(cell, leg.trajectory, scene, samples, every), strict=True))  # fmt: skip
    seconds = dict(zip(masks, costs(cell, leg.tour, leg.trajectory), strict=True))

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


def test_a_merged_leg_knows_all_of_its_viewpoints(leg):
    gone = leg.reaches[1].viewpoint.id
    new = replace(leg, reaches=(leg.reaches[0], *leg.reaches[2:]))
    earlier = replace(leg, unreachable=())
    merged = with_left_out(new, [earlier], {gone: "too dear"})
    assert [r.viewpoint.id for r in merged.reaches] == [r.viewpoint.id for r in leg.reaches]
    assert merged.unreachable == ((gone, "too dear"),)


@pytest.fixture(scope="module")
def trip():
    """Both steps on the pitted block, and a round after them that looks where all has been seen."""
    made = Trip(pitted(), load_cell("kr240"), PlanOptions(seed=1, **TINY), silent)
    made.global_step()
    made.local_rounds()
    useless = tuple(
        Viewpoint(
            id=f"U{k}", X_OS=look_at([0.6 * np.cos(a), 0.6 * np.sin(a), 0.2], [-np.cos(a), -np.sin(a), -0.2]),
            standoff=0.6, step="local", kind="station", slack=Slack(roll=True),
        )
        for k, a in enumerate((0.3, 2.0))
    )  # fmt: skip
    made.run(useless, "local", np.random.default_rng(0))
    return made


def test_useless_viewpoints_go_and_what_is_seen_stays(trip):
    before = trip._state()
    trip.tidy()
    after = trip._state()
    assert [r.step for r in trip.rounds] == ["global", "local"] and trip.searched == before.rounds
    left_out = dict(trip.rounds[-1].leg.unreachable)
    assert {"U0", "U1"} <= set(left_out) and all(left_out[u].startswith(REASON) for u in ("U0", "U1"))
    assert trip.trajectory.duration < before.trajectory.duration - 2.0
    assert after.seen.mean() > before.seen.mean() - 0.002
    # The global leg stays as it is.
    n = len(trip.after_global.trajectory.t)
    assert trip.trajectory.q[:n].tobytes() == before.trajectory.q[:n].tobytes()
    made = trip.plan()
    assert not made.findings
    ids = [v.id for v in made.viewpoints]
    assert len(ids) == len(set(ids)) and {"U0", "U1"} <= set(ids)
    summary = made.summary
    assert [r["step"] for r in summary["searched"]] == ["global", "local", "local"]
    assert len(summary["rounds"]) == 2
    # Nothing is left to tidy.
    tidy = trip._state()
    trip.tidy()
    assert trip.trajectory is tidy.trajectory


@pytest.fixture(scope="module")
def found():
    """Both steps on the pitted block, as they were found, with all the time of the world."""
    made = Trip(pitted(), load_cell("kr240"), PlanOptions(seed=1, **TINY), silent)
    made.global_step()
    made.local_rounds()
    return made, made._state()


@pytest.mark.parametrize("share", [0.9, 0.5, 0.1])
def test_a_programme_is_brought_inside_its_budget(found, share):
    trip, state = found
    trip._back_to(state)
    first, whole = trip.after_global.trajectory.duration, trip.trajectory.duration
    assert whole > first + 1.0
    process = trip.settings.process.model_copy(update={"budget_s": first + share * (whole - first)})
    trip.settings = trip.settings.model_copy(update={"process": process})
    trip.tidy()
    assert trip.trajectory.duration <= process.budget_s
    reasons = [r for _, r in trip.rounds[-1].leg.unreachable]
    assert any(r.startswith(("no seconds are left for it in the budget: it adds", REASON)) for r in reasons)
    assert trip.seen.sum() >= trip.after_global.seen.sum()


def test_without_tidying_the_rounds_stay_as_they_were_found():
    found = Trip(pitted(), load_cell("kr240"), PlanOptions(seed=1, tidy=False, **TINY), silent)
    found.global_step()
    found.local_rounds()
    before = found._state()
    found.tidy()
    assert found._state().trajectory is before.trajectory and found.searched == ()
