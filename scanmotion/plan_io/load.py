"""A plan read back from its folder, for pictures, reports and exports."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from scanmotion.cell.build import Cell, build_cell
from scanmotion.cell.settings import settings_from
from scanmotion.core.errors import PlanFileError, ScanMotionError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Slack, Viewpoint
from scanmotion.geometry.part_files import read_geometry
from scanmotion.plan_io.schema import (
    PlanRecord,
    ViewpointRecord,
    inside,
    read_json,
    read_plan,
    read_trajectory,
)
from scanmotion.plan_io.summary import read_arrays, read_holes, read_summary


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadedPlan:
    """What a plan folder holds; the attributes that pictures need have the names of `outcome.Plan`."""

    record: PlanRecord
    summary: dict[str, Any]
    part: Part
    cell: Cell
    options: Any
    """seed, mode, strategy and source."""
    viewpoints: tuple[Viewpoint, ...]
    unreachable: tuple[tuple[str, str], ...]
    trajectory: Trajectory
    segments: tuple[Any, ...]
    """Each with `step` and `seen`."""
    holes: Any
    """With `holes`, `tiny` and `notes`; None where there are none."""
    samples: SurfaceSamples | None
    visible: np.ndarray | None
    unscanned: tuple[Any, ...]

    @property
    def seen(self) -> np.ndarray | None:
        """Which samples the whole plan sees, shape (n,)."""
        return self.segments[-1].seen if self.samples is not None and self.segments else None


def cell_of(folder: Path, record: PlanRecord) -> tuple[Part, Cell]:
    """The part and the cell of a plan's folder.

    Raises:
        PlanFileError: a file is missing or not what it says.
    """
    try:
        settings = settings_from(read_json(folder, record.cell_file), folder=str(folder))
        if settings.robot.model.endswith(".urdf"):
            own = settings.robot.model_copy(update={"model": record.urdf_file})
            settings = settings.model_copy(update={"robot": own})
        solid = _part(folder, record)
        return solid, build_cell(settings, solid)
    except PlanFileError:
        raise
    except ScanMotionError as error:
        raise PlanFileError(f"{folder}: {error}") from None


def load_plan(folder: str | Path) -> LoadedPlan:
    """Reads a plan folder.

    Raises:
        PlanFileError: a file is missing or not what it says.
    """
    folder = Path(folder)
    record = read_plan(folder)
    summary = read_summary(folder)
    solid, cell = cell_of(folder, record)
    steps = [r["step"] for r in summary["rounds"]]
    arrays = read_arrays(folder, len(steps))
    seen = arrays.get("seen", np.zeros((0, 0), bool))
    samples = None
    if arrays:
        samples = SurfaceSamples(
            points=arrays["samples"].astype(float), normals=arrays["sample_normals"].astype(float), area=0.0
        )
    return LoadedPlan(
        record=record, summary=summary, part=solid, cell=cell,
        options=SimpleNamespace(
            seed=record.seed, mode=record.mode, strategy=record.strategy, source=record.source
        ),
        viewpoints=tuple(viewpoint_of(v) for v in record.viewpoints),
        unreachable=tuple(
            (u["id"], u["reason"]) for u in summary["viewpoints"]["unreachable"]
        ),
        trajectory=read_trajectory(folder, record),
        segments=tuple(SimpleNamespace(step=a, seen=b) for a, b in zip(steps, seen, strict=False)),
        holes=read_holes(folder),
        samples=samples,
        visible=arrays.get("visible") if samples is not None else None,
        unscanned=tuple(
            SimpleNamespace(
                center=np.array(p["center_mm"]) * 1e-3, area=p["area_mm2"] * 1e-6, reason=p["reason"]
            )
            for p in summary.get("unscanned", [])
        ),
    )  # fmt: skip


def _part(folder: Path, record: PlanRecord) -> Part:
    raw = read_geometry(inside(folder, record.part_file))
    if not (np.abs(raw.vertices) < 100.0).all():
        raise PlanFileError(f"{record.part_file}: corners 100 m away")
    return Part(name=record.part, vertices=raw.vertices, triangles=raw.triangles)


def viewpoint_of(v: ViewpointRecord) -> Viewpoint:
    """A viewpoint of plan.json."""
    return Viewpoint(
        id=v.id, X_OS=np.array(v.X_OS), standoff=v.standoff_m, step=v.step, kind=v.kind, sweep=v.sweep,
        slack=Slack(standoff=v.slack_standoff_m, tilt=v.slack_tilt_rad, roll=v.slack_roll), note=v.note,
    )  # fmt: skip
