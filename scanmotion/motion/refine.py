"""The chosen poses refined by Drake: each dwell of a planned tour, inside its viewpoint's slack.

Drake's InverseKinematics on the plant of the whole cell, with the pose and a least distance as constraints
over arm and table, looks near the analytic configuration for one that costs fewer seconds on the ways there
and on, and is farther from singularity. Guarantee: what is taken is free, keeps the slack, and comes no
nearer to anything than the analytic pose, or than 50 mm beyond the clearance; its manipulability is no less,
or ample; and the two ways, planned again and checked, take no more seconds. Else the analytic pose stays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.arm.robot import least_singular
from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.ik.slack_plant import Cost
from scanmotion.cell.kinematics import scanner_in_object, scanner_poses, tcp_jacobian
from scanmotion.core.errors import PathError
from scanmotion.core.tour import Path, Tour
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.reach.slack import SlackSearch, asked_pose, has_slack
from scanmotion.motion.transit.drive import transit_limits
from scanmotion.motion.transit.plan import transit

REFINED = "Drake, refined"
"""Name of the solver of a pose that is taken."""
ENOUGH_M = 0.05
"""More distance than this beyond the clearance is worth nothing [m]."""
COMFORT = 0.3
"""More manipulability than this (least singular value of the Jacobian, m and rad mixed) is worth little."""
_SIGMA_S = 2.0
"""What a unit of manipulability (m and rad mixed) is worth where it is scarce [s]."""
_SMOOTH_S = 0.05
"""Ways shorter than this count as nearly none, so that the cost has derivatives at rest [s]."""
_STEP = 1e-6
_OFF_M, _OFF_RAD = 5e-5, 2e-4
"""By how much rounding may pass the slack: well inside what the judge allows."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Refined:
    """A tour whose dwells stand where Drake put them, with the ways between."""

    tour: Tour
    paths: tuple[Path, ...]
    viewpoints: frozenset[str]
    """Ids of the viewpoints whose pose is Drake's."""


def refined(
    cell: Cell,
    clearance: Clearance,
    tour: Tour,
    paths: Sequence[Path],
    views: Mapping[str, Viewpoint],
    *,
    rng: np.random.Generator,
) -> Refined:
    """Refines the dwells of a tour one after another, each between neighbours that stand.

    Args:
        cell: the cell, with the part.
        clearance: its checker, which decides whether a pose and a way are free.
        tour: the stops in order.
        paths: a collision-free way to each.
        views: the viewpoints by id, with their slack.
        rng: source of the planner's random numbers.
    """
    stops, ways, taken = list(tour.stops), list(paths), set()
    search = SlackSearch(cell, clearance)
    # Drake reads the cell only where a stop can be refined.
    for n, stop in enumerate(stops):
        view = views[stop.viewpoints[0]]
        if stop.kind != "dwell" or not has_slack(view):
            continue
        before = stops[n - 1].q_out if n else np.asarray(tour.start_q, dtype=float)
        after = stops[n + 1].q_in if n + 1 < len(stops) else None
        q = _better_pose(cell, search, clearance, view, stop.q_in, (before, after))
        made = None if q is None else _ways(cell, clearance, (before, q, after), ways[n : n + 2], rng)
        if q is not None and made is not None:
            stops[n] = replace(stop, q_in=q, q_out=q)
            ways[n : n + 2] = made
            taken.add(view.id)
    saved = sum(p.seconds for p in paths) - sum(p.seconds for p in ways)
    return Refined(
        tour=replace(tour, stops=tuple(stops), seconds=tour.seconds - saved),
        paths=tuple(ways),
        viewpoints=frozenset(taken),
    )


def _ways(
    cell: Cell,
    clearance: Clearance,
    q: tuple[np.ndarray, np.ndarray, np.ndarray | None],
    old: Sequence[Path],
    rng: np.random.Generator,
) -> list[Path] | None:
    """The ways to a pose and on from it, where both together are no slower than the old ones; else None."""
    before, at, after = q
    budget = sum(p.seconds for p in old)
    made: list[Path] = []
    for a, b in ((before, at), (at, after)):
        if b is None:
            continue
        try:
            made.append(transit(cell, clearance, a, b, rng=rng))
        except PathError:
            return None
        if sum(p.seconds for p in made) > budget:
            return None
    return made


