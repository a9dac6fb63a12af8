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
    hemisphere,
    revolution_poses,
    scene_from,
    seen_by_any,
    sees,
    tangents,
)
from scanmotion.viewpoints.holes import Hole
from scanmotion.viewpoints.model import ClosedModel, closed_model
from scanmotion.viewpoints.stepped_rotary import UPRIGHT, oblique_turn
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint, look_at

Reachable = Callable[[np.ndarray], np.ndarray]
STATION_S, REVOLUTION_S = 1.8, 9.2
"""What a station and a revolution cost beside the way there, for weighing them against each other [s]."""
SECONDS_PER_METRE = 12.0
"""The scanner's way at 0.1 m/s with its ramps [s/m]."""
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
    most: int = 24
    """Most viewpoints chosen in one round."""
    least_rate: float = 5.0e-5
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
        frames: poses X_OS of the frames taken so far, shape (k, 4, 4): what none of them sees of the model is
            a target too, narrow strips under ledges above all; None where they are not known.
        reachable: tells which poses (n, 4, 4) the robot reaches; None for all.
        seconds: what the chosen may take together, roughly [s].
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
    usable = matrix & reached[:, None]
    least = options.least_rate * model.area
    chosen, gains = _chosen(usable, area, poses, kinds, least, seconds, options.most)
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
    """Whole turns at many inclinations, offsets, distances, heights and both rolls, shape (n, 4, 4)."""
    radius = float(np.linalg.norm(model.vertices[:, :2], axis=1).max())
    top = float(model.vertices[:, 2].max())
    near, far = scanner.range
    poses = []
    for tilt in np.deg2rad([-20.0, -8.0, 5.0, 18.0, 32.0, 46.0, 60.0, 75.0]):
        close = near + radius * np.cos(tilt) + 0.03
        for distance in (close, max(0.95 * far, close)):
            for aim in (0.2, 0.5, 0.8):
                for yaw in np.deg2rad([-30.0, -15.0, 0.0, 15.0, 30.0]):
                    for roll in (0.0, UPRIGHT):
                        X = oblique_turn(
                            tilt, yaw, aim * top, distance, radius=radius, floor=table_z + 0.02, roll=roll
                        )
                        if _standing(X[:3, 3], table_radius, table_z):
                            poses.append(X)
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


def _chosen(
    usable: np.ndarray,
    area: float,
    poses: np.ndarray,
    kinds: np.ndarray,
    least: float,
    seconds: float,
    most: int,
) -> tuple[list[int], list[float]]:
    """Rows by greatest gain per second, and what each adds to those before it [m2].

    A second choice counts the way from the nearest viewpoint already chosen; the table turns any azimuth
    before the arm, so that only radius and height of the scanner count.
    """
    place = np.column_stack([np.linalg.norm(poses[:, :2, 3], axis=1), poses[:, 2, 3]])
    base = np.where(kinds, REVOLUTION_S, STATION_S)
    gaining = np.flatnonzero(usable.any(axis=1))
    table = usable[gaining].astype(np.float32)
    way = np.full(len(gaining), 0.3)
    open_, rows, gains, spent = np.ones(usable.shape[1], np.float32), [], [], 0.0
    while len(gaining) and len(rows) < most:
        gain = (table @ open_) * area
        cost = base[gaining] + SECONDS_PER_METRE * way
        best = int(np.argmax(gain / cost))
        if gain[best] < least * cost[best] or spent + cost[best] > seconds:
            break
        rows.append(int(gaining[best]))
        gains.append(float(gain[best]))
        spent += float(cost[best])
        open_[usable[rows[-1]]] = 0.0
        way = np.minimum(way, np.linalg.norm(place[gaining] - place[rows[-1]], axis=1))
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
