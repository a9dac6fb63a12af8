"""The frontier: where space that a frame looked through meets space that none has, with no surface between.

Whatever a scan has missed lies behind its frontier (Yamauchi 1997, doi 10.1109/CIRA.1997.613851): the shadow
behind a ledge, the mouth of a groove too narrow for a hole in the cloud, a flank met at too grazing an angle.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from scanmotion.compiled import njit, prange
from scanmotion.scanner import Scanner

_BAND, _MARGIN = 4, 24
"""Space is looked at within this many cells of the surface; later scans may add so many about the first."""
_MOST_CELLS = 60_000_000
_UNKNOWN, _OCCUPIED, _FREE = 1, 2, 3


@dataclass(frozen=True, eq=False, kw_only=True)
class Frontier:
    """Cells of unknown space beside free space."""

    points: np.ndarray
    """Centres, shape (n, 3) in O [m]."""
    normals: np.ndarray
    """Unit vectors into the free space, shape (n, 3)."""
    edge: float
    """Of a cell [m]."""
    passed: Callable[[np.ndarray], np.ndarray] | None = None
    """Tells which of the places (n, 3) some frame has looked through, shape (n,); None where not known."""


class Space:
    """The space about a scanned surface, carved frame by frame."""

    def __init__(
        self,
        scanner: Scanner,
        *,
        extent: np.ndarray,
        edge: float = 0.002,
        stride: int = 2,
        table_z: float = 0.0,
    ) -> None:
        """Nothing is known yet.

        Args:
            scanner: its field of view maps points to the images' pixels.
            extent: of the part, shape (3,) [m]; of a large one the cells are larger.
            edge: of a cell [m].
            stride: of the images: every stride-th pixel of the scanner's.
            table_z: height of the table's top in O; below it nothing is sought [m].
        """
        self._edge = float(max(edge, np.cbrt(np.prod(np.asarray(extent) + 20 * edge) / _MOST_CELLS)))
        self._scanner, self._table_z = scanner, table_z
        # A ray passes up to half a pixel beside a point, which tells in depth where it grazes.
        self._margin = self._edge * max(1.0, stride / 2)
        self._X_SO = np.zeros((0, 4, 4))
        self._images: list[np.ndarray] = []
        self._known = 0
        self._low = np.zeros(3, np.int64)
        self._free: np.ndarray | None = None
        self._tested: np.ndarray | None = None

    def add(self, X_OS: np.ndarray, images: np.ndarray) -> None:
        """Remembers frames: poses (n, 4, 4) and depth images (n, h, w) [m], NaN where nothing was seen."""
        self._X_SO = np.concatenate([self._X_SO, np.linalg.inv(np.asarray(X_OS, float))])
        self._images.append(np.asarray(images, np.float32))

    def frontier(self, points: np.ndarray) -> Frontier:
        """Where the frames left space open beside the surface that `points` (n, 3) show."""
        cells = np.floor(points / self._edge).astype(np.int64)
        if self._free is None:
            self._low = cells.min(axis=0) - _MARGIN
            shape = tuple(int(n) for n in cells.max(axis=0) + _MARGIN + 1 - self._low)
            self._free, self._tested = np.zeros(shape, bool), np.zeros(shape, bool)
        assert self._tested is not None
        cells = cells - self._low
        inside = ((cells > _BAND) & (cells < np.array(self._free.shape) - _BAND - 1)).all(axis=1)
        occupied = np.zeros(self._free.shape, bool)
        occupied[tuple(cells[inside].T)] = True
        band = ndimage.binary_dilation(occupied, iterations=_BAND) & ~occupied
        ground = int(np.ceil(self._table_z / self._edge)) - int(self._low[2])
        band[:, :, : max(ground, 0)] = False
        images = np.concatenate(self._images)
        self._images = [images]
        for at, first in (
            (np.argwhere(band & ~self._tested), 0),
            (np.argwhere(band & self._tested & ~self._free), self._known),
        ):
            self._free[tuple(at.T)] = self._looked_past(at, images, first)
        self._tested |= band
        self._known = len(images)
        state = np.zeros(band.shape, np.uint8)
        state[band] = np.where(self._free[band], _FREE, _UNKNOWN)
        state[occupied] = _OCCUPIED
        return replace(_frontier_of(state, self._low, self._edge), passed=self.passed)

    def passed(self, places: np.ndarray) -> np.ndarray:
        """Which of the places (n, 3) [m] some frame has looked through, shape (n,)."""
        self._images = [np.concatenate(self._images)] if self._images else []
        if not self._images:
            return np.zeros(len(places), bool)
        return self._seen_through(np.asarray(places, dtype=float), self._images[0], 0)

    def _looked_past(self, at: np.ndarray, images: np.ndarray, first: int) -> np.ndarray:
        """Which cells a frame from `first` on has looked past, shape (n,)."""
        return self._seen_through((at + self._low + 0.5) * self._edge, images, first)

    def _seen_through(self, places: np.ndarray, images: np.ndarray, first: int) -> np.ndarray:
        if len(images) == first or len(places) == 0:
            return np.zeros(len(places), bool)
        return _carved(
            places, self._X_SO[first:], images[first:],
            np.tan(self._scanner.fov[0] / 2), np.tan(self._scanner.fov[1] / 2), self._margin,
        )  # fmt: skip


def _frontier_of(state: np.ndarray, low: np.ndarray, edge: float) -> Frontier:
    near = np.asarray(ndimage.binary_dilation(state == _OCCUPIED), dtype=bool)
    free = state == _FREE
    open_ = (state == _UNKNOWN) & ~near & ndimage.binary_dilation(free)
    labels: Any = ndimage.label(open_, structure=np.ones((3, 3, 3)))
    label, count = labels
    size = np.bincount(label.ravel(), minlength=count + 1)
    at = np.argwhere(open_ & (size[label] >= 4))
    inner = np.clip(at, 1, np.array(state.shape) - 2)
    normals = np.zeros((len(at), 3))
    for d in np.argwhere(np.ones((3, 3, 3))) - 1:
        normals += free[tuple((inner + d).T)][:, None] * d
    length = np.linalg.norm(normals, axis=1)
    keep = length > 1e-9
    return Frontier(
        points=(at[keep] + low + 0.5) * edge, normals=normals[keep] / length[keep, None], edge=edge
    )


@njit(cache=True, parallel=True)
def _carved(p_O, X_SO, images, tx, ty, margin):
    """Which points some frame looked past, shape (n,)."""
    n, (f, h, w) = len(p_O), images.shape
    out = np.zeros(n, np.bool_)
    for i in prange(n):
        x, y, z = p_O[i, 0], p_O[i, 1], p_O[i, 2]
        for s in range(f):
            # Strided order: neighbouring frames say the same.
            k = (s * 37) % f if f % 37 else s
            X = X_SO[k]
            c = X[2, 0] * x + X[2, 1] * y + X[2, 2] * z + X[2, 3]
            if c < 0.05:
                continue
            a = (X[0, 0] * x + X[0, 1] * y + X[0, 2] * z + X[0, 3]) / (c * tx)
            if a <= -1.0 or a >= 1.0:
                continue
            b = (X[1, 0] * x + X[1, 1] * y + X[1, 2] * z + X[1, 3]) / (c * ty)
            if b <= -1.0 or b >= 1.0:
                continue
            if images[k, int((b + 1.0) * 0.5 * h), int((a + 1.0) * 0.5 * w)] > c + margin:
                out[i] = True
                break
    return out
