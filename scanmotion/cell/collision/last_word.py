"""The last word: Drake judges the motion that is emitted, whatever the planner's fast filter has called free.

Guarantee: where nothing is found, arm and tool keep every clearance less `TOLERANCE_M`, and touch nothing,
at each written sample and at each instant between two of them, with the joints moving evenly in between. It
holds for the solids as Drake's parser reads them and for the true triangles of the part, for every pair but
those in `LastWord.not_held`; which those are is worked out by Drake, not taken from the planner.

How: the motion is cut where something can have moved by `COARSE_M` relative to something else, in metres, not
in radians. There Drake's SceneGraphCollisionChecker asks for the clearance and half a step besides, so that
what it passes is free up to the next cut. What it does not pass is cut at every `FINE_M`. Drake takes the
part as its convex hull: where only the hull is too near, the triangles are asked (FCL).

One instance belongs to one thread.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import fcl
import numpy as np
from pydrake.common import Parallelism
from pydrake.geometry import Box, Cylinder, GeometryId, SceneGraphInspector, Sphere
from pydrake.multibody.tree import BodyIndex

from scanmotion.cell.collision.drake_pairs import GUIDED_M, NotHeld, guided_carriers, not_held
from scanmotion.cell.drake_scene import DrakeCell
from scanmotion.cell.kinematics import flange_poses, link_poses, object_poses
from scanmotion.cell.model import Cell
from scanmotion.core.finding import Finding
from scanmotion.core.trajectory import Trajectory

COARSE_M = 0.016
FINE_M = 0.002
"""Steps between checked configurations, by the way of the fastest point of robot and part together [m]."""
TOLERANCE_M = 1e-3
"""By how much less than the clearance a checked configuration may keep [m]; the judge's is the same."""
_STEP_RAD = 0.02
"""Joints turn at most this far between two poses by which the way is measured: chords are then arcs."""
_ARC = 1.001
"""Greatest ratio of an arc to its chord at that step, and more."""
_MOST_POSES = 4_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class LastWord:
    """What Drake says of a trajectory."""

    findings: tuple[Finding, ...]
    """Empty where it agrees with the planner that all is free."""
    checked: int
    """How many configurations it was asked about."""
    way_m: float
    """Length of the way of the fastest point of robot and part [m]."""
    by_triangles: int
    """How many of the configurations the part's hull was too near to, so that its triangles decided."""
    not_held: tuple[NotHeld, ...] = ()
    """Every pair that Drake did not hold apart, with the reason."""


def last_word(cell: Cell, trajectory: Trajectory) -> LastWord:
    """Checks the whole trajectory in Drake; see the module for what an empty answer promises.

    Args:
        cell: the cell, with the part.
        trajectory: what is emitted.
    """
    return DrakeJudge(cell).judge(trajectory)


