"""Closed forms against another implementation: ssik finds the same branches, from the URDF alone."""

import numpy as np
import pytest
from test_side_branches import PLAIN, cell_of

from scanmotion.cell.arm.robot import arm_poses, clean_angle
from scanmotion.cell.build import build_cell
from scanmotion.cell.ik.choice import has_closed_form, solver_of
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.support.streams import fixed_stream

ssik = pytest.importorskip("ssik")

A3 = '<origin xyz="1.35 0 0"/>\n    <axis xyz="0 1 0"/>'


def robots(folder):
    """An arm of each kind: in OPW's form, with parallel axes, with A3 against A2."""
    assert A3 in PLAIN
    flipped = PLAIN.replace(A3, A3.replace("0 1 0", "0 -1 0"))
    (folder / "flipped").mkdir()
    return {
        "opw": build_cell(load_cell("kr240")).robot,
        "parallel": build_cell(load_cell("ur10e")).robot,
        "flipped": cell_of(flipped, folder / "flipped").robot,
    }


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    return robots(tmp_path_factory.mktemp("arms"))


@pytest.mark.parametrize("kind", ["opw", "parallel", "flipped"])
def test_another_solver_finds_the_same_branches(arms, kind, tmp_path):
    robot = arms[kind]
    assert has_closed_form(robot)
    (tmp_path / "arm.urdf").write_text(robot.text)
    other = ssik.Manipulator.from_urdf(str(tmp_path / "arm.urdf"), base="base_link", ee=robot.flange)
    q = fixed_stream("ik_oracle").uniform(robot.lower, robot.upper, (12, 6))
    X = arm_poses(robot, q)[:, 6] @ robot.X_6F
    ours = solver_of(robot)(X).joints
    compared = 0
    for rows, pose in zip(ours, X, strict=True):
        rows = rows[np.isfinite(rows[:, 0])]
        theirs = np.array([s.q for s in other.solve(pose)])
        assert len(theirs)
        apart = np.abs(clean_angle(rows[:, None] - theirs[None])).max(axis=2)
        assert (apart.min(axis=0) < 1e-6).all(), "a branch of theirs is not ours"
        # Theirs keep the limits; ours are kept to them elsewhere.
        inside = np.array([_inside(robot, row) for row in rows])
        assert (apart[inside].min(axis=1) < 1e-6).all(), "a branch of ours is not theirs"
        compared += int(inside.sum())
    assert compared >= 20


def _inside(robot, row):
    turns = row + 2 * np.pi * np.arange(-2, 3)[:, None]
    return bool(((turns >= robot.lower) & (turns <= robot.upper)).any(axis=0).all())
