"""`scanmotion study` and `scanmotion layout`: many plans at once."""

from pathlib import Path
from typing import Annotated

import typer
from typer.core import TyperGroup

from scanmotion.cli.app import OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import Json, Quiet, Robot, check_suffix, write_text


class _StudyCommands(TyperGroup):
    """`scanmotion study FILE` means `scanmotion study run FILE`."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


study_app = typer.Typer(
    cls=_StudyCommands, no_args_is_help=True, help="Many plans at once: cells, robots, parts, methods, seeds."
)

Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", help="Address of a Dask scheduler, e.g. tcp://127.0.0.1:8786.", show_default=False
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers", min=1, help="Workers on this machine; default: one a core.", show_default=False
    ),
]
Keep = Annotated[Path | None, typer.Option("--keep-plans", help="Keeps the plans' folders in this one.")]


@study_app.command("run", epilog="Example: scanmotion study study.yaml --table study.sqlite")
def run(
    study: Annotated[Path, typer.Argument(help="YAML of the study.", show_default=False)],
    table: Annotated[Path, typer.Option("--table", help="File of the results.")] = Path("study.sqlite"),
    scheduler: Scheduler = None,
    workers: Workers = None,
    keep_plans: Keep = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Run the cases of a study that have no result yet."""
    check_suffix("--table", table, ".sqlite", ".db")
    from scanmotion.studies import run as runner

    options = runner.StudyOptions(table=table, scheduler=scheduler, workers=workers, keep_in=keep_plans)
    with progress_bar(quiet=quiet or json) as progress:
        result = runner.study(study, options=options, progress=progress)
    if json:
        record = {"table": str(table), "cases": result.cases, "new": result.new, "ok": result.ok}
        say_json(record)
    elif not quiet:
        typer.echo(f"{result.cases} cases, {result.new} of them new, {result.ok} with figures: {table}")
        typer.echo(f"next: scanmotion study report {table}")
    return OK


@study_app.command("report", epilog="Example: scanmotion study report study.sqlite --out study.html")
def report(
    table: Annotated[Path, typer.Argument(help="Table that `study run` wrote.", show_default=False)],
    out: Annotated[Path | None, typer.Option("--out", help="The page; default: beside the table.")] = None,
    cell: Annotated[Path | None, typer.Option("--best-cell", help="Writes the first cell's YAML.")] = None,
    quiet: Quiet = False,
) -> int:
    """Make one page of a study: heat maps, seconds against completeness, ranking."""
    page = out or table.with_suffix(".html")
    check_suffix("--out", page, ".html")
    check_suffix("--best-cell", cell, ".yaml")
    from scanmotion.studies import table as tables
    from scanmotion.studies.report import best_cell, ranking, study_html

    write_text(page, study_html(table))
    if cell is not None:
        with tables.opened(table) as connection:
            write_text(cell, best_cell(ranking(tables.records(connection))))
    if not quiet:
        typer.echo(f"report: {page}")
    return OK


def layout(
    part: Annotated[str, typer.Option("--part", help="Mesh of the part, or carving.")] = "carving",
    robot: Robot = None,
    out: Annotated[Path, typer.Option("--out", help="The best cell's YAML.")] = Path("layout.yaml"),
    completeness: Annotated[float, typer.Option("--completeness", help="Share of what can be seen.")] = 0.995,
    plans: Annotated[int, typer.Option("--plans", min=1, help="Plans that the search may make.")] = 32,
    table: Annotated[Path | None, typer.Option("--table", help="Results; default: beside --out.")] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Search base distance, table height and fixture tilt for the least seconds."""
    check_suffix("--out", out, ".yaml")
    import yaml

    from scanmotion.studies import layout as search
    from scanmotion.studies.run import StudyOptions

    where = search.layout_table(table, out)
    with progress_bar(quiet=quiet or json) as progress:
        found = search.layout_search(
            robot or "kr240",
            part if part == "carving" else {"file": str(Path(part).resolve())},
            study_options=StudyOptions(table=where, scheduler=scheduler, workers=workers),
            options=search.LayoutOptions(completeness=completeness, plans=plans),
            progress=progress,
        )
    write_text(out, yaml.safe_dump(found.best.settings, sort_keys=False, allow_unicode=True))
    both = {"present": found.present, "best": found.best}
    if json:
        say_json({"out": str(out), "tried": found.tried} | {k: _record(v) for k, v in both.items()})
    elif not quiet:
        rows = [(name, *map(str, _record(item).values())) for name, item in both.items()]
        print_table("Layout", ("", *_record(found.best)), rows)
        typer.echo(f"the best cell of {found.tried}: {out}")
    return OK


def _record(item: object) -> dict[str, object]:
    from scanmotion.studies.layout import Tried

    assert isinstance(item, Tried)
    values = {name: round(value, 4) for name, value in item.values.items()}
    return {**values, "completeness": item.completeness, "seconds": item.seconds}
