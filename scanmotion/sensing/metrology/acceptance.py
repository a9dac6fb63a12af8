"""A simulated acceptance test: ball bars and a plane scanned by the twin, before the robot moves.

Ball bars in seven places and a plane in three, as VDI/VDE 2634 part 3 asks for, are scanned in turns of the
table from three heights, fused as every scan is, and judged by `artefacts`. Guarantees: the same figures as
on real measurements, from the same code. Assumes: the errors that the cell's section twin states; reach and
collisions are not asked for; the balls float, the bar between them is left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.streams import Streams
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.metrology.artefacts import BallBar, Plane, ball_bar_from, plane_from
from scanmotion.sensing.simulator.captures import ScanErrors, motion
from scanmotion.sensing.simulator.simulate import simulate
from scanmotion.sensing.simulator.turns import turn_captures
from scanmotion.sensing.visibility import scene_from

DIAMETER, SPACING = 0.05, 0.3
"""Of the ball bar [m]: between a tenth and a fifth, and more than a third, of the measured volume's
diagonal."""
_PLANE = (0.3, 0.2)


@dataclass(frozen=True, kw_only=True)
class Table:
    """How the table turns and how often frames are taken."""

    speed: float
    """[rad/s]."""
    acceleration: float
    """[rad/s2]."""
    fps: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Acceptance:
    """What the artefacts showed."""

    bars: tuple[BallBar, ...]
    planes: tuple[Plane, ...]

    def record(self) -> dict[str, float]:
        """The greatest of each figure [mm], which is what an acceptance test holds against its limit."""
        balls = [b for bar in self.bars for b in bar.balls]
        figures = {
            "probing form PF": max(b.form_all for b in balls),
            "P_Form.Sph.D95%": max(b.form_95 for b in balls),
            "probing size PS": max((b.size_error or 0.0 for b in balls), key=abs),
            "sphere spacing SD, D_CC": max((bar.spacing_error or 0.0 for bar in self.bars), key=abs),
            "flatness F": max(p.flatness for p in self.planes),
            "D_Form.Pla.D95%": max(p.form_95 for p in self.planes),
        }
        return {k: round(v * 1e3, 5) for k, v in figures.items()}


def acceptance(
    scanner: Scanner,
    table: Table,
    errors: ScanErrors,
    *,
    stride: int = 4,
    seed: int = 0,
    progress: Callable[[float], None] = lambda f: None,
) -> Acceptance:
    """Scans all artefacts in all places.

    Args:
        scanner: of the cell.
        table: its motion.
        errors: of the cell's twin.
        stride: every n-th pixel.
        seed: of the noise.
        progress: told the share done.
    """
    bars, planes = bar_poses(), plane_poses()
    found_bars, found_planes = [], []
    for k, X in enumerate([*bars, *planes]):
        rng = Streams(seed=seed).child("acceptance", k)
        if k < len(bars):
            p = _scanned(_bar(X), scanner, table, errors, stride, rng)
            found_bars.append(ball_bar_from(p, diameter=DIAMETER, spacing=SPACING))
        else:
            found_planes.append(
                plane_from(_front(_scanned(_board(X), scanner, table, errors, stride, rng), X))
            )
        progress((k + 1) / (len(bars) + len(planes)))
    return Acceptance(bars=tuple(found_bars), planes=tuple(found_planes))


def bar_poses() -> list[np.ndarray]:
    """Seven places of the bar (its length along x of each pose): flat, upright, and both diagonals, (4, 4) in
    O.
    """
    places = [
        (0.0, 0.0, 0.08, 0.0, 0.0), (0.0, 0.0, 0.35, np.pi / 2, 0.0), (0.12, 0.0, 0.25, 0.0, np.pi / 2),
        (0.0, 0.0, 0.22, 0.0, np.pi / 4), (0.0, 0.0, 0.22, np.pi / 2, np.pi / 4), (0.0, 0.15, 0.2, 0.0, 0.0),
        (0.0, -0.1, 0.25, np.pi / 4, -np.pi / 5),
    ]  # fmt: skip
    return [_pose(p) for p in places]


def plane_poses() -> list[np.ndarray]:
    """Three places of the board (its face along +z of each pose): upright, leaning, and off the axis, (4, 4)
    in O.
    """
    places = [
        (0.0, 0.0, 0.2, 0.0, -np.pi / 2),
        (0.0, 0.0, 0.2, 2.0, -np.pi / 3),
        (0.15, 0.0, 0.2, 0.0, -np.pi / 2),
    ]
    return [_pose(p) for p in places]


def _pose(place: Sequence[float]) -> np.ndarray:
    """At (x, y, z), turned by yaw about z, then by pitch about the own -y [m, rad]."""
    x, y, z, yaw, pitch = place
    turn = motion(np.array([[0, 0, 0, 0, 0, yaw]]))[0] @ motion(np.array([[0, 0, 0, 0, -pitch, 0]]))[0]
    return motion(np.array([[x, y, z, 0, 0, 0]]))[0] @ turn


def ball_mesh(radius: float, centre: np.ndarray, *, rings: int = 72) -> tuple[np.ndarray, np.ndarray]:
    """A sphere's vertices (n, 3) [m] and triangles (m, 3); chords lie within 0.1 % of the radius."""
    theta = np.linspace(0, np.pi, rings + 1)[1:-1]
    phi = 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    T, P = np.meshgrid(theta, phi, indexing="ij")
    ring = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=-1).reshape(-1, 3)
    w, n = len(phi), len(ring)
    i, j = (m.ravel() for m in np.meshgrid(np.arange(rings - 2), np.arange(w), indexing="ij"))
    a, b = i * w + j, i * w + (j + 1) % w
    j = np.arange(w)
    top = np.column_stack([np.full(w, n), j, (j + 1) % w])
    last = (rings - 2) * w
    end = np.column_stack([np.full(w, n + 1), last + (j + 1) % w, last + j])
    triangles = np.concatenate([np.column_stack([a, a + w, b]), np.column_stack([b, a + w, b + w]), top, end])
    return np.vstack([ring, [[0, 0, 1], [0, 0, -1]]]) * radius + centre, triangles


