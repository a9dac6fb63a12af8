"""Intervals of predicted coverage and accuracy against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SCANNER
from test_latency import turn

from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.planning.worth.confidence import Prediction, Uncertainty, confidence
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.simulator.captures import ScanErrors
from scanmotion.sensing.simulator.simulate import simulate
from scanmotion.sensing.visibility import scene_from, seen_by_any, visible

NOTHING = Uncertainty(
    hand_eye_m=0, hand_eye_rad=0, axis_m=0, axis_rad=0, backlash_rad=0, latency_s=0, place_m=0, place_rad=0
)
QUIET = replace(ScanErrors(), pose_m=0.0, pose_rad=0.0)


@pytest.fixture(scope="module")
def predicted(lump):
    captures = turn(look_at((0.5, 0.1, 0.4), (-1, -0.2, -0.6)), start=0.0, sense=1, fps=3.0)
    samples = surface_samples(lump, 3000, rng=np.random.default_rng(0))
    scene = scene_from(lump.vertices, lump.triangles)
    seen = seen_by_any(scene, SCANNER, captures.X_OS, samples.points, samples.normals)
    can = visible(scene, SCANNER, samples.points, samples.normals, seen=seen)
    return Prediction(
        scene=scene, scanner=SCANNER, captures=captures, samples=samples, seen=seen, visible=can,
        noise=(4e-5, 0.0),
    )  # fmt: skip


def test_where_all_is_known_nothing_is_spread(predicted):
    found = confidence(predicted, QUIET, NOTHING, draws=20)
    c, a = found.completeness, found.mean_abs
    assert c.low == pytest.approx(c.value, abs=1e-3) and c.high == pytest.approx(c.value, abs=1e-3)
    assert a.low == pytest.approx(4e-5, rel=1e-6) == a.high
    assert "95 %" in found.statement and found.record()["draws"] == 20


def test_more_doubt_makes_wider_intervals_and_the_same_seed_the_same(predicted):
    some = confidence(predicted, QUIET, Uncertainty(), draws=20)
    more = confidence(predicted, QUIET, Uncertainty(place_m=8e-3, hand_eye_rad=2e-3, axis_m=3e-4), draws=20)
    again = confidence(predicted, QUIET, Uncertainty(), draws=20)
    assert again == some
    width = [f.completeness.high - f.completeness.low for f in (some, more)]
    assert width[1] > width[0] and more.mean_abs.high > 1.5 * some.mean_abs.high
    assert some.completeness.low <= some.completeness.value + 1e-9


def test_coverage_of_a_draw_is_what_asking_all_samples_gives(predicted):
    """The samples that are taken for safe are indeed seen, wherever the part is put within the doubt."""
    rng, lost = np.random.default_rng(5), []
    s = predicted.samples
    for _ in range(4):
        X = predicted.captures.X_OS.copy()
        X[:, :2, 3] += 1e-3 * rng.standard_normal(2)
        now = seen_by_any(predicted.scene, SCANNER, X, s.points, s.normals)
        lost.append(now[predicted.visible | predicted.seen].mean())
    found = confidence(predicted, QUIET, replace(NOTHING, place_m=1e-3), draws=24).completeness
    assert found.low - 2e-3 < np.mean(lost) < found.high + 2e-3


def test_the_accuracy_of_a_known_shift_is_that_of_a_simulation(lump, predicted):
    """One constant error in the twin and in the draw: the linear prediction agrees with the fused cloud."""
    errors = replace(QUIET, axis_m=(3e-4, 0.0))
    clean, off = (
        accuracy(fuse([simulate(predicted.scene, SCANNER, predicted.captures, errors=e, stride=2,
                                rng=np.random.default_rng(0))]).points, lump)
        for e in (QUIET, errors)
    )  # fmt: skip
    base = replace(predicted, noise=(clean.mean_abs, clean.mean_signed))
    found = confidence(base, QUIET, replace(NOTHING, axis_m=3e-4), draws=40)
    assert found.mean_abs.low <= off.mean_abs <= 1.3 * found.mean_abs.high


def test_a_plan_says_how_sure_it_is(pitted_plan):
    found = pitted_plan.summary.document()["confidence"]
    c, a = found["completeness"], found["mean_abs_mm"]
    assert found["draws"] >= 20
    assert c["value"] == pytest.approx(pitted_plan.completeness()["final"], abs=1e-6)
    assert 0.8 < c["low_95"] <= c["high_95"] <= 1.0
    assert a["value"] == pytest.approx(pitted_plan.accuracy().mean_abs * 1e3, rel=0.1) and a["high_95"] > 0
    assert "95 %" in found["statement"]
