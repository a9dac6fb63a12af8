"""The local step: holes, local viewpoints, a segment over them, until nothing more is worth a round.

Guarantees: every round adds a segment, or is the last. Assumes a fused cloud of the global step, simulated or
measured.
"""

from dataclasses import dataclass, replace

import numpy as np

from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.reach.find import reachable_mask
from scanmotion.planning.context import Context
from scanmotion.planning.evidence import next_views
from scanmotion.planning.methods import THOROUGH_RATE
from scanmotion.planning.segment import renamed
from scanmotion.planning.state import PlanState, extend, visible_from
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.find import HoleReport

_SOUGHT = 0.5
"""Share of what a viewpoint must be worth for which it is sought, where pruning has the last word."""
_SIDE_TRIP_S = 10.0
"""A local viewpoint is taken only within this time of home or a viewpoint of the first segment [s]."""


def local_rounds(ctx: Context, state: PlanState) -> PlanState:
    """The state after the local step.

    Args:
        ctx: what planning reads.
        state: after the global step, with a fused cloud.
    """
    for number in range(1, ctx.options.rounds + 1):
        cloud = state.cloud
        assert cloud is not None
        if state.holes is None:
            with ctx.watch("holes"):
                ctx.progress("holes", 0.0)
                state = replace(state, holes=ctx.method.holes(cloud))
        assert state.holes is not None
        with ctx.watch("viewpoints"):
            ctx.progress("viewpoints", 0.0)
            chosen = _chosen(ctx, state, cloud, state.holes, number)
        state = chosen.state
        if not chosen.views:
            return state
        prefix = f"R{number}" if number > 1 else ""
        worth = {prefix + name: seconds for name, seconds in chosen.worth.items()}
        views, rng = renamed(chosen.views, prefix), ctx.rng("local_round", number)
        state = extend(ctx, state, views, step="local", rng=rng, worth=worth)
        if ctx.method.views_over_holes is not None or ctx.simulator is None:
            return state
        with ctx.watch("visible"):
            state = replace(state, visible=visible_from(ctx, state))
        if _completeness(state) >= ctx.options.goal:
            return state
    return state


@dataclass(frozen=True, eq=False, kw_only=True)
class _Chosen:
    """Viewpoints of a local round."""

    views: tuple[Viewpoint, ...]
    worth: dict[str, float]
    """By id, what each may cost at most [s]."""
    state: PlanState
    """With what the choice adds to the evidence."""


def _chosen(ctx: Context, state: PlanState, cloud: Cloud, holes: HoleReport, number: int) -> _Chosen:
    if ctx.method.views_over_holes is not None:
        return _Chosen(views=ctx.method.views_over_holes(holes, ctx.settings), worth={}, state=state)
    # The holes of a measured scan are what was asked for: none is left for its seconds.
    rate = (_SOUGHT if ctx.prunes else 1.0) * ctx.method.least_rate
    found = next_views(
        state.evidence, cloud, holes.holes,
        rate=THOROUGH_RATE if ctx.simulator is None else rate,
        seconds=_seconds_left(ctx, state),
        reachable=(lambda X_OS: _reachable(ctx, state, X_OS)) if ctx.method.asks_reach else None,
        explain=ctx.simulator is None,
        rng=ctx.rng("local_views", number),
    )  # fmt: skip
    known = replace(state, evidence=found.evidence, unscanned=found.step.unseen)
    return _Chosen(views=found.step.viewpoints, worth=found.worth, state=known)


def _seconds_left(ctx: Context, state: PlanState) -> float:
    """Of the budget, for the next round [s]; its order is not known, and pruning may take some out."""
    return (1.5 if ctx.prunes else 0.9) * max(ctx.budget_s - state.duration, 0.0)


def _reachable(ctx: Context, state: PlanState, X_OS: np.ndarray) -> np.ndarray:
    """Which poses (n, 4, 4) the robot reaches without going far from its way, shape (n,)."""
    stops = [q for item in state.segments[:1] for stop in item.tour.stops for q in stop.places]
    return reachable_mask(
        ctx.cell, X_OS, clearance=ctx.clearance,
        near_q=np.array([ctx.cell.home, *stops]), within_s=_SIDE_TRIP_S,
    )  # fmt: skip


def _completeness(state: PlanState) -> float:
    """Share of what can be seen that has been seen."""
    assert state.visible is not None
    return float(state.seen.sum() / max(state.visible.sum(), 1))
