"""The scan twin's operator: puts the part a little wrong, takes still frames, and has the pose measured.

Guarantees: frames are taken from outside the cylinder in which the part can stand, so they are free of it
whatever its yaw; the error that is drawn is not told to the registration.
"""

from dataclasses import dataclass, replace

import numpy as np

from scanmotion.core.viewpoint import look_at
from scanmotion.planning.context import Context
from scanmotion.sensing.corrections.measured_placement import (
    SHIFT,
    MeasuredPlacement,
    drawn_error,
    measured_placement,
)
from scanmotion.sensing.corrections.registration import transformed
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.simulator.simulate import simulate, still_captures
from scanmotion.sensing.visibility import scene_from

_FRAMES = 4
_DOWN = np.deg2rad(35.0)
"""The frames look down at the part by this angle [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacingTrial:
    """One draw of a placing error and what came of it."""

    X_error: np.ndarray
    """Where the part was put, seen from where it was planned, shape (4, 4)."""
    found: MeasuredPlacement
    angle_rad: float
    """What is left of the error's rotation after correction [rad]."""
    distance_m: float
    """What is left of it at the part's middle [m]."""

    @property
    def right(self) -> bool:
        """Whether the pose was found: a tenth of a degree and half a millimetre."""
        return self.angle_rad < np.deg2rad(0.1) and self.distance_m < 5e-4


def placing_trial(ctx: Context, known: Cloud, rng: np.random.Generator) -> PlacingTrial:
    """Draws an error of placing, measures it in the twin, and compares.

    Args:
        ctx: of the placement, the part as it is planned to stand.
        known: what earlier placements scanned, in this placement's frame.
        rng: of the draw and of the scanner's noise.
    """
    assert ctx.simulator is not None
    X_error = drawn_error(rng)
    vertices = ctx.part.vertices @ X_error[:3, :3].T + X_error[:3, 3]
    # It stands on the table however it leans.
    X_error[2, 3] -= vertices[:, 2].min()
    vertices[:, 2] -= vertices[:, 2].min()
    table = ctx.surroundings.table
    scene = scene_from(
        vertices, ctx.part.triangles, table_radius=table.radius, table_z=table.z,
        pedestal_radius=table.pedestal_radius,
    )  # fmt: skip
    captures = still_captures(still_poses(ctx))
    scan = simulate(scene, ctx.scanner, captures, errors=ctx.simulator.errors, stride=4, rng=rng)
    frames = fuse([scan], voxel=2 * ctx.options.voxel)
    found = measured_placement(frames, known)
    left = found.X @ X_error
    middle = np.append(ctx.part.bounds.mean(axis=0), 1.0)
    angle = np.arccos(np.clip((np.trace(left[:3, :3]) - 1) / 2, -1, 1))
    return PlacingTrial(
        X_error=X_error,
        found=found,
        angle_rad=float(angle),
        distance_m=float(np.linalg.norm((left @ middle - middle)[:3])),
    )


def still_poses(ctx: Context) -> np.ndarray:
    """Poses of the still frames in the placement's frame, a quarter turn apart, shape (4, 4, 4)."""
    low, high = ctx.part.bounds
    height, radius = float(high[2]), ctx.part.radius + SHIFT
    near, far = ctx.scanner.range
    distance = min(max(near + radius + height / 2, 0.6 * (near + far)), far - 0.02)
    middle = np.array([0.0, 0.0, (low[2] + high[2]) / 2])
    poses: list[np.ndarray] = []
    for k in range(_FRAMES):
        turn = 2 * np.pi * k / _FRAMES
        away = np.array([np.cos(_DOWN) * np.cos(turn), np.cos(_DOWN) * np.sin(turn), np.sin(_DOWN)])
        poses.append(look_at(middle + distance * away, -away))
    return np.stack(poses)


def known_cloud(clouds: list[tuple[Cloud, np.ndarray]], X_KO: np.ndarray) -> Cloud:
    """What earlier placements scanned, brought to a further one.

    Args:
        clouds: each with X_JO (4, 4), from the part as it is given to its own placement.
        X_KO: from the part as it is given to the further placement, shape (4, 4).
    """
    moved = [transformed(cloud, X_KO @ np.linalg.inv(X_JO)) for cloud, X_JO in clouds]
    return replace(
        moved[0],
        points=np.concatenate([c.points for c in moved]),
        normals=np.concatenate([c.normals for c in moved]),
        view_directions=np.concatenate([c.view_directions for c in moved]),
        counts=np.concatenate([c.counts for c in moved]),
        cells=None,
    )
