"""Time between a pose and its frame: closed forms in the twin, and planted latencies that calibration
finds."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SCANNER
from test_simulate import sphere

from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.corrections.calibration import PARAMETERS, calibrate, corrected
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.simulator.captures import Captures, ScanErrors, inverse, later, true_poses, turned
from scanmotion.sensing.simulator.simulate import simulate
from scanmotion.sensing.simulator.turns import turn_captures
from scanmotion.sensing.visibility import scene_from

SPEED, RAMP = np.pi / 3, 0.5
"""Of the table: 10 r/min, 0.5 rad/s2."""


def turn(X_WS, *, start, sense, fps=5.0):
    """A turn of the table of the paper's speed."""
    return turn_captures(X_WS, speed=SPEED, acceleration=RAMP, fps=fps, sense=sense, start=start)


def four_turns(part, errors, *, senses=(1, -1, 1, -1), seed=0, scanner=SCANNER):
    """Turns seen from four places in the given senses."""
    poses = [
        look_at((0.6, 0.0, 0.1), (-1, 0, 0)), look_at((0.5, 0.15, 0.45), (-1, -0.3, -0.7)),
        look_at((0.55, -0.2, 0.12), (-1, 0.4, 0)), look_at((0.45, 0.0, 0.02), (-1, 0, 0.2)),
    ]  # fmt: skip
    scene, rng = scene_from(part.vertices, part.triangles), np.random.default_rng(seed)
    return [
        simulate(scene, scanner, turn(X, start=0.3 * k, sense=s), errors=errors, stride=2, rng=rng)
        for k, (X, s) in enumerate(zip(poses, senses, strict=True))
    ]


def test_the_true_pose_is_that_of_a_later_instant():
    captures = turn(look_at((0.6, 0, 0.1), (-1, 0, 0)), start=0.0, sense=-1)
    errors = replace(ScanErrors.none(), latency_s=2e-3)
    X = true_poses(captures, errors, np.random.default_rng(0))
    X_WO = turned(captures.table_angle + 2e-3 * captures.rates[:, 6])
    np.testing.assert_allclose(X, inverse(X_WO) @ captures.X_WS, atol=1e-12)
    still = replace(captures, rates=None)
    np.testing.assert_array_equal(true_poses(still, errors, np.random.default_rng(0)), still.X_OS)


def test_jitter_scatters_by_its_deviation_and_zero_keeps_the_bytes():
    captures = turn(look_at((0.6, 0, 0.1), (-1, 0, 0)), start=0.0, sense=1, fps=200.0)
    X = true_poses(captures, replace(ScanErrors.none(), jitter_s=1e-3), np.random.default_rng(0))
    fast = captures.rates[:, 6] > 1.0
    off = np.arctan2(X[:, 1, 3], X[:, 0, 3]) + captures.table_angle
    off = (off + np.pi) % (2 * np.pi) - np.pi
    assert off[fast].std() == pytest.approx(1e-3 * SPEED, rel=0.1)
    noise = [
        true_poses(captures, e, np.random.default_rng(1)) for e in (ScanErrors(), ScanErrors(latency_s=0.0))
    ]
    np.testing.assert_array_equal(*noise)


def test_rates_along_the_body_are_those_of_the_motion():
    captures = turn(look_at((0.6, 0, 0.1), (-1, 0, 0)), start=0.2, sense=1)
    h = 1e-3
    before, after = later(captures, -h).X_OS, later(captures, h).X_OS
    p = np.array([0.05, -0.02, 0.55, 1.0])
    moved = (inverse(after) @ captures.X_OS @ p - inverse(before) @ captures.X_OS @ p)[:, :3] / (2 * h)
    rate = captures.body_rates
    expected = -(rate[:, :3] + np.cross(rate[:, 3:], np.broadcast_to(p[:3], (len(rate), 3))))
    np.testing.assert_allclose(moved, expected, atol=1e-5)


