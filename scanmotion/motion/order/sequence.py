"""The order: which stop when, in which configuration of arm and table, in the least seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.support.threads import by_pieces
from scanmotion.core.tour import Stop, Tour
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.order.given_order import given_order
from scanmotion.motion.order.lower_bound import floor_seconds
from scanmotion.motion.order.paper_order import paper_order
from scanmotion.motion.order.salesman.generalised_tsp import search
from scanmotion.motion.order.salesman.tsp import TourOptions, tour_from_cost
from scanmotion.motion.order.stops import (
    Group,
    PathFree,
    ReachLike,
    dwell_group,
    natural,
    revolution_group,
    stage_of,
    thinned_stops,
)
from scanmotion.motion.order.sweeps import straight_runs, sweep_group
from scanmotion.motion.transit_cost import MoveModel, joined_nodes, move_matrix, move_model, stop_seconds

if TYPE_CHECKING:
    from scanmotion.cell.build import Cell


_ORDERS = TourOptions(population=30, generations=60, bound_rounds=0)


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """How hard to search; every number counts work, none counts seconds."""

    states: int = 3000
    """Configurations in the search at once, over all stops."""
    most_per_stop: int = 80
    """Greatest number of configurations of one stop in the search at once."""
    starts: int = 3
    """Independent searches, of which the best counts; fewer are made of over 20 stops."""
    rounds: int = 8
    """Greatest number of searches, each over the configurations that suit the order of the one before; the
    first that gains nothing is followed by searches over twice as many. Fewer are made of over 75 stops."""
    population: int = 5
    """Orders kept by the genetic algorithm."""
    generations: int = 10
    """Children made in each round."""
    effort: int = 20_000_000
    """Places tried when stops are taken out and put back, in each round over all children."""
    orders: TourOptions = _ORDERS
    """Search for the order that starts each round."""
    table_step_deg: float = 15.0
    """Steps between the table angles from which a revolution may start [deg]."""
    sweep_ways: int = 12
    """Joint paths kept for each sweep and direction before windings of the table."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Ordered:
    """Groups in an order, each in one of its ways."""

    groups: list[Group]
    order: list[int]
    """Indices of the groups as they are visited."""
    ways: list[int]
    """The way of each, in that order."""
    cost: float
    """[s]"""


@dataclass(frozen=True, eq=False, kw_only=True)
class Unordered:
    """Stops without an order yet."""

    cell: Cell
    model: MoveModel
    groups: list[Group]
    viewpoints: dict[str, Viewpoint]
    """By id, in the order in which they were asked for."""
    start_q: np.ndarray
    """Where the programme stands, shape (7,) [rad]."""


Ordering = Callable[[Unordered, np.random.Generator, SequenceOptions], Ordered]
"""Puts stops into an order, each in one of its ways: `by_seconds`, `by_distance`, `as_given`."""


def by_seconds(todo: Unordered, rng: np.random.Generator, options: SequenceOptions) -> Ordered:
    """The least seconds found, over order, configurations and table angles at once."""
    return _fastest_order(todo.model, todo.groups, todo.start_q, rng, options)


def by_distance(todo: Unordered, rng: np.random.Generator, options: SequenceOptions) -> Ordered:
    """The paper's order (its section 4): by Euclidean distance; the table turns only for what needs it."""
    from scanmotion.cell.kinematics import scanner_in_object

    p_OS = np.asarray(scanner_in_object(todo.cell, todo.start_q[None]))[0, :3, 3]
    order, ways = paper_order(todo.groups, todo.viewpoints, p_OS, todo.start_q, rng, options.orders)
    return Ordered(groups=todo.groups, order=order, ways=ways, cost=np.nan)


def as_given(todo: Unordered, rng: np.random.Generator, options: SequenceOptions) -> Ordered:
    """The order in which the viewpoints were asked for; the configurations that take the least seconds."""
    order, ways = given_order(todo.groups, list(todo.viewpoints), todo.model, todo.start_q)
    return Ordered(groups=todo.groups, order=order, ways=ways, cost=np.nan)


