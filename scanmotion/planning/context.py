"""The context of a plan: what is read and never changed while it is planned; and the scan simulator."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.build import Cell, build_cell, check_room
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import CellSettings
from scanmotion.cell.table_of import table_of
from scanmotion.cell.view_costs import view_costs
from scanmotion.core.errors import PartError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.stopwatch import Stopwatch
from scanmotion.core.support.streams import Streams
from scanmotion.core.trajectory import Trajectory
from scanmotion.geometry.compiled import compile_kernels
from scanmotion.geometry.parts.make_part import check_fits, surface_samples
from scanmotion.planning.evidence import Surroundings
from scanmotion.planning.methods import Method, method_from
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.segment import Progress
from scanmotion.sensing.closed_surface import closed_model
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.scans.measured_scan import cloud_from_part, spacing_of
from scanmotion.sensing.simulator.captures import ScanErrors, captures_from_trajectory
from scanmotion.sensing.simulator.simulate import Scan, simulate
from scanmotion.sensing.visibility import Scene, scene_from, visible
from scanmotion.views.candidate_views import Reachable
from scanmotion.views.targets import Targets
from scanmotion.views.unscanned import CANNOT_BE_REACHED, Patch, open_surface, patches


@dataclass(frozen=True, eq=False, kw_only=True)
class Simulator:
    """Knows the true surface; planning asks it only for scans, and at the end for a verdict."""

    part: Part
    cell: Cell
    scanner: Scanner
    surroundings: Surroundings
    errors: ScanErrors
    """What scanner, arm and table get wrong."""
    stride: int
    """Every stride-th ray in x and y of a frame is cast."""
    samples: SurfaceSamples
    """Of the surface, by which completeness is counted."""
    scene: Scene
    """What blocks sight."""

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
            trajectory, lambda q: scanner_poses(self.cell, q),
            fps=self.cell.settings.process.fps, X_WT=self.cell.X_WT, X_TO=self.cell.X_TO,
        )  # fmt: skip
        return simulate(
            self.scene, self.scanner, captures,
            errors=self.errors, stride=self.stride, rng=rng, samples=self.samples, known=known,
            progress=progress,
        )  # fmt: skip

    def visible(self, seen: np.ndarray) -> np.ndarray:
        """Which samples can be seen at all, shape (n,); what has been, `seen` (n,), can be."""
        s = self.samples
        return visible(self.scene, self.scanner, s.points, s.normals, seen=seen)

    def unscanned(
        self, seen: np.ndarray, can_be_seen: np.ndarray, reachable: Reachable
    ) -> tuple[tuple[Patch, ...], np.ndarray]:
        """What stays unscanned and why, by place; and which samples can be seen, but not by this robot, (n,).

        Args:
            seen: samples that have been, shape (n,).
            can_be_seen: samples that any allowed pose sees, shape (n,).
            reachable: tells which poses the robot reaches.
        """
        s = self.samples
        left = np.flatnonzero(~seen)
        open_ = Targets(points=s.points[left], normals=s.normals[left], areas=np.full(len(left), s.area))
        why = open_surface(
            self.scene, self.scanner, open_, can_be_seen[left],
            solid=self.part.vertices, reachable=reachable,
            table=self.surroundings.table,
        )  # fmt: skip
        out_of_reach = np.zeros(len(seen), bool)
        out_of_reach[left] = why == CANNOT_BE_REACHED
        return patches(open_, why), out_of_reach


@dataclass(frozen=True, eq=False, kw_only=True)
class Context:
    """All that planning reads: it is the same from the first segment to the last."""

    part: Part
    settings: CellSettings
    options: PlanOptions
    method: Method
    cell: Cell
    clearance: Clearance
    """The collision checker."""
    scanner: Scanner
    surroundings: Surroundings
    measured: Cloud | None
    """The measured global scan, where that is the source."""
    spacing: float
    """Of the cloud's points [m]."""
    simulator: Simulator | None
    """None where the true surface is not known."""
    corrects: bool
    """Whether simulated scans are calibrated and registered."""
    progress: Progress
    watch: Stopwatch

    def rng(self, name: str, *numbers: int) -> np.random.Generator:
        """The stream of a stage: one stage's draws do not shift another's."""
        return Streams(seed=self.options.seed).child(name, *numbers)

    @property
    def prunes(self) -> bool:
        """Whether pruning has the last word on local viewpoints."""
        return self.method.prunes and self.simulator is not None

    @property
    def budget_s(self) -> float:
        """What the programme may take [s]."""
        return float(self.settings.process.budget_s)


def context_from(part: Part, settings: CellSettings, options: PlanOptions, progress: Progress) -> Context:
    """Builds the cell and what else planning reads.

    Args:
        part: what is scanned; for source "box" the box itself, for source "scan" the measured surface.
        settings: the cell.
        options: the user's words.
        progress: told the stage and the share done.

    Raises:
        PartError: the part does not fit the table, or is not what the source needs.
        CellError: an obstacle stands where the table turns.
    """
    watch = Stopwatch()
    with watch("compiling"):
        compile_kernels(progress=progress)
    surroundings = Surroundings(table=table_of(settings), costs=view_costs(settings))
    check_fits(part, settings.turntable.diameter_m / 2, settings.process.max_height_m)
    if options.source == "mesh" and not part.is_mesh:
        raise PartError(f"{part.name}: a point cloud cannot be scanned by the twin; give it as a scan")
    errors = options.errors or ScanErrors(**settings.twin_errors())
    measured, spacing = None, options.voxel
    if options.source == "scan":
        with watch("scan"):
            measured = cloud_from_part(part, spacing=options.voxel)
            spacing = spacing_of(measured.points, least=options.voxel)
    with watch("cell"):
        cell = build_cell(settings, _solid(part, measured, spacing))
        check_room(cell)
        clearance = Clearance(cell)
    simulator = None
    if options.source == "mesh":
        simulator = _simulator(part, cell, surroundings, options, errors)
    corrects = errors.constant if options.calibrate is None else options.calibrate
    return Context(
        part=part, settings=settings, options=options, method=method_from(options), cell=cell,
        clearance=clearance, scanner=settings.scanner_model(), surroundings=surroundings, measured=measured,
        spacing=spacing, simulator=simulator, corrects=bool(corrects) and simulator is not None,
        progress=progress, watch=watch,
    )  # fmt: skip


def _solid(part: Part, measured: Cloud | None, spacing: float) -> Part:
    """What the arm must not touch: the mesh, the box, or the closed model of a measured cloud."""
    if part.is_mesh or measured is None:
        return part
    model = closed_model(measured.points, measured.normals, spacing=spacing)
    return Part(name=part.name, vertices=model.vertices, triangles=model.triangles)


def _simulator(
    part: Part, cell: Cell, surroundings: Surroundings, options: PlanOptions, errors: ScanErrors
) -> Simulator:
    rng = Streams(seed=options.seed).child("surface_samples")
    return Simulator(
        part=part, cell=cell, scanner=cell.settings.scanner_model(), surroundings=surroundings,
        errors=errors, stride=options.stride, samples=surface_samples(part, options.samples, rng=rng),
        scene=scene_from(
            part.vertices, part.triangles, table_radius=surroundings.table.radius,
            table_z=surroundings.table.z, pedestal_radius=surroundings.table.pedestal_radius,
        ),
    )  # fmt: skip
