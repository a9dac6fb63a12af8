"""The solids of an arm as Drake's plant has them."""

from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.geometry import Box, Convex, Cylinder, Mesh, Sphere
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.arm.robot import Body
from scanmotion.cell.arm.urdf import Urdf
from scanmotion.core.errors import CellError

MOST_M = 20.0
"""Longest side of a solid of a robot [m]."""


def robot_bodies(
    plant: MultibodyPlant, inspector: Any, urdf: Urdf, places: Any, at_joints: set, name: str
) -> tuple[Body, ...]:
    """The solids of all links, in the file's order.

    Raises:
        CellError: a solid that does not move with the chain; shapes that are not usable.
    """
    bodies, seen = [], set()
    for carrier in urdf.links:
        body = plant.GetBodyByName(carrier)
        solids = plant.GetCollisionGeometriesForBody(body)
        if body.index() not in places:
            if solids:
                raise CellError(
                    f"{name}: link {carrier!r} has solids and is not fixed to the chain; make its joint "
                    "fixed, or take its solids out",
                    key="robot.model",
                )
            continue
        link, X_LB = places[body.index()]
        for geometry in solids:
            label = inspector.GetName(geometry).rpartition("::")[2]
            label = f"{carrier}_{label}" if label in seen else label
            seen.add(label)
            X_LG = X_LB @ inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            found = _body(inspector.GetShape(geometry), label, link, X_LG, f"{name}: {label}")
            bodies.append(replace(found, carrier=carrier, side=body.index() not in at_joints))
    if not bodies:
        raise CellError(f"{name}: no collision geometry", key="robot.model")
    return tuple(bodies)


def _body(shape: Any, label: str, link: int, X_LG: np.ndarray, where: str) -> Body:
    if isinstance(shape, Box):
        size, kind = tuple(float(v) for v in shape.size()), "box"
    elif isinstance(shape, Cylinder):
        size, kind = (float(shape.radius()), float(shape.length())), "cylinder"
    elif isinstance(shape, Sphere):
        size, kind = (float(shape.radius()),), "sphere"
    elif isinstance(shape, Convex | Mesh):
        return hull_body(_corners(shape), label, link, X_LG, where)
    else:
        kind = type(shape).__name__.lower()
        raise CellError(
            f"{where}: a {kind} is not read; boxes, cylinders, spheres and meshes are", key="robot.model"
        )
    if not 0.0 < min(size) <= max(size) <= MOST_M:
        raise CellError(
            f"{where}: a {kind} of {size} m is not usable; 0 to {MOST_M:g} m are", key="robot.model"
        )
    return Body(name=label, link=link, shape=kind, size=size, X_LG=X_LG)


def _corners(shape: Any) -> np.ndarray:
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(n) for n in range(hull.num_vertices())])


def hull_body(points: np.ndarray, label: str, link: int, X_LC: np.ndarray, where: str) -> Body:
    """A convex solid with its frame in the middle of its bounding box.

    Args:
        points: its corners in frame C, shape (n, 3) [m].
        label: its name.
        link: as Body.link.
        X_LC: pose of C in the link.
        where: for messages.

    Raises:
        CellError: too large, which is mostly a mesh in millimetres.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    if not np.max(high - low) <= MOST_M:
        text = (
            f'{where}: a mesh of {np.max(high - low):.0f} m; is it in millimetres? scale="0.001 0.001 0.001"'
        )
        raise CellError(text, key="robot.model")
    X_CG = np.eye(4)
    X_CG[:3, 3] = (low + high) / 2
    own = np.ascontiguousarray(points - X_CG[:3, 3])
    own.setflags(write=False)
    size = tuple(float(v) for v in np.maximum(high - low, 1e-4))
    return Body(name=label, link=link, shape="hull", size=size, X_LG=X_LC @ X_CG, points=own)
