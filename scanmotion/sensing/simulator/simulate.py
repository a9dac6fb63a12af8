"""The scan twin: range images along the captured poses, as camera and projector would measure them.

The model is stated in docs/method.md, "The scan twin": a pixel is measured where camera and projector both
see the surface, in range and inside the greatest incidence; noise along the ray is
sigma (z / z_near)^2 / max(cos, 0.3), with one scale error and one pose error per frame; measured at the true
pose, expressed with the nominal one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.threads import allowed_threads
from scanmotion.sensing.simulator.captures import (
    Captures,
    ScanErrors,
    captures_from_trajectory,
    still_captures,
    true_poses,
)
from scanmotion.sensing.simulator.kernels import frame_rays, hull_rows, lit_hits, placed, surely_lit
from scanmotion.sensing.visibility import Scene, scene_from, seen_by_any

__all__ = ["Captures", "Scan", "ScanErrors", "captures_from_trajectory", "simulate", "still_captures"]

_SHADOW_END = 1.0 - 3e-4
"""Shadow rays end this share short of the hit, so that the hit does not shade itself."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scan:
    """All points measured along a set of captures, frame by frame."""

    points_O: np.ndarray
    """Measured points, expressed with the nominal poses, shape (n, 3) float32 [m]."""
    frame: np.ndarray
    """Index of the capture of each point, ascending, shape (n,) int32."""
    depth: np.ndarray
    """Measured depth along +z of S, shape (n,) float32 [m]."""
    pixel: np.ndarray
    """Row * columns + column of the full range image, shape (n,) int32."""
    captures: Captures
    seen: np.ndarray
    """Which surface samples camera and projector see in some true pose, shape (m,) bool."""
    rays: int
    """How many pixels were asked for."""

    def __len__(self) -> int:
        return len(self.points_O)

    @property
    def view_directions(self) -> np.ndarray:
        """Unit vectors from each point to the nominal camera, shape (n, 3) float32."""
        towards = self.captures.X_OS[:, :3, 3].astype(np.float32)[self.frame] - self.points_O
        return towards / np.linalg.norm(towards, axis=1, keepdims=True)

    def range_image(self, frame: int, scanner: Scanner) -> np.ndarray:
        """Depths of one frame, NaN where nothing was measured, shape (rows, columns) float32 [m]."""
        image = np.full(scanner.rays[0] * scanner.rays[1], np.nan, np.float32)
        one = slice(*np.searchsorted(self.frame, [frame, frame + 1]))
        image[self.pixel[one]] = self.depth[one]
        return image.reshape(scanner.rays[1], scanner.rays[0])


