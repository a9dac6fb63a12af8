"""Commands that know no robot: `inspect`, `holes`, `viewpoints`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, print_table, say_json
from scanmotion.cli.inputs import (
    OUT,
    Box,
    CellFile,
    Json,
    Mode,
    PartFile,
    Place,
    Robot,
    ScanFile,
    Units,
    Up,
    cell_from,
    check_mode,
    check_suffix,
    only_one,
    part_and_source,
    say_read,
    write_text,
)
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.cell.settings.cell import CellSettings
    from scanmotion.core.part import Part
    from scanmotion.core.read_report import ReadReport
    from scanmotion.core.viewpoint import Viewpoint
    from scanmotion.sensing.holes.find import HoleReport


def inspect(
    file: Annotated[Path, typer.Argument(help="Cloud or mesh of any kind that is read.")],
    units: Annotated[
        str, typer.Option("--units", help="Unit of the file; what it states, else mm unless its size says m.")
    ] = "",
    up: Up = "",
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Write six views of it, .png or .html.", rich_help_panel=OUT),
    ] = None,
    json: Json = False,
) -> int:
    """Say what a file holds: format, size, unit, what was taken for what, and what had to be mended.

    Exit status: 0 it is used as it is, 1 something was changed or is doubtful, 2 it cannot be used.
    """
    check_suffix("--picture", picture, ".png", ".html")
    part = scan_from(file, units, up)
    report = part.report
    assert report is not None
    if picture is not None:
        draw_part(part, picture)
    if json:
        say_json(report.record())
    else:
        print_table(f"What {file.name} holds", (), report_rows(report))
        if picture is not None:
            typer.echo(str(picture))
    return CHECK_FAILED if report.changes or report.warnings else OK


def report_rows(report: "ReadReport") -> list[tuple[str, str]]:
    """Name and value of each line of `scanmotion inspect`."""
    mesh = report.triangles > 0
    rows = [("format", report.format), ("points", str(report.points))]
    rows += (
        [("triangles", str(report.triangles)), ("closed", "yes" if report.closed else "no")] if mesh else []
    )
    rows += [
        ("size", " x ".join(f"{side:.4g}" for side in report.size_mm) + " mm"),
        ("unit", f"{report.units}, {report.units_from}"),
        ("bodies" if mesh else "pieces", str(report.bodies)),
        ("specks left out", str(report.specks)),
    ]
    rows += [("taken", text) for text in report.columns]
    rows += [("changed", text) for text in report.changes]
    return [*rows, *(("note", text) for text in report.warnings)]


def draw_part(part: "Part", path: Path) -> None:
    """Writes six views of a part with its holes, as PNG or as a page that holds the picture."""
    import base64
    import html
    import io

    import numpy as np

    from scanmotion.core.errors import HoleError
    from scanmotion.core.support.whole_file import write_whole
    from scanmotion.report.figures.maps import hole_figure
    from scanmotion.sensing.holes.find import HoleReport

    try:
        report = holes_of(part, "default")
    except HoleError:
        report = HoleReport(holes=(), tiny=(), boundary_mask=np.zeros(len(part.vertices), bool), radius=0.0)
    buffer = io.BytesIO()
    hole_figure(part, report).savefig(buffer, format="png")
    data = buffer.getvalue()
    if path.suffix == ".html":
        assert part.report is not None
        rows = "".join(
            f"<tr><td>{html.escape(k)}</td><td>{html.escape(v)}</td></tr>"
            for k, v in report_rows(part.report)
        )
        image = base64.b64encode(data).decode("ascii")
        name = html.escape(part.name)
        data = (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title></head>'
            f'<body style="font-family:sans-serif"><h1>{name}</h1><table>{rows}</table>'
            f'<img alt="six views" style="max-width:100%" src="data:image/png;base64,{image}">'
            "</body></html>\n"
        ).encode()
    write_whole(path, data)


def holes(
    file: Annotated[Path, typer.Argument(help="Cloud or mesh (PLY, STL, OBJ, PCD, XYZ, ..).")],
    units: Annotated[
        str, typer.Option("--units", help="Unit of the file; what it states, else mm unless its size says m.")
    ] = "",
    up: Up = "",
    mode: Mode = "default",
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write them to a .json file, in the file's units.", rich_help_panel=OUT),
    ] = None,
    show: Annotated[
        bool, typer.Option("--show", help="Write a picture of them (PNG) beside --out.", rich_help_panel=OUT)
    ] = False,
    json: Json = False,
) -> int:
    """Find the holes of a scan: boundary, clusters, size, kind."""
    from scanmotion.sensing.holes.find import hole_report_to_json

    check_mode(mode)
    check_suffix("--out", out, ".json")
    part = scan_from(file, units, up)
    report = holes_of(part, mode)
    say_read(part, quiet=json)
    document = hole_report_to_json(report, part)
    if out is not None:
        write_text(out, dumps(document))
    if json:
        say_json(document)
    else:
        print_table(f"Holes of {file.name}", HOLE_HEADER, hole_rows(report))
    for note in report.notes:
        typer.echo(note, err=True)
    files = [out] if out is not None else []
    if show:
        files.append(draw_holes(part, report, (out or Path(file.name)).with_suffix(".png")))
    if not json:
        for written in files:
            typer.echo(str(written))
    return OK


HOLE_HEADER = ("hole", "kind", "X' mm", "Y' mm", "Z' mm", "perimeter mm", "area mm2")


def hole_rows(report: "HoleReport") -> list[tuple[str, ...]]:
    """A row for each hole, largest first."""
    rows = []
    for number, hole in enumerate(report.holes, start=1):
        sides = [f"{side * 1e3:.1f}" for side in hole.extent]
        around = f"{hole.perimeter * 1e3:.0f}"
        rows.append((f"H{number}", hole.kind, *sides, around, f"{hole.area * 1e6:.0f}"))
    return rows


def dumps(document: object) -> str:
    """JSON text that no reader refuses."""
    import json

    return json.dumps(document, allow_nan=False) + "\n"


def scan_from(file: Path, units: str, up: str) -> "Part":
    """A scan whose unit need not be known: holes are found relative to the spacing of its points."""
    from scanmotion.geometry.parts.make_part import part_from_file

    return part_from_file(file, units=units or None, up=up, guess=True)


def holes_of(part: "Part", mode: str) -> "HoleReport":
    """The hole report of a mesh or a cloud."""
    from scanmotion.sensing.holes.find import holes_from_cloud, holes_from_mesh
    from scanmotion.sensing.holes.paper_clusters import LargestAngle

    by_angle = LargestAngle() if mode == "paper" else None
    if part.is_mesh:
        return holes_from_mesh(part.vertices, part.triangles, by_angle=by_angle, weld=part.report is None)
    return holes_from_cloud(part.vertices, normals=part.normals, by_angle=by_angle)


def draw_holes(part: "Part", report: "HoleReport", path: Path) -> Path:
    """Writes the hole map as PNG."""
    from scanmotion.report.figures.maps import hole_figure

    hole_figure(part, report).savefig(path)
    return path


def viewpoints(
    box: Box = None,
    part: PartFile = None,
    scan: ScanFile = None,
    units: Units = "",
    up: Up = "",
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
    check_suffix("--out", out, ".csv", ".json")
    settings = cell_from(robot, cell)
    subject, source = part_and_source(part, box, scan, units=units, up=up, place=place)
    chosen, dropped = choose_viewpoints(subject, source, settings, mode)
    say_read(subject, quiet=json)
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


def choose_viewpoints(
    subject: "Part", source: str, settings: "CellSettings", mode: str
) -> "tuple[tuple[Viewpoint, ...], tuple[tuple[str, str], ...]]":
    """Viewpoints and (id, reason) of those left out, for a box or mesh (global) or a scan (local)."""
    standoff, scanner = settings.process.standoff_m, settings.scanner_model()
    if source == "scan":
        from scanmotion.views.hole_views import local_viewpoints, paper_local_viewpoints

        over = paper_local_viewpoints if mode == "paper" else local_viewpoints
        return over(holes_of(subject, mode).holes, scanner, standoff=standoff), ()
    from scanmotion.views.stepped_rotary import paper_stepped_rotary, stepped_rotary

    turns = paper_stepped_rotary if mode == "paper" else stepped_rotary
    length, width, height = (float(side) for side in subject.extent)
    pedestal = settings.pedestal.height_m
    step = turns(length, width, height, scanner, standoff=standoff, pedestal=pedestal)
    return step.viewpoints, step.dropped


VIEW_HEADER = ("viewpoint", "step", "kind", "x mm", "y mm", "z mm", "direction", "standoff mm")


def view_row(view: "Viewpoint") -> tuple[str, ...]:
    """A viewpoint as a row of a table."""
    position = [f"{v * 1e3:.1f}" for v in view.p_OS]
    direction = " ".join(f"{v:+.3f}" for v in view.direction)
    return (view.id, view.step, view.kind, *position, direction, f"{view.standoff * 1e3:.0f}")


def view_record(view: "Viewpoint") -> dict[str, object]:
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
