"""summary.json as a value: what a plan achieves. docs/results.md says what each figure means.

Read strictly, since pages and reports rely on it; further keys are left as they are.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue

Real = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Triple = Annotated[list[Real], Field(min_length=3, max_length=3)]
Count = Annotated[int, Field(ge=0, le=10**9)]


class Open(BaseModel):
    """A record that may hold keys that nobody here reads."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, populate_by_name=True)


NOT_WORTH = "not worth its seconds"
"""How the reason begins for which a viewpoint is left out that the robot could serve."""


class LeftOut(Open):
    """A viewpoint that no operation serves."""

    id: str
    reason: str


class ViewpointSummary(Open):
    """How many viewpoints are served, and what is left out."""

    global_: Count = Field(alias="global")
    local: Count
    unreachable: list[LeftOut]
    """What the robot cannot serve."""
    not_worth: list[LeftOut] = []
    """What it could serve, and what adds less than its seconds are worth."""
    solvers: dict[str, str] = {}
    """Which solver found the pose of each viewpoint that is served, by id."""

    @property
    def left_out(self) -> list[LeftOut]:
        """Every viewpoint that no operation serves."""
        return [*self.unreachable, *self.not_worth]


class CompletenessSummary(Open):
    """Shares after the global step and at the end, of what can be seen; and of the whole surface; 0..1."""

    after_global: Real | None
    final: Real | None
    final_of_whole: Real | None


class WithinReach(Open):
    """Of what can be seen, the share that this robot can see; of that, the share that is scanned; 0..1."""

    share: Real | None
    scanned: Real | None


class RoundSummary(Open):
    """A segment of the plan."""

    step: str
    viewpoints: Count
    completeness: Real | None


class PatchSummary(Open):
    """A patch of surface that stays unscanned."""

    center_mm: Triple
    area_mm2: Real
    reason: str


class DistanceSummary(Open):
    """Distances from the true surface [mm]."""

    mean_abs_mm: Real | None
    sd_signed_mm: Real | None
    mean_signed_mm: Real | None


class SurfaceSummary(DistanceSummary):
    """The reconstructed surface against the truth, and the truth against it."""

    triangles: Count
    from_truth: dict[str, Real] | None


class AccuracySummary(DistanceSummary):
    """Distances of the fused cloud, and of the surface where it was asked for."""

    surface: SurfaceSummary | None = None


class BeforeAfter(Open):
    """The first scan's cloud as it was measured, and as it is fused."""

    before: DistanceSummary
    after: DistanceSummary


class CalibrationSummary(Open):
    """What was estimated of the constant errors, in the keys of the cell's section `twin`."""

    applied: bool
    estimated: dict[str, list[Real] | Real]
    sd: dict[str, list[Real] | Real]
    undetermined: list[str]
    disagreement_mm: dict[str, Real]
    global_cloud: BeforeAfter
    statement: str


class RegistrationSummary(Open):
    """A later scan on the cloud so far."""

    round: Count
    rms_mm: Real
    fitness: Real
    uncertainty_mm: Real | None
    shift_mm: Real
    turn_deg: Real
    trusted: bool
    statement: str


class TimeSummary(Open):
    """Robot time in total, by kind of work, and its proven lower bound [s]."""

    total: Real
    arm: Real
    table: Real
    sweep: Real
    dwell: Real
    floor: Real
    cycle: Real = 0.0


class CostSummary(Open):
    """What a scanning operation costs and adds."""

    operation: Count
    kind: str
    viewpoints: list[str]
    seconds: Real
    of_which_way: Real
    completeness_lost_without: Real | None


class ByOrder(Open):
    """What a programme that ends with an operation has seen."""

    operation: Count = 0
    seconds: Real
    completeness: Real


class CurveSummary(Open):
    """What a programme without further stops takes and sees."""

    seconds: Real
    completeness: Real
    left_out: list[str] = []


