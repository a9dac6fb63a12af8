"""report.html and report.json of a job: what was seen, what is missing, how segments fit, how exact it is."""

import json
from html import escape
from pathlib import Path
from typing import Any

from scanmotion import __version__
from scanmotion.geometry.files.ply_write import replaced
from scanmotion.job.flow import segment_lines, state_of
from scanmotion.job.model import Progress, model_of
from scanmotion.job.store import Job
from scanmotion.report.assessment import (
    Assessment,
    assessment_record,
    figure_rows,
    histogram_figure,
    map_figure,
)
from scanmotion.report.figures.maps import hole_figure
from scanmotion.report.html import image, page, table
from scanmotion.sensing.metrology.alignment import aligned
from scanmotion.sensing.metrology.deviations import deviations
from scanmotion.sensing.metrology.measured import reference_part


def write_report(
    job: Job, reference: Path | None, units: str, *, registered: bool = True, progress: Progress
) -> dict[str, Any]:
    """Fuses the job's frames, writes both files and returns the main figures.

    Args:
        job: with frames.
        reference: mesh to hold the model against; None for none.
        units: of the reference.
        registered: whether segments are registered first.
        progress: told the stage and the share done.

    Raises:
        InputError: no frames, or the reference cannot be used.
    """
    found = model_of(job, registered=registered, progress=progress)
    holes = sorted(found.holes.holes, key=lambda h: -h.area)
    record: dict[str, Any] = {
        "software": f"scanmotion {__version__}", **state_of(job), "points": len(found.cloud),
        "segments": segment_lines(found), "notes": [str(n) for n in found.holes.notes],
        "holes": [
            {"kind": h.kind, "area_mm2": round(float(h.area) * 1e6, 1),
             "center_mm": [round(float(x) * 1e3, 1) for x in h.center]}
            for h in holes
        ],
    }  # fmt: skip
    body = [
        f"<h1>Scan job: {escape(job.record.name)}</h1>", table((), _lines(state_of(job))),
        "<h2>Segments</h2>", table((), [(line,) for line in record["segments"]]),
        "<h2>Holes that are left</h2>", image(hole_figure(found.part, found.holes), "holes that are left"),
        table(("kind", "area mm2", "x y z mm"), [
            (h["kind"], h["area_mm2"], "  ".join(f"{x:.0f}" for x in h["center_mm"])) for h in record["holes"]
        ]),
    ]  # fmt: skip
    against: dict[str, Any] = {}
    if reference is not None:
        progress("compare", 0.9)
        part = reference_part(reference, units)
        fit = aligned(found.cloud.points, part)
        R, p = fit.X[:3, :3], fit.X[:3, 3]
        compared = deviations(found.cloud.points @ R.T + p, found.cloud.normals @ R.T, part)
        held = Assessment(
            measured=job.record.name, reference=part, alignment=fit, found=compared, limit=0.5e-3
        )
        record["against_reference"] = assessment_record(held)
        s, share = compared.spread, compared.completeness
        against = {"mean_abs_mm": s.mean_abs * 1e3, "sd_signed_mm": s.sd_signed * 1e3, "rms_mm": s.rms * 1e3}
        against = {k: round(v, 6) for k, v in against.items()}
        against["completeness"] = None if share is None else round(share, 6)
        body += [
            f"<h2>Against {escape(part.name)}</h2>", table((), figure_rows(held)),
            image(map_figure(held), "deviation from six sides"), image(histogram_figure(held), "histogram"),
        ]  # fmt: skip
    replaced(job.folder / "report.json", (json.dumps(record, indent=1, allow_nan=False) + "\n").encode())
    replaced(job.folder / "report.html", page(f"scanmotion: job {job.record.name}", "\n".join(body)).encode())
    told: dict[str, Any] = {"points": record["points"], "segments": record["segments"], "holes": len(holes)}
    return {**told, **against, "page": str(job.folder / "report.html")}


def _lines(state: dict[str, Any]) -> list[tuple[str, str]]:
    rows = []
    for key, value in state.items():
        rows += [(key.replace("_", " "), str(v)) for v in (value if isinstance(value, list) else [value])]
    return rows
