"""What the twin shows to be worth less than its seconds, once all rounds are done."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.part import SurfaceSamples
from scanmotion.core.trajectory import Trajectory
from scanmotion.planning.segment import Leg, costs
from scanmotion.sensing.simulator.captures import captures_from_trajectory
from scanmotion.sensing.visibility import Scene, seen_by_any


def stop_masks(
    cell: Cell,
    trajectory: Trajectory,
    scene: Scene,
    samples: SurfaceSamples,
    which: np.ndarray,
    *,
    most: int | None = None,
) -> list[np.ndarray]:
    """What each scanning operation sees at its nominal poses, shape (m,) bool each.

    Args:
        cell: scanner, table and frame rate.
        trajectory: the programme.
        scene: what blocks sight.
        samples: of the surface.
        which: indices of the samples that are asked about, shape (m,).
        most: frames of an operation that are looked at; None for all.
    """
    settings = cell.settings
    captures = captures_from_trajectory(
        trajectory, lambda q: scanner_poses(cell, q), fps=settings.process.fps, X_WT=cell.X_WT, X_TO=cell.X_TO
    )
    scanner, X_OS = settings.scanner_model(), captures.X_OS
    points, normals = samples.points[which], samples.normals[which]
    masks = []
    for o in trajectory.operations:
        if o.scanning:
            frames = np.flatnonzero((captures.t >= o.t_start - 1e-9) & (captures.t <= o.t_end + 1e-9))
            step = 1 if most is None else max(1, len(frames) // most)
            masks.append(seen_by_any(scene, scanner, X_OS[frames[::step]], points, normals))
    return masks


@dataclass(frozen=True, eq=False, kw_only=True)
class StopSeen:
    """A stop of a local round: what it costs, and what it sees."""

    viewpoints: tuple[str, ...]
    seconds: float
    mask: np.ndarray
    """Which of the samples asked about it sees, shape (m,)."""


def stops_seen(
    cell: Cell, legs: Sequence[Leg], scene: Scene, samples: SurfaceSamples, open_: np.ndarray
) -> list[StopSeen]:
    """What each stop of the legs costs and sees.

    Args:
        cell: the cell.
        legs: of the local rounds, in order.
        scene: what blocks sight.
        samples: of the surface.
        open_: indices of the samples that the global step has not seen, shape (m,).
    """
    found = []
    for leg in legs:
        if leg.trajectory is not None:
            seconds = costs(cell, leg.tour, leg.trajectory)
            masks = stop_masks(cell, leg.trajectory, scene, samples, open_)
            found += [
                StopSeen(viewpoints=stop.viewpoints, seconds=s, mask=m)
                for stop, s, m in zip(leg.tour.stops, seconds, masks, strict=True)
            ]
    return found


def not_worth(stops: Sequence[StopSeen], samples: int, *, rate: float, save: float = 0.0) -> dict[str, str]:
    """Local viewpoints that add less than they are worth, or that the budget has no seconds for, by id, with
    the reason.

    The least worthy goes first; what it alone saw of what another one saw too then counts for that one.

    Args:
        stops: of the local rounds.
        samples: how many the whole surface has.
        rate: least share of the surface that a second adds [1/s].
        save: what must be saved beyond that [s].
    """
    out: dict[str, str] = {}
    kept = list(stops)
    while kept:
        count = np.sum([stop.mask for stop in kept], axis=0)
        adds = np.array([(stop.mask & (count == 1)).sum() for stop in kept]) / samples
        worth = adds / np.maximum([stop.seconds for stop in kept], 1e-3)
        least = int(np.argmin(worth))
        stop = kept[least]
        adding = f"it adds {adds[least]:.3%} in {stop.seconds:.1f} s"
        if worth[least] < rate:
            reason = f"not worth its seconds: {adding}"
        elif save > 0.0:
            reason = f"no seconds are left for it in the budget: {adding}"
            save -= stop.seconds
        else:
            break
        out.update(dict.fromkeys(stop.viewpoints, reason))
        del kept[least]
    return out
