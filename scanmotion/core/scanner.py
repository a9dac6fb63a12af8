"""The structured-light scanner: field of view, range, incidence, baseline and noise.

Numbers are those of Table 1 of Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139); the
noise model is stated in docs/method.md, "The scan twin".
"""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Material:
    """What a surface does to the measurement: a model, not a measurement of any stone or metal."""

    max_incidence: float
    """At most this angle between normal and ray is measured, if the scanner allows it [rad]."""
    noise: float
    """Factor on the noise along the ray."""
    mirror: float
    """Half angle of the lobe in which the reflection blinds the camera [rad]."""


MATERIALS = {
    "matt": Material(max_incidence=np.deg2rad(90.0), noise=1.0, mirror=0.0),
    "glossy": Material(max_incidence=np.deg2rad(60.0), noise=1.5, mirror=np.deg2rad(5.0)),
    "dark": Material(max_incidence=np.deg2rad(55.0), noise=3.0, mirror=0.0),
}
"""Estimates: gloss returns less light at grazing angles and a highlight about the mirror direction (Torrance
and
Sparrow 1967, doi 10.1364/JOSA.57.001105); a dark surface returns a tenth of the light, noise grows as its
root.
"""


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
    exposure: float = 0.0
    """A pixel is measured at a random instant within this time about its frame's [s]: motion blur."""
    rolling: float = 0.0
    """From the first to the last pixel row the instant moves on by this time, the middle row's is the frame's
    [s]."""

    mirror: float = 0.0
    """A glossy surface blinds the camera where its normal lies within this of halfway to the projector
    [rad]."""

    @property
    def middle(self) -> float:
        """Middle of the range: the standoff where nothing else is asked for [m]."""
        return (self.range[0] + self.range[1]) / 2

    @property
    def depth(self) -> float:
        """Length of the range [m]."""
        return self.range[1] - self.range[0]

    def usual_depth(self, depths: np.ndarray) -> float | None:
        """Median of those depths that are in range, of all finite ones if none is; None for none.

        Args:
            depths: along the optical axis, shape (n,) [m]; one that is not finite is left out.
        """
        depths = depths[np.isfinite(depths)]
        within = depths[(depths >= self.range[0]) & (depths <= self.range[1])]
        some = within if len(within) else depths
        return float(np.median(some)) if len(some) else None

    def field(self, depth: float | np.ndarray) -> tuple[float | np.ndarray, float | np.ndarray]:
        """Sides (l, w) of the field of view [m]: twice the depth times the tangents of half its angles.

        Args:
            depth: along the optical axis, a number or shape (n,) [m].
        """
        return 2.0 * depth * np.tan(self.fov[0] / 2), 2.0 * depth * np.tan(self.fov[1] / 2)

    def before(self, material: Material) -> "Scanner":
        """The scanner as it measures a surface of this material."""
        return replace(
            self, max_incidence=min(self.max_incidence, material.max_incidence), mirror=material.mirror,
            sigma_at_near=self.sigma_at_near * material.noise,
        )  # fmt: skip
