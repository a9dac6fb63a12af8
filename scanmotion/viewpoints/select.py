"""The local step with occlusion: which poses see what the scan has missed, at the least seconds.

Works from the scan alone: the unseen patches of its closed model are the targets, candidates around them are
scored by what camera and projector would see of them, and only what the robot reaches is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.scanner import Scanner
from scanmotion.viewpoints.coverage import (
    Scene,
    free_lines,
    greedy_cover,
    hemisphere,
    revolution_poses,
    scene_from,
    seen_by_any,
    sees,
    tangents,
)
from scanmotion.viewpoints.holes import Hole
from scanmotion.viewpoints.model import ClosedModel, closed_model
from scanmotion.viewpoints.stepped_rotary import UPRIGHT
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint, look_at

Reachable = Callable[[np.ndarray], np.ndarray]
STATION_S, REVOLUTION_S = 4.0, 12.0
"""What a station and a revolution cost with the way there, for weighing them against each other [s]."""
_CONE = np.deg2rad(65.0)


@dataclass(frozen=True, kw_only=True)
class SelectOptions:
    """How finely to look."""

    targets: int = 2500
    """Most points spread over the unseen patches."""
    seeds: int = 90
    """Most places around which candidates are made."""
    directions: int = 21
    """Viewing directions about each seed's normal."""
    standoffs: tuple[float, ...] = (0.45, 0.70)
    """Distances of the camera from the seed [m]."""
    rolls: tuple[float, ...] = (0.0, np.pi / 2)
    """Rolls about the optical axis [rad]."""
    candidates: int = 4000
    """Most candidates that are scored."""
    gap: float = 0.005
    """A model's triangle farther than this from the data is unseen [m]."""
    goal: float = 0.998
    """Share of what the candidates can see of the targets at which the choice ends."""
    most: int = 16
    """Most viewpoints chosen in one round."""
    least_area: float = 1.0e-5
    """A viewpoint that adds less than this is not worth its seconds [m2]."""


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
    reachable: Reachable | None = None,
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
        reachable: tells which poses (n, 4, 4) the robot reaches; None for all.
        prefix: of the viewpoints' ids.
        options: how finely to look.
        rng: draws the targets.
    """
    options = options or SelectOptions()
    model = closed_model(points, normals, spacing=spacing, table_z=table_z)
    scene = scene_from(model.vertices, model.triangles, table_radius=table_radius, table_z=table_z)
    targets, target_normals, area = _targets(model, options, table_z, rng)
    if len(targets) == 0:
        return LocalStep(viewpoints=(), unseen=(), model=model, targets=targets, gains=())
    poses, kinds = _candidates(scene, scanner, model, targets, target_normals, holes, options, table_z)
    matrix = _scores(scene, scanner, poses, kinds, targets, target_normals)
    reached = np.ones(len(poses), bool) if reachable is None else np.asarray(reachable(poses), dtype=bool)
    cost = np.where(kinds, REVOLUTION_S, STATION_S)
    weights = np.full(len(targets), area)
    usable = matrix & reached[:, None]
    chosen = greedy_cover(usable, weights, cost=cost, target=options.goal, max_views=options.most)
    chosen, gains = _worthwhile(usable, area, chosen, options.least_area)
    views = tuple(
        _view(poses[c], kinds[c], f"{prefix}{n}", g)
        for n, (c, g) in enumerate(zip(chosen, gains, strict=True), 1)
    )
    covered = usable[chosen].any(axis=0) if chosen else np.zeros(len(targets), bool)
    return LocalStep(
        viewpoints=views, unseen=_patches(targets, area, covered, matrix, usable), model=model,
        targets=targets, gains=tuple(gains),
    )  # fmt: skip


def _targets(
    model: ClosedModel, options: SelectOptions, table_z: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Points spread by area over the unseen patches, their normals, and the area that each stands for."""
    cross = model.crosses
    twice = np.linalg.norm(cross, axis=1)
    centres = model.centres
    # What faces the table from less than a cell above stands on it.
    base = (centres[:, 2] < table_z + model.cell) & (cross[:, 2] < -0.5 * twice)
    unseen = np.flatnonzero((model.distance > max(options.gap, 1.2 * model.cell)) & ~base & (twice > 0))
    if len(unseen) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), 0.0
    total = twice[unseen].sum() / 2
    n = int(min(options.targets, max(20, np.ceil(total / 16e-6))))
    edges = np.cumsum(twice[unseen])
    pick = np.searchsorted(edges, (np.arange(n) + rng.random(n)) / n * edges[-1])
    chosen = unseen[np.clip(pick, 0, len(unseen) - 1)]
    return centres[chosen], cross[chosen] / twice[chosen, None], float(total / n)


