"""The cell as a Drake MultibodyPlant, put together by model directives, with its collision checker."""

import logging
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from defusedxml.ElementTree import fromstring
from pydrake.common import Parallelism
from pydrake.geometry import (
    CollisionFilterDeclaration,
    Convex,
    GeometryId,
    GeometrySet,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import LoadModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import MultibodyPlant
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

from scanmotion.cell.arm.robot import Body, Robot
from scanmotion.cell.arm.robot_file import write_arm
from scanmotion.cell.arm.urdf import obj_text
from scanmotion.cell.collision.pairs import GUIDED_M, exempt_pairs, guided_names, on_floor
from scanmotion.cell.collision.shapes import hull_of
from scanmotion.cell.model import TABLE, TOOL, WORLD, Cell

# Drake tells of every port it opens and every context it allocates; warnings still come through. Who wants
# to hear more sets the level after this import.
logging.getLogger("drake").setLevel(logging.WARNING)

_COLOURS = {"scanner": "0.15 0.16 0.18 1", "table": "0.72 0.73 0.75 1", "floor": "0.93 0.93 0.92 1"}
_GREY = "0.45 0.46 0.48 1"


def _urdf_of(name: str, bodies: list[Body], pieces: Path, *, mass: float, collide: bool) -> str:
    """One rigid link that carries `bodies`, as URDF text; pieces of meshes are written into a folder."""
    inertia = " ".join(f'{k}="{0.01 * mass if k in ("ixx", "iyy", "izz") else 0}"' for k in _INERTIA)
    space = 'xmlns:drake="https://drake.mit.edu"'
    out = [f'<robot name="{name}" {space}><link name="{name}">']
    out += [f'<inertial><mass value="{mass}"/><inertia {inertia}/></inertial>']
    for body in bodies:
        rpy = _roll_pitch_yaw(body.X_LG)
        origin = f'<origin xyz="{_text(body.X_LG[:3, 3])}" rpy="{_text(rpy)}"/>'
        if body.shape == "box":
            shape = f'<geometry><box size="{_text(body.size)}"/></geometry>'
        elif body.shape == "hull":
            file = pieces / f"{name}_{len(out)}.obj"
            file.write_bytes(obj_text(hull_of(body)))
            mesh = f'<mesh filename="{file.as_uri()}"><drake:declare_convex/></mesh>'
            shape = f"<geometry>{mesh}</geometry>"
        else:
            shape = f'<geometry><cylinder radius="{body.size[0]!r}" length="{body.size[1]!r}"/></geometry>'
        colour = _COLOURS.get(body.name, _GREY)
        paint = f'<material name="{body.name}"><color rgba="{colour}"/></material>'
        out.append(f"<visual>{origin}{shape}{paint}</visual>")
        if collide:
            out.append(f'<collision name="{body.name}">{origin}{shape}</collision>')
    return "".join([*out, "</link></robot>"])


_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _roll_pitch_yaw(X: Any) -> Any:
    return RollPitchYaw(RigidTransform(X).rotation()).vector()


def _text(values: Any) -> str:
    return " ".join(f"{float(v):.12g}" for v in values)


def _pose_yaml(X: np.ndarray) -> str:
    rpy = np.rad2deg(_roll_pitch_yaw(X))
    numbers = ", ".join(f"{v:.12g}" for v in X[:3, 3]), ", ".join(f"{v:.12g}" for v in rpy)
    return f"{{translation: [{numbers[0]}], rotation: !Rpy {{deg: [{numbers[1]}]}}}}"


def write_models(cell: Cell, folder: Path) -> Path:
    """Writes tool, turntable and surroundings as URDF and the directives that weld them; returns the latter.

    The table's solids stand in the world, where their turning does not matter; what turns with E1 carries
    the part.
    """
    of = {k: [b for b in cell.bodies if b.link == k] for k in (TOOL, TABLE, WORLD)}
    mass = cell.settings.tool.mass_kg
    pieces = _pieces_folder(cell)
    (folder / "tool.urdf").write_text(_urdf_of("tool", of[TOOL], pieces, mass=mass, collide=True))
    (folder / "stand.urdf").write_text(_urdf_of("stand", of[TABLE], pieces, mass=1.0, collide=True))
    # The floor is a body of its own: base and link 1 are judged against obstacles, but not against it.
    for name, solids in (
        ("floor", [b for b in of[WORLD] if b.name == "floor"]),
        ("surroundings", [b for b in of[WORLD] if b.name != "floor"]),
    ):
        (folder / f"{name}.urdf").write_text(_urdf_of(name, solids, pieces, mass=1.0, collide=True))
    joint = (
        '<robot name="turntable"><link name="turntable_base"/><link name="turntable">'
        '<inertial><mass value="100"/>'
        '<inertia ixx="30" iyy="30" izz="30" ixy="0" ixz="0" iyz="0"/></inertial>'
        '</link><joint name="E1" type="continuous"><parent link="turntable_base"/><child link="turntable"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    (folder / "turntable.urdf").write_text(joint)
    arm = _arm_folder(cell.robot)
    lines = ["directives:"]
    for name, file in (
        ("arm", (arm / "arm.urdf").as_uri()),
        ("tool", (folder / "tool.urdf").as_uri()),
        ("turntable", (folder / "turntable.urdf").as_uri()),
        ("stand", (folder / "stand.urdf").as_uri()),
        ("floor", (folder / "floor.urdf").as_uri()),
        ("surroundings", (folder / "surroundings.urdf").as_uri()),
    ):
        lines.append(f"- add_model: {{name: {name}, file: '{file}'}}")
    base = _base_link(cell.robot)
    for parent, child, X in (
        ("world", f"arm::{base}", cell.X_WB),
        (f"arm::{cell.robot.flange}", "tool::tool", np.eye(4)),
        ("world", "turntable::turntable_base", cell.X_WT),
        ("world", "stand::stand", cell.X_WT),
        ("world", "floor::floor", np.eye(4)),
        ("world", "surroundings::surroundings", np.eye(4)),
    ):
        lines.append(f"- add_weld: {{parent: '{parent}', child: '{child}', X_PC: {_pose_yaml(X)}}}")
    path = folder / "cell.dmd.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


_ARMS: WeakKeyDictionary[Robot, Any] = WeakKeyDictionary()


_PIECES: WeakKeyDictionary[Cell, Any] = WeakKeyDictionary()


def _pieces_folder(cell: Cell) -> Path:
    """Where the pieces of the cell's meshes lie; Drake makes hulls and pictures of them later on."""
    if cell not in _PIECES:
        _PIECES[cell] = tempfile.TemporaryDirectory()
    return Path(_PIECES[cell].name)


def _arm_folder(robot: Robot) -> Path:
    """Where the arm's URDF and its pieces lie; Drake draws from them later on."""
    if robot not in _ARMS:
        _ARMS[robot] = tempfile.TemporaryDirectory()
        write_arm(robot.text, dict(robot.pieces), Path(_ARMS[robot].name))
    return Path(_ARMS[robot].name)


def _base_link(robot: Robot) -> str:
    """The link that nothing carries."""
    root = fromstring(robot.text.replace("drake:", "drake_"))
    children = {link.get("link") for link in root.iterfind("joint/child")}
    parents = [link.get("link", "") for link in root.iterfind("joint/parent")]
    return next(p for p in parents if p not in children)


def add_cell(plant: MultibodyPlant, cell: Cell) -> dict[str, Any]:
    """Parses the cell into `plant` (not finalized); returns model instances by name."""
    with tempfile.TemporaryDirectory() as folder:
        path: Any = str(write_models(cell, Path(folder)))
        added = ProcessModelDirectives(LoadModelDirectives(path), plant, Parser(plant))
    return {info.model_name: info.model_instance for info in added}


def add_hull(plant: MultibodyPlant, cell: Cell) -> None:
    """Welds the convex hull of the part's vertices to the table; nothing where there is no part."""
    from scipy.spatial import ConvexHull

    if cell.part is None:
        return
    points = cell.part.vertices
    corners = points[ConvexHull(points).vertices]
    # The stubs of pydrake know no arrays.
    X: Any = cell.X_TO
    convex: Any = Convex
    table = plant.GetBodyByName("turntable", plant.GetModelInstanceByName("turntable"))
    shape = convex(corners.T, "part")
    plant.RegisterCollisionGeometry(table, RigidTransform(X), shape, "part", ProximityProperties())


def exempt_ids(plant: MultibodyPlant, cell: Cell) -> list[tuple[GeometryId, GeometryId]]:
    """Solids that the planner does not hold against one another though Drake would: see `collision.pairs`.

    What is fixed to one another, and the links at either end of a joint, Drake leaves out by itself.
    """
    arm, tool, floor = (plant.GetModelInstanceByName(name) for name in ("arm", "tool", "floor"))
    ids: dict[int, GeometryId] = {}
    carriers = {b.carrier for b in cell.bodies if b.link <= TOOL}
    for carrier in sorted(carriers):
        body = plant.GetBodyByName(carrier, arm) if carrier else plant.GetBodyByName("tool", tool)
        own = [b for b in cell.bodies if b.link <= TOOL and b.carrier == carrier]
        found = plant.GetCollisionGeometriesForBody(body)
        ids |= {id(b): geometry for b, geometry in zip(own, found, strict=True)}
    pairs = [(ids[id(e.a)], ids[id(e.b)]) for e in exempt_pairs(cell) if e.meets]
    (ground,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("floor", floor))
    standing = [b for b in cell.bodies if 1 <= b.link < TOOL and not on_floor(cell, b)]
    return pairs + [(ids[id(b)], ground) for b in standing]


Pairs = list[tuple[GeometryId, GeometryId]]


class DrakeCell:
    """Plant and collision checker of a cell; the part's true triangles are judged elsewhere.

    Drake takes a mesh as its convex hull in every proximity query. One instance belongs to one thread.

    Args:
        cell: the cell.
        hull: whether the part's hull is among the solids.
        own_pairs: leaves no pair out but those that Drake does; `leave_out` may add to them.
    """

    def __init__(self, cell: Cell, *, hull: bool = False, own_pairs: bool = False) -> None:
        builder = RobotDiagramBuilder(time_step=0.0)
        instances = add_cell(builder.plant(), cell)
        if hull:
            add_hull(builder.plant(), cell)
        builder.plant().Finalize()
        process = cell.settings.process
        options: dict[str, Any] = dict(
            model=builder.Build(),
            robot_model_instances=[instances["arm"], instances["tool"]],
            edge_step_size=0.05,
            env_collision_padding=process.clearance_m,
            self_collision_padding=process.self_clearance_m,
        )
        self.checker = SceneGraphCollisionChecker(**options)
        self.plant = self.checker.plant()
        self.inspector = self.checker.model().scene_graph().model_inspector()
        self.context = self.checker.plant_context()
        of = [self.plant.GetBodyIndices(instances[name]) for name in ("arm", "tool")]
        self.robot_bodies = [*of[0], *of[1]]
        self._order = self._joint_order(cell)
        self.groups = self._groups(cell)
        if not own_pairs:
            self.leave_out(exempt_ids(self.plant, cell))
            self.keep_apart(guided_names(cell), min(process.self_clearance_m, GUIDED_M))

    def _joint_order(self, cell: Cell) -> np.ndarray:
        """Index of each of A1..A6, E1 in the plant's position vector."""
        names = cell.joint_names
        return np.array([self.plant.GetJointByName(n).position_start() for n in names])

    def _groups(self, cell: Cell) -> dict[str, int]:
        """Value of Body.link for the name of each of the plant's bodies."""
        return {b.carrier or "tool": b.link for b in cell.bodies if b.link <= TOOL} | {
            "stand": TABLE,
            "surroundings": WORLD,
        }

    def keep_apart(self, names: Iterable[frozenset[str]], distance: float) -> None:
        """Asks of pairs of the robot's bodies, by their names, this distance [m]."""
        of = {self.plant.get_body(i).name(): i for i in self.robot_bodies}
        for pair in names:
            indices = [of[name] for name in sorted(pair) if name in of]
            if len(indices) == 2:
                self.checker.SetPaddingBetween(indices[0], indices[1], distance)

    def leave_out(self, pairs: Pairs) -> None:
        """Does not hold these solids against one another any more."""

        def apply(model: Any, context: Any) -> None:
            scene = model.scene_graph()
            manager = scene.collision_filter_manager(
                scene.GetMyMutableContextFromRoot(context.model_context())
            )
            for a, b in pairs:
                manager.Apply(CollisionFilterDeclaration().ExcludeBetween(GeometrySet(a), GeometrySet(b)))

        self.checker.PerformOperationAgainstAllModelContexts(apply)

    def positions(self, q: np.ndarray) -> np.ndarray:
        """The plant's positions for configurations (n, 7)."""
        out = np.zeros((len(q), self.plant.num_positions()))
        out[:, self._order] = q
        return out

    def free(self, q: np.ndarray) -> np.ndarray:
        """Whether arm and tool keep their clearances to everything but the part, shape (n,)."""
        if len(q) == 0:
            return np.zeros(0, bool)
        # Waking threads costs more than a few hundred checks.
        threads = Parallelism(1) if len(q) < 500 else Parallelism.Max()
        rows = list(self.positions(q))
        return np.array(self.checker.CheckConfigsCollisionFree(rows, parallelize=threads), dtype=bool)

    def nearest(self, q: np.ndarray) -> tuple[float, float, tuple[str, str]]:
        """The pair that keeps its clearance worst in one configuration (7,); the part is not among them.

        Returns:
            by how much more than asked for the two are apart [m], their distance [m], and their names.
        """
        found = self.checker.CalcRobotClearance(self.positions(q[None])[0], 1.0)
        if found.size() == 0:
            return 1.0, 1.0, ("", "")
        i = int(np.argmin(found.distances()))
        first, other = found.robot_indices()[i], found.other_indices()[i]
        # Drake counts distances from the padding on.
        excess = float(found.distances()[i])
        names = self.plant.get_body(first).name(), self.plant.get_body(other).name()
        return excess, excess + float(self.checker.GetPaddingBetween(first, other)), names


_PLANTS: WeakKeyDictionary[Cell, DrakeCell] = WeakKeyDictionary()


def drake_of(cell: Cell) -> DrakeCell:
    """The same cell as a MultibodyPlant with its collision checker, made when first asked for."""
    if cell not in _PLANTS:
        _PLANTS[cell] = DrakeCell(cell)
    return _PLANTS[cell]
