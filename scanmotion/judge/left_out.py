"""Which pairs of solids the judge does not hold against one another, each with its reason.

Its own list, by its own rules: nothing of the planner is asked.
"""

from functools import partial
from itertools import combinations
from pathlib import Path

from scanmotion.judge.motion import UrdfArm, arm_of
from scanmotion.judge.solids import (
    PART,
    STILL,
    Meeting,
    Solid,
    meeting_solids,
    pair_key,
    pairs_of,
    rigid,
    solids_of,
)
from scanmotion.plan_io.read import read_plan
from scanmotion.plan_io.schema import PlanRecord


def not_judged(folder: str | Path) -> list[dict[str, str]]:
    """The pairs that `verify` leaves out of its clearances, by links and named solids.

    Args:
        folder: what `scanmotion plan` wrote.

    Returns:
        one {"a", "b", "reason"} for each pair of links, tool, part and surroundings.

    Raises:
        PlanFileError: the files cannot be read.
    """
    folder = Path(folder)
    record = read_plan(folder)
    arm = arm_of(folder, record)
    solids = solids_of(folder, record, arm)
    meeting = meeting_solids(solids, record, arm)
    judged = {frozenset((id(a), id(b))) for a, b, _ in pairs_of(solids, 1.0, arm.joined, meeting)}
    groups: dict[str, list[Solid]] = {}
    for solid in solids:
        groups.setdefault(_name(solid), []).append(solid)
    told = partial(_reason, record=record, arm=arm, meeting=meeting)
    out = []
    for one, other in combinations(groups, 2):
        both = [(a, b) for a in groups[one] for b in groups[other]]
        left = [(a, b) for a, b in both if frozenset((id(a), id(b))) not in judged]
        if len(left) == len(both):
            out.append({"a": one, "b": other, "reason": told(*left[0])})
            continue
        # Of two links that are held apart otherwise, single solids that meet by construction.
        out += [{"a": f"{one}: {a.name}", "b": f"{other}: {b.name}", "reason": told(a, b)} for a, b in left]
    return out


def _name(solid: Solid) -> str:
    if solid.group == 7:
        return "tool"
    return f"link {solid.carrier}" if solid.carrier else solid.name


def _reason(a: Solid, b: Solid, record: PlanRecord, arm: UrdfArm, meeting: Meeting) -> str:
    low, high = sorted((a, b), key=lambda solid: solid.group)
    if low.group < 0 and high.group <= 0:
        if PART in (a.group, b.group):
            return "the part stands on it"
        return "neither moves"
    if low.group == STILL:
        return "what the first joint turns stands on the floor"
    i, j = rigid(low), rigid(high)
    if i == j:
        return "fixed to one another"
    if frozenset((a.carrier, b.carrier)) in arm.joined:
        return f"joined by {record.robot_joints[i]}"
    return f"they meet in {meeting[pair_key(a, b)]:.0%} of the positions of the joints between them"
