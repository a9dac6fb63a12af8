"""`scanmotion plan`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, Progress, progress_bar, say_json
from scanmotion.cli.inputs import (  # fmt: skip
    CELL,
    OUT,
    Box,
    CellFile,
    Json,
    PartFile,
    Place,
    Quiet,
    Robot,
    ScanFile,
    Seed,
    Threads,
    Units,
    Up,
    cell_from,
    check_known,
    check_mode,
    check_out_folder,
    meta_from,
    part_and_source,
    say_read,
)
from scanmotion.cli.plans.complete import is_complete, say_answer, write_answer
from scanmotion.cli.plans.explaining import say_explained
from scanmotion.cli.plans.pages import pages
from scanmotion.cli.plans.placing import New, own_views_from, placing_from, plan_placed, say_placed
from scanmotion.cli.plans.summarising import print_summary
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.cell.settings.cell import CellSettings
    from scanmotion.core.summary import Summary
    from scanmotion.planning.options import PlanOptions
    from scanmotion.planning.plan import Plan

AGAIN = "Planning again"
TWIN = "The scan twin"
MOTIONS = ("stops", "continuous", "auto")
STRATEGIES = ("two-step", "cad-slicing", "surface-partitioning")


def plan(
    robot: Robot = None,
    cell: CellFile = None,
    part: PartFile = None,
    box: Box = None,
    scan: ScanFile = None,
    units: Units = "",
    up: Up = "",
    place: Place = "",
    budget: Annotated[
        float | None,
        typer.Option("--budget", help="Seconds that the programme may take.", rich_help_panel=CELL),
    ] = None,
    strategy: Annotated[str, typer.Option("--strategy", help=", ".join(STRATEGIES) + ".")] = "two-step",
    mode: Annotated[
        str, typer.Option("--mode", help="default, or paper: the published formulas literally.")
    ] = "default",
    viewpoints: Annotated[
        Path | None,
        typer.Option(
            "--viewpoints",
            help="Your own viewpoints (CSV or JSON) in place of the method's; no local step follows.",
        ),
    ] = None,
    order: Annotated[
        str, typer.Option("--order", help="With --viewpoints: fastest, or given: as the file has them.")
    ] = "fastest",
    seed: Seed = 0,
    helix: Annotated[
        bool,
        typer.Option(
            "--helix",
            help="The arm may go on from turn to turn of the global step while the table turns, where the "
            "twin sees as much and seconds are saved.",
        ),
    ] = False,
    motion: Annotated[
        str,
        typer.Option(
            "--motion",
            help="stops: turns and stops, each from rest to rest. continuous: arm and table move at once, "
            "the scanner always on, chosen on the part's mesh; with --budget, as much as can be seen in it. "
            "auto: both are planned, and the one that sees no less in fewer seconds is kept.",
        ),
    ] = "stops",
    completeness: Annotated[
        float | None,
        typer.Option(
            "--completeness",
            help="With --motion continuous or auto: this share of what can be seen, 0..1, in the least "
            "seconds.",
        ),
    ] = None,
    placements: Annotated[
        str,
        typer.Option(
            "--placements",
            help="1; a number; auto; or which axis of the part is up in each further placement, e.g. +y,-z.",
        ),
    ] = "1",
    forbid: Annotated[
        str,
        typer.Option("--forbid", help="With --placements: sides that must not lie down, e.g. -z,+x."),
    ] = "",
    keep: Annotated[
        Path | None,
        typer.Option(
            "--keep",
            help="An earlier plan: what was executed stays, the rest is planned anew.",
            rich_help_panel=AGAIN,
        ),
    ] = None,
    done: Annotated[
        str,
        typer.Option(
            "--done",
            help="With --keep: the last viewpoint, or operation by number, that was executed.",
            rich_help_panel=AGAIN,
        ),
    ] = "",
    failed: Annotated[
        list[str] | None,
        typer.Option(
            "--failed", help="With --keep: a viewpoint to leave out; may be repeated.", rich_help_panel=AGAIN
        ),
    ] = None,
    thorough: Annotated[
        bool,
        typer.Option("--thorough", help="Fill the budget: follow slivers too."),
    ] = False,
    tidy: Annotated[
        bool,
        typer.Option(
            "--tidy/--no-tidy",
            help="Leave out what the twin shows to be worth less than its seconds.",
        ),
    ] = True,
    calibrate: Annotated[
        bool | None,
        typer.Option(
            "--calibrate/--no-calibrate",
            help="Estimate hand-eye and table axis from the scans; default: where the cell's twin has "
            "constant errors.",
            rich_help_panel=TWIN,
        ),
    ] = None,
    surface: Annotated[
        bool,
        typer.Option("--surface", help="Assess the reconstructed surface too.", rich_help_panel=TWIN),
    ] = False,
    save_scans: Annotated[
        bool,
        typer.Option(
            "--save-scans",
            help="Write cloud.ply, deviation.ply and the range images of each round.",
            rich_help_panel=TWIN,
        ),
    ] = False,
    out: Annotated[Path, typer.Option("--out", help="Folder of the plan.", rich_help_panel=OUT)] = Path(
        "out"
    ),
    html: Annotated[
        bool,
        typer.Option("--html/--no-html", help="Write scene.html and report.html.", rich_help_panel=OUT),
    ] = True,
    meta: Annotated[
        list[str] | None,
        typer.Option(
            "--meta",
            help="key=value for the report's sheet: object, operator, date, notes, or a word of your own; "
            "may be repeated.",
            rich_help_panel=OUT,
        ),
    ] = None,
    threads: Threads = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Say which stage lost which viewpoints: candidates, reach, order, way there, worth, budget.",
            rich_help_panel=OUT,
        ),
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Plan a scan: viewpoints, order, motion, checks and files.

    Without --part, --box or --scan the built-in carving is planned.

    With --keep an interrupted plan is taken up again: what was executed stays, the rest is planned anew.
    """
    check_mode(mode)
    check_known("--strategy", strategy, STRATEGIES)
    check_known("--motion", motion, MOTIONS)
    check_out_folder(out)
    placing = placing_from(placements, forbid)
    only_with_keep(keep, done, failed, part=part, box=box, scan=scan, robot=robot, cell=cell)
    own = own_views_from(viewpoints, order, placements=placements, keep=keep, motion=motion)
    subject = None
    check_budget(budget)
    noted = meta_from(meta or ())
    from scanmotion.planning.options import PlanOptions

    options = PlanOptions(calibrate=calibrate, surface=surface, keep_scans=save_scans, helix=helix)
    if keep is not None:
        request = Again(folder=keep, done=done, failed=tuple(failed or ()), budget=budget, options=options)
    else:
        settings = with_budget(cell_from(robot, cell), budget)
        subject, source = part_and_source(part, box, scan, units=units, up=up, place=place)
        words = {"source": source, "mode": mode, "strategy": strategy, "seed": seed}
        fill = budget is not None and completeness is None
        options = replace(
            options, thorough=thorough, tidy=tidy, motion=motion, completeness=completeness, fill=fill,
            **words,
        )  # fmt: skip
        request = New(part=subject, settings=settings, options=options, own=own)
    if placing is not None:
        if not isinstance(request, New):
            raise InputError("--placements: not together with --keep; take up one placement's folder")
        if noted:
            raise InputError("--meta: not together with --placements; note it on one placement's plan")
        with progress_bar(quiet=quiet or json) as progress:
            plan_placed(request, placing, out=out, html=html, progress=progress)
        return say_placed(out, quiet=quiet, json=json)
    with progress_bar(quiet=quiet or json) as progress:
        made = request.planned(progress)
        made = replace(made, meta={**made.meta, **noted})
        told = say_explained(made, json=json) if explain else {}
        if is_complete(made):
            write_answer(made, out, html=html)
        else:
            made.save(out, pages=partial(pages, progress=progress) if html else None)
    if subject is not None:
        say_read(subject, quiet=quiet or json)
    if is_complete(made):
        say_answer(made, out, html=html, quiet=quiet, json=json)
        return OK
    summary = read_summary(out)
    if json:
        say_json(summary.document() | told)
    elif not quiet:
        print_summary(summary, out, html=html)
    return OK if summary.passes else CHECK_FAILED


