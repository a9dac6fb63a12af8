"""The arm's ways beside a table that turns: what paths and helices share."""

from collections.abc import Sequence

import numpy as np

from scanmotion.motion.profile.jerk_limited import TimeLaw
from scanmotion.motion.profile.spline import JointSpline

Way = tuple[JointSpline, TimeLaw]
"""A curve in joints, and the law by which it is driven."""


def driven_ways(
    start: np.ndarray, ways: Sequence[Way], leaves: Sequence[float], t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations of the joints, each (n, 7); the arm rests between its ways.

    Args:
        start: where the arm stands before the first way, shape (7,) [rad].
        ways: in their order, each from where the one before ends.
        leaves: when the arm sets out on each [s].
        t: times that are asked about, shape (n,) [s].
    """
    q = np.tile(start, (len(t), 1))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    for (path, law), leave in zip(ways, leaves, strict=True):
        on = np.flatnonzero(t >= leave)
        s, s1, s2 = law(np.minimum(t[on] - leave, law.duration)).T[:3, :, None]
        q1 = path(s[:, 0], 1)
        q[on], qd[on] = path(s[:, 0]), q1 * s1
        qdd[on] = path(s[:, 0], 2) * s1**2 + q1 * s2
    return q, qd, qdd
