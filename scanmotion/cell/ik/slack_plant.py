"""The cell as a plant for Drake's InverseKinematics: every solid, the part among them as its hull."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame
from pydrake.solvers import SnoptSolver, SolverOptions
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from scanmotion.cell.collision.pairs import guided_names
from scanmotion.cell.drake_scene import add_cell, add_hull, exempt_ids

if TYPE_CHECKING:
    from scanmotion.cell.model import Cell

_AIM_M = 2e-5
_AIM_RAD = 1e-4
"""How exactly the aimed point and, without slack, the direction are kept."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AskedPose:
    """A pose of the scanner in the object, and what it may give way in about the aimed point."""

    X_OS: np.ndarray
    """Shape (4, 4)."""
    standoff: float
    """Distance of the aimed point along the axis [m]."""
    near: float
    """Least distance allowed [m]."""
    far: float
    """Greatest distance allowed [m]."""
    tilt: float
    """Greatest angle to X_OS [rad]; of the axis alone where `roll` is free."""
    roll: bool
    """Whether the scanner may turn about its axis."""


Cost = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""Cost of a configuration (7,), and its derivatives (7,)."""


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
        flange = self.plant.GetFrameByName(cell.robot.flange)
        table = self.plant.GetFrameByName("turntable")
        self.frame_S = self.plant.AddFrame(FixedOffsetFrame("S", flange, RigidTransform(X_FS)))
        self.frame_O = self.plant.AddFrame(FixedOffsetFrame("O", table, RigidTransform(X_TO)))
        if part == "hull":
            add_hull(self.plant, cell)
        self.plant.Finalize()
        _filter(self.plant, scene, cell)
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self._root)
        names = cell.joint_names
        self._order = np.array([self.plant.GetJointByName(n).position_start() for n in names])

    def positions(self, q: np.ndarray) -> np.ndarray:
        """The plant's positions for a configuration (7,) of A1..A6, E1 [rad]."""
        out = np.zeros(self.plant.num_positions())
        out[self._order] = q
        return out

    def configuration(self, positions: np.ndarray) -> np.ndarray:
        """A1..A6, E1 of the plant's positions, shape (7,) [rad]."""
        return np.asarray(positions)[self._order]

    def solve(self, asked: "AskedPose", seed: np.ndarray, distance: float) -> np.ndarray | None:
        """A configuration near `seed` whose scanner looks at the aimed point within the slack, or None.

        Args:
            asked: the pose and what it may give way in.
            seed: where the search starts, shape (7,) [rad].
            distance: least distance of all pairs that are judged [m].
        """
        ik, start = self._program(asked, distance), self.positions(seed)
        ik.prog().AddQuadraticErrorCost(np.eye(len(start)), start, ik.q())
        result = self._result(ik, start, 60)
        return self.configuration(result.GetSolution(ik.q())) if result.is_success() else None

    def refined(self, asked: "AskedPose", seed: np.ndarray, distance: float, cost: "Cost") -> np.ndarray:
        """The configuration near `seed` within the slack that costs least, as far as SNOPT comes.

        It may pass a constraint by a little: the caller checks it.

        Args:
            asked: the pose and what it may give way in.
            seed: where the search starts, shape (7,) [rad].
            distance: least distance of all pairs that are judged [m].
            cost: cost of a configuration (7,) and its derivatives (7,).
        """
        ik, order = self._program(asked, distance), self._order

        def evaluated(positions: Any) -> Any:
            if positions.dtype != object:
                return cost(np.asarray(positions, dtype=float)[order])[0]
            value, slope = cost(ExtractValue(positions).ravel()[order])
            gradient: Any = slope @ ExtractGradient(positions)[order]
            return AutoDiffXd(value, gradient)

        ik.prog().AddCost(evaluated, ik.q())
        return self.configuration(self._result(ik, self.positions(seed), 30).GetSolution(ik.q()))

    def least_distance(self, q: np.ndarray, most: float = 0.5) -> float:
        """Least distance of all pairs that are judged in one configuration (7,), at most `most` [m]."""
        self.plant.SetPositions(self.context, self.positions(q))
        port: Any = self.plant.get_geometry_query_input_port()
        pairs = port.Eval(self.context).ComputeSignedDistancePairwiseClosestPoints(most)
        return min((float(p.distance) for p in pairs), default=most)

    def _program(self, asked: "AskedPose", distance: float) -> Any:
        """Drake's InverseKinematics with the pose's constraints and a least distance."""
        # The stubs of pydrake know no arrays.
        ik: Any = InverseKinematics(self.plant, self.context, True)
        X_OS, near, far = asked.X_OS, asked.near, asked.far
        aim = X_OS[:3, 3] + asked.standoff * X_OS[:3, 2]
        beside = np.array([_AIM_M, _AIM_M, 0.0])
        ik.AddPositionConstraint(
            self.frame_O, aim, self.frame_S, np.array([0, 0, near]) - beside, np.array([0, 0, far]) + beside
        )
        z, most = np.array([0.0, 0.0, 1.0]), max(asked.tilt, _AIM_RAD)
        if asked.roll:
            ik.AddAngleBetweenVectorsConstraint(self.frame_O, X_OS[:3, 2], self.frame_S, z, 0.0, most)
        else:
            R: Any = Rotation.from_matrix(X_OS[:3, :3]).as_matrix()
            ik.AddOrientationConstraint(self.frame_O, RotationMatrix(R), self.frame_S, RotationMatrix(), most)
        ik.AddMinimumDistanceLowerBoundConstraint(distance, 0.05)
        return ik

    def _result(self, ik: Any, start: np.ndarray, iterations: int) -> Any:
        """SNOPT's answer; it stops by work done, not by time."""
        # The stubs of pydrake know no arrays.
        solver: Any = SnoptSolver()
        options = SolverOptions()
        options.SetOption(solver.solver_id(), "Major iterations limit", iterations)
        return solver.Solve(ik.prog(), start, options)

    @property
    def order(self) -> np.ndarray:
        """Index of each of A1..A6, E1 in the plant's position vector."""
        return self._order


def _filter(plant: MultibodyPlant, scene: SceneGraph, cell: "Cell") -> None:
    """Leaves out the pairs that touch by construction, and what does not belong to the robot.

    Links that joints guide past one another keep less than the one distance that Drake's constraint asks of
    all: the caller's check holds them.
    """
    arm = plant.GetModelInstanceByName("arm")
    base = {b.carrier: plant.GetBodyByName(b.carrier, arm) for b in cell.bodies if b.link == 0}
    around = ("floor", "surroundings", "stand", "turntable")
    still = [*base.values(), *(plant.GetBodyByName(n, plant.GetModelInstanceByName(n)) for n in around)]
    pairs = [(GeometrySet(a), GeometrySet(b)) for a, b in exempt_ids(plant, cell)]
    of = [GeometrySet(plant.GetCollisionGeometriesForBody(body)) for body in still]
    pairs += [(a, b) for n, a in enumerate(of) for b in of[n + 1 :]]
    for names in sorted(map(sorted, guided_names(cell))):
        if all(plant.HasBodyNamed(name) for name in names):
            bodies = [GeometrySet(plant.GetCollisionGeometriesForBody(plant.GetBodyByName(n))) for n in names]
            pairs.append((bodies[0], bodies[1]))
    manager = scene.collision_filter_manager()
    for a, b in pairs:
        manager.Apply(CollisionFilterDeclaration().ExcludeBetween(a, b))
