"""Candidates of the local step: poses about what is unseen, and whole turns past it."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.sensing.holes.find import Hole
from scanmotion.sensing.visibility import Scene, free_lines, hemisphere, sees, tangents, turns_see
from scanmotion.views.stepped_rotary import FAR, UPRIGHT, oblique_turn, range_gap
from scanmotion.views.targets import Targets

log = logging.getLogger(__name__)

Reachable = Callable[[np.ndarray], np.ndarray]
"""Tells which poses X_OS (n, 4, 4) the robot reaches, shape (n,)."""
ASKED = 48
"""Candidates of which reach is asked at once."""
_CONE = np.deg2rad(65.0)
_TURN = 30
"""Poses by which a whole turn is scored."""
_STANDOFFS = (1 / 12, 11 / 30, 2 / 3)
"""Shares of the scanner's range at which the camera stands off a seed: what lies behind it needs the rest."""
_BESIDE = (1 / 12, 0.95)
"""Shares of the range between which an eye beside the table may stand off its seed."""
_HEIGHTS = (0.02, 0.07, 0.13)
"""Heights of eyes beside the table over its top [m]."""
_TILTS = np.deg2rad([-20.0, -8.0, 5.0, 18.0, 32.0, 46.0, 60.0, 75.0])
_YAWS = np.deg2rad([-30.0, -15.0, 0.0, 15.0, 30.0])


