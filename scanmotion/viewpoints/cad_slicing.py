"""CAD slicing, one of the methods that the paper compares with: passes round horizontal slices of the mesh.

After Xi and Shu, Computer-Aided Design 31 (1999) 473-479, known here from its abstract: bands no taller than
the field of view, the offset of each band's profile by the standoff, views along it. Needs the true mesh, and
sees neither top nor bottom.
"""

import numpy as np
from scipy.spatial import ConvexHull

from scanmotion.errors import PartError
from scanmotion.part import Part, surface_samples
from scanmotion.scanner import Scanner
from scanmotion.viewpoints.stepped_rotary import UPRIGHT
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint, look_at

_OVERLAP = 0.10


def cad_slicing(
    part: Part, scanner: Scanner, *, standoff: float = 0.7, table_z: float = 0.0
) -> tuple[Viewpoint, ...]:
    """Views round each band's convex profile, `standoff` before it.

    Args:
        part: the true mesh.
        scanner: field of view; its long side stands upright and sets the bands.
        standoff: from the profile [m].
        table_z: height of the table's top; views below it are left out.

    Raises:
        PartError: the part is a cloud.
    """
    if not part.is_mesh:
        raise PartError("CAD slicing needs the true mesh")
    tall, wide = (float(side) * (1 - _OVERLAP) for side in scanner.field(standoff))
    # Vertices alone miss bands that a large triangle crosses.
    points = surface_samples(part, 20_000, rng=np.random.default_rng(0)).points
    low, high = part.bounds[:, 2]
    bands = max(1, int(np.ceil((high - low) / tall - 1e-9)))
    edges = np.linspace(low, high, bands + 1)
    views: list[Viewpoint] = []
    for b in range(bands):
        inside = points[(points[:, 2] >= edges[b]) & (points[:, 2] <= edges[b + 1])]
        z = max((edges[b] + edges[b + 1]) / 2, table_z + 0.09)
        for p, direction in _around(inside[:, :2], standoff, wide):
            X_OS = look_at(np.array([*p, z]), np.array([*direction, 0.0]), roll=UPRIGHT)
            views.append(
                Viewpoint(
                    id=f"C{len(views) + 1}", X_OS=X_OS, standoff=standoff, step="global", kind="station",
                    slack=Slack(roll=False), note=f"band {b + 1} of {bands}",
                )
            )  # fmt: skip
    return tuple(views)


def _around(profile: np.ndarray, standoff: float, width: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions and inward directions on a convex profile's offset, at most `width` apart on the profile."""
    if len(profile) < 3:
        return []
    corners = profile[ConvexHull(profile).vertices]
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    around = np.concatenate([[0.0], np.cumsum(lengths)])
    n = max(4, int(np.ceil(around[-1] / width)))
    marks = (np.arange(n) + 0.5) / n * around[-1]
    side = np.clip(np.searchsorted(around, marks, side="right") - 1, 0, len(lengths) - 1)
    at = corners[side] + ((marks - around[side]) / lengths[side])[:, None] * sides[side]
    # The profile's normal over a field's width: a polygon's own would jump at its corners.
    ahead = _along(corners, around, lengths, sides, marks + width / 2)
    behind = _along(corners, around, lengths, sides, marks - width / 2)
    tangent = ahead - behind
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    return [(p + standoff * o, -o) for p, o in zip(at, outward, strict=True)]


def _along(
    corners: np.ndarray, around: np.ndarray, lengths: np.ndarray, sides: np.ndarray, marks: np.ndarray
) -> np.ndarray:
    """Points of a closed polygon at distances `marks` along it."""
    marks = np.mod(marks, around[-1])
    side = np.clip(np.searchsorted(around, marks, side="right") - 1, 0, len(lengths) - 1)
    return corners[side] + ((marks - around[side]) / lengths[side])[:, None] * sides[side]
