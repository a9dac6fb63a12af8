"""What a part sweeps while the table turns: a solid of revolution about the table's axis."""

import numpy as np

from scanmotion.core.part import Part

_SIDES = 48
_ROWS = 40


def swept_part(part: Part) -> Part:
    """The solid that holds the part at every angle of the table, in O.

    Its profile is the greatest radius of the part's vertices and edges in each of some rows of height; it is
    widened by the sagitta of the polygon that stands for the circle.
    """
    low, high = part.bounds[:, 2]
    rows = max(2, min(_ROWS, int(np.ceil((high - low) / 0.01))))
    level = np.linspace(low, high, rows + 1)
    radius = np.zeros(rows)
    corner = part.vertices[part.triangles] if part.is_mesh else part.vertices[:, None]
    reach = np.hypot(corner[..., 0], corner[..., 1]).max(axis=1)
    first = np.clip(np.searchsorted(level, corner[..., 2].min(axis=1), side="right") - 1, 0, rows - 1)
    last = np.clip(np.searchsorted(level, corner[..., 2].max(axis=1), side="left") - 1, 0, rows - 1)
    for k in range(int((last - first).max()) + 1):
        row = np.minimum(first + k, last)
        np.maximum.at(radius, row, reach)
    radius = np.maximum(radius, 0.005) / np.cos(np.pi / _SIDES)
    # Each row is a band of its greatest radius: between bands the profile steps.
    profile = np.column_stack([np.repeat(radius, 2), np.repeat(level, 2)[1:-1]])
    vertices, triangles = _revolved(profile)
    return Part(name=part.name, vertices=vertices, triangles=triangles)


def _revolved(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a closed solid with this profile of (radius, height), bottom to top."""
    a = 2 * np.pi * np.arange(_SIDES) / _SIDES
    rings = [np.column_stack([r * np.cos(a), r * np.sin(a), np.full(_SIDES, z)]) for r, z in profile]
    vertices = np.concatenate([*rings, [[0, 0, profile[0, 1]], [0, 0, profile[-1, 1]]]])
    i, j = np.arange(_SIDES), (np.arange(_SIDES) + 1) % _SIDES
    triangles = []
    for k in range(len(profile) - 1):
        b, t = k * _SIDES, (k + 1) * _SIDES
        triangles += [np.column_stack([b + i, b + j, t + j]), np.column_stack([b + i, t + j, t + i])]
    n, top = len(vertices), (len(profile) - 1) * _SIDES
    triangles.append(np.column_stack([np.full(_SIDES, n - 2), j, i]))
    triangles.append(np.column_stack([np.full(_SIDES, n - 1), top + i, top + j]))
    return vertices, np.concatenate(triangles)