def _bar(X: np.ndarray) -> Part:
    ends = [X[:3, 3] + s * SPACING / 2 * X[:3, 0] for s in (-1, 1)]
    (v, t), (w, u) = (ball_mesh(DIAMETER / 2, e) for e in ends)
    return Part(name="ball bar", vertices=np.vstack([v, w]), triangles=np.vstack([t, u + len(v)]))


def _board(X: np.ndarray) -> Part:
    box = box_part(*_PLANE, 0.02)
    v = box.vertices - [0, 0, 0.02]
    return Part(name="board", vertices=v @ X[:3, :3].T + X[:3, 3], triangles=box.triangles)


def _front(points: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Points of the board's face, without its edges."""
    p = (points - X[:3, 3]) @ X[:3, :3]
    return points[(np.abs(p[:, :2]) < np.array(_PLANE) / 2 - 0.006).all(axis=1) & (np.abs(p[:, 2]) < 0.005)]


def _scanned(
    part: Part, scanner: Scanner, table: Table, errors: ScanErrors, stride: int, rng: np.random.Generator
) -> np.ndarray:
    """Fused points of three turns: level, from 35 deg above with the scanner rolled, from 60 deg above."""
    away, middle = min(0.55 * sum(scanner.range), scanner.range[1]), np.array([0.0, 0.0, 0.22])
    scene, scans = scene_from(part.vertices, part.triangles), []
    for k, (down, roll) in enumerate(((0.0, 90.0), (35.0, 0.0), (60.0, 90.0))):
        e = np.deg2rad(down)
        aim = -np.array([np.cos(e), 0.0, np.sin(e)])
        captures = turn_captures(
            look_at(middle - away * aim, aim, roll=np.deg2rad(roll)), speed=table.speed,
            acceleration=table.acceleration, fps=table.fps, sense=(-1) ** k,
        )  # fmt: skip
        scans.append(simulate(scene, scanner, captures, errors=errors, stride=stride, rng=rng))
    return fuse(scans).points
