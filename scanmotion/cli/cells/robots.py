"""`scanmotion robots` and `scanmotion robots add`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import OK, print_table, say_json
from scanmotion.cli.inputs import Json, write_text
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.cell.settings.cell import CellSettings

robots_app = typer.Typer(invoke_without_command=True, rich_markup_mode="rich")


def robot_record(name: str, settings: "CellSettings") -> dict[str, str | float]:
    """A built-in cell and the robot in it."""
    from scanmotion.cell.build import robot_facts

    facts = robot_facts()[settings.robot.model]
    return {"name": name} | {key: facts[key] for key in ("title", "reach_m", "payload_kg", "source")}


@robots_app.callback(epilog="Example: scanmotion robots add my.urdf")
def robots(context: typer.Context, json: Json = False) -> int:
    """List the built-in robots and cells, or add one of your own."""
    if context.invoked_subcommand is not None:
        return OK
    from scanmotion.cell.settings.cell import builtin_cells, load_cell

    records = [robot_record(name, load_cell(name)) for name in builtin_cells()]
    if json:
        say_json(records)
        return OK
    rows = [tuple(str(value) for value in record.values()) for record in records]
    print_table("Built-in cells", ("name", "robot", "reach m", "payload kg", "numbers from"), rows)
    return OK


@robots_app.command(epilog="Example: scanmotion robots add my.urdf --packages ../src")
def add(
    urdf: Annotated[Path, typer.Argument(help="URDF of a six-axis arm.")],
    out: Annotated[Path | None, typer.Option(help="YAML to write; default: beside the URDF.")] = None,
    packages: Annotated[
        list[str] | None,
        typer.Option(help="Folder in which package:// is sought; may be given several times."),
    ] = None,
) -> int:
    """Write a cell's YAML for a robot of your own, and check it.

    Finds the chain of six joints, the flange and whether there is a closed form; says what is guessed.
    """
    from scanmotion.cell.build import build_cell, check_room
    from scanmotion.cell.settings.cell import load_cell
    from scanmotion.cell.suggest import suggestion
    from scanmotion.cli.cells.cell_files import check_home

    file = urdf.with_suffix(".yaml") if out is None else out
    if file.exists():
        raise InputError(f"{file}: is there already; name another file with --out")
    if file.resolve().parent != urdf.resolve().parent:
        raise InputError(f"{file}: the YAML has to lie beside the URDF")
    found = suggestion(urdf, tuple(packages or ()))
    write_text(file, found.yaml)
    for line in found.told:
        typer.echo(line)
    cell = build_cell(load_cell(file))
    check_room(cell)
    check_home(cell)
    typer.echo(f"{file}: ready\nNext: scanmotion plan --cell {file} --box 330 200 600")
    return OK
