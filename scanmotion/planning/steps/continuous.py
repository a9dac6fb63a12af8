"""The programme as one continuous motion: arm and table move at once, the scanner captures all the time.

Guarantee: the motion keeps every limit and clearance, and what it sees is counted with true rays at the
frames that it takes. Assumption: the surface is known, as it is where the twin scans a mesh.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import JsonValue

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.threads import allowed_threads
from scanmotion.core.tour import Path, Stop, Tour
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Slack, Viewpoint
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.motion.continuous.choose import Continuous, ContinuousSearch, numbered_views
from scanmotion.motion.continuous.options import ContinuousOptions
from scanmotion.motion.order.lower_bound import floor_seconds
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit_cost import move_model
from scanmotion.planning.context import Context
from scanmotion.planning.segment import Segment, served_at
from scanmotion.planning.state import PlanState, with_segment
from scanmotion.sensing.visibility import Scene, seen_by_any
from scanmotion.views.turn_poses import turn_poses

NO_MOTION = {
    "kind": "stops", "note": "no continuous motion can be driven past this part in this cell: stops instead",
}  # fmt: skip
_STEPS = 4
"""So often the price of surface is changed to come to a completeness or a budget."""
_FACTOR = 2.5
"""By which the price is changed each time."""
_SHORT_OF_BUDGET = 0.93
"""A programme that takes this share of the budget is not sought longer."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Wanted:
    """What a continuous motion is to come to."""

    completeness: float | None = None
    """Share of what can be seen, in the least seconds; None: what a second is worth decides."""
    budget_s: float = np.inf
    """Greatest duration [s]."""
    fill: bool = False
    """The budget is used up for as much as can be seen in it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TriedMotion:
    """A motion and what it sees of the samples."""

    found: Continuous
    price: float
    seen: np.ndarray
    """Shape (n,) bool."""
    completeness: float

    @property
    def seconds(self) -> float:
        return self.found.motion.duration


@dataclass(frozen=True, eq=False, kw_only=True)
class ContinuousProgramme:
    """One path as a tour, timed."""

    viewpoints: tuple[Viewpoint, ...]
    q: np.ndarray
    """Configuration at each of them, shape (k, 7) [rad]."""
    tour: Tour
    paths: tuple[Path, ...]
    trajectory: Trajectory
    record: dict[str, JsonValue]
    """`motion` of the summary."""


def continuous_programme(
    cell: Cell,
    clearance: Clearance,
    part: Part,
    scene: Scene,
    *,
    samples: tuple[np.ndarray, np.ndarray],
    visible: np.ndarray,
    start_q: np.ndarray,
    wanted: Wanted,
    options: ContinuousOptions,
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> ContinuousProgramme | None:
    """The continuous motion that comes nearest to what is wanted; None where none can be driven.

    Args:
        cell: the cell, with the part.
        clearance: its checker.
        part: the true surface.
        scene: what blocks sight.
        samples: points and normals by which completeness is counted, shape (n, 3) each; the search draws
            its own.
        visible: which of them can be seen at all, shape (n,).
        start_q: where the programme stands, shape (7,) [rad].
        wanted: completeness or budget.
        options: how hard to search.
        rng: source of the search's places and moves.
        progress: told the share done.
    """
    scanner = cell.settings.scanner_model()
    drawn = surface_samples(part, options.places, rng=rng)
    table_z = -float(cell.X_TO[2, 3])
    search = ContinuousSearch(
        cell, clearance, scene, scanner, points=drawn.points, normals=drawn.normals,
        poses=turn_poses(part.vertices, scanner, table_z=table_z), start_q=start_q, options=options,
    )  # fmt: skip
    progress(0.2)

    def attempt(price: float, begin: TriedMotion | None) -> TriedMotion | None:
        found = search.found(
            price, rng=rng, longest=wanted.budget_s, begin=None if begin is None else begin.found.choice
        )
        if found is None:
            return None
        seen = seen_along(cell, scanner, scene, found, *samples)
        share = float(seen.sum()) / max(int((visible | seen).sum()), 1)
        return TriedMotion(found=found, price=price, seen=seen, completeness=share)

    tried = _ladder(attempt, wanted, options.price, progress)
    if not tried:
        return None
    return _programme(cell, scene, _best(tried, wanted), tried, start_q)


def _ladder(
    attempt: Callable[[float, TriedMotion | None], TriedMotion | None],
    wanted: Wanted,
    price: float,
    progress: Callable[[float], None],
) -> list[TriedMotion]:
    """Motions at prices that are raised or lowered until what is wanted is met."""
    tried: list[TriedMotion] = []
    for n in range(1 + _STEPS):
        new = attempt(price, tried[-1] if tried else None)
        progress(0.2 + 0.8 * (n + 1) / (1 + _STEPS))
        if new is None:
            break
        tried.append(new)
        if wanted.completeness is not None:
            enough = [t.completeness >= wanted.completeness for t in tried]
            if len(set(enough)) == 2:
                break
            price *= 1 / _FACTOR if enough[-1] else _FACTOR
        elif wanted.fill and new.seconds < _SHORT_OF_BUDGET * wanted.budget_s:
            price *= _FACTOR
        else:
            break
    return tried


def _best(tried: list[TriedMotion], wanted: Wanted) -> TriedMotion:
    """The fastest that is complete enough; else the most complete one inside the budget."""
    if wanted.completeness is not None:
        enough = [t for t in tried if t.completeness >= wanted.completeness]
        if enough:
            return min(enough, key=lambda t: t.seconds)
    inside = [t for t in tried if t.seconds <= wanted.budget_s] or [min(tried, key=lambda t: t.seconds)]
    return max(inside, key=lambda t: t.completeness)


def seen_along(
    cell: Cell, scanner: Scanner, scene: Scene, found: Continuous, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Which points (n, 3) the frames of a motion see, shape (n,)."""
    fps = cell.settings.process.fps
    t = np.arange(int(found.motion.duration * fps) + 1) / fps
    X_OS = scanner_in_object(cell, found.motion(t)[0])
    # Frames far apart first: most points are found early and need not be asked again.
    order = np.argsort((np.arange(len(t)) * 0.6180339887498949) % 1.0, kind="stable")
    return seen_by_any(scene, scanner, X_OS[order], points, normals)


