"""The solids of a written plan: FCL's shapes, the boxes that hold them, and where they are."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fcl
import numpy as np

from scanmotion.core.errors import PartError, PlanFileError
from scanmotion.geometry.part_files import read_geometry
from scanmotion.judge.motion import Motion, UrdfArm
from scanmotion.plan_io.read import inside
from scanmotion.plan_io.schema import PlanRecord

TOOL, STILL, PART = 7, -1, -2
"""Groups beside the links 0..6."""
_TOUCHING = {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 7), (0, 2), (4, 6), (5, 7)}
"""Links that meet by construction; base and link 2, links 4 and 6 by their boxes' excess."""
_FARTHEST_M = 100.0
"""No corner of a part is as far from its origin."""
_TURNING, _UNDER = ("table", "pedestal"), ("table", "table_column", "pedestal", "floor")
"""Round solids that turn with E1; what the part may stand on."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Solid:
    """One solid: its exact shape, and a box that holds it, both centred on the frame G."""

    name: str
    group: int
    """0..6 links, TOOL, STILL, PART."""
    shape: Any
    """FCL's collision object."""
    half: np.ndarray
    """Half sides of the box, shape (3,) [m]."""
    X_CG: np.ndarray
    """Pose of G in what carries it: W at zero for a link, the flange, the object, or W."""

    @property
    def radius(self) -> float:
        """Of the sphere about G's origin that holds it [m]."""
        return float(np.linalg.norm(self.half))

    def poses(self, motion: Motion) -> np.ndarray:
        """X_WG at each sample, shape (N, 4, 4), or (1, 4, 4) where it never moves."""
        if self.group == STILL:
            return self.X_CG[None]
        if self.group == PART:
            return motion.X_WO @ self.X_CG
        return (motion.X_WF if self.group == TOOL else motion.X_WL[:, self.group]) @ self.X_CG


def solids_of(folder: Path, record: PlanRecord, arm: UrdfArm) -> list[Solid]:
    """The robot's links, the tool, what stands around, and the part's true triangles.

    Raises:
        PlanFileError: the part's file has no triangles.
    """
    out = []
    for name, link, kind, size, X_BG in arm.solids:
        shape, half = _primitive(kind, size)
        out.append(Solid(name=name, group=link, shape=shape, half=half, X_CG=X_BG))
    for body in record.bodies:
        shape, half = _primitive(body.shape, body.size_m)
        X, group = np.array(body.X), TOOL if body.frame == "flange" else STILL
        if body.frame == "table":
            X = np.array(record.X_WT) @ X
        out.append(Solid(name=body.name, group=group, shape=shape, half=half, X_CG=X))
    return [*out, _part(folder, record)]


def _primitive(kind: str, size: tuple[float, ...]) -> tuple[Any, np.ndarray]:
    """FCL's object and the half sides of its box."""
    if len(size) != {"box": 3, "cylinder": 2, "sphere": 1}[kind] or min(size) <= 0:
        raise PlanFileError(f"a {kind} cannot have the sizes {list(size)}")
    if kind == "box":
        geometry, half = fcl.Box(*size), np.array(size) / 2
    elif kind == "cylinder":
        geometry, half = fcl.Cylinder(*size), np.array([size[0], size[0], size[1] / 2])
    else:
        geometry, half = fcl.Sphere(size[0]), np.full(3, size[0])
    return fcl.CollisionObject(geometry, fcl.Transform()), half


def _part(folder: Path, record: PlanRecord) -> Solid:
    try:
        raw = read_geometry(inside(folder, record.part_file))
    except PartError as error:
        raise PlanFileError(str(error)) from None
    if len(raw.triangles) == 0 or not (np.abs(raw.vertices) < _FARTHEST_M).all():
        raise PlanFileError(f"{record.part_file}: has no triangles, or corners {_FARTHEST_M:g} m away")
    low, high = raw.vertices.min(axis=0), raw.vertices.max(axis=0)
    model = fcl.BVHModel()
    model.beginModel(len(raw.vertices), len(raw.triangles))
    model.addSubModel(raw.vertices - (low + high) / 2, raw.triangles)
    model.endModel()
    X_OG = np.eye(4)
    X_OG[:3, 3] = (low + high) / 2
    shape = fcl.CollisionObject(model, fcl.Transform())
    return Solid(name="part", group=PART, shape=shape, half=(high - low) / 2, X_CG=X_OG)


def pairs_of(solids: list[Solid], clearance: float) -> list[tuple[Solid, Solid, float]]:
    """Which two must keep which distance: robot and surroundings the clearance, links must not touch."""
    robot = [s for s in solids if s.group >= 1]
    around = [s for s in solids if s.group < 0]
    links = [s for s in solids if s.group >= 0]
    pairs = [(a, b, clearance) for a in robot for b in around if not (a.group == 1 and b.name == "floor")]
    # What turns must not touch what stands about it.
    turning = [s for s in around if s.group == PART or s.name in _TURNING]
    pairs += [(a, b, 0.0) for a in turning for b in around if b.group == STILL and b.name not in _UNDER]
    for i, a in enumerate(links):
        for b in links[i + 1 :]:
            if a.group != b.group and (min(a.group, b.group), max(a.group, b.group)) not in _TOUCHING:
                pairs.append((a, b, 0.0))
    return pairs
