"""The local step with occlusion: which poses see what the scan has missed, at the least seconds.

Works from the scan alone: the unseen patches of its closed model are the targets, candidates around them are
scored by what camera and projector would see of them, and only what the robot reaches is chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.core.view_costs import ViewCosts
from scanmotion.core.viewpoint import Slack, Viewpoint
from scanmotion.sensing.closed_surface import ClosedModel, closed_model
from scanmotion.sensing.free_space import Space
from scanmotion.sensing.holes.find import Hole
from scanmotion.sensing.visibility import Scene, axis_depths, revolution_poses
from scanmotion.views.candidate_views import ASKED, CandidateOptions, Candidates, Reachable, candidates
from scanmotion.views.targets import TargetOptions, Targets, drawn, missed, near, sight_of
from scanmotion.views.unscanned import CANNOT_BE_SEEN, Patch, patches, why_open

_BEHIND_SHARE = 0.1
_TURN_POSES = 30
"""Angles of a turn at which its distance to the surface is taken."""


@dataclass(frozen=True, kw_only=True)
class SelectOptions:
    """How finely to look."""

    candidates: CandidateOptions = field(default_factory=CandidateOptions)
    targets: TargetOptions = field(default_factory=TargetOptions)
    behind: float = 0.04
    """Targets are seen at least this far inside the range's end, but at most a tenth of the range [m]."""
    most: int = 24
    """Most viewpoints chosen in one round."""
    least_rate: float = 2.5e-5
    """A viewpoint that adds less than this share of the surface per second is not worth its seconds [1/s]."""
    wary: float = 0.0
    """Of the greatest incidence, kept in hand when seeing is promised: the normals of what was missed are
    guessed [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LocalStep:
    """What a round of the local step asks for."""

    viewpoints: tuple[Viewpoint, ...]
    unseen: tuple[Patch, ...]
    """What the scan shows to be missed and no viewpoint will see, or an earlier one has tried in vain; empty
    where no explanation was asked for."""
    model: ClosedModel
    targets: np.ndarray
    """Points on the unseen patches, shape (m, 3)."""
    claimed: np.ndarray
    """Targets that the viewpoints should see, shape (k, 3): what stays open there is not tried again."""
    gains: tuple[float, ...]
    """Area that each viewpoint adds, in the order of choice [m2]."""


def local_step(
    points: np.ndarray,
    normals: np.ndarray,
    holes: Sequence[Hole],
    scanner: Scanner,
    *,
    spacing: float,
    table: TableGeometry,
    costs: ViewCosts,
    space: Space | None = None,
    claimed: np.ndarray | None = None,
    model: ClosedModel | None = None,
    reachable: Reachable | None = None,
    seconds: float = np.inf,
    explain: bool = True,
    options: SelectOptions | None = None,
    rng: np.random.Generator,
) -> LocalStep:
    """Chooses viewpoints for what a scan has missed.

    Args:
        points: the fused scan, shape (n, 3) in O [m].
        normals: outward unit normals, shape (n, 3).
        holes: their rims' normals add candidates that look straight in.
        scanner: field, range, incidence, baseline.
        spacing: of the points [m].
        table: where it is, and the room beside it.
        costs: what stations, turns and ways take in this cell.
        space: what the frames have looked through; None where the frames are not known.
        claimed: targets that earlier rounds should have seen, shape (k, 3) [m].
        model: of an earlier round, whose shape is kept but for what frames have looked through since; None
            makes one of the points.
        reachable: tells which poses, shape (n, 4, 4) [m], the robot reaches; None for all.
        seconds: what the chosen may take together, roughly [s].
        explain: whether to say why what stays open does; reach is then asked of many more candidates.
        options: how finely to look.
        rng: draws the targets.
    """
    options = options or SelectOptions()
    passed = None if space is None else space.passed
    if model is None:
        model = closed_model(points, normals, spacing=spacing, table_z=table.z, passed=passed)
    else:
        model = model.measured(points, passed)
    open_ = missed(
        model, points, spacing=spacing, space=space, holes=holes, table_z=table.z, options=options.targets
    )
    tried = near(open_, claimed, 1.5 * model.cell)
    vain = patches(open_.only(tried), np.full(int(tried.sum()), CANNOT_BE_SEEN)) if explain else ()
    targets = drawn(open_.only(~tried), options.targets.most, rng)
    if len(targets) == 0:
        none = targets.points
        return LocalStep(viewpoints=(), unseen=vain, model=model, targets=none, claimed=none, gains=())
    scene = sight_of(model, table_radius=table.radius, table_z=table.z, pedestal_radius=table.pedestal_radius)
    found = candidates(
        scene, scanner, targets, solid=model.vertices, holes=holes, reachable=reachable, table=table,
        options=options.candidates, promised=_careful(scanner, options),
    )  # fmt: skip
    chosen, gains = _chosen(
        found, targets.areas, options.least_rate * model.area, costs, seconds=seconds, most=options.most
    )
    views = tuple(
        _view(found, c, _standoff(scene, scanner, found, c, targets.points), f"L{n}", g)
        for n, (c, g) in enumerate(zip(chosen, gains, strict=True), 1)
    )
    covered = np.asarray(found.sees[chosen].any(axis=0)) if chosen else np.zeros(len(targets), bool)
    left = np.flatnonzero(~covered)
    why = patches(targets.only(left), why_open(found, left)) if explain else ()
    return LocalStep(
        viewpoints=views,
        unseen=tuple(sorted(vain + why, key=lambda p: -p.area)),
        model=model, targets=targets.points, claimed=targets.points[covered], gains=tuple(gains),
    )  # fmt: skip


def views_of_surface(
    scene: Scene,
    scanner: Scanner,
    targets: Targets,
    *,
    solid: np.ndarray,
    table: TableGeometry,
    costs: ViewCosts,
    reachable: Reachable | None,
    whole: float,
    seconds: float = np.inf,
    options: SelectOptions | None = None,
) -> tuple[Viewpoint, ...]:
    """Viewpoints, whole turns among them, for the open part of a surface that is known.

    Args:
        scene: the true surface.
        scanner: field, range, incidence, baseline.
        targets: what is open.
        solid: points of the surface, shape (k, 3) in O [m].
        table: where it is, and the room beside it.
        costs: what stations, turns and ways take in this cell.
        reachable: tells which poses, shape (n, 4, 4) [m], the robot reaches; None for all.
        whole: area of the whole surface [m2].
        seconds: what the chosen may take together, roughly [s].
        options: how finely to look.
    """
    options = options or SelectOptions()
    if len(targets) == 0:
        return ()
    found = candidates(
        scene, scanner, targets, solid=solid, reachable=reachable, table=table, options=options.candidates
    )
    chosen, gains = _chosen(
        found, targets.areas, options.least_rate * whole, costs, seconds=seconds, most=options.most
    )
    return tuple(
        _view(found, c, _standoff(scene, scanner, found, c, targets.points), f"L{n}", g)
        for n, (c, g) in enumerate(zip(chosen, gains, strict=True), 1)
    )


def _careful(scanner: Scanner, options: SelectOptions) -> Scanner:
    """The scanner by which seeing is promised: what lies behind a target is farther than the target."""
    least, most = scanner.range
    behind = min(options.behind, _BEHIND_SHARE * scanner.depth)
    return replace(scanner, range=(least, most - behind), max_incidence=scanner.max_incidence - options.wary)


def _chosen(
    found: Candidates, areas: np.ndarray, least: float, costs: ViewCosts, *, seconds: float, most: int
) -> tuple[list[int], list[float]]:
    """Candidates by greatest gain per second, and what each adds to the others [m2].

    A second choice counts the way from the nearest viewpoint already chosen; the table turns any azimuth
    before the arm, so that only radius and height of the scanner count.
    """
    place = np.column_stack([np.linalg.norm(found.X_OS[:, :2, 3], axis=1), found.X_OS[:, 2, 3]])
    gaining = np.flatnonzero(found.sees.any(axis=1))
    table = found.sees[gaining].astype(np.float32)
    base = costs.own_seconds(found.turns)[gaining]
    way = np.full(len(gaining), costs.first_way)
    open_, rows, spent = areas.astype(np.float32), [], 0.0
    while len(gaining) and len(rows) < most:
        gain = table @ open_
        cost = base + costs.seconds_per_metre * way
        rate = np.where(found.known[gaining] & ~found.reached[gaining], -1.0, gain / cost)
        best = int(np.argmax(rate))
        if rate[best] < least or spent + cost[best] > seconds:
            break
        if not found.known[gaining[best]]:
            found.ask(gaining[np.argsort(-rate, kind="stable")[:ASKED]])
            continue
        rows.append(int(gaining[best]))
        spent += float(cost[best])
        open_[found.sees[rows[-1]]] = 0.0
        way = np.minimum(way, np.linalg.norm(place[gaining] - place[rows[-1]], axis=1))
    seconds_of = costs.own_seconds(found.turns) + costs.usual_way * costs.seconds_per_metre
    return _pruned(found.sees, areas, seconds_of, rows, least)


def _pruned(
    matrix: np.ndarray, areas: np.ndarray, seconds: np.ndarray, rows: list[int], least: float
) -> tuple[list[int], list[float]]:
    """Without the rows that later ones made superfluous, the worst first, and what each adds alone [m2]."""
    rows = list(rows)
    while rows:
        count = matrix[rows].sum(axis=0)
        alone = np.array([areas[matrix[r] & (count == 1)].sum() for r in rows])
        rate = alone / seconds[rows]
        worst = int(np.argmin(rate))
        if rate[worst] >= least:
            return rows, [float(a) for a in alone]
        del rows[worst]
    return [], []


LOCAL_SLACK = Slack(standoff=(-0.003, 0.003), tilt=np.deg2rad(0.5), roll=False)
"""What a local station may give way in: at its edge it loses 1.4 % of what it sees, and gains as much beside
that (benchmarks/slack.py)."""


def _standoff(scene: Scene, scanner: Scanner, found: Candidates, c: int, targets: np.ndarray) -> float:
    """Distance along the axis of candidate c to the surface; of a turn the median over its angles [m].

    Where the axis passes the surface, as beside a narrow part, that of the middle of what it sees of the
    targets (m, 3).
    """
    X_OS, turns = found.X_OS[c], bool(found.turns[c])
    usual = scanner.usual_depth(axis_depths(scene, revolution_poses(X_OS, _TURN_POSES) if turns else X_OS))
    if usual is not None:
        return usual
    if turns:
        # The point of the axis of sight that comes nearest to the table's axis.
        p, z = X_OS[:3, 3], X_OS[:3, 2]
        return float(-(p[:2] @ z[:2]) / max(float(z[:2] @ z[:2]), 1e-12))
    return float(np.median((targets[found.sees[c]] - X_OS[:3, 3]) @ X_OS[:3, 2]))


def _view(found: Candidates, c: int, standoff: float, name: str, gain: float) -> Viewpoint:
    return Viewpoint(
        id=name, X_OS=found.X_OS[c], standoff=standoff, step="local",
        kind="revolution" if found.turns[c] else "station",
        slack=Slack(roll=False) if found.turns[c] else LOCAL_SLACK,
        note=f"adds {gain * 1e4:.1f} cm2",
    )  # fmt: skip