class DrakeJudge:
    """The plant of a cell with the part's hull, and the part's triangles beside it.

    Args:
        cell: the cell, with or without a part.
    """

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self._drake = DrakeCell(cell, hull=True, own_pairs=True)
        self._guided = guided_carriers(cell, self._drake)
        self.not_held = not_held(cell, self._drake)
        self._drake.leave_out([ids for pair in self.not_held for ids in pair.ids])
        process = cell.settings.process
        self._asked = max(process.clearance_m - TOLERANCE_M, FINE_M / 2)
        self._asked_self = max(process.self_clearance_m - TOLERANCE_M, FINE_M / 2)
        self._by_triangles = 0
        table = self._drake.plant.GetModelInstanceByName("turntable")
        self._table = self._drake.plant.GetBodyByName("turntable", table).index()

    def judge(self, trajectory: Trajectory) -> LastWord:
        """Checks every sample of a trajectory and the motion between them."""
        t, q = _resampled(trajectory.t, trajectory.q)
        way = self._way(q)
        marks = _marks(0.0, float(way[-1]), COARSE_M)
        half = (marks[1] - marks[0]) / 2 if len(marks) > 1 else 0.0
        at = _between(marks, way, t)
        free = self._free(_between(at, t, q), self._asked + half, self._asked_self + half)
        near = marks[~free]
        checked, self._by_triangles = len(marks), 0
        worst: dict[tuple[str, str], tuple[float, float, float]] = {}
        if len(near):
            fine = np.unique(np.concatenate([_marks(m - half, m + half, FINE_M) for m in near]))
            fine = fine[(fine >= 0.0) & (fine <= way[-1])]
            at = _between(fine, way, t)
            rows = _between(at, t, q)
            checked += len(rows)
            for n in np.flatnonzero(~self._free(rows, self._asked, self._asked_self)):
                for pair, distance, asked in self._too_near(rows[n]):
                    if distance < worst.get(pair, (np.inf, 0.0, 0.0))[0]:
                        worst[pair] = distance, asked, float(at[n])
        findings = tuple(
            _finding(*item) for item in sorted(worst.items(), key=lambda item: (item[1][0], item[0]))
        )
        return LastWord(
            findings=findings, checked=checked, way_m=float(way[-1]), by_triangles=self._by_triangles,
            not_held=self.not_held,
        )  # fmt: skip

    def _free(self, q: np.ndarray, to_world: float, to_self: float) -> np.ndarray:
        """Whether Drake finds these clearances kept in each row of q (n, 7), the part as its hull."""
        checker = self._drake.checker
        checker.SetPaddingAllRobotEnvironmentPairs(to_world)
        checker.SetPaddingAllRobotRobotPairs(to_self)
        self._drake.keep_apart(self._guided, min(to_self, GUIDED_M + to_self - self._asked_self))
        rows = list(self._drake.positions(q))
        return np.array(checker.CheckConfigsCollisionFree(rows, parallelize=Parallelism(1)), dtype=bool)

    def _too_near(self, q: np.ndarray) -> list[tuple[tuple[str, str], float, float]]:
        """Bodies too near to each other in one configuration (7,): names, distance and what is asked [m]."""
        checker, plant = self._drake.checker, self._drake.plant
        found = checker.CalcRobotClearance(self._drake.positions(q[None])[0], 0.0)
        out = []
        for a, b, excess in zip(found.robot_indices(), found.other_indices(), found.distances(), strict=True):
            if excess >= 0.0:
                continue
            names = plant.get_body(a).name(), plant.get_body(b).name()
            asked = float(checker.GetPaddingBetween(a, b))
            distance = float(excess) + asked
            if b == self._table:
                self._by_triangles += 1
                distance = self._triangle_distance(q, int(a), enough=asked)
                names = names[0], self.cell.part.name if self.cell.part is not None else "part"
            if distance < asked:
                out.append((names, distance, asked))
        return out

    def _triangle_distance(self, q: np.ndarray, body: int, *, enough: float) -> float:
        """Distance of one of the robot's bodies to the part's true triangles [m]; -1e-6 where they meet."""
        # The stubs of pydrake know no arrays.
        plant: Any = self._drake.plant
        context = self._drake.context
        plant.SetPositions(context, self._drake.positions(q[None])[0])
        X_WL: np.ndarray = plant.EvalBodyPoseInWorld(context, plant.get_body(BodyIndex(body))).GetAsMatrix4()
        X_WO = object_poses(self.cell, q[None])[0]
        self._part.setTransform(fcl.Transform(X_WO[:3, :3], X_WO[:3, 3]))
        least = np.inf
        for shape, X_LG in self._solids[body]:
            X = X_WL @ X_LG
            shape.setTransform(fcl.Transform(X[:3, :3], X[:3, 3]))
            if fcl.collide(self._part, shape, fcl.CollisionRequest(), fcl.CollisionResult()):
                return -1e-6
            least = min(least, fcl.distance(self._part, shape, fcl.DistanceRequest(), fcl.DistanceResult()))
        assert self.cell.part is not None
        if least >= enough and self.cell.part.closed and self._inside(X_WL, X_WO, body):
            return -1e-6
        return float(least)

    def _inside(self, X_WL: np.ndarray, X_WO: np.ndarray, body: int) -> bool:
        """Whether the middle of a body's solid lies inside the closed part, where no surfaces meet."""
        part = self.cell.part
        assert part is not None
        for _, X_LG in self._solids[body]:
            p = np.linalg.inv(X_WO) @ (X_WL @ X_LG)[:, 3]
            if ((p[:3] > part.bounds[0]) & (p[:3] < part.bounds[1])).all() and _winding(part, p[:3]) > 0.5:
                return True
        return False

    @cached_property
    def _part(self) -> Any:
        part = self.cell.part
        assert part is not None
        model = fcl.BVHModel()
        model.beginModel(len(part.vertices), len(part.triangles))
        model.addSubModel(np.ascontiguousarray(part.vertices), np.ascontiguousarray(part.triangles))
        model.endModel()
        return fcl.CollisionObject(model, fcl.Transform())

    @cached_property
    def _solids(self) -> dict[int, list[tuple[Any, np.ndarray]]]:
        """The solids of each of the robot's bodies, as Drake has read them, for FCL."""
        inspector, out = self._drake.inspector, {}
        for index in self._drake.robot_bodies:
            body = self._drake.plant.get_body(index)
            ids = self._drake.plant.GetCollisionGeometriesForBody(body)
            out[int(index)] = [_for_fcl(inspector, i) for i in ids]
        return out

    def _way(self, q: np.ndarray) -> np.ndarray:
        """Way of the robot's fastest point plus the part's, from the first row of q (n, 7) on, (n,) [m]."""
        frames = np.concatenate([link_poses(self.cell, q), flange_poses(self.cell, q)[:, None]], axis=1)
        robot = np.zeros(len(q) - 1)
        for link, radius in self._radii.items():
            X = frames[:, link]
            shift = np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1)
            turn = np.sqrt((np.diff(X[:, :3, :3], axis=0) ** 2).sum(axis=(1, 2)) / 2)
            robot = np.maximum(robot, shift + turn * radius)
        part = self.cell.part
        if part is not None:
            p = part.vertices @ self.cell.X_TO[:3, :3].T + self.cell.X_TO[:3, 3]
            robot = robot + np.abs(np.diff(q[:, 6])) * float(np.linalg.norm(p[:, :2], axis=1).max())
        return np.concatenate([[0.0], np.cumsum(_ARC * robot)])

    @cached_property
    def _radii(self) -> dict[int, float]:
        """Greatest distance of a solid's point from the frame of its link, by link 1..6 [m]."""
        drake, cell = self._drake, self.cell
        plant: Any = drake.plant
        inspector: Any = drake.inspector
        context = drake.context
        plant.SetPositions(context, np.zeros(plant.num_positions()))
        frames = link_poses(cell, np.zeros((1, 7)))[0]
        joints = [plant.GetJointByName(n) for n in cell.settings.robot.joints]
        moved = [set(plant.GetBodiesKinematicallyAffectedBy([j.index()])) for j in joints]
        radii: dict[int, float] = {}
        for index in drake.robot_bodies:
            link = sum(index in bodies for bodies in moved)
            if link == 0:
                continue
            X_WB = plant.EvalBodyPoseInWorld(context, plant.get_body(index)).GetAsMatrix4()
            for i in plant.GetCollisionGeometriesForBody(plant.get_body(index)):
                p = (X_WB @ inspector.GetPoseInFrame(i).GetAsMatrix4())[:3, 3]
                far = float(np.linalg.norm(p - frames[link][:3, 3])) + _radius(inspector.GetShape(i))
                radii[link] = max(radii.get(link, 0.0), far)
        return radii