def simulate(
    part_or_scene: Part | Scene,
    scanner: Scanner,
    captures: Captures,
    *,
    errors: ScanErrors | None = None,
    stride: int = 2,
    rng: np.random.Generator,
    samples: SurfaceSamples | None = None,
    known: np.ndarray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Scan:
    """What the scanner measures along the captures.

    Args:
        part_or_scene: a mesh alone, or the scene with table and pedestal.
        scanner: field, range, incidence, baseline, pixels and noise.
        captures: nominal poses of the frames.
        errors: what is wrong beside the frame scale; None for the stated noise.
        stride: every stride-th pixel in x and y is cast; the phase changes from frame to frame, so that
            stride^2 frames use every pixel once.
        rng: source of all noise.
        samples: surface samples whose visibility is wanted.
        known: which of the samples earlier scans saw, shape (m,) bool: they are not asked again and count as
            seen; None for none.
        progress: told the share of frames done.
    """
    scene = (
        part_or_scene
        if isinstance(part_or_scene, Scene)
        else scene_from(part_or_scene.vertices, part_or_scene.triangles)
    )
    errors = errors or ScanErrors()
    n = len(captures)
    X_true, X_nominal = true_poses(captures, errors, rng), captures.X_OS
    scales = 1.0 + scanner.frame_scale * errors.frame_scale * rng.standard_normal(n)
    grid = _Grid(scanner, stride)
    moving = captures.body_rates if scanner.exposure or scanner.rolling else None
    frames = []
    for k in range(n):
        columns, rows = grid.phase(k)
        depth, cosine, column, row, normal = _range_frame(scene, scanner, X_true[k], columns, rows)
        if moving is not None and moving[k].any():
            ray = np.column_stack([columns[column], rows[row], np.ones(len(depth))])
            slope = _depth_rate(ray, depth, normal @ X_true[k, :3, :3], moving[k])
            instant = scanner.rolling * (rows[row] / (2 * np.tan(scanner.fov[1] / 2)))
            if scanner.exposure:
                instant = instant + scanner.exposure * (rng.random(len(depth)) - 0.5)
            depth = (depth + instant * slope).astype(np.float32)
        noise = rng.standard_normal(len(depth), dtype=np.float32)
        points = np.empty((len(depth), 3), np.float32)
        sigma = scanner.sigma_at_near * errors.range_noise
        measured = np.empty(len(depth), np.float32)
        placed(
            X_nominal[k], columns[column], rows[row], depth, cosine, noise, scales[k], sigma,
            scanner.range[0], points, measured,
        )  # fmt: skip
        frames.append((points, measured, grid.pixels(k, column, row)))
        if progress is not None:
            progress((k + 1) / n)
    count = [len(f[0]) for f in frames]
    return Scan(
        points_O=_joined([f[0] for f in frames], (0, 3), np.float32),
        depth=_joined([f[1] for f in frames], (0,), np.float32),
        pixel=_joined([f[2] for f in frames], (0,), np.int32),
        frame=np.repeat(np.arange(n, dtype=np.int32), count),
        captures=captures,
        seen=_seen(scene, scanner, X_true, samples, known),
        rays=grid.size * n,
    )


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


def _depth_rate(ray: np.ndarray, depth: np.ndarray, normal: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """How fast the depth of each pixel changes while the surface, flat about the pixel, moves, shape (k,)
    [m/s].

    Args:
        ray: directions with z = 1 in S, shape (k, 3).
        depth: shape (k,) [m].
        normal: of the surface in S, shape (k, 3).
        rate: of the scanner against the object along S, velocity and angular velocity, shape (6,).
    """
    surface = -(rate[:3] + np.cross(rate[3:], ray * depth[:, None]))
    facing = np.einsum("ij,ij->i", normal, ray)
    return np.einsum("ij,ij->i", normal, surface) / np.where(
        np.abs(facing) < 0.1, np.copysign(0.1, facing), facing
    )


def _joined(arrays: list[np.ndarray], empty: tuple[int, ...], dtype: type) -> np.ndarray:
    return np.concatenate(arrays) if arrays else np.zeros(empty, dtype)


class _Grid:
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


def _range_frame(
    scene: Scene,
    scanner: Scanner,
    X_OS: np.ndarray,
    columns: np.ndarray,
    rows: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """True depth, cosine of incidence, column, row and normal in O of every pixel that both eyes measure."""
    low, high = _spans(X_OS, rows, scene.outline)
    rays, column, row = frame_rays(X_OS, columns, rows, low, high)
    if len(rays) == 0:
        return np.zeros(0, np.float32), np.zeros(0, np.float32), column, row, np.zeros((0, 3), np.float32)
    rays_hit, hit = rays, scene.raycaster.cast_rays(rays, nthreads=allowed_threads())
    normals = hit["primitive_normals"].numpy()
    depth = hit["t_hit"].numpy()
    p_OP = X_OS[:3, 3] + scanner.baseline * X_OS[:3, 0]
    index, cosine, shadow = lit_hits(
        rays, depth, hit["geometry_ids"].numpy(), normals, p_OP, *scanner.range,
        np.cos(scanner.max_incidence), 0,
    )  # fmt: skip
    lit = np.zeros(len(index), bool)
    nearest = _nearest(scene, X_OS, p_OP)
    if scanner.baseline > 0 and nearest > 1e-3:
        lit = surely_lit(depth, column, row, columns, high, nearest, scanner.baseline)[index]
    doubtful = np.flatnonzero(~lit)
    if len(doubtful):
        rays = shadow[doubtful]
        lit[doubtful] = ~scene.raycaster.test_occlusions(
            rays, tnear=0.0, tfar=_SHADOW_END, nthreads=allowed_threads()
        ).numpy()
    if scanner.mirror > 0:
        lit &= ~_blinding(rays_hit[index], depth[index], normals[index], p_OP, scanner.mirror)
    index, cosine = index[lit], cosine[lit]
    return depth[index], cosine, column[index], row[index], normals[index]


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


def _seen(
    scene: Scene, scanner: Scanner, X_OS: np.ndarray, samples: SurfaceSamples | None, known: np.ndarray | None
) -> np.ndarray:
    if samples is None:
        return np.zeros(0, bool)
    # Poses far apart first: most samples are found early and need not be asked again.
    n = len(X_OS)
    order = np.argsort((np.arange(n) * 0.6180339887498949) % 1.0, kind="stable")
    seen = np.zeros(len(samples.points), bool) if known is None else np.array(known, dtype=bool)
    ask = np.flatnonzero(~seen)
    seen[ask] = seen_by_any(scene, scanner, X_OS[order], samples.points[ask], samples.normals[ask])
    return seen
