"""The solids of a written plan: FCL's shapes, the boxes that hold them, and where they are."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import fcl
import numpy as np

from scanmotion.core.errors import PartError, PlanFileError
from scanmotion.geometry.files.collada import triangles_of_collada
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.judge.motion import Motion, UrdfArm, motion_at
from scanmotion.plan_io.read import inside
from scanmotion.plan_io.schema import PlanRecord

TOOL, STILL, PART = 7, -1, -2
"""Groups beside the links 0..6."""
_POSITIONS = {1: 30, 2: 9}
"""Positions of each joint that are tried, by how many lie between two links."""
_NEARLY_ALWAYS = 0.9
"""Share of positions from which on two solids count as meeting by construction."""
Meeting = Mapping[tuple[str, str, str, str], float]
"""Share of positions in which two solids meet, by carrier and name of each, in either order."""
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
    carrier: str = ""
    """Link of the URDF that has it; empty for what the plan lists."""
    side: bool = False
    """Whether its carrier hangs on a link of the chain by a side branch."""
    mesh: bool = False
    """Whether it is a mesh of the URDF."""

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
    for solid in arm.solids:
        X_CG = solid.X_BG
        if solid.kind == "mesh":
            shape, half, middle = _mesh(folder, solid.file, np.array(solid.size))
            X_CG = X_CG @ _shifted(middle)
        else:
            shape, half = _primitive(solid.kind, solid.size)
        out.append(
            Solid(
                name=solid.name, group=solid.group, shape=shape, half=half, X_CG=X_CG,
                carrier=solid.carrier, side=solid.side, mesh=solid.kind == "mesh",
            )
        )  # fmt: skip
    for body in record.bodies:
        X, group = np.array(body.X), TOOL if body.frame == "flange" else STILL
        if body.shape == "mesh":
            shape, half, middle = _mesh(folder, body.file, np.array(body.size_m))
            X = X @ _shifted(middle)
        else:
            shape, half = _primitive(body.shape, body.size_m)
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
    shape, half, middle = _mesh(folder, record.part_file, np.ones(3))
    return Solid(name="part", group=PART, shape=shape, half=half, X_CG=_shifted(middle))


def _shifted(p: np.ndarray) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = p
    return X


def _mesh(folder: Path, name: str, scale: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray]:
    """FCL's object of true triangles about the middle of their box, half its sides, and the middle."""
    try:
        path = inside(folder, name)
        if path.suffix.lower() == ".dae":
            raw = triangles_of_collada(path.read_bytes(), name)
        else:
            raw = read_geometry(path)
    except PartError as error:
        raise PlanFileError(str(error)) from None
    vertices = raw.vertices * scale
    if len(raw.triangles) == 0 or not (np.abs(vertices) < _FARTHEST_M).all():
        raise PlanFileError(f"{name}: has no triangles, or corners {_FARTHEST_M:g} m away")
    used = vertices[np.unique(raw.triangles)]
    low, high = used.min(axis=0), used.max(axis=0)
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(raw.triangles))
    model.addSubModel(vertices - (low + high) / 2, raw.triangles)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform()), (high - low) / 2, (low + high) / 2


def pairs_of(
    solids: list[Solid], clearance: float, joined: frozenset[frozenset[str]], meeting: Meeting
) -> list[tuple[Solid, Solid, float]]:
    """Which two must keep which distance: robot and surroundings the clearance, links must not touch.

    Args:
        solids: of `solids_of`.
        clearance: of robot and surroundings [m].
        joined: links of the URDF at the two ends of a joint.
        meeting: solids that meet in nearly every position, from `meeting_solids`.
    """
    robot = [s for s in solids if s.group >= 1]
    around = [s for s in solids if s.group < 0]
    links = [s for s in solids if s.group >= 0]
    base = [s for s in links if s.group == 0]
    pairs = [(a, b, clearance) for a in robot for b in around if not stands_on(a, b)]
    # What turns must not touch what stands about it.
    turning = [s for s in around if s.group == PART or s.name in _TURNING]
    pairs += [(a, b, 0.0) for a in turning for b in around if b.group == STILL and b.name not in _UNDER]
    pairs += [(a, b, 0.0) for a in turning for b in base]
    for i, a in enumerate(links):
        for b in links[i + 1 :]:
            if rigid(a) == rigid(b) or frozenset((a.carrier, b.carrier)) in joined:
                continue
            if pair_key(a, b) not in meeting:
                pairs.append((a, b, 0.0))
    return pairs


