"""The floor: no tour over the given viewpoints takes less in any configurations. docs/floor.md proves it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scanmotion.core.tour import Stop
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.rest_to_rest import jerk_limited_seconds
from scanmotion.motion.order.salesman.tour_bound import best_closed_tour, one_tree_bound
from scanmotion.motion.transit_cost import MoveModel

if TYPE_CHECKING:
    from scanmotion.cell.build import Cell

ROUNDS = 600
"""1-trees of the ascent."""
EXACT_UP_TO = 13
"""Ends, with start and end of the tour, up to which the least order is enumerated."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Ends:
    """Where stops begin and end, relative to the part and in cylinder coordinates about the table's axis."""

    radius: np.ndarray
    """Distance from the table's axis, shape (n,) [m]."""
    height: np.ndarray
    """Shape (n,) [m]."""
    azimuth: np.ndarray
    """In the frame that turns with the table, shape (n,) [rad]; NaN where any will do (revolutions)."""
    slack: np.ndarray
    """How far the scanner may stand from there without losing the viewpoint's purpose, shape (n,) [m]."""
    stage: np.ndarray
    """-1 for the start, 0 for the global and 1 for the local step, shape (n,)."""
    mate: np.ndarray
    """Index of the other end of a sweep or helix, its own elsewhere, shape (n,)."""


def floor_seconds(
    cell: Cell,
    model: MoveModel,
    start_q: np.ndarray,
    stops: Sequence[Stop],
    viewpoints: Mapping[str, Viewpoint],
) -> float:
    """Least time of any tour from `start_q` over the stops' viewpoints in these kinds of stop [s].

    Args:
        cell: the table's place and the scanner's kinematics.
        model: limits and speeds.
        start_q: shape (7,) [rad].
        stops: what is visited; their order, directions and configurations do not matter.
        viewpoints: by id, all that the stops serve.
    """
    if not stops:
        return 0.0
    from scanmotion.cell.kinematics import scanner_in_object

    p_OS = np.asarray(scanner_in_object(cell, np.atleast_2d(start_q)))[0, :3, 3]
    paths = [stop for stop in stops if stop.kind == "path"]
    if paths:
        places = [p_OS, *(viewpoints[v].p_OS for stop in paths for v in stop.viewpoints)]
        others = [stop for stop in stops if stop.kind != "path"]
        least = spanning_seconds(model, np.asarray(cell.X_TO), np.array(places))
        return max(least, floor_seconds(cell, model, start_q, others, viewpoints))
    ends = stop_ends(np.asarray(cell.X_TO), p_OS, stops, viewpoints)
    scanning = sum(least_scanning_seconds(model, stop, viewpoints) for stop in stops)
    return scanning + least_transit_seconds(ends, least_pair_seconds(model, ends))


def spanning_seconds(model: MoveModel, X_TO: np.ndarray, p_OS: np.ndarray) -> float:
    """Least time of a scanner that comes to all these places in O, shape (n, 3), without a rest [s].

    However the table turns, the way from one to another is no shorter than the difference in height and in
    distance from the axis, and a way through all is no shorter than the least tree that spans them.
    """
    p = p_OS @ X_TO[:3, :3].T + X_TO[:3, 3]
    at = np.column_stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]])
    away = np.linalg.norm(at[:, None] - at[None], axis=2)
    # Prim's tree: edges of no length are edges too.
    nearest, length = away[0].copy(), 0.0
    left = np.arange(len(at)) > 0
    while left.any():
        k = int(np.where(left, nearest, np.inf).argmin())
        length += float(nearest[k])
        left[k] = False
        nearest = np.minimum(nearest, away[k])
    return length / max(model.scan_speed, model.transit_speed)


def stop_ends(
    X_TO: np.ndarray, start_p_OS: np.ndarray, stops: Sequence[Stop], viewpoints: Mapping[str, Viewpoint]
) -> Ends:
    """The start of the tour, then the ends of each stop in order: two of a sweep or helix, else one."""
    rows, slack, stage, mate, free = [np.asarray(start_p_OS)], [0.0], [-1], [0], [False]
    for stop in stops:
        served = [viewpoints[stop.viewpoints[0]]]
        if stop.kind in ("sweep", "helix"):
            served.append(viewpoints[stop.viewpoints[-1]])
        n = len(rows)
        mate += [n + 1, n] if len(served) == 2 else [n]
        for viewpoint in served:
            rows.append(viewpoint.p_OS)
            slack.append(reach_of_slack(viewpoint))
            stage.append(0 if viewpoint.step == "global" else 1)
            free.append(stop.kind in ("revolution", "helix"))
    p = np.array(rows) @ X_TO[:3, :3].T + X_TO[:3, 3]
    return Ends(
        radius=np.hypot(p[:, 0], p[:, 1]),
        height=p[:, 2],
        azimuth=np.where(free, np.nan, np.arctan2(p[:, 1], p[:, 0])),
        slack=np.array(slack),
        stage=np.array(stage),
        mate=np.array(mate),
    )


def reach_of_slack(viewpoint: Viewpoint) -> float:
    """Greatest distance of the scanner from the viewpoint's nominal place that its slack allows [m]."""
    low, high = viewpoint.slack.standoff
    along = max(abs(low), abs(high))
    farthest = viewpoint.standoff + max(high, 0.0)
    return along + 2.0 * farthest * float(np.sin(min(viewpoint.slack.tilt, np.pi) / 2.0))