@dataclass(frozen=True, eq=False, kw_only=True)
class Again:
    """What an earlier plan has not executed, planned anew behind what it has."""

    folder: Path
    done: str
    failed: tuple[str, ...]
    budget: float | None
    """[s]; None for that of the earlier plan."""
    options: "PlanOptions"

    def planned(self, progress: Progress) -> "Plan":
        """The plan."""
        from scanmotion.plan_io.load import load_plan
        from scanmotion.planning.replan import replan

        old = load_plan(self.folder)
        made = replan(
            old, done=self.done, failed=self.failed, budget_s=self.budget, options=self.options,
            progress=progress,
        )  # fmt: skip
        return replace(made, meta=old.meta)


def only_with_keep(keep: Path | None, done: str, failed: Sequence[str] | None, **given: object) -> None:
    """Refuses options that contradict --keep, or need it.

    Raises:
        InputError: with the option.
    """
    if keep is None and (done or failed):
        raise InputError(f"--{'done' if done else 'failed'}: only together with --keep")
    wrong = [name for name, value in given.items() if value is not None]
    if keep is not None and wrong:
        raise InputError(f"--{wrong[0]}: the plan that --keep names has it already")


def with_budget(settings: "CellSettings", budget: float | None) -> "CellSettings":
    """The settings with another budget [s]."""
    if budget is None:
        return settings
    process = settings.process.model_copy(update={"budget_s": budget})
    return settings.model_copy(update={"process": process})


def check_budget(budget: float | None) -> None:
    """Refuses a budget that is no time.

    Raises:
        InputError: it is not a positive number.
    """
    if budget is not None and not 0.0 < budget < 1e6:
        raise InputError(f"--budget {budget:g}: must be a positive number of seconds")


def read_summary(folder: Path) -> "Summary":
    """summary.json of a plan folder."""
    from scanmotion.plan_io.read import read_summary

    return read_summary(folder)