@pytest.mark.parametrize("sense", [1, -1])
def test_rolling_rows_shear_a_wall_as_the_closed_form_says(sense):
    """A wall that is carried towards the scanner: each row's depth is that of its own instant."""
    wall = box_part(0.02, 2.0, 2.0)
    X = look_at((0.7, 0.0, 1.0), (-1, 0, 0))[None]
    rates = np.zeros((1, 7))
    rates[0, 0] = 0.1 * sense
    scanner = Scanner(rays=(64, 48), rolling=0.05)
    captures = Captures(
        t=np.zeros(1), X_WS=X, table_angle=np.zeros(1), X_WT=np.eye(4), X_TO=np.eye(4), rates=rates
    )
    scan = simulate(wall, scanner, captures, errors=ScanErrors.none(), stride=1, rng=np.random.default_rng(0))
    row = scan.pixel // 64
    y = np.tan(scanner.fov[1] / 2) * ((2 * row + 1) / 48 - 1)
    expected = 0.69 + 0.1 * sense * 0.05 * y / (2 * np.tan(scanner.fov[1] / 2))
    np.testing.assert_allclose(scan.depth, expected, atol=2e-6)


def test_exposure_blurs_by_the_uniform_spread():
    wall = box_part(0.02, 2.0, 2.0)
    X = look_at((0.7, 0.0, 1.0), (-1, 0, 0))[None]
    rates = np.zeros((1, 7))
    rates[0, 0] = 0.1
    captures = Captures(
        t=np.zeros(1), X_WS=X, table_angle=np.zeros(1), X_WT=np.eye(4), X_TO=np.eye(4), rates=rates
    )
    scan = simulate(
        wall, Scanner(rays=(128, 96), exposure=0.02), captures, errors=ScanErrors.none(), stride=1,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    assert scan.depth.std() == pytest.approx(0.1 * 0.02 / np.sqrt(12), rel=0.03)
    assert scan.depth.mean() == pytest.approx(0.69, abs=3e-5)


@pytest.mark.parametrize("planted", [5e-4, 2e-3, 5e-3])
def test_a_planted_latency_is_found_and_told_from_backlash(lump, planted):
    errors = ScanErrors(
        latency_s=planted, backlash_rad=3e-4, axis_m=(2e-4, -1e-4), hand_eye_m=(1e-4, 0.0, -2e-4)
    )
    found = calibrate(four_turns(lump, errors), points=120_000, latency=True)
    k = PARAMETERS.index("latency")
    assert found.known[k] and found.known[PARAMETERS.index("backlash")]
    e = found.errors
    values = np.array([e.latency_s, e.backlash_rad, *e.axis_m])
    truth = np.array([planted, 3e-4, 2e-4, -1e-4])
    sd = found.sd[[k, PARAMETERS.index("backlash"), PARAMETERS.index("axis_x"), PARAMETERS.index("axis_y")]]
    assert (np.abs(values - truth) < 4 * sd).all(), (values - truth) / sd
    assert sd[0] < 0.2e-3


def test_the_corrected_model_is_five_times_better(lump):
    errors = ScanErrors(latency_s=5e-3, axis_m=(5e-4, -4e-4), backlash_rad=3e-4, hand_eye_m=(0, 0, 3e-4))
    scans = four_turns(lump, errors)
    found = calibrate(scans, points=120_000, latency=True)
    before = accuracy(fuse(scans).points, lump)
    after = accuracy(fuse([corrected(s, found.errors) for s in scans]).points, lump)
    assert after.mean_abs < before.mean_abs / 5


def test_turns_of_one_sense_leave_the_latency_where_it_does_no_harm(lump):
    """All turns late by one angle: the object is turned as a whole, its shape is the same."""
    X = look_at((0.6, 0.0, 0.1), (-1, 0, 0))
    one = turn(X, start=0.0, sense=1)
    even = replace(one, rates=np.tile([0, 0, 0, 0, 0, 0, SPEED], (len(one), 1)))
    scene = scene_from(lump.vertices, lump.triangles)
    scans = [
        simulate(
            scene, SCANNER, even, errors=ScanErrors(latency_s=2e-3), stride=3, rng=np.random.default_rng(k)
        )
        for k in range(2)
    ]
    found = calibrate(scans, points=40_000, latency=True)
    assert not found.asked[PARAMETERS.index("latency")] and found.errors.latency_s == 0
    assert "latency is not determined" in found.statement


def test_a_ball_on_the_axis_shows_no_latency():
    vertices, triangles = sphere(0.05, np.array([0, 0, 0.1]))
    ball = Part(name="ball", vertices=vertices, triangles=triangles)
    scans = four_turns(ball, replace(ScanErrors.none(), latency_s=5e-3))
    assert accuracy(fuse(scans).points, ball).mean_abs < 0.03e-3
