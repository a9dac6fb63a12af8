"""Poses, the chain's forward kinematics and times from rest to rest, against other code and closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scanmotion.geometry.chain import chain_jacobian, chain_poses, link_frames
from scanmotion.geometry.rest_to_rest import jerk_limited_seconds, trapezoid_second, trapezoid_seconds
from scanmotion.geometry.se3 import clean_angle, displacements, inverse_poses, rotations, turns_about_z


@pytest.fixture
def chain(rng):
    """A chain of six joints in general position: X_PJ, axes, X_6F."""
    axes = rng.standard_normal((6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return displacements(rng.standard_normal((6, 6))), axes, displacements(rng.standard_normal((1, 6)))[0]


def test_inverses_undo_poses_of_any_batch(rng):
    X = displacements(rng.standard_normal((12, 6))).reshape(3, 4, 4, 4)
    np.testing.assert_allclose(inverse_poses(X) @ X, np.broadcast_to(np.eye(4), X.shape), atol=1e-14)
    np.testing.assert_allclose(inverse_poses(X), np.linalg.inv(X), atol=1e-13)


def test_turns_are_scipys(rng):
    angles, axes = rng.uniform(-7, 7, 20), rng.standard_normal((20, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    about_z = Rotation.from_rotvec(angles[:, None] * [0, 0, 1.0]).as_matrix()
    np.testing.assert_allclose(turns_about_z(angles)[:, :3, :3], about_z, atol=1e-14)
    found = rotations(axes, angles[None])[0]
    np.testing.assert_allclose(found, Rotation.from_rotvec(angles[:, None] * axes).as_matrix(), atol=1e-14)


@given(st.floats(-100, 100))
def test_clean_angles_are_the_same_turn(angle):
    clean = float(clean_angle(np.array(angle)))
    assert -np.pi < clean <= np.pi + 1e-12
    assert np.cos(clean) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(clean) == pytest.approx(np.sin(angle), abs=1e-9)


def test_the_chain_is_a_product_of_scipys_turns(chain, rng):
    X_PJ, axes, X_6F = chain
    q = rng.uniform(-3, 3, (5, 6))
    found = chain_poses(X_PJ, axes, q)
    X_WB = displacements(rng.standard_normal((1, 6)))[0]
    for n in range(len(q)):
        X = np.eye(4)
        for i in range(6):
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(q[n, i] * axes[i]).as_matrix()
            X = X @ X_PJ[i] @ turn
            np.testing.assert_allclose(found[n, i + 1], X, atol=1e-13)
        out = np.empty((8, 3, 4))
        link_frames(q[n], (X_PJ, axes, X_WB, X_6F), out)
        np.testing.assert_allclose(out[:7], (X_WB @ found[n])[:, :3], atol=1e-13)
        np.testing.assert_allclose(out[7], (X_WB @ found[n, 6] @ X_6F)[:3], atol=1e-13)


def test_the_jacobian_is_the_change_of_the_flange(chain, rng):
    X_PJ, axes, X_6F = chain
    q, h = rng.uniform(-3, 3, (4, 6)), 1e-6
    J = chain_jacobian(X_PJ, axes, X_6F, q)
    for i in range(6):
        step = h * np.eye(6)[i]
        a, b = (chain_poses(X_PJ, axes, q + s * step)[:, 6] @ X_6F for s in (-1, 1))
        turn = Rotation.from_matrix(b[:, :3, :3] @ np.swapaxes(a[:, :3, :3], 1, 2)).as_rotvec() / (2 * h)
        np.testing.assert_allclose(J[:, :3, i], turn, atol=1e-7)
        np.testing.assert_allclose(J[:, 3:, i], (b - a)[:, :3, 3] / (2 * h), atol=1e-7)


@given(st.just(0.0) | st.floats(1e-9, 50), st.floats(0.01, 5), st.floats(0.01, 20))
def test_without_a_bound_on_jerk_the_profile_is_a_trapezoid(length, v, a):
    trapezoid = float(trapezoid_seconds(np.array(length), np.array(v), np.array(a)))
    assert trapezoid_second(length, v, a) == pytest.approx(trapezoid, rel=1e-12, abs=1e-12)
    assert float(jerk_limited_seconds(length, v, a, 1e9)) == pytest.approx(trapezoid, rel=1e-3, abs=1e-3)
    # The length is covered: the area under the velocity's trapezoid or triangle.
    peak = min(v, float(np.sqrt(length * a)))
    assert peak * (trapezoid - peak / a) == pytest.approx(length, rel=1e-9, abs=1e-9)
