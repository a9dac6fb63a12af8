"""Shaded orthographic pictures of a mesh or a cloud, and what became of each piece of its surface."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.support.threads import allowed_threads
from scanmotion.planning.plan import Plan
from scanmotion.report.figures.palette import HIDDEN, MISSED, SEEN_GLOBAL, SEEN_LOCAL, STATUS_COLOURS, rgb

STATUS_RGB = np.array([rgb(c) for c in STATUS_COLOURS])


def status_of_samples(plan: Plan, *, after: str = "final") -> np.ndarray:
    """What became of each surface sample of a plan, shape (n,) int, values of `palette`.

    Args:
        plan: a Plan whose part was scanned by the twin.
        after: "global" or "final": at which end.
    """
    assert plan.visible is not None
    status = np.where(plan.visible, MISSED, HIDDEN)
    if after == "final" and plan.seen is not None:
        status[plan.seen] = SEEN_LOCAL
    status[plan.seen_globally] = SEEN_GLOBAL
    return status


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """An orthographic picture's geometry: the camera far away, its image plane through the part's centre."""

    right: np.ndarray
    up: np.ndarray
    toward: np.ndarray
    """Unit vector from the part to the camera."""
    center: np.ndarray
    scale: float
    """Metres per pixel."""
    shape: tuple[int, int]
    """Rows and columns."""

    def pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns, rows (as floats) and heights toward the camera [m] of points (n, 3)."""
        p = np.asarray(points) - self.center
        rows, cols = self.shape
        return p @ self.right / self.scale + cols / 2, rows / 2 - p @ self.up / self.scale, p @ self.toward


def view_of(
    part: Part, *, azimuth: float, elevation: float, pixels: int = 360, scale: float | None = None
) -> View:
    """A view from `azimuth` (0 is +x of O) and `elevation` [deg] that just holds the part.

    Args:
        part: what is looked at.
        azimuth: [deg].
        elevation: [deg].
        pixels: along the picture's longer side, unless `scale` is given.
        scale: metres per pixel.
    """
    a, e = np.deg2rad([azimuth, elevation])
    toward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.cross(toward, right)
    center = part.bounds.mean(axis=0)
    p = part.vertices - center
    wide, high = 2.08 * np.abs(p @ right).max(), 2.08 * np.abs(p @ up).max()
    size = max(wide, high, 1e-6) / pixels if scale is None else scale
    shape = (max(int(high / size), 16), max(int(wide / size), 16))
    return View(right=right, up=up, toward=toward, center=center, scale=size, shape=shape)


@dataclass(frozen=True, eq=False, kw_only=True)
class Picture:
    """What the pixels of a view show."""

    view: View
    hit: np.ndarray
    """Shape (rows, cols) bool."""
    points: np.ndarray
    """Surface points of the hit pixels, shape (k, 3) [m]."""
    normals: np.ndarray
    """Unit normals there, towards the camera, shape (k, 3)."""
    height: np.ndarray
    """Height toward the camera, shape (rows, cols), -inf where nothing is hit [m]."""


def picture_of(part: Part, view: View) -> Picture:
    """Casts a ray through each pixel; a cloud is splatted instead."""
    return _cast(part, view) if part.is_mesh else _splat(part, view)


