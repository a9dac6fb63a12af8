"""The frontier: where space that a frame looked through meets space that none has, with no surface between.

Whatever a scan has missed lies behind its frontier (Yamauchi 1997, doi 10.1109/CIRA.1997.613851): the shadow
behind a ledge, the mouth of a groove too narrow for a hole in the cloud, a flank met at too grazing an angle.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scanmotion.core.scanner import Scanner
from scanmotion.core.support.threads import allowed_threads, by_pieces
from scanmotion.geometry.jit import njit

_BAND = 4
"""Space is looked at within this many cells of the measured surface."""
_LEAST = 4
"""Fewer cells together are chance, not a frontier."""
_HALF = 1 << 20
"""Cells on either side of the origin along each axis: enough for a kilometre."""
_FACES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
_AROUND = np.argwhere(np.ones((3, 3, 3))) - 1


@dataclass(frozen=True, eq=False, kw_only=True)
class Frontier:
    """Cells of unknown space beside free space."""

    points: np.ndarray
    """Centres, shape (n, 3) in O [m]."""
    normals: np.ndarray
    """Unit vectors into the free space, shape (n, 3)."""
    edge: float
    """Of a cell [m]."""


class Space:
    """The space about a scanned surface, carved frame by frame."""

    def __init__(
        self, scanner: Scanner, *, edge: float = 0.002, stride: int = 2, table_z: float = 0.0
    ) -> None:
        """Nothing is known yet.

        Args:
            scanner: its field of view maps points to the images' pixels.
            edge: of a cell [m].
            stride: of the images: every stride-th pixel of the scanner's.
            table_z: height of the table's top in O; below it nothing is sought [m].
        """
        self._scanner, self._edge, self._table_z = scanner, float(edge), table_z
        # A ray passes up to half a pixel beside a point, which tells in depth where it grazes.
        self._margin = self._edge * max(1.0, stride / 2)
        self._X_SO = np.zeros((0, 4, 4))
        self._images: list[np.ndarray] = []
        # Cells that were asked about before: their keys, ascending, and how many frames each was held
        # against; -1 where one of them had looked through.
        self._keys = np.zeros(0, np.int64)
        self._frames = np.zeros(0, np.int64)

    def add(self, X_OS: np.ndarray, images: np.ndarray) -> None:
        """Remembers frames.

        Args:
            X_OS: their poses, shape (n, 4, 4) [m].
            images: their depth images, shape (n, h, w) [m], NaN where nothing was seen.
        """
        self._X_SO = np.concatenate([self._X_SO, np.linalg.inv(np.asarray(X_OS, float))])
        self._images.append(np.asarray(images, np.float32))

    def with_frames(self, X_OS: np.ndarray, images: np.ndarray) -> "Space":
        """The space with more frames, see `add`; this one stays as it is.

        Args:
            X_OS: poses of the frames, shape (f, 4, 4) [m].
            images: their depth images, shape (f, h, w) [m].
        """
        more = copy(self)
        # What is remembered of cells is replaced as a whole, never written into: it may be shared.
        more._images = list(self._images)
        more.add(X_OS, images)
        return more

    def frontier(self, points: np.ndarray, *, near: np.ndarray | None = None, reach: float = 0.0) -> Frontier:
        """Where the frames left space open beside the surface that `points` (n, 3) show.

        Args:
            points: the measured surface, shape (n, 3) [m].
            near: only cells about these places are wanted, shape (k, 3) [m]; None for all along the surface.
            reach: how far from them [m].
        """
        occupied = _distinct(_keys(np.floor(points / self._edge).astype(np.int64)))
        wanted = self._wanted(points, near, reach)
        # A ring more, to see what stands beside the wanted.
        around = _distinct(wanted[:, None] + _offsets(_AROUND))
        around = around[~_among(around, occupied)]
        around = around[_cells(around)[:, 2] * self._edge >= self._table_z - 1e-9]
        free = around[self._looked_through(around)]
        beside_surface = _distinct(occupied[:, None] + _offsets(_FACES))
        unknown = np.setdiff1d(around, free, assume_unique=True)
        unknown = unknown[_among(unknown, wanted) & ~_among(unknown, beside_surface)]
        open_ = unknown[_among(unknown[:, None] + _offsets(_FACES), free).any(axis=1)]
        at = _cells(_gathered(open_))
        inward = _among(_keys(at)[:, None] + _offsets(_AROUND), free).astype(float) @ _AROUND
        length = np.linalg.norm(inward, axis=1)
        keep = length > 1e-9
        return Frontier(
            points=(at[keep] + 0.5) * self._edge, normals=inward[keep] / length[keep, None], edge=self._edge
        )

    def passed(self, places: np.ndarray) -> np.ndarray:
        """Which of the places some frame has looked through, shape (n,).

        Args:
            places: shape (n, 3) in O [m].
        """
        return self._seen_through(np.asarray(places, dtype=float), 0)

    def _wanted(self, points: np.ndarray, near: np.ndarray | None, reach: float) -> np.ndarray:
        """Keys of the cells in the band along the surface, and about `near` where that is given."""
        span = _BAND if near is None else int(np.ceil(reach / self._edge))
        ball = np.argwhere(np.ones((2 * span + 1,) * 3)) - span
        ball = ball[np.linalg.norm(ball, axis=1) <= span + 0.5]
        tree = cKDTree(points)
        centre = _distinct(_keys(np.floor((points if near is None else near) / self._edge).astype(np.int64)))
        centre = centre[self._within(centre, tree, _BAND + span + 2)]
        chunks = [np.zeros(0, np.int64)]
        for first in range(0, len(centre), 20_000):
            chunks.append(_distinct(centre[first : first + 20_000, None] + _offsets(ball)))
        wanted = _distinct(np.concatenate(chunks))
        return wanted[self._within(wanted, tree, _BAND + 0.5)]

    def _within(self, keys: np.ndarray, tree: cKDTree, cells: float) -> np.ndarray:
        """Which cells lie within so many cells of the tree's points, shape (n,)."""
        places = (_cells(keys) + 0.5) * self._edge
        return (
            tree.query(places, distance_upper_bound=cells * self._edge, workers=allowed_threads())[0] < np.inf
        )

    def _looked_through(self, keys: np.ndarray) -> np.ndarray:
        """Which cells, ascending keys (n,), some frame has looked through; each frame is asked once."""
        count = len(self._X_SO)
        at = np.searchsorted(self._keys, keys)
        known = at < len(self._keys)
        known[known] = self._keys[at[known]] == keys[known]
        frames = np.zeros(len(keys), np.int64)
        frames[known] = self._frames[at[known]]
        for first in np.unique(frames[(frames >= 0) & (frames < count)]):
            todo = np.flatnonzero(frames == first)
            through = self._seen_through((_cells(keys[todo]) + 0.5) * self._edge, int(first))
            frames[todo] = np.where(through, -1, count)
        others = ~_among(self._keys, keys)
        merged = np.concatenate([self._keys[others], keys])
        order = np.argsort(merged, kind="stable")
        self._keys, self._frames = merged[order], np.concatenate([self._frames[others], frames])[order]
        return frames < 0

    def _seen_through(self, places: np.ndarray, first: int) -> np.ndarray:
        """Which places a frame from `first` on has looked through, shape (n,)."""
        if len(self._images) > 1:
            self._images = [np.concatenate(self._images)]
        if len(self._X_SO) == first or len(places) == 0:
            return np.zeros(len(places), bool)
        # One kind of array: `places` comes in either order.
        places, X_SO, images = np.ascontiguousarray(places), self._X_SO[first:], self._images[0][first:]
        tx, ty = (float(np.tan(angle / 2)) for angle in self._scanner.fov)
        pieces = by_pieces(
            lambda a, b: _carved(places[a:b], X_SO, images, tx, ty, self._margin), len(places), least=1000
        )
        return np.concatenate(pieces)


