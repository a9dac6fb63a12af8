"""The folder of several placements: placements.json, summary.json, and an ordinary plan's folder each.

Guarantees: the folder is replaced as a whole or stays as it was; each placement's folder is read by
everything that reads a plan.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from scanmotion import __version__
from scanmotion.plan_io.files import fill, fresh_folder
from scanmotion.plan_io.save import Judge, Measure, Pages, Saved, save
from scanmotion.plan_io.write import json_text
from scanmotion.planning.placements.plan_placements import PlacedPlan, Placement

MARK = "placements.json"


def save_placed(
    placed: PlacedPlan,
    folder: str | Path,
    *,
    judge: Judge,
    measure: Measure | None = None,
    pages: Pages | None = None,
    page: Callable[[PlacedPlan], Mapping[str, str]] | None = None,
) -> tuple[Saved, ...]:
    """Writes the folder of all placements and has each judged.

    Args:
        placed: with a trajectory in each placement.
        folder: new, empty, or of placements, which is replaced.
        judge: looks at each placement's files.
        measure: finds in each folder what its programme has to spare.
        pages: makes scene.html and report.html of each.
        page: makes further files about all of them, by name.

    Raises:
        PlanFileError: the folder cannot be written.
        InputError: a placement has no trajectory.
    """
    with fresh_folder(folder, mark=MARK) as fresh:
        saved = tuple(
            save(p.plan, fresh / p.name, judge=judge, measure=measure, pages=pages) for p in placed.placements
        )
        files = {
            MARK: json_text({"software": f"scanmotion {__version__}", **placements_record(placed)}),
            "summary.json": json_text(placed_summary(placed, saved)),
        }
        fill(fresh, {**files, **(page(placed) if page is not None else {})}, folder)
    return saved


def placements_record(placed: PlacedPlan) -> dict[str, object]:
    """How the part stands in each placement: metres, and radians but for the tip angle."""
    return {
        "part": placed.part.name,
        "placements": [
            {
                "folder": p.name,
                "rests": p.resting.name,
                "X_KO": np.round(p.X_KO, 12).tolist(),
                "up": np.round(p.resting.up, 9).tolist(),
                "centre_of_mass_m": np.round(p.resting.com_m, 6).tolist(),
                "support_m": np.round(p.resting.support_m, 6).tolist(),
                "tip_deg": round(float(np.degrees(p.resting.tip_rad)), 3),
                "even_density": p.resting.even,
                "warnings": list(p.warnings),
            }
            for p in placed.placements
        ],
        "no_further_because": placed.reason,
    }


def placed_summary(placed: PlacedPlan, saved: tuple[Saved, ...]) -> dict[str, object]:
    """What all placements achieve together."""
    return {
        "part": placed.part.name,
        "completeness": {
            "of_ceiling": round(placed.of_ceiling, 6),
            "ceiling_of_whole": round(placed.ceiling, 6),
            "of_whole": round(placed.of_whole, 6),
        },
        "time_s": {
            "total": round(placed.seconds, 3),
            "handling": "not counted",
        },
        "placements": [_one(p, s) for p, s in zip(placed.placements, saved, strict=True)],
        "findings": [
            f"{p.name}: {f}" for p, s in zip(placed.placements, saved, strict=True) for f in s.findings
        ],
    }


def _one(placement: Placement, saved: Saved) -> dict[str, object]:
    trial, trajectory = placement.trial, placement.plan.trajectory
    return {
        "folder": placement.name,
        "rests": placement.resting.name,
        "adds_of_ceiling": round(placement.added, 6),
        "time_s": 0.0 if trajectory is None else round(float(trajectory.duration), 3),
        "findings": len(saved.findings),
        "warnings": list(placement.warnings),
        "registration": None
        if trial is None
        else {
            "trusted": trial.found.trusted,
            "share_of_partners": round(trial.found.fitness, 4),
            "share_at_another_yaw": round(trial.found.other, 4),
            "predicted_mm": round(trial.found.uncertainty * 1e3, 4),
            "simulated_mm": round(trial.distance_m * 1e3, 4),
            "simulated_deg": round(float(np.degrees(trial.angle_rad)), 4),
            "right": trial.right,
        },
    }
