"""The local step with occlusion: which poses see what the scan has missed, at the least seconds.

Works from the scan alone: the unseen patches of its closed model are the targets, candidates around them are
scored by what camera and projector would see of them, and only what the robot reaches is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.scanner import Scanner
from scanmotion.viewpoints.candidates import CandidateOptions, candidates
from scanmotion.viewpoints.coverage import Scene, scene_from, sees, turns_see
from scanmotion.viewpoints.frontier import Frontier
from scanmotion.viewpoints.holes import Hole
from scanmotion.viewpoints.model import ClosedModel, closed_model
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint

Reachable = Callable[[np.ndarray], np.ndarray]
STATION_S, REVOLUTION_S = 1.8, 9.2
"""What a station and a revolution cost beside the way there, for weighing them against each other [s]."""
SECONDS_PER_METRE = 12.0
"""The scanner's way at 0.1 m/s with its ramps [s/m]."""
_ASKED = 48
"""Candidates of which reach is asked at once."""
_BATCHES = 60
"""So many times at most, to tell what cannot be reached."""
_TURN = 30
"""Poses by which a whole turn is scored."""


@dataclass(frozen=True, kw_only=True)
class SelectOptions:
    """How finely to look."""

    candidates: CandidateOptions = field(default_factory=CandidateOptions)
    targets: int = 2500
    """Most points spread over the unseen patches."""
    gap: float = 0.003
    """A triangle of the model farther than this from the data is unseen, where no frontier is known [m]."""
    wide_gap: float = 0.006
    """The same where the frontier tells of narrower ones [m]."""
    probes: int = 30_000
    """Points spread over the model to find what is only guessed."""
    behind: float = 0.04
    """Targets are seen at least this far inside the range's end [m]."""
    most: int = 24
    """Most viewpoints chosen in one round."""
    least_rate: float = 2.5e-5
    """A viewpoint that adds less than this share of the surface per second is not worth its seconds [1/s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Patch:
    """A patch of the model that stays unscanned."""

    center: np.ndarray
    """Shape (3,) in O [m]."""
    area: float
    """[m2]"""
    reason: str
    """"cannot be seen", "cannot be reached" or "not worth its seconds"."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LocalStep:
    """What a round of the local step asks for."""

    viewpoints: tuple[Viewpoint, ...]
    unseen: tuple[Patch, ...]
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
    table_radius: float,
    table_z: float = 0.0,
    frontier: Frontier | None = None,
    claimed: np.ndarray | None = None,
    model: ClosedModel | None = None,
    reachable: Reachable | None = None,
    seconds: float = np.inf,
    prefix: str = "L",
    options: SelectOptions | None = None,
    rng: np.random.Generator,
) -> LocalStep:
    """Chooses viewpoints for what a scan has missed.

    Args:
        points: the fused scan, shape (n, 3) in O [m].
        normals: outward, shape (n, 3).
        holes: their rims' normals add candidates that look straight in.
        scanner: field, range, incidence, baseline.
        spacing: of the points [m].
        table_radius: of the table's disc [m].
        table_z: its height in O [m].
        frontier: where the frames left space open, narrow strips under ledges above all; None where the
            frames are not known.
        claimed: targets that earlier rounds should have seen, shape (k, 3).
        model: of an earlier round, whose shape is kept but for what frames have looked through since; None
            makes one of the points.
        reachable: tells which poses (n, 4, 4) the robot reaches; None for all.
        seconds: what the chosen may take together, roughly [s].
        prefix: of the viewpoints' ids.
        options: how finely to look.
        rng: draws the targets.
    """
    options = options or SelectOptions()
    passed = None if frontier is None else frontier.passed
    if model is None:
        model = closed_model(points, normals, spacing=spacing, table_z=table_z, passed=passed)
    else:
        model = model.measured(points, passed)
    scene = _scene(model, table_radius, table_z)
    targets = _targets(model, holes, spacing, frontier, claimed, options, table_z, rng)
    if len(targets.points) == 0:
        return LocalStep(
            viewpoints=(), unseen=(), model=model, targets=targets.points,
            claimed=targets.points, gains=(),
        )  # fmt: skip
    poses, kinds = candidates(
        scene, scanner, model.vertices, targets.points, targets.normals, holes,
        table_radius=table_radius, table_z=table_z, options=options.candidates,
    )  # fmt: skip
    # What lies behind a target is farther than the target.
    near, far = scanner.range
    matrix = _scores(scene, replace(scanner, range=(near, far - options.behind)), poses, kinds, targets)
    arm = _Arm(poses, reachable)
    least = options.least_rate * model.area
    chosen, gains = _chosen(matrix, targets.areas, poses, kinds, arm, least, seconds, options.most)
    views = tuple(
        _view(poses[c], kinds[c], f"{prefix}{n}", g)
        for n, (c, g) in enumerate(zip(chosen, gains, strict=True), 1)
    )
    covered = np.asarray(matrix[chosen].any(axis=0)) if chosen else np.zeros(len(targets.points), bool)
    return LocalStep(
        viewpoints=views, unseen=_patches(targets, covered, matrix, arm), model=model,
        targets=targets.points, claimed=targets.points[covered], gains=tuple(gains),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Targets:
    """What is to be seen: places, the side they open to, and the surface expected there."""

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray


def _scene(model: ClosedModel, table_radius: float, table_z: float) -> Scene:
    """The measured part of the model blocks sight; the guessed part only beyond its own uncertainty."""
    near = model.distance <= 1.2 * model.cell
    scene = scene_from(model.vertices, model.triangles[near], table_radius=table_radius, table_z=table_z)
    guess = scene_from(model.vertices, model.triangles[~near]) if not near.all() else None
    return replace(scene, guess=None if guess is None else guess.raycaster)


def _targets(
    model: ClosedModel,
    holes: Sequence[Hole],
    spacing: float,
    frontier: Frontier | None,
    claimed: np.ndarray | None,
    options: SelectOptions,
    table_z: float,
    rng: np.random.Generator,
) -> _Targets:
    """The frontier's cells, and points spread by area over what the model only guesses."""
    cross = model.crosses
    twice = np.linalg.norm(cross, axis=1)
    edges = np.cumsum(twice)
    pick = np.searchsorted(
        edges, (np.arange(options.probes) + rng.random(options.probes)) / options.probes * edges[-1]
    )
    pick = np.clip(pick, 0, len(twice) - 1)
    points, normals = model.centres[pick], cross[pick] / np.maximum(twice[pick, None], 1e-300)
    # What faces the table from less than a cell above stands on it.
    base = (points[:, 2] < table_z + model.cell) & (normals[:, 2] < -0.93)
    gap = options.gap if frontier is None else options.wide_gap
    far = np.flatnonzero((model.distance[pick] > max(gap, 1.2 * model.cell)) & ~base)
    points, normals = points[far], normals[far]
    areas = np.full(len(far), edges[-1] / 2 / options.probes)
    if frontier is None:
        filled = [_filled(hole, 1.5 * spacing) for hole in holes]
        points = np.concatenate([points, *filled])
        normals = np.concatenate(
            [normals, *(np.tile(h.normal, (len(f), 1)) for h, f in zip(holes, filled, strict=True))]
        )
        areas = np.concatenate([areas, np.full(sum(map(len, filled)), (1.5 * spacing) ** 2)])
    else:
        lifted = frontier.points[:, 2] > table_z + 2.5 * frontier.edge
        free_side = frontier.points[lifted] + frontier.edge * frontier.normals[lifted]
        points = np.concatenate([points, free_side])
        normals = np.concatenate([normals, frontier.normals[lifted]])
        areas = np.concatenate([areas, np.full(int(lifted.sum()), frontier.edge**2)])
    if claimed is not None and len(claimed) and len(points):
        fresh = cKDTree(claimed).query(points)[0] > 1.5 * model.cell
        points, normals, areas = points[fresh], normals[fresh], areas[fresh]
    if len(points) > options.targets:
        share = len(points) / options.targets
        index = np.linspace(0, len(points) - 1, options.targets).astype(int)
        points, normals, areas = points[index], normals[index], areas[index] * share
    return _Targets(points, normals, areas)


def _filled(hole: Hole, step: float) -> np.ndarray:
    """Points over the area that a hole's rim encloses, a `step` apart, shape (n, 3)."""
    rim = hole.boundary[: hole.outer] @ hole.X_OH[:3, :3] - hole.X_OH[:3, 3] @ hole.X_OH[:3, :3]
    low, high = rim.min(axis=0), rim.max(axis=0)
    x, y = (a.ravel() for a in np.meshgrid(*(np.arange(low[i], high[i] + step, step) for i in (0, 1))))
    a, b = rim, np.roll(rim, -1, axis=0)
    inside = np.zeros(len(x), bool)
    for (ax, ay, _), (bx, by, _) in zip(a, b, strict=True):
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (bx - ax) * (y - ay) / (by - ay))
    x, y = np.concatenate([x[inside], rim[:, 0]]), np.concatenate([y[inside], rim[:, 1]])
    distance, near = cKDTree(rim[:, :2]).query(np.column_stack([x, y]), k=min(4, len(rim)))
    weight = 1 / np.maximum(distance.reshape(len(x), -1), 1e-9)
    z = (weight * rim[near.reshape(len(x), -1), 2]).sum(axis=1) / weight.sum(axis=1)
    return np.column_stack([x, y, z]) @ hole.X_OH[:3, :3].T + hole.X_OH[:3, 3]


