"""The structured-light scanner: field of view, range, incidence, baseline and noise.

Numbers are those of Table 1 of Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139); the
noise model is stated in docs/method.md, "The scan twin".
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Scanner:
    """A camera at the origin of S and a projector beside it, both looking along +z of S."""

    fov: tuple[float, float] = (np.deg2rad(30.0), np.deg2rad(21.0))
    """Full angles of the field of view along +x (long side l) and +y (short side w) [rad]."""
    range: tuple[float, float] = (0.4, 1.0)
    """Least and greatest depth along +z of S at which a point is measured [m]."""
    max_incidence: float = np.deg2rad(70.0)
    """Greatest angle between the surface normal and the line to camera or projector [rad]."""
    baseline: float = 0.150
    """The projector stands at (baseline, 0, 0) in S [m]."""
    rays: tuple[int, int] = (424, 296)
    """Measured pixels along x and y in one frame."""
    sigma_at_near: float = 0.05e-3
    """Standard deviation along the ray at the least depth and normal incidence [m]."""
    frame_scale: float = 1.5e-4
    """Standard deviation of one frame's scale error [m/m]."""

    @property
    def middle(self) -> float:
        """Middle of the range: the standoff where nothing else is asked for [m]."""
        return (self.range[0] + self.range[1]) / 2

    @property
    def depth(self) -> float:
        """Length of the range [m]."""
        return self.range[1] - self.range[0]

    def usual_depth(self, depths: np.ndarray) -> float | None:
        """Median of those depths (n,) that are in range, of all finite ones if none is; None for none."""
        depths = depths[np.isfinite(depths)]
        within = depths[(depths >= self.range[0]) & (depths <= self.range[1])]
        some = within if len(within) else depths
        return float(np.median(some)) if len(some) else None

    def field(self, depth: float | np.ndarray) -> tuple[float | np.ndarray, float | np.ndarray]:
        """Sides (l, w) of the field of view at `depth` [m]: l = 2 d tan(15 deg), w = 2 d tan(10.5 deg)."""
        return 2.0 * depth * np.tan(self.fov[0] / 2), 2.0 * depth * np.tan(self.fov[1] / 2)
