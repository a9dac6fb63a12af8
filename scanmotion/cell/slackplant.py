"""The cell as a plant for Drake's InverseKinematics: every solid, the part among them as its hull."""

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    Convex,
    GeometrySet,
    ProximityProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame
from pydrake.systems.framework import DiagramBuilder

from scanmotion.cell.filter import IGNORED_PAIRS
from scanmotion.cell.scene import add_cell

if TYPE_CHECKING:
    from scanmotion.cell.plant import Cell


class SlackPlant:
    """Plant, context and frames in which a configuration of arm and table is sought by InverseKinematics.

    Drake's proximity takes a mesh as its convex hull: with the hull what is found is free of the part, but
    what has to reach into a notch is not found; without the part the caller has to check what comes out.
    One instance belongs to one thread.

    Args:
        cell: the cell.
        part: "hull" puts the convex hull of the part on the table, "none" leaves it out.
    """

    def __init__(self, cell: "Cell", *, part: Literal["hull", "none"]) -> None:
        builder = DiagramBuilder()
        self.plant, scene = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_cell(self.plant, cell)
        X_FS: Any = cell.X_FS
        X_TO: Any = cell.X_TO
        flange = self.plant.GetFrameByName(cell.settings.robot.flange)
        table = self.plant.GetFrameByName("turntable")
        self.frame_S = self.plant.AddFrame(FixedOffsetFrame("S", flange, RigidTransform(X_FS)))
        self.frame_O = self.plant.AddFrame(FixedOffsetFrame("O", table, RigidTransform(X_TO)))
        if part == "hull" and cell.part is not None:
            _add_hull(self.plant, cell)
        self.plant.Finalize()
        _filter(self.plant, scene, cell)
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self._root)
        names = [*cell.settings.robot.joints, "E1"]
        self._order = np.array([self.plant.GetJointByName(n).position_start() for n in names])

    def positions(self, q: np.ndarray) -> np.ndarray:
        """The plant's positions for a configuration (7,) of A1..A6, E1 [rad]."""
        out = np.zeros(self.plant.num_positions())
        out[self._order] = q
        return out

    def configuration(self, positions: np.ndarray) -> np.ndarray:
        """A1..A6, E1 of the plant's positions, shape (7,) [rad]."""
        return np.asarray(positions)[self._order]

    @property
    def order(self) -> np.ndarray:
        """Index of each of A1..A6, E1 in the plant's position vector."""
        return self._order


def _add_hull(plant: MultibodyPlant, cell: "Cell") -> None:
    """Welds the convex hull of the part's vertices to the table."""
    from scipy.spatial import ConvexHull

    assert cell.part is not None
    points = cell.part.vertices
    corners = points[ConvexHull(points).vertices]
    # The stubs of pydrake know no arrays.
    X: Any = cell.X_TO
    convex: Any = Convex
    body, shape = plant.GetBodyByName("turntable"), convex(corners.T, "part")
    plant.RegisterCollisionGeometry(body, RigidTransform(X), shape, "part", ProximityProperties())


def _filter(plant: MultibodyPlant, scene: SceneGraph, cell: "Cell") -> None:
    """Leaves out the pairs that touch by construction, and what does not belong to the robot."""
    joints = [plant.GetJointByName(n) for n in cell.settings.robot.joints]
    bodies = [joints[0].parent_body(), *(j.child_body() for j in joints), plant.GetBodyByName("tool")]
    floor = plant.GetBodyByName("surroundings")
    still = [floor, plant.GetBodyByName("stand"), plant.GetBodyByName("turntable"), bodies[0]]
    pairs = [(bodies[a], bodies[b]) for a, b in sorted(IGNORED_PAIRS)] + [(bodies[1], floor)]
    pairs += [(a, b) for n, a in enumerate(still) for b in still[n + 1 :]]
    manager = scene.collision_filter_manager()
    for a, b in pairs:
        of = [GeometrySet(plant.GetCollisionGeometriesForBody(body)) for body in (a, b)]
        manager.Apply(CollisionFilterDeclaration().ExcludeBetween(of[0], of[1]))
