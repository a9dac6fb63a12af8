"""Verdicts on many configurations at once, in numba: the first free ones, and those blocked beyond doubt."""

import numpy as np

from scanmotion.cell.arm.robot import Body
from scanmotion.cell.collision.shapes import inside_shape
from scanmotion.cell.collision.sphere_filter import (
    _box,
    _box_frame,
    _cylinder,
    _outside,
    _placed,
    margin,
)
from scanmotion.cell.model import TOOL, Cell
from scanmotion.geometry.chain import link_frames
from scanmotion.geometry.jit import njit


def sure_points(cell: Cell, spheres: tuple) -> np.ndarray:
    """Which centres of the covering spheres lie in a solid of their link: what touches those touches it.

    Args:
        cell: the cell.
        spheres: of `filter_from`.
    """
    points, starts, _, groups, _ = spheres
    sure = np.zeros(len(points), bool)
    for g, link in enumerate(groups):
        rows = slice(starts[g], starts[g + 1])
        for body in cell.bodies:
            if body.link != link or link > TOOL:
                continue
            p = (points[rows, :3] - body.X_LG[:3, 3]) @ body.X_LG[:3, :3]
            sure[rows] |= inside_shape(body, p)
    return sure


def lattice(body: Body) -> np.ndarray:
    """Points of a solid in its link, shape (n, 3) [m].

    Corners, middles of the sides and the middle of a box; a cylinder's axis; a sphere's middle; a hull's
    corners.
    """
    if body.points is not None:
        points = body.points
    elif body.shape == "box":
        signs = np.array(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3, indexing="ij")).reshape(3, -1).T
        points = signs[np.abs(signs).sum(axis=1) != 2] * np.array(body.size) / 2
    elif body.shape == "sphere":
        points = np.zeros((1, 3))
    else:
        points = np.array([[0, 0, -0.5], [0, 0, 0.0], [0, 0, 0.5]]) * body.size[1]
    return points @ body.X_LG[:3, :3].T + body.X_LG[:3, 3]


@njit(cache=True)
def tool_blocked(X_WF, e1, points, pad, world, grid):
    """Whether one of the tool's own points (k, 3) comes too near to table, surroundings or part, shape (n,).

    Args:
        X_WF: flange poses, shape (n, 4, 4).
        e1: the table's angle at each, shape (n,) [rad].
        points: in the flange, shape (k, 3) [m].
        pad: by how much less than the arrays' clearance counts [m].
        world: as in `filter_from`.
        grid: likewise.
    """
    out = np.zeros(len(X_WF), np.bool_)
    for i in range(len(X_WF)):
        cos, sin = np.cos(e1[i]), np.sin(e1[i])
        for n in range(len(points)):
            p = _placed(X_WF[i], points[n])
            if _at_most(p, True, cos, sin, world, grid) < world[2] - pad:
                out[i] = True
                break
    return out


@njit(cache=True)
def _part_at_most(px, py, pz, cos, sin, grid):
    """Upper bound of the signed distance to the part, which has turned by E1; 1e9 off the grid."""
    values, low, h, _, X = grid
    if values.size == 0:
        return 1e9
    x, y, z = px - X[0, 3], py - X[1, 3], pz - X[2, 3]
    o0, o1 = cos * x + sin * y, -sin * x + cos * y
    i, j, k = round((o0 - low[0]) / h), round((o1 - low[1]) / h), round((z - low[2]) / h)
    if i < 0 or j < 0 or k < 0 or i >= values.shape[0] or j >= values.shape[1] or k >= values.shape[2]:
        return 1e9
    gap = np.sqrt((low[0] + i * h - o0) ** 2 + (low[1] + j * h - o1) ** 2 + (low[2] + k * h - z) ** 2)
    return values[i, j, k] + gap


