"""One case of a study: a pure function from a case and its part to a row of figures.

Guarantees: the row depends on case and part alone (planning seconds and memory apart), so it is the same on
every worker; whatever goes wrong in a case is a row with a status and a reason, never an exception.
"""

import hashlib
import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion import __version__
from scanmotion.cell.settings.cell import CellSettings, settings_from
from scanmotion.core.errors import ScanMotionError
from scanmotion.core.part import Part
from scanmotion.studies.settings import Case

_DIRECTIONS = 150
"""Scanner poses round the part of a reach study."""
_LOWEST = -0.2
"""Sine of the lowest elevation of those poses."""

FIGURES = (
    "completeness",
    "after_global",
    "of_whole",
    "of_reach",
    "seconds",
    "floor_s",
    "mean_abs_mm",
    "sd_signed_mm",
    "viewpoints",
    "unreachable",
    "findings",
    "reachable",
)
"""Numbers of a row; one that a kind does not have is None."""


@dataclass(frozen=True, kw_only=True)
class CaseRow:
    """What came of one case."""

    id: str
    status: str
    """ok: figures are there. none: nothing could be planned. refused: the input is bad.
    fault: a fault of ours. killed: the case brought its worker down."""
    reason: str
    figures: dict[str, float | None]
    plan_sha256: str
    """Of plan.json and trajectory.csv one after the other; "" where no plan was made."""
    planning_s: float
    """CPU seconds of this case on its worker."""
    version: str


def row_of(case: Case, part: Part, *, keep_in: Path | None = None) -> CaseRow:
    """Plans, or counts, one case.

    Args:
        case: what is asked.
        part: the surface whose hash the case names.
        keep_in: a folder in which the plan's folder is kept, named by the case's id; None keeps none.
    """
    start = time.process_time()
    figures: dict[str, float | None] = dict.fromkeys(FIGURES)
    status, reason, sha = "ok", "", ""
    try:
        settings = settings_from(case.settings, folder=case.folder)
        if case.kind == "plan":
            found, reason, sha = _planned(case, settings, part, keep_in)
            status = "ok" if not reason else "none"
        else:
            found = _reached(case, settings, part) if case.kind == "reach" else _viewpoints(settings, part)
        figures.update(found)
    except ScanMotionError as error:
        status, reason = "refused", " ".join(str(error).split())
    except Exception as error:
        status, reason = "fault", f"{type(error).__name__}: {error}"[:500]
    return CaseRow(
        id=case.id,
        status=status,
        reason=reason,
        figures=figures,
        plan_sha256=sha,
        planning_s=time.process_time() - start,
        version=__version__,
    )


def _planned(
    case: Case, settings: CellSettings, part: Part, keep_in: Path | None
) -> tuple[dict[str, float | None], str, str]:
    """Figures of a whole plan, the reason where there is none, and the hash of its files."""
    from scanmotion.planning.options import PlanOptions
    from scanmotion.planning.pipeline import plan
    from scanmotion.planning.worth.comparison import VARIANTS

    options = replace(
        PlanOptions(source=case.source, seed=case.seed, **case.options), **VARIANTS[case.method]
    )
    made = plan(part, settings, options=options)
    with tempfile.TemporaryDirectory(prefix="scanmotion-case-") as folder:
        out = Path(folder) / case.id
        made.save(out)
        data = (out / "plan.json").read_bytes() + (out / "trajectory.csv").read_bytes()
        if keep_in is not None:
            keep_in.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(keep_in / case.id, ignore_errors=True)
            shutil.move(out, keep_in / case.id)
        summary = _summary_of(keep_in / case.id if keep_in is not None else out)
    share, accuracy, time_s = made.completeness(), made.accuracy(), made.time_s()
    figures: dict[str, float | None] = {
        "completeness": share["final"],
        "after_global": share["after_global"],
        "of_whole": share["final_of_whole"],
        "of_reach": made.within_reach()["scanned"],
        "seconds": float(time_s["total"]),
        "floor_s": float(time_s["floor"]),
        "mean_abs_mm": accuracy.mean_abs * 1e3 if accuracy else None,
        "sd_signed_mm": accuracy.sd_signed * 1e3 if accuracy else None,
        "viewpoints": float(len(made.viewpoints) - len(made.left_out)),
        "unreachable": float(len(made.unreachable)),
        "findings": float(len(summary.get("findings", ()))),
    }
    reason = "" if made.trajectory is not None else _why(made.left_out)
    return figures, reason, hashlib.sha256(data).hexdigest()


def _summary_of(folder: Path) -> dict[str, Any]:
    import json

    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def _why(unreachable: tuple[tuple[str, str], ...]) -> str:
    """The reason that most viewpoints share."""
    reasons = [reason for _, reason in unreachable]
    return max(set(reasons), key=lambda r: (reasons.count(r), r)) if reasons else "no viewpoint to plan"


def _viewpoints(settings: CellSettings, part: Part) -> dict[str, float | None]:
    """Number of stepped rotary viewpoints of the part's box."""
    from scanmotion.views.stepped_rotary import stepped_rotary

    length, width, height = (float(side) for side in part.extent)
    step = stepped_rotary(
        length,
        width,
        height,
        settings.scanner_model(),
        pedestal=settings.pedestal.height_m,
    )
    return {"viewpoints": float(len(step.viewpoints)), "unreachable": float(len(step.dropped))}


def _reached(case: Case, settings: CellSettings, part: Part) -> dict[str, float | None]:
    """Share of scanner poses, evenly spread round the part at the standoff, that the robot reaches."""
    from scanmotion.cell.build import build_cell
    from scanmotion.cell.collision.clearance import Clearance
    from scanmotion.motion.reach.find import reachable_mask

    cell = build_cell(settings, part)
    X_OS = poses_round(part, settings.process.standoff_m)
    mask = reachable_mask(cell, X_OS, clearance=Clearance(cell))
    return {"reachable": float(mask.mean()), "viewpoints": float(len(X_OS))}


def poses_round(part: Part, standoff: float) -> np.ndarray:
    """Poses that look at the centre of the part's box from `standoff` outside of it, shape (n, 4, 4).

    Directions are Fibonacci points of the sphere above a slightly negative elevation.

    Args:
        part: what is looked at.
        standoff: distance from where the line of sight enters the box to the scanner [m].
    """
    from scanmotion.core.viewpoint import look_at

    i = np.arange(_DIRECTIONS)
    z = _LOWEST + (1.0 - _LOWEST) * (i + 0.5) / _DIRECTIONS
    turn = np.pi * (1.0 + 5.0**0.5) * i
    across = np.sqrt(1.0 - z**2)
    away = np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    centre, half = part.bounds.mean(axis=0), part.extent / 2
    with np.errstate(divide="ignore"):
        depth = np.min(half / np.abs(away), axis=1)
    return np.stack([look_at(centre + d * (t + standoff), -d) for d, t in zip(away, depth, strict=True)])
