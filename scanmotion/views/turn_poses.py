"""Scanner poses about the table for whole turns and what lies between them: a grid, chosen from later."""

import numpy as np

from scanmotion.core.scanner import Scanner
from scanmotion.views.stepped_rotary import oblique_turn

TILTS = np.deg2rad([-28.0, -20.0, -12.0, -4.0, 6.0, 16.0, 26.0, 36.0, 46.0, 58.0, 70.0])
"""Inclinations above the aimed point [rad]."""
YAWS = np.deg2rad([-32.0, -16.0, 0.0, 16.0, 32.0])
"""Angles between line of sight and axial plane [rad]."""
AIMS = (0.1, 0.35, 0.6, 0.85)
"""Aimed heights as shares of the part's."""
ROLLS = np.pi / 2 * np.arange(4)
_CLEAR_M = 0.03
"""The nearest surface stays this far beyond the least range [m]."""
_ABOVE_M = 0.02
"""Least height of the optical centre above the table [m]."""


def turn_poses(solid: np.ndarray, scanner: Scanner, *, table_z: float) -> np.ndarray:
    """Poses X_OS at azimuth zero, shape (n, 4, 4).

    Args:
        solid: points of the surface in O, shape (k, 3) [m].
        scanner: its range.
        table_z: height of the table's top in O [m].
    """
    radius = float(np.linalg.norm(solid[:, :2], axis=1).max())
    top = float(solid[:, 2].max())
    near, far = scanner.range
    poses = []
    for tilt in TILTS:
        close = near + radius * np.cos(tilt) + _CLEAR_M
        # The surface is a cylinder's at most: steep views may come nearer to its rim than to its axis.
        reach = sorted({round(d, 4) for d in (close, (close + max(0.95 * far, close)) / 2, 0.95 * far)})
        for distance in [d for d in reach if d >= close - 1e-6] or [close]:
            for aim in AIMS:
                for yaw in YAWS:
                    for roll in ROLLS:
                        poses.append(
                            oblique_turn(
                                tilt, yaw, aim * top, distance, radius=radius, floor=table_z + _ABOVE_M,
                                roll=roll,
                            )
                        )  # fmt: skip
    poses = np.array(poses).reshape(-1, 4, 4)
    _, once = np.unique(np.round(poses[:, :3].reshape(len(poses), -1), 3), axis=0, return_index=True)
    return poses[np.sort(once)]
