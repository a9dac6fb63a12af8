"""Transit: collision-free ways between the stops of a tour, short in seconds.

For each gap the scanner's straight line in W and the straight joint edge are tried in the order of their
durations; where none is free, or only a slow one, RRT-Connect plans round what blocks it and its path is
shortened by pieces of the same two kinds as long as that saves time. What is checked at last is the very
curve that timing drives on (`transit_spline`), sampled densely.
"""

from collections.abc import Callable

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import tcp_jacobian
from scanmotion.core.errors import PathError
from scanmotion.core.tour import Path, PathMethod, Tour
from scanmotion.motion.profile.spline import STEP_M, STEP_RAD, evenly_spaced, subdivided
from scanmotion.motion.transit.drive import (
    floor_along,
    positions,
    transit_law,
    transit_limits,
    transit_spline,
)
from scanmotion.motion.transit.rrt_connect import plan_round
from scanmotion.motion.transit.straight_line import chord, least_seconds, ways, with_table

SAMPLES_PER_SPAN = 2
"""Checked points on the driven curve per span of its spline; their straight edges are stepped more finely."""
_SLOW = 1.25
"""A free way this many times slower than the fastest imaginable is worth planning against."""
_SLOW_S = 1.0
_RAMPS = 0.8
"""Least that ramps add to a way without a jerk limit, as a share of a / j."""
_TRIES = 3
_FEW_CHECKS = 1500
_SHORTCUTS = 60
_ROOM_RAD = 0.8
_EXACT_STEP_M = 0.002
"""As fine as the last word's: what is free here keeps its clearance less 1 mm in between [m]."""
_BEYOND_SCANNER_M = 0.3
"""What of scanner and arm lies further from an axis than the scanner's origin does [m]."""
_EDGE_S = 3.0


