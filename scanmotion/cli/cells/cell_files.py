"""`scanmotion cell init`, `scanmotion cell check` and `scanmotion cell show`."""

from math import degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import OK, print_table
from scanmotion.cli.inputs import Box, PartFile, Robot, Units, Up, check_suffix, write_text
from scanmotion.core.errors import CellError, InputError

if TYPE_CHECKING:
    from scanmotion.cell.model import Cell

cell_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    help="Start, check or look at a description of your own cell.",
)


@cell_app.command(epilog="Example: scanmotion cell init my-cell.yaml")
def init(
    file: Annotated[Path, typer.Argument(help="YAML file to write.")] = Path("cell.yaml"),
    robot: Robot = None,
) -> int:
    """Write a commented YAML to start from."""
    from scanmotion.cell.settings.cell import cell_template

    if file.exists():
        raise InputError(f"{file}: is there already; name another file")
    if not file.resolve().parent.is_dir():
        raise InputError(f"{file}: the folder {file.parent} does not exist")
    write_text(file, cell_template(robot or "kr240"))
    typer.echo(f"{file}\nNext: scanmotion cell check {file}")
    return OK


@cell_app.command(epilog="Example: scanmotion cell check my-cell.yaml")
def check(file: Annotated[Path, typer.Argument(help="YAML file of a cell.")]) -> int:
    """Say what is wrong with a cell, or what it holds."""
    from scanmotion.cell.build import build_cell, check_room
    from scanmotion.cli.inputs import cell_from

    cell = build_cell(cell_from(None, file))
    check_room(cell)
    check_home(cell)
    ranges = zip(cell.joint_names, cell.q_min, cell.q_max, cell.v_max, strict=True)
    rows = [
        (
            name,
            f"{degrees(low):.1f} .. {degrees(high):.1f} deg" if isfinite(high - low) else "endless",
            f"{degrees(speed):.0f} deg/s",
        )
        for name, low, high, speed in ranges
    ]
    print_table(f"{file}: ready", ("joint", "range", "speed"), rows)
    return OK


@cell_app.command("show", epilog="Example: scanmotion cell show my-cell.yaml --out cell.html")
def show_cell(
    file: Annotated[
        str, typer.Argument(help="YAML file of a cell, or the name of a built-in robot.")
    ] = "kr240",
    box: Box = None,
    part: PartFile = None,
    units: Units = "",
    up: Up = "",
    out: Annotated[Path, typer.Option("--out", help="Page to write.")] = Path("cell.html"),
) -> int:
    """Draw a cell at rest, before anything is planned; without --part or --box with the built-in carving."""
    from scanmotion.cell.build import build_cell
    from scanmotion.cli.inputs import cell_from, part_and_source
    from scanmotion.report.scene import cell_page

    named = not file.lower().endswith((".yaml", ".yml"))
    settings = cell_from(file if named else None, None if named else Path(file))
    check_suffix("--out", out, ".html")
    subject, _ = part_and_source(part, box, None, units=units, up=up)
    write_text(out, cell_page(build_cell(settings, subject), subject))
    typer.echo(f"{out}\nNext: scanmotion plan {'--robot' if named else '--cell'} {file} --out out")
    return OK


def check_home(cell: "Cell") -> None:
    """Refuses a rest in which the robot would touch something, or come nearer than the clearance.

    Raises:
        CellError: with the two solids.
    """
    from scanmotion.cell.collision.clearance import Clearance

    checker = Clearance(cell)
    distance, pair = checker.distance(cell.home)
    if distance < checker.asked(pair):
        told = "touch" if distance <= 0 else f"come within {distance * 1e3:.0f} mm"
        raise CellError(
            f"at rest {pair[0]} and {pair[1]} {told}, {checker.asked(pair) * 1e3:.0f} mm are asked for",
            key="robot.home_deg",
        )
