"""The order of the stages: a part and a cell in, a Plan out. Nobody else knows it.

Guarantees: every viewpoint that the method asks for is served or has a reason; the same part, settings, seed
and version give the same bytes. Assumes that the part stands in the object frame on the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from scanmotion.cell.collision.last_word import last_word
from scanmotion.cell.settings.cell import CellSettings, cell_settings_from
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.trajectory import Trajectory, joined
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.parts.part_objects import part_from
from scanmotion.motion.order.sequence import as_given, sequence
from scanmotion.motion.reach.find import reachable_mask
from scanmotion.planning.context import Context, Simulator, context_from
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import Progress, silent
from scanmotion.planning.state import PlanState, begin, extend, visible_from
from scanmotion.planning.steps.continuous import better_motion, continuous_step
from scanmotion.planning.steps.local_rounds import local_rounds
from scanmotion.planning.steps.prune import prune
from scanmotion.planning.steps.way_home import way_home
from scanmotion.planning.worth.confidence import Confidence, Prediction, Uncertainty, confidence
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.simulator.captures import joined_captures
from scanmotion.views.unscanned import Patch

__all__ = ["PlanOptions", "plan"]

_ACCURACY_POINTS = 20_000
"""Of the cloud, by which the interval of the accuracy is centred."""


def plan(
    part: object,
    settings: object = "kr240",
    *,
    viewpoints: Sequence[Viewpoint] | None = None,
    order: Literal["fastest", "given"] = "fastest",
    options: PlanOptions | None = None,
    progress: Progress = silent,
) -> Plan:
    """Plans the scan of `part` in the cell that `settings` describe.

    Args:
        part: what is scanned: a Part, or a file of one in mm; for source "box" the box itself, for source
            "scan" the measured surface.
        settings: the cell: its settings, the name of a built-in one, a YAML file, or a mapping as in one.
        viewpoints: your own ones in place of the method's; they go through reach, order, transit, timing and
            simulation like any other, and no local step follows.
        order: of your own viewpoints: "fastest", or "given" as they stand.
        options: source, mode, strategy, seed and the simulator's settings.
        progress: told the stage and the share of it that is done.

    Raises:
        PartError: the part does not fit the table, or is not what the source needs.
        CellError: an obstacle stands where the table turns.
        InputError: an argument of another kind, an unknown order, or two viewpoints with one id.
    """
    part, settings = part_from(part), cell_settings_from(settings)
    if viewpoints is not None:
        return _own_views(part, settings, viewpoints, order, options or PlanOptions(), progress)
    ctx = context_from(part, settings, options or PlanOptions(), progress)
    state = begin(ctx)
    return plan_from(ctx, _programme(ctx, state))


def _programme(ctx: Context, state: PlanState) -> PlanState:
    """The whole scan, in the kind of motion that the options ask for."""
    asked = ctx.options.motion
    moving = None if asked == "stops" else continuous_step(ctx, state)
    if moving is not None and asked == "continuous":
        return moving
    still = _stops(ctx, state)
    return still if asked == "stops" else better_motion(ctx, moving, still)


def _stops(ctx: Context, state: PlanState) -> PlanState:
    """The scan by turns and stops, in the method's steps."""
    if ctx.measured is None:
        state = global_step(ctx, state)
    if ctx.method.takes_local_step and state.cloud is not None:
        state = prune(ctx, before=state, after=local_rounds(ctx, state))
    return state


def _own_views(
    part: Part,
    settings: CellSettings,
    viewpoints: Sequence[Viewpoint],
    order: str,
    options: PlanOptions,
    progress: Progress,
) -> Plan:
    """A plan over the user's viewpoints alone."""
    if order not in ("fastest", "given"):
        raise InputError(f"order {order!r} is unknown; known: fastest, given")
    check_viewpoints(viewpoints)
    ctx = context_from(part, settings, options, progress)
    if order == "given":
        ctx = replace(ctx, method=replace(ctx.method, order=partial(sequence, ordering=as_given)))
    # One step: an order that is given may mix what a method would plan in two.
    views = tuple(replace(v, step="global") for v in viewpoints)
    return plan_from(ctx, extend(ctx, begin(ctx), views, step="global", rng=ctx.rng("given_views")))


def check_viewpoints(viewpoints: Sequence[object]) -> tuple[Viewpoint, ...]:
    """Viewpoints as a user gives them; refuses what are none, none at all, or two with one id.

    Raises:
        InputError: with the first that is wrong.
    """
    found: list[Viewpoint] = []
    for item in viewpoints:
        if not isinstance(item, Viewpoint):
            raise InputError(f"viewpoints: a {type(item).__name__} is no Viewpoint")
        found.append(item)
    ids = [v.id for v in found]
    if not ids:
        raise InputError("viewpoints: there is none")
    twice = next((v for v in ids if ids.count(v) > 1), None)
    if twice is not None:
        raise InputError(f"viewpoints: the id {twice!r} is there twice")
    return tuple(found)


