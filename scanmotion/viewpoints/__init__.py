"""The geometry module: holes, viewpoints and what they see. It knows no robot and is used on its own too.

The public names stand below; each is loaded when it is first used.
"""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

_HOMES = {
    "Viewpoint": "viewpoint",
    "Slack": "viewpoint",
    "look_at": "viewpoint",
    "StepPlan": "stepped_rotary",
    "stepped_rotary": "stepped_rotary",
    "boundary_points": "boundary",
    "oriented_normals": "boundary",
    "Hole": "holes",
    "HoleReport": "holes",
    "holes_from_cloud": "holes",
    "holes_from_mesh": "holes",
    "hole_report_to_json": "holes",
    "local_viewpoints": "local",
    "LocalStep": "select",
    "SelectOptions": "select",
    "local_step": "select",
    "ClosedModel": "model",
    "closed_model": "model",
    "Frontier": "frontier",
    "Space": "frontier",
    "Scene": "coverage",
    "scene_from": "coverage",
    "sees": "coverage",
    "seen_by_any": "coverage",
    "turns_see": "coverage",
    "revolution_poses": "coverage",
    "visible": "coverage",
    "greedy_cover": "coverage",
    "cad_slicing": "cad_slicing",
    "surface_partitioning": "surface_partitioning",
    "show": "",
}

__all__ = list(_HOMES)

if TYPE_CHECKING:
    from scanmotion.viewpoints import show as show
    from scanmotion.viewpoints.boundary import boundary_points as boundary_points
    from scanmotion.viewpoints.boundary import oriented_normals as oriented_normals
    from scanmotion.viewpoints.cad_slicing import cad_slicing as cad_slicing
    from scanmotion.viewpoints.coverage import Scene as Scene
    from scanmotion.viewpoints.coverage import greedy_cover as greedy_cover
    from scanmotion.viewpoints.coverage import revolution_poses as revolution_poses
    from scanmotion.viewpoints.coverage import scene_from as scene_from
    from scanmotion.viewpoints.coverage import seen_by_any as seen_by_any
    from scanmotion.viewpoints.coverage import sees as sees
    from scanmotion.viewpoints.coverage import turns_see as turns_see
    from scanmotion.viewpoints.coverage import visible as visible
    from scanmotion.viewpoints.frontier import Frontier as Frontier
    from scanmotion.viewpoints.frontier import Space as Space
    from scanmotion.viewpoints.holes import Hole as Hole
    from scanmotion.viewpoints.holes import HoleReport as HoleReport
    from scanmotion.viewpoints.holes import hole_report_to_json as hole_report_to_json
    from scanmotion.viewpoints.holes import holes_from_cloud as holes_from_cloud
    from scanmotion.viewpoints.holes import holes_from_mesh as holes_from_mesh
    from scanmotion.viewpoints.local import local_viewpoints as local_viewpoints
    from scanmotion.viewpoints.model import ClosedModel as ClosedModel
    from scanmotion.viewpoints.model import closed_model as closed_model
    from scanmotion.viewpoints.select import LocalStep as LocalStep
    from scanmotion.viewpoints.select import SelectOptions as SelectOptions
    from scanmotion.viewpoints.select import local_step as local_step
    from scanmotion.viewpoints.stepped_rotary import StepPlan as StepPlan
    from scanmotion.viewpoints.stepped_rotary import stepped_rotary as stepped_rotary
    from scanmotion.viewpoints.surface_partitioning import surface_partitioning as surface_partitioning
    from scanmotion.viewpoints.viewpoint import Slack as Slack
    from scanmotion.viewpoints.viewpoint import Viewpoint as Viewpoint
    from scanmotion.viewpoints.viewpoint import look_at as look_at


class _Room(ModuleType):
    """Some modules share their name with their function; here the name always means the function."""

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and _HOMES.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Room


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scanmotion.viewpoints' has no attribute {name!r}")
    home = _HOMES[name]
    module = importlib.import_module(f"scanmotion.viewpoints.{home or name}")
    value = getattr(module, name) if home else module
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
