"""Stepped rotary viewpoints: the paper's worked example literally, and default turns that see the box."""

import numpy as np
import pytest

from scanmotion.core.errors import InputError
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.sensing.visibility import scene_from, turns_see
from scanmotion.views.stepped_rotary import oblique_turn, paper_stepped_rotary, stepped_rotary

SCANNER = Scanner()
WORKED = (0.33, 0.20, 0.60)
BOXES = (
    (0.33, 0.20, 0.60), (0.60, 0.33, 0.20), (0.05, 0.05, 0.05), (0.2, 0.2, 1.2), (0.3, 0.3, 0.66),
    (0.85, 0.85, 0.4), (0.85, 0.85, 0.05), (1.13, 0.4, 0.3), (0.85, 0.85, 1.2),
)  # fmt: skip


def seen_share(box, views, *, table_z=0.0):
    """Shares of the box's sides and of its top that whole turns see past the table."""
    part = box_part(*box)
    samples = surface_samples(part, 3000, rng=np.random.default_rng(7))
    scene = scene_from(part.vertices, part.triangles, table_radius=0.76, table_z=table_z, pedestal_radius=0.1)
    seen = turns_see(scene, SCANNER, np.array([v.X_OS for v in views]), samples.points, samples.normals)
    top, base = samples.normals[:, 2] > 0.5, samples.normals[:, 2] < -0.5
    return seen[:, ~top & ~base].any(axis=0).mean(), seen[:, top].any(axis=0).mean()


def test_the_worked_example_literally():
    step = paper_stepped_rotary(*WORKED, SCANNER, standoff=0.7, pedestal=0.35)
    places = np.array([v.p_OS for v in step.viewpoints]) * 1e3
    expected = [[771.218, 0, 950], [865, 0, 300], [865, 0, 0], [771.218, 0, -350]]
    np.testing.assert_allclose(places, expected, atol=5e-4)
    c, s = np.sqrt(3) / 2, 0.5
    looks = np.array([v.direction for v in step.viewpoints])
    np.testing.assert_allclose(looks, [[-c, 0, -s], [-1, 0, 0], [-1, 0, 0], [-c, 0, s]], atol=1e-12)
    assert step.dropped == ()
    assert [v.note.split(",")[0] for v in step.viewpoints] == ["VP0", "VP1", "VP2", "VPn"]


def test_the_bottom_viewpoint_needs_its_pedestal():
    step = paper_stepped_rotary(*WORKED, SCANNER, standoff=0.7, pedestal=0.349)
    ((name, reason),) = step.dropped
    assert name == "G3" and "350 mm below" in reason and "349 mm" in reason
    assert [v.id for v in step.viewpoints] == ["G0", "G1", "G2"]


@pytest.mark.parametrize("height", [0.05, 0.375, 0.376, 0.6, 1.2, 1.7])
@pytest.mark.parametrize("d", [0.5, 0.7, 0.9])
def test_paper_steps_are_the_least_that_the_field_bridges(height, d):
    views = paper_stepped_rotary(0.6, 0.33, height, SCANNER, standoff=d).viewpoints
    side = 2 * d * np.tan(np.deg2rad(15.0))
    k = len(views) - 1
    assert height / k <= side + 1e-9 and (k == 1 or height / (k - 1) > side)
    steps = np.diff([height, *(v.p_OS[2] for v in views[1:])])
    np.testing.assert_allclose(steps, -height / k, atol=1e-12)
    assert all(v.p_OS[0] == pytest.approx(0.3 + d) for v in views[1:])


