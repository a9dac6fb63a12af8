"""What each stage of planning lost, and why: for a plan that came out empty or poor.

Guarantee: every viewpoint that was proposed is counted once, as served or as lost at the stage that its
reason names.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from scanmotion.core.summary import NOT_WORTH
from scanmotion.planning.plan import Plan

_STAGES = (
    ("reach", ("out of reach", "joint limit", "collision", "singular", "no collision-free configuration")),
    ("order", ("the table's range",)),
    ("way there", ("no collision-free way",)),
    ("worth", (NOT_WORTH,)),
    ("budget", ("no seconds are left",)),
)
"""Stages after the candidates, in their order, and how the reasons begin that they give."""
_CANDIDATES = "candidates"


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """One stage of planning."""

    name: str
    given: int
    """Viewpoints that came in."""
    lost: int
    """Those that it left out."""
    causes: tuple[tuple[str, int, str], ...]
    """(cause, how many, one viewpoint with its whole reason), the commonest first."""
    note: str = ""


def explained(plan: Plan) -> tuple[Stage, ...]:
    """The stages of a plan with what each has lost, and at last what is served and what stays unscanned.

    Args:
        plan: made, not loaded: a loaded one no longer knows which viewpoints were dropped where.
    """
    known = dict.fromkeys((*(v.id for v in plan.viewpoints), *(name for name, _ in plan.dropped)))
    reasons = dict(plan.left_out)
    by_stage: dict[str, list[tuple[str, str]]] = {}
    for name, reason in reasons.items():
        by_stage.setdefault(losing_stage(reason), []).append((name, reason))
    out: list[Stage] = []
    count = len(known)
    for name in (_CANDIDATES, *(stage for stage, _ in _STAGES)):
        lost = by_stage.get(name, [])
        out.append(
            Stage(name=name, given=count, lost=len(lost), causes=_causes(lost), note=_note(plan, name))
        )
        count -= len(lost)
    patches = Counter(patch.reason for patch in plan.unscanned)
    left = tuple((reason, number, "") for reason, number in patches.most_common())
    out.append(Stage(name="served", given=count, lost=0, causes=left, note=_seen(plan)))
    return tuple(out)


def losing_stage(reason: str) -> str:
    """The stage that gave a reason; what no stage gives is of the candidates' choice."""
    for stage, beginnings in _STAGES:
        if reason.startswith(beginnings):
            return stage
    return _CANDIDATES


def _causes(lost: Sequence[tuple[str, str]]) -> tuple[tuple[str, int, str], ...]:
    found: dict[str, list[tuple[str, str]]] = {}
    for name, reason in lost:
        cause = reason.partition(": ")[0] if ": " in reason[:60] else reason
        found.setdefault(cause, []).append((name, reason))
    ranked = sorted(found.items(), key=lambda item: -len(item[1]))
    return tuple((cause, len(rows), f"{rows[0][0]}: {rows[0][1]}") for cause, rows in ranked)


def _note(plan: Plan, stage: str) -> str:
    """What else is known of a stage."""
    if stage == _CANDIDATES:
        steps = Counter(v.step for v in plan.viewpoints)
        parts = [f"{number} of the {step} step" for step, number in steps.items()]
        if plan.holes is not None:
            parts.append(f"{len(plan.holes.holes)} holes after the global step")
        return ", ".join(parts)
    if stage == "reach":
        solvers = Counter(s for s in plan.solvers.values() if s)
        return ", ".join(f"{number} by {solver}" for solver, number in solvers.most_common())
    if stage == "budget":
        limit = plan.cell.settings.process.budget_s
        return f"{plan.time_s()['total']:.1f} of {limit:g} s are used"
    return ""


def _seen(plan: Plan) -> str:
    share = plan.completeness()["final"]
    return "" if share is None else f"{share:.2%} of what can be seen"
