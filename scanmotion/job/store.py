"""A job on disk: the record, the plans and the frames of one scan, whole at any moment.

Guarantees: `job.json` is replaced as a whole and last of all; frames and plans that it does not name do not
belong to the job. A run that is killed leaves the job as it was before, or as it is after. Assumes: one
process changes a job at a time.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from scanmotion.cell.settings.cell import CellSettings, load_cell
from scanmotion.core.errors import InputError
from scanmotion.geometry.files.ply_write import replaced
from scanmotion.sensing.scans.scan_files import load_scan, scan_data
from scanmotion.sensing.simulator.simulate import Scan

RECORD, CELL = "job.json", "cell.yaml"


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PlanEntry(_Record):
    """One plan of the job."""

    folder: str = Field(pattern=r"^plan-[0-9]+$")
    step: str = Field(pattern=r"^(global|local)$")
    frames: int = Field(ge=0, description="frames that its programme takes")


class BatchEntry(_Record):
    """Frames that were added together."""

    file: str = Field(pattern=r"^frames-[0-9]+\.npz$")
    plan: int | None = Field(ge=1, description="number of the plan whose programme took them; none: not said")
    points: int = Field(ge=0)
    sha256: tuple[str, ...] = Field(description="of each frame's file")
    posed_by: str = Field(description="where the poses came from")
    simulated: bool = False


class JobRecord(_Record):
    """job.json."""

    format: int = Field(default=1, ge=1, le=1)
    name: str
    box_mm: tuple[float, float, float]
    seed: int = Field(ge=0)
    plans: tuple[PlanEntry, ...] = ()
    batches: tuple[BatchEntry, ...] = ()
    calibration: dict[str, Any] | None = Field(
        default=None, description="in the keys of the cell's section calibration"
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """A job as it was read."""

    folder: Path
    record: JobRecord
    settings: CellSettings

    @property
    def seen_files(self) -> set[str]:
        """SHA-256 of every frame's file that the job has."""
        return {s for b in self.record.batches for s in b.sha256}

    def plan_folder(self, number: int) -> Path:
        """Folder of a plan, counted from 1."""
        return self.folder / self.record.plans[number - 1].folder

    def scan(self, number: int) -> Scan:
        """The frames of a batch, counted from 1, as they were measured and posed."""
        return load_scan(self.folder / self.record.batches[number - 1].file)

    def scans(self) -> list[Scan]:
        """Every batch that has points, in the order in which they were added."""
        return [self.scan(i + 1) for i, b in enumerate(self.record.batches) if b.points]


def new_job(folder: Path, cell: Path | None, settings: CellSettings, record: JobRecord) -> Job:
    """Makes a job's folder with its record and a copy of the cell.

    Args:
        folder: new, or empty.
        cell: the YAML that `settings` come from; None for a built-in cell, whose settings are written out.
        settings: the cell.
        record: without plans and batches.

    Raises:
        InputError: the folder holds something, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: is there already and not empty; name another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
    replaced(folder / CELL, cell_text(settings, cell).encode())
    replaced(folder / RECORD, _text(record))
    return load_job(folder)


def cell_text(settings: CellSettings, cell: Path | None) -> str:
    """The YAML of a cell for a folder of its own: paths of models are made absolute."""
    import yaml

    told = settings.model_dump(mode="json")
    model = Path(settings.folder) / settings.robot.model if settings.folder else None
    if cell is not None and model is not None and model.suffix == ".urdf":
        told["robot"]["model"] = str(model.resolve())
    return "# The cell of this job.\n" + yaml.safe_dump(told, sort_keys=False)


def load_job(folder: str | Path) -> Job:
    """Reads a job.

    Raises:
        InputError: no job, one of another version, or one whose files are missing.
        CellError: its cell cannot be read.
    """
    folder = Path(folder)
    path = folder / RECORD
    if not path.is_file():
        raise InputError(
            f"{folder}: is no job: it holds no {RECORD}; `scanmotion job new {folder}` makes one"
        )
    try:
        record = JobRecord.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (ValidationError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is not a job's record ({' '.join(str(error).split())[:120]})") from None
    for name in [b.file for b in record.batches] + [p.folder for p in record.plans]:
        if not (folder / name).exists():
            raise InputError(f"{folder}: the job names {name}, which is missing")
    return Job(folder=folder, record=record, settings=load_cell(folder / CELL))


def with_batch(
    job: Job, scan: Scan, hashes: Sequence[str], *, plan: int | None, how: str, simulated: bool
) -> Job:
    """The job with one batch more: its file first, then the record.

    Args:
        job: as it is.
        scan: the frames.
        hashes: SHA-256 of the frames' files.
        plan: number of the plan whose programme took them.
        how: where the poses came from, for people.
        simulated: whether the twin took them.
    """
    name = f"frames-{len(job.record.batches) + 1}.npz"
    replaced(job.folder / name, scan_data(scan))
    entry = BatchEntry(
        file=name, plan=plan, points=len(scan), sha256=tuple(hashes), posed_by=how, simulated=simulated
    )
    return _with(job, batches=(*job.record.batches, entry))


def with_plan(job: Job, entry: PlanEntry) -> Job:
    """The job with one plan more, whose folder is there."""
    return _with(job, plans=(*job.record.plans, entry))


def with_calibration(job: Job, calibration: dict[str, Any] | None) -> Job:
    """The job whose frames are corrected by these constants from now on; None for as they were posed."""
    return _with(job, calibration=calibration)


def _with(job: Job, **changes: Any) -> Job:
    record = job.record.model_copy(update=changes)
    replaced(job.folder / RECORD, _text(record))
    return Job(folder=job.folder, record=record, settings=job.settings)


def _text(record: JobRecord) -> bytes:
    return (record.model_dump_json(indent=1) + "\n").encode()


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    sha = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            sha.update(block)
    return sha.hexdigest()


def box_m(record: JobRecord) -> np.ndarray:
    """Sides of the job's box [m], shape (3,)."""
    return np.array(record.box_mm) * 1e-3