def transits(
    cell: Cell,
    clearance: Clearance,
    tour: Tour,
    *,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> list[Path]:
    """One collision-free path for each gap: from the start to the first stop, from stop to stop.

    Args:
        cell: its axes' limits and transit speed.
        clearance: the collision checker of the cell.
        tour: the stops in order.
        rng: source of the planner's random numbers.
        progress: told the share done.

    Raises:
        PathError: no way was found; names the two bodies that are in the way and the stop.
    """
    draws = rng.spawn(len(tour.stops))
    at = np.asarray(tour.start_q, dtype=float)
    paths = []
    for n, stop in enumerate(tour.stops):
        paths.append(_transit(cell, clearance, at, np.asarray(stop.q_in, dtype=float), draws[n], n))
        at = np.asarray(stop.q_out, dtype=float)
        if progress is not None:
            progress((n + 1) / len(tour.stops))
    return paths


def transit(
    cell: Cell, clearance: Clearance, qa: np.ndarray, qb: np.ndarray, *, rng: np.random.Generator
) -> Path:
    """A collision-free path from qa to qb, shape (7,) each; see `transits`."""
    return _transit(cell, clearance, qa, qb, rng, 0)


def _transit(
    cell: Cell, clearance: Clearance, qa: np.ndarray, qb: np.ndarray, rng: np.random.Generator, stop: int
) -> Path:
    if np.abs(qb - qa).max() < 1e-9:
        return Path(q=np.array([qa, qb]), seconds=0.0, method="joint")
    candidates = ways(cell, qa, qb)
    direct = _fastest_free(cell, clearance, candidates)
    least = float(least_seconds(cell, qa, qb)[0])
    if direct is not None and direct.seconds <= max(_SLOW * least, least + _SLOW_S):
        return direct
    found = [direct] if direct is not None else []
    for attempt in range(_TRIES):
        planned = _planned(cell, clearance, qa, qb, rng, attempt)
        if planned is not None:
            found.append(planned)
            if planned.seconds <= _SLOW * least:
                break
    if not found:
        raise _blocked(cell, clearance, candidates[0][1], stop)
    return min(found, key=lambda path: path.seconds)


def _fastest_free(
    cell: Cell, clearance: Clearance, candidates: list[tuple[PathMethod, np.ndarray]]
) -> Path | None:
    """The fastest of some ways that are free; None where none is."""
    floors = [floor_along(cell, q) for _, q in candidates]
    ramps = _RAMPS * float((cell.a_max / cell.j_max).max())
    best: Path | None = None
    for k in np.argsort(floors, kind="stable"):
        method, q = candidates[k]
        if best is not None and floors[k] + ramps >= best.seconds:
            break
        if driven_free(cell, clearance, q)[0]:
            seconds = transit_law(cell, q)[1].duration
            if best is None or seconds < best.seconds:
                best = Path(q=q, seconds=seconds, method=method)
    return best


def driven_free(cell: Cell, clearance: Clearance, q: np.ndarray) -> tuple[bool, int, tuple[str, str]]:
    """Whether the curve along the polyline `q` (k, 7) is free; else at which sample, which bodies."""
    path = transit_spline(cell, q)
    return samples_free(
        cell, clearance, path(np.linspace(0.0, path.end, SAMPLES_PER_SPAN * round(path.end) + 1))
    )


def samples_free(cell: Cell, clearance: Clearance, samples: np.ndarray) -> tuple[bool, int, tuple[str, str]]:
    """Whether a densely sampled motion, shape (n, 7), is free; else at which sample, which bodies.

    Edges between samples that the fast tier refuses are judged by the exact one, in small steps.
    """
    if (samples < cell.q_min).any() or (samples > cell.q_max).any():
        return False, 0, ("arm", "its range")
    free, k, pair = clearance.path_free(samples)
    if free:
        return True, -1, ("", "")
    blocked = np.flatnonzero(~clearance.free(samples))
    if len(blocked):
        return False, max(int(blocked[0]) - 1, 0), clearance.distance(samples[blocked[0]])[1]
    first = 0
    while not free:
        if not _exactly_free(cell, clearance, samples[first + k], samples[first + k + 1]):
            return False, first + k, pair
        first += k + 1
        if first >= len(samples) - 1:
            break
        free, k, pair = clearance.path_free(samples[first:])
    return True, -1, ("", "")


def _exactly_free(cell: Cell, clearance: Clearance, qa: np.ndarray, qb: np.ndarray) -> bool:
    """Whether configurations on the straight edge, in steps of a few millimetres, are free."""
    reach = np.linalg.norm(tcp_jacobian(cell, np.array([qa, qb]))[:, 3:], axis=1).max(axis=0)
    reach += _BEYOND_SCANNER_M
    reach[6] = cell.settings.turntable.diameter_m / 2
    count = int(np.ceil(float(np.abs(qb - qa) @ reach) / _EXACT_STEP_M)) + 1
    return bool(clearance.free(qa + np.linspace(0.0, 1.0, count + 1)[:, None] * (qb - qa)).all())


def _way_out(cell: Cell, clearance: Clearance, q: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """A configuration near q, shape (7,), that the fast tier calls free, with a free edge to it; or None."""
    if clearance.fast_free(q[None])[0]:
        return q
    for radius in _ROOM_RAD * np.array([0.05, 0.1, 0.2, 0.4]):
        around = np.clip(q + radius * rng.uniform(-1.0, 1.0, size=(64, 7)), cell.q_min, cell.q_max)
        for near in around[clearance.fast_free(around)][:4]:
            if _exactly_free(cell, clearance, q, near):
                return near
    return None


def _planned(
    cell: Cell,
    clearance: Clearance,
    qa: np.ndarray,
    qb: np.ndarray,
    rng: np.random.Generator,
    attempt: int,
) -> Path | None:
    """One run of the planner, shortened and rounded; later attempts look further away and longer."""
    room = _ROOM_RAD * (1 + attempt)
    lower = np.maximum(np.minimum(qa, qb) - room, cell.q_min)
    upper = np.minimum(np.maximum(qa, qb) + room, cell.q_max)
    start, goal = _way_out(cell, clearance, qa, rng), _way_out(cell, clearance, qb, rng)
    if start is None or goal is None:
        return None
    found = plan_round(
        lambda a, b: bool(clearance.edges_free(a[None], b[None])[0]),
        lambda q: bool(clearance.fast_free(q[None])[0]),
        (start, goal),
        (np.minimum(lower, np.minimum(start, goal)), np.maximum(upper, np.maximum(start, goal))),
        scale=_scale(cell, qa, qb),
        reach=_EDGE_S,
        seed=int(rng.integers(1, 2**31 - 1)),
        most_checks=_FEW_CHECKS * 2**attempt,
    )
    if found is None:
        return None
    found = np.vstack([qa[None], found, qb[None]])
    found = found[np.concatenate([[True], np.abs(np.diff(found, axis=0)).max(axis=1) > 0.0])]
    q = _shortened(cell, clearance, subdivided(found, positions(cell, found)), rng)
    p = positions(cell, q)
    options = [with_table(cell, q)]
    options += [evenly_spaced(q, p, step_rad=STEP_RAD / k, step_m=STEP_M / k) for k in (1, 2, 4)]
    return _fastest_free(cell, clearance, [("planned", option) for option in options])


def _scale(cell: Cell, qa: np.ndarray, qb: np.ndarray) -> np.ndarray:
    """Seconds that a radian of each joint costs at least, for the scanner's way or the joint itself."""
    limits = transit_limits(cell)
    lever = np.linalg.norm(tcp_jacobian(cell, np.array([qa, qb]))[:, 3:], axis=1).mean(axis=0)
    return np.maximum(lever / limits.tcp, 1 / limits.v)


def _pace(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Seconds from the start to each vertex without regard to acceleration, shape (k,)."""
    limits = transit_limits(cell)
    steps = np.linalg.norm(np.diff(positions(cell, q), axis=0), axis=1) / limits.tcp
    steps = np.maximum(steps, (np.abs(np.diff(q, axis=0)) / limits.v).max(axis=1))
    return np.concatenate([[0.0], np.cumsum(steps)])


def _shortened(cell: Cell, clearance: Clearance, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Replaces stretches by the scanner's straight line or a straight edge where that is free and faster."""
    at = _pace(cell, q)
    for _ in range(_SHORTCUTS):
        a, b = np.sort(rng.uniform(0.0, at[-1], size=2))
        i, j = int(np.searchsorted(at, a)), int(np.searchsorted(at, b))
        if j - i < 2:
            continue
        pieces = [chord(cell, q[i], q[j]), subdivided(q[[i, j]], positions(cell, q[[i, j]]))]
        timed = [(float(_pace(cell, piece)[-1]), k) for k, piece in enumerate(pieces) if piece is not None]
        for seconds, k in sorted(timed):
            piece = pieces[k]
            if piece is None or seconds > at[j] - at[i] - 1e-3:
                break
            if clearance.edges_free(piece[:-1], piece[1:]).all():
                q = np.vstack([q[:i], piece, q[j + 1 :]])
                at = _pace(cell, q)
                break
    return q


def _blocked(cell: Cell, clearance: Clearance, q: np.ndarray, stop: int) -> PathError:
    """The error for a way that is blocked, with the pair that is closest on its first blocked edge."""
    _, index, pair = driven_free(cell, clearance, q)
    path = transit_spline(cell, q)
    edge = path((index + np.linspace(0.0, 1.0, 5)) / SAMPLES_PER_SPAN)
    near = min(float(clearance.distance(row)[0]) for row in edge)
    depth = max(float(cell.settings.process.clearance_m) - near, 0.0)
    text = f"{pair[0]} and {pair[1]} come {1000 * depth:.0f} mm too close on the way; no way round was found"
    return PathError(text, pair=pair, depth=depth, stop=stop)
