"""All that is mended in a cloud from a file, in order, with one sentence for each change."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.core.errors import PartError
from scanmotion.core.read_report import counted
from scanmotion.geometry.files.raw import are_numbers
from scanmotion.geometry.mending.floor import floor_under
from scanmotion.geometry.mending.keys import equal_points
from scanmotion.geometry.mending.outward import disagreeing, look_inwards, spacing_of_points
from scanmotion.geometry.mending.specks import cloud_specks

MAX_POINTS = 4_000_000
"""A larger cloud is thinned evenly to about so many points."""
_UNIT = 0.02
_LACKING = 0.5
"""Normals are filled in from neighbours where at most this share lacks them."""
_QUARREL = 0.1
"""Normals of which more look against their neighbour's are no use."""
_CELLS, _OF_SIZE = 8.0, 0.01
"""Points within 8 spacings, or a hundredth of the size, are neighbours when specks are sought."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MendedCloud:
    """Points that are all measured, and what was done for it."""

    points: np.ndarray
    normals: np.ndarray | None
    specks: int = 0
    pieces: int = 1
    turned: int = 0
    dropped: int = 0
    changes: tuple[str, ...] = ()

    def kept(self, keep: np.ndarray, sentence: str) -> "MendedCloud":
        """Without the points that `keep` (n,) leaves out."""
        return replace(
            self, points=self.points[keep], normals=None if self.normals is None else self.normals[keep],
            dropped=self.dropped + int(len(keep) - keep.sum()) if keep.dtype == bool else self.dropped,
            changes=(*self.changes, sentence),
        )  # fmt: skip


def measured_points(points: np.ndarray, normals: np.ndarray | None, path: str = "") -> MendedCloud:
    """The cloud without rows that measure nothing: not finite, zero (where several are), or there before.

    Raises:
        PartError: too few points are left.
    """
    made = MendedCloud(points=points, normals=normals)
    n = len(points)
    bad = np.logical_not(are_numbers(points))
    if bad.any():
        made = made.kept(~bad, f"{int(bad.sum())} of {n} points that are not finite numbers were dropped")
    zero = np.logical_not(made.points.any(axis=1))
    if zero.sum() > 1:
        made = made.kept(~zero, f"{int(zero.sum())} of {n} points at 0, 0, 0 (nothing measured) were dropped")
    if len(made.points) > 3:
        first, _ = equal_points(made.points)
        if len(first) < len(made.points):
            keep = np.zeros(len(made.points), bool)
            keep[first] = True
            made = made.kept(keep, f"{len(keep) - len(first)} points that stand twice were dropped")
    if len(made.points) < 3:
        why = f": {made.changes[0]}" if made.changes else ""
        raise PartError(f"only {len(made.points)} points{why}", path=path)
    return made


def mended_cloud(
    points: np.ndarray,
    normals: np.ndarray | None,
    *,
    up: np.ndarray,
    path: str = "",
    islands: bool = True,
) -> MendedCloud:
    """Drops what measures nothing, thins, leaves out specks and a floor, and checks the normals.

    Args:
        points: shape (n, 3), in any unit.
        normals: as in the file, shape (n, 3).
        up: unit vector in the file's frame, shape (3,).
        path: for the error.
        islands: whether larger pieces that float count too; one scan of several may have such.

    Raises:
        PartError: too few points are left.
    """
    made = thinned_cloud(measured_points(points, normals, path))
    spacing = spacing_of_points(made.points)
    size = float(np.linalg.norm(np.ptp(made.points, axis=0)))
    if len(made.points) > 100 and spacing > 0:
        made = _without_floor(made, up)
        cells = max(_CELLS * spacing, _OF_SIZE * size)
        speck, specks, rest = cloud_specks(made.points, cells, up if islands else None)
        made = replace(made, pieces=rest)
        if specks:
            n = counted(int(speck.sum()), "point")
            said = f"{counted(specks, 'speck')} ({n}) floating off the part left out"
            made = replace(made.kept(~speck, said), specks=specks)
    return with_checked_normals(made)


def _without_floor(made: MendedCloud, up: np.ndarray) -> MendedCloud:
    floor = floor_under(made.points, up)
    if floor is None:
        return made
    if not floor.cut:
        said = f"a plane {floor.size:.4g} wide lies under it and was kept: it may be its ground or the table"
        return replace(made, changes=(*made.changes, said))
    keep = floor.above(made.points)
    return made.kept(
        keep,
        f"a plane {floor.size:.4g} wide under it (table or floor, {int((~keep).sum())} points) was cut off",
    )


def thinned_cloud(made: MendedCloud, most: int = MAX_POINTS) -> MendedCloud:
    """At most about `most` points: the first in each cell of an even grid."""
    n = len(made.points)
    if n <= most:
        return made
    low = made.points.min(axis=0)
    size = float(np.ptp(made.points, axis=0).max())
    cell = size / 2000
    for _ in range(8):
        place = np.floor((made.points - low) / cell).astype(np.int64)
        span = place.max(axis=0) + 1
        key = (place[:, 0] * span[1] + place[:, 1]) * span[2] + place[:, 2]
        _, first = np.unique(key, return_index=True)
        if 0.7 * most <= len(first) <= most:
            break
        cell *= float(np.sqrt(len(first) / (0.85 * most)))
    keep = np.zeros(n, bool)
    keep[first] = True
    return made.kept(keep, f"{n} points were thinned to {len(first)}, one in each cell of {cell:.3g}")


def with_checked_normals(made: MendedCloud) -> MendedCloud:
    """Normals of length one that look outwards, or none; and what is to be said of them."""
    if made.normals is None:
        return made
    normals = np.array(made.normals, float)
    with np.errstate(over="ignore", invalid="ignore"):  # a damaged number may be of any size
        length = np.linalg.norm(normals, axis=1)
    known = np.isfinite(length) & (length > 1e-6)
    lacking = int((~known).sum())
    said: list[str] = []
    if lacking > _LACKING * len(known):
        why = f"its normals were left aside: {lacking} of {len(known)} are zero or missing"
        return replace(made, normals=None, changes=(*made.changes, why))
    if (np.abs(length[known] - 1) > _UNIT).any():
        said.append("normals that were not of length one were scaled")
    normals[known] /= length[known, None]
    if lacking:
        near = cKDTree(made.points[known]).query(made.points[~known])[1]
        normals[~known] = normals[known][near]
        said.append(f"{lacking} normals that are zero or missing were taken from neighbours")
    if len(normals) > 100 and (bad := disagreeing(made.points, normals)) > _QUARREL:
        said.append(f"its normals were left aside: {bad:.0%} look against their neighbour's")
        return replace(made, normals=None, changes=(*made.changes, *said))
    turned = 0
    if len(normals) > 100 and look_inwards(made.points, normals):
        normals, turned = -normals, len(normals)
        said.append("its normals looked inwards and were turned")
    return replace(made, normals=normals, turned=turned, changes=(*made.changes, *said))