@lru_cache(maxsize=1)
def _scene_of(part: Part) -> Any:
    """An Open3D RaycastingScene of the mesh, made once for all pictures of it."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=allowed_threads())
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(tensor(part.vertices.astype(np.float32)), tensor(part.triangles.astype(np.uint32)))
    return scene


def _cast(part: Part, view: View) -> Picture:
    import open3d as o3d

    scene, tensor = _scene_of(part), o3d.core.Tensor.from_numpy
    rows, cols = view.shape
    far = 2.0 * float(np.linalg.norm(part.extent)) + 1.0
    y, x = np.mgrid[0:rows, 0:cols]
    origins = (
        view.center
        + ((x - cols / 2 + 0.5) * view.scale)[..., None] * view.right
        + ((rows / 2 - y - 0.5) * view.scale)[..., None] * view.up
        + far * view.toward
    )
    rays = np.concatenate([origins, np.broadcast_to(-view.toward, origins.shape)], axis=-1)
    answer = scene.cast_rays(tensor(rays.astype(np.float32)), nthreads=allowed_threads())
    t = answer["t_hit"].numpy()
    hit = np.isfinite(t)
    normals = answer["primitive_normals"].numpy()[hit]
    points = origins[hit] - t[hit][:, None] * view.toward
    height = np.where(hit, far - t, -np.inf)
    return Picture(view=view, hit=hit, points=points, normals=_facing(normals, view), height=height)


def _splat(part: Part, view: View) -> Picture:
    """Each point covers 3 x 3 pixels; the one nearest to the camera stays."""
    column, row, height = view.pixels(part.vertices)
    rows, cols = view.shape
    top = np.full((rows + 2, cols + 2), -np.inf)
    index = np.full((rows + 2, cols + 2), -1)
    order = np.argsort(height, kind="stable")
    r0, c0 = np.clip(row.astype(int), 0, rows - 1), np.clip(column.astype(int), 0, cols - 1)
    for dr in range(3):
        for dc in range(3):
            cell = (r0[order] + dr, c0[order] + dc)
            nearer = height[order] > top[cell]
            # Within one offset the highest comes last in `order`, and numpy keeps the last one assigned.
            cell, winners = (cell[0][nearer], cell[1][nearer]), order[nearer]
            top[cell], index[cell] = height[winners], winners
    index, top = index[1:-1, 1:-1], top[1:-1, 1:-1]
    hit = index >= 0
    chosen = index[hit]
    normals = _relief_normals(top, hit, view) if part.normals is None else part.normals[chosen]
    return Picture(
        view=view, hit=hit, points=part.vertices[chosen], normals=_facing(normals, view), height=top
    )


def _relief_normals(height: np.ndarray, hit: np.ndarray, view: View) -> np.ndarray:
    """Normals of the hit pixels from the slope of their smoothed heights, shape (k, 3)."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(hit.astype(float), 1.5)
    smooth = gaussian_filter(np.where(hit, height, 0.0), 1.5) / np.maximum(weight, 1e-9)
    down, right = (np.gradient(smooth, view.scale, axis=k) for k in (0, 1))
    normals = view.toward - right[hit][:, None] * view.right + down[hit][:, None] * view.up
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _facing(normals: np.ndarray, view: View) -> np.ndarray:
    away = normals @ view.toward < 0
    return np.where(away[:, None], -normals, normals)


def shaded(picture: Picture, colours: np.ndarray) -> np.ndarray:
    """An RGBA image in [0, 1]: `colours` (k, 3) of the hit pixels under a lamp beside the camera."""
    view = picture.view
    lamp = view.toward + 0.5 * view.up - 0.4 * view.right
    lamp = lamp / np.linalg.norm(lamp)
    light = 0.35 + 0.65 * np.clip(picture.normals @ lamp, 0.0, 1.0)
    image = np.zeros((*view.shape, 4))
    image[picture.hit, :3] = np.clip(colours * light[:, None], 0.0, 1.0)
    image[picture.hit, 3] = 1.0
    return image


def nearest_status(
    points: np.ndarray, normals: np.ndarray, samples: SurfaceSamples, status: np.ndarray
) -> np.ndarray:
    """Status of the sample nearest to each point; a different normal counts as far: sharp edges stay."""
    tree = cKDTree(np.hstack([samples.points, 0.02 * samples.normals]))
    return status[tree.query(np.hstack([points, 0.02 * normals]), workers=allowed_threads())[1]]


def status_image(part: Part, view: View, samples: SurfaceSamples, status: np.ndarray) -> np.ndarray:
    """The part from one side, coloured by what became of its surface."""
    picture = picture_of(part, view)
    return shaded(picture, STATUS_RGB[nearest_status(picture.points, picture.normals, samples, status)])


def plain_image(part: Part, view: View) -> tuple[np.ndarray, Picture]:
    """The part from one side in light grey, and its picture for what is drawn on top."""
    picture = picture_of(part, view)
    return shaded(picture, np.full((len(picture.points), 3), 0.85)), picture


def in_sight(picture: Picture, points: np.ndarray, *, tolerance: float = 0.006) -> np.ndarray:
    """Which points lie on the side that the picture shows, shape (n,) bool; points over empty pixels do."""
    column, row, height = picture.view.pixels(points)
    rows, cols = picture.view.shape
    r, c = np.clip(row.astype(int), 0, rows - 1), np.clip(column.astype(int), 0, cols - 1)
    return height >= picture.height[r, c] - tolerance