@pytest.mark.parametrize("turns", [paper_stepped_rotary, stepped_rotary])
def test_all_are_revolutions_with_a_side_of_the_field_level(turns):
    step = turns(*WORKED, SCANNER)
    assert len({v.id for v in step.viewpoints}) == len(step.viewpoints)
    for v in step.viewpoints:
        assert (v.step, v.kind, v.slack.roll) == ("global", "revolution", False)
        R = v.X_OS[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        upright = abs(R[2, 1]) < 1e-12 and R[2, 0] > 0
        assert upright or (turns is stepped_rotary and abs(R[2, 0]) < 1e-12)


@pytest.mark.parametrize("box", BOXES, ids=str)
def test_default_turns_see_the_sides_and_the_top(box):
    sides, top = seen_share(box, stepped_rotary(box[0], box[1], box[2], SCANNER).viewpoints)
    assert sides > 0.97 and top > 0.95


@pytest.mark.parametrize("box", BOXES, ids=str)
@pytest.mark.parametrize("pedestal", [0.0, 0.3])
def test_default_turns_stand_above_the_table_outside_the_part_and_in_range(box, pedestal):
    radius = np.hypot(*box[:2]) / 2
    for v in stepped_rotary(box[0], box[1], box[2], SCANNER, pedestal=pedestal).viewpoints:
        assert v.p_OS[2] >= 0.02 - pedestal - 1e-12
        # The nearest point of the cylinder that the turning box fills, and the point in mid-view.
        across = max(np.hypot(*v.p_OS[:2]) - radius, 0.0)
        up = max(v.p_OS[2] - box[2], 0.0)
        assert np.hypot(across, up) > 0.2
        assert SCANNER.range[0] - 1e-9 <= v.standoff <= SCANNER.range[1]


@pytest.mark.parametrize("height", [0.64, 0.66, 1.2])
def test_taller_parts_get_more_rows(height):
    views = stepped_rotary(0.2, 0.2, height, SCANNER).viewpoints
    rows = int(np.ceil(height / 0.65))
    assert len(views) == 1 + 3 * rows


def test_wide_parts_get_turns_of_what_the_four_miss():
    box = (0.85, 0.85, 0.5)
    views = stepped_rotary(*box, SCANNER).viewpoints
    assert len(views) > 4
    four, all_ = seen_share(box, views[:4]), seen_share(box, views)
    assert four[1] < 0.8 < 0.95 < all_[1]
    assert all("adds" in v.note for v in views[4:])


def test_the_carving_needs_no_more_than_four():
    assert len(stepped_rotary(0.6, 0.33, 0.2, SCANNER).viewpoints) == 4


def test_a_pedestal_lowers_the_views_and_lets_the_bottom_be_looked_at():
    low = stepped_rotary(*WORKED, SCANNER)
    lifted = stepped_rotary(*WORKED, SCANNER, pedestal=0.4)
    assert [name for name, _ in low.dropped] == ["VPn"] and lifted.dropped == ()
    assert min(v.p_OS[2] for v in lifted.viewpoints) < 0 <= min(v.p_OS[2] for v in low.viewpoints)


@pytest.mark.parametrize("yaw", np.deg2rad([-30.0, -10.0, 0.0, 20.0]))
@pytest.mark.parametrize("tilt", np.deg2rad([-20.0, 10.0, 60.0]))
def test_an_oblique_line_passes_the_axis_at_its_offset(yaw, tilt):
    radius, aim, distance = 0.3, 0.25, 0.8
    X = oblique_turn(tilt, yaw, aim, distance, radius=radius, floor=-np.inf)
    p, u = X[:2, 3], X[:2, 2] / np.linalg.norm(X[:2, 2])
    offset = abs(p[0] * u[1] - p[1] * u[0])
    assert offset == pytest.approx(0.7 * radius * abs(np.tan(yaw)) * np.cos(yaw))
    assert np.arcsin(-X[2, 2]) == pytest.approx(tilt)
    target = np.array([0.0, 0.7 * radius * np.tan(yaw), aim])
    assert np.linalg.norm(target - X[:3, 3]) == pytest.approx(distance)
    np.testing.assert_allclose(np.cross(target - X[:3, 3], X[:3, 2]), 0, atol=1e-12)


@pytest.mark.parametrize("turns", [paper_stepped_rotary, stepped_rotary])
@pytest.mark.parametrize("bad", [0.0, -0.1, np.nan, np.inf])
@pytest.mark.parametrize("axis", range(3))
def test_bad_boxes_are_refused(turns, bad, axis):
    box = list(WORKED)
    box[axis] = bad
    with pytest.raises(InputError, match="sides must be positive"):
        turns(box[0], box[1], box[2], SCANNER)


def test_the_deprecated_mode_is_the_papers_function():
    with pytest.deprecated_call():
        old = stepped_rotary(*WORKED, SCANNER, standoff=0.7, mode="paper").viewpoints
    new = paper_stepped_rotary(*WORKED, SCANNER, standoff=0.7).viewpoints
    assert np.array_equal([v.X_OS for v in old], [v.X_OS for v in new])


def test_an_unknown_mode_is_refused():
    with pytest.raises(InputError, match=r"unknown mode 'Paper'.*default, paper"):
        stepped_rotary(*WORKED, SCANNER, mode="Paper")
