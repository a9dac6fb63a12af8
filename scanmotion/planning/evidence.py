"""Evidence: what the frames looked through, what viewpoints promised, and what has been tried; a value.

Guarantees: a pose that was tried is not chosen again, nor a place that a viewpoint should have seen, unless
less than half of what a round promised was measured. Assumes that the frames that are given are all of those
that made the cloud, or none of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.core.view_costs import ViewCosts
from scanmotion.geometry.typed_scipy import distances_to_nearest
from scanmotion.sensing.closed_surface import ClosedModel
from scanmotion.sensing.free_space import Space
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.find import Hole
from scanmotion.views.candidate_views import Reachable
from scanmotion.views.next_best_views import LocalStep, SelectOptions, local_step
from scanmotion.views.targets import TargetOptions

_WARY, _WARIER, _WARIEST, _WARY_OF_FILES = (float(np.deg2rad(a)) for a in (8, 12, 32, 15))
"""Incidence kept in hand [rad]; of a scan that comes as a file nobody knows what its frames looked through,
and no second round corrects what the first promised in vain. Where a round keeps less than half of its
promises, the normals are worse than that: the next one keeps more in hand, and may try the same places."""
_LEAST_KEPT = 0.05
"""A round that kept less of its promises is taken for one that kept so much."""
_SAME_PLACE, _SAME_DIRECTION = 0.06, np.deg2rad(12.0)
"""A pose nearer than this to one that was tried is the same once more [m], [rad]."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What local viewpoints must know of the cell, in O."""

    table: TableGeometry
    costs: ViewCosts


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """What is known for choosing local viewpoints."""

    scanner: Scanner
    surroundings: Surroundings
    spacing: float
    """Of the cloud's points [m]."""
    space: Space
    """What the frames have looked through."""
    frames: int = 0
    """How many there were."""
    wary: float = _WARY
    """Incidence kept in hand [rad]."""
    model: ClosedModel | None = None
    """Closed surface of the last round."""
    claimed: tuple[np.ndarray, ...] = ()
    """Points that each round's viewpoints should see, shape (k, 3) each [m]."""
    tried: tuple[np.ndarray, ...] = ()
    """Poses X_OS that need not be asked for again, shape (4, 4) each."""

    def with_frames(self, X_OS: np.ndarray, images: np.ndarray) -> "Evidence":
        """With more frames: poses (n, 4, 4) and depth images (n, h, w) [m]."""
        return replace(self, space=self.space.with_frames(X_OS, images), frames=self.frames + len(X_OS))

    def with_tried(self, poses: Sequence[np.ndarray]) -> "Evidence":
        """With poses X_OS, shape (4, 4) each, that need not be asked for again."""
        return replace(self, tried=(*self.tried, *poses))

    def untried(self, X_OS: np.ndarray) -> np.ndarray:
        """Which poses (n, 4, 4) are not near one that was tried, shape (n,)."""
        mask = np.ones(len(X_OS), bool)
        for X in self.tried:
            near = np.linalg.norm(X_OS[:, :3, 3] - X[:3, 3], axis=1) < _SAME_PLACE
            mask &= ~(near & (X_OS[:, :3, 2] @ X[:3, 2] > np.cos(_SAME_DIRECTION)))
        return mask

    def kept(self, cloud: Cloud) -> float:
        """Share of what the last round's viewpoints should have seen that has been measured since, 0..1."""
        if not self.claimed or len(self.claimed[-1]) == 0:
            return 1.0
        gap = TargetOptions().gap * self.spacing
        near = distances_to_nearest(cloud.points, self.claimed[-1]) <= gap
        return max(float(near.mean()), _LEAST_KEPT)


def no_evidence(scanner: Scanner, surroundings: Surroundings, *, spacing: float, stride: int) -> Evidence:
    """Before the first frame.

    Args:
        scanner: its field of view maps points to the images' pixels.
        surroundings: the table.
        spacing: of the cloud's points, and edge of the space's cells [m].
        stride: of the images: every stride-th pixel of the scanner's.
    """
    space = Space(scanner, edge=spacing, stride=stride, table_z=surroundings.table.z)
    return Evidence(scanner=scanner, surroundings=surroundings, spacing=spacing, space=space)


@dataclass(frozen=True, eq=False, kw_only=True)
class NextViews:
    """What one more round asks for."""

    step: LocalStep
    worth: dict[str, float]
    """By id, what each viewpoint may cost at most [s]."""
    evidence: Evidence
    """With what the round promises."""


def next_views(
    evidence: Evidence,
    cloud: Cloud,
    holes: Sequence[Hole],
    *,
    rate: float,
    seconds: float,
    reachable: Reachable | None,
    explain: bool,
    rng: np.random.Generator,
) -> NextViews:
    """The viewpoints of one more round, and what each may cost at most.

    Args:
        evidence: of the rounds before.
        cloud: the fused scan.
        holes: of it.
        rate: least share of the surface that a viewpoint adds per second [1/s].
        seconds: what the round may take [s].
        reachable: of the robot; None for all.
        explain: whether to say why what stays open does.
        rng: draws the targets.
    """
    # What the last round did not keep of its promises, this one will not keep either.
    kept, known = evidence.kept(cloud), evidence
    if kept < 0.5 and known.wary < _WARIEST:
        known, kept = replace(known, wary=min(known.wary + _WARIER, _WARIEST), claimed=()), 0.5
    rate = rate / kept
    step = local_step(
        cloud.points, cloud.normals, holes, known.scanner,
        spacing=known.spacing,
        space=known.space if known.frames else None,
        claimed=np.concatenate(known.claimed) if known.claimed else None,
        model=known.model,
        seconds=seconds,
        options=SelectOptions(least_rate=rate, wary=known.wary if known.frames else _WARY_OF_FILES),
        table=known.surroundings.table,
        costs=known.surroundings.costs,
        reachable=None if reachable is None else lambda X: reachable(X) & known.untried(X),
        explain=explain,
        rng=rng,
    )  # fmt: skip
    least = rate * step.model.area
    return NextViews(
        step=step,
        worth={v.id: gain / least for v, gain in zip(step.viewpoints, step.gains, strict=True)},
        evidence=replace(known, claimed=(*known.claimed, step.claimed), model=step.model),
    )
