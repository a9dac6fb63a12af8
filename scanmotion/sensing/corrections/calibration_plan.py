"""Which few turns determine the constant errors best: chosen by information, checked by a simulation.

Guarantees: the deviations that are stated are those of `calibrate` on simulated frames of the chosen turns.
Assumes: an object about as large and as rich in shape as the one that is given; on a plain one less is
determined.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.streams import Streams
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.column_products import column_products
from scanmotion.sensing.corrections.calibration import Calibration, calibrate, prior_information, slopes
from scanmotion.sensing.simulator.captures import ScanErrors
from scanmotion.sensing.simulator.simulate import Scan, simulate
from scanmotion.sensing.simulator.turns import turn_captures
from scanmotion.sensing.visibility import scene_from


@dataclass(frozen=True, eq=False, kw_only=True)
class Turn:
    """A turn of the table seen from one place."""

    X_OS: np.ndarray
    """Pose of the scanner in O at table angle zero, shape (4, 4)."""
    sense: int
    speed: float
    """Of the table [rad/s]."""

    @property
    def name(self) -> str:
        """For people: from how high it looks, roll, sense and speed."""
        z = self.X_OS[:3, 2]
        roll = np.rad2deg(np.arctan2(self.X_OS[2, 0], -self.X_OS[2, 1]))
        way = "forward" if self.sense > 0 else "backward"
        return (
            f"from ({', '.join(f'{v * 1e3:.0f}' for v in self.X_OS[:3, 3])}) mm, "
            f"{-np.rad2deg(np.arcsin(z[2])):.0f} deg down, roll {roll:.0f} deg, "
            f"{way} at {self.speed * 30 / np.pi:.3g} r/min"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibrationPlan:
    """The chosen turns and what they are expected to tell."""

    turns: tuple[Turn, ...]
    expected: Calibration
    """Of simulated frames without constant errors: its deviations are what counts."""


def candidate_turns(part: Part, scanner: Scanner, *, speed: float) -> list[Turn]:
    """Turns from three heights, two rolls and past the axis to either side, both senses, full and third
    speed.

    Args:
        part: gives size and height.
        scanner: gives the distance.
        speed: greatest of the table [rad/s].
    """
    low, high = scanner.range
    away = min(max(low + part.radius * 1.2, 0.5 * (low + high)), high)
    middle = np.array([0.0, 0.0, float(part.bounds[:, 2].mean())])
    found = []
    for k, (down, yaw, roll) in enumerate(
        [(5, 0, 0), (35, 0, 0), (60, 0, 0), (5, 0, 90), (35, 0, 90), (20, 18, 0), (20, -18, 0), (45, 12, 90)]
    ):
        e, y = np.deg2rad([down, yaw])
        p = middle + away * np.array([np.cos(e), 0.0, np.sin(e)])
        aim = -np.array([np.cos(e) * np.cos(y), np.cos(e) * np.sin(y), np.sin(e)])
        X = look_at(p, aim, roll=np.deg2rad(roll))
        for sense in (1, -1):
            found.append(Turn(X_OS=X, sense=sense, speed=speed if (k + sense) % 2 else speed / 3))
    return found


def best_turns(
    part: Part, scanner: Scanner, candidates: Sequence[Turn], *, acceleration: float, fps: float,
    count: int = 4, errors: ScanErrors | None = None, stride: int = 6, seed: int = 0,
) -> CalibrationPlan:  # fmt: skip
    """Chooses turns greedily by the determinant of the information on the constant errors.

    Args:
        part: the object that will stand on the table, or one like it.
        scanner: of the cell.
        candidates: turns that the cell can make.
        count: of turns to choose.
        acceleration: of the table [rad/s2].
        fps: frames a second.
        errors: noise of the scanner and arm; None for the stated one.
        stride: every n-th pixel is simulated.
        seed: of the noise.

    Raises:
        InputError: fewer candidates than turns to choose, or nothing overlaps.
    """
    if not 2 <= count <= len(candidates):
        raise InputError(f"{count} turns of {len(candidates)} candidates: at least 2 are to be chosen")
    scene = scene_from(part.vertices, part.triangles)
    scans = []
    for k, turn in enumerate(candidates):
        captures = turn_captures(
            turn.X_OS,
            speed=turn.speed,
            acceleration=acceleration,
            fps=fps * min(1.0, turn.speed),
            sense=turn.sense,
        )
        rng = Streams(seed=seed).child("calibration_turn", k)
        scans.append(
            simulate(scene, scanner, captures, errors=errors or ScanErrors(), stride=stride, rng=rng)
        )
    chosen: list[int] = []
    information = _informations(scans)
    while len(chosen) < count:
        worth = {k: information((*chosen, k)) for k in range(len(scans)) if k not in chosen}
        chosen.append(max(worth, key=lambda k: (worth[k], -k)))
    expected = calibrate([scans[k] for k in chosen], voxel=0.006, turns=2, latency=True)
    return CalibrationPlan(turns=tuple(candidates[k] for k in chosen), expected=expected)


def _informations(scans: Sequence[Scan]):
    """A function that gives log det of the information of some of the scans, by their indices."""
    J, spot, frame, sigma = slopes(scans, voxel=0.006)
    first = np.cumsum([0, *(len(s.captures) for s in scans)])
    owner = np.searchsorted(first, frame, side="right") - 1
    prior = prior_information()
    scale = np.sqrt(np.diag(prior))

    def worth(which: tuple[int, ...]) -> float:
        rows = np.isin(owner, which)
        j, s = J[rows] / scale, spot[rows]
        count = np.maximum(np.bincount(s), 1)
        means = (
            np.stack([np.bincount(s, weights=j[:, i]) for i in range(j.shape[1])], axis=1) / count[:, None]
        )
        j = j - means[s]
        return float(np.linalg.slogdet(column_products(j, j) / sigma**2 + np.eye(len(scale)))[1])

    return worth