@njit(cache=True)
def _at_most(p, floor, cos, sin, world, grid):
    """Upper bound of a point's distance to everything that is not the robot."""
    cylinders, blocks, _ = world
    d = _part_at_most(p[0], p[1], p[2], cos, sin, grid)
    for k in range(len(cylinders)):
        d = min(d, _cylinder(p[0], p[1], p[2], cylinders[k]))
    for k in range(len(blocks)):
        # A box about a piece of a mesh says nothing of what is nearer than it.
        if (k > 0 or floor) and blocks[k, 15] > 0.0:
            d = min(d, _box(p[0], p[1], p[2], blocks[k, :12], blocks[k, 12:15]))
    return d


@njit(cache=True)
def first_free(q, starts, geometry, most, chain, spheres, boxes, world, grid):
    """Which rows the fast tier calls free, per owner until `most` of its rows are.

    Args:
        q: rows of all owners, shape (m, 7) [rad].
        starts: first row of each owner and the end, shape (n + 1,).
        geometry: rows of one owner with the same number place the robot alike (windings), shape (m,).
        most: free rows wanted of each owner; later rows are left False.
    """
    free = np.zeros(len(q), np.bool_)
    size = 1
    for i in range(len(geometry)):
        size = max(size, geometry[i] + 1)
    known = np.empty(size, np.int8)
    for k in range(size):
        known[k] = -1
    for n in range(len(starts) - 1):
        count = 0
        for i in range(starts[n], starts[n + 1]):
            k = geometry[i]
            if known[k] < 0:
                known[k] = 1 if margin(q[i], chain, spheres, boxes, world, grid, 1e-6) >= 0.0 else 0
            if known[k] == 1:
                free[i] = True
                count += 1
                if count >= most:
                    break
    return free


@njit(cache=True)
def _blocked(q, sure, pad, chain, spheres, boxes, solid, world, grid):
    """Whether a point inside the robot comes nearer to something than the clearance, less `pad`."""
    X = np.empty((8, 3, 4))
    link_frames(q, chain, X)
    cos, sin = np.cos(q[6]), np.sin(q[6])
    points, starts, bounds, groups, floored = spheres
    box_link, box_X, box_half, pairs, self_clearance, _, _ = boxes
    clearance = world[2]
    T = np.empty((len(box_link), 12))
    middle = np.empty((len(box_link), 4))
    for b in range(len(box_link)):
        _box_frame(X[box_link[b]], box_X[b], T[b])
        middle[b, 0], middle[b, 1], middle[b, 2] = _placed(X[box_link[b]], box_X[b, :3, 3])
        middle[b, 3] = np.sqrt(box_half[b, 0] ** 2 + box_half[b, 1] ** 2 + box_half[b, 2] ** 2)
    for g in range(len(groups)):
        link = groups[g]
        c = _placed(X[link], bounds[g])
        for b in range(len(box_link)):
            if not (pairs[g, b] and solid[b]):
                continue
            apart = bounds[g, 3] + middle[b, 3] + self_clearance
            gap = (c[0] - middle[b, 0]) ** 2 + (c[1] - middle[b, 1]) ** 2 + (c[2] - middle[b, 2]) ** 2
            if gap >= apart * apart:
                continue
            for n in range(starts[g], starts[g + 1]):
                p = _placed(X[link], points[n])
                if sure[n] and _box(p[0], p[1], p[2], T[b], box_half[b]) < self_clearance - pad:
                    return True
        if _outside(c[0], c[1], c[2], floored[g], cos, sin, world, grid) > bounds[g, 3]:
            continue
        for n in range(starts[g], starts[g + 1]):
            if not sure[n]:
                continue
            p = _placed(X[link], points[n])
            d = _at_most(p, floored[g], cos, sin, world, grid)
            if d < clearance - pad:
                return True
    return False


@njit(cache=True)
def surely_blocked(q, sure, pad, chain, spheres, boxes, solid, world, grid):
    """`_blocked` of each row of q (n, 7), shape (n,); what is not may still be blocked."""
    out = np.empty(len(q), np.bool_)
    for i in range(len(q)):
        out[i] = _blocked(q[i], sure, pad, chain, spheres, boxes, solid, world, grid)
    return out