def sequence(
    cell: Cell,
    reaches: Sequence[ReachLike],
    *,
    start_q: np.ndarray,
    ordering: Ordering | None = None,
    rng: np.random.Generator,
    options: SequenceOptions | None = None,
    path_free: PathFree | None = None,
    keep: Sequence[Stop] = (),
) -> Tour:
    """The order over viewpoints, configurations and table angles that takes the least seconds found.

    Viewpoints of the global step come before those of the local step. A revolution keeps the arm still and
    may turn either way; a sweep may be passed either way; a station is a dwell.

    Args:
        cell: limits of the axes and speeds of the process.
        reaches: the viewpoints with their collision-free configurations.
        start_q: where the programme stands, shape (7,) [rad]; with `keep`, where the last kept stop ends.
        ordering: how the stops are put in order: `by_seconds` unless given, `by_distance` or `as_given`.
        rng: source of the random numbers; the same state gives the same tour.
        options: how hard to search.
        path_free: tells whether a sweep's joint path (k, 7) is clear; None takes it as clear.
        keep: stops that are done already; their viewpoints are left out of the tour.

    Raises:
        InputError: start_q is not seven finite numbers.
    """
    options = options or SequenceOptions()
    start_q = np.array(start_q, dtype=float)
    if start_q.shape != (7,) or not np.isfinite(start_q).all():
        raise InputError(f"start_q must be seven finite joint positions, got shape {start_q.shape}")
    done = {v for stop in keep for v in stop.viewpoints}
    reaches = [r for r in reaches if r.viewpoint.id not in done]
    model = move_model(cell)
    groups, unplaced = _groups(cell, model, reaches, start_q, path_free, options)
    viewpoints = {r.viewpoint.id: r.viewpoint for r in reaches}
    todo = Unordered(cell=cell, model=model, groups=groups, viewpoints=viewpoints, start_q=start_q)
    found = (ordering or by_seconds)(todo, rng, options)
    stops = tuple(_stop(found.groups[g], w) for g, w in zip(found.order, found.ways, strict=True))
    return Tour(
        start_q=start_q,
        stops=stops,
        seconds=tour_seconds(model, start_q, stops),
        floor=floor_seconds(cell, model, start_q, stops, viewpoints),
        unplaced=tuple(unplaced),
    )


def tour_seconds(model: MoveModel, start_q: np.ndarray, stops: Sequence[Stop]) -> float:
    """Expected duration of a tour: its transits by the cost model and its stops [s]."""
    at, total = np.asarray(start_q, dtype=float), 0.0
    for stop in stops:
        total += float(move_matrix(model, at, stop.q_in)[0, 0]) + stop_seconds(model, stop)
        at = stop.q_out
    return total


def _stop(group: Group, way: int) -> Stop:
    """The stop that serves a group in one of its ways; a sweep passed backwards names its viewpoints so."""
    path = group.paths[way] if group.paths else None
    viewpoints = group.viewpoints[::-1] if group.kind == "sweep" and group.backward[way] else group.viewpoints
    return Stop(
        viewpoints=viewpoints,
        kind=group.kind,
        q_in=group.enter.q[way].copy(),
        q_out=group.leave.q[way].copy(),
        path=path,
    )


def _groups(
    cell: Cell,
    model: MoveModel,
    reaches: Sequence[ReachLike],
    start_q: np.ndarray,
    path_free: PathFree | None,
    options: SequenceOptions,
) -> tuple[list[Group], list[tuple[str, str]]]:
    """The stops to order, and the viewpoints that have none with the reason."""
    # One and a half turns either way are enough: a revolution can turn back what the one before turned on.
    e1_range = (
        max(float(cell.q_min[6]), start_q[6] - 3 * np.pi),
        min(float(cell.q_max[6]), start_q[6] + 3 * np.pi),
    )
    groups: list[Group] = []
    unplaced: list[tuple[str, str]] = []
    sweeps: dict[str, list[ReachLike]] = {}
    for reach in reaches:
        viewpoint = reach.viewpoint
        if reach.unreachable is not None or len(reach.q) == 0:
            unplaced.append((viewpoint.id, str(reach.unreachable or "no collision-free configuration")))
        elif viewpoint.kind == "revolution":
            table = start_q[6] + np.radians(np.arange(0.0, 360.0, options.table_step_deg))
            group = revolution_group(reach, model, e1_range, table)
            if len(group):
                groups.append(group)
            else:
                degrees = np.degrees(e1_range[1] - e1_range[0])
                unplaced.append((viewpoint.id, f"the table's range of {degrees:.0f} deg holds no whole turn"))
        elif viewpoint.sweep:
            sweeps.setdefault(f"{stage_of(reach)}.{viewpoint.sweep}", []).append(reach)
        else:
            groups.append(dwell_group(reach, model, e1_range))
    for members in sweeps.values():
        for run in straight_runs(sorted(members, key=lambda r: natural(r.viewpoint.id))):
            sweep = sweep_group(cell, model, run, e1_range, path_free, options.sweep_ways)
            groups += [sweep] if sweep else [dwell_group(r, model, e1_range) for r in run]
    for group in groups:
        if not len(group):
            unplaced += [(v, "the table's range holds none of its angles") for v in group.viewpoints]
    groups = [g for g in groups if len(g)]
    return sorted(groups, key=lambda g: (g.stage, natural(g.viewpoints[0]))), unplaced


