"""What a cell is: the solids, frames, joints and limits of arm, scanner, turntable and surroundings."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scanmotion.cell.arm.robot import Body, Robot
from scanmotion.cell.mesh_solids import MeshSolid
from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.part import Part

if TYPE_CHECKING:
    from scanmotion.cell.drake_model import DrakeModel

TOOL, TABLE, WORLD = 7, 8, 9
"""Values of Body.link beside 0..6."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell:
    """What exists in the cell and never changes while a plan is made. Joints: A1..A6 and the table E1."""

    settings: CellSettings
    part: Part | None
    robot: Robot
    X_WB: np.ndarray
    """Robot base in the world, shape (4, 4)."""
    X_FS: np.ndarray
    """Scanner in the flange."""
    X_WT: np.ndarray
    """Turntable at angle zero in the world, origin on its surface."""
    X_TO: np.ndarray
    """Object on the turntable."""
    joint_names: tuple[str, ...]
    q_min: np.ndarray
    """Shape (7,) [rad]; -inf for an endless table."""
    q_max: np.ndarray
    v_max: np.ndarray
    """Shape (7,) [rad/s]."""
    a_max: np.ndarray
    """Shape (7,) [rad/s2]."""
    j_max: np.ndarray
    """Shape (7,) [rad/s3]."""
    home: np.ndarray
    """Where a programme starts, shape (7,) [rad]."""
    bodies: tuple[Body, ...]
    """Every solid but the part: links, tool, table, pedestal, floor and obstacles."""
    meshes: tuple[MeshSolid, ...] = ()
    """Those of the cell that are meshes; their convex pieces are among the bodies."""

    def drake(self, **options: Any) -> "DrakeModel":
        """The cell as a Drake diagram with plant, scene graph, context, part and drives.

        Args:
            options: time_step [s], meshcat; see `scanmotion.cell.drake_model.drake_model`.
        """
        from scanmotion.cell.drake_model import drake_model

        return drake_model(self, **options)

    @property
    def urdf_path(self) -> Path:
        """The robot's URDF."""
        return self.robot.urdf
