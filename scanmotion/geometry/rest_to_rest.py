"""Least times over a length from rest to rest, in closed form.

Each is the exact optimum for one axis that starts and ends at rest: a trapezoid or triangle of velocity where
acceleration is bounded, and the symmetric profile of seven pieces where jerk is bounded too (Biagiotti and
Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, sections 3.2 and 3.4). Lengths may be
in any unit, metres or radians, if velocity, acceleration and jerk are in the same.
"""

import numpy as np

from scanmotion.geometry.jit import njit


def jerk_limited_seconds(length: np.ndarray | float, v: float, a: float, j: float) -> np.ndarray:
    """Least time over a length inside velocity, acceleration and jerk [s].

    Args:
        length: not negative, any shape.
        v: greatest velocity.
        a: greatest acceleration.
        j: greatest jerk.

    Returns:
        the shape of `length`.
    """
    length = np.asarray(length, dtype=float)
    # Greatest velocities of the profile without a velocity limit, with and without constant acceleration.
    full = a / 2.0 * (np.sqrt((a / j) ** 2 + 4.0 * length / a) - a / j)
    bent = np.cbrt(length**2 * j / 4.0)
    peak = np.minimum(np.where(full >= a * a / j, full, bent), v)
    ramp = np.where(peak >= a * a / j, peak / a + a / j, 2.0 * np.sqrt(peak / j))
    return 2.0 * ramp + np.maximum(length - peak * ramp, 0.0) / np.maximum(peak, 1e-300)


def trapezoid_seconds(length: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Least time over lengths inside velocity and acceleration; the shapes broadcast [s]."""
    ramped = length / v + v / a
    return np.where(length > v**2 / a, ramped, 2 * np.sqrt(length / a))


@njit(cache=True)
def trapezoid_second(length, v, a):
    """`trapezoid_seconds` of one length, for compiled code."""
    if length * a >= v * v:
        return length / v + v / a
    return 2.0 * np.sqrt(length / a)
