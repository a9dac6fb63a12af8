"""scanmotion: robot programmes that scan a whole sculpture, planned, timed and judged.

The public names stand below in the order of the pipeline; each is loaded when it is first used.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# In a notebook Open3D would open its WebRTC window system, and say so.
os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")

_HOMES = {
    "ScanMotionError": "errors",
    "part_from_file": "part",
    "box_part": "part",
    "carving": "part",
    "Scanner": "scanner",
    "viewpoints": "",
    "load_cell": "cell.config",
    "build_cell": "cell.plant",
    "reach": "motion.reach",
    "tour_from_cost": "motion.tsp",
    "PlanOptions": "pipeline",
    "plan": "pipeline",
    "load_plan": "loaded",
    "verify": "judge",
    "export_plan": "export",
    "compare": "comparison",
    "show": "",
    "report": "",
}

__all__ = list(_HOMES)

if TYPE_CHECKING:
    from scanmotion.cell.config import load_cell as load_cell
    from scanmotion.cell.plant import build_cell as build_cell
    from scanmotion.errors import ScanMotionError as ScanMotionError
    from scanmotion.part import box_part as box_part
    from scanmotion.part import carving as carving
    from scanmotion.part import part_from_file as part_from_file
    from scanmotion.scanner import Scanner as Scanner


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scanmotion' has no attribute {name!r}")
    home = _HOMES[name]
    if not home:
        value = importlib.import_module(f"scanmotion.{name}")
    else:
        value = getattr(importlib.import_module(f"scanmotion.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
