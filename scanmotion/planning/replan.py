"""Re-planning: what has been executed stays as it is, the rest extends the state where the robot stands.

Guarantees: the executed operations are kept sample by sample. Assumes that the robot stands at rest where the
last executed operation ends.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.trajectory import Operation, Trajectory, piece
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.order.lower_bound import floor_seconds
from scanmotion.motion.transit_cost import move_model
from scanmotion.planning.context import Context, context_from
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.pipeline import plan_from
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import Progress, Segment, segment_from_operations, served_at, silent
from scanmotion.planning.state import PlanState, begin, extend, with_segment

__all__ = ["replan"]

FAILED = "failed when it was executed"


def replan(
    old: Plan,
    *,
    done: str = "",
    failed: Sequence[str] = (),
    budget_s: float | None = None,
    options: PlanOptions | None = None,
    progress: Progress = silent,
) -> Plan:
    """A whole plan that begins with the executed operations of an earlier one, sample by sample.

    The rest of the earlier plan's viewpoints is ordered and planned anew from where the last executed
    operation ends: those of the global step, then those of the local one. No new viewpoints are sought.

    Args:
        old: the earlier plan, as it was loaded from its folder.
        done: the id of a viewpoint or the index of an operation: all up to the end of the last operation that
            serves it has been executed. "" where nothing has.
        failed: ids of viewpoints that are left out.
        budget_s: another budget [s]; None keeps the earlier plan's.
        options: how the twin scans; source, mode, strategy and seed are always those of the earlier plan.
        progress: told the stage and the share done.

    Raises:
        InputError: `done` or `failed` name nothing of the plan, a failed viewpoint has been served, or a
            continuous motion has not been executed to its end.
    """
    whole = old.trajectory
    if whole is None:
        raise InputError("the earlier plan has no trajectory")
    last = last_operation(whole.operations, done)
    _check_whole(whole.operations, last, done)
    finished = whole.operations[: last + 1]
    served = {v for o in finished if o.scanning for v in o.viewpoints}
    views = {v.id: v for v in old.viewpoints}
    _check_failed(failed, views, finished)
    settings = old.cell.settings
    if budget_s is not None:
        process = settings.process.model_copy(update={"budget_s": budget_s})
        settings = settings.model_copy(update={"process": process})
    of_old = old.options
    told = replace(
        options or PlanOptions(), source=of_old.source, mode=of_old.mode, strategy=of_old.strategy,
        seed=of_old.seed,
    )  # fmt: skip
    ctx = context_from(old.part, settings, told, progress)
    state = begin(ctx)
    if ctx.measured is not None:
        if old.cloud is None:
            raise InputError("the earlier plan has lost its measured cloud")
        state = replace(state, cloud=old.cloud)
    state = _with_executed(ctx, state, whole, finished, old)
    given_up = dict(old.left_out) | dict.fromkeys(failed, FAILED)
    for step in ("global", "local"):
        rest = [v for v in old.viewpoints if v.step == step and v.id not in served and v.id not in given_up]
        if rest:
            rng = ctx.rng("replan", len(finished), len(state.segments))
            state = extend(ctx, state, rest, step=step, rng=rng)
    if not state.segments:
        raise InputError("no viewpoint is left to plan")
    lost = [v for v in old.viewpoints if v.id in given_up]
    last = _with_lost(state.segments[-1], lost, given_up)
    state = replace(state, segments=(*state.segments[:-1], last), holes=old.holes)
    if ctx.simulator is None:
        state = replace(state, unscanned=old.unscanned)
    others = [(name, why) for name, why in given_up.items() if name not in {v.id for v in lost}]
    return plan_from(ctx, state, left_out=others)


def last_operation(operations: Sequence[Operation], done: str) -> int:
    """Index of the last executed operation; -1 where none is.

    Raises:
        InputError: `done` is neither a viewpoint that an operation serves nor an operation's index.
    """
    if not done:
        return -1
    found = [o.index for o in operations if o.scanning and done in o.viewpoints]
    if found:
        return found[-1]
    if done.isdecimal() and int(done) < len(operations):
        return int(done)
    served = [v for o in operations if o.scanning for v in o.viewpoints]
    raise InputError(
        f"--done {done}: no operation serves it; operations are 0 to {len(operations) - 1} and serve "
        f"{', '.join(served)}"
    )


def _check_whole(operations: Sequence[Operation], last: int, done: str) -> None:
    """Refuses to take up a continuous motion in its middle: the rest of it is not made of viewpoints."""
    for o in operations:
        inside = done in o.viewpoints[:-1]
        if o.kind == "path" and (o.index > last or inside):
            raise InputError(
                f"operation {o.index} is one continuous motion, which cannot be taken up in its middle; "
                "plan the part anew, or take up what follows it with --done " + str(o.index)
            )


def _check_failed(failed: Sequence[str], views: dict[str, Viewpoint], finished: Sequence[Operation]) -> None:
    for name in failed:
        if name not in views:
            raise InputError(f"--failed {name}: not one of {', '.join(views)}")
        by = [o.index for o in finished if o.scanning and name in o.viewpoints]
        if by:
            raise InputError(f"--failed {name}: operation {by[0]}, which is done, serves it")


def _with_executed(
    ctx: Context,
    state: PlanState,
    whole: Trajectory,
    finished: Sequence[Operation],
    old: Plan,
) -> PlanState:
    """The state where the finished operations end, with a segment for each step among them."""
    views = {v.id: v for v in old.viewpoints}
    steps = ["local" if any(views[v].step == "local" for v in o.viewpoints) else "global" for o in finished]
    first = 0
    while first < len(finished):
        last = first
        while last + 1 < len(finished) and steps[last + 1] == steps[first]:
            last += 1
        segment = _executed(ctx, piece(whole, first, last), views, steps[first], old.solvers)
        state = with_segment(ctx, state, segment, ctx.rng("executed", first, last))
        first = last + 1
    return state


def _executed(
    ctx: Context, part: Trajectory, views: dict[str, Viewpoint], step: str, solvers: Mapping[str, str]
) -> Segment:
    """The segment that a piece of trajectory has served, with its lower bound and who found its poses."""
    found = segment_from_operations(part, views, step=step, floor=0.0)
    floor = floor_seconds(ctx.cell, move_model(ctx.cell), part.q[0], found.tour.stops, views)
    reaches = tuple(replace(r, solver=solvers.get(r.viewpoint.id, "")) for r in found.reaches)
    return replace(found, reaches=reaches, tour=replace(found.tour, floor=floor))


def _with_lost(segment: Segment, lost: Sequence[Viewpoint], reasons: dict[str, str]) -> Segment:
    """The segment with viewpoints that nothing serves, each with its reason."""
    return replace(
        segment,
        reaches=segment.reaches + tuple(served_at(v, np.zeros((0, 7))) for v in lost),
        unreachable=segment.unreachable + tuple((v.id, reasons[v.id]) for v in lost),
    )
