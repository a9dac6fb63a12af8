"""Inverse kinematics of arms with a spherical wrist and parallel A2 and A3, in all eight branches."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from py_opw_kinematics import KinematicModel
from py_opw_kinematics import Robot as OpwRobot
from scipy.spatial.transform import RigidTransform

from scanmotion.cell.arm.robot import Robot, Solved, arm_poses
from scanmotion.core.support.streams import fixed_stream

_EDGE_M = 1e-10
"""A wrist this near to the edge of the reach is taken for on it, and solved as far inside [m]."""
_TILT = 1e-7
"""By how much a singular wrist is tilted to be solved, and then straightened again [rad]."""
_AXIS_M = 1e-9
"""A wrist this near to the axis of A1 is taken for on it [m]."""
_ROUND = 12
"""Angles of A1 that are then tried."""
_ANY = np.array([[-2 * np.pi, 2 * np.pi]] * 6)


@dataclass(frozen=True, eq=False, kw_only=True)
class OpwArm:
    """The analytic solver of an arm and how its flange is turned against the URDF's."""

    solver: OpwRobot
    lengths: dict[str, float]
    X_FG: np.ndarray
    """The solver's flange frame G in the URDF's F, a rotation, shape (4, 4)."""

    def __call__(self, X_BF: np.ndarray) -> Solved:
        """All branches of flange poses in the base, shape (n, 4, 4).

        Slots past the eighth are filled only where the wrist stands on the axis of A1.
        """
        X_BG = X_BF @ self.X_FG
        found = self.solver.reach(RigidTransform.from_matrix(X_BG), _ANY)
        joints, sigma = np.array(found.joints), np.array(found.sigma_min)
        self._restore(X_BG, joints, sigma)
        joints, sigma = self._spread(X_BG, joints, sigma)
        extension = np.where(found.extension > -_EDGE_M, np.maximum(found.extension, 0.0), found.extension)
        return Solved(joints=joints, sigma_min=sigma, extension=extension)

    def _restore(self, X_BG: np.ndarray, joints: np.ndarray, sigma: np.ndarray) -> None:
        """Fills in place the branches that exist and were left out.

        py-opw-kinematics drops those whose cosine comes out above one by rounding, as with the elbow
        straight or A5 at zero.
        """
        inner, outer, short, u, dz = self._triangles(X_BG)
        for tilt, side in product((0.0, _TILT), (0, 1)):
            slots = [2 * side, 2 * side + 1, 2 * side + 4, 2 * side + 5]
            within = (short[side] > inner - _EDGE_M) & (short[side] < outer + _EDGE_M)
            rows = np.flatnonzero(within & np.isnan(joints[:, slots, 0]).any(axis=1))
            if len(rows) == 0:
                continue
            s = short[side][rows]
            step = (np.clip(s, inner + _EDGE_M, outer - _EDGE_M) - s) / np.maximum(s, 1e-9)
            moved = self._tilted(X_BG[rows], tilt)
            moved[:, :2, 3] += step[:, None] * u[side][rows]
            moved[:, 2, 3] += step * dz[rows]
            again = self.solver.reach(RigidTransform.from_matrix(moved), _ANY)
            q = np.array(again.joints)
            # The tilt is all of A5: without it the pose is the one that was asked for.
            q[:, :, 4] = np.where(np.abs(q[:, :, 4]) < 2 * tilt, 0.0, q[:, :, 4])
            for slot in slots:
                lost = np.isnan(joints[rows, slot, 0])
                joints[rows[lost], slot] = q[lost, slot]
                sigma[rows[lost], slot] = again.sigma_min[lost, slot]

    def _spread(
        self, X_BG: np.ndarray, joints: np.ndarray, sigma: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Adds slots with A1 all round for the poses whose wrist stands on its axis, where A1 is free."""
        p = X_BG[:, :3, 3] - self.lengths["c4"] * X_BG[:, :3, 2]
        rows = np.flatnonzero(np.hypot(p[:, 0], p[:, 1]) < _AXIS_M)
        if len(rows) == 0 or self.lengths["b"] != 0.0:
            return joints, sigma
        more_q, more_s = [joints], [sigma]
        for angle in 2 * np.pi * np.arange(_ROUND) / _ROUND:
            moved = X_BG[rows]
            moved[:, :2, 3] += _AXIS_M * _direction(angle) - p[rows, :2]
            again = self.solver.reach(RigidTransform.from_matrix(moved), _ANY)
            q, s = np.full_like(joints, np.nan), np.full_like(sigma, np.nan)
            q[rows], s[rows] = again.joints, again.sigma_min
            more_q.append(q)
            more_s.append(s)
        return np.concatenate(more_q, axis=1), np.concatenate(more_s, axis=1)

    def _tilted(self, X_BG: np.ndarray, tilt: float) -> np.ndarray:
        """The poses with the hand tilted about the wrist's centre."""
        X = np.eye(4)
        c, s = np.cos(tilt), np.sin(tilt)
        X[1:3, 1:3] = [[c, -s], [s, c]]
        c4 = self.lengths["c4"]
        X[:3, 3] = c4 * X[:3, 2] - [0.0, 0.0, c4]
        return X_BG @ X

    def _triangles(self, X_BG: np.ndarray) -> tuple[float, float, list, list, np.ndarray]:
        """The triangle of the elbow: least and greatest length, length, level part and height of its base.

        Those in lists are for the arm ahead and for the arm that reaches back.
        """
        k = self.lengths
        p = X_BG[:, :3, 3] - k["c4"] * X_BG[:, :3, 2]
        r = np.sqrt(np.maximum(p[:, 0] ** 2 + p[:, 1] ** 2 - k["b"] ** 2, 0.0))
        azimuth, lean = np.arctan2(p[:, 1], p[:, 0]), np.arctan2(k["b"], r)
        dz = p[:, 2] - k["c1"]
        fore = np.hypot(k["a2"], k["c3"])
        ahead, back = r - k["a1"], r + k["a1"]
        u = [ahead[:, None] * _direction(azimuth - lean), back[:, None] * _direction(azimuth + lean)]
        return abs(k["c2"] - fore), k["c2"] + fore, [np.hypot(ahead, dz), np.hypot(back, dz)], u, dz


def _direction(angle: np.ndarray | float) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def opw_arm(robot: Robot) -> OpwArm | None:
    """Finds the solver's parameters from the URDF's axes: offsets by quarter turns, signs by trial.

    The parameters are those of Brandstoetter, Angerer and Hofbaur (2014), "An analytical solution of the
    inverse kinematics problem of industrial serial manipulators with an ortho-parallel basis and a spherical
    wrist"; what is returned has been checked against the URDF's own kinematics. None where the arm is not of
    this kind.
    """
    q = fixed_stream("opw_check").uniform(-2, 2, (6, 6))
    target = arm_poses(robot, q)[:, 6] @ robot.X_6F
    for turns in product((0, -1, 1), repeat=2):
        up = np.array([0.0, *(np.pi / 2 * t for t in turns), 0.0, 0.0, 0.0])
        lengths = _lengths(robot, up)
        if lengths is None:
            continue
        for flips in product((False, True), repeat=6):
            solver = opw_solver(lengths, up, flips)
            got = opw_poses(solver, q)
            R_FG = np.swapaxes(target[:, :3, :3], 1, 2) @ got[:, :3, :3]
            off = np.abs(got[:, :3, 3] - target[:, :3, 3]).max()
            if off < 1e-6 and np.abs(R_FG - R_FG[0]).max() < 1e-6:
                X_FG = np.eye(4)
                X_FG[:3, :3] = np.round(R_FG[0], 12)
                return OpwArm(solver=solver, lengths=lengths, X_FG=X_FG)
    return None


def opw_solver(lengths: dict[str, float], offsets: np.ndarray, flips: Sequence[bool]) -> OpwRobot:
    """The library's solver; what it is not given it takes as zero.

    Args:
        lengths: a1, a2, b, c1 to c4 [m].
        offsets: of the joints, shape (6,) [rad].
        flips: which joints turn the other way, six.
    """
    o1, o2, o3, o4, o5, o6 = (float(x) for x in offsets)
    f1, f2, f3, f4, f5, f6 = flips
    model = KinematicModel(
        a1=lengths["a1"], a2=lengths["a2"], b=lengths["b"], c1=lengths["c1"], c2=lengths["c2"],
        c3=lengths["c3"], c4=lengths["c4"], offsets=(o1, o2, o3, o4, o5, o6),
        flip_axes=(f1, f2, f3, f4, f5, f6),
    )  # fmt: skip
    return OpwRobot(model, degrees=False)


def opw_poses(solver: OpwRobot, q: np.ndarray) -> np.ndarray:
    """The solver's own flange, shape (n, 4, 4) [m], for joints of shape (n, 6) [rad]."""
    poses: list[np.ndarray] = []
    for row in q:
        a, b, c, d, e, f = (float(x) for x in row)
        poses.append(solver.forward((a, b, c, d, e, f)).as_matrix())
    return np.array(poses)


def _lengths(robot: Robot, q_up: np.ndarray) -> dict[str, float] | None:
    """Lengths of the arm where `q_up` stretches it straight up; None where it does not."""
    frames = arm_poses(robot, q_up[None])[0]
    p2, p3, wrist = frames[2, :3, 3], frames[3, :3, 3], frames[5, :3, 3]
    flange = (frames[6] @ robot.X_6F)[:3, 3]
    straight = np.array([p3[0] - p2[0], flange[0] - wrist[0], flange[1] - wrist[1]])
    if np.abs(straight).max() > 1e-6 or p3[2] <= p2[2] or wrist[2] <= p3[2]:
        return None
    return {
        "a1": float(p2[0]), "a2": float(wrist[0] - p3[0]), "b": float(wrist[1]), "c1": float(p2[2]),
        "c2": float(p3[2] - p2[2]), "c3": float(wrist[2] - p3[2]), "c4": float(flange[2] - wrist[2]),
    }  # fmt: skip
