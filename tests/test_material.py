"""Glossy and dark surfaces: closed forms of the highlight, and what the twin and visibility agree on."""

from dataclasses import replace

import numpy as np
import pytest

from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.core.scanner import MATERIALS, Scanner
from scanmotion.core.viewpoint import look_at
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.sensing.simulator.captures import ScanErrors
from scanmotion.sensing.simulator.simulate import simulate, still_captures
from scanmotion.sensing.visibility import in_view, scene_from, sees

WALL = box_part(0.02, 0.6, 0.6)
FRONT = look_at((0.7, 0.0, 0.3), (-1, 0, 0))


def test_matt_is_the_scanner_as_it_was():
    cell = load_cell("kr240")
    assert cell.scanner_model() == Scanner(
        fov=cell.scanner_model().fov, max_incidence=cell.scanner_model().max_incidence
    )
    glossy = settings_from({"scanner": {"material": "glossy"}}).scanner_model()
    assert glossy.mirror == MATERIALS["glossy"].mirror and glossy.sigma_at_near == pytest.approx(7.5e-5)


def test_the_highlight_lies_where_the_mirror_law_puts_it():
    """On a wall seen squarely it surrounds the point midway between camera and projector."""
    scanner = Scanner().before(MATERIALS["glossy"])
    captures = still_captures(FRONT[None])
    scan = simulate(WALL, scanner, captures, errors=ScanErrors.none(), stride=1, rng=np.random.default_rng(0))
    plain = simulate(
        WALL, Scanner(), captures, errors=ScanErrors.none(), stride=1, rng=np.random.default_rng(0)
    )
    lost = np.setdiff1d(plain.pixel, scan.pixel)
    p = plain.points_O[np.isin(plain.pixel, lost)]
    middle = FRONT[:3, 3] + 0.075 * FRONT[:3, 0]
    away = np.linalg.norm(p[:, 1:] - middle[1:], axis=1)
    z, tilt = 0.69, MATERIALS["glossy"].mirror
    assert len(lost) > 50 and away.max() == pytest.approx(z * np.tan(tilt), rel=0.06)


@pytest.mark.parametrize("material", ["glossy", "dark"])
def test_visibility_and_twin_agree(material):
    scanner = replace(Scanner(), baseline=0.1).before(MATERIALS[material])
    samples = surface_samples(WALL, 4000, rng=np.random.default_rng(1))
    X = np.stack([FRONT, look_at((0.5, 0.4, 0.5), (-1, -0.9, -0.4))])
    scene = scene_from(WALL.vertices, WALL.triangles)
    mask = sees(scene, scanner, X, samples.points, samples.normals)
    assert (mask <= sees(scene, replace(scanner, mirror=0.0), X, samples.points, samples.normals)).all()
    # The definition, point by point.
    for k in range(2):
        c, p = X[k, :3, 3] - samples.points, X[k, :3, 3] + 0.1 * X[k, :3, 0] - samples.points
        half = c / np.linalg.norm(c, axis=1, keepdims=True) + p / np.linalg.norm(p, axis=1, keepdims=True)
        cos = np.einsum("ij,ij->i", half, samples.normals) / np.linalg.norm(half, axis=1)
        blind = (cos >= np.cos(scanner.mirror)) & (scanner.mirror > 0)
        free = in_view(replace(scanner, mirror=0.0), X[k], samples.points, samples.normals)[0]
        np.testing.assert_array_equal(
            in_view(scanner, X[k], samples.points, samples.normals)[0], free & ~blind
        )


def test_a_dark_wall_is_noisier_by_the_stated_factor():
    captures = still_captures(FRONT[None])
    sd = []
    for material in ("matt", "dark"):
        scanner = Scanner().before(MATERIALS[material])
        errors = replace(ScanErrors.none(), range_noise=1.0)
        scan = simulate(WALL, scanner, captures, errors=errors, stride=2, rng=np.random.default_rng(0))
        sd.append((scan.points_O[:, 0] - 0.01).std())
    assert sd[1] / sd[0] == pytest.approx(3.0, rel=0.02)
