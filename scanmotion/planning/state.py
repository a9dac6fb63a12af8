"""The state of a plan: a value that grows by whole segments, and in no other way.

Guarantees: `extend` leaves the state that it is given as it is; going back is keeping the old one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import JsonValue

from scanmotion.core.trajectory import Trajectory, joined
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.planning.context import Context, Simulator
from scanmotion.planning.evidence import Evidence, no_evidence
from scanmotion.planning.segment import Segment, segment_from
from scanmotion.planning.steps.helices import Joining, fastest_form
from scanmotion.sensing.corrections.corrected_scan import Corrections, corrected_scan
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.fusion.merge import merged
from scanmotion.sensing.holes.find import HoleReport
from scanmotion.sensing.simulator.images import depth_images
from scanmotion.sensing.simulator.simulate import Scan
from scanmotion.views.unscanned import Patch


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanState:
    """All that a segment adds to, and what the local step has found out on the way."""

    seen: np.ndarray
    """Which surface samples have been seen, shape (n,) bool; empty where nothing is simulated."""
    evidence: Evidence
    segments: tuple[Segment, ...] = ()
    trajectory: Trajectory | None = None
    """Of all segments; None where nothing could be planned yet."""
    scans: tuple[Scan, ...] = ()
    """What the simulator measured, as it is fused."""
    cloud: Cloud | None = None
    """The fused scan: simulated, or the measured one."""
    corrections: Corrections | None = None
    """None where scans are not corrected."""
    holes: HoleReport | None = None
    """Of the first scan; None before they were sought."""
    visible: np.ndarray | None = None
    """Which samples any allowed pose sees, shape (n,); None before it was asked for."""
    dropped: tuple[tuple[str, str], ...] = ()
    """Viewpoints of the method that are not planned: (id, reason)."""
    unscanned: tuple[Patch, ...] = ()
    """Patches of surface that the local step leaves open, each with its reason."""
    joining: Joining | None = None
    """What came of joining turns, where that was allowed."""
    motion: Mapping[str, JsonValue] | None = None
    """The continuous motion, as the summary tells it; None for stops."""
    searched: tuple[Segment, ...] = ()
    """The segments as they were found, where pruning has made others of them since."""

    @property
    def duration(self) -> float:
        """Of the programme so far [s]."""
        return 0.0 if self.trajectory is None else self.trajectory.duration

    def value(self, rate: float) -> float:
        """What has been seen, less what the seconds are worth at `rate` [1/s], as a share of the surface."""
        return float(self.seen.mean()) - rate * self.duration


def begin(ctx: Context) -> PlanState:
    """Nothing is planned yet; a measured scan stands in for the global step."""
    return PlanState(
        seen=np.zeros(0 if ctx.simulator is None else len(ctx.simulator.samples.points), bool),
        evidence=no_evidence(
            ctx.scanner, ctx.surroundings, spacing=ctx.spacing, stride=ctx.options.stride
        ),
        cloud=ctx.measured,
        corrections=Corrections() if ctx.corrects else None,
    )  # fmt: skip


def extend(
    ctx: Context,
    state: PlanState,
    views: Sequence[Viewpoint],
    *,
    step: str,
    rng: np.random.Generator,
    worth: Mapping[str, float] | None = None,
) -> PlanState:
    """Plans a segment over `views` from where the programme stands, and simulates the scan along it.

    Args:
        ctx: what planning reads.
        state: what there is; it stays as it is.
        views: what is to be visited.
        step: "global" or "local".
        rng: source of the segment's random numbers.
        worth: by id, what a viewpoint may cost at most [s].
    """
    at = ctx.cell.home if state.trajectory is None else state.trajectory.q[-1]
    with ctx.watch("motion"):
        segment = segment_from(
            ctx.cell, ctx.clearance, views, at,
            step=step, method=ctx.method, worth=worth, rng=rng, progress=ctx.progress,
        )  # fmt: skip
    scan = None
    if ctx.method.joins_turns and step == "global" and segment.trajectory is not None:
        with ctx.watch("helix"):
            form = fastest_form(
                ctx.cell, ctx.clearance, segment, lambda t, draws: _simulated(ctx, state, t, draws), rng
            )
        segment, scan, state = form.segment, form.scan, replace(state, joining=form.joining)
    left_out = {v for v, _ in segment.unreachable}
    tried = [v.X_OS for v in views if v.id in left_out or v.kind == "station"]
    grown = with_segment(ctx, state, segment, rng, scan)
    return replace(grown, evidence=grown.evidence.with_tried(tried))


def with_segment(
    ctx: Context, state: PlanState, segment: Segment, rng: np.random.Generator, scan: Scan | None = None
) -> PlanState:
    """The state with a segment that begins where the programme stands.

    Args:
        ctx: what planning reads.
        state: what there is; it stays as it is.
        segment: planned, or executed already.
        rng: of the simulated scan's noise.
        scan: along the segment, where it is known already.
    """
    new = segment.trajectory
    if new is not None:
        before = state.trajectory
        state = replace(state, trajectory=new if before is None else joined(before, new))
        if ctx.simulator is not None:
            with ctx.watch("simulator"):
                found = _simulated(ctx, state, new, rng) if scan is None else scan
                state = _with_scan(ctx, ctx.simulator, state, found)
    return replace(state, segments=(*state.segments, replace(segment, seen=state.seen)))


def visible_from(ctx: Context, state: PlanState) -> np.ndarray:
    """Which samples any allowed pose sees, shape (n,): what has been seen once can be."""
    assert ctx.simulator is not None
    known = ctx.simulator.visible(state.seen) if state.visible is None else state.visible
    return known | state.seen


def _simulated(ctx: Context, state: PlanState, trajectory: Trajectory, rng: np.random.Generator) -> Scan:
    assert ctx.simulator is not None
    return ctx.simulator.scan(
        trajectory, known=state.seen, rng=rng, progress=lambda f: ctx.progress("simulator", f)
    )  # fmt: skip


def _with_scan(ctx: Context, simulator: Simulator, state: PlanState, scan: Scan) -> PlanState:
    """The state with a scan added to what is known."""
    corrections, cloud, voxel = state.corrections, state.cloud, ctx.options.voxel
    if corrections is not None:
        scan, corrections = corrected_scan(
            scan, cloud, corrections, part=simulator.part, voxel=voxel, index=len(state.segments),
            latency=simulator.errors.latency_s != 0,
        )  # fmt: skip
    images = depth_images(scan, ctx.scanner, stride=ctx.options.stride)
    if len(scan):
        new = fuse([scan], voxel=voxel)
        cloud = new if cloud is None else merged(cloud, new, voxel=voxel)
    return replace(
        state, scans=(*state.scans, scan), seen=state.seen | scan.seen, cloud=cloud, corrections=corrections,
        evidence=state.evidence.with_frames(scan.captures.X_OS, images),
    )  # fmt: skip
