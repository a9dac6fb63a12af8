"""The cell as a Drake diagram to build on: plant, scene graph and context, with the part in it and drives.

Guarantees: frames, joints and solids are those that the planner asks Drake about; each joint has a drive.
Assumes rigid links with the masses of the URDF. Drake takes the part as its convex hull where it asks for
distances, and shows its true triangles.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from scanmotion.cell.drake_scene import add_cell, add_hull

if TYPE_CHECKING:
    from scanmotion.cell.model import Cell

_PART_RGBA: Any = np.array([0.80, 0.76, 0.68, 1.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class DrakeModel:
    """A cell in Drake. The context changes where `set_q` is called; one value belongs to one thread."""

    diagram: Diagram
    plant: MultibodyPlant
    scene_graph: SceneGraph
    context: Context
    """Of the diagram."""
    plant_context: Context
    """Of the plant, inside of the former."""
    order: np.ndarray
    """Index of each of A1..A6, E1 among the plant's positions, shape (7,)."""

    def set_q(self, q: np.ndarray) -> None:
        """Brings arm and table to a configuration.

        Args:
            q: A1..A6, E1, shape (7,) [rad].
        """
        positions: Any = np.zeros(self.plant.num_positions())
        positions[self.order] = np.asarray(q, dtype=float)
        self.plant.SetPositions(self.plant_context, positions)

    def X_WS(self) -> np.ndarray:
        """The scanner in the world, shape (4, 4), in the context's configuration."""
        frame: Any = self.plant.GetFrameByName("scanner")
        return np.array(frame.CalcPoseInWorld(self.plant_context).GetAsMatrix4())


def drake_model(cell: "Cell", *, time_step: float = 0.001, meshcat: Any = None) -> DrakeModel:
    """The cell as a diagram of its own; nothing of the planner changes when it is driven.

    Ports of actuation and state of the plant are not connected: build a `Simulator` on the diagram and fix
    them in the context. For a diagram with controllers of your own, `add_cell` puts the cell into any plant.

    Args:
        cell: the cell, with or without a part.
        time_step: of the plant [s]; 0 for a continuous one.
        meshcat: Drake's Meshcat, in which all is shown; None shows nothing.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    add_cell(plant, cell)
    add_hull(plant, cell)
    _add_picture(plant, cell)
    tool = plant.GetBodyByName("tool", plant.GetModelInstanceByName("tool"))
    _add_scanner_frame(plant, tool, cell)
    if plant.num_actuators() == 0:
        for name in cell.joint_names:
            plant.AddJointActuator(f"drive_{name}", plant.GetJointByName(name))
    plant.Finalize()
    if meshcat is not None:
        from pydrake.visualization import AddDefaultVisualization

        AddDefaultVisualization(builder, meshcat)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    made = DrakeModel(
        diagram=diagram,
        plant=plant,
        scene_graph=scene_graph,
        context=context,
        plant_context=plant.GetMyMutableContextFromRoot(context),
        order=np.array([plant.GetJointByName(n).position_start() for n in cell.joint_names]),
    )
    made.set_q(cell.home)
    return made


def _add_scanner_frame(plant: MultibodyPlant, tool: Any, cell: "Cell") -> None:
    from pydrake.multibody.tree import FixedOffsetFrame

    X_FS: Any = cell.X_FS
    plant.AddFrame(FixedOffsetFrame("scanner", tool.body_frame(), RigidTransform(X_FS)))


def _add_picture(plant: MultibodyPlant, cell: "Cell") -> None:
    """The part's own triangles on the table, to be looked at; nothing for a cloud or without a part."""
    part = cell.part
    if part is None or not part.is_mesh:
        return
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in part.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(part.triangles) + 1]
    text: Any = ("\n".join(lines) + "\n").encode()
    mesh = Mesh(InMemoryMesh(mesh_file=MemoryFile(text, ".obj", "part")))
    table = plant.GetBodyByName("turntable", plant.GetModelInstanceByName("turntable"))
    X_TO: Any = cell.X_TO
    plant.RegisterVisualGeometry(table, RigidTransform(X_TO), mesh, "part_picture", _PART_RGBA)
