"""Whether neighbouring revolutions become helices: what the simulator sees decides, then the seconds.

Guarantees: all but `MOST_LOST` of what still revolutions see is seen, in less time. Assumes that the noise of
a simulated scan hides no more than that.
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.core.errors import PathError
from scanmotion.core.trajectory import Trajectory
from scanmotion.motion.order.helix_choice import joined_stops
from scanmotion.motion.order.lower_bound import floor_seconds
from scanmotion.motion.order.sequence import tour_seconds
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit.plan import transits
from scanmotion.motion.transit_cost import move_model
from scanmotion.planning.segment import Segment
from scanmotion.sensing.simulator.simulate import Scan

OVERLAPS = (1.0, 0.5, 0.0)
"""Shares of the arm's ways that count for a viewpoint's whole turn; at 0 the arm stands for all of it."""
MOST_LOST = 0.001
"""Share of what still revolutions see that may be lost."""


@dataclass(frozen=True, kw_only=True)
class TriedForm:
    """A joined form of a segment, and what the simulator says of it."""

    overlap: float
    """Share of the arm's ways that counts for a viewpoint's whole turn, 0..1."""
    seconds: float
    seen: float
    """Of what is seen with the arm still."""


@dataclass(frozen=True, kw_only=True)
class Joining:
    """What came of joining turns."""

    taken: bool
    still_seconds: float
    """Duration with every revolution by itself [s]."""
    tried: tuple[TriedForm, ...]
    """Fastest first; the last one is taken, if any is."""
    note: str
    """The same in words."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FastestForm:
    """The segment that is taken, its scan, and what was compared."""

    segment: Segment
    scan: Scan
    joining: Joining


def fastest_form(
    cell: Cell,
    clearance: Clearance,
    segment: Segment,
    simulated: Callable[[Trajectory, np.random.Generator], Scan],
    rng: np.random.Generator,
) -> FastestForm:
    """The fastest of the segment and its joined forms of which as much is seen, but for `MOST_LOST`.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: the collision checker of the cell.
        segment: every revolution by itself, with a trajectory.
        simulated: the scan along a trajectory.
        rng: source of random numbers; each form draws the same.
    """

    def scanned(form: Segment) -> Scan:
        assert form.trajectory is not None
        return simulated(form.trajectory, deepcopy(rng))

    still = scanned(segment)
    made = [(share, joined_segment(cell, clearance, segment, share, rng=deepcopy(rng))) for share in OVERLAPS]
    forms = sorted(((share, form) for share, form in made if form), key=lambda form: _seconds(form[1]))
    tried: list[TriedForm] = []
    for share, form in forms:
        scan = scanned(form)
        kept = int(scan.seen.sum()) / max(int(still.seen.sum()), 1)
        tried.append(TriedForm(overlap=share, seconds=_seconds(form), seen=round(kept, 6)))
        if kept >= 1.0 - MOST_LOST:
            return FastestForm(segment=form, scan=scan, joining=_joining(segment, form, tried))
    return FastestForm(segment=segment, scan=still, joining=_joining(segment, None, tried))


def joined_segment(
    cell: Cell, clearance: Clearance, segment: Segment, overlap: float, *, rng: np.random.Generator
) -> Segment | None:
    """The segment with neighbouring revolutions joined to helices; None if that cannot be, or saves nothing.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: the collision checker of the cell.
        segment: what was planned with every revolution by itself; a viewpoint stands in one stop only.
        overlap: share of the arm's ways that counts for the whole turn of each viewpoint, 0..1.
        rng: source of the planner's random numbers.
    """
    if segment.trajectory is None:
        return None
    seconds: list[float] = []
    way = 0.0
    for o in segment.trajectory.operations:
        if o.scanning:
            seconds.append(way)
        way = 0.0 if o.scanning else o.t_end - o.t_start
    start = segment.tour.start_q
    stops = joined_stops(cell, clearance, start, segment.tour.stops, seconds, overlap)
    if all(stop.kind != "helix" for stop in stops):
        return None
    model, views = move_model(cell), {r.viewpoint.id: r.viewpoint for r in segment.reaches}
    tour = replace(
        segment.tour, stops=stops, seconds=tour_seconds(model, start, stops),
        floor=floor_seconds(cell, model, start, stops, views),
    )  # fmt: skip
    try:
        paths = tuple(transits(cell, clearance, tour, rng=rng))
    except PathError:
        return None
    made = replace(segment, tour=tour, paths=paths, trajectory=time_plan(cell, tour, paths))
    assert made.trajectory is not None
    return made if made.trajectory.duration < segment.trajectory.duration else None


def _seconds(segment: Segment) -> float:
    return 0.0 if segment.trajectory is None else round(segment.trajectory.duration, 3)


def _joining(still: Segment, taken: Segment | None, tried: Sequence[TriedForm]) -> Joining:
    if taken is not None:
        turns = sum(len(s.viewpoints) for s in taken.tour.stops if s.kind == "helix")
        note = (
            f"{turns} turns joined: {_seconds(taken):.1f} s instead of {_seconds(still):.1f} s, and "
            f"{tried[-1].seen:.2%} of what is seen with the arm still"
        )
    elif tried:
        note = (
            f"turns stay apart, {_seconds(still):.1f} s: joined, at best {max(t.seen for t in tried):.2%} "
            f"of what they see would be seen, {1.0 - MOST_LOST:.1%} are asked for"
        )
    else:
        note = f"turns stay apart, {_seconds(still):.1f} s: joining them is not possible or not faster"
    return Joining(taken=taken is not None, still_seconds=_seconds(still), tried=tuple(tried), note=note)
