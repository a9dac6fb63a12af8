"""Registration: known motions undone, and a statement of trust that is true."""

from dataclasses import replace

import numpy as np
import pytest
from scans import turns, wrong

from scanmotion.core.errors import InputError
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.sensing.corrections.registration import align, register, transformed
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.simulator.captures import inverse, motion
from scanmotion.sensing.simulator.simulate import ScanErrors


@pytest.mark.parametrize("seed", range(3))
def test_registration_undoes_a_known_motion(lump_cloud, seed):
    X = wrong(1.0, 2.0, seed)
    moved = transformed(lump_cloud, X)
    found = register(moved, lump_cloud)
    residual = transformed(moved, found.X).points - lump_cloud.points
    assert np.abs(residual).max() < 2e-6
    assert found.trusted and found.fitness > 0.95
    assert found.turn == pytest.approx(np.deg2rad(1.0), rel=1e-3)


def test_registration_of_independent_scans_of_a_part(lump, lump_cloud):
    other = fuse([turns(lump, ScanErrors(), seed=7, n=20)])
    local = other.points[:, 0] > 0.0
    piece = Cloud(**{k: getattr(other, k)[local] for k in ("points", "normals", "view_directions", "counts")})
    found = register(transformed(piece, wrong(1.0, 2.0, 3)), lump_cloud)
    back = found.X @ wrong(1.0, 2.0, 3)
    moved = piece.points @ back[:3, :3].T + back[:3, 3]
    assert np.linalg.norm(moved - piece.points, axis=1).max() < 0.05e-3
    assert found.trusted


def test_a_sphere_and_a_plane_are_not_trusted(rng):
    u = rng.standard_normal((6000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    ball = Cloud(points=0.1 * u, normals=u, view_directions=u, counts=np.ones(6000))
    xy = rng.uniform(-0.1, 0.1, (6000, 2))
    up = np.tile([0.0, 0.0, 1.0], (6000, 1))
    sheet = Cloud(
        points=np.column_stack([xy, np.zeros(6000)]), normals=up, view_directions=up, counts=np.ones(6000)
    )
    for cloud in (ball, sheet):
        other = Cloud(
            **{k: getattr(cloud, k)[::2] for k in ("points", "normals", "view_directions", "counts")}
        )
        found = register(other, cloud)
        assert not found.trusted and "free" in found.statement


def test_clouds_that_do_not_meet_are_not_trusted(lump_cloud):
    away = transformed(lump_cloud, motion(np.array([[1.0, 0, 0, 0, 0, 0]]))[0])
    found = register(away, lump_cloud)
    assert not found.trusted and found.fitness == 0.0
    assert np.array_equal(found.X, np.eye(4))


def test_all_clouds_at_once_close_the_ring(lump_cloud):
    azimuth = np.arctan2(lump_cloud.points[:, 1], lump_cloud.points[:, 0])
    names = ("points", "normals", "view_directions", "counts")
    pieces, starts = [], []
    for k in range(4):
        away = np.abs((azimuth - k * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi)
        pieces.append(Cloud(**{n: getattr(lump_cloud, n)[away < 1.1] for n in names}))
        starts.append(np.eye(4) if k == 0 else wrong(0.7, 1.5, k))
    found = align(pieces, start=np.stack(starts))
    for piece, r in zip(pieces, found, strict=True):
        assert np.abs(transformed(piece, r.X).points - piece.points).max() < 5e-6


def test_too_few_points_to_register(lump_cloud):
    few = Cloud(
        **{n: getattr(lump_cloud, n)[:20] for n in ("points", "normals", "view_directions", "counts")}
    )
    with pytest.raises(InputError, match="too few"):
        register(few, lump_cloud)


def test_the_stated_uncertainty_is_the_spread_of_the_answers(lump):
    """Independent noise: errors over many draws against what each registration says of itself."""
    exact = surface_samples(lump, 60_000, rng=np.random.default_rng(0))
    target = Cloud(
        points=exact.points, normals=exact.normals, view_directions=exact.normals, counts=np.ones(60_000)
    )
    errors, said = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        some = surface_samples(lump, 1500, rng=rng)
        noisy = some.points + 2e-4 * rng.standard_normal((1500, 1)) * some.normals
        source = replace(
            target, points=noisy, normals=some.normals, view_directions=some.normals, counts=np.ones(1500)
        )
        found = register(source, target, reach=0.002)
        centre = noisy.mean(axis=0)
        size = np.sqrt(((noisy - centre) ** 2).sum(axis=1).mean())
        shift = found.X[:3, :3] @ centre + found.X[:3, 3] - centre
        errors.append(shift @ shift + (size * found.turn) ** 2)
        said.append(found.uncertainty)
        assert found.rms == pytest.approx(2e-4, rel=0.15)
    # The uncertainty is that of the worst of six motions: the whole error is between one and six of it.
    ratio = np.mean(errors) / np.mean(said) ** 2
    assert 0.6 < ratio < 8.0


def test_a_first_guess_is_where_registration_starts(lump_cloud):
    X = wrong(25.0, 120.0, 5)
    moved = transformed(lump_cloud, X)
    near = inverse((wrong(1.0, 2.0, 6) @ X)[None])[0]
    found = register(moved, lump_cloud, start=near)
    assert np.abs(found.X @ X - np.eye(4)).max() < 1e-4
    assert found.shift < 5e-3 and found.turn == pytest.approx(np.deg2rad(1.0), rel=0.01)
