"""The steps of a job: start it, let the twin take frames, plan what is missing, write the model."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.geometry.files.ply_write import write_ply
from scanmotion.job.model import Model, Progress, model_of
from scanmotion.job.poses import programme_captures
from scanmotion.job.simulate import write_simulated
from scanmotion.job.store import Job, JobRecord, PlanEntry, new_job, with_plan
from scanmotion.plan_io.load import load_plan
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.planning.segment import silent
from scanmotion.sensing.fusion.surface import surface as surface_of
from scanmotion.sensing.scans.scan_files import save_cloud

_MOST_REASONS = 8


def start_job(
    folder: Path, cell: Path | None, settings: CellSettings, part: Part, box_mm: tuple[float, float, float],
    *, seed: int = 0, progress: Progress = silent,
) -> Job:  # fmt: skip
    """Makes a job and plans its global step from the bounding box.

    Args:
        folder: new, or empty.
        cell: the YAML that the settings come from; None for a built-in cell.
        settings: the cell.
        part: the box.
        box_mm: its sides.
        seed: of all that is drawn.
        progress: told the stage and the share done.

    Raises:
        InputError: the folder holds something, or nothing could be planned.
    """
    made = plan(part, settings, options=PlanOptions(source="box", seed=seed), progress=progress)
    job = new_job(folder, cell, settings, JobRecord(name=folder.name, box_mm=box_mm, seed=seed))
    return _with_made(job, made, "global")


def _with_made(job: Job, made: Any, step: str) -> Job:
    """Writes a plan into the job: its folder first, then the record."""
    name = f"plan-{len(job.record.plans) + 1}"
    made.save(job.folder / name)
    written = load_plan(job.folder / name).trajectory
    assert written is not None
    frames = len(programme_captures(build_cell(job.settings), written))
    return with_plan(job, PlanEntry(folder=name, step=step, frames=frames))


def simulated_frames(
    job: Job,
    truth: Part,
    number: int | None,
    *,
    kind: str = "ply",
    stride: int = 2,
    progress: Any = lambda f: None,
) -> Path:
    """Lets the twin write the frames of a plan; returns their folder, `scanner/plan-N` in the job.

    Args:
        job: with the plan.
        truth: the mesh on the table.
        number: of the plan; None for the last.
        kind: of the frames.
        stride: every n-th pixel.
        progress: told the share done.

    Raises:
        InputError: no such plan.
    """
    number = number or len(job.record.plans)
    if not 1 <= number <= len(job.record.plans):
        raise InputError(f"--plan {number}: the job has the plans 1 to {len(job.record.plans)}")
    folder = job.folder / "scanner" / f"plan-{number}"
    write_simulated(job, number, truth, folder, kind=kind, stride=stride, progress=progress)
    return folder


def plan_next(job: Job, *, progress: Progress = silent) -> dict[str, Any]:
    """Plans a local step for what the frames so far have not shown, and adds it to the job.

    Returns:
        what was found, for people: holes, the plan, and what stays out with reasons.

    Raises:
        InputError: the job has no frames.
    """
    model = model_of(job, progress=progress)
    options = PlanOptions(source="scan", seed=job.record.seed)
    made = plan(model.part, job.settings, options=options, progress=progress)
    found: dict[str, Any] = {"holes": len(model.holes.holes), **_left(made)}
    if made.trajectory is None:
        return {"plan": "none: nothing is missing that a programme could show", **found}
    done = _with_made(job, made, "local")
    entry = done.record.plans[-1]
    summary = json.loads((done.plan_folder(len(done.record.plans)) / "summary.json").read_text())
    views = summary["viewpoints"]
    return {
        "plan": entry.folder, "viewpoints": views["local"], "frames": entry.frames,
        "seconds": round(float(summary["time_s"]["total"]), 2), "findings": summary["findings"], **found,
    }  # fmt: skip


def _left(made: Any) -> dict[str, Any]:
    """What stays out, by reason."""
    areas: dict[str, float] = {}
    for patch in made.unscanned:
        areas[patch.reason] = areas.get(patch.reason, 0.0) + float(patch.area) * 1e6
    reasons: dict[str, int] = {}
    for _, why in made.left_out:
        reasons[why] = reasons.get(why, 0) + 1
    return {
        "stays_out": [f"{area:.0f} mm2: {why}" for why, area in sorted(areas.items(), key=lambda x: -x[1])],
        "left_out": [f"{n} viewpoints: {why}" for why, n in list(reasons.items())[:_MOST_REASONS]],
    }


def state_of(job: Job) -> dict[str, Any]:
    """Where the job stands, without fusing anything."""
    record = job.record
    taken = {b.plan for b in record.batches}
    waiting = [p.folder for i, p in enumerate(record.plans, start=1) if i not in taken]
    if waiting:
        todo = f"run {waiting[-1]} and add its frames"
    else:
        todo = "scanmotion job next: plan what is missing"
    return {
        "job": record.name,
        "box_mm": " x ".join(f"{s:g}" for s in record.box_mm),
        "plans": [f"{p.folder}: {p.step} step, {p.frames} frames" for p in record.plans],
        "frames": [
            f"{b.file}: {len(b.sha256)} frames, {b.points} points, poses from {b.posed_by}"
            + (" (simulated)" if b.simulated else "")
            for b in record.batches
        ],
        "calibration": "none" if record.calibration is None else json.dumps(record.calibration),
        "to_do": todo,
    }


def write_model(
    job: Job, out: Path, *, surface: bool = False, registered: bool = True, progress: Progress = silent
) -> dict[str, Any]:
    """Fuses the job's frames into a PLY in millimetres.

    Args:
        job: with frames.
        out: the file.
        surface: a triangle mesh instead of a cloud.
        registered: whether segments are registered first.
        progress: told the stage and the share done.

    Raises:
        InputError: no frames, or the file cannot be written.
    """
    found = model_of(job, registered=registered, progress=progress)
    told: dict[str, Any] = {"points": len(found.cloud), "segments": segment_lines(found)}
    if surface:
        vertices, triangles = surface_of(found.cloud)
        write_ply(out, vertices * 1e3, triangles=triangles)
        told["triangles"] = len(triangles)
    else:
        save_cloud(out, found.cloud)
    return {**told, "file": str(out)}


def segment_lines(found: Model) -> list[str]:
    """What became of each segment, one sentence each."""
    lines = []
    for s in found.segments:
        if s.registration is None:
            lines.append(f"frames-{s.batch}: where its poses put it")
            continue
        r = s.registration
        by = (
            f", moved by {r.shift * 1e3:.3f} mm and {np.rad2deg(r.turn):.4f} deg"
            if s.used
            else ", left in place"
        )
        lines.append(f"frames-{s.batch}: {r.statement}{by}")
    return lines
