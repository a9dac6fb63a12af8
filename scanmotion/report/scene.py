"""The scene: robot, part, scanner, viewpoints and motion, as a page that plays or live on localhost.

Nothing listens beyond the loopback device, and the page loads nothing from anywhere.
"""

from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatAnimation, MeshcatParams, Rgba, Role
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from scanmotion.cell.build import Cell
from scanmotion.cell.drake_scene import add_cell
from scanmotion.cell.kinematics import object_poses, scanner_poses
from scanmotion.core.part import Part
from scanmotion.core.trajectory import Trajectory
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.plan import Plan
from scanmotion.report.figures import palette
from scanmotion.report.figures.shapes import (  # fmt: skip
    Mesh,
    field_edges,
    field_faces,
    label,
    paintable,
    segments,
    shading_normals,
    tube,
)
from scanmotion.report.figures.sight import first_sight
from scanmotion.report.figures.surface import nearest_status, status_of_samples
from scanmotion.report.scene_overlay import LEFT_OUT, NOT_WORTH_COLOUR, views_of, with_overlay

FRAMES_PER_SECOND = 10.0
_AXIS_COLOURS = ("#d62728", "#2ca02c", "#1f77b4")


def scene_html(plan: Plan) -> str:
    """A self-contained page that plays the plan.

    Args:
        plan: a Plan, made just now or loaded from its folder.
    """
    meshcat = live_scene(plan)
    page = meshcat.StaticHtml()
    return with_overlay(page, plan)


def cell_page(cell: Cell, part: Part) -> str:
    """A self-contained page of a cell at rest, with a part on its table, before anything is planned.

    Args:
        cell: with the part in it.
        part: what stands on the table.
    """
    nothing = Plan(
        part=part, cell=cell, options=PlanOptions(), segments=(), trajectory=None, cloud=None, holes=None,
        samples=None, visible=None,
    )  # fmt: skip
    return scene_html(nothing)


def live_scene(plan: Plan) -> Meshcat:
    """The scene served on localhost only, with the motion recorded; `web_url()` says where."""
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [1.0, 1.0, 1.0])
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 0.9)
    bodies = _cell(meshcat, plan)
    appearing = _part(meshcat, plan)
    _scanner(meshcat, plan)
    _frames(meshcat, plan)
    if plan.trajectory is None:
        rest = plan.cell.home[None]
        poses = bodies.poses(rest)
        poses["scanner"], poses["part"] = scanner_poses(plan.cell, rest), object_poses(plan.cell, rest)
        for path, X in poses.items():
            meshcat.SetTransform(path, _pose(X[0]))
    else:
        _path(meshcat, plan.cell, plan.trajectory)
        _record(meshcat, plan, plan.trajectory, bodies, appearing)
    pose: Any = views_of(plan).object_view
    meshcat.SetCameraPose(*pose)
    return meshcat


def _columns(rows: np.ndarray, kind: Any = float) -> Any:
    """Rows as the Fortran-ordered columns that Meshcat takes."""
    return np.asfortranarray(rows.T.astype(kind))


def _pose(X: np.ndarray) -> RigidTransform:
    # The stubs of pydrake know no arrays.
    told: Any = X
    return RigidTransform(told)


def _mesh(meshcat: Meshcat, path: str, mesh: Mesh, colour: str, alpha: float = 1.0) -> None:
    rgba = Rgba(*palette.rgb(colour), alpha)
    meshcat.SetTriangleMesh(path, _columns(mesh[0]), _columns(mesh[1], np.int32), rgba)


