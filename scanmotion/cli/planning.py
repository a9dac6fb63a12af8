"""`scanmotion plan`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, print_table, progress_bar, say_json
from scanmotion.cli.complete import is_complete, say_answer, write_answer
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
    Units,
    Up,
    cell_from,
    check_known,
    check_mode,
    check_out_folder,
    part_and_source,
    say_read,
)
from scanmotion.core.errors import InputError

AGAIN = "Planning again"
TWIN = "The scan twin"
FEW = 3
MOTIONS = ("stops", "continuous")
STRATEGIES = ("two-step", "cad-slicing", "surface-partitioning")


def plan(
    robot: Robot = None,
    cell: CellFile = None,
    part: PartFile = None,
    box: Box = None,
    scan: ScanFile = None,
    units: Units = "",
    up: Up = "+z",
    place: Place = "",
    budget: Annotated[
        float | None,
        typer.Option("--budget", help="Seconds that the programme may take.", rich_help_panel=CELL),
    ] = None,
    strategy: Annotated[str, typer.Option("--strategy", help=", ".join(STRATEGIES) + ".")] = "two-step",
    mode: Annotated[
        str, typer.Option("--mode", help="default, or paper: the published formulas literally.")
    ] = "default",
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
            "the scanner always on, chosen on the part's mesh; with --budget, as much as can be seen in it.",
        ),
    ] = "stops",
    completeness: Annotated[
        float | None,
        typer.Option(
            "--completeness",
            help="With --motion continuous: this share of what can be seen, 0..1, in the least seconds.",
        ),
    ] = None,
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
    only_with_keep(keep, done, failed, part=part, box=box, scan=scan, robot=robot, cell=cell)
    settings = subject = source = answer = None
    twin = {"calibrate": calibrate, "surface": surface, "keep_scans": save_scans, "helix": helix}
    if keep is None:
        settings = with_budget(cell_from(robot, cell), budget)
        subject, source = part_and_source(part, box, scan, units=units, up=up, place=place)
    with progress_bar(quiet=quiet or json) as progress:
        if keep is not None:
            made = planned_again(keep, done, failed or (), budget, progress, **twin)
        else:
            told = {"source": source, "mode": mode, "strategy": strategy, "seed": seed}
            told |= {"thorough": thorough, "tidy": tidy, "motion": motion, "completeness": completeness}
            told |= {"fill": budget is not None and completeness is None}
            made = planned(subject, settings, progress, **told, **twin)
        if is_complete(made):
            answer = write_answer(made, out, html=html)
        else:
            made.save(out, extras=pages(made, progress) if html else {})
    if subject is not None:
        say_read(subject, quiet=quiet or json)
    if answer is not None:
        say_answer(answer, out, html=html, quiet=quiet, json=json)
        return OK
    summary = read_summary(out)
    if json:
        say_json(summary)
    elif not quiet:
        print_summary(summary, out, html=html)
    return OK if passes(summary) else CHECK_FAILED


def planned(subject: Any, settings: Any, progress: Any, **options: Any) -> Any:
    """A new plan."""
    from scanmotion.planning.pipeline import PlanOptions, plan

    return plan(subject, settings, options=PlanOptions(**options), progress=progress)


def planned_again(
    keep: Any, done: str, failed: Sequence[str], budget: float | None, progress: Any, **options: Any
) -> Any:
    """What an earlier plan has not executed, planned anew behind what it has."""
    from scanmotion.planning.pipeline import PlanOptions
    from scanmotion.planning.replan import replan

    check_budget(budget)
    told = PlanOptions(**options)
    return replan(keep, done=done, failed=failed, budget_s=budget, options=told, progress=progress)


def only_with_keep(keep: Path | None, done: str, failed: Sequence[str] | None, **given: Any) -> None:
    """Refuses options that contradict --keep, or need it.

    Raises:
        InputError: with the option.
    """
    if keep is None and (done or failed):
        raise InputError(f"--{'done' if done else 'failed'}: only together with --keep")
    wrong = [name for name, value in given.items() if value is not None]
    if keep is not None and wrong:
        raise InputError(f"--{wrong[0]}: the plan that --keep names has it already")


def pages(made: Any, progress: Any) -> dict[str, str]:
    """The two HTML files that go with a plan."""
    from scanmotion.report.page import report_html
    from scanmotion.report.scene import scene_html

    progress("scene", 0.0)
    scene = scene_html(made)
    progress("report", 0.5)
    return {"scene.html": scene, "report.html": report_html(made)}


def with_budget(settings: Any, budget: float | None) -> Any:
    """The settings with another budget [s].

    Raises:
        InputError: the budget is not a positive number.
    """
    if budget is None:
        return settings
    check_budget(budget)
    process = settings.process.model_copy(update={"budget_s": budget})
    return settings.model_copy(update={"process": process})


def check_budget(budget: float | None) -> None:
    """Refuses a budget that is no time.

    Raises:
        InputError: it is not a positive number.
    """
    if budget is not None and not 0.0 < budget < 1e6:
        raise InputError(f"--budget {budget:g}: must be a positive number of seconds")


def read_summary(folder: Path) -> dict[str, Any]:
    """summary.json of a plan folder."""
    import json

    return json.loads((folder / "summary.json").read_text())


def passes(summary: dict[str, Any]) -> bool:
    """Whether the plan is inside its budget and the judge found nothing."""
    return bool(summary["budget"]["ok"]) and not summary["findings"]


def print_summary(summary: dict[str, Any], folder: Path, *, html: bool = True) -> None:
    """The table that ends `scanmotion plan`."""
    print_table("The plan", (), summary_rows(summary))
    unreachable = summary["viewpoints"]["unreachable"]
    if unreachable:
        print_table("Viewpoints left out", ("viewpoint", "reason"), left_out_rows(unreachable))
    if summary["budget"].get("advice"):
        print_table("Over the budget", ("what would help",), [(a,) for a in summary["budget"]["advice"]])
    if summary["findings"]:
        rows = [(finding_line(f),) for f in summary["findings"]]
        print_table("The judge found", ("finding",), rows)
    names = ["trajectory.csv", "summary.json"] + (["scene.html", "report.html"] if html else [])
    names += [name for name in ("cloud.ply", "deviation.ply") if (folder / name).is_file()]
    print_table("Files", (), [(name.split(".")[0], str(folder / name)) for name in names])


def left_out_rows(unreachable: Sequence[dict[str, str]]) -> list[tuple[str, str]]:
    """Viewpoints and reasons; many that are only not worth their seconds share a line."""
    dear = [u for u in unreachable if u["reason"].startswith("not worth its seconds")]
    if len(dear) <= FEW:
        return [(u["id"], u["reason"]) for u in unreachable]
    rows = [(u["id"], u["reason"]) for u in unreachable if u not in dear]
    return [*rows, (f"{len(dear)} others", "not worth their seconds; summary.json lists them")]


def finding_line(finding: Any) -> str:
    """A finding as one line, whether it is a sentence or a record."""
    if isinstance(finding, dict):
        return finding.get("message") or ", ".join(f"{k} {v}" for k, v in finding.items())
    return str(finding)


def summary_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each line of the final table."""
    views, done, exact = summary["viewpoints"], summary["completeness"], summary["accuracy"]
    time, budget = summary["time_s"], summary["budget"]

    def share(value: float | None) -> str:
        return "not known" if value is None else f"{value:.2%}"

    def mm(value: float | None) -> str:
        return "not known" if value is None else f"{value:.3f} mm"

    split = ", ".join(f"{name} {time[name]:.1f}" for name in ("arm", "table", "sweep", "dwell"))
    verdict, limit = ("inside" if budget["ok"] else "OVER"), budget["limit_s"]
    return [
        (
            "viewpoints",
            f"{views['global']} global, {views['local']} local, {len(views['unreachable'])} left out",
        ),
        ("completeness, of what can be seen", share(done["final"])),
        *sure_rows(summary),
        ("after the global step", share(done["after_global"])),
        *reach_rows(summary),
        ("of the whole surface", share(done["final_of_whole"])),
        ("accuracy", f"mean {mm(exact['mean_abs_mm'])}, standard deviation {mm(exact['sd_signed_mm'])}"),
        *twin_rows(summary),
        ("time", f"{time['total']:.1f} s, {verdict} the budget of {limit:g} s (floor {time['floor']:.1f} s)"),
        ("of which [s]", split),
        *([("helix", summary["helix"]["note"])] if "helix" in summary else []),
        *([("motion", summary["motion"]["note"])] if "motion" in summary else []),
        ("checks", counted(len(summary["findings"]))),
        ("planned in", f"{summary['planning_s']['total']:.1f} s"),
    ]  # fmt: skip


