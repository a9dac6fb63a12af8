"""The best layout of a cell for a part: an evolution strategy over base distance, table height, fixture tilt.

The search is CMA-ES (Hansen, doi 10.1162/106365601750190398) by the `cma` package; each generation's plans
run as the cases of a study, so a search that is stopped goes on from its table. It minimises the seconds of
the programme; completeness that is lacking counts as many seconds as the ranking of a study gives it.
Guarantees: the cell's own layout is the first that is tried, so the answer is never worse than it; the same
seed gives the same search.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.cell.settings.cell import CellSettings, load_cell
from scanmotion.core.errors import InputError
from scanmotion.studies import table
from scanmotion.studies.run import Progress, StudyOptions, study

BOUNDS = {"distance_m": (1.6, 2.8), "height_m": (0.4, 1.1), "tilt_deg": (0.0, 90.0)}
"""What is searched, and between what: table from base, its top above the floor, tilt of the fixture."""
_STEP = 0.15
"""First step of the search as a share of the bounds."""
_LACK_S = 1e4
"""Seconds that a whole share of completeness counts for where it is lacking."""
_NO_PLAN_S = 1e6


@dataclass(frozen=True, kw_only=True)
class Tried:
    """One layout and what a plan in it gives."""

    values: dict[str, float]
    completeness: float | None
    seconds: float | None
    cost: float
    settings: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class LayoutSearch:
    """The cell as it is, and the best that was found."""

    present: Tried
    best: Tried
    tried: int


@dataclass(frozen=True, kw_only=True)
class LayoutOptions:
    """What a search for a layout may be told."""

    completeness: float = 0.995
    """Share of what can be seen that is asked for."""
    plans: int = 32
    """Plans that the search may make."""
    seed: int = 0
    plan_options: dict[str, Any] | None = None
    """Options of each plan, as in a study's YAML."""


def layout_search(
    robot: str,
    part: str | dict[str, Any],
    *,
    study_options: StudyOptions,
    options: LayoutOptions | None = None,
    progress: Progress | None = None,
) -> LayoutSearch:
    """Searches the layout with the least seconds at the completeness asked for.

    Args:
        robot: built-in cell, or the YAML of one.
        part: as a part of a study.
        study_options: table and workers.
        options: what is asked for.
        progress: told what is done, and the share of it.

    Raises:
        InputError: the part, the cell or an option is not usable.
    """
    import cma

    told = options or LayoutOptions()
    if not 0.0 < told.completeness <= 1.0:
        raise InputError(f"completeness {told.completeness:g}: a share above 0 and up to 1 is expected")
    base = load_cell(robot)
    start = _unit(present_values(base))
    search = cma.CMAEvolutionStrategy(
        list(start), _STEP, {"bounds": [0.0, 1.0], "seed": told.seed + 1, "verbose": -9, "popsize": 8}
    )
    tried = [_plans(robot, part, base, [start], told, study_options)[0]]
    while len(tried) < told.plans and not search.stop():
        asked = [np.round(x, 3) for x in search.ask()]
        found = _plans(robot, part, base, asked, told, study_options)
        search.tell(asked, [item.cost for item in found])
        tried += found
        if progress:
            best = min(tried, key=lambda item: item.cost)
            progress(f"{len(tried)} layouts, best cost {best.cost:.1f} s", min(1.0, len(tried) / told.plans))
    best = min(tried, key=lambda item: item.cost)
    return LayoutSearch(present=tried[0], best=best, tried=len(tried))


def present_values(base: CellSettings) -> dict[str, float]:
    """What is searched, as it is in a cell, brought inside the bounds."""
    (bx, by, _), (tx, ty) = base.base.position_m, base.turntable.position_m
    now = (math.hypot(tx - bx, ty - by), base.turntable.height_m, base.tool.tilt_deg)
    return {k: min(max(v, BOUNDS[k][0]), BOUNDS[k][1]) for k, v in zip(BOUNDS, now, strict=True)}


def _unit(values: dict[str, float]) -> np.ndarray:
    return np.round([(values[k] - low) / (high - low) for k, (low, high) in BOUNDS.items()], 3)


def _values(unit: np.ndarray) -> dict[str, float]:
    return {
        k: float(low + u * (high - low)) for u, (k, (low, high)) in zip(unit, BOUNDS.items(), strict=True)
    }


def layout_keys(base: CellSettings, values: dict[str, float]) -> dict[str, Any]:
    """The cell's keys of a layout: the table moves on the line from the base to where it is now."""
    (bx, by, _), (tx, ty) = base.base.position_m, base.turntable.position_m
    angle, r = math.atan2(ty - by, tx - bx), values["distance_m"]
    return {
        "turntable.position_m": [round(bx + r * math.cos(angle), 4), round(by + r * math.sin(angle), 4)],
        "turntable.height_m": round(values["height_m"], 4),
        "tool.tilt_deg": round(values["tilt_deg"], 2),
    }


def _plans(
    robot: str,
    part: str | dict[str, Any],
    base: CellSettings,
    units: list[np.ndarray],
    told: LayoutOptions,
    study_options: StudyOptions,
) -> list[Tried]:
    """Plans layouts as cases of a study and reads what came of them."""
    values = [_values(u) for u in units]
    names = ["x".join(f"{v:.3f}" for v in u) for u in units]
    layouts = {n: {"name": n, "set": layout_keys(base, v)} for n, v in zip(names, values, strict=True)}
    document = {
        "robots": [robot],
        "parts": [part],
        "seeds": [told.seed],
        "options": told.plan_options or {},
        "layouts": {"list": list(layouts.values())},
    }
    study(document, options=study_options)
    with table.opened(study_options.table) as connection:
        rows = {(row["robot"], row["layout"]): row for row in table.records(connection)}
    return [_tried(v, rows[robot, n], told) for v, n in zip(values, names, strict=True)]


def _tried(values: dict[str, float], row: dict[str, Any], told: LayoutOptions) -> Tried:
    import json

    share, seconds = row["completeness"], row["seconds"]
    cost = _NO_PLAN_S
    if row["status"] == "ok" and seconds is not None:
        cost = seconds + _LACK_S * max(0.0, told.completeness - (share if share is not None else 1.0))
    return Tried(
        values=values, completeness=share, seconds=seconds, cost=cost, settings=json.loads(row["settings"])
    )


def layout_table(path: Path | None, out: Path) -> Path:
    """The file of the search's table: as named, or beside the YAML that is written."""
    return path if path is not None else out.with_suffix(".sqlite")
