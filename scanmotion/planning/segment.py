"""A segment: viewpoints in, a timed trajectory out, and a reason for each viewpoint that is left out.

Guarantees: each viewpoint is served by one stop or has a reason; the trajectory starts at rest in the
configuration that is given. Assumes that this configuration is free.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.core.errors import PathError
from scanmotion.core.summary import NOT_WORTH
from scanmotion.core.tour import Path, Stop, Tour
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.reach.find import Reach, reach
from scanmotion.motion.refine import REFINED, refined
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit.plan import transits
from scanmotion.motion.transit_cost import move_matrix, move_model
from scanmotion.planning.methods import DEFAULT, Method

LONGEST_WAY_S = 15.0
"""A transit to a local viewpoint that takes longer is not driven [s]."""

Progress = Callable[[str, float], None]


def silent(stage: str, fraction: float) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Segment:
    """What became of a set of viewpoints, and what had been seen when it was done."""

    step: str
    """"global" or "local"."""
    reaches: tuple[Reach, ...]
    """One for each viewpoint asked for."""
    tour: Tour
    paths: tuple[Path, ...]
    trajectory: Trajectory | None
    """From time 0; None where no viewpoint could be served."""
    unreachable: tuple[tuple[str, str], ...]
    """(id, reason), in the order of the viewpoints."""
    seen: np.ndarray
    """Which surface samples had been seen by then, shape (n,) bool; empty where nothing is simulated."""
    refined: frozenset[str] = frozenset()
    """Ids of the viewpoints whose pose Drake refined inside the slack."""

    @property
    def served(self) -> tuple[Viewpoint, ...]:
        """The viewpoints that the trajectory visits, in the order asked for."""
        ids = {v for stop in self.tour.stops for v in stop.viewpoints}
        return tuple(r.viewpoint for r in self.reaches if r.viewpoint.id in ids)

    @property
    def solvers(self) -> dict[str, str]:
        """Which solver found the pose of each viewpoint that is served, by id."""
        ids = {v for stop in self.tour.stops for v in stop.viewpoints}
        found = {r.viewpoint.id: r.solver for r in self.reaches if r.viewpoint.id in ids}
        return {v: REFINED if v in self.refined else solver for v, solver in found.items()}


def segment_from(
    cell: Cell,
    clearance: Clearance,
    viewpoints: Sequence[Viewpoint],
    start_q: np.ndarray,
    *,
    step: str = "local",
    method: Method = DEFAULT,
    longest_way: float = LONGEST_WAY_S,
    worth: Mapping[str, float] | None = None,
    rng: np.random.Generator,
    progress: Progress = silent,
) -> Segment:
    """Reach, order, transit and timing of `viewpoints`, starting at rest in `start_q`.

    A stop whose transit stays blocked is taken out, with the pair of bodies that blocks it as its reason, and
    the rest is ordered again.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: the collision checker of the cell.
        viewpoints: what is to be visited.
        start_q: shape (7,) [rad].
        step: "global" or "local".
        method: which configurations count, and how they are ordered.
        longest_way: a local viewpoint whose transit takes longer is left out [s].
        worth: by id, what a viewpoint may cost at most: its stop, and the way there and on less the way past
            it [s]. Those that cost more are left out.
        rng: source of the random numbers of order and transit.
        progress: told the stage and the share done.
    """
    reaches = list(
        reach(cell, list(viewpoints), clearance=clearance, progress=lambda f: progress("reach", f))
    )
    if method.stations is not None:
        reaches = method.stations(cell, clearance, reaches, start_q)
    reasons = {r.viewpoint.id: str(r.unreachable) for r in reaches if r.unreachable is not None}
    trajectory = None
    while True:
        todo = [r for r in reaches if r.viewpoint.id not in reasons]
        progress("order", 0.0)
        tour = method.order(cell, todo, start_q=start_q, rng=rng, path_free=clearance.path_free)
        reasons.update(dict(tour.unplaced))
        try:
            paths = tuple(transits(cell, clearance, tour, rng=rng, progress=lambda f: progress("transit", f)))
        except PathError as error:
            blocked = tour.stops[error.stop]
            reasons.update({v: f"no collision-free way there: {error}" for v in blocked.viewpoints})
            continue
        if not tour.stops:
            trajectory = None
            break
        trajectory = time_plan(cell, tour, paths, progress=lambda f: progress("timing", f))
        local = {r.viewpoint.id for r in todo if r.viewpoint.step == "local"}
        dear = _detours(trajectory, local, longest_way) or _dear(cell, tour, trajectory, worth or {})
        if not dear:
            break
        reasons.update(dear)
    taken: frozenset[str] = frozenset()
    if method.refines and trajectory is not None:
        progress("refine", 0.0)
        views = {r.viewpoint.id: r.viewpoint for r in reaches}
        better = refined(cell, clearance, tour, paths, views, rng=rng)
        if better.viewpoints:
            tour, paths, taken = better.tour, better.paths, better.viewpoints
            trajectory = time_plan(cell, tour, paths)
    order = [r.viewpoint.id for r in reaches]
    return Segment(
        step=step, reaches=tuple(reaches), tour=tour, paths=paths, trajectory=trajectory,
        unreachable=tuple((v, reasons[v]) for v in order if v in reasons), seen=np.zeros(0, bool),
        refined=taken,
    )  # fmt: skip


def _detours(trajectory: Trajectory, local: set[str], longest: float) -> dict[str, str]:
    """Local viewpoints at the end of the longest way round, where it costs more than they are worth."""
    ways = [
        (o.t_end - o.t_start, o.viewpoints)
        for o in trajectory.operations
        if o.kind == "transit" and o.viewpoints and set(o.viewpoints) <= local
    ]
    seconds, viewpoints = max(ways, default=(0.0, ()), key=lambda w: w[0])
    if seconds <= longest:
        return {}
    return {v: f"{NOT_WORTH}: the way there takes {seconds:.1f} s" for v in viewpoints}


def with_left_out(segment: Segment, earlier: Sequence[Segment], out: Mapping[str, str]) -> Segment:
    """`segment`, made of viewpoints of earlier ones, with those that it leaves out and why.

    Args:
        segment: the new one.
        earlier: the segments that it stands for.
        out: reasons of viewpoints that the earlier ones served, by id.
    """
    mine = {r.viewpoint.id: r for r in segment.reaches}
    reasons = dict(pair for one in earlier for pair in one.unreachable) | dict(out)
    reasons |= dict(segment.unreachable)
    reaches = tuple(mine.get(r.viewpoint.id, r) for one in earlier for r in one.reaches)
    order = [r.viewpoint.id for r in reaches]
    left_out = tuple((v, reasons[v]) for v in order if v in reasons)
    return replace(segment, reaches=reaches, unreachable=left_out)


def costs(cell: Cell, tour: Tour, trajectory: Trajectory) -> list[float]:
    """What each stop of a segment costs: itself, and the way there and on less the way past it [s]."""
    model, after = move_model(cell), [o for o in trajectory.operations if o.kind != "transit"]
    found: list[float] = []
    for n in range(len(tour.stops)):
        before = tour.stops[n - 1].q_out if n else tour.start_q
        start = after[n - 1].t_end if n else 0.0
        cost = after[n].t_end - start
        if n + 1 < len(tour.stops):
            way = move_matrix(model, np.array([before]), np.array([tour.stops[n + 1].q_in]))[0, 0]
            cost = after[n + 1].t_start - start - float(way)
        found.append(max(cost, 0.0))
    return found


def _dear(cell: Cell, tour: Tour, trajectory: Trajectory, worth: Mapping[str, float]) -> dict[str, str]:
    """Viewpoints that cost more seconds than they are worth, no two of them in a row: one gone, the other's
    way is another.
    """
    dear: dict[str, str] = {}
    last = -2
    for n, (stop, cost) in enumerate(zip(tour.stops, costs(cell, tour, trajectory), strict=True)):
        if cost > sum(worth.get(v, np.inf) for v in stop.viewpoints) and n > last + 1:
            last = n
            dear.update({v: f"{NOT_WORTH}: it would cost {cost:.1f} s" for v in stop.viewpoints})
    return dear


def served_at(viewpoint: Viewpoint, q: np.ndarray) -> Reach:
    """A viewpoint with what is known of its configurations, shape (k, 7)."""
    k = len(q)
    return Reach(
        viewpoint=viewpoint, q=q, clearance=np.zeros(k), manipulability=np.zeros(k),
        X_OS=np.tile(viewpoint.X_OS, (k, 1, 1)),
    )  # fmt: skip


def renamed(viewpoints: Sequence[Viewpoint], prefix: str) -> tuple[Viewpoint, ...]:
    """The same viewpoints with `prefix` before their ids and sweeps, so that rounds do not collide."""
    return tuple(replace(v, id=prefix + v.id, sweep=prefix + v.sweep if v.sweep else "") for v in viewpoints)


def segment_from_operations(
    trajectory: Trajectory, views: Mapping[str, Viewpoint], *, step: str, floor: float
) -> Segment:
    """The segment that a trajectory has served: executed, or read from a file.

    Args:
        trajectory: from time 0.
        views: by id, those that it serves and maybe others.
        step: "global" or "local".
        floor: proven lower bound of its duration [s].
    """
    stops: list[Stop] = []
    for o in trajectory.operations:
        if o.kind == "transit":
            continue
        path = trajectory.q[trajectory.operation == o.index] if o.kind == "sweep" else None
        stops.append(Stop(viewpoints=o.viewpoints, kind=o.kind, q_in=o.q_start, q_out=o.q_end, path=path))
    served = {v: s.q_in for s in stops for v in s.viewpoints}
    tour = Tour(
        start_q=trajectory.q[0], stops=tuple(stops), seconds=trajectory.duration, floor=floor
    )  # fmt: skip
    reaches = tuple(served_at(views[v], q[None]) for v, q in served.items())
    return Segment(
        step=step, reaches=reaches, tour=tour, paths=(),
        trajectory=trajectory, unreachable=(), seen=np.zeros(0, bool),
    )  # fmt: skip
