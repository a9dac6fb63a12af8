"""What the strictly typed rooms ask of scipy, which ships no types: the border where they are stated."""

from typing import cast

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import erf


def distances_to_nearest(points: np.ndarray, queries: np.ndarray) -> np.ndarray:
    """From each query to the nearest of the points, shape (m,) [m].

    Args:
        points: shape (n, 3) [m].
        queries: shape (m, 3) [m].
    """
    return cast(np.ndarray, cKDTree(points).query(queries)[0])


def hermite_at(t: np.ndarray, q: np.ndarray, qd: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The cubic Hermite spline through samples with their derivatives, at other times, shape (m, k).

    Args:
        t: times of the samples, increasing, shape (n,) [s].
        q: positions, shape (n, k) [rad].
        qd: their derivatives, shape (n, k) [rad/s].
        at: times that are asked about, shape (m,) [s].
    """
    return cast(np.ndarray, CubicHermiteSpline(t, q, qd)(at))


def quaternions_from_rotations(R: np.ndarray) -> np.ndarray:
    """Unit quaternions w, x, y, z with w >= 0, shape (n, 4), of rotations, shape (n, 3, 3)."""
    if len(R) == 0:
        return np.zeros((0, 4))
    return cast(np.ndarray, Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True))


def error_function(x: np.ndarray) -> np.ndarray:
    """Erf of each number, shape (n,)."""
    return cast(np.ndarray, erf(x))
