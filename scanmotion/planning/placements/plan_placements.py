"""Several placements of a part: what one leaves unseen, the next shows.

Guarantees: each placement is an ordinary plan of the part as it rests there, and knows what the placements
before it have seen; completeness is counted on one set of surface samples; what a later placement shows
as well is left out of the first. Assumes that the part is a mesh and that each placement is found by
registration; the operator's handling is not in the seconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.parts.resting import RestingPose, resting_poses, turned_part
from scanmotion.motion.reach.find import reachable_mask
from scanmotion.planning.context import Context, context_from
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.pipeline import global_step, plan_from
from scanmotion.planning.placements.placed import Placed, without_needless
from scanmotion.planning.placements.placing_trial import PlacingTrial, known_cloud, placing_trial
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import Progress, silent
from scanmotion.planning.state import PlanState, begin, extend
from scanmotion.planning.steps.local_rounds import local_rounds
from scanmotion.planning.steps.prune import prune
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.visibility import scene_from, visible
from scanmotion.views.next_best_views import SelectOptions, views_of_surface
from scanmotion.views.targets import Targets

_TARGETS = 6000
"""Open samples by which viewpoints of a further placement are chosen."""
_TRIALS = 3000
"""Samples by which resting poses are compared."""
_ROUNDS = 2
"""Choices of viewpoints in a further placement: what the first misses is sought again."""
_NEAR_RAD = np.deg2rad(25.0)
"""A direction that is asked to be up is met by a resting pose within this [rad]."""
_WORTH = 0.002
"""A further placement must show this share of the ceiling that nothing else has shown."""


@dataclass(frozen=True, kw_only=True)
class PlacementOptions:
    """How placements are chosen."""

    most: int = 2
    """Placements at most."""
    least_tip_deg: float = 5.0
    """Poses that tip at less are not used."""
    ups: tuple[tuple[float, float, float], ...] = ()
    """Directions of the part that are up in the further placements, in their order; none: they are chosen."""
    forbid: tuple[tuple[float, float, float], ...] = ()
    """Directions of the part, as it is given, that must not point down within 45 deg: a fragile side."""
    stop_rad_s2: float = 10.0
    """Angular acceleration of an emergency stop of the table, for warnings."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Placement:
    """One placement and its programme."""

    name: str
    resting: RestingPose
    X_KO: np.ndarray
    """From the part as it is given to this placement, shape (4, 4)."""
    plan: Plan
    added: float
    """Share of the ceiling that this placement sees first."""
    warnings: tuple[str, ...]
    trial: PlacingTrial | None
    """How the twin's operator placed the part and how the pose was found; None for the first placement."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacedPlan:
    """Programmes of all placements, in their order."""

    part: Part
    placements: tuple[Placement, ...]
    of_whole: float
    """Share of the whole surface that is seen."""
    ceiling: float
    """Share of the whole surface that a floating part would show."""
    of_ceiling: float
    seconds: float
    """Robot time of all placements; handling is not in it."""
    reason: str
    """Why there is no further placement."""


def plan_placements(
    part: Part,
    settings: CellSettings,
    *,
    options: PlanOptions | None = None,
    placing: PlacementOptions | None = None,
    progress: Progress = silent,
) -> PlacedPlan:
    """Plans the part as it is given, then as it rests otherwise, until nothing worth a turn is left.

    Args:
        part: a mesh.
        settings: the cell.
        options: of each plan.
        placing: how placements are chosen.
        progress: told the stage and the share done.

    Raises:
        PartError: not a mesh, or it does not fit the table as it is given.
        InputError: options that one placement alone can follow.
    """
    options, placing = options or PlanOptions(), placing or PlacementOptions()
    if options.source != "mesh" or options.motion != "stops":
        raise InputError("several placements are planned for a mesh (--part), with --motion stops")
    ctx = context_from(part, settings, options, progress)
    assert ctx.simulator is not None
    ceiling = _floating(part, ctx, ctx.simulator.samples)
    poses = _allowed(resting_poses(part, least_tip_rad=np.deg2rad(placing.least_tip_deg)), placing)
    asked = [_asked(part, poses, up) for up in placing.ups]
    done = [_first(ctx, _resting_as_given(part, poses))]
    reason = f"at most {placing.most} placements were asked for"
    while len(done) < placing.most:
        left = asked[len(done) - 1 : len(done)] if asked else poses
        best, reason = _next_pose(ctx, left, [d.pose for d in done], done[-1].state.seen, ceiling)
        if best is None:
            break
        found = _further(ctx, best, done[-1].state.seen, ceiling)
        if found is None:
            reason = f"{best.name}: the robot sees nothing new there that is worth its seconds"
            break
        done.append(found)
        reason = f"at most {placing.most} placements were asked for"
    return _result(part, without_needless(done), ceiling, placing, reason)


def _result(
    part: Part, done: Sequence[Placed], ceiling: np.ndarray, placing: PlacementOptions, reason: str
) -> PlacedPlan:
    seen = done[-1].state.seen
    could = ceiling | seen
    placements: list[Placement] = []
    before = np.zeros(len(seen), bool)
    clouds: list[tuple[Cloud, np.ndarray]] = []
    for number, item in enumerate(done, 1):
        placements.append(
            Placement(
                name=f"placement-{number}",
                resting=item.pose,
                X_KO=item.X_KO,
                plan=plan_from(item.ctx, item.state),
                added=float((item.state.seen & ~before).sum() / max(int(could.sum()), 1)),
                warnings=_warnings(item.pose, placing),
                trial=_trial(item, clouds, number),
            )
        )
        before = item.state.seen
        if item.state.cloud is not None:
            clouds.append((item.state.cloud, item.X_KO))
    return PlacedPlan(
        part=part,
        placements=tuple(placements),
        of_whole=float(seen.mean()),
        ceiling=float(could.mean()),
        of_ceiling=float(seen.sum() / max(int(could.sum()), 1)),
        seconds=float(sum(item.state.duration for item in done)),
        reason=reason,
    )


def _trial(item: Placed, clouds: list[tuple[Cloud, np.ndarray]], number: int) -> PlacingTrial | None:
    """How well a further placement is found again where the operator puts it a little wrong."""
    if not clouds:
        return None
    rng = item.ctx.rng("placing_trial", number)
    return placing_trial(item.ctx, known_cloud(clouds, item.X_KO), rng)


def _floating(part: Part, ctx: Context, samples: SurfaceSamples) -> np.ndarray:
    """Which samples a part that floats would show, shape (n,): the ceiling of all placements."""
    scene = scene_from(part.vertices, part.triangles)
    return visible(scene, ctx.scanner, samples.points, samples.normals)


def _allowed(poses: Sequence[RestingPose], placing: PlacementOptions) -> list[RestingPose]:
    """Poses in which no forbidden direction points down."""
    down = [np.asarray(d, float) / np.linalg.norm(d) for d in placing.forbid]
    return [p for p in poses if all(-(p.up @ d) < np.cos(np.pi / 4) for d in down)]


def _asked(part: Part, poses: Sequence[RestingPose], up: tuple[float, float, float]) -> RestingPose:
    """The resting pose with a direction up.

    Raises:
        InputError: the part does not rest so; the directions in which it does are named.
    """
    near = [p for p in poses if p.up @ np.asarray(up) > np.cos(_NEAR_RAD)]
    if not near:
        known = "; ".join(p.name for p in poses) or "none"
        raise InputError(f"{part.name} does not rest with {up} up; resting poses: {known}")
    return max(near, key=lambda p: float(p.up @ np.asarray(up)))


def _resting_as_given(part: Part, poses: Sequence[RestingPose]) -> RestingPose:
    """The pose in which the part is given; where it does not rest so by itself, one that says so."""
    for pose in poses:
        if np.allclose(pose.R_OP, np.eye(3)):
            return pose
    mass = part.bounds.mean(axis=0)
    return RestingPose(
        name="as given, held", R_OP=np.eye(3), tip_rad=0.0, com_m=mass, support_m=np.zeros((0, 2)), even=False
    )


def _first(ctx: Context, pose: RestingPose) -> Placed:
    """The part as it is given, planned as ever."""
    whole = global_step(ctx, begin(ctx))
    state = whole
    if ctx.method.takes_local_step and state.cloud is not None:
        state = prune(ctx, before=state, after=local_rounds(ctx, state))
    return Placed(ctx=ctx, pose=pose, X_KO=np.eye(4), state=state, after_global=whole)


def _next_pose(
    ctx: Context,
    poses: Sequence[RestingPose],
    used: Sequence[RestingPose],
    seen: np.ndarray,
    ceiling: np.ndarray,
) -> tuple[RestingPose | None, str]:
    """The pose that shows most of what is open; None with the reason where none is worth it."""
    left = [p for p in poses if all(p is not u for u in used)]
    if not left:
        return None, "it has no other stable resting pose; a cradle or foam would be needed"
    assert ctx.simulator is not None
    open_ = np.flatnonzero(ceiling & ~seen)
    if len(open_) < _WORTH * max(int(ceiling.sum()), 1):
        return None, "less is left than a further placement is worth"
    some = open_[:: max(1, len(open_) // _TRIALS)]
    samples = ctx.simulator.samples
    shown = [_shows(ctx, pose, samples.points[some], samples.normals[some]) for pose in left]
    best = int(np.argmax(shown))
    share = shown[best] * len(open_) / max(int(ceiling.sum()), 1)
    if share < _WORTH:
        return None, f"no other resting pose shows more than {share:.2%} of what is left open"
    return left[best], ""


def _shows(ctx: Context, pose: RestingPose, points: np.ndarray, normals: np.ndarray) -> float:
    """Share of points that some allowed pose of the scanner sees in a placement; 0 where it does not fit."""
    turned, X_KO = turned_part(ctx.part, pose.R_OP)
    table = ctx.settings.turntable
    if turned.radius > table.diameter_m / 2 or turned.extent[2] > ctx.settings.process.max_height_m:
        return 0.0
    scene = scene_from(
        turned.vertices,
        turned.triangles,
        table_radius=ctx.surroundings.table.radius,
        table_z=ctx.surroundings.table.z,
        pedestal_radius=ctx.surroundings.table.pedestal_radius,
    )
    R, p = X_KO[:3, :3], X_KO[:3, 3]
    return float(visible(scene, ctx.scanner, points @ R.T + p, normals @ R.T).mean())


def _further(first: Context, pose: RestingPose, seen: np.ndarray, ceiling: np.ndarray) -> Placed | None:
    """A further placement: viewpoints for what is open, chosen on the known surface; None if none pays."""
    turned, X_KO = turned_part(first.part, pose.R_OP)
    ctx = context_from(turned, first.settings, first.options, first.progress)
    assert ctx.simulator is not None and first.simulator is not None
    here = _moved(first.simulator.samples, X_KO)
    ctx = replace(ctx, simulator=replace(ctx.simulator, samples=here))
    begun = state = replace(begin(ctx), seen=seen)
    for again in range(_ROUNDS):
        views = _views(ctx, state, ceiling, again)
        if not views:
            break
        state = extend(ctx, state, views, step="global", rng=ctx.rng("placement_again", again))
    if state.trajectory is None:
        return None
    return Placed(ctx=ctx, pose=pose, X_KO=X_KO, state=state, after_global=begun)


def _moved(samples: SurfaceSamples, X_KO: np.ndarray) -> SurfaceSamples:
    R, p = X_KO[:3, :3], X_KO[:3, 3]
    return SurfaceSamples(points=samples.points @ R.T + p, normals=samples.normals @ R.T, area=samples.area)


def _views(ctx: Context, state: PlanState, ceiling: np.ndarray, again: int) -> tuple[Viewpoint, ...]:
    """Viewpoints by gain per second for the samples that are still open."""
    assert ctx.simulator is not None
    s = ctx.simulator.samples
    open_ = np.flatnonzero(ceiling & ~state.seen)
    some = open_[:: max(1, len(open_) // _TARGETS)]
    targets = Targets(
        points=s.points[some],
        normals=s.normals[some],
        areas=np.full(len(some), s.area * len(open_) / max(len(some), 1)),
    )
    views = views_of_surface(
        ctx.simulator.scene,
        ctx.scanner,
        targets,
        solid=ctx.part.vertices,
        table=ctx.surroundings.table,
        costs=ctx.surroundings.costs,
        reachable=lambda X_OS: reachable_mask(ctx.cell, X_OS, clearance=ctx.clearance),
        whole=s.area * len(s.points),
        seconds=max(ctx.budget_s - state.duration, 0.0),
        options=SelectOptions(least_rate=ctx.method.least_rate),
    )
    names = {v.id: f"{'R2' if again else ''}{v.id}" for v in views}
    return tuple(replace(v, id=names[v.id], step="global") for v in views)


def _warnings(pose: RestingPose, placing: PlacementOptions) -> tuple[str, ...]:
    """What the operator must be told of a pose before the table turns."""
    said: list[str] = []
    if len(pose.support_m) == 0:
        said.append("the part does not rest so by itself: it must be held")
        return tuple(said)
    tip, margin = np.degrees(pose.tip_rad), pose.margin(placing.stop_rad_s2)
    if tip < 10.0:
        said.append(f"it tips at {tip:.1f} deg")
    if margin < 3.0:
        said.append(
            f"an emergency stop of {placing.stop_rad_s2:g} rad/s2 reaches 1/{margin:.1f} of what tips it"
        )
    if not pose.even:
        said.append("the mesh is open: its centre of mass is a guess")
    return tuple(said)
