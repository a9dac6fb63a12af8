"""The twin's errors as settings, what calibration in the trip buys, and the files of the scans."""

import math
from dataclasses import fields, replace

import pytest

from scanmotion.cell.config import load_cell, settings_from
from scanmotion.errors import CellError
from scanmotion.scan.captures import ScanErrors


def test_a_cell_that_says_nothing_has_the_stated_noise():
    for name in ("kr240", "ur10e"):
        errors = ScanErrors(**load_cell(name).twin_errors())
        assert errors == ScanErrors() and not errors.constant


def test_every_error_of_the_twin_is_a_setting():
    told = {
        "pose_mm": 0.5, "pose_deg": 0.1, "range_noise": 2, "frame_scale": 3, "hand_eye_mm": [1, -2, 3],
        "hand_eye_deg": [0.1, 0.2, -0.3], "axis_mm": [-0.5, 0.25], "axis_deg": [0.4, -0.5],
        "backlash_deg": 0.6,
    }  # fmt: skip
    found = settings_from({"twin": told}).twin_errors()
    assert set(found) == {f.name for f in fields(ScanErrors)}
    deg = math.pi / 180
    assert ScanErrors(**found).constant
    for name, expected in {
        "range_noise": 2.0, "frame_scale": 3.0, "pose_m": 5e-4, "pose_rad": 0.1 * deg,
        "hand_eye_m": (1e-3, -2e-3, 3e-3), "hand_eye_rad": (0.1 * deg, 0.2 * deg, -0.3 * deg),
        "axis_m": (-5e-4, 2.5e-4), "axis_rad": (0.4 * deg, -0.5 * deg), "backlash_rad": 0.6 * deg,
    }.items():  # fmt: skip
        assert found[name] == pytest.approx(expected, rel=1e-12), name


@pytest.mark.parametrize("key", ["hand_eye_m", "hand_eye_rad", "axis_m", "axis_rad"])
def test_one_constant_error_is_enough(key):
    none = ScanErrors()
    assert replace(none, **{key: (*getattr(none, key)[:-1], -1e-9)}).constant
    assert replace(none, backlash_rad=1e-9).constant
    assert not replace(none, pose_m=1.0, range_noise=5.0).constant


@pytest.mark.parametrize(
    ("twin", "key", "word"),
    [
        ({"axis_mm": [50, 0]}, "twin.axis_mm.0", "millimetres"),
        ({"pose_mm": -1}, "twin.pose_mm", "below"),
        ({"pose_mm": 20}, "twin.pose_mm", "millimetres"),
        ({"axis_mm": [0, 0, 0]}, "twin.axis_mm", "2 items"),
        ({"axis_mm": 0.5}, "twin.axis_mm", "tuple"),
        ({"axis_m": [0, 0]}, "twin.axis_m", "unknown; known: [axis_deg"),
        ({"hand_eye_deg": [0, 0, 3]}, "twin.hand_eye_deg.2", "degrees"),
        ({"hand_eye_deg": [0, 0, "1 deg"]}, "twin.hand_eye_deg.2", "number"),
        ({"backlash_deg": float("nan")}, "twin.backlash_deg", "finite"),
        ({"range_noise": True}, "twin.range_noise", "number"),
    ],
    ids=str,
)
def test_a_wrong_error_is_refused_with_its_key(twin, key, word):
    with pytest.raises(CellError) as caught:
        settings_from({"twin": twin})
    assert caught.value.key == key and word in str(caught.value) and "\n" not in str(caught.value)