class _Bodies:
    """The cell's bodies as Drake parses them, for drawing."""

    def __init__(self, cell: Cell) -> None:
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        add_cell(self.plant, cell)
        self.plant.Finalize()
        self._diagram = builder.Build()  # keeps plant and scene graph alive
        joints = (self.plant.GetJointByName(name) for name in cell.joint_names)
        self._order = [joint.position_start() for joint in joints]
        self.shapes: dict[str, list[tuple[Any, RigidTransform, Rgba]]] = {}
        inspector = scene_graph.model_inspector()
        for frame in inspector.GetAllFrameIds():
            name = self.plant.GetBodyFromFrameId(frame).name()
            for geometry in inspector.GetGeometries(frame, Role.kIllustration):
                paint = inspector.GetIllustrationProperties(geometry)
                colour = paint.GetPropertyOrDefault("phong", "diffuse", Rgba(0.7, 0.7, 0.7, 1.0))
                found = (inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry), colour)
                self.shapes.setdefault(name, []).append(found)

    def poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Pose in W of each body that is drawn, by its path, shape (n, 4, 4)."""
        context = self.plant.CreateDefaultContext()
        bodies = {name: self.plant.GetBodyByName(name) for name in self.shapes}
        poses = {f"cell/{name}": np.zeros((len(q), 4, 4)) for name in bodies}
        positions = np.zeros(self.plant.num_positions())
        for i, values in enumerate(q):
            positions[self._order] = values
            self.plant.SetPositions(context, positions)
            for name, body in bodies.items():
                poses[f"cell/{name}"][i] = self.plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4()
        return poses


def _cell(meshcat: Meshcat, plan: Plan) -> _Bodies:
    bodies = _Bodies(plan.cell)
    for name, shapes in bodies.shapes.items():
        for number, (shape, X, colour) in enumerate(shapes):
            path = f"cell/{name}/{number}"
            meshcat.SetObject(path, shape, colour)
            meshcat.SetTransform(path, X)
    # A round table does not show that it turns: a mark on its rim does.
    radius = plan.cell.settings.turntable.diameter_m / 2
    mark = np.array([[0.85 * radius, 0.0, 0.002], [radius, 0.0, 0.002]]) - plan.cell.X_TO[:3, 3]
    _mesh(meshcat, "part/table_mark", tube(mark, 0.008), "#c8102e")
    return bodies


def _part(meshcat: Meshcat, plan: Plan) -> list[tuple[str, float]]:
    """The surface coloured by what becomes of it, the holes and the viewpoints: all turn with the table.

    Returns:
        Path and instant [s] of each piece of surface that is seen, which is grey until then.
    """
    part, appearing = plan.part, []
    if part.is_mesh and plan.samples is not None and plan.visible is not None:
        appearing = _surface(meshcat, plan)
    elif part.is_mesh:
        _mesh(meshcat, "part/surface", paintable(part), "#cccccc")
    else:
        _cloud(meshcat, part.vertices)
    for number, hole in enumerate(plan.holes.holes if plan.holes is not None else (), start=1):
        loop = np.vstack([hole.boundary, hole.boundary[:1]])
        colour = palette.HOLE_COLOURS.get(hole.kind, "#444444")
        _mesh(meshcat, f"part/holes/H{number}/loop", tube(loop, 0.0015), colour)
        _text(
            meshcat,
            f"part/holes/H{number}/label",
            f"H{number}",
            hole.center + 0.03 * hole.normal,
            0.03,
            colour,
        )
    _viewpoints(meshcat, plan)
    return appearing


def _surface(meshcat: Meshcat, plan: Plan) -> list[tuple[str, float]]:
    """The part's triangles in pieces, one for each colour and instant at which it appears."""
    assert plan.samples is not None
    vertices, triangles = paintable(plan.part)
    normals = shading_normals((vertices, triangles))
    ends, first = first_sight(plan)
    status = status_of_samples(plan)
    # One number for both: which sample is nearest is asked once.
    both = (first + 1) * len(palette.STATUS_COLOURS) + status
    kind = nearest_status(vertices, normals, plan.samples, both)[triangles[:, 0]]
    appearing = []
    for value in np.unique(kind):
        used, index = np.unique(triangles[kind == value], return_inverse=True)
        mesh, colour = (vertices[used], index.reshape(-1, 3)), int(value) % len(palette.STATUS_COLOURS)
        slice_, path = int(value) // len(palette.STATUS_COLOURS) - 1, f"part/surface/{value}"
        if slice_ >= 0:
            _mesh(meshcat, f"{path}/before", mesh, palette.NOT_YET)
            appearing.append((path, float(ends[slice_])))
        _mesh(meshcat, f"{path}/seen", mesh, palette.STATUS_COLOURS[colour])
    return appearing


