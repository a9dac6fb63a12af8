"""The budget: what each stop of a programme costs and adds, and what a shorter programme would still see."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.summary import BudgetSummary, ByOrder, CostSummary, CurveSummary
from scanmotion.core.tour import Stop, Tour
from scanmotion.core.trajectory import Trajectory
from scanmotion.motion.order.completeness_curve import CurvePoint, completeness_curve
from scanmotion.motion.order.sequence import tour_seconds
from scanmotion.motion.transit_cost import MoveModel, move_model
from scanmotion.planning.steps.prune import stop_masks
from scanmotion.sensing.visibility import scene_from

__all__ = ["Coverage", "budget_record", "coverage_of"]

COSTLIEST = 5
_SAMPLES = 12_000
"""Surface samples by which stops are weighed."""
_TURN_FRAMES = 30
"""Frames of one operation by which it is weighed."""
_FASTER = (0.12, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
"""Transit speeds that are tried in advice [m/s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Coverage:
    """What each scanning operation sees by itself, of a part of what the whole programme sees."""

    masks: tuple[np.ndarray, ...]
    """For each scanning operation in order, shape (m,) bool each; together they see every sample."""
    whole: float
    """Completeness of the whole programme, of what can be seen, 0..1."""

    def share(self, operations: Sequence[int]) -> float:
        """Completeness of some scanning operations alone."""
        if not len(operations) or not len(self.masks[0]):
            return 0.0
        return self.whole * float(np.any([self.masks[n] for n in operations], axis=0).mean())


def coverage_of(
    part: Part, cell: Cell, trajectory: Trajectory, samples: SurfaceSamples, seen: np.ndarray, whole: float
) -> Coverage:
    """What each scanning operation sees, by nominal poses and some of the samples and frames.

    Args:
        part: the true surface.
        cell: scanner, table and frame rate.
        trajectory: the programme.
        samples: of the surface.
        seen: which of them the whole programme sees, shape (n,) bool.
        whole: its completeness.
    """
    few = np.flatnonzero(seen)
    few = few[:: max(1, len(few) // _SAMPLES)]
    settings = cell.settings
    scene = scene_from(
        part.vertices, part.triangles, table_radius=settings.turntable.diameter_m / 2,
        table_z=-settings.pedestal.height_m, pedestal_radius=settings.pedestal.diameter_m / 2,
    )  # fmt: skip
    masks = stop_masks(cell, trajectory, scene, samples, few, most=_TURN_FRAMES)
    # Samples that only frames between those looked at see count for no stop.
    known = np.any(masks, axis=0) if masks else np.zeros(len(few), bool)
    return Coverage(masks=tuple(m[known] for m in masks), whole=whole)


def budget_record(
    cell: Cell, trajectory: Trajectory | None, stops: Sequence[Stop], floor: float, coverage: Coverage | None
) -> BudgetSummary:
    """The `budget` of summary.json: limit, costliest stops, curves of completeness, and advice.

    Args:
        cell: the budget and the limits.
        trajectory: the programme; None where nothing could be planned.
        stops: its stops in order, one for each scanning operation.
        floor: proven lower bound of its duration [s].
        coverage: what each stop sees; None where no twin scans.
    """
    limit = float(cell.settings.process.budget_s)
    total = 0.0 if trajectory is None else trajectory.duration
    costs = _costs(trajectory, coverage)
    record = BudgetSummary(
        limit_s=limit, ok=bool(total <= limit), by_order=_by_order(trajectory, coverage), curve=[], advice=[],
        costliest=sorted(costs, key=lambda c: -c.seconds)[:COSTLIEST],
    )  # fmt: skip
    if trajectory is None or not stops:
        return record
    model = move_model(cell)
    tour = Tour(start_q=trajectory.q[0], stops=tuple(stops), seconds=total, floor=floor)
    curve = _curve(model, tour, coverage)
    advice = [] if record.ok else _advice(model, tour, curve, limit, floor)
    return record.model_copy(update={"curve": _curve_summary(curve), "advice": advice})


def _curve_summary(curve: Sequence[CurvePoint]) -> list[CurveSummary]:
    """Each point with what it leaves out beyond the one before."""
    before = 0
    found: list[CurveSummary] = []
    for point in curve:
        found.append(
            CurveSummary(
                seconds=round(point.seconds, 2), completeness=round(point.completeness, 6),
                left_out=list(point.dropped[before:]),
            )
        )  # fmt: skip
        before = len(point.dropped)
    return found


def _costs(trajectory: Trajectory | None, coverage: Coverage | None) -> list[CostSummary]:
    """Each scanning operation with the seconds of the way there and its own, and what is lost without it."""
    found: list[CostSummary] = []
    scanning = 0 if trajectory is None else sum(o.scanning for o in trajectory.operations)
    way = 0.0
    for o in trajectory.operations if trajectory is not None else ():
        if not o.scanning:
            way += o.t_end - o.t_start
            continue
        lost = None
        if coverage is not None:
            others = coverage.share([k for k in range(scanning) if k != len(found)])
            lost = round(coverage.whole - others, 6)
        found.append(
            CostSummary(
                operation=o.index, kind=o.kind, viewpoints=list(o.viewpoints),
                seconds=round(way + o.t_end - o.t_start, 3), of_which_way=round(way, 3),
                completeness_lost_without=lost,
            )
        )  # fmt: skip
        way = 0.0
    return found


def _by_order(trajectory: Trajectory | None, coverage: Coverage | None) -> list[ByOrder]:
    """Completeness when each scanning operation ends: what a programme that stops there has seen."""
    if trajectory is None or coverage is None:
        return []
    scanning = [o for o in trajectory.operations if o.scanning]
    return [
        ByOrder(
            operation=o.index, seconds=round(o.t_end, 2),
            completeness=round(coverage.share(range(n + 1)), 6),
        )
        for n, o in enumerate(scanning)
    ]  # fmt: skip


def _curve(model: MoveModel, tour: Tour, coverage: Coverage | None) -> tuple[CurvePoint, ...]:
    """Completeness by leaving out the least worthy stops first; none where nothing tells their worth."""
    if coverage is None:
        return ()
    seen = {v: m for stop, m in zip(tour.stops, coverage.masks, strict=True) for v in stop.viewpoints}
    expected = tour_seconds(model, tour.start_q, tour.stops)
    points = completeness_curve(seen, replace(tour, seconds=expected), model=model)
    slower = tour.seconds / max(expected, 1e-9)
    return tuple(
        replace(p, seconds=p.seconds * slower, completeness=p.completeness * coverage.whole) for p in points
    )


def _advice(
    model: MoveModel, tour: Tour, curve: Sequence[CurvePoint], limit: float, floor: float
) -> list[str]:
    """What would bring the programme inside its budget, one sentence each."""
    said: list[str] = []
    if floor > limit:
        said.append(f"no order of these viewpoints takes less than {floor:.1f} s: fewer or faster is needed")
    fits = next((p for p in curve if p.seconds <= limit), None)
    if fits is not None and fits.completeness > 0.0:
        said.append(
            f"without {', '.join(fits.dropped)} it takes about {fits.seconds:.1f} s and sees "
            f"{fits.completeness:.2%} of what can be seen instead of {curve[0].completeness:.2%}"
        )
    now = tour_seconds(model, tour.start_q, tour.stops)
    for speed in _FASTER:
        if speed <= model.transit_speed:
            continue
        faster = replace(model, transit_speed=speed)
        seconds = tour.seconds - now + tour_seconds(faster, tour.start_q, tour.stops)
        if seconds <= limit:
            said.append(
                f"with process.transit_speed_m_s {speed:g} for {model.transit_speed:g} it takes about "
                f"{seconds:.1f} s, if the scanner may move so fast between its views"
            )
            break
    if len(said) == (floor > limit):
        said.append(f"nothing that was tried brings it under {limit:g} s; {tour.seconds:.1f} s are needed")
    return said