def _spread(points: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most `most` points, each the farthest from those before it."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < min(most, len(points)) and distance.max() > 0.012:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


@dataclass(frozen=True, kw_only=True)
class CandidateOptions:
    """How finely candidates are sought."""

    seeds: int = 120
    """Most places around which stations are made."""
    directions: int = 160
    """Directions tried about each seed's normal; narrow shafts want many."""
    standoffs: tuple[float, ...] | None = None
    """Distances of the camera from the seed [m]; None: spread over the scanner's range."""
    rolls: int = 4
    """Rolls tried about each line of sight; the projector must see the seed too."""
    per_seed: int = 36
    """Most stations kept of one seed."""


class Candidates:
    """Poses, what each sees of the targets, and what the robot reaches of them: asked where it matters."""

    def __init__(
        self, X_OS: np.ndarray, turns: np.ndarray, sees: np.ndarray, reachable: Reachable | None
    ) -> None:
        self.X_OS, self.turns, self.sees = X_OS, turns, sees
        """Poses (n, 4, 4), which of them are whole turns (n,), which sees which target (n, m)."""
        self._reachable = reachable
        self.known = np.full(len(X_OS), reachable is None)
        self.reached = np.full(len(X_OS), reachable is None)

    def ask(self, index: np.ndarray) -> None:
        """Finds out whether the robot reaches these."""
        index = index[~self.known[index]]
        if len(index) and self._reachable is not None:
            self.reached[index] = self._reachable(self.X_OS[index])
            self.known[index] = True


def candidates(
    scene: Scene,
    scanner: Scanner,
    targets: Targets,
    *,
    solid: np.ndarray,
    holes: Sequence[Hole] = (),
    reachable: Reachable | None = None,
    table: TableGeometry,
    options: CandidateOptions | None = None,
    promised: Scanner | None = None,
) -> Candidates:
    """Poses with free lines from both eyes to their seed, and whole turns.

    Guarantees: stations stand off their seeds inside the scanner's own range, whatever that is, and no eye is
    where the table or the housing's room about it forbids. Reach is not tested here.

    Args:
        scene: what blocks sight.
        scanner: range, field, baseline, incidence.
        targets: what is to be seen.
        solid: points of the surface, shape (k, 3): turns are laid by its radius and height.
        holes: their centres are seeds too, along their normals.
        reachable: of the robot; None for all.
        table: where it is, and the room beside it.
        options: how finely.
        promised: the scanner with something of its range and incidence kept in hand, by which seeing is
            promised; None for the scanner itself.
    """
    options, promised = options or CandidateOptions(), promised or scanner
    stations = _stations(scene, scanner, targets, holes, table, options)
    turns = _turns(solid, promised, table)
    seen = np.concatenate(
        [
            sees(scene, promised, stations, targets.points, targets.normals),
            turns_see(scene, promised, turns, targets.points, targets.normals, poses=_TURN),
        ]
    )
    if len(targets) and not seen.any():
        near, far = scanner.range
        log.warning(
            "none of %d candidate viewpoints sees any of what was missed with a scanner of %g to %g m",
            len(seen), near, far,
        )  # fmt: skip
    kinds = np.concatenate([np.zeros(len(stations), bool), np.ones(len(turns), bool)])
    return Candidates(np.concatenate([stations, turns]), kinds, seen, reachable)


def _stations(
    scene: Scene,
    scanner: Scanner,
    targets: Targets,
    holes: Sequence[Hole],
    table: TableGeometry,
    options: CandidateOptions,
) -> np.ndarray:
    """Poses about seeds spread over the targets, shape (n, 4, 4)."""
    index = _spread(targets.points, options.seeds)
    aims = np.concatenate([targets.points[index], *(h.center[None] for h in holes[:40])])
    faces = np.concatenate([targets.normals[index], *(h.normal[None] for h in holes[:40])])
    cone = hemisphere(int(options.directions / (1 - np.cos(_CONE))))
    cone = np.vstack([[0, 0, 1.0], cone[cone[:, 2] >= np.cos(_CONE)]])
    x, y = tangents(faces)
    u = cone[None, :, :1] * x[:, None] + cone[None, :, 1:2] * y[:, None] + cone[None, :, 2:] * faces[:, None]
    seed = np.repeat(np.arange(len(aims)), len(cone))
    standoffs = _share_of_range(scanner, _STANDOFFS) if options.standoffs is None else options.standoffs
    eyes = [(seed, (aims[:, None] + d * u).reshape(-1, 3)) for d in standoffs]
    eyes += [_beside(aims, faces, table, h, _share_of_range(scanner, _BESIDE)) for h in _HEIGHTS]
    seed, eye = np.concatenate([e[0] for e in eyes]), np.concatenate([e[1] for e in eyes])
    standing = _standing(eye, table)
    seed, eye = seed[standing], eye[standing]
    start = aims + 0.001 * faces
    free = free_lines(scene, start[seed], eye)
    return _both_eyes(scene, scanner, aims, start, seed[free], eye[free], table.z, options)


def _share_of_range(scanner: Scanner, shares: Sequence[float]) -> tuple[float, ...]:
    """Distances at shares of the scanner's range, to the tenth of a millimetre [m]."""
    return tuple(round(scanner.range[0] + share * scanner.depth, 4) for share in shares)


def _both_eyes(
    scene: Scene,
    scanner: Scanner,
    aims: np.ndarray,
    start: np.ndarray,
    seed: np.ndarray,
    eye: np.ndarray,
    table_z: float,
    options: CandidateOptions,
) -> np.ndarray:
    """Poses at `eye` whose projector has a free line too, thinned evenly seed by seed, shape (n, 4, 4)."""
    line = aims[seed] - eye
    z = line / np.linalg.norm(line, axis=1, keepdims=True)
    side, up = tangents(z)
    poses, owner = [], []
    for roll in 2 * np.pi * np.arange(options.rolls) / options.rolls:
        # At roll 0 the long side is horizontal, as `look_at` has it.
        x = np.cos(roll) * side + np.sin(roll) * up
        projector = eye + scanner.baseline * x
        ok = projector[:, 2] > table_z + 0.01
        ok[ok] = free_lines(scene, start[seed[ok]], projector[ok])
        X = np.tile(np.eye(4), (int(ok.sum()), 1, 1))
        X[:, :3, 0], X[:, :3, 1], X[:, :3, 2], X[:, :3, 3] = x[ok], np.cross(z[ok], x[ok]), z[ok], eye[ok]
        poses.append(X)
        owner.append(seed[ok])
    pose, of = np.concatenate(poses), np.concatenate(owner)
    kept = []
    for k in range(len(aims)):
        mine = np.flatnonzero(of == k)
        if len(mine) > options.per_seed:
            mine = mine[np.linspace(0, len(mine) - 1, options.per_seed).astype(int)]
        kept.append(mine)
    return pose[np.concatenate(kept)] if kept else pose


def _standing(eye: np.ndarray, table: TableGeometry) -> np.ndarray:
    """Where an eye (..., 3) can be: well above the table, or beside it and hardly below its top."""
    beside = np.linalg.norm(eye[..., :2], axis=-1) > table.radius + table.rim_near
    return eye[..., 2] > table.z + np.where(beside, table.eye_beside, table.eye_above)


def _beside(
    aims: np.ndarray, faces: np.ndarray, table: TableGeometry, height: float, within: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Eyes beside the table that look up under what faces down: (seed of each, (n, 3))."""
    azimuth = 2 * np.pi * np.arange(24) / 24
    eye = np.empty((len(aims), 24, 3))
    eye[..., :2] = np.column_stack([np.cos(azimuth), np.sin(azimuth)]) * (table.radius + table.rim_far)
    eye[..., 2] = table.z + height
    line = eye - aims[:, None]
    distance = np.linalg.norm(line, axis=2)
    ok = (distance < within[1]) & (distance > within[0])
    ok &= np.einsum("ijk,ik->ij", line, faces) > 0.36 * distance
    i, j = np.nonzero(ok)
    return i, eye[i, j]


def _turns(solid: np.ndarray, scanner: Scanner, table: TableGeometry) -> np.ndarray:
    """Whole turns at many inclinations, offsets, distances, heights and both rolls, shape (n, 4, 4)."""
    radius = float(np.linalg.norm(solid[:, :2], axis=1).max())
    top = float(solid[:, 2].max())
    near, far = scanner.range
    # Three heights are enough where the field is as tall as a third of the part.
    aims = np.linspace(0.2, 0.8, max(3, int(np.ceil(top / float(scanner.field(scanner.middle)[0])))))
    floor, poses = table.z + _HEIGHTS[0], []
    for tilt in _TILTS:
        close = near + radius * np.cos(tilt) + range_gap(scanner)
        for distance in dict.fromkeys((close, max(FAR * far, close))):
            for aim in aims:
                for yaw in _YAWS:
                    for roll in (0.0, UPRIGHT):
                        X = oblique_turn(
                            tilt, yaw, aim * top, distance, radius=radius, floor=floor, roll=roll
                        )
                        if _standing(X[:3, 3], table):
                            poses.append(X)
    return np.array(poses).reshape(-1, 4, 4)
