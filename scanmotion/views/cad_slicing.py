"""CAD slicing, one of the methods that the paper compares with: passes round horizontal slices of the mesh.

After Xi and Shu, Computer-Aided Design 31 (1999) 473-479, known here from its abstract: bands no taller than
the field of view, the offset of each band's profile by the standoff, a pass along that offset. Needs the true
mesh, and has no view from above or below.
"""

import numpy as np
from scipy.spatial import ConvexHull

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.streams import fixed_stream
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.views.stepped_rotary import UPRIGHT

_OVERLAP = 0.10


def cad_slicing(
    part: Part, scanner: Scanner, *, standoff: float | None = None, table_z: float = 0.0
) -> tuple[Viewpoint, ...]:
    """Views along the offset of each band's convex profile, at most a field's width apart.

    Args:
        part: the true mesh.
        scanner: field of view; its long side stands upright and sets the bands.
        standoff: from the profile [m]; None for the middle of the range.
        table_z: height of the table's top; views below it are left out.

    Raises:
        PartError: the part is a cloud.
    """
    if not part.is_mesh:
        raise PartError("CAD slicing needs the true mesh")
    standoff = scanner.middle if standoff is None else standoff
    tall, wide = (float(side) * (1 - _OVERLAP) for side in scanner.field(standoff))
    # Vertices alone miss bands that a large triangle crosses.
    points = surface_samples(part, 20_000, rng=fixed_stream("slicing_samples")).points
    low, high = part.bounds[:, 2]
    bands = max(1, int(np.ceil((high - low) / tall - 1e-9)))
    edges = np.linspace(low, high, bands + 1)
    views: list[Viewpoint] = []
    for b in range(bands):
        inside = points[(points[:, 2] >= edges[b]) & (points[:, 2] <= edges[b + 1])]
        z = max((edges[b] + edges[b + 1]) / 2, table_z + 0.09)
        for p, direction in _offset(inside[:, :2], standoff, wide):
            X_OS = look_at(np.array([*p, z]), np.array([*direction, 0.0]), roll=UPRIGHT)
            views.append(
                Viewpoint(
                    id=f"C{len(views) + 1}", X_OS=X_OS, standoff=standoff, step="global", kind="station",
                    slack=Slack(roll=False), note=f"band {b + 1} of {bands}",
                )
            )  # fmt: skip
    return tuple(views)


def _offset(profile: np.ndarray, standoff: float, width: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions on the offset of a convex profile, evenly spaced by at most `width`, and inward directions.

    The offset of a polygon is its sides moved outwards and an arc round every corner.
    """
    if len(profile) < 3:
        return []
    corners = profile[ConvexHull(profile).vertices]
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    # Side i starts at corner i; its outward normal's angle, and the turn at the corner after it.
    angle = np.arctan2(-sides[:, 0], sides[:, 1])
    turn = np.mod(np.roll(angle, -1) - angle, 2 * np.pi)
    pieces = np.column_stack([lengths, standoff * turn]).ravel()
    ends = np.cumsum(pieces)
    n = max(4, int(np.ceil(ends[-1] / width)))
    views = []
    for mark in (np.arange(n) + 0.5) / n * ends[-1]:
        i, on_arc = divmod(min(int(np.searchsorted(ends, mark, side="right")), len(pieces) - 1), 2)
        past = mark - (ends[2 * i + on_arc] - pieces[2 * i + on_arc])
        along = lengths[i] if on_arc else past
        a = angle[i] + (past / standoff if on_arc else 0.0)
        out = np.array([np.cos(a), np.sin(a)])
        views.append((corners[i] + along / lengths[i] * sides[i] + standoff * out, -out))
    return views
