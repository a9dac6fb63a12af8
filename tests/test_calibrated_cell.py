"""Calibrated poses in the YAML: taken as they are, in whichever form, and never in two."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scanmotion.cell.build import build_cell, tool_pose
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.kinematics import branches, scanner_poses
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.core.errors import CellError

HOME = [0.0, -90.0, 90.0, 0.0, 20.0, 0.0]


def pose(rpy, p):
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix(), p
    return X


def cell_from(**sections):
    return build_cell(settings_from({"robot": {"home_deg": HOME}, **sections}))


def test_the_convenient_form_and_the_matrix_are_the_same_cell(rng):
    plain = cell_from(base={"position_m": [0.1, -0.2, 0.3], "yaw_deg": 20})
    X_FS = tool_pose(load_cell("kr240")).tolist()
    same = cell_from(base={"X_WB": plain.X_WB.tolist()}, tool={"X_FS": X_FS})
    # As a plan's folder keeps it, with every key.
    dumped = json.loads(same.settings.model_dump_json())
    np.testing.assert_allclose(build_cell(settings_from(dumped)).X_WB, same.X_WB, atol=1e-14)
    q = np.column_stack([rng.uniform(plain.q_min[:6], plain.q_max[:6], (200, 6)), np.zeros(200)])
    np.testing.assert_allclose(scanner_poses(same, q), scanner_poses(plain, q), atol=1e-12)
    np.testing.assert_array_equal(Clearance(same).free(q), Clearance(plain).free(q))


def test_a_tilted_base_and_a_skew_scanner_hold_in_numpy_and_drake(rng):
    X_WB, X_FS = pose([1.5, -2.0, 30.0], [0.02, -0.01, 0.4]), pose([5.0, 40.0, -7.0], [0.05, 0.03, 0.31])
    quaternion = Rotation.from_matrix(X_FS[:3, :3]).as_quat()[[3, 0, 1, 2]].tolist()
    cell = cell_from(
        base={"X_WB": {"position_m": X_WB[:3, 3].tolist(), "rpy_deg": [1.5, -2.0, 30.0]}},
        tool={"X_FS": {"position_m": X_FS[:3, 3].tolist(), "quaternion_wxyz": quaternion}},
    )
    np.testing.assert_allclose(cell.X_WB, X_WB, atol=1e-12)
    np.testing.assert_allclose(cell.X_FS, X_FS, atol=1e-12)
    drake = drake_of(cell)
    context = drake.plant.CreateDefaultContext()
    q = np.column_stack([rng.uniform(cell.q_min[:6], cell.q_max[:6], (20, 6)), np.zeros(20)])
    for row, X in zip(q, scanner_poses(cell, q), strict=True):
        drake.plant.SetPositions(context, drake.positions(row[None])[0])
        X_WF = drake.plant.GetFrameByName("tool0").CalcPoseInWorld(context).GetAsMatrix4()
        assert np.abs(X_WF @ X_FS - X).max() < 1e-9
    found = branches(cell, scanner_poses(cell, q[:5]))
    back = scanner_poses(cell, np.column_stack([found.q, np.zeros(len(found.q))]))
    assert np.abs(back - scanner_poses(cell, q[:5])[found.pose_index]).max() < 1e-9


@pytest.mark.parametrize(
    ("section", "values", "line"),
    [
        ("base", {"X_WB": np.eye(4).tolist(), "yaw_deg": 3}, "in place of position_m and yaw_deg"),
        ("tool", {"X_FS": np.eye(4).tolist(), "arm_m": 0.2}, "in place of arm_m"),
        ("tool", {"X_FS": np.diag([1.0, 1, -1, 1]).tolist()}, "not a rotation"),
        ("tool", {"X_FS": pose([0, 0, 0], [250.0, 0, 0]).tolist()}, "is it in millimetres"),
        ("tool", {"X_FS": [[1, 0, 0], [0, 1, 0]]}, "four rows of four numbers"),
        ("tool", {"X_FS": {"position_m": [0, 0, 0.2], "rpy_deg": [0, 45]}}, "rpy_deg: 3 numbers"),
        ("tool", {"arm_m": "0,25"}, "write a decimal point, not a comma"),
    ],
)
def test_what_is_wrong_is_one_line(section, values, line):
    with pytest.raises(CellError, match=line):
        settings_from({section: values})
