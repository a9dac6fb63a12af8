"""A placement while it is planned, and the leaving out of what a later one shows as well.

Guarantees: `without_needless` returns what it was given, or programmes that together see as much for their
seconds: share of the surface less seconds at the method's rate, as pruning weighs everywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.geometry.parts.resting import RestingPose
from scanmotion.planning.context import Context
from scanmotion.planning.state import PlanState, begin, extend, with_segment
from scanmotion.planning.steps.prune import not_worth, stops_seen


@dataclass(frozen=True, eq=False, kw_only=True)
class Placed:
    """A placement with all that is known of it."""

    ctx: Context
    pose: RestingPose
    X_KO: np.ndarray
    """From the part as it is given to this placement, shape (4, 4)."""
    state: PlanState
    """Its programme; `seen` is of all placements up to this one."""
    after_global: PlanState
    """Before its local step."""


def without_needless(done: Sequence[Placed]) -> list[Placed]:
    """The placements, the first without local viewpoints that add nothing worth beside the later ones."""
    first, later = done[0], done[1:]
    local = [s for s in first.state.segments if s.step == "local" and s.trajectory is not None]
    simulator = first.ctx.simulator
    if not later or not local or simulator is None:
        return list(done)
    open_ = np.flatnonzero(~first.after_global.seen)
    open_ = open_[~_shown_later(later, open_)]
    stops = stops_seen(first.ctx.cell, local, simulator.scene, simulator.samples, open_)
    rate = first.ctx.method.least_rate
    out = not_worth(stops, len(first.state.seen), rate=rate)
    if not out:
        return list(done)
    kept = tuple(v for item in local for v in item.served if v.id not in out)
    state = first.after_global
    if kept:
        state = extend(first.ctx, state, kept, step="local", rng=first.ctx.rng("placed_local"))
    state = replace(state, holes=first.state.holes, visible=first.state.visible)
    fewer = [replace(first, state=state)]
    for item in later:
        fewer.append(_seen_again(item, fewer[-1].state.seen))
    return fewer if _value(fewer, rate) > _value(done, rate) else list(done)


def _shown_later(later: Sequence[Placed], open_: np.ndarray) -> np.ndarray:
    """Which of the samples `open_` (m,) the later placements see, shape (m,)."""
    shown = np.zeros(len(open_), bool)
    for item in later:
        simulator, segments = item.ctx.simulator, item.state.segments
        assert simulator is not None
        for stop in stops_seen(item.ctx.cell, segments, simulator.scene, simulator.samples, open_):
            shown |= stop.mask
    return shown


def _seen_again(item: Placed, seen: np.ndarray) -> Placed:
    """The placement with the same programme, scanned behind other earlier ones."""
    state = replace(begin(item.ctx), seen=seen)
    for number, segment in enumerate(item.state.segments):
        state = with_segment(item.ctx, state, segment, item.ctx.rng("placed", number))
    return replace(item, state=state)


def _value(done: Sequence[Placed], rate: float) -> float:
    return float(done[-1].state.seen.mean()) - rate * sum(item.state.duration for item in done)
