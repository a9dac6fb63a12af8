"""`scanmotion run`: an exported programme on the virtual controller."""

import math
from pathlib import Path
from typing import Annotated

import typer

from scanmotion.cli.app import CHECK_FAILED, OK, say_json
from scanmotion.cli.inputs import Json, Quiet
from scanmotion.core.errors import InputError

Folder = Annotated[Path, typer.Argument(help="Folder of the plan.")]


def run(
    folder: Folder,
    controller: Annotated[str, typer.Option("--controller", help="sim: the virtual one.")] = "sim",
    programme: Annotated[
        Path | None, typer.Option("--programme", help="Its main file; by default the only one in the folder.")
    ] = None,
    ready: Annotated[
        str, typer.Option("--ready", help="The scanner is ready at-once, late or never.")
    ] = "at-once",
    done: Annotated[str, typer.Option("--done", help="It is done at-once, late or never.")] = "at-once",
    fault: Annotated[
        list[int] | None, typer.Option("--fault", help="A recording, from 1, that a fault of it breaks off.")
    ] = None,
    stop_at: Annotated[float, typer.Option("--stop-at", help="When the power goes, s.")] = math.inf,
    dynamics: Annotated[
        bool, typer.Option("--dynamics/--no-dynamics", help="Whether Drake simulates arm and table.")
    ] = True,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Run an exported programme on a virtual controller with a simulated scanner; writes run.csv and
    executed.json into the plan's folder, from which `export --rest` goes on.
    """
    if controller != "sim":
        raise InputError(f"--controller {controller}: only sim is known")
    from scanmotion.controller.log import EXECUTED, LOG, executed_text, log_text
    from scanmotion.controller.simulate import Circumstances, programme_in, run_programme
    from scanmotion.export.source import write_files

    file = programme_in(folder) if programme is None else programme
    how = Circumstances(ready=ready, done=done, faults=tuple(fault or ()), stop_at=stop_at)
    found = run_programme(file, folder, how, dynamics=dynamics)
    write_files(folder, {LOG: log_text(found.log), EXECUTED: executed_text(found.executed)})
    frames = int((found.log.frame > 0).sum())
    if json:
        told = found.executed.model_dump(mode="json")
        say_json({**told, "seconds": float(found.log.t[-1]), "frames": frames, "said": list(found.said)})
    elif not quiet:
        for line in found.said:
            typer.echo(line)
        state = "came to its end" if found.executed.ended else f"broken off: {found.executed.reason}"
        typer.echo(
            f"{file.name} {state}; {found.log.t[-1]:.2f} s, {frames} frames, "
            f"{found.executed.completed} steps done, joints within {found.lag_deg:.3f} deg of the command"
        )
    return OK if found.executed.ended else CHECK_FAILED
