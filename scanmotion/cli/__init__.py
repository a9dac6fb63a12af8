"""The command line: `scanmotion COMMAND`; nothing heavy is imported before a command runs."""

from scanmotion.cli.app import app, note_interrupts
from scanmotion.cli.cells.arms import reach
from scanmotion.cli.cells.cell_files import cell_app
from scanmotion.cli.cells.robots import robots_app
from scanmotion.cli.fusing import fuse
from scanmotion.cli.geometry import holes, inspect, viewpoints
from scanmotion.cli.loop.accepting import acceptance
from scanmotion.cli.loop.assessing import assess
from scanmotion.cli.loop.calibrating import calibrate
from scanmotion.cli.loop.jobs import job_app
from scanmotion.cli.loop.papering import paper
from scanmotion.cli.plans.comparing import compare
from scanmotion.cli.plans.looking import export, show, verify
from scanmotion.cli.plans.planning import plan
from scanmotion.cli.plans.running import run
from scanmotion.cli.studying import layout, study_app

__all__ = ["app", "main"]

for _command, _panel, _example in (
    (plan, "Plan", "scanmotion plan --robot kr240 --part statue.ply --out out"),
    (verify, "Plan", "scanmotion verify out"),
    (show, "Plan", "scanmotion show out"),
    (export, "Plan", "scanmotion export out --to krl"),
    (paper, "Plan", "scanmotion paper --out paper.html"),
    (run, "Plan", "scanmotion run out --controller sim"),
    (compare, "Plan", "scanmotion compare --variants two-step,cad-slicing --seeds 3 --out table.md"),
    (inspect, "One stage alone", "scanmotion inspect statue.stl --picture statue.png"),
    (holes, "One stage alone", "scanmotion holes scan.ply --out holes.json"),
    (viewpoints, "One stage alone", "scanmotion viewpoints --box 330 200 600 --out viewpoints.csv"),
    (reach, "One stage alone", "scanmotion reach --robot kr240 --box 330 200 600"),
    (fuse, "One stage alone", "scanmotion fuse turn1.ply turn2.ply --out fused.ply"),
    (assess, "The real loop", "scanmotion assess fused.ply --reference statue.stl --out assessment"),
    (acceptance, "The real loop", "scanmotion acceptance --cell my-cell.yaml"),
    (calibrate, "The real loop", "scanmotion calibrate statue --write-cell calibrated.yaml"),
    (layout, "Many plans", "scanmotion layout --part statue.ply --out layout.yaml"),
):
    app.command(rich_help_panel=_panel, epilog=f"Example: {_example}", no_args_is_help=False)(_command)

app.add_typer(robots_app, name="robots", rich_help_panel="Robots and cells")
app.add_typer(cell_app, name="cell", rich_help_panel="Robots and cells")
app.add_typer(job_app, name="job", rich_help_panel="The real loop")
app.add_typer(study_app, name="study", rich_help_panel="Many plans")


def main() -> None:
    """Runs the command line of this process and exits with its status."""
    note_interrupts()
    app(prog_name="scanmotion")
