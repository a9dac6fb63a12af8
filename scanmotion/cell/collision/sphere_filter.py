"""The fast, conservative tier of collision checking: covering spheres against exact distances, in numba.

Every link is covered by spheres, so what is called free is free; what is called blocked may be blocked by
the spheres' excess only, and is then left to the exact tier. Distances to boxes, cylinders and the floor are
exact, those to the part are lower bounds: the nearest node of a signed-distance grid less the way to it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from scanmotion.cell.arm.robot import Body
from scanmotion.cell.collision.near_tables import near_tables, way_to_blocked
from scanmotion.cell.collision.pairs import GUIDED_M, guided, ignored, on_floor
from scanmotion.cell.collision.shapes import beyond, box_of
from scanmotion.cell.model import TABLE, TOOL, WORLD, Cell
from scanmotion.core.part import Part
from scanmotion.core.support.threads import allowed_threads
from scanmotion.geometry.chain import link_frames
from scanmotion.geometry.jit import njit

_CELL_M = (0.30, 0.24, 0.17, 0.14, 0.09, 0.08, 0.06, 0.05)
"""Edge of the cells that a link's boxes are cut into before each is wrapped in a sphere, by link [m].

For an arm as long as the KR 240; a shorter one has finer cells in proportion.
"""
_LONG_M = 3.6
"""The offsets of the KR 240's joints, one after the other."""
GRID_M = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class Filter:
    """Arrays that the kernels read; see `filter_from`."""

    chain: tuple[Any, ...]
    spheres: tuple[Any, ...]
    boxes: tuple[Any, ...]
    world: tuple[Any, ...]
    grid: tuple[Any, ...]
    reach: np.ndarray
    """Greatest distance of any moving point from each joint's axis, for bounds on motion, shape (7,) [m]."""


