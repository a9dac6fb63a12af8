"""Distances and collision checks of configurations and edges, in two tiers.

Fast tier: sphere_filter.py, conservative. Exact tier: Drake's checker for arm, tool, table and surroundings,
and FCL on the part's true triangles, or on a light copy of a heavy mesh, whose deviation is taken off. What
the fast tier calls free is free. What it refuses may be free in truth.
"""

from functools import cached_property
from typing import Any

import numpy as np

from scanmotion.cell.arm.robot import Body
from scanmotion.cell.collision.batch import first_free, lattice, sure_points, surely_blocked, tool_blocked
from scanmotion.cell.collision.pairs import GUIDED_M, guided_names
from scanmotion.cell.collision.shapes import box_of, fcl_object
from scanmotion.cell.collision.sphere_filter import edge_free, edges_free, filter_from, margins
from scanmotion.cell.kinematics import link_poses, object_poses
from scanmotion.cell.model import TOOL, Cell
from scanmotion.geometry.parts.working_copy import working_copy
from scanmotion.geometry.se3 import inverse_poses

PAD_M = 0.004
"""Half of the least step along an edge; the fast tier keeps this much more than the clearances [m]."""


class Clearance:
    """The checker of one cell; it belongs to one thread.

    Args:
        cell: the cell, with the part that the arm must not touch.
        clearance: least distance to part and surroundings; default: of the cell [m].
        like: a checker of another layout with the same part, whose distances to the part are used again.
    """

    def __init__(
        self, cell: Cell, *, clearance: float | None = None, like: "Clearance | None" = None
    ) -> None:
        self.cell = cell
        self.clearance = cell.settings.process.clearance_m if clearance is None else clearance
        self.self_clearance = cell.settings.process.self_clearance_m
        grid = like.filter.grid if like is not None and like.cell.part is cell.part else None
        self.filter = filter_from(cell, self.clearance + PAD_M, self.self_clearance + PAD_M, grid=grid)
        f = self.filter
        self._arrays = (f.chain, f.spheres, f.boxes, f.world, f.grid)

    def margins(self, q: np.ndarray, *, enough: float = 0.5) -> np.ndarray:
        """Lower bounds of the distance beyond clearances and pad, (n,) [m]; only signs where negative.

        Neighbours but one, which are always near, count by the way to where they are too near.
        """
        return margins(_rows(q), *self._arrays, enough)

    def fast_free(self, q: np.ndarray) -> np.ndarray:
        """Whether the fast tier calls each row of q (n, 7) free."""
        return self.margins(q, enough=1e-6) >= 0.0

    def first_free(self, q: np.ndarray, starts: np.ndarray, geometry: np.ndarray, most: int) -> np.ndarray:
        """Which rows of q (m, 7) the fast tier calls free, for each owner until `most` of its rows are.

        Args:
            q: rows, those of one owner after those of another [rad].
            starts: the first row of each owner, and m, shape (n + 1,).
            geometry: rows with the same number place arm and table alike, shape (m,).
            most: how many free rows are wanted of each owner.
        """
        return first_free(_rows(q), starts, geometry, most, *self._arrays)

    def surely_blocked(self, q: np.ndarray) -> np.ndarray:
        """Whether each row of q (n, 7) is blocked beyond doubt: by points inside the robot, shape (n,).

        Between this and `fast_free` only the exact tier knows.
        """
        f = self.filter
        return surely_blocked(
            _rows(q), self._sure, PAD_M, f.chain, f.spheres, f.boxes, self._solid, f.world, f.grid
        )

    def tool_blocked(self, X_WS: np.ndarray, e1: np.ndarray) -> np.ndarray:
        """Whether the tool alone is blocked beyond doubt with the scanner at X_WS (n, 4, 4), shape (n,).

        Args:
            X_WS: scanner poses.
            e1: the table's angle at each, shape (n,) [rad].
        """
        X_WF = np.ascontiguousarray(X_WS @ inverse_poses(self.cell.X_FS))
        f = self.filter
        return tool_blocked(X_WF, np.ascontiguousarray(e1), self._tool, PAD_M, f.world, f.grid)

    @cached_property
    def _tool(self) -> np.ndarray:
        return np.concatenate([lattice(b) for b in self.cell.bodies if b.link == TOOL])

    @cached_property
    def _sure(self) -> np.ndarray:
        return sure_points(self.cell, self.filter.spheres)

    @cached_property
    def _solid(self) -> np.ndarray:
        """Which of the filter's boxes are the bodies themselves, not boxes around cylinders."""
        return np.array([b.shape == "box" for b in self.cell.bodies if b.link <= TOOL])

    def free(self, q: np.ndarray) -> np.ndarray:
        """Whether each row of q (n, 7) keeps all clearances, shape (n,)."""
        q = _rows(q)
        free = self.fast_free(q)
        doubtful = np.flatnonzero(~free)
        free[doubtful] = self.exactly_free(q[doubtful])
        return free

    def exactly_free(self, q: np.ndarray) -> np.ndarray:
        """As `free`, for rows (n, 7) that the fast tier has refused: it is not asked again."""
        q = _rows(q)
        doubtful = np.flatnonzero(~self.surely_blocked(q))
        doubtful = doubtful[self._drake.free(q[doubtful])]
        if self._part is not None and len(doubtful):
            near = self._near_part(q[doubtful], self.clearance)
            ok = ~near
            for i in np.flatnonzero(near):
                ok[i] = self._part_distance(q[doubtful[i]], self.clearance)[0] >= self.clearance
            doubtful = doubtful[ok]
        free = np.zeros(len(q), bool)
        free[doubtful] = True
        return free

    def edges_free(self, qa: np.ndarray, qb: np.ndarray) -> np.ndarray:
        """Whether each straight joint edge between rows of qa and qb (n, 7) keeps the clearances all along.

        Steps are bounded in metres at the farthest point of arm and part, so that a free edge is a promise.
        """
        return edges_free(_rows(qa), _rows(qb), *self._arrays, self.filter.reach, PAD_M)

    def path_free(self, q: np.ndarray) -> tuple[bool, int, tuple[str, str]]:
        """Whether the polyline q (k, 7) is free; else the first blocked edge and the pair that blocks it."""
        q = _rows(q)
        for i in range(max(len(q) - 1, 1)):
            j = min(i + 1, len(q) - 1)
            ok, t = edge_free(q[i], q[j], *self._arrays, self.filter.reach, PAD_M)
            if not ok:
                return False, i, self.distance(q[i] + t * (q[j] - q[i]))[1]
        return True, -1, ("", "")

    def distance(self, q: np.ndarray) -> tuple[float, tuple[str, str]]:
        """Exact distance of the two solids that keep their clearance worst in one configuration (7,) [m].

        It is negative in collision; the second value names the two.
        """
        q = np.asarray(q, dtype=float)
        excess, distance, pair = self._drake.nearest(q)
        if self._part is not None:
            d, name = self._part_distance(q)
            if d - self.clearance < excess:
                return d, (name, self.cell.part.name if self.cell.part else "part")
        return distance, self._named(q, pair)

    def asked(self, pair: tuple[str, str]) -> float:
        """The clearance that a pair named by `distance` has to keep [m]."""
        still = {b.name for b in self.cell.bodies if b.link > TOOL}
        part = self.cell.part.name if self.cell.part else ""
        if still & set(pair) or pair[1] == part:
            return self.clearance
        return min(self.self_clearance, GUIDED_M) if frozenset(pair) in self._guided else self.self_clearance

    @cached_property
    def _guided(self) -> frozenset[frozenset[str]]:
        return guided_names(self.cell)

    @cached_property
    def _drake(self) -> Any:
        from scanmotion.cell.drake_scene import drake_of

        return drake_of(self.cell)

    def _named(self, q: np.ndarray, pair: tuple[str, str]) -> tuple[str, str]:
        """The pair with the nearest solids of tool, table and surroundings in place of the whole."""
        import fcl

        groups = [self._drake.groups.get(name, -1) for name in pair]
        if max(groups) < TOOL or min(groups) < 0:
            return pair
        links = link_poses(self.cell, q)[0]
        frames = [*links, links[6] @ self.cell.robot.X_6F, self.cell.X_WT, np.eye(4)]
        sides: list[list[tuple[str, Any]]] = [[], []]
        for side, group, whole in zip(sides, groups, pair, strict=True):
            for body in self.cell.bodies:
                if body.link == group and (body.name == "floor") == (whole == "floor"):
                    side.append((body.name, fcl_object(body, frames[group] @ body.X_LG)))
        best, names = np.inf, pair
        for a, first in sides[0]:
            for b, other in sides[1]:
                d = -1.0
                if not fcl.collide(first, other, fcl.CollisionRequest(), fcl.CollisionResult()):
                    d = fcl.distance(first, other, fcl.DistanceRequest(), fcl.DistanceResult())
                if d < best:
                    best, names = d, (a, b)
        a, b = (n if g >= TOOL else p for n, g, p in zip(names, groups, pair, strict=True))
        return a, b

    @cached_property
    def _part(self) -> Any:
        """The part's triangles, or those of its light copy, as an FCL object, and the robot's bodies.

        None without a part. What the copy is off is taken from the distances to it.
        """
        part = self.cell.part
        if part is None or not part.is_mesh:
            return None
        import fcl

        light = working_copy(part).part
        model = fcl.BVHModel()
        model.beginModel(len(light.vertices), len(light.triangles))
        model.addSubModel(np.ascontiguousarray(light.vertices), np.ascontiguousarray(light.triangles))
        model.endModel()
        bodies = [b for b in self.cell.bodies if 1 <= b.link <= TOOL]
        shapes = [_near_shape(b) for b in bodies]
        ball = part.bounds.mean(axis=0), float(np.linalg.norm(part.extent)) / 2
        links = np.array([b.link for b in bodies])
        X_LG = np.array([b.X_LG for b in bodies])
        radii = np.array([np.linalg.norm(box_of(b)) for b in bodies])
        return fcl.CollisionObject(model, fcl.Transform()), bodies, shapes, ball, links, X_LG, radii

    def _near_part(self, q: np.ndarray, enough: float) -> np.ndarray:
        """Whether a body's enclosing ball is within `enough` of the part's in each row of q, shape (n,)."""
        _, _, _, (middle, radius), of_link, X_LG, radii = self._part
        links = link_poses(self.cell, q)
        frames = np.concatenate([links, (links[:, 6] @ self.cell.robot.X_6F)[:, None]], axis=1)
        p = (frames[:, of_link] @ X_LG)[:, :, :3, 3]
        X_WO = object_poses(self.cell, q)
        centre = X_WO[:, :3, :3] @ middle + X_WO[:, :3, 3]
        return (np.linalg.norm(p - centre[:, None], axis=2) - radii < radius + enough).any(axis=1)

    def _part_distance(self, q: np.ndarray, enough: float = np.inf) -> tuple[float, str]:
        """Distance between robot and part, and the robot's body; -0.001 where they touch.

        It is exact, or for a heavy mesh less than that by no more than twice what its copy is off.

        Bodies that are further away than `enough` by their enclosing balls are left out.
        """
        import fcl

        obj, bodies, shapes, (middle, radius), of_link, X_LG, radii = self._part
        X_WO = object_poses(self.cell, q)[0]
        obj.setTransform(fcl.Transform(X_WO[:3, :3], X_WO[:3, 3]))
        links = link_poses(self.cell, q)[0]
        frames = np.concatenate([links, (links[6] @ self.cell.robot.X_6F)[None]])
        poses = frames[of_link] @ X_LG
        centre = X_WO[:3, :3] @ middle + X_WO[:3, 3]
        apart = np.linalg.norm(poses[:, :3, 3] - centre, axis=1) - radius - radii
        best, name = 1e3, ""
        off = 0.0 if self.cell.part is None else working_copy(self.cell.part).deviation
        for k in np.argsort(apart, kind="stable"):
            if apart[k] > min(best, enough, 1.0):
                break
            body, shape, X = bodies[k], shapes[k], poses[k]
            shape.setTransform(fcl.Transform(X[:3, :3], X[:3, 3]))
            if fcl.collide(obj, shape, fcl.CollisionRequest(), fcl.CollisionResult()):
                return -1e-3, body.name
            result = fcl.DistanceResult()
            d = fcl.distance(obj, shape, fcl.DistanceRequest(), result)
            if d < best:
                best, name = d, body.name
        return best - off, name


def _near_shape(body: Body) -> Any:
    """A body for distances to the part: cylinders by their boxes."""
    import fcl

    if body.shape == "cylinder":
        return fcl.CollisionObject(fcl.Box(*(2 * box_of(body))), fcl.Transform())
    return fcl_object(body, np.eye(4))


def _rows(q: np.ndarray) -> np.ndarray:
    """Rows (n, 7), contiguous and writable: kernels are compiled anew for any other kind."""
    rows = np.ascontiguousarray(np.atleast_2d(np.asarray(q, dtype=float)))
    return rows if rows.flags.writeable else rows.copy()