def sure_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Line of the final table on how sure the prediction is, where that is known."""
    found = summary.get("confidence")
    return [] if found is None else [("how sure", found["statement"])]


def reach_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Line of the final table on what this robot's scanner can be brought to see, where that is known."""
    found = summary.get("within_reach") or {}
    if found.get("scanned") is None:
        return []
    return [
        ("of what this robot can reach", f"{found['scanned']:.2%} ({found['share']:.2%} is within reach)")
    ]


def counted(findings: int) -> str:
    """How many findings, in words."""
    return "no finding" if not findings else "1 finding" if findings == 1 else f"{findings} findings"


def twin_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Lines of the final table on the surface, calibration and registration, where there are any."""
    rows, made, found = [], summary["accuracy"].get("surface"), summary.get("calibration")
    if made is not None:
        sd = made["sd_signed_mm"]
        rows.append(("of the surface", f"mean {made['mean_abs_mm']:.3f} mm, standard deviation {sd:.3f} mm"))
    if found is not None:
        before, after = (found["global_cloud"][k]["mean_abs_mm"] for k in ("before", "after"))
        bought = f"the global scan's mean from {before:.3f} to {after:.3f} mm"
        rows.append(("calibration", bought if found["applied"] else found["statement"]))
    for item in summary.get("registration", []):
        rows.append((f"round {item['round']} on the cloud", item["statement"]))
    return rows