def _programme(
    cell: Cell, scene: Scene, best: TriedMotion, tried: list[TriedMotion], start_q: np.ndarray
) -> ContinuousProgramme:
    names = tuple(f"P{k + 1}" for k in range(len(best.found.passes)))
    found = numbered_views(best.found, names)
    standoffs = _standoffs(scene, found.X_OS, cell.settings.scanner_model())
    views = tuple(
        Viewpoint(
            id=name, X_OS=X, standoff=d, step="global", kind="station", slack=Slack(roll=False),
            note=f"passed at {t:.2f} s",
        )
        for name, X, d, t in zip(names, found.X_OS, standoffs, found.passes, strict=True)
    )  # fmt: skip
    stop: Stop = found.stop
    tour = Tour(
        start_q=start_q, stops=(stop,), seconds=found.motion.duration,
        floor=floor_seconds(cell, move_model(cell), start_q, [stop], {v.id: v for v in views}),
    )  # fmt: skip
    paths = (Path(q=np.array([start_q, stop.q_in]), seconds=0.0, method="joint"),)
    return ContinuousProgramme(
        viewpoints=views, q=found.motion(np.array(found.passes))[0], tour=tour, paths=paths,
        trajectory=time_plan(cell, tour, paths), record=_record(best, tried),
    )  # fmt: skip


def _standoffs(scene: Scene, X_OS: np.ndarray, scanner: Scanner) -> list[float]:
    """How far the surface is along each optical axis, the middle of the range where there is none [m]."""
    rays: Any = np.concatenate([X_OS[:, :3, 3], X_OS[:, :3, 2]], axis=1).astype(np.float32)
    hit = scene.raycaster.cast_rays(rays, nthreads=allowed_threads())["t_hit"].numpy()
    near, far = scanner.range
    return [float(d) if near <= d <= far else 0.5 * (near + far) for d in hit]