def _fastest_order(
    model: MoveModel,
    groups: list[Group],
    start_q: np.ndarray,
    rng: np.random.Generator,
    options: SequenceOptions,
) -> Ordered:
    """The best of several independent searches."""
    if not groups:
        return Ordered(groups=groups, order=[], ways=[], cost=0.0)
    starts = int(np.clip(60 // len(groups), 1, options.starts))
    streams = rng.spawn(starts)

    def some(first: int, last: int) -> list[Ordered]:
        return [_one_start(model, groups, start_q, draws, options) for draws in streams[first:last]]

    # Each start draws from a stream of its own, so that their order on threads changes nothing.
    found = [one for piece in by_pieces(some, starts, least=1) for one in piece]
    return min(found, key=lambda f: f.cost)


def _one_start(
    model: MoveModel,
    groups: list[Group],
    start_q: np.ndarray,
    rng: np.random.Generator,
    options: SequenceOptions,
) -> Ordered:
    """Rounds of search, each over the ways that suit the order of the best so far."""
    per_stop = int(np.clip(options.states // len(groups), 4, options.most_per_stop))
    between: list[Between] = [(start_q, None)] * len(groups)
    best = Ordered(groups=groups, order=list(range(len(groups))), ways=[], cost=np.inf)
    width = 1
    for _ in range(int(np.clip(600 // len(groups), min(3, options.rounds), options.rounds))):
        few = [thinned_stops(g, model, width * per_stop, *b) for g, b in zip(groups, between, strict=True)]
        found = _searched(model, few, start_q, np.array(best.order), rng, options)
        if found.cost < best.cost - 1e-3:
            best = found
            between = _neighbours(best, start_q)
        elif width == 1:
            width = 2
        else:
            break
    return best


Between = tuple[np.ndarray | None, np.ndarray | None]
"""Configurations that the tour comes from and goes on to, where they are known."""


def _neighbours(found: Ordered, start_q: np.ndarray) -> list[Between]:
    """What the tour does before and after each group."""
    few, order, ways = found.groups, found.order, found.ways
    between: list[Between] = [(None, None)] * len(few)
    for i, g in enumerate(order):
        before = few[order[i - 1]].leave.q[ways[i - 1]] if i > 0 else start_q
        after = few[order[i + 1]].enter.q[ways[i + 1]] if i + 1 < len(order) else None
        between[g] = (before, after)
    return between


def _searched(
    model: MoveModel,
    groups: list[Group],
    start_q: np.ndarray,
    order: np.ndarray,
    rng: np.random.Generator,
    options: SequenceOptions,
) -> Ordered:
    """Genetic algorithm over the order and the ways of `groups`."""
    first = np.cumsum([0] + [len(g) for g in groups])
    served = np.concatenate([g.seconds for g in groups])
    enter, leave = joined_nodes([g.enter for g in groups]), joined_nodes([g.leave for g in groups])
    C = move_matrix(model, leave, enter) + (served[:, None] + served[None]) / 2
    head = move_matrix(model, start_q, enter)[0] + served / 2
    partner = np.concatenate([g.partner + n for g, n in zip(groups, first[:-1], strict=True)])
    stage = np.array([g.stage for g in groups])
    seeds = _seeds(C, head, first, stage, order, rng, options)
    m = len(groups)
    runs = options.population + options.generations
    shakes = int(np.clip(options.effort // (runs * 4 * len(head)), 10, 2000))
    state = np.array([rng.integers(0, 2**63)], dtype=np.uint64)
    most = max(1, min(8, m // 2))
    tail = served / 2
    CT = np.ascontiguousarray(C.T)
    found, states, cost = search(
        C, CT, head, tail, first, partner, stage, seeds, options.generations, shakes, most, state
    )
    ways = [int(s - first[g]) for g, s in zip(found, states, strict=True)]
    return Ordered(groups=groups, order=[int(g) for g in found], ways=ways, cost=float(cost))


def _seeds(
    C: np.ndarray,
    head: np.ndarray,
    first: np.ndarray,
    stage: np.ndarray,
    order: np.ndarray,
    rng: np.random.Generator,
    options: SequenceOptions,
) -> np.ndarray:
    """First orders: the best so far, the tour over the least costs between groups, and shuffles of that."""
    m = len(stage)
    least = np.minimum.reduceat(np.minimum.reduceat(C, first[:-1], axis=0), first[:-1], axis=1)
    depot = np.zeros((m + 1, m + 1))
    depot[:m, :m] = least
    depot[m, :m] = np.minimum.reduceat(head, first[:-1])
    # Going back to the start costs nothing: an open tour; from the local to the global step costs a lot.
    depot[:m, :m] += 1e3 * (stage[:, None] > stage[None])
    tour = tour_from_cost(depot, closed=True, start=m, rng=rng, options=options.orders).order[1:]
    seeds = [order, tour[np.argsort(stage[tour], kind="stable")]]
    while len(seeds) < options.population:
        # Few stops are shuffled one by one; of many, long stretches stay whole.
        a, b = np.sort(rng.integers(0, m + 1, 2))
        shuffled = rng.permutation(m) if m <= 12 else np.concatenate([tour[a:b], tour[b:], tour[:a]])
        seeds.append(shuffled[np.argsort(stage[shuffled], kind="stable")])
    return np.array(seeds[: max(options.population, 1)], dtype=np.int64)
