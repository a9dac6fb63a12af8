"""scanmotion: robot programmes that scan a whole sculpture, planned, timed and judged.

The public names stand below in the order of the pipeline; each is loaded when it is first used.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

from scanmotion.core.support.later import defer_functions
from scanmotion.core.support.threads import follow_openmp

__version__ = "0.1.0"

# In a notebook Open3D would open its WebRTC window system, and say so.
os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")
follow_openmp()
# Of Open3D one module imports dash, and with it a second of other libraries.
defer_functions("open3d.visualization.draw_plotly", ("get_plotly_fig", "draw_plotly", "draw_plotly_server"))

_HOMES = {  # a colon behind a name: the module itself
    "ScanMotionError": "core.errors",
    "Part": "core.part",
    "part_from": "geometry.parts.part_objects",
    "part_from_file": "geometry.parts.make_part",
    "box_part": "geometry.parts.make_part",
    "carving": "geometry.parts.make_part",
    "Scanner": "core.scanner",
    "viewpoints": "viewpoints:",
    "Viewpoint": "core.viewpoint",
    "look_at": "core.viewpoint",
    "load_cell": "cell.settings.cell",
    "Cell": "cell.model",
    "build_cell": "cell.build",
    "reach": "motion.reach.find",
    "tour_from_cost": "motion.order.salesman.tsp",
    "PlanOptions": "planning.pipeline",
    "plan": "planning.pipeline",
    "Plan": "planning.plan",
    "load_plan": "plan_io.load",
    "verify": "judge",
    "export_plan": "controller.export_plan",
    "compare": "planning.worth.comparison",
    "study": "studies.run",
    "show": "report.scene:",
    "report": "report.page:",
}

__all__ = list(_HOMES)

if TYPE_CHECKING:
    import scanmotion.report.page as report  # noqa: F401
    import scanmotion.report.scene as show  # noqa: F401
    import scanmotion.viewpoints as viewpoints  # noqa: F401
    from scanmotion.cell.build import build_cell as build_cell
    from scanmotion.cell.model import Cell as Cell
    from scanmotion.cell.settings.cell import load_cell as load_cell
    from scanmotion.controller.export_plan import export_plan as export_plan
    from scanmotion.core.errors import ScanMotionError as ScanMotionError
    from scanmotion.core.part import Part as Part
    from scanmotion.core.scanner import Scanner as Scanner
    from scanmotion.core.viewpoint import Viewpoint as Viewpoint
    from scanmotion.core.viewpoint import look_at as look_at
    from scanmotion.geometry.parts.make_part import box_part as box_part
    from scanmotion.geometry.parts.make_part import carving as carving
    from scanmotion.geometry.parts.make_part import part_from_file as part_from_file
    from scanmotion.geometry.parts.part_objects import part_from as part_from
    from scanmotion.judge import verify as verify
    from scanmotion.motion.order.salesman.tsp import tour_from_cost as tour_from_cost
    from scanmotion.motion.reach.find import reach as reach
    from scanmotion.plan_io.load import load_plan as load_plan
    from scanmotion.planning.pipeline import PlanOptions as PlanOptions
    from scanmotion.planning.pipeline import plan as plan
    from scanmotion.planning.plan import Plan as Plan
    from scanmotion.planning.worth.comparison import compare as compare
    from scanmotion.studies.run import study as study


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scanmotion' has no attribute {name!r}")
    home, is_module, _ = _HOMES[name].partition(":")
    module = importlib.import_module(f"scanmotion.{home}")
    value = module if is_module else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
