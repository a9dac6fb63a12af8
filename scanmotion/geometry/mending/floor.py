"""The plane of a turntable or a floor that was scanned with the part: found below it, and cut off."""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.support.streams import fixed_stream

_TRIES = 400
_TILT = np.cos(np.deg2rad(8.0))
_LEAST_SHARE = 0.04
"""A floor has at least this share of the samples."""
_BELOW = 0.002
"""At most this share lies under it: what has walls down from its rim is a plinth."""
_WIDER = 1.6
"""It reaches over at least so many times the ground that the part stands on."""
_TALL = 0.25
"""What stands on it is at least so tall, as a share of its own width: a relief keeps its ground."""
_THICK = 0.004
"""Of the size of all: what lies so close to the plane belongs to it."""
_MOST = 40_000


@dataclass(frozen=True, eq=False, kw_only=True)
class Floor:
    """A plane n . p = d with the part above it."""

    normal: np.ndarray
    """Unit normal that points up, shape (3,)."""
    offset: float
    thickness: float
    """What lies within this distance over the plane belongs to it."""
    size: float
    """Greater width of the plane."""
    cut: bool
    """Whether it is sure enough to be cut off; else it is only named."""

    def above(self, points: np.ndarray) -> np.ndarray:
        """Which points (n, 3) lie over the plane and do not belong to it."""
        return points @ self.normal - self.offset > self.thickness


def floor_under(points: np.ndarray, up: np.ndarray, *, normals: np.ndarray | None = None) -> Floor | None:
    """The floor under a part, or None.

    A floor is flat, level, has nothing under it, faces up, and is wider than what stands on it. A base that
    is the part's own faces down or has walls down from its rim; a relief is low on its ground.

    Args:
        points: samples of the surface, shape (n, 3).
        up: unit vector, shape (3,).
        normals: of the samples, shape (n, 3), where they are known.
    """
    if len(points) > _MOST:
        keep = np.linspace(0, len(points) - 1, _MOST).astype(int)
        points, normals = points[keep], None if normals is None else normals[keep]
    if len(points) < 200:
        return None
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    plane = _lowest_plane(points, up, _THICK * size)
    if plane is None:
        return None
    normal, offset = plane
    height = points @ normal - offset
    noise = 1.4826 * float(np.median(np.abs(height[np.abs(height) < _THICK * size])))
    thick = min(max(5.0 * noise, 0.001 * size), _THICK * size)
    on, over = np.abs(height) <= thick, height > thick
    if on.mean() < _LEAST_SHARE or (height < -2 * thick).mean() > _BELOW or over.sum() < 50:
        return None
    if normals is not None and (normals[on] @ normal).mean() < 0.5:
        return None
    ground, part = _ground(points[on], normal), _ground(points[over], normal)
    ratio = ground[0] / max(part[0], 1e-300)
    if ratio < _WIDER:
        return None
    tall = float(height[over].max()) > _TALL * part[1]
    return Floor(normal=normal, offset=offset, thickness=float(thick), size=ground[1], cut=tall)


def _lowest_plane(points: np.ndarray, up: np.ndarray, reach: float) -> tuple[np.ndarray, float] | None:
    """The level plane in the lowest third that holds most samples; refined by least squares."""
    z = points @ up
    low = np.flatnonzero(z < z.min() + 0.34 * np.ptp(z))
    if len(low) < 50:
        return None
    rng = fixed_stream("floor_plane")
    some = points[low[rng.integers(len(low), size=min(4000, len(low)))]]
    a, b, c = np.moveaxis(some[rng.integers(len(some), size=(_TRIES, 3))], 1, 0)
    n = np.cross(b - a, c - a)
    length = np.linalg.norm(n, axis=1)
    level = (length > 0) & (np.abs(n @ up) >= _TILT * length)
    if not level.any():
        return None
    n = n[level] * (np.sign(n[level] @ up) / length[level])[:, None]
    offset = np.einsum("ij,ij->i", a[level], n)
    count = np.array([(np.abs(some @ v - d) < reach / 2).sum() for v, d in zip(n, offset, strict=True)])
    best = int(count.argmax())
    found = (n[best], float(offset[best]))
    for shrink in (1.0, 0.5, 0.5):
        near = points[np.abs(points @ found[0] - found[1]) < shrink * reach]
        if len(near) < 10:
            return None
        middle = near.mean(axis=0)
        n = np.linalg.svd(near - middle, full_matrices=False)[2][2]
        n = n * (1.0 if n @ up > 0 else -1.0)
        found = (n, float(middle @ n))
    return found


def _ground(points: np.ndarray, normal: np.ndarray) -> tuple[float, float]:
    """Area of the convex outline on the plane, and its greater width."""
    from scipy.spatial import ConvexHull, QhullError

    axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
    u = np.cross(normal, axis)
    u /= np.linalg.norm(u)
    flat = np.column_stack([points @ u, points @ np.cross(normal, u)])
    width = float(np.ptp(flat, axis=0).max())
    try:
        return float(ConvexHull(flat).volume), width
    except (QhullError, ValueError):
        return 0.0, width
