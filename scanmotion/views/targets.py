"""What a scan has missed: the guessed part of its closed model, and where its frames left space open."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.sensing.closed_surface import ClosedModel
from scanmotion.sensing.free_space import Space
from scanmotion.sensing.holes.find import Hole
from scanmotion.sensing.visibility import Scene, scene_from

_FACES_TABLE = -0.3
"""A normal that sinks more than this looks at the table."""


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """How far from the data surface counts as missed; in spacings of the data."""

    gap: float = 1.5
    """A triangle of the model farther than this from the data is missed."""
    unsure: float = 1.25
    """A cell of the frontier counts only beside triangles farther than this from the data: unknown space
    before a measured surface hides nothing."""
    beside: float = 3.0
    """How near to such a triangle."""
    sure: float = 2.5
    """Where the frames are not known, missed triangles count only about one that is farther than this from
    the data: random points leave gaps of 1.5 everywhere, but of 2.5 only about one of 3e8."""
    most: int = 2500
    """Most targets."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Targets:
    """What is to be seen."""

    points: np.ndarray
    """Shape (m, 3) in O [m]."""
    normals: np.ndarray
    """Unit vectors to the side that they open to, shape (m, 3)."""
    areas: np.ndarray
    """Of the surface that each stands for, shape (m,) [m2]."""

    def __len__(self) -> int:
        return len(self.points)

    def only(self, which: np.ndarray) -> "Targets":
        """Some of them."""
        return Targets(points=self.points[which], normals=self.normals[which], areas=self.areas[which])


def sight_of(
    model: ClosedModel, *, table_radius: float, table_z: float = 0.0, pedestal_radius: float = 0.0
) -> Scene:
    """The measured part of the model blocks sight; the guessed part only beyond its own uncertainty."""
    near = model.distance <= 1.2 * model.cell
    scene = scene_from(
        model.vertices, model.triangles[near], table_radius=table_radius, table_z=table_z,
        pedestal_radius=pedestal_radius,
    )  # fmt: skip
    guess = scene_from(model.vertices, model.triangles[~near]) if not near.all() else None
    return replace(scene, guess=None if guess is None else guess.raycaster)


def missed(
    model: ClosedModel,
    measured: np.ndarray,
    *,
    spacing: float,
    space: Space | None = None,
    holes: Sequence[Hole] = (),
    table_z: float = 0.0,
    options: TargetOptions | None = None,
) -> Targets:
    """What the scan has missed, as far as the scan itself can tell.

    Args:
        model: closed over the measured points.
        measured: the points, shape (n, 3) in O [m].
        spacing: of the points [m].
        space: what the frames have looked through: narrow strips under ledges show there only. None where the
            frames are not known; the holes stand in for it.
        holes: of the points.
        table_z: height of the table's top in O [m].
        options: what counts as missed.
    """
    options = options or TargetOptions()
    cross, centres = model.crosses, model.centres
    twice = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(twice[:, None], 1e-300)
    # What faces down hardly above the table stands on it: the guess is round where the part has its edge.
    standing = (centres[:, 2] < table_z + 2 * model.cell) & (normals[:, 2] < _FACES_TABLE)
    distance = np.where(standing, 0.0, model.distance)
    far = distance > options.gap * spacing
    whole = Targets(points=centres, normals=normals, areas=twice / 2)
    if space is None:
        far &= near(whole, centres[distance > options.sure * spacing], options.beside * spacing)
    found = [whole.only(far)]
    if space is None:
        over = [_over(hole, 1.5 * spacing) for hole in holes]
        found += [o.only(~near(o, centres[far], 2.0 * spacing)) for o in over]
    else:
        unsure = centres[distance > options.unsure * spacing]
        found.append(_open_space(space, measured, unsure, centres[far], options.beside * spacing, table_z))
    return Targets(
        **{name: np.concatenate([getattr(t, name) for t in found]) for name in ("points", "normals", "areas")}
    )


def near(targets: Targets, places: np.ndarray | None, reach: float) -> np.ndarray:
    """Which targets lie within `reach` [m] of one of the places (k, 3), shape (m,)."""
    if places is None or len(places) == 0 or len(targets) == 0:
        return np.zeros(len(targets), bool)
    return cKDTree(places).query(targets.points)[0] <= reach


def drawn(targets: Targets, most: int, rng: np.random.Generator) -> Targets:
    """At most so many, drawn by area, for all of the area."""
    if len(targets) <= most:
        return targets
    edges = np.cumsum(targets.areas)
    marks = (np.arange(most) + rng.random(most)) / most * edges[-1]
    drawn = targets.only(np.minimum(np.searchsorted(edges, marks), len(targets) - 1))
    return replace(drawn, areas=np.full(most, edges[-1] / most))


def _open_space(
    space: Space,
    measured: np.ndarray,
    unsure: np.ndarray,
    known: np.ndarray,
    beside: float,
    table_z: float,
) -> Targets:
    """The frontier's cells beside surface that is not measured, on their free side; those beside the known
    targets say nothing new.
    """
    frontier = space.frontier(measured, near=unsure, reach=beside)
    keep = frontier.points[:, 2] > table_z + 2.5 * frontier.edge
    if len(known) and len(keep):
        keep &= cKDTree(known).query(frontier.points)[0] > 2.0 * frontier.edge
    normals = frontier.normals[keep]
    return Targets(
        points=frontier.points[keep] + frontier.edge * normals,
        normals=normals,
        areas=np.full(len(normals), frontier.edge**2),
    )


def _over(hole: Hole, step: float) -> Targets:
    """A hole's area, all of it open along the hole's normal."""
    points = _filled(hole, step)
    return Targets(
        points=points, normals=np.tile(hole.normal, (len(points), 1)), areas=np.full(len(points), step**2)
    )


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
