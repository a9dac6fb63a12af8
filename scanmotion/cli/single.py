"""Commands that run one stage alone: `holes`, `viewpoints`, `reach`, `fuse`, `robots`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from scanmotion.cli.app import OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import (
    OUT,
    PART,
    Box,
    CellFile,
    Json,
    PartFile,
    Place,
    Quiet,
    Robot,
    ScanFile,
    Seed,
    Units,
    Up,
    cell_from,
    check_mode,
    only_one,
    part_and_source,
)  # fmt: skip
from scanmotion.errors import InputError

Mode = Annotated[str, typer.Option("--mode", help="default, or paper: the published formulas literally.")]


def holes(
    file: Annotated[Path, typer.Argument(help="Cloud or mesh (PLY, STL, OBJ, PCD, XYZ).")],
    units: Units = "mm",
    up: Up = "+z",
    mode: Mode = "default",
    json: Json = False,
) -> int:
    """Find the holes of a scan: boundary, clusters, size, kind."""
    from scanmotion.part import part_from_file

    check_mode(mode)
    part = part_from_file(file, units=units, up=up, place="centre")
    report = holes_of(part, mode)
    if json:
        say_json(
            {
                "file": str(file),
                "radius_mm": report.radius * 1e3,
                "holes": [hole_record(h) for h in report.holes],
                "tiny": len(report.tiny),
                "notes": list(report.notes),
            }
        )
        return OK
    header = ("hole", "kind", "X' mm", "Y' mm", "Z' mm", "perimeter mm", "area mm2")
    rows = []
    for number, hole in enumerate(report.holes, start=1):
        sides = [f"{side * 1e3:.1f}" for side in hole.extent]
        rows.append(
            (f"H{number}", hole.kind, *sides, f"{hole.perimeter * 1e3:.0f}", f"{hole.area * 1e6:.0f}")
        )
    print_table(f"Holes of {file.name}", header, rows)
    for note in report.notes:
        typer.echo(note, err=True)
    return OK


def holes_of(part: Any, mode: str) -> Any:
    """The hole report of a mesh or a cloud."""
    from scanmotion.viewpoints.holes import holes_from_cloud, holes_from_mesh

    if part.is_mesh:
        return holes_from_mesh(part.vertices, part.triangles, mode=mode)
    return holes_from_cloud(part.vertices, normals=part.normals, mode=mode)


def hole_record(hole: Any) -> dict[str, Any]:
    """A hole in mm, for JSON."""
    return {
        "kind": hole.kind,
        "center_mm": [round(float(v) * 1e3, 3) for v in hole.center],
        "normal": [round(float(v), 6) for v in hole.normal],
        "extent_mm": [round(float(v) * 1e3, 3) for v in hole.extent],
        "perimeter_mm": round(hole.perimeter * 1e3, 3),
        "area_mm2": round(hole.area * 1e6, 3),
    }


def viewpoints(
    box: Box = None,
    part: PartFile = None,
    scan: ScanFile = None,
    units: Units = "mm",
    up: Up = "+z",
    place: Place = "",
    robot: Robot = None,
    cell: CellFile = None,
    mode: Mode = "default",
    out: Annotated[
        Path | None, typer.Option("--out", help="Write them to a .csv or .json file.", rich_help_panel=OUT)
    ] = None,
    json: Json = False,
) -> int:
    """Choose viewpoints without a robot: the global ones of a box or mesh, or the local ones of a scan."""
    check_mode(mode)
    if only_one(box=box, part=part, scan=scan) is None:
        raise InputError("give one of --box, --part, --scan")
    if out is not None and out.suffix not in (".csv", ".json"):
        raise InputError(f"--out {out}: must end in .csv or .json")
    settings = cell_from(robot, cell)
    subject, source = part_and_source(part, box, scan, units=units, up=up, place=place)
    chosen, dropped = choose_viewpoints(subject, source, settings, mode)
    if out is not None:
        from scanmotion.export.viewpoints import write_viewpoints

        write_viewpoints(chosen, out)
    if json:
        say_json({"viewpoints": [view_record(v) for v in chosen], "dropped": [list(d) for d in dropped]})
        return OK
    print_table("Viewpoints in the object frame", VIEW_HEADER, [view_row(v) for v in chosen])
    if dropped:
        print_table("Left out", ("viewpoint", "reason"), [(i, why) for i, why in dropped])
    if out is not None:
        typer.echo(str(out))
    return OK


def choose_viewpoints(subject: Any, source: str, settings: Any, mode: str) -> tuple[tuple, tuple]:
    """Viewpoints and (id, reason) of those left out, for a box or mesh (global) or a scan (local)."""
    standoff, scanner = settings.process.standoff_m, settings.scanner_model()
    if source == "scan":
        from scanmotion.viewpoints.local import local_viewpoints

        report = holes_of(subject, mode)
        return tuple(local_viewpoints(report.holes, scanner, standoff=standoff, mode=mode)), ()
    from scanmotion.viewpoints.stepped_rotary import stepped_rotary

    step = stepped_rotary(
        *subject.extent, scanner, standoff=standoff, mode=mode, pedestal=settings.pedestal.height_m
    )
    return tuple(step.viewpoints), tuple(step.dropped)


VIEW_HEADER = ("viewpoint", "step", "kind", "x mm", "y mm", "z mm", "direction", "standoff mm")


def view_row(view: Any) -> tuple[str, ...]:
    """A viewpoint as a row of a table."""
    position = [f"{v * 1e3:.1f}" for v in view.p_OS]
    direction = " ".join(f"{v:+.3f}" for v in view.direction)
    return (view.id, view.step, view.kind, *position, direction, f"{view.standoff * 1e3:.0f}")


def view_record(view: Any) -> dict[str, Any]:
    """A viewpoint for JSON; the pose in metres as in plan.json."""
    return {
        "id": view.id,
        "step": view.step,
        "kind": view.kind,
        "sweep": view.sweep,
        "standoff_m": view.standoff,
        "X_OS": view.X_OS.tolist(),
        "note": view.note,
    }


def reach(
    robot: Robot = None,
    cell: CellFile = None,
    box: Box = None,
    part: PartFile = None,
    units: Units = "mm",
    up: Up = "+z",
    views: Annotated[
        Path | None,
        typer.Option(
            "--viewpoints",
            help="CSV or JSON of viewpoints; the global ones by default.",
            rich_help_panel=PART,
        ),
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Say which viewpoints the robot can reach, in how many configurations, and why the others not."""
    if only_one(box=box, part=part) is None and views is None:
        raise InputError("give one of --box, --part, --viewpoints")
    settings = cell_from(robot, cell)
    subject = None
    if box is not None or part is not None:
        subject, _ = part_and_source(part, box, None, units=units, up=up)
    chosen = _views_for_reach(views, subject, settings)
    from scanmotion.cell.plant import build_cell
    from scanmotion.motion.reach import reach as find_reach

    with progress_bar(quiet=quiet or json) as progress:
        found = find_reach(
            build_cell(settings, subject), list(chosen), progress=lambda f: progress("reach", f)
        )
    if json:
        say_json([reach_record(r) for r in found])
    elif not quiet:
        header = ("viewpoint", "configurations", "clearance mm", "why not", "what would help")
        print_table("Reach", header, [reach_row(r) for r in found])
    return OK