def _scores(
    scene: Scene,
    scanner: Scanner,
    poses: np.ndarray,
    kinds: np.ndarray,
    targets: _Targets,
) -> np.ndarray:
    """Which candidate sees which target, shape (n, m)."""
    matrix = np.zeros((len(poses), len(targets.points)), bool)
    matrix[~kinds] = sees(scene, scanner, poses[~kinds], targets.points, targets.normals)
    matrix[kinds] = turns_see(scene, scanner, poses[kinds], targets.points, targets.normals, poses=_TURN)
    return matrix


class _Arm:
    """What the arm reaches of the candidates, asked for only where it matters."""

    def __init__(self, poses: np.ndarray, reachable: Reachable | None) -> None:
        self._poses, self._reachable = poses, reachable
        self.known = np.full(len(poses), reachable is None)
        self.reached = np.full(len(poses), reachable is None)

    def ask(self, index: np.ndarray) -> None:
        index = index[~self.known[index]]
        if len(index) and self._reachable is not None:
            self.reached[index] = self._reachable(self._poses[index])
            self.known[index] = True


def _chosen(
    matrix: np.ndarray,
    areas: np.ndarray,
    poses: np.ndarray,
    kinds: np.ndarray,
    arm: _Arm,
    least: float,
    seconds: float,
    most: int,
) -> tuple[list[int], list[float]]:
    """Rows by greatest gain per second, and what each adds to those before it [m2].

    A second choice counts the way from the nearest viewpoint already chosen; the table turns any azimuth
    before the arm, so that only radius and height of the scanner count.
    """
    place = np.column_stack([np.linalg.norm(poses[:, :2, 3], axis=1), poses[:, 2, 3]])
    gaining = np.flatnonzero(matrix.any(axis=1))
    table = matrix[gaining].astype(np.float32)
    base = np.where(kinds, REVOLUTION_S, STATION_S)[gaining]
    way = np.full(len(gaining), 0.3)
    open_, rows, gains, spent = areas.astype(np.float32), [], [], 0.0
    while len(gaining) and len(rows) < most:
        gain = table @ open_
        cost = base + SECONDS_PER_METRE * way
        rate = np.where(arm.known[gaining] & ~arm.reached[gaining], -1.0, gain / cost)
        best = int(np.argmax(rate))
        if rate[best] < least or spent + cost[best] > seconds:
            break
        if not arm.known[gaining[best]]:
            arm.ask(gaining[np.argsort(-rate, kind="stable")[:_ASKED]])
            continue
        rows.append(int(gaining[best]))
        gains.append(float(gain[best]))
        spent += float(cost[best])
        open_[matrix[rows[-1]]] = 0.0
        way = np.minimum(way, np.linalg.norm(place[gaining] - place[rows[-1]], axis=1))
    return _pruned(matrix, areas, kinds, rows, least)


