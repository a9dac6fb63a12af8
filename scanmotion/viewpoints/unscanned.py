"""What stays unscanned, gathered by place, and why."""

from dataclasses import dataclass

import numpy as np

from scanmotion.viewpoints.candidates import ASKED, Candidates
from scanmotion.viewpoints.targets import Targets

REASONS = ("cannot be seen", "cannot be reached", "not worth its seconds")
CANNOT_BE_SEEN, CANNOT_BE_REACHED, NOT_WORTH = range(3)
_BATCHES = 60
"""So many times reach is asked at most, to tell what cannot be reached."""
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
    from scipy.cluster.hierarchy import fcluster, linkage

    out = []
    for r, name in enumerate(REASONS):
        some = targets.only(reasons == r)
        if len(some) == 0:
            continue
        label = np.ones(1, int)
        if len(some) > 1:
            label = fcluster(linkage(some.points, "single"), _TOGETHER, "distance")
        for k in np.unique(label):
            group = some.only(label == k)
            out.append(Patch(center=group.points.mean(axis=0), area=float(group.areas.sum()), reason=name))
    return tuple(sorted(out, key=lambda p: -p.area))
