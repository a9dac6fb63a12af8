"""The search for what the scans have missed, kept from round to round of the local step."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.core.view_costs import ViewCosts
from scanmotion.sensing.closed_surface import ClosedModel
from scanmotion.sensing.free_space import Space
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.find import Hole
from scanmotion.views.candidate_views import Reachable
from scanmotion.views.next_best_views import LocalStep, SelectOptions, local_step
from scanmotion.views.targets import TargetOptions

THOROUGH_RATE = 2.5e-6
"""Least share of the surface per second that a viewpoint of a thorough plan adds [1/s]."""
_WARY, _WARIER, _WARIEST, _WARY_OF_FILES = (float(np.deg2rad(a)) for a in (8, 12, 32, 15))
"""Incidence kept in hand [rad]; of a scan that comes as a file nobody knows what its frames looked through,
and no second round mends what the first promised in vain. Where a round keeps less than half of its promises,
the normals are worse than that: the next one keeps more in hand, and may try the same places."""
_LEAST_KEPT = 0.05
"""A round that kept less of its promises is taken for one that kept so much."""
_SAME_PLACE, _SAME_DIRECTION = 0.06, np.deg2rad(12.0)
"""A pose nearer than this to one that was tried is the same once more [m], [rad]."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What the search must know of the cell, in O."""

    table: TableGeometry
    costs: ViewCosts


class Search:
    """What frames looked through, what viewpoints promised, and what has been tried."""

    def __init__(self, scanner: Scanner, surroundings: Surroundings, *, voxel: float, stride: int) -> None:
        self._scanner, self._around, self._voxel = scanner, surroundings, voxel
        self._space = Space(scanner, edge=voxel, stride=stride, table_z=surroundings.table.z)
        self._frames = 0
        self._wary = _WARY
        self._model: ClosedModel | None = None
        self._claimed: list[np.ndarray] = []
        self._tried: list[np.ndarray] = []

    def look(self, X_OS: np.ndarray, images: np.ndarray) -> None:
        """Remembers frames: poses (n, 4, 4) and depth images (n, h, w) [m]."""
        self._space.add(X_OS, images)
        self._frames += len(X_OS)

    def tried(self, poses: Sequence[np.ndarray]) -> None:
        """Poses X_OS that need not be asked for again."""
        self._tried += list(poses)

    def step(
        self,
        cloud: Cloud,
        holes: Sequence[Hole],
        *,
        rate: float,
        seconds: float,
        reachable: Reachable | None,
        explain: bool,
        rng: np.random.Generator,
    ) -> tuple[LocalStep, dict[str, float]]:
        """The viewpoints of one more round, and what each may cost at most [s].

        Args:
            cloud: the fused scan.
            holes: of it.
            rate: least share of the surface that a viewpoint adds per second [1/s].
            seconds: what the round may take [s].
            reachable: of the robot; None for all.
            explain: whether to say why what stays open does.
            rng: draws the targets.
        """
        # What the last round did not keep of its promises, this one will not keep either.
        kept = self._kept(cloud)
        if kept < 0.5 and self._wary < _WARIEST:
            self._wary = min(self._wary + _WARIER, _WARIEST)
            self._claimed, kept = [], 0.5
        rate = rate / kept
        step = local_step(
            cloud.points, cloud.normals, holes, self._scanner,
            spacing=self._voxel,
            space=self._space if self._frames else None,
            claimed=np.concatenate(self._claimed) if self._claimed else None,
            model=self._model,
            seconds=seconds,
            options=SelectOptions(least_rate=rate, wary=self._wary if self._frames else _WARY_OF_FILES),
            table=self._around.table,
            costs=self._around.costs,
            reachable=None if reachable is None else lambda X: reachable(X) & self._untried(X),
            explain=explain,
            rng=rng,
        )  # fmt: skip
        self._claimed.append(step.claimed)
        self._model = step.model
        least = rate * step.model.area
        return step, {v.id: gain / least for v, gain in zip(step.viewpoints, step.gains, strict=True)}

    def _kept(self, cloud: Cloud) -> float:
        """Share of what the last round's viewpoints should have seen that has been measured since."""
        if not self._claimed or len(self._claimed[-1]) == 0:
            return 1.0
        gap = TargetOptions().gap * self._voxel
        near = cKDTree(cloud.points).query(self._claimed[-1])[0] <= gap
        return max(float(near.mean()), _LEAST_KEPT)

    def _untried(self, X_OS: np.ndarray) -> np.ndarray:
        mask = np.ones(len(X_OS), bool)
        for X in self._tried:
            near = np.linalg.norm(X_OS[:, :3, 3] - X[:3, 3], axis=1) < _SAME_PLACE
            mask &= ~(near & (X_OS[:, :3, 2] @ X[:3, 2] > np.cos(_SAME_DIRECTION)))
        return mask
