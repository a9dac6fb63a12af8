"""`scanmotion verify`, `show` and `export`: what is done with a plan's folder."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import OUT, Json, Quiet, write_text
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.planning.plan import Plan

Folder = Annotated[Path, typer.Argument(help="Folder that `scanmotion plan` wrote.")]


def verify(
    folder: Annotated[Path, typer.Argument(help="A plan's folder, or the main file of a programme (.src).")],
    plan: Annotated[
        Path | None,
        typer.Option("--plan", help="The plan that a programme was made from; by default the file's folder."),
    ] = None,
    margins: Annotated[
        bool,
        typer.Option("--margins", help="Tell too what is to spare: distances, joints, speeds."),
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Judge a plan again from its files alone, or an exported programme by running it: limits, clearance,
    speeds, viewpoints, order, handshake.
    """
    if folder.is_file():
        if margins:
            raise InputError("--margins: of a plan's folder, not of a programme's file")
        return _verify_programme(folder, plan, quiet=quiet, json=json)
    if plan is not None:
        raise InputError("--plan: belongs to a programme's file, not to a plan's folder")
    from scanmotion.judge import margins_of
    from scanmotion.judge import verify as judge
    from scanmotion.judge.left_out import not_judged
    from scanmotion.report.words import margin_rows

    with progress_bar(quiet=quiet or json):
        findings = judge(folder)
        spare = margins_of(folder) if margins else None
    if json:
        told = {"ok": not findings, "findings": [str(f) for f in findings]}
        told |= {} if spare is None else {"margins": spare.model_dump(mode="json")}
        say_json(told | {"not_judged": not_judged(folder)})
    elif not quiet:
        _say_findings([str(f) for f in findings])
        if spare is not None:
            print_table("To spare", ("", "least or greatest", "where", "at"), margin_rows(spare))
        rows = [(pair["a"], pair["b"], pair["reason"]) for pair in not_judged(folder)]
        print_table("Pairs that are not judged", ("", "", "reason"), rows)
    return CHECK_FAILED if findings else OK


def _say_findings(findings: list[str]) -> None:
    if findings:
        print_table("The judge found", ("finding",), [(f,) for f in findings])
    else:
        typer.echo("no finding")


def _verify_programme(file: Path, plan: Path | None, *, quiet: bool, json: bool) -> int:
    from scanmotion.judge.programme.check import summary_of, verify_programme

    with progress_bar(quiet=quiet or json) as progress:
        report = verify_programme(file, plan, progress=lambda share: progress("clearance", share))
    told = summary_of(report)
    if json:
        say_json(told)
    elif not quiet:
        head = ("step", "kind", "seconds", "planned", "off the path, deg", "mm")
        rows = [
            (
                str(d.step),
                d.kind,
                f"{d.seconds:.2f}",
                f"{d.planned_s:.2f}",
                f"{d.away_deg:.4f}",
                f"{d.away_mm:.2f}",
            )
            for d in report.deviations
        ]
        print_table("The programme against the plan", head, rows)
        typer.echo(f"{report.seconds:.2f} s, planned {report.planned_s:.2f} s, {report.frames} frames")
        _say_findings(told["findings"])
    return CHECK_FAILED if report.findings else OK


def show(
    folder: Folder,
    live: Annotated[bool, typer.Option("--live", help="Serve the scene on localhost until Ctrl-C.")] = False,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the scene in the web browser.")
    ] = True,
    quiet: Quiet = False,
) -> int:
    """Write scene.html and report.html of a plan again and open the scene."""
    from scanmotion.cli.plans.pages import pages
    from scanmotion.plan_io.load import load_plan

    plan = load_plan(folder)
    if live:
        return _serve(plan, browser=browser)
    with progress_bar(quiet=quiet) as progress:
        for name, text in pages(plan, progress=progress).items():
            write_text(folder / name, text)
            if not quiet:
                typer.echo(str(folder / name))
    if browser:
        _open((folder / "scene.html").resolve().as_uri())
    return OK


def _serve(plan: "Plan", *, browser: bool) -> int:
    from threading import Event

    from scanmotion.report.scene import live_scene

    scene = live_scene(plan)
    typer.echo(f"{scene.web_url()} (Ctrl-C ends)")
    if browser:
        _open(scene.web_url())
    try:
        Event().wait()
    except KeyboardInterrupt:
        return OK
    return OK


def _open(address: str) -> None:
    import webbrowser

    webbrowser.open(address)


def _rest_folder(folder: Path, out: Path | None, step: int | None, at: str | None) -> Path:
    """Writes the plan of what is left to the folder of --out, and names it."""
    import numpy as np

    from scanmotion.controller.log import EXECUTED, read_executed
    from scanmotion.plan_io.files import atomic_folder
    from scanmotion.plan_io.resume import rest_files

    if out is None or out.resolve() == folder.resolve():
        raise InputError("--rest and --step write a plan of their own: name a folder for it (--out)")
    known = read_executed(folder) if step is None or (folder / EXECUTED).exists() else None
    if known is not None and known.ended and step is None:
        raise InputError(
            f"{folder}: the last run came to its end; nothing is left (--step N for a part of it)"
        )
    first = step if step is not None else (known.completed if known is not None else 0) + 1
    stands = None if known is None else np.array(known.q_deg)
    if at is not None:
        try:
            stands = np.array([float(x) for x in at.split(",")])
        except ValueError:
            stands = np.zeros(0)
        if stands.shape != (7,) or not np.isfinite(stands).all():
            raise InputError(f"--at {at[:80]}: seven numbers with commas are expected, A1 to A6 and E1")
    files = rest_files(folder, first, None if stands is None else np.deg2rad(stands))
    return atomic_folder(out, files)


def export(
    folder: Folder,
    to: Annotated[
        str, typer.Option("--to", help="csv, json, viewpoints, krl, krl-timed, rapid, urscript, ros or mcap.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Where to write; by default the plan's folder.", rich_help_panel=OUT),
    ] = None,
    name: Annotated[str, typer.Option("--name", help="Name of the robot programme.")] = "scan",
    signal: Annotated[
        int | None,
        typer.Option("--signal", help="Output that is on while the scanner scans; the cell's by default."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Scanner off, a tenth of the speed, a halt at each view.")
    ] = False,
    rest: Annotated[
        bool, typer.Option("--rest", help="Only what the last run left, from where the robot stands.")
    ] = False,
    step: Annotated[int | None, typer.Option("--step", help="Only from this step on.")] = None,
    at: Annotated[
        str | None, typer.Option("--at", help="Where the robot stands: A1,..,A6,E1 in degrees.")
    ] = None,
    risk: Annotated[
        bool, typer.Option("--risk/--no-risk", help="A risk sheet beside a programme.", rich_help_panel=OUT)
    ] = True,
    quiet: Quiet = False,
) -> int:
    """Write a plan for a controller or another program, and beside a programme its risk sheet."""
    from scanmotion.controller.export_plan import export_plan

    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"--out {out}: is not a folder")
    if rest or step is not None:
        folder = _rest_folder(folder, out, step, at)
    elif at is not None:
        raise InputError("--at: belongs to --rest or --step")
    paths = export_plan(folder, to, out=out, name=name, signal=signal, dry_run=dry_run, risk=risk)
    for path in paths:
        if not quiet:
            typer.echo(str(path))
    return OK
