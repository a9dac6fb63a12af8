"""The summary of a plan: every figure of summary.json from the plan's own values and the judge's findings."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from scanmotion.cell.collision.last_word import LastWord
from scanmotion.core.errors import InputError
from scanmotion.core.finding import Finding
from scanmotion.core.summary import (
    AccuracySummary,
    BudgetSummary,
    CompletenessSummary,
    DrakeSummary,
    FormSummary,
    HelixSummary,
    LeftOut,
    MarginsSummary,
    PairSummary,
    PatchSummary,
    RoundSummary,
    Summary,
    TimeSummary,
    WithinReach,
)
from scanmotion.plan_io.scans.measured import (
    calibration_record,
    millimetres,
    registration_records,
    surface_record,
)
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import Segment
from scanmotion.planning.steps.helices import MOST_LOST, Joining
from scanmotion.planning.worth.budget import budget_record, coverage_of
from scanmotion.sensing.fusion.surface import surface

__all__ = ["summary_from", "surface_from"]


def summary_from(plan: Plan, findings: Sequence[Finding], margins: MarginsSummary | None = None) -> Summary:
    """What the plan achieves; docs/results.md says what each figure means.

    Args:
        plan: as it was made.
        findings: what the judge says of its files.
        margins: what the programme has to spare, where it was measured.
    """
    served = [v for item in plan.segments for v in item.served]
    told = {
        "viewpoints": {
            "global": sum(v.step == "global" for v in served),
            "local": sum(v.step == "local" for v in served),
            "unreachable": [LeftOut(id=name, reason=reason) for name, reason in plan.unreachable],
            "not_worth": [LeftOut(id=name, reason=reason) for name, reason in plan.not_worth],
            "solvers": plan.solvers,
        },
        "completeness": CompletenessSummary(**_rounded(plan.completeness())),
        "within_reach": WithinReach(**_rounded(plan.within_reach())),
        "rounds": [_round(plan, item) for item in plan.segments],
        "searched": [_round(plan, item) for item in plan.searched],
        "unscanned": [
            PatchSummary(
                center_mm=[round(float(x) * 1e3, 1) for x in p.center], area_mm2=round(p.area * 1e6, 1),
                reason=p.reason,
            )
            for p in plan.unscanned
        ],
        **({} if plan.confidence is None else {"confidence": plan.confidence.record()}),
        "accuracy": _accuracy(plan),
        "calibration": calibration_record(plan.corrections),
        "registration": registration_records(plan.corrections),
        "time_s": TimeSummary(**{k: round(v, 3) for k, v in plan.time_s().items()}),
        "budget": budget_from(plan),
        **({} if plan.joining is None else {"helix": _helix(plan.joining)}),
        **({"no_way_home": plan.no_way_home} if plan.no_way_home else {}),
        **({} if plan.motion is None else {"motion": dict(plan.motion)}),
        **({} if plan.last_word is None else {"drake": _drake(plan.last_word)}),
        **({} if plan.part.report is None else {"read": plan.part.report.record()}),
        **({} if margins is None else {"margins": margins}),
        **({"meta": dict(plan.meta)} if plan.meta else {}),
        "findings": [str(f) for f in findings],
        "planning_s": {k: round(v, 2) for k, v in plan.planning_s.items()},
    }  # fmt: skip
    return Summary.model_validate(told)


def surface_from(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """The surface reconstructed from the fused cloud: vertices (v, 3) [m] and triangles (t, 3).

    Raises:
        InputError: nothing was scanned, or too little.
    """
    if plan.cloud is None:
        raise InputError("nothing was scanned: there is no surface")
    return surface(plan.cloud)


def budget_from(plan: Plan) -> BudgetSummary:
    """The budget, what uses it up, and what a shorter programme would see."""
    stops = [stop for item in plan.segments for stop in item.tour.stops]
    whole, coverage = plan.completeness()["final"], None
    if plan.trajectory is not None and plan.samples is not None and whole is not None:
        assert plan.seen is not None
        coverage = coverage_of(plan.part, plan.cell, plan.trajectory, plan.samples, plan.seen, whole)
    return budget_record(plan.cell, plan.trajectory, stops, plan.time_s()["floor"], coverage)


def _accuracy(plan: Plan) -> AccuracySummary:
    """Of the fused cloud, and of the surface where the options ask for it."""
    told = millimetres(plan.accuracy())
    if not plan.options.surface or plan.samples is None or plan.seen is None:
        return AccuracySummary.model_validate(told)
    made = surface_record(surface_from(plan), plan.part, plan.samples.points[plan.seen])
    return AccuracySummary.model_validate({**told, "surface": made})


def _round(plan: Plan, item: Segment) -> RoundSummary:
    share = None
    if plan.visible is not None and len(item.seen) == len(plan.visible):
        share = round(float(item.seen.sum()) / max(int(plan.visible.sum()), 1), 6)
    return RoundSummary(step=item.step, viewpoints=len(item.served), completeness=share)


def _helix(joining: Joining) -> HelixSummary:
    return HelixSummary(
        taken=joining.taken, still_seconds=joining.still_seconds, most_lost=MOST_LOST,
        tried=[FormSummary(**asdict(form)) for form in joining.tried], note=joining.note,
    )  # fmt: skip


def _drake(word: LastWord) -> DrakeSummary:
    return DrakeSummary(
        checked=word.checked, way_m=round(word.way_m, 3), by_triangles=word.by_triangles,
        findings=len(word.findings),
        not_held=[PairSummary(a=pair.a, b=pair.b, reason=pair.reason) for pair in word.not_held],
    )  # fmt: skip


def _rounded(shares: dict[str, float | None]) -> dict[str, float | None]:
    return {k: None if v is None else round(v, 6) for k, v in shares.items()}
