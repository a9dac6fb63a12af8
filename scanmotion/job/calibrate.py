"""Calibration of a job's frames, and the cell that follows from it."""

from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from scanmotion.cell.settings.cell import CellSettings, settings_from
from scanmotion.core.errors import InputError
from scanmotion.job.store import Job
from scanmotion.plan_io.scans.measured import constants_by_name
from scanmotion.sensing.corrections.calibration import PARAMETERS, Calibration, calibrate
from scanmotion.sensing.simulator.captures import motion

POINTS = 300_000


def calibration_of(job: Job) -> Calibration:
    """The constant errors that all frames of a job agree on best, from zero and as they were posed.

    Raises:
        InputError: the job has no frames, or none that overlap.
    """
    scans = job.scans()
    if not scans:
        raise InputError(f"{job.folder}: has no frames yet to calibrate from")
    return calibrate(scans, points=POINTS, latency=True)


def record_of(found: Calibration) -> dict[str, Any]:
    """What was found, for machines: values and deviations in the keys of the cell's section calibration."""
    e = found.errors
    values = [
        *e.hand_eye_m, *e.hand_eye_rad, *e.axis_m, *e.axis_rad, e.backlash_rad, e.latency_s
    ]  # fmt: skip
    return {
        "estimated": constants_by_name(values), "sd": constants_by_name(found.sd),
        "determined": found.determined,
        "undetermined": [
            n for n, k, a in zip(PARAMETERS, found.known, found.asked, strict=True) if a and not k
        ],
        "disagreement_mm": {
            "before": round(found.rms_before * 1e3, 5), "after": round(found.rms_after * 1e3, 5)
        },
        "statement": found.statement
        + ". Where the base stands against the table is the table's axis against the robot: one is found.",
    }  # fmt: skip


def calibrated_cell(job: Job, found: Calibration) -> CellSettings:
    """The job's cell with what was found added to what it knew.

    In a job whose frames the twin took, the section twin loses what is known now, so that the cell describes
    the same world; what a real cell's twin says is left as it is.

    Raises:
        InputError: the frames do not determine all that was asked for.
    """
    if not found.determined:
        raise InputError(
            f"no cell is written: {found.statement}; `scanmotion calibrate plan` proposes turns that tell"
        )
    told = job.settings.model_dump(mode="json")
    delta = record_of(found)["estimated"]
    told["calibration"] = _added(told["calibration"], delta)
    if job.record.batches and all(b.simulated for b in job.record.batches):
        told["twin"] = _less(told["twin"], delta)
    return settings_from(told, folder=job.settings.folder)


def _added(old: dict[str, Any], delta: dict[str, Any]) -> dict[str, Any]:
    """Both motions in a row; play and latency add up."""
    out = dict(old)
    for name, size in (("hand_eye", 3), ("axis", 2)):
        pad = [0.0] * (3 - size)
        X = _motion(old, name, pad) @ _motion(delta, name, pad)
        turn = np.rad2deg(Rotation.from_matrix(X[:3, :3]).as_rotvec())
        out[f"{name}_mm"] = [round(float(v), 6) for v in X[:size, 3] * 1e3]
        out[f"{name}_deg"] = [round(float(v), 7) for v in turn[:size]]
    for key in ("backlash_deg", "latency_ms"):
        out[key] = round(old[key] + delta[key], 7)
    return out


def _motion(values: dict[str, Any], name: str, pad: list[float]) -> np.ndarray:
    p, r = np.array([*values[f"{name}_mm"], *pad]) * 1e-3, np.deg2rad([*values[f"{name}_deg"], *pad])
    return motion(np.array([[*p, *r]]))[0]


def _less(twin: dict[str, Any], delta: dict[str, Any]) -> dict[str, Any]:
    """What the world has beyond what is known now; errors are small, so that they subtract."""
    out = dict(twin)
    for key in ("hand_eye_mm", "hand_eye_deg", "axis_mm", "axis_deg"):
        out[key] = [round(a - b, 6) for a, b in zip(twin[key], delta[key], strict=True)]
    for key in ("backlash_deg", "latency_ms"):
        out[key] = round(twin[key] - delta[key], 6)
    # A play that was found a little too large cannot be taken off to below nothing.
    out["backlash_deg"] = max(out["backlash_deg"], 0.0)
    return out


def cell_yaml(settings: CellSettings, found: Calibration) -> str:
    """The YAML of a calibrated cell, the deviations as comments."""
    told = settings.model_dump(mode="json")
    lines = [
        "# A calibrated cell: the section calibration was estimated from frames. Standard deviations:",
        *(f"#   {k}: {v}" for k, v in record_of(found)["sd"].items()),
    ]
    return "\n".join(lines) + "\n" + yaml.safe_dump(told, sort_keys=False)
