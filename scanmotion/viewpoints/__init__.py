"""The geometry module: holes, viewpoints and what they see. It knows no robot and is used on its own too.

The public names stand below; each is loaded when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

_HOMES = {
    "Viewpoint": "core.viewpoint",
    "Slack": "core.viewpoint",
    "look_at": "core.viewpoint",
    "StepPlan": "views.stepped_rotary",
    "stepped_rotary": "views.stepped_rotary",
    "paper_stepped_rotary": "views.stepped_rotary",
    "boundary_points": "sensing.holes.boundary",
    "oriented_normals": "sensing.holes.boundary",
    "Hole": "sensing.holes.find",
    "HoleReport": "sensing.holes.find",
    "holes_from_cloud": "sensing.holes.find",
    "LargestAngle": "sensing.holes.paper_clusters",
    "holes_from_mesh": "sensing.holes.find",
    "hole_report_to_json": "sensing.holes.find",
    "local_viewpoints": "views.hole_views",
    "paper_local_viewpoints": "views.hole_views",
    "LocalStep": "views.next_best_views",
    "SelectOptions": "views.next_best_views",
    "local_step": "views.next_best_views",
    "ClosedModel": "sensing.closed_surface",
    "closed_model": "sensing.closed_surface",
    "Frontier": "sensing.free_space",
    "Space": "sensing.free_space",
    "Scene": "sensing.visibility",
    "scene_from": "sensing.visibility",
    "sees": "sensing.visibility",
    "seen_by_any": "sensing.visibility",
    "turns_see": "sensing.visibility",
    "revolution_poses": "sensing.visibility",
    "visible": "sensing.visibility",
    "greedy_cover": "sensing.greedy_cover",
    "cad_slicing": "views.cad_slicing",
    "surface_partitioning": "views.surface_partitioning",
    "show": "report.viewpoint_scene:",
}

__all__ = list(_HOMES)

if TYPE_CHECKING:
    import scanmotion.report.viewpoint_scene as show  # noqa: F401
    from scanmotion.core.viewpoint import Slack as Slack
    from scanmotion.core.viewpoint import Viewpoint as Viewpoint
    from scanmotion.core.viewpoint import look_at as look_at
    from scanmotion.sensing.closed_surface import ClosedModel as ClosedModel
    from scanmotion.sensing.closed_surface import closed_model as closed_model
    from scanmotion.sensing.free_space import Frontier as Frontier
    from scanmotion.sensing.free_space import Space as Space
    from scanmotion.sensing.greedy_cover import greedy_cover as greedy_cover
    from scanmotion.sensing.holes.boundary import boundary_points as boundary_points
    from scanmotion.sensing.holes.boundary import oriented_normals as oriented_normals
    from scanmotion.sensing.holes.find import Hole as Hole
    from scanmotion.sensing.holes.find import HoleReport as HoleReport
    from scanmotion.sensing.holes.find import hole_report_to_json as hole_report_to_json
    from scanmotion.sensing.holes.find import holes_from_cloud as holes_from_cloud
    from scanmotion.sensing.holes.find import holes_from_mesh as holes_from_mesh
    from scanmotion.sensing.holes.paper_clusters import LargestAngle as LargestAngle
    from scanmotion.sensing.visibility import Scene as Scene
    from scanmotion.sensing.visibility import revolution_poses as revolution_poses
    from scanmotion.sensing.visibility import scene_from as scene_from
    from scanmotion.sensing.visibility import seen_by_any as seen_by_any
    from scanmotion.sensing.visibility import sees as sees
    from scanmotion.sensing.visibility import turns_see as turns_see
    from scanmotion.sensing.visibility import visible as visible
    from scanmotion.views.cad_slicing import cad_slicing as cad_slicing
    from scanmotion.views.hole_views import local_viewpoints as local_viewpoints
    from scanmotion.views.hole_views import paper_local_viewpoints as paper_local_viewpoints
    from scanmotion.views.next_best_views import LocalStep as LocalStep
    from scanmotion.views.next_best_views import SelectOptions as SelectOptions
    from scanmotion.views.next_best_views import local_step as local_step
    from scanmotion.views.stepped_rotary import StepPlan as StepPlan
    from scanmotion.views.stepped_rotary import paper_stepped_rotary as paper_stepped_rotary
    from scanmotion.views.stepped_rotary import stepped_rotary as stepped_rotary
    from scanmotion.views.surface_partitioning import surface_partitioning as surface_partitioning


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scanmotion.viewpoints' has no attribute {name!r}")
    home, is_module, _ = _HOMES[name].partition(":")
    module = importlib.import_module(f"scanmotion.{home}")
    value = module if is_module else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
