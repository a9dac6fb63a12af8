"""When each piece of the surface is first seen while a plan runs."""

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.core.trajectory import Trajectory
from scanmotion.planning.plan import Plan
from scanmotion.sensing.simulator.captures import captures_from_trajectory
from scanmotion.sensing.visibility import scene_from, seen_by_any

SLICE_S = 1.0
"""Sight is told to this; what is first seen within one slice appears at its end [s]."""
_FRAMES = 4
"""Frames looked at in one slice."""


def first_sight(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """When the scanner first sees each surface sample, by the nominal poses of the plan.

    Args:
        plan: a Plan with samples and a trajectory.

    Returns:
        Instants at which slices of scanning end, shape (k,) [s], and for each sample the index of the slice
        in which it is first seen, shape (n,); -1 where the plan does not see it. What was seen in frames
        between those looked at counts for the last slice of its step.
    """
    ends, spans, steps = _slices(plan)
    samples, trajectory = plan.samples, plan.trajectory
    first = np.full(0 if samples is None else len(samples.points), -1)
    if not ends or plan.seen is None or samples is None or trajectory is None:
        return np.zeros(0), first
    t, X_OS = _poses(plan.cell, trajectory)
    settings, part = plan.cell.settings, plan.part
    scene = scene_from(
        part.vertices, part.triangles, table_radius=settings.turntable.diameter_m / 2,
        table_z=-settings.pedestal.height_m, pedestal_radius=settings.pedestal.diameter_m / 2,
    )  # fmt: skip
    scanner = settings.scanner_model()
    rest = np.flatnonzero(plan.seen)
    for k, span in enumerate(spans):
        frames = _frames(t, *span)
        seen = seen_by_any(scene, scanner, X_OS[frames], samples.points[rest], samples.normals[rest])
        first[rest[seen]] = k
        rest = rest[~seen]
    last = max((k for k, step in enumerate(steps) if step == "global"), default=len(ends) - 1)
    first[rest] = np.where(plan.seen_globally[rest], last, len(ends) - 1)
    return np.array(ends), first


def _frames(t: np.ndarray, start: float, end: float) -> np.ndarray:
    """Some of the frames from `start` to `end`, the first and last among them."""
    frames = np.flatnonzero((t >= start - 1e-9) & (t <= end + 1e-9))
    return frames[np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))] if len(frames) else frames


def _slices(plan: Plan) -> tuple[list[float], list[tuple[float, float]], list[str]]:
    """The end, the span and the step of each slice of scanning, in order."""
    step_of = {view.id: view.step for view in plan.viewpoints}
    ends, spans, steps = [], [], []
    for o in plan.trajectory.operations if plan.trajectory is not None else ():
        if not o.scanning:
            continue
        count = max(int(np.ceil((o.t_end - o.t_start) / SLICE_S)), 1)
        marks = np.linspace(o.t_start, o.t_end, count + 1)
        ends += marks[1:].tolist()
        spans += list(zip(marks[:-1].tolist(), marks[1:].tolist(), strict=True))
        steps += [step_of.get(next(iter(o.viewpoints), ""), "local")] * count
    return ends, spans, steps


def _poses(cell: Cell, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Times and poses in the object of all frames."""
    captures = captures_from_trajectory(
        trajectory, lambda q: scanner_poses(cell, q), fps=cell.settings.process.fps,
        X_WT=cell.X_WT, X_TO=cell.X_TO,
    )  # fmt: skip
    return captures.t, captures.X_OS