def _record(best: TriedMotion, tried: list[TriedMotion]) -> dict[str, JsonValue]:
    curve = sorted((round(t.seconds, 2), round(t.completeness, 6)) for t in tried)
    return {
        "kind": "continuous", "seconds": round(best.seconds, 2),
        "completeness": round(best.completeness, 6),
        "price_s": best.price,
        "curve": [{"seconds": s, "completeness": c} for s, c in curve],
        "note": f"one motion of {best.seconds:.1f} s, arm and table at once, the scanner always on: "
        f"{best.completeness:.2%} of what can be seen",
    }  # fmt: skip


def continuous_step(ctx: Context, state: PlanState) -> PlanState | None:
    """The state with one continuous motion in place of all steps; None where none can be driven.

    Args:
        ctx: what planning reads; it knows the true surface.
        state: nothing is planned yet.
    """
    assert ctx.simulator is not None
    options, s = ctx.options, ctx.simulator.samples
    with ctx.watch("visible"):
        state = replace(state, visible=ctx.simulator.visible(state.seen))
    assert state.visible is not None
    with ctx.watch("motion"):
        made = continuous_programme(
            ctx.cell, ctx.clearance, ctx.part, ctx.simulator.scene,
            samples=(s.points, s.normals), visible=state.visible, start_q=ctx.cell.home,
            wanted=Wanted(completeness=options.completeness, budget_s=ctx.budget_s, fill=options.fill),
            options=options.search, rng=ctx.rng("continuous_motion"),
            progress=lambda f: ctx.progress("motion", f),
        )  # fmt: skip
    if made is None:
        return None
    segment = Segment(
        step="global", reaches=tuple(
            served_at(v, q[None]) for v, q in zip(made.viewpoints, made.q, strict=True)
        ),
        tour=made.tour, paths=made.paths, trajectory=made.trajectory, unreachable=(), seen=state.seen,
    )  # fmt: skip
    return with_segment(ctx, replace(state, motion=made.record), segment, ctx.rng("continuous_scan"))


def better_motion(ctx: Context, moving: PlanState | None, still: PlanState) -> PlanState:
    """The better of a continuous motion and of stops, by what the twin has seen along each.

    The motion is kept where it sees no fewer samples, or as much as was asked for, in fewer seconds; where
    the budget is to be used up, where it sees more inside it.

    Args:
        ctx: what planning reads.
        moving: the continuous motion; None where none can be driven.
        still: turns and stops.
    """
    if moving is None:
        return replace(still, motion=NO_MOTION)
    assert moving.visible is not None and moving.motion is not None
    can = max(int((moving.visible | moving.seen | still.seen).sum()), 1)
    seen = {"continuous": int(moving.seen.sum()), "stops": int(still.seen.sum())}
    shares = {kind: n / can for kind, n in seen.items()}
    seconds = {"continuous": moving.duration, "stops": still.duration}
    asked = ctx.options.completeness
    enough = shares["stops"] if asked is None else min(asked, shares["stops"])
    if ctx.options.fill and moving.duration <= max(ctx.budget_s, still.duration):
        keeps = (seen["continuous"], -moving.duration) > (seen["stops"], -still.duration)
    else:
        keeps = shares["continuous"] >= enough and moving.duration < still.duration
    kept, other = ("continuous", "stops") if keeps else ("stops", "continuous")
    told = {k: f"{k} ({seconds[k]:.1f} s, {shares[k]:.2%} of what can be seen)" for k in seconds}
    record = {
        **(moving.motion if keeps else {}), "kind": kept,
        "compared": {
            k: {"seconds": round(seconds[k], 2), "completeness": round(shares[k], 6)} for k in seconds
        },
        "note": f"{told[kept]} rather than {told[other]}, by the twin",
    }  # fmt: skip
    return replace(moving if keeps else still, motion=record)