def _keys(cells: np.ndarray) -> np.ndarray:
    """One number for each cell (..., 3); a step of one cell is a step of the same size everywhere."""
    cells = cells + _HALF
    return (cells[..., 0] << 42) | (cells[..., 1] << 21) | cells[..., 2]


def _cells(keys: np.ndarray) -> np.ndarray:
    """The cells (n, 3) of keys (n,)."""
    mask = (1 << 21) - 1
    return np.stack([keys >> 42, (keys >> 21) & mask, keys & mask], axis=-1) - _HALF


def _offsets(steps: np.ndarray) -> np.ndarray:
    """What steps (n, 3) between cells add to their keys."""
    return steps @ np.array([1 << 42, 1 << 21, 1])


def _distinct(keys: np.ndarray) -> np.ndarray:
    """Each key once, ascending."""
    keys = np.sort(keys, axis=None)
    return keys[np.diff(keys, prepend=-1) != 0]


def _among(keys: np.ndarray, ascending: np.ndarray) -> np.ndarray:
    """Which keys stand in the ascending ones."""
    if len(ascending) == 0:
        return np.zeros(keys.shape, bool)
    at = np.minimum(np.searchsorted(ascending, keys), len(ascending) - 1)
    return ascending[at] == keys


def _gathered(keys: np.ndarray) -> np.ndarray:
    """The ascending keys whose cells hang together, edge or corner, with enough others."""
    n = len(keys)
    if n == 0:
        return keys
    beside = keys[:, None] + _offsets(_AROUND[:13])
    i, k = np.nonzero(_among(beside, keys))
    j = np.searchsorted(keys, beside[i, k])
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(n, n))
    label = connected_components(graph, directed=False)[1]
    return keys[np.bincount(label)[label] >= _LEAST]


@njit(cache=True, nogil=True)
def _carved(p_O, X_SO, images, tx, ty, margin):
    """Which points some frame looked past, shape (n,)."""
    n, (f, h, w) = len(p_O), images.shape
    out = np.zeros(n, np.bool_)
    for i in range(n):
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
