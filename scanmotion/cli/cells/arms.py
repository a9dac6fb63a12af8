"""`scanmotion reach`: which viewpoints a cell serves, and where its table should stand."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import OK, Progress, print_table, progress_bar, say_json
from scanmotion.cli.geometry import choose_viewpoints
from scanmotion.cli.inputs import (
    OUT,
    PART,
    Box,
    CellFile,
    Json,
    PartFile,
    Quiet,
    Robot,
    Units,
    Up,
    cell_from,
    check_suffix,
    only_one,
    part_and_source,
)
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.cell.settings.cell import CellSettings
    from scanmotion.core.part import Part
    from scanmotion.core.viewpoint import Viewpoint
    from scanmotion.motion.reach.diagnosis import Change
    from scanmotion.motion.reach.find import Reach

DISTANCES_M = (1.8, 2.0, 2.2, 2.4)
HEIGHTS_M = (0.5, 0.7, 0.9)
"""Base distance and table height that `reach --sweep` tries."""


def reach(
    robot: Robot = None,
    cell: CellFile = None,
    box: Box = None,
    part: PartFile = None,
    units: Units = "",
    up: Up = "",
    views: Annotated[
        Path | None,
        typer.Option(
            "--viewpoints",
            help="CSV or JSON of viewpoints; by default the global ones.",
            rich_help_panel=PART,
        ),
    ] = None,
    sweep: Annotated[
        bool,
        typer.Option("--sweep", help="Try other base distances and table heights: where to put the robot."),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--map", help="Write a map of the viewpoints (PNG).", rich_help_panel=OUT)
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Say which viewpoints the robot can reach, in how many configurations, and why the others not."""
    if only_one(box=box, part=part) is None and views is None:
        raise InputError("give one of --box, --part, --viewpoints")
    check_suffix("--map", picture, ".png")
    settings = cell_from(robot, cell)
    subject = None
    if box is not None or part is not None:
        subject, _ = part_and_source(part, box, None, units=units, up=up)
    chosen = _views(views, subject, settings)
    with progress_bar(quiet=quiet or json) as progress:
        if sweep:
            rows = sweep_rows(settings, subject, chosen, progress)
        else:
            found = find(settings, subject, chosen, progress)
    if sweep:
        _say_sweep(rows, quiet=quiet, json=json)
        return OK
    if picture is not None:
        draw_reach(found, subject, settings, picture)
    if json:
        say_json([reach_record(r) for r in found])
    elif not quiet:
        header = ("viewpoint", "configurations", "solver", "clearance mm", "why not", "what would help")
        print_table("Reach", header, [reach_row(r) for r in found])
        typer.echo(f"{sum(r.unreachable is None for r in found)} of {len(found)} viewpoints can be reached")
    return OK


def find(
    settings: "CellSettings", subject: "Part | None", views: "Sequence[Viewpoint]", progress: Progress
) -> "list[Reach]":
    """The reach of a cell for some viewpoints."""
    from scanmotion.cell.build import build_cell
    from scanmotion.motion.reach.find import reach as find_reach

    return find_reach(build_cell(settings, subject), views, progress=lambda f: progress("reach", f))


def sweep_rows(
    settings: "CellSettings", subject: "Part | None", views: "Sequence[Viewpoint]", progress: Progress
) -> list[dict[str, float | None]]:
    """Share of the viewpoints that can be reached, over the table's distance from the base and its height.

    The table is moved along the line from base to table; the share is None where the cell cannot be so.
    """
    rows, total = [], len(DISTANCES_M) * len(HEIGHTS_M)
    for distance in DISTANCES_M:
        for height in HEIGHTS_M:
            progress("reach", len(rows) / total)
            share = _share(moved_table(settings, distance, height), subject, views)
            rows.append({"distance_m": distance, "height_m": height, "share": share})
    return rows


def moved_table(settings: "CellSettings", distance: float, height: float) -> "CellSettings":
    """Settings with the table `distance` from the base on its present side and `height` high [m]."""
    import math

    (bx, by, _), (tx, ty) = settings.base.position_m, settings.turntable.position_m
    angle = math.atan2(ty - by, tx - bx)
    place = (bx + distance * math.cos(angle), by + distance * math.sin(angle))
    table = settings.turntable.model_copy(update={"position_m": place, "height_m": height})
    return settings.model_copy(update={"turntable": table})


def _share(settings: "CellSettings", subject: "Part | None", views: "Sequence[Viewpoint]") -> float | None:
    from scanmotion.cell.build import build_cell
    from scanmotion.core.errors import CellError
    from scanmotion.motion.reach.find import ReachOptions
    from scanmotion.motion.reach.find import reach as find_reach

    try:
        cell = build_cell(settings, subject)
    except CellError:
        return None
    found = find_reach(cell, views, options=ReachOptions(most=1, remedies=False))
    return sum(r.unreachable is None for r in found) / max(len(found), 1)


def _say_sweep(rows: list[dict[str, float | None]], *, quiet: bool, json: bool) -> None:
    if json:
        say_json(rows)
    elif not quiet:
        header = ("base to table m", *(f"table at {height} m" for height in HEIGHTS_M))
        share = {
            (r["distance_m"], r["height_m"]): "-" if r["share"] is None else f"{r['share']:.0%}" for r in rows
        }
        lines = [(f"{d}", *(share[d, h] for h in HEIGHTS_M)) for d in DISTANCES_M]
        print_table("Share of the viewpoints that can be reached", header, lines)


def draw_reach(
    found: "Sequence[Reach]", subject: "Part | None", settings: "CellSettings", path: Path
) -> None:
    """Writes a map of the viewpoints: served, or the cause why not."""
    from scanmotion.report.figures.maps import reach_map

    causes = {r.viewpoint.id: "served" if r.unreachable is None else r.unreachable.cause for r in found}
    radius = settings.turntable.diameter_m / 2
    reach_map([r.viewpoint for r in found], causes, subject, radius).savefig(path)


def _views(path: Path | None, subject: "Part | None", settings: "CellSettings") -> "tuple[Viewpoint, ...]":
    if path is None:
        assert subject is not None
        return choose_viewpoints(subject, "box", settings, "default")[0]
    from scanmotion.export.viewpoints import read_viewpoints

    return tuple(read_viewpoints(path))


def reach_record(item: "Reach") -> dict[str, object]:
    """What was found for one viewpoint, for JSON."""
    lost = item.unreachable
    return {
        "id": item.viewpoint.id,
        "configurations": len(item.q),
        "solver": item.solver,
        "clearance_mm": round(float(item.clearance.max()) * 1e3, 1) if len(item.q) else None,
        "manipulability": round(float(item.manipulability.max()), 3) if len(item.q) else None,
        "unreachable": None
        if lost is None
        else {"cause": lost.cause, "detail": lost.detail, "remedy": lost.remedy, **_change(lost.change)},
    }


def _change(change: "Change | None") -> dict[str, float]:
    """The remedy as numbers: by how much the pedestal grows and the table goes away."""
    return {} if change is None else {"raise_m": change.raise_m, "shift_m": change.shift_m}


def reach_row(item: "Reach") -> tuple[str, ...]:
    """What was found for one viewpoint, as a row."""
    lost = item.unreachable
    clearance = f"{float(item.clearance.max()) * 1e3:.0f}" if len(item.q) else ""
    why = "" if lost is None else f"{lost.cause}: {lost.detail}"
    remedy = "" if lost is None else lost.remedy
    return (item.viewpoint.id, str(len(item.q)), item.solver, clearance, why, remedy)