def least_scanning_seconds(model: MoveModel, stop: Stop, viewpoints: Mapping[str, Viewpoint]) -> float:
    """Least time of a stop itself [s]."""
    if stop.kind == "dwell":
        return model.dwell_s
    if stop.kind in ("revolution", "helix"):
        turns = 2 * np.pi * len(stop.viewpoints)
        return float(jerk_limited_seconds(turns, model.v[6], model.a[6], model.j[6]))
    a, b = viewpoints[stop.viewpoints[0]], viewpoints[stop.viewpoints[-1]]
    length = float(np.linalg.norm(a.p_OS - b.p_OS)) - reach_of_slack(a) - reach_of_slack(b)
    return float(travel_seconds(model, np.array(max(length, 0.0)), model.scan_speed))


def scanner_jerk(model: MoveModel) -> float:
    """Bound on how fast the scanner's speed can grow from rest: it is at most this times t^2 / 2 [m/s3].

    Joint i turns at most at j_i t^2 / 2, and carries the scanner at that times the scanner's distance from
    its axis, which is at most the length of the chain of axes from there to the scanner.
    """
    tip, length, total = model.p_WS, 0.0, 0.0
    for i in range(5, -1, -1):
        foot = model.points[i] + model.axes[i] * float(model.axes[i] @ (tip - model.points[i]))
        length += float(np.linalg.norm(tip - foot))
        total += length * float(model.j[i])
        tip = foot
    return total


def travel_seconds(model: MoveModel, distance: np.ndarray, speed: float) -> np.ndarray:
    """Least time of the scanner over a distance from rest to rest at no more than `speed` [s]."""
    jerk = scanner_jerk(model)
    ramp = np.sqrt(2.0 * speed / jerk)
    long = distance / speed + 4.0 * ramp / 3.0
    return np.where(distance >= 2.0 * speed * ramp / 3.0, long, 2.0 * np.cbrt(3.0 * distance / jerk))


def least_pair_seconds(model: MoveModel, ends: Ends) -> np.ndarray:
    """Least time from one end to another whatever the table does meanwhile, shape (n, n) [s].

    A turn of the table by x takes at least tau(x) and leaves the scanner a way of at least d(phi - x); the
    least of the greater of both over x lies where they cross, and is bracketed from below by bisection.
    """
    gap = np.abs(ends.azimuth[:, None] - ends.azimuth[None])
    gap = np.minimum(gap, 2 * np.pi - gap)
    gap = np.where(np.isnan(gap), 0.0, gap)
    r, s = ends.radius[:, None], ends.radius[None]
    rise = (ends.height[:, None] - ends.height[None]) ** 2
    slack = ends.slack[:, None] + ends.slack[None]

    def travel(angle: np.ndarray) -> np.ndarray:
        way = np.sqrt((r - s) ** 2 + 4.0 * r * s * np.sin(angle / 2.0) ** 2 + rise)
        return travel_seconds(model, np.maximum(way - slack, 0.0), model.transit_speed)

    def turn(angle: np.ndarray) -> np.ndarray:
        return jerk_limited_seconds(angle, model.v[6], model.a[6], model.j[6])

    low, high = np.zeros_like(gap), gap.copy()
    for _ in range(60):
        middle = (low + high) / 2.0
        slower = travel(gap - middle) >= turn(middle)
        low, high = np.where(slower, middle, low), np.where(slower, high, middle)
    whole = travel(np.zeros_like(gap)) >= turn(gap)
    return np.where(whole, travel(np.zeros_like(gap)), turn(low))


def least_transit_seconds(ends: Ends, pair: np.ndarray) -> float:
    """Lower bound of the transits of any order: from the start, the global step first, each sweep whole."""
    n = len(pair)
    much = 4.0 * (float(pair.max()) + 1.0)
    D = np.zeros((n + 1, n + 1))
    D[:n, :n] = pair
    stage = ends.stage.astype(float)
    # The tour closes over one more city, n, that stands between its last stop and its start.
    both = bool((stage == 0).any() and (stage == 1).any())
    if both:
        across = (stage[:, None] >= 0) & (stage[None] >= 0) & (stage[:, None] != stage[None])
        across |= (stage[:, None] == -1) & (stage[None] == 1) | (stage[:, None] == 1) & (stage[None] == -1)
        D[:n, :n] += much * across
        D[n, :n] = D[:n, n] = much * (stage == 0)
    paid = much if both else 0.0
    D[n, 0] = D[0, n] = -n * much
    paid -= n * much
    for i in np.flatnonzero(ends.mate > np.arange(n)):
        k = ends.mate[i]
        D[i, k] = D[k, i] = -n * much
        paid -= n * much
    np.fill_diagonal(D, 0.0)
    if n + 1 <= EXACT_UP_TO:
        tour = best_closed_tour(D)
        return float(D[tour, np.roll(tour, -1)].sum()) - paid
    given = np.arange(n + 1)
    upper = float(D[given, np.roll(given, -1)].sum())
    return max(float(one_tree_bound(D, upper, ROUNDS)) - paid, 0.0)
