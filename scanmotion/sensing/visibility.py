"""What a viewpoint sees: field, range, incidence and occlusion, for camera and projector both."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scanmotion.core.scanner import Scanner
from scanmotion.core.support.threads import allowed_threads, by_pieces
from scanmotion.geometry.jit import njit
from scanmotion.geometry.se3 import turns_about_z

_SKIN = 2e-4
"""Shadow rays start this far off the surface [m]."""
_CHUNK = 400_000
SURFACE = 0
"""Open3D's number of the surface in a scene's raycaster; table and pedestal come after it."""
GUESSED = 0.005
"""A guessed surface does not hide points closer behind it than this [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """What blocks sight, in O: the surface, the table's disc, the pedestal. All are fixed in O: the last two
    are round about the table's axis.
    """

    raycaster: Any
    """Open3D RaycastingScene."""
    table_z: float
    """Height of the table's top in O [m]; the scanner stays above it. -inf without a table."""
    guess: Any = None
    """Open3D RaycastingScene of surface that is guessed, not measured; it blocks a line only beyond GUESSED
    from the line's origin. None for none."""
    outline: np.ndarray | None = None
    """Corners of the surface's convex hull, shape (h, 3): rays past it cannot hit; None where not known."""


def scene_from(
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    table_radius: float | None = None,
    table_z: float = 0.0,
    pedestal_radius: float = 0.0,
) -> Scene:
    """Prepares the surface for rays.

    Args:
        vertices: shape (n, 3) in O [m].
        triangles: indices of vertices, shape (m, 3).
        table_radius: of the table's disc [m]; None for no table.
        table_z: height of the table's top in O, below zero where a pedestal lifts the part [m].
        pedestal_radius: of the pedestal between table and part [m]; 0 for none.
    """
    import open3d as o3d

    raycaster = o3d.t.geometry.RaycastingScene(nthreads=allowed_threads())
    parts = [(np.asarray(vertices), np.asarray(triangles))]
    if table_radius is not None:
        parts.append(_disc(table_radius, table_z - 1e-4))
        if pedestal_radius > 0 and table_z < 0:
            parts.append(_tube(pedestal_radius, table_z, -1e-4))
    for v, t in parts:
        vertices_f: Any = np.ascontiguousarray(v, dtype=np.float32)
        triangles_u: Any = np.ascontiguousarray(t, dtype=np.uint32)
        raycaster.add_triangles(vertices_f, triangles_u)
    return Scene(
        raycaster=raycaster,
        table_z=table_z if table_radius is not None else -np.inf,
        outline=_outline(np.asarray(vertices, dtype=float)),
    )


def _outline(vertices: np.ndarray) -> np.ndarray:
    """Corners of the convex hull; of the box where all lie in one plane."""
    try:
        return vertices[ConvexHull(vertices).vertices]
    except QhullError:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return np.array(
            [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        )


def _ring(radius: float, z: float, n: int = 96) -> np.ndarray:
    a = 2 * np.pi * np.arange(n) / n
    return np.column_stack([radius * np.cos(a), radius * np.sin(a), np.full(n, z)])


def _disc(radius: float, z: float) -> tuple[np.ndarray, np.ndarray]:
    ring = _ring(radius, z)
    n = len(ring)
    i = np.arange(n)
    return np.vstack([ring, [[0, 0, z]]]), np.column_stack([i, (i + 1) % n, np.full(n, n)])


def _tube(radius: float, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    a, b = _ring(radius, low), _ring(radius, high)
    n = len(a)
    i, j = np.arange(n), (np.arange(n) + 1) % n
    top = _disc(radius, high)
    sides = np.vstack([np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n])])
    return np.vstack([a, b, top[0]]), np.vstack([sides, top[1] + 2 * n])


def free_lines(scene: Scene, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Whether nothing stands between each origin, near the surface, and its target (k, 3), shape (k,)."""
    out = np.zeros(len(origins), bool)
    for first in range(0, len(origins), _CHUNK):
        o, t = origins[first : first + _CHUNK], targets[first : first + _CHUNK]
        line = t - o
        rays = np.concatenate([o, line], axis=1).astype(np.float32)
        free = ~scene.raycaster.test_occlusions(rays, tnear=0.0, tfar=1.0, nthreads=allowed_threads()).numpy()
        if scene.guess is not None:
            length = np.maximum(np.linalg.norm(line, axis=1, keepdims=True), GUESSED)
            start = o + GUESSED / length * line
            rays = np.concatenate([start, t - start], axis=1).astype(np.float32)
            free &= ~scene.guess.test_occlusions(
                rays, tnear=0.0, tfar=1.0, nthreads=allowed_threads()
            ).numpy()
        out[first : first + _CHUNK] = free
    return out


def in_view(scanner: Scanner, X_OS: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Which points the scanner at X_OS (n, 4, 4) would see were nothing in the way, shape (n, m).

    Inside the camera's field and range, and turned towards camera and projector by no more than the greatest
    incidence.
    """
    X_OS = np.ascontiguousarray(X_OS, dtype=float).reshape(-1, 4, 4)
    points, normals = np.ascontiguousarray(points, dtype=float), np.ascontiguousarray(normals, dtype=float)
    field = np.array(
        [np.tan(scanner.fov[0] / 2), np.tan(scanner.fov[1] / 2), *scanner.range, _highlight(scanner)]
    )
    least, baseline = float(np.cos(scanner.max_incidence)), float(scanner.baseline)
    out = np.zeros((len(X_OS), len(points)), bool)

    def some(first: int, last: int) -> None:
        _in_views(X_OS[first:last], points, normals, field, least, baseline, out[first:last])

    # Threads cost more than they bring where there is little to do.
    by_pieces(some, len(X_OS), least=1 + 250_000 // max(len(points), 1))
    return out


def _highlight(scanner: Scanner) -> float:
    """Least cosine of normal and half vector at which the reflection blinds; above 1 where it never does."""
    return float(np.cos(scanner.mirror)) if scanner.mirror > 0 else 2.0


@njit(cache=True, nogil=True)
def _in_views(X_OS, points, normals, field, least, baseline, out):
    for i in range(len(X_OS)):
        _in_view(X_OS[i], points, normals, field, least, baseline, out[i])


@njit(cache=True)
def _in_view(X, points, normals, field, least, baseline, out):
    for j in range(len(points)):
        x, y, z = points[j, 0] - X[0, 3], points[j, 1] - X[1, 3], points[j, 2] - X[2, 3]
        c = X[0, 2] * x + X[1, 2] * y + X[2, 2] * z
        if c < field[2] or c > field[3]:
            continue
        a = X[0, 0] * x + X[1, 0] * y + X[2, 0] * z
        b = X[0, 1] * x + X[1, 1] * y + X[2, 1] * z
        if abs(a) > field[0] * c or abs(b) > field[1] * c:
            continue
        u, v, w = normals[j, 0], normals[j, 1], normals[j, 2]
        if -(u * x + v * y + w * z) < least * np.sqrt(x * x + y * y + z * z):
            continue
        r, p, q, s = np.sqrt(x * x + y * y + z * z), x, y, z
        x -= baseline * X[0, 0]
        y -= baseline * X[1, 0]
        z -= baseline * X[2, 0]
        out[j] = -(u * x + v * y + w * z) >= least * np.sqrt(x * x + y * y + z * z)
        if out[j] and field[4] <= 1.0:
            t = np.sqrt(x * x + y * y + z * z)
            p, q, s = p / r + x / t, q / r + y / t, s / r + z / t
            out[j] = -(u * p + v * q + w * s) < field[4] * np.sqrt(p * p + q * q + s * s)


def _unblocked(
    scene: Scene, scanner: Scanner, X_OS: np.ndarray, pose: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Whether both eyes of the poses X_OS[pose] have a free line to the points (k, 3), shape (k,)."""
    camera = X_OS[pose, :3, 3]
    ok = free_lines(scene, points, camera)
    where = np.flatnonzero(ok)
    projector = camera[where] + scanner.baseline * X_OS[pose[where], :3, 0]
    ok[where] = free_lines(scene, points[where], projector)
    return ok


def axis_depths(scene: Scene, X_OS: np.ndarray) -> np.ndarray:
    """Distance along the optical axis of poses (n, 4, 4) to the surface, measured or guessed, shape (n,) [m].

    Infinite where the axis meets the table or the pedestal first, or nothing.
    """
    X_OS = np.asarray(X_OS, dtype=float).reshape(-1, 4, 4)
    rays = np.concatenate([X_OS[:, :3, 3], X_OS[:, :3, 2]], axis=1).astype(np.float32)
    hits = scene.raycaster.cast_rays(rays, nthreads=allowed_threads())
    depth = hits["t_hit"].numpy().astype(float)
    surface = hits["geometry_ids"].numpy() == SURFACE
    if scene.guess is not None:
        guess = scene.guess.cast_rays(rays, nthreads=allowed_threads())["t_hit"].numpy().astype(float)
        surface |= guess < depth
        depth = np.minimum(depth, guess)
    return np.where(surface, depth, np.inf)


def sees(
    scene: Scene, scanner: Scanner, X_OS: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Which surface points each scanner pose measures.

    Args:
        scene: what blocks sight.
        scanner: field, range, incidence, baseline.
        X_OS: poses, shape (n, 4, 4) [m].
        points: shape (m, 3) in O [m].
        normals: outward unit normals, shape (m, 3).

    Returns:
        shape (n, m), bool.
    """
    X_OS = np.asarray(X_OS, dtype=float).reshape(-1, 4, 4)
    out = np.zeros((len(X_OS), len(points)), bool)
    start = points + _SKIN * normals
    step = max(1, 4_000_000 // max(len(points), 1))
    for first in range(0, len(X_OS), step):
        poses = X_OS[first : first + step]
        i, j = np.nonzero(in_view(scanner, poses, points, normals))
        out[first + i, j] = _unblocked(scene, scanner, poses, i, start[j])
    return out


def seen_by_any(
    scene: Scene,
    scanner: Scanner,
    X_OS: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    seen: np.ndarray | None = None,
) -> np.ndarray:
    """Which points at least one of the poses measures, shape (m,).

    Args:
        scene: what blocks sight.
        scanner: field, range, incidence, baseline.
        X_OS: poses, shape (n, 4, 4) [m].
        points: shape (m, 3) in O [m].
        normals: outward unit normals, shape (m, 3).
        seen: mask of points that are not asked again, shape (m,).
    """
    found = np.zeros(len(points), bool) if seen is None else np.array(seen, dtype=bool)
    X_OS = np.asarray(X_OS, dtype=float).reshape(-1, 4, 4)
    for n in range(len(X_OS)):
        todo = np.flatnonzero(~found)
        if len(todo) == 0:
            break
        todo = todo[in_view(scanner, X_OS[n], points[todo], normals[todo])[0]]
        start = points[todo] + _SKIN * normals[todo]
        found[todo] = _unblocked(scene, scanner, X_OS, np.full(len(todo), n), start)
    return found


def turns_see(
    scene: Scene,
    scanner: Scanner,
    X_OS: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    poses: int = 30,
) -> np.ndarray:
    """Which points each whole turn of the table before a pose measures, shape (n, m).

    Args:
        scene: what blocks sight.
        scanner: field, range, incidence, baseline.
        X_OS: poses, shape (n, 4, 4) [m].
        points: shape (m, 3) in O [m].
        normals: outward unit normals, shape (m, 3).
        poses: frames in a turn.
    """
    out = np.zeros((len(X_OS), len(points)), bool)
    step = max(1, 4_000_000 // max(poses * len(points), 1))
    for first in range(0, len(X_OS), step):
        turns = X_OS[first : first + step]
        frames = np.concatenate([revolution_poses(X, poses) for X in turns])
        seen = sees(scene, scanner, frames, points, normals)
        out[first : first + step] = seen.reshape(len(turns), poses, -1).any(axis=1)
    return out


def revolution_poses(X_OS: np.ndarray, n: int = 60) -> np.ndarray:
    """The pose seen from the object while the table turns once, shape (n, 4, 4).

    Args:
        X_OS: of the scanner at table angle zero, shape (4, 4) [m].
        n: frames in the turn.
    """
    return turns_about_z(-2 * np.pi * np.arange(n) / n) @ X_OS


def hemisphere(n: int) -> np.ndarray:
    """`n` directions spread evenly over the upper half sphere (Fibonacci), shape (n, 3)."""
    k = np.arange(n) + 0.5
    z = 1 - k / n
    r, phi = np.sqrt(1 - z * z), np.pi * (1 + 5**0.5) * k
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])


def tangents(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with each normal, shape (m, 3) each."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = np.cross(helper, normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return x, np.cross(normals, x)


def visible(
    scene: Scene,
    scanner: Scanner,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    seen: np.ndarray | None = None,
    directions: int = 256,
) -> np.ndarray:
    """Which points any allowed scanner pose can measure, reach aside, shape (m,).

    Allowed is every pose outside the object and above the table with the point in its field. The camera is
    tried along `directions` of the hemisphere inside the greatest incidence, at the least, a middle and the
    greatest distance; the projector beside it at eight rolls.

    Args:
        scene: what blocks sight.
        scanner: range, incidence, baseline.
        points: shape (m, 3) in O [m].
        normals: outward unit normals, shape (m, 3).
        seen: mask of points that are known to be visible and are not tested, shape (m,).
        directions: over the whole hemisphere; a finer set finds narrower shafts.
    """
    found = np.zeros(len(points), bool) if seen is None else np.array(seen, dtype=bool)
    local = hemisphere(directions)
    local = local[local[:, 2] >= np.cos(scanner.max_incidence)]
    for first in range(0, len(points), 2000):
        block = np.arange(first, min(first + 2000, len(points)))
        block = block[~found[block]]
        if len(block):
            found[block] = _visible_block(scene, scanner, points[block], normals[block], local)
    return found


def _visible_block(
    scene: Scene, scanner: Scanner, points: np.ndarray, normals: np.ndarray, local: np.ndarray
) -> np.ndarray:
    x, y = tangents(normals)
    u = (
        local[None, :, :1] * x[:, None]
        + local[None, :, 1:2] * y[:, None]
        + local[None, :, 2:] * normals[:, None]
    )
    start = points + _SKIN * normals
    rays = np.concatenate([np.broadcast_to(start[:, None], u.shape), u], axis=2).reshape(-1, 6)
    hit = (
        scene.raycaster.cast_rays(rays.astype(np.float32), nthreads=allowed_threads())["t_hit"]
        .numpy()
        .reshape(u.shape[:2])
    )
    found = np.zeros(len(points), bool)
    near, far = scanner.range
    for distance in (near + 1e-3, (near + far) / 2, far - 1e-3):
        camera = start[:, None] + distance * u
        ok = (hit > distance) & (camera[..., 2] > scene.table_z + 1e-3) & ~found[:, None]
        for roll in range(8):
            i, j = np.nonzero(ok & ~found[:, None])
            if len(i) == 0:
                break
            a, b = tangents(u[i, j])
            angle = 2 * np.pi * roll / 8
            eye = camera[i, j] + scanner.baseline * (np.cos(angle) * a + np.sin(angle) * b)
            line = eye - start[i]
            turned = np.einsum("ij,ij->i", line, normals[i]) >= np.cos(
                scanner.max_incidence
            ) * np.linalg.norm(line, axis=1)
            turned &= eye[:, 2] > scene.table_z + 1e-3
            i, eye = i[turned], eye[turned]
            found[i[free_lines(scene, start[i], eye)]] = True
    return found
