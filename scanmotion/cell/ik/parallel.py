"""Inverse kinematics of arms whose A2, A3 and A4 are parallel (Universal Robots), in all eight branches.

The closed form of Hawkins (2013), "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms",
written on the axes of the URDF at its zero pose instead of Denavit-Hartenberg parameters, so that signs,
offsets and the turn of base and flange follow from the model.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.cell.arm.robot import Robot, Solved, arm_poses, clean_angle, least_singular, rotations
from scanmotion.cell.ik.polish import polished

_EDGE_M = 1e-9
"""A wrist this far outside the reach is taken for on its edge [m]."""

_SQUARE = 1e-4
"""Axes this near to parallel, to right angles and to meeting are taken for so [rad, m]; see `polished`."""
_EXACT = 1e-12
_ROUND = 12
"""Angles of A6 that are tried where it is free."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ParallelArm:
    """An arm by its axes at zero, in the base: directions w, and points p on them."""

    robot: Robot
    w: np.ndarray
    """Shape (6, 3)."""
    p: np.ndarray
    """Shape (6, 3) [m]; those of A5 and A6 are the same point, where the two meet."""
    X_BF0: np.ndarray
    """Flange at zero, shape (4, 4)."""
    rough: bool = False
    """Whether axes are parallel only nearly, so that answers are led onto the pose by Newton's steps."""

    def __call__(self, X_BF: np.ndarray) -> Solved:
        """All branches of flange poses in the base, shape (n, 4, 4); slot 4 a + 2 b + c for A1, A5 and A3.

        Slots past the eighth are filled only where A6 is in line with A4, so that its angle is free.
        """
        X = X_BF @ np.linalg.inv(self.X_BF0)
        joints, short, singular = self._slots(X, 0.0)
        if singular.any():
            more = [(joints, short)]
            for angle in 2 * np.pi * np.arange(1, _ROUND) / _ROUND:
                q, gap, _ = self._slots(X, angle)
                more.append((q, np.where(singular, gap, np.inf)))
            joints, short = (np.concatenate(parts, axis=1) for parts in zip(*more, strict=True))
        joints[short > _EDGE_M] = np.nan
        if self.rough:
            joints = polished(self.robot, joints, X_BF)
        least = short.min(axis=1, initial=np.inf)
        found = np.isfinite(joints[:, :, 0])
        joints[found] = clean_angle(joints[found])
        sigma = np.full(found.shape, np.nan)
        sigma[found] = least_singular(self.robot, joints[found])
        extension = -np.where(least > _EDGE_M, least, np.minimum(least, 0.0))
        return Solved(joints=joints, sigma_min=sigma, extension=extension)

    def _slots(self, X: np.ndarray, free: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eight slots of joints, by how much each is out of reach, and whether A6 was given `free`."""
        n = len(X)
        R, wrist = X[:, :3, :3], X[:, :3, :3] @ self.p[5] + X[:, :3, 3]
        joints, short, singular = np.empty((n, 8, 6)), np.empty((n, 8)), np.empty((n, 8), bool)
        for a in (0, 1):
            q1, off_axis = self._first(wrist, a)
            back = rotations(self.w[:1], -q1[:, None])[:, 0]
            Q, c = back @ R, np.einsum("nij,nj->ni", back, wrist - self.p[0]) + self.p[0]
            for b in (0, 1):
                q5, q6, theta, alone = self._hand(Q, b, free)
                for e in (0, 1):
                    q2, q3, q4, gap = self._elbow(c, theta, e)
                    slot = 4 * a + 2 * b + e
                    short[:, slot], singular[:, slot] = np.maximum(off_axis, gap), alone
                    joints[:, slot] = np.stack([q1, q2, q3, q4, q5, q6], axis=1)
        return joints, short, singular

    def _first(self, wrist: np.ndarray, a: int) -> tuple[np.ndarray, np.ndarray]:
        """A1 brings the plane of A2..A4 to the wrist; and by how much the wrist is too near to A1 [m]."""
        z, h = self.w[0], self.w[1]
        d = wrist - self.p[0]
        away = d - (d @ z)[:, None] * z
        rho = np.linalg.norm(away, axis=1)
        k = float((self.p[5] - self.p[0]) @ h)
        bearing = np.arctan2(away @ np.cross(z, h), away @ h)
        half = np.arctan2(np.sqrt(np.maximum(rho**2 - k**2, 0.0)), k)
        return bearing + (half if a else -half), abs(k) - rho

    def _hand(self, Q: np.ndarray, b: int, free: float) -> tuple[np.ndarray, ...]:
        """A5, A6 and the sum of the turns about A2..A4, from the rotation that they make together.

        In line with A4, A6 turns nothing that A4 does not: there it is given the angle `free`.
        """
        h, w5, w6 = self.w[1], self.w[4], self.w[5]
        now = Q @ w6
        size = np.arctan2(np.linalg.norm(np.cross(now, h), axis=1), now @ h)
        to_h = np.arctan2(np.cross(w6, h) @ w5, w6 @ h)
        q5 = to_h + (size if b else -size)
        R5 = rotations(w5[None], q5[:, None])[:, 0]
        across = np.eye(3) - np.outer(w6, w6)
        u, g = h @ R5 @ across, h @ Q @ across
        singular = np.linalg.norm(u, axis=1) < 1e-9
        q6 = np.where(singular, free, np.arctan2(np.cross(g, u) @ w6, (g * u).sum(axis=1)))
        T = Q @ np.swapaxes(R5 @ rotations(w6[None], q6[:, None])[:, 0], 1, 2)
        theta = np.arctan2(np.einsum("ni,i->n", T @ w5, np.cross(h, w5)), (T @ w5) @ w5)
        return q5, q6, theta, singular

    def _elbow(self, c: np.ndarray, theta: np.ndarray, e: int) -> tuple[np.ndarray, ...]:
        """A2, A3, A4 in the plane, and by how much the two long links are too short or too long [m]."""
        h = self.w[1]
        turn = rotations(h[None], theta[:, None])[:, 0]
        v = self._flat(c - turn @ (self.p[5] - self.p[3]) - self.p[1])
        upper, fore = self._flat(np.stack([self.p[2] - self.p[1], self.p[3] - self.p[2]]))
        L2, L3, s = np.hypot(*upper), np.hypot(*fore), np.hypot(v[:, 0], v[:, 1])
        gap = np.maximum(s - (L2 + L3), abs(L2 - L3) - s)
        bend = np.arccos(np.clip((s**2 - L2**2 - L3**2) / (2 * L2 * L3), -1.0, 1.0)) * (1 if e else -1)
        first = np.arctan2(v[:, 1], v[:, 0]) - np.arctan2(L3 * np.sin(bend), L2 + L3 * np.cos(bend))
        at_zero = [np.arctan2(y, x) for x, y in (upper, fore)]
        sign = self.w[1:4] @ h
        t2, t3 = first - at_zero[0], bend - (at_zero[1] - at_zero[0])
        return t2 * sign[0], t3 * sign[1], (theta - t2 - t3) * sign[2], gap

    def _flat(self, v: np.ndarray) -> np.ndarray:
        """Vectors in the plane across A2, shape (n, 2)."""
        x = self.w[0]
        return np.stack([v @ x, v @ np.cross(self.w[1], x)], axis=1)


def parallel_arm(robot: Robot) -> ParallelArm | None:
    """The solver of an arm with A2, A3, A4 parallel and at right angles to A1 and A5, and A6 meeting A5.

    None where the arm is not of this kind.
    """
    frames = arm_poses(robot, np.zeros((1, 6)))[0]
    w = np.einsum("kij,kj->ki", frames[1:, :3, :3], robot.axes)
    p = frames[1:, :3, 3].copy()
    h = w[1]
    square = np.array([w[0] @ h, h @ w[4], w[4] @ w[5], 1 - abs(w[2] @ h), 1 - abs(w[3] @ h)])
    if np.abs(square).max() > _SQUARE or abs(np.cross(w[4], w[5]) @ (p[5] - p[4])) > _SQUARE:
        return None
    meet = p[4] + ((p[5] - p[4]) @ w[4]) * w[4]
    p[4] = p[5] = meet
    rough = bool(np.abs(square).max() > _EXACT)
    return ParallelArm(robot=robot, w=w, p=p, X_BF0=frames[6] @ robot.X_6F, rough=rough)
