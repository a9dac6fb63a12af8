"""`scanmotion compare`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import (  # fmt: skip
    OUT,
    CellFile,
    Json,
    PartFile,
    Quiet,
    Robot,
    Units,
    Up,
    cell_from,
    check_suffix,
    part_and_source,
    write_text,
)

if TYPE_CHECKING:
    from scanmotion.planning.worth.comparison import Row


def compare(
    robot: Robot = None,
    cell: CellFile = None,
    part: PartFile = None,
    units: Units = "",
    up: Up = "",
    variant: Annotated[
        list[str] | None,
        typer.Option(
            "--variants", "--variant",
            help="Rows of the table: two-step, as-found, thorough, paper-mode, cad-slicing, "
            "surface-partitioning, without-occlusion, without-feedback, turntable-fallback; "
            "separated by commas, or repeated. Default: all.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=100, help="Seeds 0..N-1 for each.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Writes the table as .md, and as .json beside it.", rich_help_panel=OUT),
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:  # fmt: skip
    """Compare scanning methods on one part: completeness, accuracy, time (table 3 of the paper)."""
    check_suffix("--out", out, ".md", ".json")
    settings = cell_from(robot, cell)
    from scanmotion.planning.worth import comparison

    asked = [name.strip() for text in variant or () for name in text.split(",")]
    asked = list(dict.fromkeys(asked)) if variant else list(comparison.VARIANTS)
    comparison.check_variants(asked)
    subject, _ = part_and_source(part, None, None, units=units, up=up)
    with progress_bar(quiet=quiet or json) as progress:
        rows = comparison.compare(subject, settings, variants=asked, seeds=range(seeds), progress=progress)
    if out is not None:
        _write(out, subject.name, rows)
    if json:
        say_json(comparison.document(subject.name, rows))
    elif not quiet:
        table = [comparison.cells(row) for row in rows]
        print_table(f"Methods compared on {subject.name}", comparison.HEADER, table)
    return OK


def _write(out: Path, name: str, rows: Sequence["Row"]) -> None:
    """Both forms of the table, whichever of the two was named."""
    import json

    from scanmotion.planning.worth.comparison import document, markdown

    write_text(out.with_suffix(".md"), markdown(rows))
    write_text(out.with_suffix(".json"), json.dumps(document(name, rows), indent=1, allow_nan=False) + "\n")