def stands_on(a: Solid, b: Solid) -> bool:
    """Whether a is of what A1 turns on the floor b."""
    return a.group == 1 and not a.side and b.name == "floor"


def rigid(a: Solid) -> int:
    """What a solid moves with; the tool is fixed to link 6."""
    return min(a.group, 6)


def pair_key(a: Solid, b: Solid) -> tuple[str, str, str, str]:
    """How `Meeting` calls two solids, whichever comes first."""
    first, second = sorted(((a.carrier, a.name), (b.carrier, b.name)))
    return (*first, *second)


def meeting_solids(solids: list[Solid], record: PlanRecord, arm: UrdfArm) -> Meeting:
    """Solids that touch in nearly all of some positions of the one or two joints between them.

    No motion could keep them apart: the model has them meet by construction. Links at either end of a joint
    are not asked about.
    """
    links = [s for s in solids if s.group >= 0]
    spans: dict[tuple[int, int], list[tuple[Solid, Solid]]] = {}
    for a, b in combinations(sorted(links, key=rigid), 2):
        if rigid(b) - rigid(a) in _POSITIONS and frozenset((a.carrier, b.carrier)) not in arm.joined:
            spans.setdefault((rigid(a), rigid(b)), []).append((a, b))
    out = {}
    for (first, last), pairs in spans.items():
        motion = motion_at(arm, record, *_positions(arm, first, last))
        units: dict[tuple[str, str], list[tuple[Solid, Solid]]] = {}
        for a, b in pairs:
            units.setdefault((_unit(a), _unit(b)), []).append((a, b))
        for both in units.values():
            share = _share_meeting(both, motion)
            if share >= _NEARLY_ALWAYS:
                out |= {pair_key(a, b): share for a, b in both}
    return out


def _unit(solid: Solid) -> str:
    """The meshes of a link count as one solid, others each for itself."""
    return solid.carrier if solid.mesh else f"{solid.carrier}/{solid.name}"


def _share_meeting(pairs: list[tuple[Solid, Solid]], motion: Motion) -> float:
    """Share of positions in which one of some pairs touches; 0 when that is little."""
    count = len(motion.t)
    placed = []
    for a, b in pairs:
        Xa, Xb = (np.broadcast_to(s.poses(motion), (count, 4, 4)) for s in (a, b))
        near = np.linalg.norm(Xa[:, :3, 3] - Xb[:, :3, 3], axis=1) < a.radius + b.radius
        placed.append((a, b, Xa, Xb, near))
    misses = 0
    for n in range(count):
        misses += not any(near[n] and _collide(a, b, Xa[n], Xb[n]) for a, b, Xa, Xb, near in placed)
        if misses > (1 - _NEARLY_ALWAYS) * count:
            return 0.0
    return 1 - misses / count


def _positions(arm: UrdfArm, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and joints (n, 7) over the ranges of the joints from link `first` to `last`, in mixed order."""
    each = _POSITIONS[last - first]
    q = np.zeros((each ** (last - first), 7))
    low, high = (np.clip(v, -2 * np.pi, 2 * np.pi) for v in (arm.lower, arm.upper))
    ranges = [np.linspace(low[k], high[k], each) for k in range(first, last)]
    q[:, first:last] = np.stack(np.meshgrid(*ranges), axis=-1).reshape(-1, last - first)
    # Neighbours in a row meet alike: a stride that is prime to the number tells sooner.
    q = q[np.argsort(np.arange(len(q)) * 37 % len(q), kind="stable")]
    return np.arange(len(q), dtype=float), q


def _collide(a: Solid, b: Solid, Xa: np.ndarray, Xb: np.ndarray) -> bool:
    a.shape.setTransform(fcl.Transform(Xa[:3, :3], Xa[:3, 3]))
    b.shape.setTransform(fcl.Transform(Xb[:3, :3], Xb[:3, 3]))
    return bool(fcl.collide(a.shape, b.shape, fcl.CollisionRequest(), fcl.CollisionResult()))
