"""What the twin's scans are worth beyond the fused cloud: calibration, registration, surface, and files."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from scanmotion.core.part import Part
from scanmotion.core.summary import (
    BeforeAfter,
    CalibrationSummary,
    DistanceSummary,
    RegistrationSummary,
    SurfaceSummary,
)
from scanmotion.core.support.streams import fixed_stream
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.sensing.assess import Accuracy, accuracy, distances_to, raycaster
from scanmotion.sensing.corrections.calibration import PARAMETERS, Calibration
from scanmotion.sensing.corrections.corrected_scan import Corrections
from scanmotion.sensing.corrections.registration import Registration
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.fusion.surface import deviation_mesh
from scanmotion.sensing.scans.scan_files import cloud_data, scan_data
from scanmotion.sensing.simulator.simulate import Scan

__all__ = [
    "calibration_record",
    "constants_by_name",
    "millimetres",
    "registration_records",
    "scan_files",
    "surface_record",
]

_SAMPLES = 100_000
"""Samples, uniform by area, at which a reconstructed surface is assessed."""


def millimetres(found: Accuracy | None) -> dict[str, float | None]:
    """Mean absolute, standard deviation and mean of the signed distance [mm]."""
    names = ("mean_abs", "sd_signed", "mean_signed")
    return {f"{n}_mm": None if found is None else round(getattr(found, n) * 1e3, 5) for n in names}


def calibration_record(corrections: Corrections | None) -> CalibrationSummary | None:
    """`calibration` of summary.json; None where the plan does not calibrate, or could not."""
    if corrections is None or corrections.calibration is None:
        return None
    found = corrections.calibration
    e = asdict(found.errors)
    values = [*e["hand_eye_m"], *e["hand_eye_rad"], *e["axis_m"], *e["axis_rad"], e["backlash_rad"]]
    values.append(e["latency_s"])
    return CalibrationSummary(
        applied=corrections.applied,
        estimated=constants_by_name(values),
        sd=constants_by_name(found.sd),
        undetermined=_undetermined(found),
        disagreement_mm={
            "before": round(found.rms_before * 1e3, 5), "after": round(found.rms_after * 1e3, 5),
        },
        global_cloud=BeforeAfter(
            before=DistanceSummary(**millimetres(corrections.before)),
            after=DistanceSummary(**millimetres(corrections.after)),
        ),
        statement=found.statement + ("" if corrections.applied else "; nothing is corrected"),
    )  # fmt: skip


def constants_by_name(values: Sequence[float] | np.ndarray) -> dict[str, list[float] | float]:
    """The unknowns of calibration in the keys of the cell's section `twin`."""
    v = np.asarray(values, float)
    deg, mm = np.rad2deg(v), v * 1e3

    def told(a: np.ndarray) -> list[float]:
        return [round(float(x), 6) for x in a]

    return {
        "hand_eye_mm": told(mm[:3]), "hand_eye_deg": told(deg[3:6]), "axis_mm": told(mm[6:8]),
        "axis_deg": told(deg[8:10]), "backlash_deg": round(float(deg[10]), 6),
        "latency_ms": round(float(mm[11]), 6),
    }  # fmt: skip


def _undetermined(found: Calibration) -> list[str]:
    every = zip(PARAMETERS, found.known, found.asked, strict=True)
    return [name for name, known, asked in every if asked and not known]


def registration_records(corrections: Corrections | None) -> list[RegistrationSummary]:
    """`registration` of summary.json: one entry for each scan after the first."""
    return [] if corrections is None else [_registration(i, r) for i, r in corrections.registrations]


def _registration(index: int, found: Registration) -> RegistrationSummary:
    sure = np.isfinite(found.uncertainty)
    return RegistrationSummary(
        round=index + 1,
        rms_mm=round(found.rms * 1e3, 5),
        fitness=round(found.fitness, 4),
        uncertainty_mm=round(found.uncertainty * 1e3, 5) if sure else None,
        shift_mm=round(found.shift * 1e3, 5),
        turn_deg=round(float(np.rad2deg(found.turn)), 5),
        trusted=bool(found.trusted),
        statement=found.statement,
    )


def surface_record(
    surface: tuple[np.ndarray, np.ndarray], part: Part, seen_points: np.ndarray | None = None
) -> SurfaceSummary:
    """`surface` of summary.json: the reconstructed surface against the truth, and the truth against it.

    Args:
        surface: vertices (v, 3) [m] and triangles (t, 3).
        part: the reference mesh.
        seen_points: points of the true surface that the scan saw, shape (n, 3) [m]; None for no way back.
    """
    made = Part(name="surface", vertices=surface[0], triangles=surface[1])
    at = surface_samples(made, _SAMPLES, rng=fixed_stream("reconstructed_samples")).points
    back: dict[str, float] = {}
    if seen_points is not None and len(seen_points):
        d = np.abs(distances_to(raycaster(made), seen_points, closed=False))
        back = {
            "mean_abs_mm": round(float(d.mean()) * 1e3, 5),
            "p95_abs_mm": round(float(np.percentile(d, 95)) * 1e3, 5),
        }
    told = millimetres(accuracy(at, part))
    return SurfaceSummary(**told, triangles=len(surface[1]), from_truth=back or None)


def scan_files(
    cloud: Cloud, surface: tuple[np.ndarray, np.ndarray], part: Part, scans: Sequence[Scan]
) -> dict[str, bytes]:
    """The scans as files of a plan folder: cloud.ply, deviation.ply and frames-1.npz, frames-2.npz, ...

    Args:
        cloud: fused.
        surface: reconstructed from it, vertices (v, 3) [m] and triangles (t, 3).
        part: the reference mesh, whose distance colours the surface.
        scans: of the rounds.
    """
    frames = {f"frames-{i + 1}.npz": scan_data(scan) for i, scan in enumerate(scans)}
    return {"cloud.ply": cloud_data(cloud), "deviation.ply": deviation_mesh(*surface, part).data(), **frames}
