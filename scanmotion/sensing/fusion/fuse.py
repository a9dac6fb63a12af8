"""Fusion: all scans in one frame -> one cloud with normals, on the surface that the raw points agree on."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.core.support.threads import allowed_threads
from scanmotion.sensing.fusion.moving_least_squares import fitted
from scanmotion.sensing.fusion.voxels import averaged, extent, grouped
from scanmotion.sensing.simulator.simulate import Scan


@dataclass(frozen=True, eq=False, kw_only=True)
class Cloud:
    """A fused scan: one point per occupied voxel."""

    points: np.ndarray
    """Shape (n, 3) [m]."""
    normals: np.ndarray
    """Outward unit normals, shape (n, 3)."""
    view_directions: np.ndarray
    """Mean unit vector from the point to the cameras that saw it, shape (n, 3)."""
    counts: np.ndarray
    """Raw points in the voxel, shape (n,)."""
    cells: np.ndarray | None = None
    """Which voxel each point stands for, its corner at edge * cells, shape (n, 3) int32; None: not known."""

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False, kw_only=True)
class RawPoints:
    """Measured points of many frames in one frame of reference."""

    points: np.ndarray
    """Shape (n, 3) [m]."""
    frame: np.ndarray
    """Index into `cameras`, shape (n,)."""
    cameras: np.ndarray
    """Where each frame was seen from, shape (f, 3) [m]."""
    sigma: np.ndarray
    """Expected standard deviation of each point, up to one common factor, shape (n,) [m]."""


def fuse(scans: Sequence[Scan], *, voxel: float = 0.002, radius: float | None = None) -> Cloud:
    """Merges scans that are expressed in one frame.

    Raw points are grouped by voxels. Each voxel's mean is moved along the normal onto a quadratic surface
    fitted through the raw points within `radius`, weighted by distance and 1 / sigma^2 with Tukey's robust
    weights: the mean alone lies inside of curved surfaces.

    Args:
        scans: of `simulate`, or read from files.
        voxel: edge [m].
        radius: of the fit [m]; None for one voxel.

    Raises:
        InputError: no points, or the voxel is not a positive number.
    """
    return fuse_points(joined_points(scans), voxel=voxel, radius=radius)


def joined_points(scans: Sequence[Scan]) -> RawPoints:
    """The raw points of several scans with the noise that is to be expected of each, by its depth.

    Raises:
        InputError: no scans.
    """
    if not scans:
        raise InputError("no scans to fuse")
    first = np.cumsum([0, *(len(s.captures) for s in scans)])
    points = _stacked([s.points_O for s in scans])
    frame = _stacked([s.frame + np.int32(o) for s, o in zip(scans, first, strict=False)])
    depth = _stacked([s.depth for s in scans])
    cameras = np.ascontiguousarray(_stacked([s.captures.X_OS[:, :3, 3] for s in scans]))
    return RawPoints(points=points, frame=frame, cameras=cameras, sigma=expected_sigma(depth))


def _stacked(arrays: list[np.ndarray]) -> np.ndarray:
    """Joins without a copy where there is one only."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def expected_sigma(depth: np.ndarray) -> np.ndarray:
    """Standard deviation of a point by its depth, method.md section 6, at normal incidence [m]."""
    return np.hypot(0.05e-3 * (depth / 0.4) ** 2, 1.5e-4 * depth).astype(np.float32)


def fuse_points(raw: RawPoints, *, voxel: float = 0.002, radius: float | None = None) -> Cloud:
    """As `fuse`, for raw points of any origin.

    Raises:
        InputError: no points, or the voxel is not a positive number.
    """
    if not np.isfinite(voxel) or voxel <= 0:
        raise InputError(f"voxel {voxel:g} m: a positive length is expected")
    if len(raw.points) == 0:
        raise InputError("no points to fuse")
    low, shape = _grid(raw.points, voxel)
    spots = _fitted(raw, low, shape, voxel, min(radius or voxel, voxel))
    points, view, start = spots.points, spots.view, spots.start
    normals, lone = _sparse_spots(points, spots.normals, view, spots.misfit < 0, voxel)
    keep = np.logical_not(lone)
    cells = np.rint(low / voxel) + np.stack(np.unravel_index(spots.unique[keep], shape), axis=1)
    return Cloud(
        points=points[keep], normals=normals[keep], view_directions=view[keep],
        counts=np.diff(start)[keep],
        cells=cells.astype(np.int32),
    )  # fmt: skip


