"""A measured scan that is given as a file, not made by the twin."""

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.part import Part
from scanmotion.core.support.streams import fixed_stream
from scanmotion.core.support.threads import allowed_threads
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.boundary import oriented_normals
from scanmotion.sensing.holes.sampling import even_samples

_NEIGHBOURS = 8
_MOST_SAMPLES = 400_000
"""A mesh is resampled by at most about so many points."""


def cloud_from_part(part: Part, *, spacing: float) -> Cloud:
    """A measured scan as a cloud with normals.

    A mesh is resampled evenly, never taken by its vertices; normals that a cloud lacks are oriented by a
    spanning tree.

    Args:
        part: a mesh or a cloud.
        spacing: of a mesh's samples [m]; wider where they would be too many.

    Raises:
        HoleError: normals cannot be oriented.
    """
    if part.is_mesh:
        a, b, c = (part.vertices[part.triangles[:, i]] for i in range(3))
        area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
        spacing = max(spacing, float(np.sqrt(area / _MOST_SAMPLES)))
        # Thinned random samples lie between one and two least distances apart.
        points, normals = even_samples(
            part.vertices, part.triangles, 0.75 * spacing, rng=fixed_stream("scan_from_mesh")
        )
    else:
        points = part.vertices
        normals = part.normals if part.normals is not None else oriented_normals(points)
    return Cloud(
        points=np.asarray(points, float), normals=np.asarray(normals, float),
        view_directions=np.asarray(normals, float), counts=np.ones(len(points), np.int64),
    )  # fmt: skip


def spacing_of(points: np.ndarray, *, least: float) -> float:
    """Square root of the surface that a point stands for where the cloud is sparse, but at least `least` [m].

    Args:
        points: shape (n, 3) [m].
        least: what finer clouds are given [m].

    Returns:
        The 95th percentile over the points: where parts of a scan lie double, its single parts decide.
    """
    k = min(_NEIGHBOURS, len(points) - 1)
    distance = cKDTree(points).query(points, k + 1, workers=allowed_threads())[0][:, -1]
    # k neighbours and half of the point itself share a disc that reaches to the last of them.
    return max(float(np.percentile(distance * np.sqrt(np.pi / (k + 0.5)), 95)), least)
