"""Re-planning: what has been executed stays as it is, the rest is planned from where the robot stands."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.tour import Stop, Tour
from scanmotion.core.trajectory import Operation, Trajectory
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.order.lower_bound import floor_seconds
from scanmotion.motion.transit_cost import move_model
from scanmotion.plan_io.load import LoadedPlan, load_plan
from scanmotion.plan_io.summary import read_cloud
from scanmotion.planning.outcome import Plan
from scanmotion.planning.pipeline import PlanOptions, Trip
from scanmotion.planning.segment import Leg, Progress, served_at, silent
from scanmotion.sensing.fusion.fuse import Cloud

__all__ = ["replan"]

FAILED = "failed when it was executed"


def replan(
    folder: str | Path,
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
        folder: the earlier plan.
        done: the id of a viewpoint or the index of an operation: all up to the end of the last operation that
            serves it has been executed. "" where nothing has.
        failed: ids of viewpoints that are left out.
        budget_s: another budget [s]; None keeps the earlier plan's.
        options: how the twin scans; source, mode, strategy and seed are always those of the earlier plan.
        progress: told the stage and the share done.

    Raises:
        PlanFileError: the folder cannot be read.
        InputError: `done` or `failed` name nothing of the plan, or a failed viewpoint has been served.
    """
    old = load_plan(folder)
    last = last_operation(old.trajectory.operations, done)
    finished = old.trajectory.operations[: last + 1]
    served = {v for o in finished if o.scanning for v in o.viewpoints}
    views = {v.id: v for v in old.viewpoints}
    _check_failed(failed, views, finished)
    settings = old.cell.settings
    if budget_s is not None:
        process = settings.process.model_copy(update={"budget_s": budget_s})
        settings = settings.model_copy(update={"process": process})
    same: dict[str, Any] = {k: getattr(old.record, k) for k in ("source", "mode", "strategy", "seed")}
    trip = Trip(old.part, settings, replace(options or PlanOptions(), **same), progress)
    if trip.options.source == "scan":
        trip.cloud = _cloud(Path(folder))
    _resume(trip, old, finished, views)
    given_up = dict(old.unreachable) | dict.fromkeys(failed, FAILED)
    for step in ("global", "local"):
        rest = [v for v in old.viewpoints if v.step == step and v.id not in served and v.id not in given_up]
        if rest:
            rng = np.random.default_rng([trip.options.seed, len(served), len(trip.rounds)])
            trip.run(tuple(rest), step, rng)
    if not trip.rounds:
        raise InputError(f"{folder}: no viewpoint is left to plan")
    _leave_out(trip, [v for v in old.viewpoints if v.id in given_up], given_up)
    made = replace(trip.plan(), holes=old.holes)
    return made if trip.options.source == "mesh" else replace(made, unscanned=old.unscanned)


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


def _check_failed(failed: Sequence[str], views: dict[str, Viewpoint], finished: Sequence[Operation]) -> None:
    for name in failed:
        if name not in views:
            raise InputError(f"--failed {name}: not one of {', '.join(views)}")
        by = [o.index for o in finished if o.scanning and name in o.viewpoints]
        if by:
            raise InputError(f"--failed {name}: operation {by[0]}, which is done, serves it")


def _resume(trip: Trip, old: LoadedPlan, finished: Sequence[Operation], views: dict[str, Viewpoint]) -> None:
    """Brings the trip to where the finished operations end, with a round for each step among them."""
    steps = ["local" if any(views[v].step == "local" for v in o.viewpoints) else "global" for o in finished]
    first = 0
    while first < len(finished):
        last = first
        while last + 1 < len(finished) and steps[last + 1] == steps[first]:
            last += 1
        piece = _piece(old.trajectory, first, last)
        leg = _executed(trip, piece, views)
        trip.take(leg, steps[first], np.random.default_rng([trip.options.seed, first, last]))
        first = last + 1


def _piece(whole: Trajectory, first: int, last: int) -> Trajectory:
    """The operations first..last by themselves, from time 0."""
    rows = np.flatnonzero((whole.operation >= first) & (whole.operation <= last))
    # A shared instant belongs to the earlier operation.
    begin = rows[0] if first == 0 else rows[0] - 1
    span = slice(begin, rows[-1] + 1)
    t0 = whole.operations[first].t_start
    operations = tuple(
        replace(o, index=o.index - first, t_start=o.t_start - t0, t_end=o.t_end - t0)
        for o in whole.operations[first : last + 1]
    )
    return Trajectory(
        t=whole.t[span] - whole.t[begin], q=whole.q[span], qd=whole.qd[span], qdd=whole.qdd[span],
        operation=np.maximum(whole.operation[span] - first, 0), operations=operations,
    )  # fmt: skip


def _executed(trip: Trip, piece: Trajectory, views: dict[str, Viewpoint]) -> Leg:
    """The leg that a piece of trajectory has served."""
    stops = []
    for o in piece.operations:
        if o.scanning:
            path = piece.q[piece.operation == o.index] if o.kind == "sweep" else None
            kind: Any = o.kind
            stops.append(Stop(viewpoints=o.viewpoints, kind=kind, q_in=o.q_start, q_out=o.q_end, path=path))
    served = {v: s.q_in for s in stops for v in s.viewpoints}
    model = move_model(trip.cell)
    tour = Tour(
        start_q=piece.q[0], stops=tuple(stops), seconds=piece.duration,
        floor=floor_seconds(trip.cell, model, piece.q[0], stops, views),
    )  # fmt: skip
    reaches = tuple(served_at(views[v], q[None]) for v, q in served.items())
    return Leg(reaches=reaches, tour=tour, paths=(), trajectory=piece, unreachable=())


def _leave_out(trip: Trip, lost: Sequence[Viewpoint], reasons: dict[str, str]) -> None:
    """Adds viewpoints that nothing serves to the last round, each with its reason."""
    trip.dropped += [(v, why) for v, why in reasons.items() if v not in {w.id for w in lost}]
    last = trip.rounds.pop()
    leg = replace(
        last.leg,
        reaches=last.leg.reaches + tuple(served_at(v, np.zeros((0, 7))) for v in lost),
        unreachable=last.leg.unreachable + tuple((v.id, reasons[v.id]) for v in lost),
    )
    trip.rounds.append(replace(last, leg=leg))


def _cloud(folder: Path) -> Cloud:
    """The measured cloud that the earlier plan began with."""
    points, normals = read_cloud(folder)
    return Cloud(
        points=points, normals=normals, view_directions=normals, counts=np.ones(len(points), np.int64)
    )  # fmt: skip
