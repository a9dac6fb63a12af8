"""A plan read back from its folder, for pictures, reports and exports."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from scanmotion.cell.config import settings_from
from scanmotion.cell.plant import Cell, build_cell
from scanmotion.errors import PlanFileError, ScanMotionError
from scanmotion.part import Part, SurfaceSamples
from scanmotion.partfile import read_geometry
from scanmotion.planfile import PlanRecord, ViewpointRecord, read_json, read_plan, read_trajectory
from scanmotion.trajectory import Trajectory
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint

_MAX_ARRAYS = 512 << 20


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
    rounds: tuple[Any, ...]
    """Each with `step` and `seen`."""
    holes: Any
    """With `holes`, `tiny` and `notes`; None where there are none."""
    samples: SurfaceSamples | None
    visible: np.ndarray | None
    unscanned: tuple[Any, ...]

    @property
    def seen(self) -> np.ndarray | None:
        """Which samples the whole plan sees, shape (n,)."""
        return self.rounds[-1].seen if self.samples is not None and self.rounds else None


def load_plan(folder: str | Path) -> LoadedPlan:
    """Reads a plan folder.

    Raises:
        PlanFileError: a file is missing or not what it says.
    """
    folder = Path(folder)
    record = read_plan(folder)
    summary = read_json(folder, "summary.json")
    if not isinstance(summary, dict) or not isinstance(summary.get("rounds"), list):
        raise PlanFileError("summary.json: is not a plan's summary")
    try:
        settings = settings_from(read_json(folder, record.cell_file), folder=str(folder))
        if settings.robot.model.endswith(".urdf"):
            own = settings.robot.model_copy(update={"model": record.urdf_file})
            settings = settings.model_copy(update={"robot": own})
        solid = _part(folder, record)
        cell = build_cell(settings, solid)
    except PlanFileError:
        raise
    except ScanMotionError as error:
        raise PlanFileError(f"{folder}: {error}") from None
    arrays = arrays_of(folder)
    steps = [str(r.get("step")) for r in summary["rounds"] if isinstance(r, dict)]
    seen = arrays.get("seen", np.zeros((0, 0), bool))
    samples = None
    if "samples" in arrays and "visible" in arrays and len(seen) == len(steps):
        samples = SurfaceSamples(
            points=arrays["samples"].astype(float), normals=arrays["sample_normals"].astype(float), area=0.0
        )
    return LoadedPlan(
        record=record, summary=summary, part=solid, cell=cell,
        options=SimpleNamespace(
            seed=record.seed, mode=record.mode, strategy=record.strategy, source=record.source
        ),
        viewpoints=tuple(_viewpoint(v) for v in record.viewpoints),
        unreachable=tuple(
            (str(u.get("id")), str(u.get("reason"))) for u in summary["viewpoints"]["unreachable"]
        ),
        trajectory=read_trajectory(folder, record),
        rounds=tuple(SimpleNamespace(step=a, seen=b) for a, b in zip(steps, seen, strict=False)),
        holes=_holes(folder),
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
    raw = read_geometry(folder / record.part_file)
    return Part(name=record.part, vertices=raw.vertices, triangles=raw.triangles)


def _viewpoint(v: ViewpointRecord) -> Viewpoint:
    return Viewpoint(
        id=v.id, X_OS=np.array(v.X_OS), standoff=v.standoff_m, step=v.step, kind=v.kind, sweep=v.sweep,
        slack=Slack(standoff=v.slack_standoff_m, tilt=v.slack_tilt_rad, roll=v.slack_roll), note=v.note,
    )  # fmt: skip


def _holes(folder: Path) -> Any:
    data = read_json(folder, "holes.json") if (folder / "holes.json").is_file() else {}
    try:
        holes = [
            SimpleNamespace(**{k: np.array(v) if isinstance(v, list) else v for k, v in item.items()})
            for item in data.get("holes", [])
        ]
    except (AttributeError, TypeError, ValueError):
        raise PlanFileError("holes.json: is not a list of holes") from None
    return SimpleNamespace(holes=tuple(holes), tiny=(), notes=()) if holes else None


def arrays_of(folder: Path) -> dict[str, np.ndarray]:
    """scan.npz of a plan folder; empty where there is none.

    Raises:
        PlanFileError: it cannot be read.
    """
    path = folder / "scan.npz"
    if not path.is_file():
        return {}
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(i.file_size for i in archive.infolist()) > _MAX_ARRAYS:
                raise PlanFileError("scan.npz: holds more than a plan's arrays")
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise PlanFileError(f"scan.npz: cannot be read ({str(error)[:80]})") from None