def _sphere_cover(body: Body, scale: float = 1.0) -> np.ndarray:
    """Spheres (x, y, z, r) in the link's frame that cover the body, shape (k, 4)."""
    half = box_of(body)
    n = np.maximum(np.ceil(2 * half / (scale * _CELL_M[body.link]) - 1e-9), 1).astype(int)
    radius = float(np.linalg.norm(half / n))
    axes = [(-half[i] + (2 * np.arange(n[i]) + 1) * half[i] / n[i]) for i in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.all(np.abs(centres) < half - 1.01 * 2 * half / n, axis=1)
    if body.shape == "hull":
        # Cells that the hull does not reach need no sphere, and all that it reaches have one.
        inside = beyond(body, centres) > radius
    centres = centres[~inside] @ body.X_LG[:3, :3].T + body.X_LG[:3, 3]
    return np.column_stack([centres, np.full(len(centres), radius)])


def filter_from(
    cell: Cell, clearance: float, self_clearance: float, *, grid: tuple[Any, ...] | None = None
) -> Filter:
    """Prepares the kernels' arrays.

    Args:
        cell: the cell, with or without a part.
        clearance: least distance to table, floor, obstacles and part [m].
        self_clearance: least distance between links [m].
        grid: of another cell with the same part, whose distances are used again.
    """
    moving = sorted((b for b in cell.bodies if 1 <= b.link <= TOOL), key=lambda b: -b.link)
    length = float(np.linalg.norm(cell.robot.X_PJ[:, :3, 3], axis=1).sum())
    # The tool is as large on any arm, but a short one brings its wrist nearer to it.
    scale = min(1.0, length / _LONG_M)
    covers = [_sphere_cover(b, scale if b.link < TOOL else 1.0 if scale > 0.75 else 0.5) for b in moving]
    spheres = np.concatenate(covers)
    groups = np.array([b.link for b in moving])
    starts = np.concatenate([[0], np.cumsum([len(c) for c in covers])])
    bounds = np.array([_bounding(c) for c in covers])
    robot = [b for b in cell.bodies if b.link <= TOOL]
    of = {id(b): n for n, b in enumerate(robot)}
    links = np.array([b.link for b in robot])
    pairs = ~ignored(cell)[[of[id(b)] for b in moving]] & (groups[:, None] > links)
    tabled = np.array([[guided(low, high) for low in robot] for high in moving])
    near = [(robot[b], moving[g]) for g, b in np.argwhere(pairs & tabled)]
    reach = _reach(cell, spheres, np.repeat(groups, np.diff(starts)))
    tables = near_tables(cell, near, min(cell.settings.process.self_clearance_m, GUIDED_M), reach)
    # Copies where a cell is frozen or not yet: kernels would be compiled for either kind.
    return Filter(
        chain=(
            np.ascontiguousarray(cell.robot.X_PJ), np.ascontiguousarray(cell.robot.axes),
            np.array(cell.X_WB, order="C"), np.ascontiguousarray(cell.robot.X_6F),
        ),
        spheres=(spheres, starts, bounds, groups, np.array([on_floor(cell, b) for b in moving])),
        boxes=(
            links, np.array([b.X_LG for b in robot]),
            np.array([box_of(b) for b in robot]), pairs & ~tabled, float(self_clearance),
            tables.values, tables.joints,
        ),
        world=(*_world_arrays(cell), float(clearance)),
        grid=_grid(cell) if grid is None else (*grid[:4], cell.X_WT @ cell.X_TO),
        reach=reach,
    )  # fmt: skip


def _bounding(spheres: np.ndarray) -> np.ndarray:
    """One sphere around several, shape (4,)."""
    low, high = (spheres[:, :3] - spheres[:, 3:]).min(0), (spheres[:, :3] + spheres[:, 3:]).max(0)
    centre = (low + high) / 2
    return np.append(centre, (np.linalg.norm(spheres[:, :3] - centre, axis=1) + spheres[:, 3]).max())


def _world_arrays(cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Cylinders (x, y, z, radius, half length) and boxes (pose inverse, half sides, 1 where exact) in W."""
    cylinders, boxes = [], []
    for body in cell.bodies:
        if body.link not in (TABLE, WORLD):
            continue
        X_WG = cell.X_WT @ body.X_LG if body.link == TABLE else body.X_LG
        if body.shape == "cylinder":
            cylinders.append([*X_WG[:3, 3], body.size[0], body.size[1] / 2])
        else:
            exact = [float(body.shape == "box")]
            boxes.append(np.concatenate([np.linalg.inv(X_WG)[:3].ravel(), box_of(body), exact]))
    return np.array(cylinders).reshape(-1, 5), np.array(boxes).reshape(-1, 16)


def signed_distance_grid(part: Part, spacing: float = GRID_M) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances to the part's triangles on a grid around it (negative inside) and its origin [m]."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=allowed_threads())
    vertices: Any = part.vertices.astype(np.float32)
    triangles: Any = part.triangles.astype(np.uint32)
    scene.add_triangles(vertices, triangles)
    low = part.bounds[0] - 6 * spacing
    shape = np.ceil((part.extent + 12 * spacing) / spacing).astype(int) + 1
    axes = [low[i] + spacing * np.arange(shape[i]) for i in range(3)]
    points: Any = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
    if part.closed:
        values = scene.compute_signed_distance(points, nthreads=allowed_threads()).numpy()
    else:
        values = scene.compute_distance(points, nthreads=allowed_threads()).numpy()
    return np.ascontiguousarray(values, dtype=np.float32), low


def _grid(cell: Cell) -> tuple[Any, ...]:
    if cell.part is None or not cell.part.is_mesh:
        return np.zeros((0, 0, 0), np.float32), np.zeros(3), GRID_M, np.zeros((2, 3)), cell.X_WT @ cell.X_TO
    spacing = max(GRID_M, float(cell.part.extent.max()) / 120)
    values, low = signed_distance_grid(cell.part, spacing)
    return values, low, spacing, np.ascontiguousarray(cell.part.bounds), cell.X_WT @ cell.X_TO


def _reach(cell: Cell, spheres: np.ndarray, links: np.ndarray) -> np.ndarray:
    """Bounds by the lengths of the chain: no point beyond joint i is farther from its axis than this."""
    steps = np.append(
        np.linalg.norm(cell.robot.X_PJ[1:, :3, 3], axis=1), np.linalg.norm(cell.robot.X_6F[:3, 3])
    )
    extents = np.zeros(TOOL + 1)
    np.maximum.at(extents, links, np.linalg.norm(spheres[:, :3], axis=1) + spheres[:, 3])
    reach = np.zeros(7)
    beyond = extents[TOOL]
    for i in range(5, -1, -1):
        beyond = max(extents[i + 1], steps[i] + beyond)
        reach[i] = beyond
    reach[6] = cell.part.radius if cell.part is not None else 0.0
    return reach


@njit(cache=True)
def _placed(X, p):
    """A point of a link's frame in W."""
    return (
        X[0, 0] * p[0] + X[0, 1] * p[1] + X[0, 2] * p[2] + X[0, 3],
        X[1, 0] * p[0] + X[1, 1] * p[1] + X[1, 2] * p[2] + X[1, 3],
        X[2, 0] * p[0] + X[2, 1] * p[1] + X[2, 2] * p[2] + X[2, 3],
    )


@njit(cache=True)
def _box_frame(X, G, T):
    """Writes the inverse pose of a solid (pose G in its link, the link at X) into T, in rows of four."""
    o = _placed(X, G[:3, 3])
    for r in range(3):
        total = 0.0
        for k in range(3):
            a = X[k, 0] * G[0, r] + X[k, 1] * G[1, r] + X[k, 2] * G[2, r]
            T[4 * r + k] = a
            total += a * o[k]
        T[4 * r + 3] = -total


@njit(cache=True)
def _cylinder(px, py, pz, c):
    """Signed distance of a point to an upright cylinder."""
    dr = np.sqrt((px - c[0]) ** 2 + (py - c[1]) ** 2) - c[3]
    dz = abs(pz - c[2]) - c[4]
    return min(max(dr, dz), 0.0) + np.sqrt(max(dr, 0.0) ** 2 + max(dz, 0.0) ** 2)


@njit(cache=True)
def _box(px, py, pz, T, half):
    """Signed distance of a point to a box; T holds the inverse pose in rows of four."""
    inner, outer = -1e9, 0.0
    for r in range(3):
        d = abs(T[4 * r] * px + T[4 * r + 1] * py + T[4 * r + 2] * pz + T[4 * r + 3]) - half[r]
        inner = max(inner, d)
        if d > 0:
            outer += d * d
    return min(inner, 0.0) + np.sqrt(outer)


@njit(cache=True)
def _part(px, py, pz, cos, sin, grid):
    """Lower bound of the signed distance to the part, which has turned by E1."""
    values, low, h, bounds, X = grid
    if values.size == 0:
        return 1e9
    x, y, z = px - X[0, 3], py - X[1, 3], pz - X[2, 3]
    o0, o1 = cos * x + sin * y, -sin * x + cos * y
    out = 0.0
    for a, v in ((0, o0), (1, o1), (2, z)):
        d = max(bounds[0, a] - v, v - bounds[1, a], 0.0)
        out += d * d
    out = np.sqrt(out)
    i, j, k = round((o0 - low[0]) / h), round((o1 - low[1]) / h), round((z - low[2]) / h)
    if i < 0 or j < 0 or k < 0 or i >= values.shape[0] or j >= values.shape[1] or k >= values.shape[2]:
        return out
    gap = np.sqrt((low[0] + i * h - o0) ** 2 + (low[1] + j * h - o1) ** 2 + (low[2] + k * h - z) ** 2)
    return max(values[i, j, k] - gap, out)


@njit(cache=True)
def _outside(px, py, pz, floor, cos, sin, world, grid):
    """Distance of a point to everything that is not the robot, less the clearance."""
    cylinders, boxes, clearance = world
    d = 1e9
    for n in range(len(cylinders)):
        d = min(d, _cylinder(px, py, pz, cylinders[n]))
    for n in range(len(boxes)):
        if n > 0 or floor:
            d = min(d, _box(px, py, pz, boxes[n, :12], boxes[n, 12:15]))
    return min(d, _part(px, py, pz, cos, sin, grid)) - clearance


@njit(cache=True)
def margin(q, chain, spheres, boxes, world, grid, enough):
    """Lower bound of the distance to contact beyond the clearances; exact only below `enough` [m]."""
    X = np.empty((8, 3, 4))
    link_frames(q, chain, X)
    cos, sin = np.cos(q[6]), np.sin(q[6])
    points, starts, bounds, groups, floored = spheres
    box_link, box_X, box_half, pairs, self_clearance, tables, table_joints = boxes
    best = way_to_blocked(q, tables, table_joints, enough)
    if best < 0:
        return best
    T = np.empty((len(box_link), 12))
    middle = np.empty((len(box_link), 4))
    for b in range(len(box_link)):
        _box_frame(X[box_link[b]], box_X[b], T[b])
        middle[b, 0], middle[b, 1], middle[b, 2] = _placed(X[box_link[b]], box_X[b, :3, 3])
        middle[b, 3] = np.sqrt(box_half[b, 0] ** 2 + box_half[b, 1] ** 2 + box_half[b, 2] ** 2)
    for g in range(len(groups)):
        link = groups[g]
        floor = floored[g]
        c = _placed(X[link], bounds[g])
        if _outside(c[0], c[1], c[2], floor, cos, sin, world, grid) - bounds[g, 3] < best:
            for n in range(starts[g], starts[g + 1]):
                p = _placed(X[link], points[n])
                best = min(best, _outside(p[0], p[1], p[2], floor, cos, sin, world, grid) - points[n, 3])
                if best < 0:
                    return best
        for b in range(len(box_link)):
            if not pairs[g, b]:
                continue
            apart = bounds[g, 3] + middle[b, 3] + self_clearance + best
            gap = (c[0] - middle[b, 0]) ** 2 + (c[1] - middle[b, 1]) ** 2 + (c[2] - middle[b, 2]) ** 2
            if gap >= apart * apart:
                continue
            if _box(c[0], c[1], c[2], T[b], box_half[b]) - bounds[g, 3] - self_clearance >= best:
                continue
            for n in range(starts[g], starts[g + 1]):
                p = _placed(X[link], points[n])
                best = min(best, _box(p[0], p[1], p[2], T[b], box_half[b]) - points[n, 3] - self_clearance)
                if best < 0:
                    return best
    return best


@njit(cache=True)
def margins(q, chain, spheres, boxes, world, grid, enough):
    """`margin` of each row of q (n, 7), shape (n,)."""
    out = np.empty(len(q))
    for i in range(len(q)):
        out[i] = margin(q[i], chain, spheres, boxes, world, grid, enough)
    return out


@njit(cache=True)
def edge_free(qa, qb, chain, spheres, boxes, world, grid, reach, pad):
    """Whether the straight joint edge is free all along; else where it stops, in 0..1.

    From a configuration with margin m nothing can come closer than the clearances before some point has moved
    by m; the edge is walked in such steps, or of 2 `pad` where m is less: between two free samples that far
    apart nothing comes closer than the clearances less `pad`, which the arrays were padded by.
    """
    way = 0.0
    for i in range(7):
        way += abs(qb[i] - qa[i]) * reach[i]
    t, q = 0.0, np.empty(7)
    while True:
        for i in range(7):
            q[i] = qa[i] + t * (qb[i] - qa[i])
        m = margin(q, chain, spheres, boxes, world, grid, 0.5)
        if m < 0.0:
            return False, t
        if t >= 1.0:
            return True, 1.0
        t = min(1.0, t + max(m, 2.0 * pad) / max(way, 1e-12))


@njit(cache=True)
def edges_free(qa, qb, chain, spheres, boxes, world, grid, reach, pad):
    """`edge_free` of each pair of rows, shape (n,)."""
    out = np.empty(len(qa), np.bool_)
    for i in range(len(qa)):
        out[i] = edge_free(qa[i], qb[i], chain, spheres, boxes, world, grid, reach, pad)[0]
    return out
