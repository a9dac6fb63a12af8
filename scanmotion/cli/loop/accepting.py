"""`scanmotion acceptance`: ball bars and planes in the twin, before the robot moves."""

from typing import Annotated

import typer

from scanmotion.cli.app import OK, print_table, progress_bar, say_json
from scanmotion.cli.inputs import CellFile, Json, Quiet, Robot, Seed, cell_from


def acceptance(
    robot: Robot = None,
    cell: CellFile = None,
    stride: Annotated[int, typer.Option("--stride", min=1, max=16, help="Every n-th pixel is cast.")] = 4,
    seed: Seed = 0,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Predict the cell's figures on artefacts: probing form and size, sphere spacing, flatness.

    A ball bar in seven places and a plane in three are scanned by the twin with the errors of the cell's
    section `twin`, in the manner of VDI/VDE 2634 part 3 and ISO 10360-13; the greatest of each figure is
    given.
    """
    settings = cell_from(robot, cell)
    import numpy as np

    from scanmotion.sensing.metrology.acceptance import Table
    from scanmotion.sensing.metrology.acceptance import acceptance as scanned
    from scanmotion.sensing.simulator.captures import ScanErrors

    table = Table(
        speed=settings.turntable.speed_rpm * np.pi / 30, fps=settings.process.fps,
        acceleration=settings.turntable.acceleration_rad_s2,
    )  # fmt: skip
    with progress_bar(quiet=quiet or json) as progress:
        found = scanned(
            settings.scanner_model(), table, ScanErrors(**settings.twin_errors()), stride=stride, seed=seed,
            progress=lambda f: progress("twin", f),
        )  # fmt: skip
    told = {"units": "mm", "bars": len(found.bars), "planes": len(found.planes), **found.record()}
    if json:
        say_json(told)
    elif not quiet:
        print_table("Simulated acceptance test, greatest of each", (), [(k, str(v)) for k, v in told.items()])
    return OK
