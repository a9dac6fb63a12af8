"""A cell in Drake for people who build on it: its frames, drives, part and motion."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.geometry.parts.make_part import box_part


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.2, 0.15, 0.4))


def test_the_scanner_is_where_the_planner_has_it(cell, rng):
    made = cell.drake()
    for q in rng.uniform(np.maximum(cell.q_min, -3), np.minimum(cell.q_max, 3), size=(20, 7)):
        made.set_q(q)
        assert np.allclose(made.X_WS(), scanner_poses(cell, q[None])[0], atol=1e-9)


def test_the_part_turns_with_the_table_and_stands_on_it(cell):
    made = cell.drake()
    q = cell.home.copy()
    q[6] = 1.0
    made.set_q(q)
    query = made.scene_graph.get_query_output_port().Eval(made.scene_graph.GetMyContextFromRoot(made.context))
    inspector = query.inspector()
    shown = [i for i in inspector.GetAllGeometryIds() if inspector.GetName(i).endswith("part_picture")]
    hull = [i for i in inspector.GetAllGeometryIds() if inspector.GetName(i).endswith("part")]
    assert len(shown) == len(hull) == 1
    c, s = np.cos(1.0), np.sin(1.0)
    turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    for one in (*shown, *hull):
        X = query.GetPoseInWorld(one).GetAsMatrix4()
        assert np.allclose(X, cell.X_WT @ turn @ cell.X_TO, atol=1e-9)


def test_each_joint_has_a_drive_and_torques_against_gravity_hold_the_arm(cell):
    made = cell.drake()
    plant = made.plant
    assert plant.num_actuators() == 7
    torques = -plant.CalcGravityGeneralizedForces(made.plant_context)
    assert np.abs(torques).max() > 100.0
    asked = plant.MakeActuationMatrix().T @ torques
    plant.get_actuation_input_port().FixValue(made.plant_context, asked)
    before = plant.GetPositions(made.plant_context).copy()
    Simulator(made.diagram, made.context).AdvanceTo(0.05)
    assert np.abs(plant.GetPositions(made.plant_context) - before).max() < 1e-3
    free = cell.drake()
    free.plant.get_actuation_input_port().FixValue(free.plant_context, np.zeros(7))
    Simulator(free.diagram, free.context).AdvanceTo(0.05)
    assert np.abs(free.plant.GetPositions(free.plant_context) - before).max() > 3e-3
