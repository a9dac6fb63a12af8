"""Resting poses: closed forms of boxes and cones, and what tips."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.geometry.parts.resting import resting_poses, turned_part

SIDES = st.floats(0.05, 0.6)


@given(SIDES, SIDES, SIDES)
def test_a_box_tips_at_the_angle_of_its_sides(a, b, c):
    poses = resting_poses(box_part(a, b, c), least_tip_rad=0.0)
    assert np.allclose(poses[0].R_OP, np.eye(3))
    assert len(poses) == 6
    for pose in poses:
        axis = int(np.argmax(np.abs(pose.up)))
        high = (a, b, c)[axis]
        narrow = min((a, b, c)[i] for i in range(3) if i != axis)
        assert pose.tip_rad == pytest.approx(np.arctan2(narrow, high), abs=1e-6)
        assert np.allclose(pose.com_m, [0, 0, high / 2], atol=1e-9)
        area = 0.5 * abs(np.sum(np.cross(pose.support_m, np.roll(pose.support_m, -1, axis=0))))
        assert area == pytest.approx(a * b * c / high, rel=1e-6)


def test_poses_that_tip_easily_are_left_out():
    flat = resting_poses(box_part(0.4, 0.4, 0.02), least_tip_rad=np.deg2rad(5.0))
    assert [p.name for p in flat] == ["+z up", "-z up"]


def test_the_margin_is_that_of_gravity_against_the_push():
    pose = resting_poses(box_part(0.2, 0.2, 0.2))[0]
    assert pose.margin(10.0) == np.inf
    cone = trimesh.creation.cone(radius=0.1, height=0.3, sections=64)
    off = np.vstack([cone.vertices, [[0.4, 0.0, 0.0], [0.4, 0.01, 0.0], [0.4, 0.0, 0.01]]])
    part = Part(name="c", vertices=off, triangles=np.vstack([cone.faces, [[66, 67, 68]]]), closed=False)
    pose = resting_poses(part, least_tip_rad=0.0)[0]
    push = 10.0 * np.linalg.norm(pose.com_m[:2])
    assert pose.margin(10.0) == pytest.approx(9.80665 * np.tan(pose.tip_rad) / push)


def test_a_turned_part_stands_on_the_table():
    part = box_part(0.1, 0.2, 0.3)
    for pose in resting_poses(part):
        turned, X_KO = turned_part(part, pose.R_OP)
        assert turned.bounds[0, 2] == pytest.approx(0.0, abs=1e-12)
        assert np.allclose(turned.bounds[:, :2].sum(axis=0), 0.0, atol=1e-12)
        assert np.allclose(part.vertices @ X_KO[:3, :3].T + X_KO[:3, 3], turned.vertices)
        assert np.linalg.det(X_KO[:3, :3]) == pytest.approx(1.0)


def test_a_cloud_has_none():
    with pytest.raises(PartError, match="only a mesh"):
        resting_poses(Part(name="c", vertices=np.eye(3), triangles=np.zeros((0, 3), int)))