class BudgetSummary(Open):
    """The budget, what uses it up, and what a shorter programme would see."""

    limit_s: Real
    ok: bool
    costliest: list[CostSummary] = []
    by_order: list[ByOrder] = []
    curve: list[CurveSummary] = []
    advice: list[str] = []


class FormSummary(Open):
    """A joined form of the global step that was tried."""

    overlap: Real
    seconds: Real
    seen: Real


class HelixSummary(Open):
    """What came of joining turns."""

    taken: bool
    still_seconds: Real = 0.0
    most_lost: Real = 0.0
    tried: list[FormSummary] = []
    note: str


class PairSummary(Open):
    """Two solids or links that are not held apart, and why."""

    a: str
    b: str
    reason: str


class DrakeSummary(Open):
    """How much of the motion Drake checked, and how."""

    checked: Count
    way_m: Real
    by_triangles: Count
    findings: Count
    not_held: list[PairSummary] = []
    """Every pair that Drake left out, by its own list."""


class ReadSummary(Open):
    """What was read from the part's file, and what was changed."""

    file: str
    format: str
    points: Count
    triangles: Count
    size_mm: Triple
    units: str
    units_from: str
    columns: list[str]
    bodies: Count
    specks: Count
    changes: list[str]
    warnings: list[str]


class ConfidenceSummary(Open):
    """How sure predicted coverage and accuracy are."""

    statement: str


class MotionSummary(Open):
    """What came of the continuous motion."""

    note: str
    curve: list[CurveSummary] = []


class Margin(Open):
    """The least distance of two solids and when; -0.001 mm where they touch."""

    mm: Real
    a: str
    b: str
    t_s: Real


class JointMargin(Open):
    """The joint that comes nearest to an end of its range, and when."""

    joint: str
    deg: Real
    t_s: Real


class Extreme(Open):
    """An extreme value, a speed in [m/s], and when."""

    value: Real
    t_s: Real


class FastestSummary(Open):
    """Greatest speeds [m/s] of the flange, the elbow and the scanner's optical centre."""

    flange: Extreme
    elbow: Extreme
    scanner: Extreme


class MarginsSummary(Open):
    """How much the programme has to spare, by the judge's kinematics and solids."""

    to_object: Margin | None
    """Between robot or tool and the part."""
    to_surroundings: Margin | None
    """Between robot or tool and all that stands around."""
    joint_limit: JointMargin | None
    singularity: Extreme
    """Least singular value of the flange's Jacobian, a metre weighed as a radian; 0 is singular."""
    fastest: FastestSummary


class Summary(Open):
    """summary.json."""

    viewpoints: ViewpointSummary
    completeness: CompletenessSummary
    within_reach: WithinReach = WithinReach(share=None, scanned=None)
    rounds: list[RoundSummary]
    searched: list[RoundSummary] = []
    unscanned: list[PatchSummary] = []
    confidence: ConfidenceSummary | None = None
    accuracy: AccuracySummary
    calibration: CalibrationSummary | None = None
    registration: list[RegistrationSummary] = []
    time_s: TimeSummary
    budget: BudgetSummary
    helix: HelixSummary | None = None
    no_way_home: str = ""
    motion: MotionSummary | None = None
    drake: DrakeSummary | None = None
    findings: list[str | dict[str, JsonValue]]
    planning_s: dict[str, Real]
    read: ReadSummary | None = None
    margins: MarginsSummary | None = None
    meta: dict[str, str] = {}
    """What the user noted: object number, operator, date, notes."""

    @property
    def passes(self) -> bool:
        """Whether the plan is inside its budget and the judge found nothing."""
        return self.budget.ok and not self.findings

    @property
    def finding_lines(self) -> list[str]:
        """Each finding as one line, whether it is a sentence or a record."""
        lines: list[str] = []
        for found in self.findings:
            if isinstance(found, dict):
                found = str(found.get("message") or ", ".join(f"{k} {v}" for k, v in found.items()))
            lines.append(found)
        return lines

    def document(self) -> dict[str, JsonValue]:
        """As it stands in the file: only what was told, plain numbers."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)
