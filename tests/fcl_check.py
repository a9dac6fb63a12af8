"""Distances of a configuration by FCL on true triangles, with poses of Drake's plant: a second opinion."""

import fcl
import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from scanmotion.cell.build import TABLE, TOOL, Cell
from scanmotion.cell.collision.shapes import fcl_object
from scanmotion.cell.drake_scene import add_cell


class FclCell:
    """The solids of a cell as FCL objects."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.plant = MultibodyPlant(0.0)
        add_cell(self.plant, cell)
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()
        self.names = cell.joint_names
        self.shapes = [_shape(b) for b in cell.bodies]
        self.part = None
        if cell.part is not None:
            model = fcl.BVHModel()
            model.beginModel(len(cell.part.vertices), len(cell.part.triangles))
            model.addSubModel(cell.part.vertices, cell.part.triangles)
            model.endModel()
            self.part = fcl.CollisionObject(model, fcl.Transform())

    def frames(self, q: np.ndarray) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Links 0..6 and flange, scanner, and object, all in W, by Drake."""
        for name, value in zip(self.names, q, strict=True):
            self.plant.GetJointByName(name).set_angle(self.context, value)
        joints = [self.plant.GetJointByName(n) for n in self.names[:6]]
        bodies = [joints[0].parent_body(), *(j.child_body() for j in joints)]
        links = [self.plant.EvalBodyPoseInWorld(self.context, b).GetAsMatrix4() for b in bodies]
        flange = self.plant.GetFrameByName(self.cell.robot.flange)
        X_WF = flange.CalcPoseInWorld(self.context).GetAsMatrix4()
        table = self.plant.GetBodyByName("turntable")
        X_WO = self.plant.EvalBodyPoseInWorld(self.context, table).GetAsMatrix4() @ self.cell.X_TO
        return [*links, X_WF], X_WF @ self.cell.X_FS, X_WO

    def distances(self, q: np.ndarray, *, near: bool = True) -> tuple[float, float]:
        """Least distance to what is not the robot, and between links that are judged; -1 in collision.

        Without `near`, neighbours but one that always are near to each other do not count.
        """
        frames, _, X_WO = self.frames(q)
        robot, other = [], []
        for body, shape in zip(self.cell.bodies, self.shapes, strict=True):
            X = frames[body.link] if body.link <= TOOL else np.eye(4)
            X = self.cell.X_WT if body.link == TABLE else X
            shape.setTransform(_transform(X @ body.X_LG))
            (robot if body.link <= TOOL else other).append((body, shape))
        if self.part is not None:
            self.part.setTransform(_transform(X_WO))
        outside = inside = 10.0
        for n, (body, shape) in enumerate(robot):
            if body.link >= 1:
                for still, solid in other:
                    if not (body.link == 1 and still.name == "floor"):
                        outside = min(outside, _distance(shape, solid))
            if body.link >= 2 and self.part is not None:
                outside = min(outside, _distance(self.part, shape))
            for second, solid in robot[n + 1 :]:
                pair = (min(body.link, second.link), max(body.link, second.link))
                if pair[1] - pair[0] > 1 and (near or pair not in {(0, 2), (4, 6), (5, TOOL)}):
                    apart = _distance(shape, solid)
                    # Neighbours but one keep a millimetre, not the clearance.
                    if pair in {(0, 2), (4, 6), (5, TOOL)} and apart > 0:
                        apart += self.cell.settings.process.self_clearance_m - 1e-3
                    inside = min(inside, apart)
        return outside, inside


def _shape(body):
    return fcl_object(body, np.eye(4))


def _transform(X: np.ndarray):
    return fcl.Transform(np.ascontiguousarray(X[:3, :3]), np.ascontiguousarray(X[:3, 3]))


def _distance(a, b) -> float:
    if fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()):
        return -1.0
    return float(fcl.distance(a, b, fcl.DistanceRequest(), fcl.DistanceResult()))
