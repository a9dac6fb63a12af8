"""An arm of one's own: the built-in one's URDF under another name behaves as the built-in one."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from scanmotion.cell.build import robot_facts
from scanmotion.cell.settings.cell import load_cell
from scanmotion.geometry.parts.make_part import box_part, models_dir
from scanmotion.plan_io.load import load_plan
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.report.scene import _Bodies


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """Its pictures lie in a ROS package, which is not here, and above its folder."""
    folder = tmp_path_factory.mktemp("own")
    text = (models_dir() / "robots" / "kr240.urdf").read_text()
    text = re.sub(r'filename="\.\./meshes/', 'filename="package://kuka/meshes/', text, count=5)
    (folder / "own.urdf").write_text(text)
    rates = robot_facts()["kr240"]["acceleration_rad_s2"]["light"]
    (folder / "own.yaml").write_text(f"robot:\n  model: own.urdf\n  acceleration: {list(rates)}\n")
    return load_cell(folder / "own.yaml")


def test_it_plans_as_the_built_in_one_and_is_read_back_and_shown(cell, tmp_path):
    options, part = PlanOptions(source="box"), box_part(0.2, 0.16, 0.15)
    mine, builtin = plan(part, cell, options=options), plan(part, load_cell("kr240"), options=options)
    np.testing.assert_array_equal(mine.trajectory.q, builtin.trajectory.q)
    assert mine.save(tmp_path / "plan") == []
    read = load_plan(tmp_path / "plan")
    assert read.cell.urdf_path == tmp_path / "plan" / "robot.urdf"
    np.testing.assert_allclose(read.cell.robot.X_PJ, mine.cell.robot.X_PJ)
    # The folder alone suffices: no mesh of the robot is in it, its solids are drawn.
    drawn = _Bodies(read.cell).shapes
    for link in ET.parse(read.cell.urdf_path).getroot().iter("link"):
        assert len(drawn.get(str(link.get("name")), [])) == len(link.findall("collision"))
