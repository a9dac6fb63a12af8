"""`scanmotion paper`: the paper's experiments as one page."""

from pathlib import Path
from typing import Annotated

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


def paper(
    robot: Robot = None,
    cell: CellFile = None,
    part: PartFile = None,
    units: Units = "mm",
    up: Up = "",
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=20, help="Seeds 0..N-1 of table 3.")] = 1,
    out: Annotated[
        Path,
        typer.Option("--out", help="The page; its figures stand as .json beside it.", rich_help_panel=OUT),
    ] = Path("paper.html"),
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Repeat the paper's experiments in the twin: table 3, figures 9 to 13 and 16 to 20, tour and budgets.

    Without --part on the built-in carving. Five plans are made for each seed: some minutes.
    """
    check_suffix("--out", out, ".html")
    settings = cell_from(robot, cell)
    subject, _ = part_and_source(part, None, None, units=units, up=up)
    import json as files

    from scanmotion.report.paper import budgets_kept, paper_experiments, paper_html, paper_record

    with progress_bar(quiet=quiet or json) as progress:
        found = paper_experiments(subject, settings, seeds=range(seeds), progress=progress)
    record = paper_record(found)
    write_text(out, paper_html(found))
    write_text(out.with_suffix(".json"), files.dumps(record, indent=1, allow_nan=False) + "\n")
    if json:
        say_json(record)
    elif not quiet:
        before, after = found.tour.at_random * 1e3, found.tour.optimised * 1e3
        rows = [
            (
                "tour over the local viewpoints",
                f"{before:.1f} -> {after:.1f} mm",
            ),
            ("the paper's", "763.9 -> 585.7 mm"),
            *(
                (f"budget of {limit:g} s ({name})", f"{ours:.1f} s, {'kept' if kept else 'NOT kept'}")
                for name, limit, ours, kept in budgets_kept(found)
            ),
            ("page", str(out)),
        ]
        print_table("The paper's experiments", (), rows)
    return OK
