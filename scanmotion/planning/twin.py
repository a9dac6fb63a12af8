"""The twin of a trip: the true surface, scans along trajectories, and what can be seen at all."""

from collections.abc import Callable

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.scanner import Scanner
from scanmotion.core.trajectory import Trajectory
from scanmotion.planning.evidence import Surroundings
from scanmotion.planning.options import PlanOptions
from scanmotion.sensing.simulator.captures import ScanErrors, captures_from_trajectory
from scanmotion.sensing.simulator.simulate import Scan, simulate
from scanmotion.sensing.visibility import scene_from, visible
from scanmotion.views.candidate_views import Reachable
from scanmotion.views.targets import Targets
from scanmotion.views.unscanned import CANNOT_BE_REACHED, Patch, open_surface, patches


class Twin:
    """Knows the truth; the planner asks it only for scans, and at the end for a verdict."""

    def __init__(
        self,
        part: Part,
        cell: Cell,
        around: Surroundings,
        *,
        options: PlanOptions,
        errors: ScanErrors,
        samples: SurfaceSamples,
    ) -> None:
        self._part, self._cell, self._around = part, cell, around
        self._options, self._errors = options, errors
        self._scanner: Scanner = cell.settings.scanner_model()
        self._visible: np.ndarray | None = None
        self.samples = samples
        self.scene = scene_from(
            part.vertices, part.triangles,
            table_radius=around.table.radius, table_z=around.table.z,
            pedestal_radius=around.table.pedestal_radius,
        )  # fmt: skip

    def scan(
        self,
        trajectory: Trajectory,
        *,
        known: np.ndarray,
        rng: np.random.Generator,
        progress: Callable[[float], None],
    ) -> Scan:
        """What the scanner measures along a trajectory.

        Args:
            trajectory: joint positions over time.
            known: samples that have been seen and need no test, shape (n,).
            rng: of the noise.
            progress: told the share done.
        """
        captures = captures_from_trajectory(
            trajectory, lambda q: scanner_poses(self._cell, q),
            fps=self._cell.settings.process.fps, X_WT=self._cell.X_WT, X_TO=self._cell.X_TO,
        )  # fmt: skip
        return simulate(
            self.scene, self._scanner, captures,
            errors=self._errors, stride=self._options.stride, rng=rng, samples=self.samples, known=known,
            progress=progress,
        )  # fmt: skip

    def visible(self, seen: np.ndarray) -> np.ndarray:
        """Which samples can be seen at all, shape (n,); what has been seen once, `seen` (n,), can be."""
        if self._visible is None:
            s = self.samples
            self._visible = visible(self.scene, self._scanner, s.points, s.normals, seen=seen)
        self._visible = self._visible | seen
        return self._visible

    def unscanned(self, seen: np.ndarray, reachable: Reachable) -> tuple[tuple[Patch, ...], np.ndarray]:
        """What stays unscanned and why, by place; and which samples can be seen, but not by this robot, (n,).

        Args:
            seen: samples that have been, shape (n,).
            reachable: tells which poses the robot reaches.
        """
        s = self.samples
        left = np.flatnonzero(~seen)
        open_ = Targets(points=s.points[left], normals=s.normals[left], areas=np.full(len(left), s.area))
        why = open_surface(
            self.scene, self._scanner, open_, self.visible(seen)[left],
            solid=self._part.vertices, reachable=reachable, table=self._around.table,
        )  # fmt: skip
        out_of_reach = np.zeros(len(seen), bool)
        out_of_reach[left] = why == CANNOT_BE_REACHED
        return patches(open_, why), out_of_reach
