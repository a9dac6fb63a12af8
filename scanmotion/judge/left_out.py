"""Which pairs of solids the judge does not hold against one another, each with its reason.

Its own list, by its own rules: nothing of the planner is asked.
"""

from itertools import combinations
from pathlib import Path

from scanmotion.judge.motion import arm_of
from scanmotion.judge.solids import PART, STILL, Solid, meeting_carriers, pairs_of, solids_of
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
    meeting = meeting_carriers(solids, record, arm)
    judged = {frozenset((_name(a), _name(b))) for a, b, _ in pairs_of(solids, 1.0, meeting)}
    first: dict[str, Solid] = {}
    for solid in solids:
        first.setdefault(_name(solid), solid)
    return [
        {"a": a, "b": b, "reason": _reason(first[a], first[b], record)}
        for a, b in combinations(first, 2)
        if frozenset((a, b)) not in judged
    ]


def _name(solid: Solid) -> str:
    if solid.group == 7:
        return "tool"
    return f"link {solid.carrier}" if solid.carrier else solid.name


def _reason(a: Solid, b: Solid, record: PlanRecord) -> str:
    low, high = sorted((a, b), key=lambda solid: solid.group)
    if low.group < 0 and high.group <= 0:
        if PART in (a.group, b.group):
            return "the part stands on it"
        return "neither moves"
    if low.group == STILL:
        return "what the first joint turns stands on the floor"
    i, j = min(low.group, 6), min(high.group, 6)
    if i == j:
        return "fixed to one another"
    if a.side or b.side:
        return "they meet in every position of the joints between them"
    if j - i == 1:
        return f"joined by {record.robot_joints[i]}"
    return "two joints apart: the model's solids meet where the robot's bodies do not"