def global_step(ctx: Context, state: PlanState) -> PlanState:
    """The state with the method's global viewpoints planned."""
    with ctx.watch("viewpoints"):
        asked = ctx.method.global_views(ctx.part, ctx.settings)
    state = extend(ctx, state, asked.viewpoints, step="global", rng=ctx.rng("global_step"))
    return replace(state, dropped=asked.dropped)


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis:
    """What is known at the end of a plan's scan, and why it stays incomplete."""

    cloud: Cloud | None
    """All scans, fused at once."""
    visible: np.ndarray | None
    """Which samples any allowed scanner pose can see, shape (n,)."""
    out_of_reach: np.ndarray | None
    """Which of those stay unscanned because this robot reaches no pose that sees them, shape (n,)."""
    unscanned: tuple[Patch, ...]
    """Patches of surface that stay unscanned, each with its reason."""


def diagnose(ctx: Context, state: PlanState) -> Diagnosis:
    """What stays unscanned and why.

    Args:
        ctx: what planning reads.
        state: of the whole programme.
    """
    if ctx.simulator is None:
        return Diagnosis(cloud=state.cloud, visible=None, out_of_reach=None, unscanned=state.unscanned)
    with ctx.watch("unscanned"):
        ctx.progress("unscanned", 0.0)
        can_be_seen = visible_from(ctx, state)
        unscanned, out_of_reach = ctx.simulator.unscanned(
            state.seen, can_be_seen, lambda X_OS: reachable_mask(ctx.cell, X_OS, clearance=ctx.clearance)
        )
    cloud = state.cloud
    if len(state.scans) > 1:
        with ctx.watch("simulator"):
            cloud = fuse(state.scans, voxel=ctx.options.voxel)
    return Diagnosis(cloud=cloud, visible=can_be_seen, out_of_reach=out_of_reach, unscanned=unscanned)


def confidence_of(ctx: Context, simulator: Simulator, state: PlanState, found: Diagnosis) -> Confidence:
    """Intervals of what the programme is predicted to see and how exactly.

    Args:
        ctx: what planning reads.
        simulator: knows the true surface.
        state: of the whole programme, with its trajectory.
        found: at its end.
    """
    assert found.cloud is not None and found.visible is not None
    some = accuracy(found.cloud.points[:: max(1, len(found.cloud) // _ACCURACY_POINTS)], ctx.part)
    it = Prediction(
        scene=simulator.scene, scanner=ctx.scanner,
        captures=joined_captures([s.captures for s in state.scans]),
        samples=simulator.samples, seen=state.seen, visible=found.visible,
        noise=(some.mean_abs, some.mean_signed),
    )  # fmt: skip
    unknown = Uncertainty(**ctx.settings.uncertainty.si())
    errors = simulator.errors
    if state.corrections is not None and state.corrections.applied:
        errors = errors.without_constants()
    return confidence(it, errors, unknown, seed=ctx.options.seed)


def plan_from(ctx: Context, state: PlanState, *, left_out: Sequence[tuple[str, str]] = ()) -> Plan:
    """All that was found, in one value.

    Args:
        ctx: what planning reads.
        state: of the whole programme.
        left_out: further viewpoints that are not planned: (id, reason).
    """
    found = diagnose(ctx, state)
    home: Trajectory | None = None
    note, word = "", None
    if state.trajectory is not None:
        with ctx.watch("motion"):
            home, note = way_home(ctx.cell, ctx.clearance, state.trajectory.q[-1], rng=ctx.rng("way_home"))
        with ctx.watch("last word"):
            ctx.progress("last word", 0.0)
            cycle = state.trajectory if home is None else joined(state.trajectory, home)
            word = last_word(ctx.cell, cycle)
    sure = None
    if ctx.simulator is not None and state.trajectory is not None and found.cloud is not None:
        with ctx.watch("confidence"):
            ctx.progress("confidence", 0.0)
            sure = confidence_of(ctx, ctx.simulator, state, found)
    return Plan(
        confidence=sure, part=ctx.part,
        cell=ctx.cell, options=ctx.options, segments=state.segments, searched=state.searched,
        trajectory=state.trajectory, cloud=found.cloud, holes=state.holes,
        samples=None if ctx.simulator is None else ctx.simulator.samples,
        visible=found.visible, out_of_reach=found.out_of_reach,
        dropped=(*state.dropped, *left_out), unscanned=found.unscanned,
        scans=state.scans if ctx.options.keep_scans else (),
        corrections=state.corrections, joining=state.joining, motion=state.motion, last_word=word,
        planning_s=ctx.watch.seconds(), way_home=home, no_way_home=note,
    )  # fmt: skip