def _pruned(
    matrix: np.ndarray, areas: np.ndarray, kinds: np.ndarray, rows: list[int], least: float
) -> tuple[list[int], list[float]]:
    """Without the rows that later ones made superfluous, the worst first, and what each adds alone [m2]."""
    rows = list(rows)
    while rows:
        count = matrix[rows].sum(axis=0)
        alone = np.array([areas[matrix[r] & (count == 1)].sum() for r in rows])
        rate = alone / (np.where(kinds[rows], REVOLUTION_S, STATION_S) + 0.1 * SECONDS_PER_METRE)
        worst = int(np.argmin(rate))
        if rate[worst] >= least:
            return rows, [float(a) for a in alone]
        del rows[worst]
    return [], []


def _view(X_OS: np.ndarray, turns: bool, name: str, gain: float) -> Viewpoint:
    return Viewpoint(
        id=name, X_OS=X_OS, standoff=0.7 if turns else 0.55, step="local",
        kind="revolution" if turns else "station", slack=Slack(roll=False),
        note=f"adds {gain * 1e4:.1f} cm2",
    )  # fmt: skip


def _decide(matrix: np.ndarray, arm: _Arm) -> None:
    """Asks for reach until each target has a row that is reached, or none left to ask for."""
    for _ in range(_BATCHES):
        undecided = ~matrix[arm.reached].any(axis=0)
        count = np.where(arm.known, 0, matrix[:, undecided].sum(axis=1))
        asked = np.argsort(-count, kind="stable")[:_ASKED]
        if count[asked[0]] == 0:
            return
        arm.ask(asked[count[asked] > 0])


def _patches(targets: _Targets, covered: np.ndarray, matrix: np.ndarray, arm: _Arm) -> tuple[Patch, ...]:
    """What is left, gathered by place and reason."""
    from scipy.cluster.hierarchy import fcluster, linkage

    left = np.flatnonzero(~covered)
    _decide(matrix[:, left], arm)
    usable = matrix & (arm.reached | ~arm.known)[:, None]
    reasons = np.where(~matrix.any(axis=0), 0, np.where(~usable.any(axis=0), 1, 2))[left]
    names = ("cannot be seen", "cannot be reached", "not worth its seconds")
    patches = []
    for r, name in enumerate(names):
        members = left[reasons == r]
        if len(members) == 0:
            continue
        label = np.ones(1, int)
        if len(members) > 1:
            label = fcluster(linkage(targets.points[members], "single"), 0.02, "distance")
        for k in np.unique(label):
            group = members[label == k]
            center, area = targets.points[group].mean(axis=0), float(targets.areas[group].sum())
            patches.append(Patch(center=center, area=area, reason=name))
    return tuple(sorted(patches, key=lambda p: -p.area))
