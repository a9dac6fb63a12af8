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
from scanmotion.sensing.simulator.captures import (
    Captures,
    ScanErrors,
    captures_from_trajectory,
    still_captures,
    true_poses,
)
from scanmotion.sensing.simulator.kernels import placed
from scanmotion.sensing.simulator.range_frames import PixelGrid, range_frames
from scanmotion.sensing.visibility import Scene, scene_from, seen_by_any

__all__ = ["Captures", "Scan", "ScanErrors", "captures_from_trajectory", "simulate", "still_captures"]


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
    grid = PixelGrid(scanner, stride)
    moving = captures.body_rates if scanner.exposure or scanner.rolling else None
    frames = []
    for k, (depth, cosine, column, row, normal) in enumerate(range_frames(scene, scanner, X_true, grid)):
        columns, rows = grid.phase(k)
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
