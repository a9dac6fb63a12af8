"""Rigid poses as (4, 4) matrices, in batches: inverses, turns, displacements.

Everything here is pure and keeps batches. The closed forms are written out where scipy's Rotation would give
other last digits, so that plans keep their bytes; rotation vectors go through scipy.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation


def inverse_poses(X: np.ndarray) -> np.ndarray:
    """Inverses of rigid poses, shape (..., 4, 4)."""
    R = np.swapaxes(X[..., :3, :3], -1, -2)
    out = np.zeros_like(X)
    out[..., :3, :3] = R
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R, X[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def turns_about_z(angles: np.ndarray) -> np.ndarray:
    """Turns about z by `angles` (n,) [rad], counter-clockwise seen from above, shape (n, 4, 4)."""
    X = np.tile(np.eye(4), (len(angles), 1, 1))
    X[:, 0, 0] = X[:, 1, 1] = np.cos(angles)
    X[:, 1, 0] = np.sin(angles)
    X[:, 0, 1] = -X[:, 1, 0]
    return X


def displacements(twists: np.ndarray) -> np.ndarray:
    """Poses from displacements and rotation vectors, shape (n, 6) [m, rad] -> (n, 4, 4)."""
    X = np.tile(np.eye(4), (len(twists), 1, 1))
    X[:, :3, 3] = twists[:, :3]
    X[:, :3, :3] = Rotation.from_rotvec(twists[:, 3:]).as_matrix()
    return X


def rotations(axes: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations by `angles` (n, k) [rad] about unit `axes` (k, 3) (Rodrigues), shape (n, k, 3, 3)."""
    K = np.zeros((len(axes), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axes[:, 2], axes[:, 1], -axes[:, 0]
    K = K - K.transpose(0, 2, 1)
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    return np.eye(3) + s * K + (1 - c) * (K @ K)


def clean_angle(q: np.ndarray) -> np.ndarray:
    """Angles brought into (-pi, pi] [rad], any shape."""
    return math.pi - np.mod(math.pi - q, 2 * math.pi)
