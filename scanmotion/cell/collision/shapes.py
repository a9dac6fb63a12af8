"""The solids of a cell for FCL, and which points lie in them."""

import functools

import fcl
import numpy as np

from scanmotion.cell.arm.robot import Body
from scanmotion.geometry.convex import Hull, hull_from


def box_of(body: Body) -> np.ndarray:
    """Half sides of the box that holds a body, shape (3,) [m]."""
    if body.shape == "cylinder":
        return np.array([body.size[0], body.size[0], body.size[1] / 2])
    if body.shape == "sphere":
        return np.full(3, body.size[0])
    return np.array(body.size) / 2


@functools.lru_cache(maxsize=1024)
def hull_of(body: Body) -> Hull:
    """Corners and faces of a body of the shape "hull", in its own frame."""
    assert body.points is not None
    return hull_from(body.points)


def fcl_shape(body: Body) -> fcl.CollisionGeometry:
    """The body as FCL's geometry, in its own frame."""
    if body.shape == "box":
        return fcl.Box(*body.size)
    if body.shape == "cylinder":
        return fcl.Cylinder(*body.size[:2])
    if body.shape == "sphere":
        return fcl.Sphere(body.size[0])
    hull = hull_of(body)
    faces = np.concatenate([np.full((len(hull.faces), 1), 3), hull.faces], axis=1)
    return fcl.Convex(hull.points, len(hull.faces), faces.ravel())


def fcl_object(body: Body, X_WG: np.ndarray) -> fcl.CollisionObject:
    """The body at a pose, shape (4, 4)."""
    R, p = np.ascontiguousarray(X_WG[:3, :3]), np.ascontiguousarray(X_WG[:3, 3])
    return fcl.CollisionObject(fcl_shape(body), fcl.Transform(R, p))


def beyond(body: Body, p: np.ndarray) -> np.ndarray:
    """Lower bound of the signed distance of points (n, 3) of the body's frame to a hull, shape (n,) [m].

    The greatest distance to a plane of its faces: negative inside, and never more than the true distance.
    """
    hull = hull_of(body)
    a, b, c = (hull.points[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    keep = length > 1e-12
    normals = normals[keep] / length[keep, None]
    return (p @ normals.T - np.einsum("ni,ni->n", normals, a[keep])).max(axis=1)


def inside_shape(body: Body, p: np.ndarray) -> np.ndarray:
    """Whether points (n, 3) of the body's own frame lie in it, shape (n,)."""
    if body.shape == "box":
        return np.all(np.abs(p) <= np.array(body.size) / 2, axis=1)
    if body.shape == "sphere":
        return np.linalg.norm(p, axis=1) <= body.size[0]
    if body.shape == "hull":
        return np.asarray(beyond(body, p) <= 0.0)
    radius, length = body.size[:2]
    return (np.hypot(p[:, 0], p[:, 1]) <= radius) & (np.abs(p[:, 2]) <= length / 2)
