"""What camera and projector both measure, frame by frame; rays are cast for some frames at once.

Open3D's casts gain by threads only where there are many rays, and hold the interpreter; the compiled loops
about them let go of it. Frames are independent of one another, so that neither threads nor how many frames
are cast at once change anything.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.core.support.threads import allowed_threads, by_pieces
from scanmotion.sensing.simulator.kernels import frame_rays, hull_rows, lit_hits, surely_lit
from scanmotion.sensing.visibility import Scene

T = TypeVar("T")
_FRAMES = 16
"""Frames whose rays are cast at once."""
_SHADOW_END = 1.0 - 3e-4
"""Shadow rays end this share short of the hit, so that the hit does not shade itself."""


class PixelGrid:
    """The pixels' directions x / z and y / z, and the subset cast in each frame."""

    def __init__(self, scanner: Scanner, stride: int) -> None:
        if stride < 1:
            raise ValueError(f"stride {stride}: at least 1 is expected")
        self.width, self.height = scanner.rays
        self.stride = stride
        self.x = np.tan(scanner.fov[0] / 2) * ((2 * np.arange(self.width) + 1) / self.width - 1)
        self.y = np.tan(scanner.fov[1] / 2) * ((2 * np.arange(self.height) + 1) / self.height - 1)

    @property
    def size(self) -> int:
        """Pixels asked for in one frame, on average over the phases."""
        return self.width * self.height // self.stride**2

    def offsets(self, k: int) -> tuple[int, int]:
        """First column and row of frame `k`; for stride 2 successive frames lie apart diagonally."""
        s = self.stride
        step = k % (s * s)
        return step % s, (step + step // s) % s

    def phase(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        a, b = self.offsets(k)
        return self.x[a :: self.stride], self.y[b :: self.stride]

    def pixels(self, k: int, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        a, b = self.offsets(k)
        return ((b + row * self.stride) * self.width + a + column * self.stride).astype(np.int32)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Asked:
    """The rays of one frame that may hit the part."""

    columns: np.ndarray
    """x / z of the pixels' columns, shape (w,)."""
    high: np.ndarray
    """Greatest x / z of the part's outline in each pixel row."""
    rays: np.ndarray
    """Shape (k, 6) float32."""
    column: np.ndarray
    """Shape (k,)."""
    row: np.ndarray
    """Shape (k,)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Hits:
    """What the camera of one frame may measure, and what is still to be asked of the projector."""

    depth: np.ndarray
    """Of all rays, shape (k,)."""
    normals: np.ndarray
    """Of all rays, shape (k, 3)."""
    index: np.ndarray
    """Rays that hit the part in range and inside the incidence, shape (m,)."""
    cosine: np.ndarray
    """Shape (m,)."""
    lit: np.ndarray
    """Which the projector surely lights, shape (m,)."""
    shadow: np.ndarray
    """Rays from the projector to the others, shape (d, 6) float32."""


Measured = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""True depth, cosine of incidence, column, row and normal in O of every pixel that both eyes measure."""


def range_frames(scene: Scene, scanner: Scanner, X_OS: np.ndarray, grid: PixelGrid) -> Iterator[Measured]:
    """What both eyes measure, frame by frame; rays are cast for some frames at once, which threads need."""
    for first in range(0, len(X_OS), _FRAMES):
        poses = X_OS[first : first + _FRAMES]
        asked = _for_each(lambda i, k=first, X=poses: _asked(scene, X[i], *grid.phase(k + i)), len(poses))
        rays = np.concatenate([a.rays for a in asked])
        if len(rays) == 0:
            yield from (_nothing(a) for a in asked)
            continue
        hit = scene.raycaster.cast_rays(rays, nthreads=allowed_threads())
        ends = np.cumsum([0] + [len(a.rays) for a in asked])
        found = [hit[name].numpy() for name in ("t_hit", "geometry_ids", "primitive_normals")]
        hits = _for_each(
            lambda i, X=poses, a=asked, e=ends, f=found: _hits(
                scene, scanner, X[i], a[i], *(values[e[i] : e[i + 1]] for values in f)
            ),
            len(poses),
        )
        free = _free(scene, np.concatenate([h.shadow for h in hits]))
        at = np.cumsum([0] + [len(h.shadow) for h in hits])
        for i, h in enumerate(hits):
            yield _measured(scanner, poses[i], asked[i], h, free[at[i] : at[i + 1]])


def _for_each(work: Callable[[int], T], count: int) -> list[T]:
    """What `work` gives for 0..count, on threads."""
    pieces = by_pieces(lambda a, b: [work(i) for i in range(a, b)], count, least=1)
    return [item for piece in pieces for item in piece]


def _asked(scene: Scene, X_OS: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> _Asked:
    low, high = _spans(X_OS, rows, scene.outline)
    rays, column, row = frame_rays(X_OS, columns, rows, low, high)
    return _Asked(columns=columns, high=high, rays=rays, column=column, row=row)


def _nothing(asked: _Asked) -> Measured:
    none = np.zeros(0, np.float32)
    return none, none, asked.column, asked.row, np.zeros((0, 3), np.float32)


def _hits(
    scene: Scene,
    scanner: Scanner,
    X_OS: np.ndarray,
    asked: _Asked,
    depth: np.ndarray,
    geometry: np.ndarray,
    normals: np.ndarray,
) -> _Hits:
    """The hits of one frame's rays: depths (k,), numbers of what is hit (k,) and its normals (k, 3)."""
    p_OP = _projector(scanner, X_OS)
    index, cosine, shadow = lit_hits(
        asked.rays, depth, geometry, normals, p_OP, *scanner.range, np.cos(scanner.max_incidence), 0
    )
    lit = np.zeros(len(index), bool)
    nearest = _nearest(scene, X_OS, p_OP)
    if scanner.baseline > 0 and nearest > 1e-3:
        lit = surely_lit(
            depth, asked.column, asked.row, np.ascontiguousarray(asked.columns), asked.high, nearest,
            scanner.baseline,
        )[index]  # fmt: skip
    return _Hits(depth=depth, normals=normals, index=index, cosine=cosine, lit=lit, shadow=shadow[~lit])


def _free(scene: Scene, shadow: np.ndarray) -> np.ndarray:
    """Which rays of the projector nothing stops short of their hit, shape (d,)."""
    if len(shadow) == 0:
        return np.zeros(0, bool)
    blocked = scene.raycaster.test_occlusions(shadow, tnear=0.0, tfar=_SHADOW_END, nthreads=allowed_threads())
    return ~blocked.numpy()


def _measured(scanner: Scanner, X_OS: np.ndarray, asked: _Asked, hits: _Hits, free: np.ndarray) -> Measured:
    lit, index = hits.lit.copy(), hits.index
    lit[~hits.lit] = free
    if scanner.mirror > 0:
        p_OP = _projector(scanner, X_OS)
        lit &= ~_blinding(asked.rays[index], hits.depth[index], hits.normals[index], p_OP, scanner.mirror)
    index = index[lit]
    return hits.depth[index], hits.cosine[lit], asked.column[index], asked.row[index], hits.normals[index]


def _projector(scanner: Scanner, X_OS: np.ndarray) -> np.ndarray:
    return X_OS[:3, 3] + scanner.baseline * X_OS[:3, 0]


def _nearest(scene: Scene, X_OS: np.ndarray, p_OP: np.ndarray) -> float:
    """Least depth of the part; 0 where it is not known, or where table or pedestal may shade it too.

    Both are below z = 0 of O and lie off every way from a part above it to a projector above it.
    """
    if scene.outline is None:
        return 0.0
    if np.isfinite(scene.table_z) and not (p_OP[2] > 0 and scene.outline[:, 2].min() > -1e-5):
        return 0.0
    return float(((scene.outline - X_OS[:3, 3]) @ X_OS[:3, 2]).min())


def _spans(X_OS: np.ndarray, rows: np.ndarray, outline: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """In each pixel row, the interval of x / z that the part's convex hull fills; all of it where unknown."""
    everything = np.full(len(rows), -np.inf), np.full(len(rows), np.inf)
    if outline is None:
        return everything
    p_S = (outline - X_OS[:3, 3]) @ X_OS[:3, :3]
    if p_S[:, 2].min() < 1e-3:
        return everything
    low, high = hull_rows(p_S[:, :2] / p_S[:, 2:], rows)
    return low - 1e-6, high + 1e-6


def _blinding(
    rays: np.ndarray, depth: np.ndarray, normals: np.ndarray, p_OP: np.ndarray, mirror: float
) -> np.ndarray:
    """Where the mirror image of the projector lies within `mirror` [rad] of the camera, shape (k,) bool.

    Args:
        rays: from the camera, shape (k, 6); their parameter is the depth.
        depth: shape (k,) [m].
        normals: shape (k, 3).
        p_OP: place of the projector in O, shape (3,) [m].
        mirror: half angle.
    """
    camera = -depth[:, None] * rays[:, 3:]
    projector = p_OP - (rays[:, :3] - camera)
    half = sum(v / np.linalg.norm(v, axis=1, keepdims=True) for v in (camera, projector))
    return np.einsum("ij,ij->i", half, normals) >= np.cos(mirror) * np.linalg.norm(half, axis=1)
