"""Where a part was really put: a few still frames registered against what is known of it.

Guarantees: the pose is trusted only where its share of partners is clearly above that of every other yaw, so
that a body that looks the same from several sides is answered as not known. Assumes that the part stands as
planned within `TILT` and `SHIFT`; its yaw may be anything.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scanmotion.sensing.corrections.registration import Registration, align, register
from scanmotion.sensing.fusion.fuse import Cloud

TILT = np.deg2rad(8.0)
"""Greatest tilt off the planned pose that is sought [rad]."""
SHIFT = 0.02
"""Greatest shift off the planned place that is sought [m]."""
_YAWS = 24
_COARSE_POINTS, _COARSE_TURNS = 700, 8
_REACH = 0.05
"""Partners of a first guess are sought this far [m]: the shift, and a tilt at the part's rim."""
_BEST = 3
"""So many of the coarse poses are refined."""
_ON, _BESIDE = 0.0007, 0.006
"""On the known surface is what is no farther along its normal, and no farther from its next point [m]."""
_LEAST = 0.4
"""Less than this share on the known surface is no placement."""
_CLEARLY = 1.3
"""The best pose has so many times the partners of the best other yaw, or it is not trusted."""
_OTHER_RAD = np.deg2rad(10.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredPlacement:
    """Where the part stands, and whether to believe it."""

    X: np.ndarray
    """Takes the frames' points to where the plan expects them, shape (4, 4)."""
    fitness: float
    """Share of the frames' points that lie on the known surface."""
    other: float
    """The best share at another yaw; 0 where there is none."""
    trusted: bool
    uncertainty: float
    """Standard deviation along the worst-known motion, at the rim [m]."""


def measured_placement(frames: Cloud, known: Cloud) -> MeasuredPlacement:
    """Registers still frames against the known surface, from many yaws about the planned pose.

    Args:
        frames: what the still frames measured, in the placement's frame.
        known: what is known of the part, where the plan expects it in the same frame.

    Raises:
        InputError: a cloud has too few points to register.
    """
    coarse = [_from_yaw(frames, known, 2 * np.pi * k / _YAWS) for k in range(_YAWS)]
    coarse.sort(key=lambda item: -item[0])
    tree = cKDTree(known.points)
    best, share = _refined(frames, known, tree, [X for _, X in coarse[:_BEST]])
    # A pose at another yaw has loose partners before it is refined: it counts by what it has then.
    away = [X for _, X in coarse if _angle(X, best.X) > _OTHER_RAD]
    other = 0.0
    if away:
        rival, rival_share = _refined(frames, known, tree, away[:_BEST])
        other = rival_share if _angle(rival.X, best.X) > _OTHER_RAD else 0.0
    return MeasuredPlacement(
        X=best.X,
        fitness=share,
        other=other,
        trusted=bool(share >= max(_CLEARLY * other, _LEAST) and best.trusted),
        uncertainty=best.uncertainty,
    )


def _refined(
    frames: Cloud, known: Cloud, tree: cKDTree, starts: list[np.ndarray]
) -> tuple[Registration, float]:
    """The best registration from some starts, and its share of points that lie on the known surface."""
    fine = [register(frames, known, start=X, reach=0.012) for X in starts]
    shares = [_on_surface(frames, known, tree, item.X) for item in fine]
    best = int(np.argmax(shares))
    return fine[best], shares[best]


def _on_surface(frames: Cloud, known: Cloud, tree: cKDTree, X: np.ndarray) -> float:
    """Share of the frames' points that lie within `_ON` of the known surface and face as it does."""
    points = frames.points @ X[:3, :3].T + X[:3, 3]
    normals = frames.normals @ X[:3, :3].T
    distance, nearest = tree.query(points, distance_upper_bound=_BESIDE)
    hit = np.isfinite(distance)
    normal = known.normals[nearest[hit]]
    off = np.abs(np.einsum("ij,ij->i", points[hit] - known.points[nearest[hit]], normal))
    faces = np.einsum("ij,ij->i", normals[hit], normal) > 0.8
    return float((faces & (off < _ON)).sum() / max(len(points), 1))


def _from_yaw(frames: Cloud, known: Cloud, yaw: float) -> tuple[float, np.ndarray]:
    """Coarse ICP from one yaw: its share of partners and the pose."""
    R = Rotation.from_euler("z", yaw).as_matrix()
    X = np.eye(4)
    X[:3, :3] = R
    middle = _middle(frames)
    X[:3, 3] = _middle(known) - R @ middle
    X[2, 3] = 0.0
    start = np.stack([np.eye(4), X])
    pair = (_thinned(known, 6000), frames)
    found = align(pair, start=start, reach=_REACH, points=_COARSE_POINTS, turns=_COARSE_TURNS)[1]
    return found.fitness, found.X


def _middle(cloud: Cloud) -> np.ndarray:
    """Middle of the cloud's box, shape (3,)."""
    return (cloud.points.min(axis=0) + cloud.points.max(axis=0)).astype(float) / 2


def _thinned(cloud: Cloud, most: int) -> Cloud:
    step = max(1, len(cloud) // most)
    return replace(
        cloud,
        points=cloud.points[::step],
        normals=cloud.normals[::step],
        view_directions=cloud.view_directions[::step],
        counts=cloud.counts[::step],
        cells=None,
    )


def _angle(A: np.ndarray, B: np.ndarray) -> float:
    """Angle between the rotations of two poses [rad]."""
    return float(Rotation.from_matrix(A[:3, :3].T @ B[:3, :3]).magnitude())


def drawn_error(rng: np.random.Generator) -> np.ndarray:
    """How an operator may put the part off its planned pose: tilt, shift, any yaw; shape (4, 4)."""
    azimuth, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0, TILT)
    lean = Rotation.from_rotvec(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
    X = np.eye(4)
    X[:3, :3] = (lean * Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))).as_matrix()
    away, radius = rng.uniform(0, 2 * np.pi), rng.uniform(0, SHIFT)
    X[:2, 3] = radius * np.cos(away), radius * np.sin(away)
    return X