def _views_for_reach(path: Path | None, subject: Any, settings: Any) -> tuple:
    if path is None:
        return choose_viewpoints(subject, "box", settings, "default")[0]
    from scanmotion.export.viewpoints import read_viewpoints

    return tuple(read_viewpoints(path))


def reach_record(item: Any) -> dict[str, Any]:
    """What was found for one viewpoint, for JSON."""
    lost = item.unreachable
    return {
        "id": item.viewpoint.id,
        "configurations": len(item.q),
        "clearance_mm": round(float(item.clearance.max()) * 1e3, 1) if len(item.q) else None,
        "unreachable": None
        if lost is None
        else {"cause": lost.cause, "detail": lost.detail, "remedy": lost.remedy},
    }


def reach_row(item: Any) -> tuple[str, ...]:
    """What was found for one viewpoint, as a row."""
    record = reach_record(item)
    lost = record["unreachable"]
    clearance = "" if record["clearance_mm"] is None else f"{record['clearance_mm']:.0f}"
    why = "" if lost is None else f"{lost['cause']}: {lost['detail']}"
    return (
        record["id"],
        str(record["configurations"]),
        clearance,
        why,
        "" if lost is None else lost["remedy"],
    )


def fuse(
    files: Annotated[list[Path], typer.Argument(help="Measured scans in the table's frame.")],
    out: Annotated[Path, typer.Option("--out", help="Fused cloud or surface, PLY.", rich_help_panel=OUT)],
    units: Units = "mm",
    voxel: Annotated[float, typer.Option("--voxel", help="Edge of the cloud's voxels [mm].")] = 2.0,
    register: Annotated[
        bool, typer.Option("--register/--no-register", help="Align the scans to one another first.")
    ] = True,
    surface: Annotated[bool, typer.Option("--surface", help="Write a triangle mesh, not a cloud.")] = False,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Merge measured scans into one cloud or surface."""
    from scanmotion.scan.files import fuse_files

    if out.suffix != ".ply":
        raise InputError(f"--out {out}: must end in .ply")
    if not 0.05 <= voxel <= 100.0:
        raise InputError(f"--voxel {voxel:g}: must lie between 0.05 and 100 mm")
    with progress_bar(quiet=quiet) as progress:
        lines = fuse_files(
            files, out, units=units, voxel=voxel * 1e-3, align=register, surface=surface, seed=seed,
            progress=progress,
        )  # fmt: skip
    if not quiet:
        for line in lines:
            typer.echo(line)
    return OK


def robot_record(name: str, settings: Any) -> dict[str, Any]:
    """A built-in cell and the robot in it."""
    from scanmotion.cell.plant import robot_facts

    facts = robot_facts()[settings.robot.model]
    return {"name": name} | {key: facts[key] for key in ("title", "reach_m", "payload_kg", "source")}


def robots(json: Json = False) -> int:
    """List the built-in robots and cells."""
    from scanmotion.cell.config import builtin_cells, load_cell

    records = [robot_record(name, load_cell(name)) for name in builtin_cells()]
    if json:
        say_json(records)
        return OK
    rows = [tuple(str(value) for value in record.values()) for record in records]
    print_table("Built-in cells", ("name", "robot", "reach m", "payload kg", "numbers from"), rows)
    return OK
