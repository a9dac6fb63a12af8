"""Which way each place of a surface is open: sight of many poses without a ray for each.

A ray from a place that has left the convex hull of the part does not meet it again. So whether a scanner
that stands outside that hull is hidden depends on the direction alone, and one table of directions for each
place answers for every pose. Guarantee: none, the directions are rounded to `Sight.cells` steps; what is
chosen with these tables is scanned by the twin with true rays. Assumption: scanner outside the hull; inside
it, a place may be called hidden that is not.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.jit import njit
from scanmotion.sensing.visibility import Scene

_SKIN = 2e-4
"""Rays start this far off the surface [m]."""
_CHUNK = 4_000_000
_FAR_M = 10.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Sight:
    """Places of a surface in O and the directions in which they are open."""

    points: np.ndarray
    """Shape (3, m) [m]."""
    normals: np.ndarray
    """Outward unit normals, shape (3, m)."""
    open: np.ndarray
    """Bit k of row i: place i is open in the direction of cell k of the octahedral map, shape (m, w)
    uint64."""
    cells: int
    """Cells along each side of the map."""
    field: np.ndarray
    """Half widths of the field of view at depth 1 along x and y of S, least and greatest depth [m], least
    cosine of incidence, baseline [m]; shape (6,)."""

    def only(self, which: np.ndarray) -> "Sight":
        """The same for some of the places, by index."""
        return Sight(
            points=np.ascontiguousarray(self.points[:, which]),
            normals=np.ascontiguousarray(self.normals[:, which]),
            open=np.ascontiguousarray(self.open[which]), cells=self.cells, field=self.field,
        )  # fmt: skip

    @property
    def words(self) -> int:
        """Words of 64 bits in a mask over the places."""
        return (self.points.shape[1] + 63) // 64


def sight_from(
    scene: Scene, scanner: Scanner, points: np.ndarray, normals: np.ndarray, *, cells: int = 48
) -> Sight:
    """Casts a ray from each place into each direction in which the scanner may be.

    Args:
        scene: what blocks sight; rays end above the table's top, under which no scanner is.
        scanner: field, range, incidence, baseline.
        points: shape (m, 3) in O [m].
        normals: outward unit normals, shape (m, 3).
        cells: cells along each side of the map of directions; 48 are about 3 degrees each.
    """
    directions = octahedral(cells)
    least = float(np.cos(scanner.max_incidence))
    m, k = len(points), cells * cells
    bits = np.zeros((m, (k + 63) // 64), np.uint64)
    start = points + _SKIN * normals
    step = max(1, _CHUNK // k)
    for first in range(0, m, step):
        own = slice(first, min(first + step, m))
        i, j = np.nonzero(normals[own] @ directions.T >= least - 2.0 / cells)
        d, o = directions[j], start[own][i]
        far = np.full(len(i), _FAR_M)
        down = d[:, 2] < -1e-6
        if np.isfinite(scene.table_z):
            far[down] = np.maximum(o[down, 2] - scene.table_z - 1e-3, 0.0) / -d[down, 2]
        rays = np.concatenate([o, d * np.minimum(far, _FAR_M)[:, None]], axis=1).astype(np.float32)
        free = ~scene.raycaster.test_occlusions(rays, tnear=0.0, tfar=1.0, nthreads=allowed_threads()).numpy()
        _set_bits(bits[own], i[free], j[free])
    field = np.array(
        [np.tan(scanner.fov[0] / 2), np.tan(scanner.fov[1] / 2), *scanner.range, least, scanner.baseline]
    )
    return Sight(
        points=np.ascontiguousarray(points.T, dtype=float),
        normals=np.ascontiguousarray(normals.T, dtype=float),
        open=bits, cells=cells, field=field,
    )  # fmt: skip


@njit(cache=True)
def _set_bits(bits, i, j):
    for n in range(len(i)):
        bits[i[n], j[n] >> 6] |= np.uint64(1) << np.uint64(j[n] & 63)


def octahedral(cells: int) -> np.ndarray:
    """Directions in the middle of each cell of the octahedral map, shape (cells^2, 3).

    Source: Cigolla et al., A Survey of Efficient Representations for Independent Unit Vectors, JCGT 3(2),
    2014.
    """
    at = (2 * np.arange(cells) + 1) / cells - 1
    x, y = np.meshgrid(at, at, indexing="ij")
    z = 1 - np.abs(x) - np.abs(y)
    below = z < 0
    fx = np.where(below, (1 - np.abs(y)) * np.where(x >= 0, 1.0, -1.0), x)
    fy = np.where(below, (1 - np.abs(x)) * np.where(y >= 0, 1.0, -1.0), y)
    d = np.stack([fx, fy, z], axis=-1).reshape(-1, 3)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@njit(cache=True, inline="always")
def grid_cell_of(x, y, z, cells):
    """The cell of the octahedral map that a direction (x, y, z), of any length, falls into."""
    s = abs(x) + abs(y) + abs(z)
    u, v = x / s, y / s
    if z < 0.0:
        a, b = 1.0 - abs(v), 1.0 - abs(u)
        u = a if x >= 0.0 else -a
        v = b if y >= 0.0 else -b
    i = min(int((u + 1.0) * 0.5 * cells), cells - 1)
    j = min(int((v + 1.0) * 0.5 * cells), cells - 1)
    return i * cells + j


@njit(cache=True)
def _in_field(X, p, n, field, near):
    """Marks in `near` the places, columns of p and n (3, m), that would be measured were nothing in the way.

    Without a branch, so that the compiler takes several places at once.
    """
    least = field[4] * field[4]
    ox, oy, oz = X[0, 3], X[1, 3], X[2, 3]
    xx, xy, xz = X[0, 0], X[1, 0], X[2, 0]
    yx, yy, yz = X[0, 1], X[1, 1], X[2, 1]
    zx, zy, zz = X[0, 2], X[1, 2], X[2, 2]
    fx, fy, low, high, base = field[0], field[1], field[2], field[3], field[5]
    px, py, pz, nx, ny, nz = p[0], p[1], p[2], n[0], n[1], n[2]
    for j in range(p.shape[1]):
        x, y, z = px[j] - ox, py[j] - oy, pz[j] - oz
        c = zx * x + zy * y + zz * z
        a, b = abs(xx * x + xy * y + xz * z), abs(yx * x + yy * y + yz * z)
        d = -(nx[j] * x + ny[j] * y + nz[j] * z)
        e = d + base * (nx[j] * xx + ny[j] * xy + nz[j] * xz)
        u, v, w = x - base * xx, y - base * xy, z - base * xz
        near[j] = (
            (c >= low) & (c <= high) & (a <= fx * c) & (b <= fy * c)
            & (d > 0.0) & (d * d >= least * (x * x + y * y + z * z))
            & (e > 0.0) & (e * e >= least * (u * u + v * v + w * w))
        )  # fmt: skip


@njit(cache=True)
def frame_mask(X, p, n, opened, cells, field, near, out):
    """Sets in `out`, shape (w,) uint64, the bits of the places that a scanner at X (4, 4) in O measures.

    Args:
        X: the pose.
        p: places, shape (3, m) [m].
        n: their normals, shape (3, m).
        opened: `Sight.open`.
        cells: `Sight.cells`.
        field: `Sight.field`.
        near: room for work, shape (m,) bool.
        out: the mask.
    """
    out[:] = 0
    _in_field(X, p, n, field, near)
    ox, oy, oz = X[0, 3], X[1, 3], X[2, 3]
    qx, qy, qz = ox + field[5] * X[0, 0], oy + field[5] * X[1, 0], oz + field[5] * X[2, 0]
    for j in range(len(near)):
        if near[j]:
            k = grid_cell_of(ox - p[0, j], oy - p[1, j], oz - p[2, j], cells)
            if (opened[j, k >> 6] >> np.uint64(k & 63)) & np.uint64(1):
                k = grid_cell_of(qx - p[0, j], qy - p[1, j], qz - p[2, j], cells)
                if (opened[j, k >> 6] >> np.uint64(k & 63)) & np.uint64(1):
                    out[j >> 6] |= np.uint64(1) << np.uint64(j & 63)


@njit(cache=True)
def turned_pose(Y, angle, out):
    """Writes into `out` the pose in O of a scanner that is at Y (4, 4) where the table is at 0."""
    c, s = np.cos(angle), np.sin(angle)
    for k in range(4):
        out[0, k] = c * Y[0, k] + s * Y[1, k]
        out[1, k] = -s * Y[0, k] + c * Y[1, k]
        out[2, k] = Y[2, k]


@njit(cache=True)
def _masks_of(Y, angles, p, n, opened, cells, field):
    words = (p.shape[1] + 63) // 64
    out = np.zeros((len(Y), len(angles), words), np.uint64)
    X, near = np.eye(4), np.zeros(p.shape[1], np.bool_)
    for i in range(len(Y)):
        for k in range(len(angles)):
            turned_pose(Y[i], angles[k], X)
            frame_mask(X, p, n, opened, cells, field, near, out[i, k])
    return out


def masks_of(sight: Sight, Y: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Masks of each pose Y (n, 4, 4) at each table angle (k,) [rad], shape (n, k, w) uint64."""
    return _masks_of(Y, angles, sight.points, sight.normals, sight.open, sight.cells, sight.field)


def unpacked(mask: np.ndarray, count: int) -> np.ndarray:
    """Masks (..., w) uint64 as bool, shape (..., count)."""
    little = np.ascontiguousarray(mask).view(np.uint8)
    return np.unpackbits(little, axis=-1, bitorder="little", count=count).astype(bool)
