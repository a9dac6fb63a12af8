"""Calibration from the scan itself: planted errors of hand-eye, table axis and backlash."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SCANNER, turns

from scanmotion.core.errors import InputError
from scanmotion.core.viewpoint import look_at
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.corrections.calibration import PARAMETERS, calibrate, corrected, errors_from
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.simulator.captures import inverse
from scanmotion.sensing.simulator.simulate import ScanErrors, simulate, still_captures
from scanmotion.sensing.visibility import scene_from

PLANTED = ScanErrors(
    hand_eye_m=(2e-4, -1e-4, 3e-4), hand_eye_rad=(5e-4, -3e-4, 2e-4), axis_m=(2e-4, -1.5e-4),
    axis_rad=(2e-4, -3e-4), backlash_rad=3e-4,
)  # fmt: skip


def unknowns(errors):
    """The constant errors in the order of PARAMETERS."""
    e = errors
    return np.array([*e.hand_eye_m, *e.hand_eye_rad, *e.axis_m, *e.axis_rad, e.backlash_rad, e.latency_s])


def test_correcting_by_the_true_errors_restores_the_clean_scan(lump):
    constant = replace(PLANTED, range_noise=0.0, frame_scale=0.0, pose_m=0.0, pose_rad=0.0)
    mended = corrected(turns(lump, constant, n=8), constant)
    a = accuracy(mended.points_O, lump)
    assert a.mean_abs < 2e-6
    X = mended.captures.X_OS
    np.testing.assert_allclose(X @ inverse(X), np.tile(np.eye(4), (24, 1, 1)), atol=1e-12)


def test_calibration_finds_planted_errors(lump, clean_scan):
    scan = turns(lump, PLANTED)
    found = calibrate([scan], points=150_000)
    assert found.rms_after < 0.75 * found.rms_before
    before, after = (
        accuracy(fuse([scan]).points, lump),
        accuracy(fuse([corrected(scan, found.errors)]).points, lump),
    )
    clean = accuracy(fuse([clean_scan]).points, lump)
    assert before.mean_abs > 0.15e-3
    assert after.mean_abs < 0.06e-3 and after.mean_abs < clean.mean_abs + 0.04e-3
    assert after.sd_signed < clean.sd_signed + 0.02e-3
    assert len(found.sd) == len(PARAMETERS) and "disagree" in found.statement
    # Each estimate lies where its own standard deviation says: chi-square of 11, 99.9% below 31.3.
    z = ((unknowns(found.errors) - unknowns(PLANTED)) / np.where(found.asked, found.sd, 1.0))[found.asked]
    assert z @ z < 31.3
    # The lengths that matter for accuracy are known to a twentieth of a millimetre.
    assert (found.sd[:3] < 0.05e-3).all() and (found.sd[6:8] < 0.05e-3).all()


def test_calibration_leaves_a_good_scan_alone(clean_scan, lump):
    found = calibrate([clean_scan], points=100_000)
    a = accuracy(fuse([corrected(clean_scan, found.errors)]).points, lump)
    assert a.mean_abs < 0.06e-3


def test_frames_from_one_side_do_not_determine_the_table(lump):
    X = np.repeat(look_at((0.55, 0, 0.1), (-1, 0, 0))[None], 6, axis=0)
    scene = scene_from(lump.vertices, lump.triangles)
    scan = simulate(scene, SCANNER, still_captures(X), rng=np.random.default_rng(0))
    found = calibrate([scan])
    assert not found.known.any()
    assert "not determined" in found.statement
    with pytest.raises(InputError):
        corrected(scan, ScanErrors())


def test_errors_from_keeps_the_order_of_the_parameters():
    np.testing.assert_array_equal(unknowns(errors_from(np.arange(12.0))), np.arange(12.0))
