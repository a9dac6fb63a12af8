"""scanmotion: robot programmes that scan a whole sculpture, planned, timed and judged.

The public names stand below in the order of the pipeline; each is loaded when it is first used.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# In a notebook Open3D would open its WebRTC window system, and say so.
os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")

_HOMES = {  # a colon behind a name: the module itself
    "ScanMotionError": "core.errors",
    "part_from_file": "geometry.parts",
    "box_part": "geometry.parts",
    "carving": "geometry.parts",
    "Scanner": "core.scanner",
    "viewpoints": "viewpoints:",
    "load_cell": "cell.settings",
    "build_cell": "cell.build",
    "reach": "motion.reach.find",
    "tour_from_cost": "motion.order.tsp",
    "PlanOptions": "planning.pipeline",
    "plan": "planning.pipeline",
    "load_plan": "plan_io.load",
    "verify": "judge",
    "export_plan": "export",
    "compare": "planning.comparison",
    "study": "studies.run",
    "show": "report.scene:",
    "report": "report.page:",
}

__all__ = list(_HOMES)

if TYPE_CHECKING:
    from scanmotion.cell.build import build_cell as build_cell
    from scanmotion.cell.settings import load_cell as load_cell
    from scanmotion.core.errors import ScanMotionError as ScanMotionError
    from scanmotion.core.scanner import Scanner as Scanner
    from scanmotion.geometry.parts import box_part as box_part
    from scanmotion.geometry.parts import carving as carving
    from scanmotion.geometry.parts import part_from_file as part_from_file


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
