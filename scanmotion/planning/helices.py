"""Whether neighbouring revolutions become helices: what the twin sees decides, then the seconds."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.core.trajectory import Trajectory
from scanmotion.planning.segment import Leg, joined_leg
from scanmotion.sensing.simulator.simulate import Scan

OVERLAPS = (1.0, 0.5, 0.0)
"""Shares of the arm's ways that count for a viewpoint's whole turn; at 0 the arm stands for all of it."""
MOST_LOST = 0.001
"""Share of what still revolutions see that may be lost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Joining:
    """The leg that was taken, its scan, and what was compared."""

    leg: Leg
    scan: Scan
    record: dict[str, Any]
    """`helix` of the summary."""


def joined(
    cell: Cell,
    clearance: Clearance,
    leg: Leg,
    simulated: Callable[[Trajectory, np.random.Generator], Scan],
    rng: np.random.Generator,
) -> Joining:
    """The fastest of the leg and its joined forms of which the twin sees as much, but for `MOST_LOST`.

    Args:
        cell: the cell, with the part that is scanned.
        clearance: the collision checker of the cell.
        leg: every revolution by itself, with a trajectory.
        simulated: the twin's scan along a trajectory.
        rng: source of random numbers; each form draws the same.
    """

    def scanned(form: Leg) -> Scan:
        assert form.trajectory is not None
        return simulated(form.trajectory, deepcopy(rng))

    still = scanned(leg)
    made = [(share, joined_leg(cell, clearance, leg, share, rng=deepcopy(rng))) for share in OVERLAPS]
    forms = sorted(((share, form) for share, form in made if form), key=lambda form: _seconds(form[1]))
    tried: list[dict[str, Any]] = []
    for share, form in forms:
        scan = scanned(form)
        kept = int(scan.seen.sum()) / max(int(still.seen.sum()), 1)
        tried.append({"overlap": share, "seconds": _seconds(form), "seen": round(kept, 6)})
        if kept >= 1.0 - MOST_LOST:
            return Joining(leg=form, scan=scan, record=_record(leg, form, tried))
    return Joining(leg=leg, scan=still, record=_record(leg, None, tried))


def _seconds(leg: Leg) -> float:
    return 0.0 if leg.trajectory is None else round(leg.trajectory.duration, 3)


def _record(still: Leg, taken: Leg | None, tried: Sequence[dict[str, Any]]) -> dict[str, Any]:
    if taken is not None:
        turns = sum(len(s.viewpoints) for s in taken.tour.stops if s.kind == "helix")
        note = (
            f"{turns} turns joined: {_seconds(taken):.1f} s instead of {_seconds(still):.1f} s, and "
            f"{tried[-1]['seen']:.2%} of what is seen with the arm still"
        )
    elif tried:
        note = (
            f"turns stay apart, {_seconds(still):.1f} s: joined, at best {max(t['seen'] for t in tried):.2%} "
            f"of what they see would be seen, {1.0 - MOST_LOST:.1%} are asked for"
        )
    else:
        note = f"turns stay apart, {_seconds(still):.1f} s: joining them is not possible or not faster"
    return {
        "taken": taken is not None, "still_seconds": _seconds(still), "most_lost": MOST_LOST,
        "tried": list(tried), "note": note,
    }  # fmt: skip
