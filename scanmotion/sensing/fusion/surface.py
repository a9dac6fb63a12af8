"""Surface reconstruction from the fused cloud, trimmed to the data, and the coloured deviation mesh."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.geometry.files.ply_write import ply_data, replaced
from scanmotion.sensing.assess import signed_distances
from scanmotion.sensing.fusion.fuse import Cloud


def surface(cloud: Cloud, *, depth: int = 9, trim: float = 0.004) -> tuple[np.ndarray, np.ndarray]:
    """Screened Poisson surface without the parts that no data supports: it closes every hole by itself.

    Kazhdan and Hoppe 2013 (doi 10.1145/2487228.2487237), as Open3D has it.

    Args:
        cloud: with outward normals.
        depth: of the octree; the cells are about 1.1 * extent / 2^depth.
        trim: vertices farther than this from the data are cut off [m].

    Returns:
        vertices (v, 3) [m] and triangles (t, 3).

    Raises:
        InputError: fewer than 100 points.
    """
    import open3d as o3d

    if len(cloud) < 100:
        raise InputError(f"{len(cloud)} points are too few for a surface")
    raw = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(cloud.points, float)))
    raw.normals = o3d.utility.Vector3dVector(np.asarray(cloud.normals, float))
    # One thread: the sums of several come in any order and change the last digits.
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(raw, depth=depth, n_threads=1)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    far = cKDTree(cloud.points).query(vertices, distance_upper_bound=trim)[0] > trim
    triangles = triangles[~far[triangles].any(axis=1)]
    used = np.unique(triangles)
    rank = np.full(len(vertices), -1, np.int64)
    rank[used] = np.arange(len(used))
    return vertices[used], rank[triangles]


@dataclass(frozen=True, eq=False, kw_only=True)
class DeviationMesh:
    """A measured surface coloured by its distance from the reference."""

    vertices: np.ndarray
    triangles: np.ndarray
    distance: np.ndarray
    """Signed distance of each vertex, positive outside, shape (v,) [m]."""
    colors: np.ndarray
    """Red outside, blue inside, pale where it fits, shape (v, 3) uint8."""
    limit: float
    """Distance of the full colour [m]."""

    def save(self, path: str | Path) -> None:
        """Writes a binary PLY in millimetres with the distances as `quality` [mm]."""
        replaced(Path(path), self.data())

    def data(self) -> bytes:
        """The PLY that `save` writes."""
        return ply_data(
            self.vertices * 1e3, triangles=self.triangles, colors=self.colors, quality=self.distance * 1e3
        )


def deviation_mesh(
    vertices: np.ndarray, triangles: np.ndarray, part: Part, *, limit: float = 0.5e-3
) -> DeviationMesh:
    """Colours a measured surface (or a cloud, with triangles (0, 3)) by its distance from the reference.

    Args:
        vertices: shape (v, 3) [m].
        triangles: shape (t, 3).
        part: the reference mesh.
        limit: distance of the full colour [m].

    Raises:
        InputError: the part is a cloud.
    """
    d = signed_distances(vertices, part)
    x = np.clip(d / limit, -1.0, 1.0)[:, None]
    pale, red, blue = np.array([235.0, 235, 235]), np.array([178.0, 24, 43]), np.array([33.0, 102, 172])
    colors = np.where(x > 0, pale + x * (red - pale), pale - x * (blue - pale))
    return DeviationMesh(
        vertices=np.asarray(vertices), triangles=np.asarray(triangles), distance=d,
        colors=np.rint(colors).astype(np.uint8), limit=limit,
    )  # fmt: skip
