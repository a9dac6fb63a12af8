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
STATION_S, REVOLUTION_S = 3.3, 10.8
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
    standoffs: tuple[float, ...] = (0.45, 0.70, 0.93)
    """Distances of the camera from the seed [m]."""
    rolls: tuple[float, ...] = (0.0, np.pi / 2)
    """Rolls about the optical axis [rad]."""
    candidates: int = 4000
    """Most candidates that are scored."""
    gap: float = 0.005
    """A model's triangle farther than this from the data is unseen in any case [m]."""
    probes: int = 30_000
    """Points spread over the model to find what no frame has seen."""
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
    frames: np.ndarray | None = None,
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
        frames: poses X_OS of the frames taken so far, shape (k, 4, 4): what none of them sees of the model is
            a target too, narrow strips under ledges above all; None where they are not known.
        reachable: tells which poses (n, 4, 4) the robot reaches; None for all.
        prefix: of the viewpoints' ids.
        options: how finely to look.
        rng: draws the targets.
    """
    options = options or SelectOptions()
    model = closed_model(points, normals, spacing=spacing, table_z=table_z)
    scene = scene_from(model.vertices, model.triangles, table_radius=table_radius, table_z=table_z)
    targets, target_normals, area = _targets(model, scene, scanner, frames, options, table_z, rng)
    if len(targets) == 0:
        return LocalStep(viewpoints=(), unseen=(), model=model, targets=targets, gains=())
    poses, kinds = _candidates(
        scene, scanner, model, targets, target_normals, holes, options, table_radius, table_z
    )
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
    model: ClosedModel,
    scene: Scene,
    scanner: Scanner,
    frames: np.ndarray | None,
    options: SelectOptions,
    table_z: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Points spread by area over what is unseen, their normals, and the area that each stands for."""
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
    far = model.distance[pick] > max(options.gap, 1.2 * model.cell)
    unseen = far
    if frames is not None:
        known = base | far
        seen = seen_by_any(scene, scanner, frames, points, normals, seen=known)
        unseen = far | ~seen
    index = np.flatnonzero(unseen & ~base)
    area = float(edges[-1] / 2 / options.probes)
    if len(index) > options.targets:
        area *= len(index) / options.targets
        index = index[np.linspace(0, len(index) - 1, options.targets).astype(int)]
    return points[index], normals[index], area


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
    table_radius: float,
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
    start = aims + 0.001 * faces
    for d in options.standoffs:
        eye = aims[:, None] + d * u
        i, j = np.nonzero(_standing(eye, table_radius, table_z))
        free = free_lines(scene, start[i], eye[i, j])
        poses += [
            look_at(eye[a, b], -u[a, b], roll=roll)
            for a, b in zip(i[free], j[free], strict=True)
            for roll in options.rolls
        ]
    poses += _low(scene, aims, faces, start, table_radius, table_z)
    stations = np.array(poses).reshape(-1, 4, 4)
    if len(stations) > options.candidates:
        stations = stations[np.linspace(0, len(stations) - 1, options.candidates).astype(int)]
    # The projector must stand above the table too.
    stations = stations[stations[:, 2, 3] + scanner.baseline * stations[:, 2, 0] > table_z + 0.01]
    turns = _revolutions(model, scanner, table_radius, table_z)
    kinds = np.concatenate([np.zeros(len(stations), bool), np.ones(len(turns), bool)])
    return np.concatenate([stations, turns]), kinds


def _standing(eye: np.ndarray, table_radius: float, table_z: float) -> np.ndarray:
    """Where an eye (..., 3) can be: well above the table, or beside it and hardly below its top."""
    beside = np.linalg.norm(eye[..., :2], axis=-1) > table_radius + 0.1
    return eye[..., 2] > table_z + np.where(beside, 0.015, 0.08)


def _low(
    scene: Scene,
    aims: np.ndarray,
    faces: np.ndarray,
    start: np.ndarray,
    table_radius: float,
    table_z: float,
) -> list[np.ndarray]:
    """Eyes beside the table that look up under what faces down."""
    poses = []
    azimuth = 2 * np.pi * np.arange(24) / 24
    ring = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    for height in (0.02, 0.07, 0.13):
        eye = np.empty((len(aims), 24, 3))
        eye[..., :2] = ring * (table_radius + 0.17)
        eye[..., 2] = table_z + height
        line = eye - aims[:, None]
        distance = np.linalg.norm(line, axis=2)
        ok = (distance < 0.97) & (distance > 0.45)
        ok &= np.einsum("ijk,ik->ij", line, faces) > 0.36 * distance
        i, j = np.nonzero(ok)
        free = free_lines(scene, start[i], eye[i, j])
        poses += [
            look_at(eye[a, b], -line[a, b], roll=UPRIGHT) for a, b in zip(i[free], j[free], strict=True)
        ]
    return poses


def _revolutions(model: ClosedModel, scanner: Scanner, table_radius: float, table_z: float) -> np.ndarray:
    """A few whole turns at other inclinations and heights than the global step's, shape (n, 4, 4)."""
    radius = float(np.linalg.norm(model.vertices[:, :2], axis=1).max())
    height = float(model.vertices[:, 2].max())
    near, far = scanner.range
    poses = []
    for tilt in np.deg2rad([-22.0, -10.0, 8.0, 20.0, 42.0, 65.0, 80.0]):
        u = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        for distance in (near + radius * np.cos(tilt) + 0.03, 0.93 * far):
            for aim in (0.25, 0.75):
                for side in (0.0, 0.5 * radius):
                    target = np.array([side, 0.0, aim * height])
                    p = target + distance * u
                    if p[0] > table_radius + 0.1:
                        p[2] = max(p[2], table_z + 0.02)
                    if _standing(p, table_radius, table_z):
                        poses.append(look_at(p, target - p, roll=UPRIGHT))
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