def _spread(points: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most `most` points, each the farthest from those before it."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(most, len(points)) and distance.max() > 0.012:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _candidates(
    scene: Scene,
    scanner: Scanner,
    model: ClosedModel,
    targets: np.ndarray,
    normals: np.ndarray,
    holes: Sequence[Hole],
    options: SelectOptions,
    table_z: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Poses with a free line to their seed, (n, 4, 4), and which of them are revolutions, (n,)."""
    seeds = _spread(targets, options.seeds)
    aims = np.concatenate([targets[seeds], *(h.center[None] for h in holes[:40])])
    faces = np.concatenate([normals[seeds], *(h.normal[None] for h in holes[:40])])
    cone = hemisphere(int(options.directions / (1 - np.cos(_CONE))))
    cone = np.vstack([[0, 0, 1.0], cone[cone[:, 2] >= np.cos(_CONE)]])
    x, y = tangents(faces)
    u = cone[None, :, :1] * x[:, None] + cone[None, :, 1:2] * y[:, None] + cone[None, :, 2:] * faces[:, None]
    poses = []
    for d in options.standoffs:
        eye = aims[:, None] + d * u
        ok = eye[..., 2] > table_z + 0.08
        i, j = np.nonzero(ok)
        free = free_lines(scene, (aims[:, None] + 0.001 * faces[:, None] + 0 * u)[i, j], eye[i, j])
        poses += [
            look_at(eye[a, b], -u[a, b], roll=roll)
            for a, b in zip(i[free], j[free], strict=True)
            for roll in options.rolls
        ]
    stations = np.array(poses).reshape(-1, 4, 4)
    if len(stations) > options.candidates:
        stations = stations[np.linspace(0, len(stations) - 1, options.candidates).astype(int)]
    # The projector must stand above the table too.
    stations = stations[stations[:, 2, 3] + scanner.baseline * stations[:, 2, 0] > table_z + 0.05]
    turns = _revolutions(model, scanner, table_z)
    kinds = np.concatenate([np.zeros(len(stations), bool), np.ones(len(turns), bool)])
    return np.concatenate([stations, turns]), kinds


def _revolutions(model: ClosedModel, scanner: Scanner, table_z: float) -> np.ndarray:
    """A few whole turns at other inclinations and heights than the global step's, shape (n, 4, 4)."""
    radius = float(np.linalg.norm(model.vertices[:, :2], axis=1).max())
    height = float(model.vertices[:, 2].max())
    near, far = scanner.range
    poses = []
    for tilt in np.deg2rad([-8.0, 8.0, 20.0, 42.0, 65.0, 80.0]):
        u = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        for distance in (near + radius * np.cos(tilt) + 0.03, 0.93 * far):
            for aim in (0.25, 0.75):
                for side in (0.0, 0.5 * radius):
                    p = np.array([side, 0.0, aim * height]) + distance * u
                    if p[2] > table_z + 0.09:
                        poses.append(look_at(p, -u, roll=UPRIGHT))
    return np.array(poses).reshape(-1, 4, 4)


def _scores(
    scene: Scene,
    scanner: Scanner,
    poses: np.ndarray,
    kinds: np.ndarray,
    targets: np.ndarray,
    normals: np.ndarray,
) -> np.ndarray:
    """Which candidate sees which target, shape (n, m)."""
    matrix = np.zeros((len(poses), len(targets)), bool)
    matrix[~kinds] = sees(scene, scanner, poses[~kinds], targets, normals)
    for n in np.flatnonzero(kinds):
        matrix[n] = seen_by_any(scene, scanner, revolution_poses(poses[n], 30), targets, normals)
    return matrix


def _worthwhile(
    usable: np.ndarray, area: float, chosen: list[int], least: float
) -> tuple[list[int], list[float]]:
    """The chosen rows by what each adds to those before, without those that add too little."""
    covered, rows, gains = np.zeros(usable.shape[1], bool), [], []
    for row in sorted(chosen, key=lambda r: -int(usable[r].sum())):
        gain = float((usable[row] & ~covered).sum() * area)
        if gain >= least:
            covered |= usable[row]
            rows.append(row)
            gains.append(gain)
    return rows, gains


def _view(X_OS: np.ndarray, turns: bool, name: str, gain: float) -> Viewpoint:
    return Viewpoint(
        id=name, X_OS=X_OS, standoff=0.7 if turns else 0.55, step="local",
        kind="revolution" if turns else "station", slack=Slack(roll=False),
        note=f"adds {gain * 1e4:.1f} cm2",
    )  # fmt: skip


def _patches(
    targets: np.ndarray, area: float, covered: np.ndarray, matrix: np.ndarray, usable: np.ndarray
) -> tuple[Patch, ...]:
    """What is left, gathered by place and reason."""
    from scipy.cluster.hierarchy import fcluster, linkage

    left = np.flatnonzero(~covered)
    reasons = np.where(~matrix.any(axis=0), 0, np.where(~usable.any(axis=0), 1, 2))[left]
    names = ("cannot be seen", "cannot be reached", "not worth its seconds")
    patches = []
    for r, name in enumerate(names):
        members = left[reasons == r]
        if len(members) == 0:
            continue
        label = np.ones(1, int)
        if len(members) > 1:
            label = fcluster(linkage(targets[members], "single"), 0.02, "distance")
        for k in np.unique(label):
            group = targets[members[label == k]]
            patches.append(Patch(center=group.mean(axis=0), area=float(len(group) * area), reason=name))
    return tuple(sorted(patches, key=lambda p: -p.area))
