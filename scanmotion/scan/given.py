"""A measured scan that is given as a file, not made by the twin."""

import numpy as np

from scanmotion.part import Part, surface_samples
from scanmotion.scan.fuse import Cloud
from scanmotion.viewpoints.boundary import oriented_normals


def cloud_from_part(part: Part) -> Cloud:
    """A measured scan as a cloud with normals.

    A mesh is resampled uniformly, never taken by its vertices; normals that a cloud lacks are oriented by a
    spanning tree.

    Raises:
        HoleError: normals cannot be oriented.
    """
    if part.is_mesh:
        area = np.linalg.norm(
            np.cross(
                part.vertices[part.triangles[:, 1]] - part.vertices[part.triangles[:, 0]],
                part.vertices[part.triangles[:, 2]] - part.vertices[part.triangles[:, 0]],
            ),
            axis=1,
        ).sum()
        n = int(np.clip(area / 2 / 2e-6, 5_000, 400_000))
        samples = surface_samples(part, n, rng=np.random.default_rng(0))
        points, normals = samples.points, samples.normals
    else:
        points = part.vertices
        normals = part.normals if part.normals is not None else oriented_normals(points)
    return Cloud(
        points=np.asarray(points, float), normals=np.asarray(normals, float),
        view_directions=np.asarray(normals, float), counts=np.ones(len(points), np.int64),
    )  # fmt: skip