def _better_pose(
    cell: Cell,
    search: SlackSearch,
    clearance: Clearance,
    view: Viewpoint,
    q: np.ndarray,
    between: tuple[np.ndarray, np.ndarray | None],
) -> np.ndarray | None:
    """Drake's pose for a viewpoint that is served in `q` (7,), or None where it is no better in itself."""
    asked = asked_pose(cell, view)
    cost = _cost(cell, between)
    least = max(clearance.clearance, clearance.self_clearance)
    sigma = float(least_singular(cell.robot, q[None, :6])[0])
    for plant in search.plants():
        here = plant.least_distance(q)
        if here < least:
            # Inside the part's hull: the plant without the part asks for the rest, the checker for the part.
            continue
        bound = min(here, least + ENOUGH_M)
        found = np.clip(plant.refined(asked, q, bound, cost), cell.q_min, cell.q_max)
        if (
            cost(found)[0] < cost(q)[0]
            and least_singular(cell.robot, found[None, :6])[0] >= min(sigma, COMFORT) - 1e-9
            and keeps_slack(cell, view, found)
            and clearance.free(found[None])[0]
            and plant.least_distance(found) >= bound - 1e-6
            and _margin(clearance, found) >= min(_margin(clearance, q), ENOUGH_M) - 1e-6
        ):
            return found
    return None


def _margin(clearance: Clearance, q: np.ndarray) -> float:
    """Lower bound of the distance to the part's triangles and all else, beyond the clearance [m]."""
    return max(float(clearance.margins(q[None])[0]), 0.0)


def keeps_slack(cell: Cell, view: Viewpoint, q: np.ndarray) -> bool:
    """Whether a configuration (7,) brings the scanner to a pose that the viewpoint allows."""
    asked, X = asked_pose(cell, view), scanner_in_object(cell, q[None])[0]
    aim = view.p_OS + asked.standoff * view.direction
    far = float((aim - X[:3, 3]) @ X[:3, 2])
    off = float(np.linalg.norm(X[:3, 3] + far * X[:3, 2] - aim))
    cosine = X[:3, 2] @ view.direction
    if not view.slack.roll:
        cosine = (np.einsum("ij,ij->", X[:3, :3], view.X_OS[:3, :3]) - 1) / 2
    angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    inside = asked.near - _OFF_M <= far <= asked.far + _OFF_M
    return inside and off <= _OFF_M and angle <= view.slack.tilt + _OFF_RAD


def _cost(cell: Cell, between: tuple[np.ndarray, np.ndarray | None]) -> Cost:
    """About the seconds of the ways there and on, less what manipulability is worth, with derivatives."""
    limits = transit_limits(cell)
    ends = [q for q in between if q is not None]
    places = scanner_poses(cell, np.array(ends))[:, :3, 3]

    def cost(q: np.ndarray) -> tuple[float, np.ndarray]:
        p, J = scanner_poses(cell, q[None])[0, :3, 3], tcp_jacobian(cell, q[None])[0, 3:]
        value, slope = 0.0, np.zeros(7)
        for end, place in zip(ends, places, strict=True):
            turn, way = (q - end) / limits.v, (p - place) / limits.tcp
            seconds = float(np.sqrt(_SMOOTH_S**2 + way @ way + turn @ turn))
            value += seconds
            slope += (J.T @ way / limits.tcp + turn / limits.v) / seconds
        rows = np.vstack([q, q + _STEP * np.eye(7)[:6]])
        sigma = least_singular(cell.robot, rows[:, :6])
        slope[:6] -= _SIGMA_S * (sigma[1:] - sigma[0]) / _STEP
        return value - _SIGMA_S * float(sigma[0]), slope

    return cost
