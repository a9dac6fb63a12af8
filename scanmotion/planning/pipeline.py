"""The whole trip on one screen: a part and a cell in, a Plan out. Nobody else knows the stages' order."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scanmotion.cell.build import Cell, build_cell, check_room
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings import CellSettings
from scanmotion.cell.table_of import table_of
from scanmotion.cell.view_costs import view_costs
from scanmotion.core.errors import PartError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.trajectory import joined as in_a_row
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.parts import check_fits, surface_samples
from scanmotion.motion.reach.find import reachable_mask
from scanmotion.planning.evidence import THOROUGH_RATE, Search, Surroundings
from scanmotion.planning.helices import joined
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.outcome import Plan, Round, Stopwatch
from scanmotion.planning.prune import not_worth, stops_seen
from scanmotion.planning.segment import Leg, Progress, leg_from, renamed, silent, with_left_out
from scanmotion.planning.twin import Twin
from scanmotion.sensing.closed_surface import closed_model
from scanmotion.sensing.corrections import Mender, Mending
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.fusion.merge import merged
from scanmotion.sensing.holes.find import HoleReport, holes_from_cloud
from scanmotion.sensing.measured_scan import cloud_from_part, spacing_of
from scanmotion.sensing.simulator.images import depth_images
from scanmotion.sensing.simulator.simulate import Scan, ScanErrors
from scanmotion.views.cad_slicing import cad_slicing
from scanmotion.views.hole_views import local_viewpoints
from scanmotion.views.next_best_views import SelectOptions
from scanmotion.views.stepped_rotary import stepped_rotary
from scanmotion.views.surface_partitioning import surface_partitioning

__all__ = ["PlanOptions", "plan"]

_SOUGHT = 0.5
"""Share of what a viewpoint must be worth for which it is sought, where the twin has the last word."""
_TRIES = 6
"""So often viewpoints are taken out until a programme is inside its budget."""
_SIDE_TRIP_S = 10.0
"""A local viewpoint is taken only within this time of home or a viewpoint of the first leg [s]."""


def plan(
    part: Part, settings: CellSettings, *, options: PlanOptions | None = None, progress: Progress = silent
) -> Plan:
    """Plans the scan of `part` in the cell that `settings` describe.

    Args:
        part: what is scanned; for source "box" the box itself, for source "scan" the measured surface.
        settings: the cell.
        options: source, mode, strategy, seed and the twin's settings.
        progress: told the stage and the share of it that is done.

    Raises:
        PartError: the part does not fit the table, or is not what the source needs.
        CellError: an obstacle stands where the table turns.
    """
    trip = Trip(part, settings, options or PlanOptions(), progress)
    if trip.options.source == "scan":
        trip.take_scan()
    elif trip.options.strategy == "two-step":
        trip.global_step()
    else:
        trip.single_step()
    if trip.options.source != "box" and trip.options.strategy == "two-step":
        trip.local_rounds()
    trip.tidy()
    return trip.plan()


@dataclass(frozen=True, eq=False, kw_only=True)
class _State:
    """All that a leg adds to."""

    trajectory: Trajectory | None
    rounds: tuple[Round, ...]
    scans: tuple[Scan, ...]
    seen: np.ndarray
    cloud: Cloud | None
    mending: Mending | None

    def value(self, rate: float) -> float:
        """What has been seen, less what the seconds are worth, as a share of the surface."""
        return float(self.seen.mean()) - rate * (self.trajectory.duration if self.trajectory else 0.0)


class Trip:
    """What the stages have found so far."""

    def __init__(self, part: Part, settings: CellSettings, options: PlanOptions, progress: Progress) -> None:
        self.watch = Stopwatch()
        self.options, self.progress = options, progress
        self.settings, self.part = settings, part
        check_fits(part, settings.turntable.diameter_m / 2, settings.process.max_height_m)
        if options.source == "mesh" and not part.is_mesh:
            raise PartError(f"{part.name}: a point cloud cannot be scanned by the twin; give it as a scan")
        self.scanner: Scanner = settings.scanner_model()
        errors = options.errors or ScanErrors(**settings.twin_errors())
        self.given: Cloud | None = None
        self.spacing = options.voxel
        if options.source == "scan":
            with self.watch("scan"):
                self.given = cloud_from_part(part, spacing=options.voxel)
                self.spacing = spacing_of(self.given.points, least=options.voxel)
        with self.watch("cell"):
            self.cell: Cell = build_cell(settings, self._solid())
            check_room(self.cell)
            self.clearance = Clearance(self.cell)
        self.rounds: list[Round] = []
        self.searched: tuple[Round, ...] = ()
        self.after_global: _State | None = None
        self.trajectory: Trajectory | None = None
        self.scans: list[Scan] = []
        mends = errors.constant if options.calibrate is None else options.calibrate
        self.mender = Mender(part, voxel=options.voxel) if mends and options.source == "mesh" else None
        self.cloud: Cloud | None = None
        self.holes: HoleReport | None = None
        self.dropped: list[tuple[str, str]] = []
        self.unscanned: tuple = ()
        self.search = Search(self.scanner, self._surroundings(), voxel=self.spacing, stride=options.stride)
        self.twin: Twin | None = None
        self.helix: dict[str, Any] | None = None
        self.seen = np.zeros(options.samples if options.source == "mesh" else 0, bool)
        if options.source == "mesh":
            self.twin = Twin(
                part, self.cell, self._surroundings(), options=options, errors=errors,
                samples=surface_samples(part, options.samples, rng=self._rng(1)),
            )  # fmt: skip

    def _rng(self, stream: int) -> np.random.Generator:
        """Each stage has a stream of its own, so that one stage's draws do not shift another's."""
        return np.random.default_rng([self.options.seed, stream])

    def _solid(self) -> Part:
        """What the arm must not touch: the mesh, the box, or the closed model of a measured cloud."""
        if self.part.is_mesh:
            return self.part
        assert self.given is not None
        model = closed_model(self.given.points, self.given.normals, spacing=self.spacing)
        return Part(name=self.part.name, vertices=model.vertices, triangles=model.triangles)

    def _surroundings(self) -> Surroundings:
        return Surroundings(table=table_of(self.settings), costs=view_costs(self.settings))

    @property
    def table_z(self) -> float:
        """Height of the table's top in O [m]."""
        return -self.settings.pedestal.height_m

    @property
    def at(self) -> np.ndarray:
        """Where the programme stands now, shape (7,)."""
        return self.cell.home if self.trajectory is None else self.trajectory.q[-1]

    def take_scan(self) -> None:
        """A measured global scan stands in for the global step."""
        self.cloud = self.given

    def global_step(self) -> None:
        """Stepped rotary scanning of the bounding box."""
        length, width, height = (float(side) for side in self.part.extent)
        step = stepped_rotary(
            length, width, height, self.scanner,
            standoff=self.settings.process.standoff_m,
            mode=self.options.mode,
            pedestal=self.settings.pedestal.height_m,
        )  # fmt: skip
        self.dropped += list(step.dropped)
        self.run(step.viewpoints, "global", self._rng(2))
        self.after_global = self._state()

    def single_step(self) -> None:
        """One of the two methods that the paper compares with; both need the mesh."""
        strategy = cad_slicing if self.options.strategy == "cad-slicing" else surface_partitioning
        with self.watch("viewpoints"):
            views = strategy(self.part, self.scanner, standoff=self.settings.process.standoff_m)
        self.run(views, "global", self._rng(2))

    def local_rounds(self) -> None:
        """Holes, local viewpoints, the same trip again, until nothing more is worth a round."""
        for number in range(1, self.options.rounds + 1):
            assert self.cloud is not None
            if self.holes is None:
                with self.watch("holes"):
                    self.progress("holes", 0.0)
                    self.holes = holes_from_cloud(
                        self.cloud.points, view_directions=self.cloud.view_directions, mode=self.options.mode
                    )
            with self.watch("viewpoints"):
                self.progress("viewpoints", 0.0)
                views, worth = self._local_views(self.holes, number)
            if not views:
                return
            prefix = f"R{number}" if number > 1 else ""
            worth = {prefix + name: seconds for name, seconds in worth.items()}
            self.run(renamed(views, prefix), "local", self._rng(10 + number), worth)
            if self._literal or self.options.source == "scan" or self._complete():
                return

    def tidy(self) -> None:
        """Takes out the local viewpoints that the twin shows to be worth less than their seconds, or that the
        budget has no seconds for, and makes one leg of the rest, where that is the better programme.
        """
        local = [item.leg for item in self.rounds if item.step == "local"]
        if not self._tidies or self.after_global is None or not any(leg.trajectory for leg in local):
            return
        assert self.twin is not None
        old, open_ = self._state(), np.flatnonzero(self.seen & ~self.after_global.seen)
        self.twin.visible(self.seen)
        with self.watch("tidy"):
            self.progress("tidy", 0.0)
            stops = stops_seen(self.cell, local, self.twin.scene, self.twin.samples, open_)
        save, late = 0.0, self._over() > 0
        for _ in range(_TRIES):
            out = not_worth(stops, len(self.seen), rate=self._rate, save=save)
            if not out and sum(leg.trajectory is not None for leg in local) == 1 and self._over() <= 0:
                return
            self._back_to(self.after_global)
            kept = [v for leg in local for v in leg.served if v.id not in out]
            self.run(tuple(kept), "local", self._rng(30))
            if self._over() <= 0 or not kept:
                break
            save += self._over() + 0.5
        if not late and self._state().value(self._rate) <= old.value(self._rate):
            self._back_to(old)
            return
        self.searched = old.rounds
        self.rounds[-1] = replace(self.rounds[-1], leg=with_left_out(self.rounds[-1].leg, local, out))

    def _over(self) -> float:
        """By how much the programme is longer than its budget [s]; negative where it is shorter."""
        return (self.trajectory.duration if self.trajectory else 0.0) - self.settings.process.budget_s

    def _state(self) -> _State:
        return _State(
            trajectory=self.trajectory, rounds=tuple(self.rounds), scans=tuple(self.scans), seen=self.seen,
            cloud=self.cloud, mending=None if self.mender is None else self.mender.mending,
        )  # fmt: skip

    def _back_to(self, state: _State) -> None:
        self.trajectory, self.seen, self.cloud = state.trajectory, state.seen, state.cloud
        self.rounds, self.scans = list(state.rounds), list(state.scans)
        if self.mender is not None and state.mending is not None:
            self.mender.mending = state.mending

    def _local_views(self, holes: HoleReport, number: int) -> tuple[tuple[Viewpoint, ...], dict[str, float]]:
        """Viewpoints of a local round, and what each may cost [s]."""
        standoff = self.settings.process.standoff_m
        if self._literal:
            views = local_viewpoints(
                holes.holes, self.scanner, standoff=standoff, mode=self.options.mode, table_z=self.table_z
            )
            return views, {}
        assert self.cloud is not None
        measured = self.options.source == "scan"
        # The holes of a measured scan are what was asked for: none is left for its seconds.
        step, worth = self.search.step(
            self.cloud, holes.holes,
            rate=THOROUGH_RATE if measured else (_SOUGHT if self._tidies else 1.0) * self._rate,
            seconds=self._seconds_left(),
            reachable=self._reachable if self.options.reach_feedback else None,
            explain=measured,
            rng=self._rng(20 + number),
        )  # fmt: skip
        self.unscanned = step.unseen
        return step.viewpoints, worth

    @property
    def _rate(self) -> float:
        """Least share of the surface that a viewpoint adds per second [1/s]."""
        return THOROUGH_RATE if self.options.thorough else SelectOptions().least_rate

    @property
    def _literal(self) -> bool:
        """Whether local viewpoints come from the holes alone, without a model of what hides them."""
        return self.options.mode == "paper" or not self.options.occlusion_aware

    @property
    def _tidies(self) -> bool:
        return self.options.tidy and self.options.source == "mesh" and not self._literal

    def _seconds_left(self) -> float:
        """Of the budget, for the next round [s]; its order is not known, and the twin may take some out."""
        return (1.5 if self._tidies else 0.9) * max(-self._over(), 0.0)

    def _reachable(self, X_OS: np.ndarray) -> np.ndarray:
        """What the robot reaches without going far from its way."""
        stops = [q for item in self.rounds[:1] for stop in item.leg.tour.stops for q in stop.places]
        return reachable_mask(
            self.cell, X_OS, clearance=self.clearance,
            near_q=np.array([self.cell.home, *stops]), within_s=_SIDE_TRIP_S,
        )  # fmt: skip

    def run(
        self,
        views: tuple[Viewpoint, ...],
        step: str,
        rng: np.random.Generator,
        worth: dict[str, float] | None = None,
    ) -> None:
        """Plans a leg over `views`, appends it, and lets the twin scan along it.

        Args:
            views: what is to be visited.
            step: "global" or "local".
            rng: source of the leg's random numbers.
            worth: by id, what a viewpoint may cost at most [s].
        """
        with self.watch("motion"):
            leg: Leg = leg_from(
                self.cell, self.clearance, views, self.at,
                mode=self.options.mode, table=self.options.turntable, worth=worth, rng=rng,
                progress=self.progress,
            )  # fmt: skip
        scan = None
        if self.options.helix and step == "global" and leg.trajectory is not None:
            with self.watch("helix"):
                made = joined(self.cell, self.clearance, leg, self._simulated, rng)
            leg, scan, self.helix = made.leg, made.scan, made.record
        self.take(leg, step, rng, scan)
        given_up = {v for v, _ in leg.unreachable}
        self.search.tried([v.X_OS for v in views if v.id in given_up or v.kind == "station"])

    def take(self, leg: Leg, step: str, rng: np.random.Generator, scan: Scan | None = None) -> None:
        """Appends a leg that begins where the programme stands; unless it has, the twin scans along it."""
        if leg.trajectory is not None:
            before = self.trajectory
            self.trajectory = leg.trajectory if before is None else in_a_row(before, leg.trajectory)
            if self.options.source == "mesh":
                with self.watch("twin"):
                    self._look(self._simulated(leg.trajectory, rng) if scan is None else scan)
        self.rounds.append(Round(step=step, leg=leg, seen=self.seen.copy()))

    def _simulated(self, trajectory: Trajectory, rng: np.random.Generator) -> Scan:
        assert self.twin is not None
        return self.twin.scan(
            trajectory, known=self.seen, rng=rng, progress=lambda f: self.progress("twin", f)
        )  # fmt: skip

    def _look(self, scan: Scan) -> None:
        """Adds a scan to what is known."""
        if self.mender is not None:
            scan = self.mender.mended(scan, self.cloud, index=len(self.rounds))
        self.scans.append(scan)
        self.seen = self.seen | scan.seen
        images = depth_images(scan, self.scanner, stride=self.options.stride)
        self.search.look(scan.captures.X_OS, images)
        if len(scan):
            new = fuse([scan], voxel=self.options.voxel)
            self.cloud = new if self.cloud is None else merged(self.cloud, new, voxel=self.options.voxel)

    def _complete(self) -> bool:
        return self.completeness() >= self.options.goal

    def completeness(self) -> float:
        """Share of what can be seen that has been seen."""
        assert self.twin is not None
        with self.watch("visible"):
            return float(self.seen.sum() / max(self.twin.visible(self.seen).sum(), 1))

    def _explain(self) -> np.ndarray:
        """Finds out what stays unscanned and why; which samples can be seen, but not by this robot, (n,)."""
        assert self.twin is not None
        with self.watch("unscanned"):
            self.progress("unscanned", 0.0)
            self.unscanned, out_of_reach = self.twin.unscanned(
                self.seen, lambda X: reachable_mask(self.cell, X, clearance=self.clearance)
            )
        return out_of_reach

    def plan(self) -> Plan:
        """All that was found, in one value."""
        out_of_reach = None
        if self.twin is not None:
            out_of_reach = self._explain()
            if len(self.scans) > 1:
                with self.watch("twin"):
                    self.cloud = fuse(self.scans, voxel=self.options.voxel)
        return Plan(
            part=self.part, cell=self.cell, options=self.options, rounds=tuple(self.rounds),
            searched=self.searched,
            trajectory=self.trajectory, cloud=self.cloud, holes=self.holes,
            samples=None if self.twin is None else self.twin.samples,
            visible=None if self.twin is None else self.twin.visible(self.seen),
            out_of_reach=out_of_reach,
            dropped=tuple(self.dropped), unscanned=self.unscanned, planning_s=self.watch.seconds(),
            scans=tuple(self.scans) if self.options.keep_scans else (),
            mending=None if self.mender is None else self.mender.mending, helix=self.helix,
        )  # fmt: skip