def _cloud(meshcat: Meshcat, points: np.ndarray) -> None:
    from pydrake.perception import PointCloud

    shown = points[:: max(1, len(points) // 100_000)]
    cloud = PointCloud(len(shown))
    cloud.mutable_xyzs()[:] = shown.T
    meshcat.SetObject("part/surface", cloud, point_size=0.002, rgba=Rgba(0.6, 0.6, 0.65, 1.0))


def _viewpoints(meshcat: Meshcat, plan: Plan) -> None:
    """Those that are served, and in a branch of its own, hidden at first, those that are left out."""
    lost = {name: palette.CAUSE_COLOURS["out_of_reach"] for name, _ in plan.unreachable}
    lost |= {name: NOT_WORTH_COLOUR for name, _ in plan.not_worth}
    scanner = plan.cell.settings.scanner_model()
    edges = field_edges(scanner, 0.02, 0.10)
    for view in plan.viewpoints:
        served = palette.STATUS_COLOURS[palette.SEEN_GLOBAL if view.step == "global" else palette.SEEN_LOCAL]
        colour = lost.get(view.id, served)
        path = f"{LEFT_OUT if view.id in lost else 'part/viewpoints'}/{view.id}"
        _mesh(meshcat, f"{path}/field", segments(edges, 0.0015), colour)
        meshcat.SetTransform(f"{path}/field", _pose(view.X_OS))
        _text(meshcat, f"{path}/label", view.id, view.p_OS + np.array([0.0, 0.0, 0.03]), 0.04, colour)
    if any(v.id in lost for v in plan.viewpoints):
        meshcat.SetProperty(LEFT_OUT, "visible", False)


def _text(meshcat: Meshcat, path: str, text: str, at: np.ndarray, height: float, colour: str) -> None:
    _mesh(meshcat, path, label(text, height), colour)
    meshcat.SetTransform(path, _pose(np.asarray(at, dtype=float)))


def _triad(meshcat: Meshcat, path: str, name: str, X: np.ndarray, length: float) -> None:
    """Red x, green y, blue z with their letters, and the frame's name at its origin."""
    for axis, letter in enumerate("xyz"):
        end = np.zeros(3)
        end[axis] = length
        line = np.array([np.zeros(3), end])
        _mesh(meshcat, f"{path}/{letter}", tube(line, 0.02 * length), _AXIS_COLOURS[axis])
        _text(meshcat, f"{path}/{letter}_label", letter, 1.08 * end, 0.05, _AXIS_COLOURS[axis])
    _text(meshcat, f"{path}/name", name, np.array([0.0, 0.0, 1.08 * length + 0.1]), 0.06, "#222222")
    meshcat.SetTransform(path, _pose(X))


def _scanner(meshcat: Meshcat, plan: Plan) -> None:
    scanner = plan.cell.settings.scanner_model()
    near, far = scanner.range
    _mesh(meshcat, "scanner/field/volume", field_faces(scanner, far), "#f2a33a", 0.16)
    _mesh(meshcat, "scanner/field/edges", segments(field_edges(scanner, near, far), 0.002), "#c77700")
    _triad(meshcat, "scanner/frame", "S", np.eye(4), 0.15)


def _frames(meshcat: Meshcat, plan: Plan) -> None:
    cell = plan.cell
    _triad(meshcat, "frames/W", "W", np.eye(4), 0.9)
    if not np.allclose(cell.X_WB, np.eye(4)):
        _triad(meshcat, "frames/B", "B", cell.X_WB, 0.8)
    _triad(meshcat, "part/frame", "O", np.eye(4), 0.25)


def _path(meshcat: Meshcat, cell: Cell, trajectory: Trajectory) -> None:
    """The way of the scanner's optical centre, one colour for each kind of operation."""
    for o in trajectory.operations:
        inside = np.flatnonzero((trajectory.t >= o.t_start) & (trajectory.t <= o.t_end))
        p = scanner_poses(cell, trajectory.q[inside[:: max(1, len(inside) // 150)]])[:, :3, 3]
        keep = np.concatenate([[True], np.linalg.norm(np.diff(p, axis=0), axis=1) > 1e-4])
        if keep.sum() >= 2:
            _mesh(
                meshcat, f"path/{o.index}_{o.kind}", tube(p[keep], 0.003), palette.OPERATION_COLOURS[o.kind]
            )


def frame_times(trajectory: Trajectory, fps: float = FRAMES_PER_SECOND) -> np.ndarray:
    """Indices of the trajectory's samples that become frames: evenly spaced, and each operation's ends."""
    t = trajectory.t
    wanted = np.arange(0.0, t[-1], 1.0 / fps)
    ends = [time for o in trajectory.operations for time in (o.t_start, o.t_end)]
    index = np.searchsorted(t, np.concatenate([wanted, ends, [t[-1]]]) - 1e-9)
    return np.unique(np.clip(index, 0, len(t) - 1))


def _record(
    meshcat: Meshcat,
    plan: Plan,
    trajectory: Trajectory,
    bodies: _Bodies,
    appearing: list[tuple[str, float]],
) -> None:
    cell = plan.cell
    index = frame_times(trajectory)
    t, q = trajectory.t[index], trajectory.q[index]
    poses = bodies.poses(q)
    poses["scanner"], poses["part"] = scanner_poses(cell, q), object_poses(cell, q)
    scanning = np.zeros(len(t), bool)
    for o in trajectory.operations:
        if o.scanning:
            scanning |= (t >= o.t_start) & (t < o.t_end)
    meshcat.StartRecording(frames_per_second=64.0, set_visualizations_while_recording=False)
    for path, X in poses.items():
        for i in _changes(X):
            meshcat.SetTransform(path, _pose(X[i]), time_in_recording=float(t[i]))
    for i in _changes(scanning[:, None, None]):
        meshcat.SetProperty("scanner/field", "visible", bool(scanning[i]), time_in_recording=float(t[i]))
    for path, instant in appearing:
        for name, before in (("before", True), ("seen", False)):
            meshcat.SetProperty(f"{path}/{name}", "visible", before, time_in_recording=0.0)
            meshcat.SetProperty(f"{path}/{name}", "visible", not before, time_in_recording=instant)
    meshcat.StopRecording()
    meshcat.get_mutable_recording().set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    meshcat.PublishRecording()
    # What a reader without scripts, or a paused page, sees first.
    for path, X in poses.items():
        meshcat.SetTransform(path, _pose(X[0]))
    meshcat.SetProperty("scanner/field", "visible", bool(scanning[0]))
    for path, _ in appearing:
        meshcat.SetProperty(f"{path}/before", "visible", False)


def _changes(values: np.ndarray) -> np.ndarray:
    """Frames that must be written: the first, and both sides of every change."""
    moved = np.abs(np.diff(values.astype(float), axis=0)).max(axis=(1, 2)) > 1e-9
    keep = np.zeros(len(values), bool)
    keep[0] = True
    keep[1:] |= moved
    keep[:-1] |= moved
    return np.flatnonzero(keep)
