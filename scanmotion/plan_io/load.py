"""A plan read back from its folder: the same type as one that was just made.

Guarantees: the viewpoints, reasons, trajectory and summary of the files. What is in no file is not there: the
errors of the simulated scans, configurations that were not taken, and the path of each transit.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import JsonValue

from scanmotion.cell.build import Cell, build_cell
from scanmotion.cell.settings.cell import settings_from
from scanmotion.core.errors import InputError, PlanFileError, ScanMotionError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.summary import RoundSummary, Summary
from scanmotion.core.tour import Tour
from scanmotion.core.trajectory import Trajectory, piece
from scanmotion.core.viewpoint import Slack, Viewpoint
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.plan_io.read import inside, read_json, read_plan, read_summary, read_trajectory
from scanmotion.plan_io.scans.scan_record import read_arrays, read_cloud, read_holes
from scanmotion.plan_io.schema import PlanRecord, ViewpointRecord
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import Segment, segment_from_operations, served_at
from scanmotion.views.unscanned import Patch

__all__ = ["load_plan"]


def cell_of(folder: Path, record: PlanRecord) -> tuple[Part, Cell]:
    """The part and the cell of a plan's folder.

    Raises:
        PlanFileError: a file is missing or not what it says.
    """
    try:
        settings = settings_from(_mapping(folder, record.cell_file), folder=str(folder))
        if settings.robot.model.endswith(".urdf"):
            own = settings.robot.model_copy(update={"model": record.urdf_file})
            settings = settings.model_copy(update={"robot": own})
        solid = _part(folder, record)
        return solid, build_cell(settings, solid)
    except PlanFileError:
        raise
    except ScanMotionError as error:
        raise PlanFileError(f"{folder}: {error}") from None


def load_plan(folder: str | Path) -> Plan:
    """Reads a plan folder.

    Args:
        folder: what `scanmotion plan` wrote.

    Raises:
        PlanFileError: a file is missing or not what it says.
    """
    folder = Path(folder)
    record, summary = read_plan(folder), read_summary(folder)
    trajectory, way_home = _without_way_home(read_trajectory(folder, record))
    solid, cell = cell_of(folder, record)
    options = _options(record)
    rounds = summary.rounds or [RoundSummary(step="global", viewpoints=0, completeness=None)]
    arrays = read_arrays(folder, len(rounds))
    segments = _segments(record, trajectory, rounds, summary.time_s.floor)
    samples = None
    if arrays:
        segments = [replace(s, seen=seen) for s, seen in zip(segments, arrays["seen"], strict=True)]
        samples = SurfaceSamples(
            points=arrays["samples"].astype(float), normals=arrays["sample_normals"].astype(float), area=0.0
        )
    known = {v.id for v in record.viewpoints}
    return Plan(
        part=solid, cell=cell, options=options, segments=tuple(segments), trajectory=trajectory,
        way_home=way_home,
        cloud=read_cloud(folder), holes=read_holes(folder), samples=samples, visible=arrays.get("visible"),
        dropped=tuple((u.id, u.reason) for u in summary.viewpoints.left_out if u.id not in known),
        unscanned=_unscanned(summary), planning_s=dict(summary.planning_s), summary=summary,
        meta=summary.meta,
    )  # fmt: skip


def _without_way_home(cycle: Trajectory) -> tuple[Trajectory, Trajectory | None]:
    """The scan, and the transit that leads to no viewpoint behind it, where there is one."""
    last = len(cycle.operations) - 1
    if last < 1 or cycle.operations[last].kind != "transit" or cycle.operations[last].viewpoints:
        return cycle, None
    if not (cycle.operation == last).any() or not (cycle.operation < last).any():
        return cycle, None
    return piece(cycle, 0, last - 1), piece(cycle, last, last)


def _mapping(folder: Path, name: str) -> dict[str, JsonValue]:
    data = read_json(folder, name)
    if not isinstance(data, dict):
        raise PlanFileError(f"{name}: an object is expected")
    return data


def _options(record: PlanRecord) -> PlanOptions:
    """Those of the words that are written down; PlanOptions refuses what it does not know."""
    words = {"source": record.source, "mode": record.mode, "strategy": record.strategy}
    try:
        return replace(PlanOptions(), seed=record.seed, **words)
    except InputError as error:
        raise PlanFileError(f"plan.json: {error}") from None


def _part(folder: Path, record: PlanRecord) -> Part:
    raw = read_geometry(inside(folder, record.part_file))
    if not (np.abs(raw.vertices) < 100.0).all():
        raise PlanFileError(f"{record.part_file}: corners 100 m away")
    return Part(name=record.part, vertices=raw.vertices, triangles=raw.triangles)


def _unscanned(summary: Summary) -> tuple[Patch, ...]:
    return tuple(
        Patch(center=np.array(p.center_mm) * 1e-3, area=p.area_mm2 * 1e-6, reason=p.reason)
        for p in summary.unscanned
    )


def _segments(
    record: PlanRecord, trajectory: Trajectory, rounds: Sequence[RoundSummary], floor: float
) -> list[Segment]:
    """One segment for each round of the summary: its operations, and the viewpoints up to its last one."""
    views = {v.id: viewpoint_of(v) for v in record.viewpoints}
    ends = _ends(trajectory, rounds)
    found: list[Segment] = []
    first = 0
    for item, end in zip(rounds, ends, strict=True):
        # The floor is known of the whole only; it stands with the first.
        bound = 0.0 if found else floor
        if _whole(trajectory, first, end) and set(_served(trajectory, first, end)) <= set(views):
            part = piece(trajectory, first, end - 1)
            found.append(segment_from_operations(part, views, step=item.step, floor=bound))
        else:
            at = trajectory.operations[first - 1].q_end if first else trajectory.q[0]
            tour = Tour(start_q=at, stops=(), seconds=0.0, floor=bound)
            found.append(
                Segment(
                    step=item.step, reaches=(), tour=tour, paths=(), trajectory=None, unreachable=(),
                    seen=np.zeros(0, bool),
                )
            )  # fmt: skip
        first = max(first, end)
    solvers = {v.id: v.solver for v in record.viewpoints}
    return _with_viewpoints(found, views, dict(record.unreachable), solvers)


def _whole(trajectory: Trajectory, first: int, end: int) -> bool:
    """Whether the operations first..end-1 have samples."""
    return bool(((trajectory.operation >= first) & (trajectory.operation < end)).any())


def _served(trajectory: Trajectory, first: int, end: int) -> list[str]:
    """Viewpoints of the scanning operations first..end-1, in order."""
    return [v for o in trajectory.operations[first:end] if o.scanning for v in o.viewpoints]


def _ends(trajectory: Trajectory, rounds: Sequence[RoundSummary]) -> list[int]:
    """For each round, how many operations are done when it has served as many viewpoints as it says."""
    ends: list[int] = []
    at = 0
    for item in rounds:
        left = item.viewpoints
        while left > 0 and at < len(trajectory.operations):
            o = trajectory.operations[at]
            left -= len(o.viewpoints) if o.scanning else 0
            at += 1
        ends.append(at)
    # What a summary does not count belongs to the last.
    ends[-1] = len(trajectory.operations)
    return ends


def _with_viewpoints(
    segments: list[Segment], views: dict[str, Viewpoint], reasons: dict[str, str], solvers: dict[str, str]
) -> list[Segment]:
    """The segments with all viewpoints in the order of the record: what is left out stands with what follows
    it.
    """
    home = {r.viewpoint.id: n for n, s in enumerate(segments) for r in s.reaches}
    known = {r.viewpoint.id: r for s in segments for r in s.reaches}
    place, at = dict[str, int](), len(segments) - 1
    for name in reversed(views):
        at = min(at, home.get(name, at))
        place[name] = at
    return [
        replace(
            s,
            reaches=tuple(
                replace(known.get(v) or served_at(view, np.zeros((0, 7))), solver=solvers[v])
                for v, view in views.items()
                if place[v] == n
            ),
            unreachable=tuple((v, reasons[v]) for v in views if place[v] == n and v in reasons),
        )
        for n, s in enumerate(segments)
    ]


def viewpoint_of(v: ViewpointRecord) -> Viewpoint:
    """A viewpoint of plan.json."""
    return Viewpoint(
        id=v.id, X_OS=np.array(v.X_OS), standoff=v.standoff_m, step=v.step, kind=v.kind, sweep=v.sweep,
        slack=Slack(standoff=v.slack_standoff_m, tilt=v.slack_tilt_rad, roll=v.slack_roll), note=v.note,
    )  # fmt: skip
