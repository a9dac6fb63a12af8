"""The part: a surface to be scanned, in the object frame O in metres; and samples of its surface."""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.read_report import ReadReport


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """A triangle mesh or a point cloud in frame O (z up, on the table at z = 0, table axis at x = y = 0)."""

    name: str
    vertices: np.ndarray
    """Mesh vertices or cloud points in O, shape (n, 3) [m]."""
    triangles: np.ndarray
    """Vertex indices, counter-clockwise seen from outside, shape (m, 3); (0, 3) for a cloud."""
    normals: np.ndarray | None = None
    """Outward unit normals of a cloud's points, shape (n, 3), where the file has them."""
    X_OI: np.ndarray | None = None
    """Similarity from the file's frame and unit to O, shape (4, 4); None is the identity."""
    closed: bool = True
    """Whether a mesh is watertight (a cloud never is)."""
    repairs: tuple[str, ...] = ()
    """What was mended while loading, one sentence each."""
    report: ReadReport | None = None
    """What was read from which file; None for a part made in memory."""

    def __post_init__(self) -> None:
        for name in ("vertices", "triangles", "normals", "X_OI"):
            value = getattr(self, name)
            if value is not None:
                value = np.array(value)
                value.setflags(write=False)
                object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        size = " x ".join(f"{side * 1e3:.0f}" for side in self.extent)
        what = f"{len(self.triangles)} triangles" if self.is_mesh else f"{len(self.vertices)} points"
        return f"Part({self.name!r}, {what}, {size} mm)"

    @property
    def is_mesh(self) -> bool:
        return len(self.triangles) > 0

    @property
    def bounds(self) -> np.ndarray:
        """Least and greatest corner of the box in O, shape (2, 3) [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extent(self) -> np.ndarray:
        """Sides L, W, H of the box along x, y, z of O, shape (3,) [m]."""
        return np.ptp(self.bounds, axis=0)

    @property
    def radius(self) -> float:
        """Greatest distance of the surface from the table's axis [m]."""
        return float(np.linalg.norm(self.vertices[:, :2], axis=1).max())


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfaceSamples:
    """Points spread uniformly by area over a mesh; each stands for `area` of the surface."""

    points: np.ndarray
    """Shape (n, 3) [m]."""
    normals: np.ndarray
    """Outward unit normals, shape (n, 3)."""
    area: float
    """Area per sample [m2]."""
