"""Arms whose joints turn the other way, start elsewhere or stand turned: all branches in closed form."""

import numpy as np
import pytest
from test_robot_files import PLAIN, cell_of

from scanmotion.cell.arm.robot import arm_poses, clean_angle
from scanmotion.cell.ik.choice import solver_of
from scanmotion.cell.ik.opw import opw_arm
from scanmotion.cell.ik.parallel import parallel_arm
from scanmotion.cell.ik.turned_opw import turned_arm


def flange_at(robot, q):
    return arm_poses(robot, q)[:, 6] @ robot.X_6F


def flipped(*joints, text=PLAIN):
    """The URDF with the axes of some joints turned about."""
    for joint in joints:
        at = text.index("<axis", text.index(f'<joint name="{joint}"'))
        end = text.index("/>", at)
        axis = [-float(v) for v in text[at:end].split('"')[1].split()]
        text = text[:at] + f'<axis xyz="{axis[0]:g} {axis[1]:g} {axis[2]:g}"' + text[end:]
    return text


def shifted(joint, rpy, text=PLAIN):
    """The URDF with the frame of one joint turned against its parent."""
    at = text.index("<origin", text.index(f'<joint name="{joint}"'))
    end = text.index("/>", at)
    return text[:end].replace(' rpy="0 0 0"', "") + f' rpy="{rpy}"' + text[end:]


ARMS = {
    "A3 against A2": flipped("A3"),
    "Fanuc: A3 and the wrist": flipped("A3", "A4", "A6"),
    "all": flipped("A1", "A2", "A3", "A4", "A5", "A6"),
    "base turned": shifted("A1", "0 0 0.7"),
    "elbow bent at zero": shifted("A3", "0 -0.4 0", flipped("A3")),
    "wrist turned at zero": shifted("A4", "1.1 0 0", flipped("A5")),
}


@pytest.mark.parametrize("name", ARMS)
def test_every_branch_of_the_plain_arm_is_found(name, tmp_path, kr240_cell, rng):
    """The plain arm's solver is the oracle: as many branches for as many poses of the hand."""
    robot = cell_of(ARMS[name], tmp_path, home_deg=[0, -90, 90, 0, 0, 0]).robot
    solve = turned_arm(robot)
    assert solve is not None and not solve.rough
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (200, 6))
    X = flange_at(robot, q)
    found = solve(X)
    exists = np.isfinite(found.joints[:, :, 0])
    row, slot = np.nonzero(exists)
    assert np.abs(flange_at(robot, found.joints[row, slot]) - X[row]).max() < 1e-9
    off = np.abs(clean_angle(found.joints - q[:, None])).max(axis=2)
    assert np.nanmin(off, axis=1).max() < 1e-6
    if name != "wrist turned at zero" and "zero" not in name and "base" not in name:
        plain = opw_arm(kr240_cell.robot)
        sign = np.array([1.0 if kr240_cell.robot.axes[k] @ robot.axes[k] > 0 else -1.0 for k in range(6)])
        same = flange_at(kr240_cell.robot, q * sign)
        np.testing.assert_allclose(same, X, atol=1e-12)
        other = np.isfinite(plain(same).joints[:, :, 0])
        np.testing.assert_array_equal(exists.sum(axis=1), other.sum(axis=1))
    assert solver_of(robot) is not None


def test_rounded_angles_of_a_file_are_led_onto_the_pose(tmp_path, rng):
    """rpy="1.5708 0 0" is 4e-6 rad off: the closed form alone would miss by some 1e-5 m."""
    text = shifted("A4", "0 0.000004 0.000003", shifted("A2", "0.000004 0 0", flipped("A3")))
    robot = cell_of(text, tmp_path).robot
    solve = turned_arm(robot)
    assert solve is not None and solve.rough
    q = rng.uniform([-2, -2, -1, -2, 0.2, -2], [2, -0.5, 2, 2, 2, 2], (100, 6))
    X = flange_at(robot, q)
    found = solve(X)
    row, slot = np.nonzero(np.isfinite(found.joints[:, :, 0]))
    assert len(row) > 300
    assert np.abs(flange_at(robot, found.joints[row, slot]) - X[row]).max() < 1e-9
    assert np.nanmin(np.abs(clean_angle(found.joints - q[:, None])).max(axis=2), axis=1).max() < 1e-6


def test_other_arms_are_left_to_other_solvers(tmp_path):
    from scanmotion.cell.build import build_cell
    from scanmotion.cell.settings.cell import load_cell

    ur = build_cell(load_cell("ur10e")).robot
    assert turned_arm(ur) is None and parallel_arm(ur) is not None
    assert turned_arm(cell_of(shifted("A5", "0 0 0.3"), tmp_path).robot) is None
