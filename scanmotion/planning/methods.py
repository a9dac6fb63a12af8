"""Methods: how a scan is planned, as frozen values that hold functions.

The user's words (mode, strategy and switches) are translated into a method once, by `method_from`; nothing
below asks for a word again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.part import Part
from scanmotion.core.tour import Tour
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.motion.order.sequence import by_distance, sequence
from scanmotion.motion.order.stops import PathFree
from scanmotion.motion.reach.find import Reach
from scanmotion.motion.reach.table_still import with_table_still
from scanmotion.planning.options import PlanOptions
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.find import HoleReport, holes_from_cloud
from scanmotion.sensing.holes.paper_clusters import LargestAngle
from scanmotion.views.cad_slicing import cad_slicing
from scanmotion.views.hole_views import local_viewpoints, paper_local_viewpoints
from scanmotion.views.next_best_views import SelectOptions
from scanmotion.views.stepped_rotary import StepPlan, paper_stepped_rotary, stepped_rotary
from scanmotion.views.surface_partitioning import surface_partitioning

__all__ = [
    "CAD_SLICING",
    "DEFAULT",
    "METHODS",
    "PAPER",
    "SURFACE_PARTITIONING",
    "THOROUGH_RATE",
    "Method",
    "method_from",
]

THOROUGH_RATE = 2.5e-6
"""Least share of the surface per second that a viewpoint of a thorough plan adds [1/s]."""


class Order(Protocol):
    """Puts viewpoints into an order, each with a configuration; see `motion.order.sequence`."""

    def __call__(
        self,
        cell: Cell,
        reaches: Sequence[Reach],
        *,
        start_q: np.ndarray,
        rng: np.random.Generator,
        path_free: PathFree | None,
    ) -> Tour:
        """The tour from `start_q`, shape (7,) [rad]."""
        ...


Stations = Callable[[Cell, Clearance, Sequence[Reach], np.ndarray], list[Reach]]
"""What is left of the configurations of stations, for a programme that stands at q, shape (7,) [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Method:
    """How a scan is planned."""

    name: str
    global_views: Callable[[Part, CellSettings], StepPlan]
    """Viewpoints of the global step."""
    holes: Callable[[Cloud], HoleReport]
    """Holes of a fused scan."""
    takes_local_step: bool = True
    """Whether a local step follows."""
    views_over_holes: Callable[[HoleReport, CellSettings], tuple[Viewpoint, ...]] | None = None
    """Local viewpoints from the holes alone, in one round; None chooses next best views on a closed model of
    the scan, in several rounds."""
    stations: Stations | None = None
    """Which configurations of stations count; None for all."""
    order: Order = sequence
    asks_reach: bool = True
    """Next best views are chosen among those that the robot reaches; False: reach is asked for afterwards."""
    least_rate: float = SelectOptions().least_rate
    """Least share of the surface that a local viewpoint adds per second [1/s]."""
    prunes: bool = True
    """In the end, what the simulator shows to be worth less than its seconds is left out."""
    refines: bool = True
    """The poses of dwells are refined by Drake inside their viewpoints' slack."""
    joins_turns: bool = False
    """Neighbouring turns of the global step may become helices."""


def _turns(part: Part, settings: CellSettings) -> StepPlan:
    length, width, height = (float(side) for side in part.extent)
    return stepped_rotary(
        length, width, height, settings.scanner_model(), pedestal=settings.pedestal.height_m
    )  # fmt: skip


def _paper_turns(part: Part, settings: CellSettings) -> StepPlan:
    length, width, height = (float(side) for side in part.extent)
    return paper_stepped_rotary(
        length, width, height, settings.scanner_model(),
        standoff=settings.process.standoff_m, pedestal=settings.pedestal.height_m,
    )  # fmt: skip


def _slices(part: Part, settings: CellSettings) -> StepPlan:
    views = cad_slicing(part, settings.scanner_model(), standoff=settings.process.standoff_m)
    return StepPlan(viewpoints=views, dropped=())


def _patches(part: Part, settings: CellSettings) -> StepPlan:
    views = surface_partitioning(part, settings.scanner_model(), standoff=settings.process.standoff_m)
    return StepPlan(viewpoints=views, dropped=())


def _over_holes(report: HoleReport, settings: CellSettings) -> tuple[Viewpoint, ...]:
    return local_viewpoints(
        report.holes, settings.scanner_model(),
        standoff=settings.process.standoff_m, table_z=-settings.pedestal.height_m,
    )  # fmt: skip


def _paper_over_holes(report: HoleReport, settings: CellSettings) -> tuple[Viewpoint, ...]:
    return paper_local_viewpoints(
        report.holes, settings.scanner_model(),
        standoff=settings.process.standoff_m, table_z=-settings.pedestal.height_m,
    )  # fmt: skip


def _holes(cloud: Cloud) -> HoleReport:
    return holes_from_cloud(cloud.points, view_directions=cloud.view_directions)


def _paper_holes(cloud: Cloud) -> HoleReport:
    return holes_from_cloud(cloud.points, view_directions=cloud.view_directions, by_angle=LargestAngle())


def _table_at_zero(cell: Cell, clearance: Clearance, reaches: Sequence[Reach], at: np.ndarray) -> list[Reach]:
    return with_table_still(cell, clearance, reaches, 0.0)


def _table_as_it_stands(
    cell: Cell, clearance: Clearance, reaches: Sequence[Reach], at: np.ndarray
) -> list[Reach]:
    return with_table_still(cell, clearance, reaches, float(at[6]))


DEFAULT = Method(name="default", global_views=_turns, holes=_holes)
"""Four turns, then next best views on a closed model of the scan; order by seconds."""

PAPER = Method(
    name="paper", global_views=_paper_turns, holes=_paper_holes,
    views_over_holes=_paper_over_holes, stations=_table_at_zero,
    order=partial(sequence, ordering=by_distance), prunes=False, refines=False,
)  # fmt: skip
"""The published formulas (doi 10.3390/act14030139): its turns, its four cases, order by distance."""

CAD_SLICING = replace(
    DEFAULT, name="cad-slicing", global_views=_slices, takes_local_step=False, prunes=False
)  # fmt: skip
"""Passes round slices of the true mesh, one step; the paper compares with it."""

SURFACE_PARTITIONING = replace(CAD_SLICING, name="surface-partitioning", global_views=_patches)
"""One view for each nearly flat patch of the true mesh, one step; the paper compares with it."""

METHODS = (DEFAULT, PAPER, CAD_SLICING, SURFACE_PARTITIONING)


def method_from(options: PlanOptions) -> Method:
    """The method that a user's words mean."""
    literal = options.mode == "paper"
    method = PAPER if literal else DEFAULT
    if options.strategy != "two-step":
        one_step = next(m for m in METHODS if m.name == options.strategy)
        method = replace(one_step, stations=method.stations, order=method.order)
    elif not literal and not options.occlusion_aware:
        method = replace(method, views_over_holes=_over_holes, prunes=False)
    if options.turntable == "fallback" and not literal:
        method = replace(method, stations=_table_as_it_stands)
    return replace(
        method,
        asks_reach=options.reach_feedback,
        least_rate=THOROUGH_RATE if options.thorough else method.least_rate,
        prunes=method.prunes and options.tidy,
        joins_turns=options.helix,
    )