def _sparse_spots(
    points: np.ndarray, normals: np.ndarray, view: np.ndarray, unfitted: np.ndarray, voxel: float
) -> tuple[np.ndarray, np.ndarray]:
    """Normals of the voxels that hold too few points for a fit, and which voxels stand alone.

    A sparse spot has other voxels about it and takes its normal from theirs; a flying pixel has not: fewer
    than three within three edges.
    """
    lone = np.zeros(len(points), bool)
    where = np.flatnonzero(unfitted)
    if len(where) == 0:
        return normals, lone
    if len(points) < 4:
        lone[where] = True
        return normals, lone
    d, k = cKDTree(points).query(points[where], k=min(9, len(points)))
    near = d <= 3.0 * voxel
    lone[where] = near.sum(axis=1) < 4
    weight = near[..., None] / near.sum(axis=1)[:, None, None]
    offset = points[k] - (weight * points[k]).sum(axis=1)[:, None]
    fit = np.linalg.eigh(np.einsum("nki,nkj->nij", weight * offset, offset))[1][:, :, 0]
    fit *= np.where(np.einsum("ij,ij->i", fit, view[where]) < 0, -1.0, 1.0)[:, None]
    normals[where] = fit
    return normals, lone


@dataclass(frozen=True, eq=False, kw_only=True)
class SpotPoints:
    """Raw points that lie in spots of the surface, and their height over them."""

    point: np.ndarray
    """Index of the raw point in the joined scans, shape (k,)."""
    spot: np.ndarray
    """Index of its spot, ascending, shape (k,)."""
    frame: np.ndarray
    """Index of its frame over all scans, shape (k,)."""
    height: np.ndarray
    """Over the surface fitted through the spot, shape (k,) [m]."""
    normals: np.ndarray
    """Of the spots, shape (s, 3)."""


def surface_groups(scans: Sequence[Scan], *, voxel: float) -> SpotPoints:
    """Raw points by voxel with their height over the surface that is fitted there.

    Raises:
        InputError: no voxel holds points of two frames on a surface.
    """
    raw = joined_points(scans)
    low, shape = _grid(raw.points, voxel)
    spots = _fitted(raw, low, shape, voxel, voxel)
    points, normals, start, order = spots.points, spots.normals, spots.start, spots.order
    spot = np.repeat(np.arange(len(points)), np.diff(start))
    frames = raw.frame[order]
    several = np.maximum.reduceat(frames, start[:-1]) > np.minimum.reduceat(frames, start[:-1])
    # Points seen from behind the spot belong to the far side of a thin wall.
    towards = raw.cameras[frames] - raw.points[order]
    keep = (several & (spots.misfit > 0))[spot] & (np.einsum("ij,ij->i", towards, normals[spot]) > 0)
    if not keep.any():
        raise InputError("no spot of the surface was seen by two frames: nothing to calibrate from")
    spot, point = spot[keep], order[keep]
    height = np.einsum("ij,ij->i", raw.points[point] - points[spot], normals[spot])
    return SpotPoints(point=point, spot=spot, frame=frames[keep], height=height, normals=normals)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Spots:
    """Occupied voxels and the surface fitted through each; see `grouped`, `averaged`, `fitted`."""

    unique: np.ndarray
    start: np.ndarray
    order: np.ndarray
    view: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    misfit: np.ndarray


def _fitted(raw: RawPoints, low: np.ndarray, shape: np.ndarray, voxel: float, radius: float) -> _Spots:
    """Runs the compiled fit on threads; each voxel is fitted for itself, so their number changes nothing."""
    unique, start, order = grouped(raw.points, low, voxel, shape)
    points, view, rows, frames = averaged(raw.points, raw.frame, raw.cameras, raw.sigma, start, order)
    normals, misfit = np.empty_like(points), np.empty(len(points))
    ends = np.linspace(0, len(points), 9).astype(int)

    def one(first: int, last: int) -> None:
        fitted(
            first, last, radius, rows, frames, raw.cameras, unique, shape, start, view, points, normals,
            misfit,
        )  # fmt: skip

    with ThreadPoolExecutor(max_workers=allowed_threads()) as pool:
        list(pool.map(one, ends[:-1], ends[1:]))
    return _Spots(
        unique=unique, start=start, order=order, view=view, points=points, normals=normals, misfit=misfit
    )


def _grid(points: np.ndarray, voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """Corner and cells of the grid: its planes are multiples of the voxel, whatever the points' extent."""
    least, most = extent(points)
    low = np.floor(least / voxel - 0.5)
    cells = np.floor(most / voxel) - low + 2
    if not (cells <= 2_000_000).all():
        raise InputError(f"voxel {voxel:g} m is too small for a cloud of {(most - least).max():g} m")
    cells = cells.astype(np.int64)
    return low.astype(np.float64) * voxel, cells
