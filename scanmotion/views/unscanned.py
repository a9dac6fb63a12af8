"""What stays unscanned, gathered by place, and why."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.sensing.visibility import Scene
from scanmotion.views.candidate_views import ASKED, CandidateOptions, Candidates, Reachable, candidates
from scanmotion.views.targets import Targets

REASONS = ("cannot be seen", "cannot be reached", "not worth its seconds")
CANNOT_BE_SEEN, CANNOT_BE_REACHED, NOT_WORTH = range(3)
_BATCHES = 60
"""So many times reach is asked at most, to tell what cannot be reached."""
_FINE = CandidateOptions(seeds=200, directions=240, per_seed=48)
_TOGETHER = 0.02
"""Places nearer to each other than this make one patch [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Patch:
    """A patch of surface that stays unscanned."""

    center: np.ndarray
    """Shape (3,) in O [m]."""
    area: float
    """[m2]"""
    reason: str
    """One of REASONS."""


def why_open(found: Candidates, left: np.ndarray) -> np.ndarray:
    """Why each of the targets `left` (k,) stays open, as indices of REASONS, shape (k,)."""
    seen = found.sees[:, left]
    _decide(seen, found)
    usable = seen & (found.reached | ~found.known)[:, None]
    return np.where(
        ~seen.any(axis=0), CANNOT_BE_SEEN, np.where(~usable.any(axis=0), CANNOT_BE_REACHED, NOT_WORTH)
    )


def _decide(seen: np.ndarray, found: Candidates) -> None:
    """Asks for reach until each target has a pose that is reached, or none left to ask for."""
    for _ in range(_BATCHES):
        undecided = ~seen[found.reached].any(axis=0)
        count = np.where(found.known, 0, seen[:, undecided].sum(axis=1))
        asked = np.argsort(-count, kind="stable")[:ASKED]
        if len(asked) == 0 or count[asked[0]] == 0:
            return
        found.ask(asked[count[asked] > 0])


def patches(targets: Targets, reasons: np.ndarray) -> tuple[Patch, ...]:
    """Targets gathered by place and reason (indices of REASONS, shape (m,)), the largest patch first."""
    out = []
    for r, name in enumerate(REASONS):
        some = targets.only(reasons == r)
        label = _together(some.points)
        for k in np.unique(label):
            group = some.only(label == k)
            out.append(Patch(center=group.points.mean(axis=0), area=float(group.areas.sum()), reason=name))
    return tuple(sorted(out, key=lambda p: -p.area))


def _together(points: np.ndarray) -> np.ndarray:
    """Which points (n, 3) hang together by short steps, shape (n,)."""
    if len(points) == 0:
        return np.zeros(0, int)
    pairs = cKDTree(points).query_pairs(_TOGETHER, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    return connected_components(graph, directed=False)[1]


def open_surface(
    scene: Scene,
    scanner: Scanner,
    open_: Targets,
    visible: np.ndarray,
    *,
    solid: np.ndarray,
    reachable: Reachable,
    table: TableGeometry,
) -> np.ndarray:
    """Why each piece of a known surface that was not scanned was not, as indices of REASONS, shape (m,).

    Args:
        scene: what blocks sight, the surface itself above all.
        scanner: field, range, incidence, baseline.
        open_: the surface that was not scanned.
        visible: which of it some allowed scanner could see, shape (m,).
        solid: points of the whole surface, shape (k, 3).
        reachable: tells which poses the robot reaches.
        table: where it is, and the room beside it.
    """
    reasons = np.full(len(open_), CANNOT_BE_SEEN)
    where = np.flatnonzero(visible)
    if len(where):
        found = candidates(
            scene, scanner, open_.only(where), solid=solid, reachable=reachable, table=table, options=_FINE
        )
        # What can be seen, but from nowhere that a scanner on its arm can stand, is out of reach.
        reasons[where] = np.maximum(why_open(found, np.arange(len(where))), CANNOT_BE_REACHED)
    return reasons
