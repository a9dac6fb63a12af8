"""The two steps on a mesh with the scan twin alone: no arm, every pose is reached."""

import numpy as np

from scanmotion.cell.settings.cell import load_cell
from scanmotion.cell.view_costs import view_costs
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.sensing.free_space import Space
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.fusion.merge import merged
from scanmotion.sensing.simulator.captures import Captures, ScanErrors
from scanmotion.sensing.simulator.images import depth_images
from scanmotion.sensing.simulator.simulate import simulate
from scanmotion.sensing.visibility import revolution_poses, scene_from
from scanmotion.views.next_best_views import LocalStep, local_step

STRIDE, VOXEL, TABLE = 4, 0.004, 0.76
SCANNER = Scanner()
AROUND = TableGeometry(radius=TABLE)
COSTS = view_costs(load_cell("kr240"))


def block_with_pit(size, pit, *, lean=0.0):
    """A block with a rectangular pit in its top, whose bottom is moved by `lean` along x."""
    ring = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    outer, inner, top = ring * size[:2], ring * pit[:2], size[2]
    layers = ((outer, 0.0), (outer, top), (inner, top), (inner + [lean, 0.0], top - pit[2]))
    vertices = np.vstack([np.column_stack([xy, np.full(4, z)]) for xy, z in layers])
    triangles = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for low in (0, 4, 8):
        for i in range(4):
            a, b = low + i, low + (i + 1) % 4
            triangles += [[a, b, b + 4], [a, b + 4, a + 4]]
    return Part(name="pit", vertices=vertices, triangles=np.array(triangles))


def boxes(*given):
    """Vertices and triangles of boxes (low corner, high corner), together."""
    vertices, triangles = [], []
    for k, (low, high) in enumerate(given):
        one = box_part(*(np.array(high) - low))
        vertices.append(one.vertices + [*(np.array(low) + high)[:2] / 2, low[2]])
        triangles.append(one.triangles + 8 * k)
    return np.concatenate(vertices), np.concatenate(triangles)


def blocked(blocks, a, b):
    """Whether a box stands between two places, by slabs: slow, and nobody else's code."""
    for low, high in blocks:
        enter, leave = 1e-6, 1.0
        for k in range(3):
            step = b[k] - a[k]
            if abs(step) < 1e-15:
                if not low[k] <= a[k] <= high[k]:
                    enter, leave = 1.0, 0.0
                continue
            s, t = sorted(((low[k] - a[k]) / step, (high[k] - a[k]) / step))
            enter, leave = max(enter, s), min(leave, t)
        if enter < leave:
            return True
    return False


def frames(part, X_OS, scanner, *, stride=1):
    """What perfect frames at poses (n, 4, 4) measure: points (m, 3), and depth images."""
    n = len(X_OS)
    captures = Captures(
        t=np.arange(n) / 10, X_WS=X_OS, table_angle=np.zeros(n), X_WT=np.eye(4), X_TO=np.eye(4)
    )
    scan = simulate(
        part, scanner, captures, errors=ScanErrors.none(), stride=stride, rng=np.random.default_rng(0)
    )
    return np.asarray(scan.points_O, float), depth_images(scan, scanner, stride=stride)


class Rounds:
    """What the scans have shown so far, and the local steps taken on it."""

    def __init__(self, part: Part, *, samples: int = 8000, seed: int = 0, scanner: Scanner = SCANNER) -> None:
        self.part, self.rng, self.scanner = part, np.random.default_rng(seed), scanner
        self.scene = scene_from(part.vertices, part.triangles, table_radius=TABLE)
        self.samples = surface_samples(part, samples, rng=np.random.default_rng(seed + 1))
        self.seen = np.zeros(samples, bool)
        self.space = Space(scanner, edge=VOXEL, stride=STRIDE)
        self.cloud, self.model, self.claimed = None, None, None
        self.steps: list[LocalStep] = []

    def look(self, X_OS: np.ndarray) -> None:
        """Takes frames at poses (n, 4, 4)."""
        n = len(X_OS)
        captures = Captures(
            t=np.arange(n) / 10, X_WS=X_OS, table_angle=np.zeros(n), X_WT=np.eye(4), X_TO=np.eye(4)
        )
        scan = simulate(
            self.scene, self.scanner, captures,
            stride=STRIDE, rng=self.rng, samples=self.samples, known=self.seen,
        )  # fmt: skip
        self.seen |= scan.seen
        self.space.add(captures.X_OS, depth_images(scan, self.scanner, stride=STRIDE))
        new = fuse([scan], voxel=VOXEL)
        self.cloud = new if self.cloud is None else merged(self.cloud, new, voxel=VOXEL)

    def turn(self, views) -> None:
        """A whole turn of the table at each viewpoint."""
        self.look(np.concatenate([revolution_poses(v.X_OS, 60) for v in views]))

    def local(self, **options) -> LocalStep:
        """Chooses viewpoints, and takes their frames."""
        assert self.cloud is not None
        step = local_step(
            self.cloud.points, self.cloud.normals, (), self.scanner, spacing=VOXEL, table=AROUND,
            costs=COSTS, space=self.space, claimed=self.claimed, model=self.model, rng=self.rng, **options,
        )  # fmt: skip
        self.claimed = step.claimed if self.claimed is None else np.concatenate([self.claimed, step.claimed])
        self.model = step.model
        self.steps.append(step)
        for v in step.viewpoints:
            self.look(revolution_poses(v.X_OS, 60) if v.kind == "revolution" else np.tile(v.X_OS, (6, 1, 1)))
        return step
