"""One leg of the trip: viewpoints in, a timed trajectory out, and a reason for each viewpoint left behind."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.cell.robot import clean_angle
from scanmotion.core.errors import PathError
from scanmotion.core.tour import Path, Tour
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.order.helix_choice import joined_stops
from scanmotion.motion.order.lower_bound import floor_seconds
from scanmotion.motion.order.sequence import sequence, tour_seconds
from scanmotion.motion.reach.find import Reach, ReachOptions, reach
from scanmotion.motion.reach.ik_candidates import candidates
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit.plan import transits
from scanmotion.motion.transit_cost import move_matrix, move_model

LONGEST_WAY_S = 15.0
"""A transit to a local viewpoint that takes longer is not driven [s]."""

Progress = Callable[[str, float], None]


def silent(stage: str, fraction: float) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Leg:
    """What became of a set of viewpoints."""

    reaches: tuple[Reach, ...]
    """One for each viewpoint asked for."""
    tour: Tour
    paths: tuple[Path, ...]
    trajectory: Trajectory | None
    """None where no viewpoint could be served."""
    unreachable: tuple[tuple[str, str], ...]
    """(id, reason), in the order of the viewpoints."""

    @property
    def served(self) -> tuple[Viewpoint, ...]:
        """The viewpoints that the trajectory visits, in the order asked for."""
        ids = {v for stop in self.tour.stops for v in stop.viewpoints}
        return tuple(r.viewpoint for r in self.reaches if r.viewpoint.id in ids)


def leg_from(
    cell: Cell,
    clearance: Clearance,
    viewpoints: Sequence[Viewpoint],
    start_q: np.ndarray,
    *,
    mode: str = "default",
    table: str = "axis",
    longest_way: float = LONGEST_WAY_S,
    worth: Mapping[str, float] | None = None,
    rng: np.random.Generator,
    progress: Progress = silent,
) -> Leg:
    """Reach, order, transit and timing of `viewpoints`, starting at rest in `start_q`.

    A stop whose transit stays blocked is taken out, with the pair of bodies that blocks it as its reason, and
    the rest is ordered again.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: the collision checker of the cell.
        viewpoints: what is to be visited.
        start_q: shape (7,) [rad].
        mode: "default" orders by seconds; "paper" by distance, with the table for the unreachable only.
        table: "fallback" keeps the table still for every station that the arm reaches without it; so does
            mode "paper".
        longest_way: a local viewpoint whose transit takes longer is left out [s].
        worth: by id, what a viewpoint may cost at most: its stop, and the way there and on less the way past
            it [s]. Those that cost more are left out.
        rng: source of the search's random numbers.
        progress: told the stage and the share done.
    """
    reaches = list(
        reach(cell, list(viewpoints), clearance=clearance, progress=lambda f: progress("reach", f))
    )
    if table == "fallback" or mode == "paper":
        reaches = _table_still(cell, clearance, reaches, 0.0 if mode == "paper" else float(start_q[6]))
    reasons = {r.viewpoint.id: str(r.unreachable) for r in reaches if r.unreachable is not None}
    trajectory = None
    while True:
        todo = [r for r in reaches if r.viewpoint.id not in reasons]
        progress("order", 0.0)
        tour = sequence(cell, todo, start_q=start_q, mode=mode, rng=rng, path_free=clearance.path_free)
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
    order = [r.viewpoint.id for r in reaches]
    unreachable = tuple((v, reasons[v]) for v in order if v in reasons)
    return Leg(
        reaches=tuple(reaches), tour=tour, paths=paths, trajectory=trajectory, unreachable=unreachable
    )  # fmt: skip


def joined_leg(
    cell: Cell, clearance: Clearance, leg: Leg, overlap: float, *, rng: np.random.Generator
) -> Leg | None:
    """The leg with neighbouring revolutions joined to helices; None where that cannot be, or saves nothing.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: the collision checker of the cell.
        leg: what was planned with every revolution by itself; a viewpoint stands in one stop only.
        overlap: share of the arm's ways that counts for the whole turn of each viewpoint, 0..1.
        rng: source of the planner's random numbers.
    """
    if leg.trajectory is None:
        return None
    seconds, way = [], 0.0
    for o in leg.trajectory.operations:
        if o.scanning:
            seconds.append(way)
        way = 0.0 if o.scanning else o.t_end - o.t_start
    start = leg.tour.start_q
    stops = joined_stops(cell, clearance, start, leg.tour.stops, seconds, overlap)
    if all(stop.kind != "helix" for stop in stops):
        return None
    model, views = move_model(cell), {r.viewpoint.id: r.viewpoint for r in leg.reaches}
    tour = replace(
        leg.tour, stops=stops, seconds=tour_seconds(model, start, stops),
        floor=floor_seconds(cell, model, start, stops, views),
    )  # fmt: skip
    try:
        paths = tuple(transits(cell, clearance, tour, rng=rng))
    except PathError:
        return None
    made = replace(leg, tour=tour, paths=paths, trajectory=time_plan(cell, tour, paths))
    assert made.trajectory is not None
    return made if made.trajectory.duration < leg.trajectory.duration else None


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
    return {v: f"not worth its seconds: the way there takes {seconds:.1f} s" for v in viewpoints}


def with_left_out(leg: Leg, earlier: Sequence[Leg], out: Mapping[str, str]) -> Leg:
    """`leg`, made of viewpoints of earlier legs, with those that it leaves behind and why.

    Args:
        leg: the new one.
        earlier: the legs that it stands for.
        out: reasons of viewpoints that the earlier ones served, by id.
    """
    mine = {r.viewpoint.id: r for r in leg.reaches}
    reasons = dict(pair for one in earlier for pair in one.unreachable) | dict(out) | dict(leg.unreachable)
    reaches = tuple(mine.get(r.viewpoint.id, r) for one in earlier for r in one.reaches)
    order = [r.viewpoint.id for r in reaches]
    return replace(leg, reaches=reaches, unreachable=tuple((v, reasons[v]) for v in order if v in reasons))


def costs(cell: Cell, tour: Tour, trajectory: Trajectory) -> list[float]:
    """What each stop of a leg costs: itself, and the way there and on less the way past it [s]."""
    model, after = move_model(cell), [o for o in trajectory.operations if o.kind != "transit"]
    found = []
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
            dear.update({v: f"not worth its seconds: it would cost {cost:.1f} s" for v in stop.viewpoints})
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


def _table_still(cell: Cell, clearance: Clearance, reaches: Sequence[Reach], angle: float) -> list[Reach]:
    """Stations with the configurations that leave the table at `angle` [rad], if there are any."""
    stations = [n for n, r in enumerate(reaches) if r.viewpoint.kind == "station" and len(r.q)]
    views = [reaches[n].viewpoint for n in stations]
    options = ReachOptions()
    at = np.array([clean_angle(np.array(angle))])
    found = candidates(cell, views, [at] * len(views), options.rolls, hopeless=clearance.tool_blocked)
    free = clearance.first_free(found.q, found.starts, found.geometry, options.most)
    still = list(reaches)
    for i, n in enumerate(stations):
        rows = np.arange(len(found.q))[found.of(i)]
        rows = rows[free[rows]][: options.most]
        if len(rows):
            q = found.q[rows]
            still[n] = replace(
                still[n], q=q, clearance=np.maximum(clearance.margins(q), 0.0),
                manipulability=found.sigma[rows], X_OS=scanner_in_object(cell, q),
            )  # fmt: skip
    return still