def _resampled(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The trajectory with samples put in where a joint turns farther than a step; those that were stay."""
    if len(t) < 2:
        return np.repeat(t, 2), np.repeat(q, 2, axis=0)
    parts = np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1) / _STEP_RAD).clip(1, _MOST_POSES // len(t))
    count = np.concatenate([[0], np.cumsum(parts)])
    fine = np.interp(np.arange(int(count[-1]) + 1), count, t)
    return fine, _between(fine, t, q)


def _between(at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Columns of y (n,) or (n, k) over increasing x (n,), read at `at`."""
    if y.ndim == 1:
        return np.interp(at, x, y)
    return np.column_stack([np.interp(at, x, column) for column in y.T])


def _marks(low: float, high: float, step: float) -> np.ndarray:
    """Even marks from low to high, no farther apart than a step."""
    return np.linspace(low, high, max(int(np.ceil((high - low) / step)), 1) + 1)


def _finding(pair: tuple[str, str], found: tuple[float, float, float]) -> Finding:
    distance, asked, t = found
    code = "collision" if distance <= 0.0 else "clearance"
    how = "touch" if distance <= 0.0 else f"come within {distance * 1e3:.1f} mm"
    text = f"Drake finds that {pair[0]} and {pair[1]} {how} at {t:.2f} s, where the planner saw no fault"
    return Finding(code=code, message=text, where=f"{pair[0]}, {pair[1]}", value=distance, limit=asked, t=t)


def _radius(shape: Any) -> float:
    """Distance of a shape's farthest point from its origin [m]."""
    if isinstance(shape, Box):
        return float(np.linalg.norm(shape.size())) / 2
    if isinstance(shape, Cylinder):
        return float(np.hypot(shape.radius(), shape.length() / 2))
    if isinstance(shape, Sphere):
        return float(shape.radius())
    return float(np.linalg.norm(_hull(shape)[0], axis=1).max())


def _hull(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Corners (v, 3) [m] and triangles (t, 3) of a mesh's convex hull, which is how Drake takes it."""
    from scipy.spatial import ConvexHull

    hull = shape.GetConvexHull()
    points = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    return points, ConvexHull(points).simplices.astype(np.int64)


def _for_fcl(inspector: SceneGraphInspector, geometry: GeometryId) -> tuple[Any, np.ndarray]:
    """A solid for FCL, and its pose in its body, shape (4, 4)."""
    shape: Any = inspector.GetShape(geometry)
    pose: Any = inspector.GetPoseInFrame(geometry)
    X_BG: np.ndarray = pose.GetAsMatrix4()
    if isinstance(shape, Box):
        solid = fcl.Box(*shape.size())
    elif isinstance(shape, Cylinder):
        solid = fcl.Cylinder(shape.radius(), shape.length())
    elif isinstance(shape, Sphere):
        solid = fcl.Sphere(shape.radius())
    else:
        points, triangles = _hull(shape)
        solid = fcl.BVHModel()
        solid.beginModel(len(points), len(triangles))
        solid.addSubModel(points, triangles)
        solid.endModel()
    return fcl.CollisionObject(solid, fcl.Transform()), X_BG


def _winding(part: Any, p: np.ndarray) -> float:
    """Winding number of the part's triangles about a point (3,): near 1 inside, near 0 outside.

    Source: van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30(2), 1983, doi 10.1109/TBME.1983.325207.
    """
    a, b, c = (part.vertices[part.triangles[:, k]] - p for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    top = np.einsum("ij,ij->i", a, np.cross(b, c))
    low = la * lb * lc + lc * np.einsum("ij,ij->i", a, b)
    low += la * np.einsum("ij,ij->i", b, c) + lb * np.einsum("ij,ij->i", c, a)
    return abs(float(np.arctan2(top, low).sum())) / (2 * np.pi)
