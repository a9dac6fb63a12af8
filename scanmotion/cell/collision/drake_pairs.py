"""Which pairs Drake's last word leaves out, worked out in Drake from its own poses and distances.

Nothing of the planner's list is asked. Guarantee: every pair of a solid of the robot with another, or with
what stands around, is held apart, but those that are named here with their reason.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.geometry import Convex, GeometryId, Mesh

from scanmotion.cell.drake_scene import DrakeCell
from scanmotion.cell.model import Cell
from scanmotion.core.support.streams import fixed_stream

CONFIGURATIONS = 200
NEARLY_ALWAYS = 0.9
"""Share of random configurations from which on two solids count as meeting by construction.

A little under the planner's, so that chance alone makes no disagreement.
"""


GUIDED_M = 1e-3
"""What links keep that two joints guide past one another: they must not touch [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NotHeld:
    """Two things that Drake's last word does not hold apart."""

    a: str
    b: str
    reason: str
    ids: tuple[tuple[GeometryId, GeometryId], ...] = field(default=())
    """The solids to leave out, where Drake does not by itself."""


def not_held(cell: Cell, drake: DrakeCell) -> tuple[NotHeld, ...]:
    """The pairs that are left out, by links and solids.

    Args:
        cell: the cell.
        drake: its plant, in which no pair has been left out yet.
    """
    return (*_joined(drake), *_meeting(cell, drake), *_around(drake))


def guided_carriers(cell: Cell, drake: DrakeCell) -> list[frozenset[str]]:
    """Pairs of the robot's bodies, by their names, with one or two moving joints between them."""
    plant = drake.plant
    moved = [
        set(plant.GetBodiesKinematicallyAffectedBy([plant.GetJointByName(name).index()]))
        for name in cell.joint_names[:6]
    ]
    link = {i: sum(i in bodies for bodies in moved) for i in _solid_bodies(drake)}
    return [
        frozenset((plant.get_body(a).name(), plant.get_body(b).name()))
        for n, a in enumerate(link)
        for b in list(link)[n + 1 :]
        if 1 <= abs(link[a] - link[b]) <= 2
    ]


def _joined(drake: DrakeCell) -> list[NotHeld]:
    """Links that are fixed to one another, or that a joint joins: Drake leaves them out by itself."""
    plant, solid = drake.plant, _solid_bodies(drake)
    rigid: dict[int, int] = {}
    for n, index in enumerate(solid):
        for body in plant.GetBodiesWeldedTo(plant.get_body(index)):
            rigid.setdefault(int(body.index()), n)
        rigid.setdefault(int(index), n)
    by_joint = {}
    for index in plant.GetJointIndices():
        joint: Any = plant.get_joint(index)
        if joint.num_positions():
            by_joint[frozenset((int(joint.parent_body().index()), int(joint.child_body().index())))] = joint
    out = []
    for n, a in enumerate(solid):
        for b in solid[n + 1 :]:
            names = plant.get_body(a).name(), plant.get_body(b).name()
            joint = by_joint.get(frozenset((int(a), int(b))))
            if rigid[int(a)] == rigid[int(b)]:
                out.append(NotHeld(a=names[0], b=names[1], reason="fixed to one another"))
            elif joint is not None:
                out.append(NotHeld(a=names[0], b=names[1], reason=f"joined by {joint.name()}"))
    return out


def _solid_bodies(drake: DrakeCell) -> list[Any]:
    """The robot's bodies that have solids."""
    plant = drake.plant
    return [i for i in drake.robot_bodies if plant.GetCollisionGeometriesForBody(plant.get_body(i))]


def _meeting(cell: Cell, drake: DrakeCell) -> list[NotHeld]:
    """Solids that are too near in nearly all of some random configurations, wherever the joints stand."""
    plant = drake.plant
    q = np.zeros((CONFIGURATIONS, 7))
    q[:, :6] = fixed_stream("drake_pairs").uniform(cell.q_min[:6], cell.q_max[:6], (CONFIGURATIONS, 6))
    owner = {g: i for i in drake.robot_bodies for g in plant.GetCollisionGeometriesForBody(plant.get_body(i))}
    floor = plant.GetBodyByName("floor", plant.GetModelInstanceByName("floor"))
    ground = set(plant.GetCollisionGeometriesForBody(floor))
    lowest = set(plant.GetBodiesKinematicallyAffectedBy([plant.GetJointByName(cell.joint_names[0]).index()]))
    lowest -= set(plant.GetBodiesKinematicallyAffectedBy([plant.GetJointByName(cell.joint_names[1]).index()]))
    unit = _units(drake)
    process, count = cell.settings.process, Counter()
    most = max(process.self_clearance_m, process.clearance_m, 1e-4)
    port: Any = plant.get_geometry_query_input_port()
    for row in drake.positions(q):
        plant.SetPositions(drake.context, row)
        met = set()
        for pair in port.Eval(drake.context).ComputeSignedDistancePairwiseClosestPoints(most):
            both = [g for g in (pair.id_A, pair.id_B) if g in owner]
            stands = len(both) == 1 and owner[both[0]] in lowest and {pair.id_A, pair.id_B} & ground
            asked = process.clearance_m if stands else min(process.self_clearance_m, GUIDED_M)
            if (len(both) == 2 or stands) and pair.distance < max(asked, 1e-4):
                met.add(tuple(sorted((unit.get(pair.id_A, 0), unit.get(pair.id_B, 0)))))
        count.update(met)
    of: dict[int, list[GeometryId]] = {0: list(ground)}
    for g, n in unit.items():
        of.setdefault(n, []).append(g)
    out = []
    for (a, b), times in count.items():
        if times >= NEARLY_ALWAYS * CONFIGURATIONS:
            share = times / CONFIGURATIONS
            reason = f"they meet in {share:.0%} of {CONFIGURATIONS} random configurations"
            if 0 in (a, b):
                reason = "what the first joint turns stands on the floor"
            names = [_name(drake, of[n]) for n in (a, b)]
            ids = tuple((x, y) for x in of[a] for y in of[b])
            out.append(NotHeld(a=names[0], b=names[1], reason=reason, ids=ids))
    return sorted(out, key=lambda pair: (pair.a, pair.b))


def _name(drake: DrakeCell, unit: list[GeometryId]) -> str:
    """The solid's name, or its link's where it is the pieces of its meshes."""
    if isinstance(drake.inspector.GetShape(unit[0]), Convex | Mesh):
        body = drake.plant.GetBodyFromFrameId(drake.inspector.GetFrameId(unit[0]))
        return str(body.name()) if body is not None else ""
    return drake.inspector.GetName(unit[0]).rpartition("::")[2]


def _units(drake: DrakeCell) -> dict[GeometryId, int]:
    """Numbers from 1 on of the robot's solids; the pieces of a link's meshes are one."""
    unit: dict[GeometryId, int] = {}
    for index in drake.robot_bodies:
        whole = 0
        for g in drake.plant.GetCollisionGeometriesForBody(drake.plant.get_body(index)):
            if isinstance(drake.inspector.GetShape(g), Convex | Mesh):
                whole = whole or len(unit) + 1
                unit[g] = whole
            else:
                unit[g] = len(unit) + 1
    return unit


def _around(drake: DrakeCell) -> list[NotHeld]:
    """What is not the robot is not held apart here; the judge holds the turning part against what stands."""
    plant = drake.plant
    world = {int(b.index()) for b in plant.GetBodiesWeldedTo(plant.world_body())}
    base = [plant.get_body(i).name() for i in _solid_bodies(drake) if int(i) in world]
    still = ("floor", "stand", "surroundings")
    out = [NotHeld(a=a, b=b, reason="neither moves") for a in base for b in still]
    out += [
        NotHeld(a="turntable", b=b, reason="neither is the robot's; the judge looks at them") for b in still
    ]
    return out
