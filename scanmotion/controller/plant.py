"""Arm and table in Drake's Simulator behind position control: how far they lag behind what they are told.

Assumptions: nothing touches; rigid links with the masses of the URDF, gravity balanced, each joint under
computed torque of the bandwidth stated below; friction, elasticity, dead time and drives' limits left out.
"""

from typing import Any

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import InverseDynamicsController
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from scanmotion.cell.build import Cell
from scanmotion.cell.drake_scene import add_cell

BANDWIDTH_HZ = 8.0
"""Natural frequency of each joint behind its controller, critically damped."""
STEP_S = 0.002


def tracked(cell: Cell, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Where arm and table are while they are told to follow joints over time.

    Args:
        cell: what moves.
        t: increasing times from 0, shape (n,) [s].
        q: what the controller commands, shape (n, 7) [rad].

    Returns:
        shape (n, 7) [rad].
    """
    builder = DiagramBuilder()
    plant, scene = AddMultibodyPlantSceneGraph(builder, STEP_S)
    add_cell(plant, cell)
    if plant.num_actuators() == 0:
        for name in cell.joint_names:
            plant.AddJointActuator(f"drive_{name}", plant.GetJointByName(name))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    # The judge tells what touches what; here neighbours whose shapes overlap must not push one another.
    solids = GeometrySet(scene.model_inspector().GetAllGeometryIds(Role.kProximity))
    scene.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(solids))
    order = [plant.GetJointByName(name).position_start() for name in cell.joint_names]
    asked = np.zeros_like(q)
    asked[:, order] = q
    w = 2 * np.pi * BANDWIDTH_HZ
    n = plant.num_positions()
    gains: Any = (np.full(n, w**2), np.zeros(n), np.full(n, 2 * w))
    control = builder.AddSystem(InverseDynamicsController(plant, gains[0], gains[1], gains[2], False))
    curve = PiecewisePolynomial.FirstOrderHold(t, asked.T)
    source = builder.AddSystem(TrajectorySource(curve, 1, True))
    builder.Connect(source.get_output_port(), control.get_input_port_desired_state())
    builder.Connect(plant.get_state_output_port(), control.get_input_port_estimated_state())
    builder.Connect(control.get_output_port_control(), plant.get_actuation_input_port())
    log = LogVectorOutput(plant.get_state_output_port(), builder, 5 * STEP_S)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), asked[0])
    simulator.AdvanceTo(float(t[-1]))
    found = log.FindLog(context)
    rows = found.data()[:n].T[:, order]
    return np.column_stack([np.interp(t, found.sample_times(), rows[:, j]) for j in range(7)])
