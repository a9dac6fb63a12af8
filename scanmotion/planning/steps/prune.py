"""Pruning: local viewpoints that the simulator shows to be worth less than their seconds are left out.

Guarantees: the better of two values comes back, and neither of them is changed; what no longer fits into the
budget is left out, the least worthy first. Assumes that nominal poses tell what a stop sees.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.part import SurfaceSamples
from scanmotion.core.summary import NOT_WORTH
from scanmotion.core.trajectory import Trajectory
from scanmotion.planning.context import Context
from scanmotion.planning.segment import Segment, costs, with_left_out
from scanmotion.planning.state import PlanState, extend, visible_from
from scanmotion.sensing.simulator.captures import captures_from_trajectory
from scanmotion.sensing.visibility import Scene, seen_by_any

_TRIES = 6
"""So often viewpoints are taken out until a programme is inside its budget."""


def prune(ctx: Context, *, before: PlanState, after: PlanState) -> PlanState:
    """The better of two states: as it was found, or with the worthwhile local viewpoints in one segment.

    Args:
        ctx: what planning reads.
        before: the state before the local step.
        after: the state after it.
    """
    local = [item for item in after.segments if item.step == "local"]
    if not ctx.prunes or not any(item.trajectory is not None for item in local):
        return after
    after = replace(after, visible=visible_from(ctx, after))
    stops = _stops_added(ctx, local, before=before, after=after)
    base = replace(
        before, holes=after.holes, unscanned=after.unscanned, visible=after.visible, evidence=after.evidence
    )
    shorter, out, save = after, {}, 0.0
    for number in range(_TRIES):
        out = not_worth(stops, len(after.seen), rate=ctx.method.least_rate, save=save)
        if not out and sum(item.trajectory is not None for item in local) == 1 and _over(ctx, after) <= 0:
            return after
        kept = tuple(v for item in local for v in item.served if v.id not in out)
        shorter = extend(ctx, base, kept, step="local", rng=ctx.rng("prune", number))
        if _over(ctx, shorter) <= 0 or not kept:
            break
        save += _over(ctx, shorter) + 0.5
    rate = ctx.method.least_rate
    if _over(ctx, after) <= 0 and shorter.value(rate) <= after.value(rate):
        return after
    last = with_left_out(shorter.segments[-1], local, out)
    return replace(shorter, segments=(*shorter.segments[:-1], last), searched=after.segments)


def _over(ctx: Context, state: PlanState) -> float:
    """By how much the programme is longer than its budget [s]; negative where it is shorter."""
    return state.duration - ctx.budget_s


def _stops_added(
    ctx: Context, local: Sequence[Segment], *, before: PlanState, after: PlanState
) -> "list[StopSeen]":
    """What each stop of the local step costs, and sees of what it added."""
    assert ctx.simulator is not None
    open_ = np.flatnonzero(after.seen & ~before.seen)
    with ctx.watch("prune"):
        ctx.progress("prune", 0.0)
        return stops_seen(ctx.cell, local, ctx.simulator.scene, ctx.simulator.samples, open_)


def stop_masks(
    cell: Cell,
    trajectory: Trajectory,
    scene: Scene,
    samples: SurfaceSamples,
    which: np.ndarray,
    *,
    most: int | None = None,
) -> list[np.ndarray]:
    """What each scanning operation sees at its nominal poses, shape (m,) bool each.

    Args:
        cell: scanner, table and frame rate.
        trajectory: the programme.
        scene: what blocks sight.
        samples: of the surface.
        which: indices of the samples that are asked about, shape (m,).
        most: frames of an operation that are looked at; None for all.
    """
    settings = cell.settings
    captures = captures_from_trajectory(
        trajectory, lambda q: scanner_poses(cell, q), fps=settings.process.fps, X_WT=cell.X_WT, X_TO=cell.X_TO
    )
    scanner, X_OS = settings.scanner_model(), captures.X_OS
    points, normals = samples.points[which], samples.normals[which]
    masks: list[np.ndarray] = []
    for o in trajectory.operations:
        if o.scanning:
            frames = np.flatnonzero((captures.t >= o.t_start - 1e-9) & (captures.t <= o.t_end + 1e-9))
            step = 1 if most is None else max(1, len(frames) // most)
            masks.append(seen_by_any(scene, scanner, X_OS[frames[::step]], points, normals))
    return masks


@dataclass(frozen=True, eq=False, kw_only=True)
class StopSeen:
    """A stop of a local round: what it costs, and what it sees."""

    viewpoints: tuple[str, ...]
    seconds: float
    mask: np.ndarray
    """Which of the samples asked about it sees, shape (m,)."""


def stops_seen(
    cell: Cell, segments: Sequence[Segment], scene: Scene, samples: SurfaceSamples, open_: np.ndarray
) -> list[StopSeen]:
    """What each stop of the segments costs and sees.

    Args:
        cell: the cell.
        segments: of the local rounds, in order.
        scene: what blocks sight.
        samples: of the surface.
        open_: indices of the samples that the global step has not seen, shape (m,).
    """
    found: list[StopSeen] = []
    for item in segments:
        if item.trajectory is not None:
            seconds = costs(cell, item.tour, item.trajectory)
            masks = stop_masks(cell, item.trajectory, scene, samples, open_)
            found += [
                StopSeen(viewpoints=stop.viewpoints, seconds=s, mask=m)
                for stop, s, m in zip(item.tour.stops, seconds, masks, strict=True)
            ]
    return found


def not_worth(stops: Sequence[StopSeen], samples: int, *, rate: float, save: float = 0.0) -> dict[str, str]:
    """Local viewpoints that add less than they are worth, or that the budget has no seconds for, by id, with
    the reason.

    The least worthy goes first; what it alone saw of what another one saw too then counts for that one.

    Args:
        stops: of the local rounds.
        samples: how many the whole surface has.
        rate: least share of the surface that a second adds [1/s].
        save: what must be saved beyond that [s].
    """
    out: dict[str, str] = {}
    kept = list(stops)
    while kept:
        count = np.sum([stop.mask for stop in kept], axis=0)
        adds = np.array([(stop.mask & (count == 1)).sum() for stop in kept]) / samples
        worth = adds / np.maximum([stop.seconds for stop in kept], 1e-3)
        least = int(np.argmin(worth))
        stop = kept[least]
        adding = f"it adds {adds[least]:.3%} in {stop.seconds:.1f} s"
        if worth[least] < rate:
            reason = f"{NOT_WORTH}: {adding}"
        elif save > 0.0:
            reason = f"no seconds are left for it in the budget: {adding}"
            save -= stop.seconds
        else:
            break
        out.update(dict.fromkeys(stop.viewpoints, reason))
        del kept[least]
    return out
