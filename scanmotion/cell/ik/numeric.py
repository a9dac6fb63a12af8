"""Inverse kinematics of any other arm: Drake's InverseKinematics from several seeds, always the same ones."""

from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.solvers import SnoptSolver, SolverOptions

from scanmotion.cell.arm.robot import Robot, Solved, arm_jacobian, arm_poses, clean_angle, least_singular
from scanmotion.core.support.streams import fixed_stream

SEEDS = 12
_NEAR_M, _NEAR_RAD = 1e-3, 1e-2
"""How near Drake has to come; Newton's steps do the rest."""
_SAME = 1e-4
"""Answers that are nearer to each other than this are one [rad]."""


class NumericArm:
    """Solves by search: what exists may be missed, what is returned is exact.

    One instance belongs to one thread.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.plant = _plant(robot)
        span = np.minimum(robot.upper - robot.lower, 2 * np.pi)
        middle = np.clip(0.0, robot.lower + span / 2, robot.upper - span / 2)
        self.seeds = middle + (fixed_stream("numeric_ik_starts").random((SEEDS, 6)) - 0.5) * span
        steps = np.linalg.norm(robot.X_PJ[1:, :3, 3], axis=1).sum() + np.linalg.norm(robot.X_6F[:3, 3])
        self.length = float(steps)
        self.options = SolverOptions()
        self.options.SetOption(SnoptSolver.id(), "Major iterations limit", 100)

    def __call__(self, X_BF: np.ndarray) -> Solved:
        """Configurations of flange poses in the base, shape (n, 4, 4), in as many slots as were needed."""
        away = np.linalg.norm(X_BF[:, :3, 3] - self.robot.X_PJ[0, :3, 3], axis=1)
        extension = self.length - away
        found = [self._answers(X) if inside else [] for X, inside in zip(X_BF, extension > 0, strict=True)]
        slots = max((len(f) for f in found), default=0) or 1
        joints, sigma = np.full((len(X_BF), slots, 6), np.nan), np.full((len(X_BF), slots), np.nan)
        for i, rows in enumerate(found):
            if rows:
                joints[i, : len(rows)] = rows
                sigma[i, : len(rows)] = least_singular(self.robot, np.array(rows))
        return Solved(joints=joints, sigma_min=sigma, extension=extension)

    def _answers(self, X: Any) -> list[np.ndarray]:
        """Different configurations for one pose, turned into (-pi, pi]."""
        ik: Any = InverseKinematics(self.plant)
        tip, world = self.plant.GetFrameByName("flange"), self.plant.world_frame()
        ik.AddPositionConstraint(tip, np.zeros(3), world, X[:3, 3] - _NEAR_M, X[:3, 3] + _NEAR_M)
        goal = RotationMatrix(X[:3, :3])
        ik.AddOrientationConstraint(tip, RotationMatrix(), world, goal, _NEAR_RAD)
        found: list[np.ndarray] = []
        for seed in self.seeds:
            result = SnoptSolver().Solve(ik.prog(), seed, self.options)
            q = self._polished(result.GetSolution(ik.q()), X) if result.is_success() else None
            if q is not None and all(np.abs(clean_angle(q - other)).max() > _SAME for other in found):
                found.append(q)
        return found

    def _polished(self, q: Any, X: np.ndarray) -> np.ndarray | None:
        """Damped Newton steps onto the pose; None where they do not lead there."""
        for _ in range(20):
            now = (arm_poses(self.robot, q[None])[:, 6] @ self.robot.X_6F)[0]
            turn = X[:3, :3] @ now[:3, :3].T
            off = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            error = np.concatenate([off, X[:3, 3] - now[:3, 3]])
            if np.abs(error).max() < 1e-11:
                return clean_angle(q)
            J = arm_jacobian(self.robot, q[None])[0]
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(6), error)
        return None


def _plant(robot: Robot) -> MultibodyPlant:
    """The joints of an arm without its solids, from the numbers that were read."""
    plant = MultibodyPlant(time_step=0.0)
    # Drake's stubs know no plain arrays.
    numbers: Any = (robot.X_PJ, robot.X_6F, robot.axes, robot.lower, robot.upper)
    X_PJ, X_6F, axes, low, high = numbers
    parent = plant.world_frame()
    for i in range(6):
        link = plant.AddRigidBody(f"link_{i + 1}", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        place = plant.AddFrame(FixedOffsetFrame(f"joint_{i + 1}", parent, RigidTransform(X_PJ[i])))
        joint = RevoluteJoint(f"A{i + 1}", place, link.body_frame(), axes[i], low[i], high[i])
        plant.AddJoint(joint)
        parent = link.body_frame()
    plant.AddFrame(FixedOffsetFrame("flange", parent, RigidTransform(X_6F)))
    plant.Finalize()
    return plant
