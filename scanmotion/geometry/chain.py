"""Forward kinematics of a chain of six turning joints: batches in numpy, one configuration compiled.

Each joint turns about an axis of its own frame, which stands at a fixed pose in the link before it, as in a
URDF.
"""

import numpy as np

from scanmotion.geometry.jit import njit
from scanmotion.geometry.se3 import rotations


def chain_poses(X_PJ: np.ndarray, axes: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Poses of the base and of links 1..6 in the base, shape (n, 7, 4, 4).

    Args:
        X_PJ: pose of each joint's frame in its parent at zero, shape (6, 4, 4).
        axes: unit axis of each joint in its own frame, shape (6, 3).
        q: joint positions, shape (n, 6) [rad].
    """
    R = rotations(axes, q)
    out = np.zeros((len(q), 7, 4, 4))
    out[:, 0] = np.eye(4)
    joint = np.zeros((len(q), 4, 4))
    joint[:, 3, 3] = 1.0
    for i in range(6):
        joint[:, :3, :3] = R[:, i]
        out[:, i + 1] = out[:, i] @ (X_PJ[i] @ joint)
    return out


def chain_jacobian(X_PJ: np.ndarray, axes: np.ndarray, X_6F: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Angular (rows 0..2) and linear velocity of the flange in the base per joint speed, shape (n, 6, 6).

    Args:
        X_PJ: as in `chain_poses`, with axes and q.
        axes: shape (6, 3).
        X_6F: flange in link 6, shape (4, 4).
        q: shape (n, 6) [rad].
    """
    frames = chain_poses(X_PJ, axes, q)
    turning = np.einsum("nkij,kj->nki", frames[:, 1:, :3, :3], axes)
    tip = (frames[:, 6] @ X_6F)[:, None, :3, 3]
    J = np.concatenate([turning, np.cross(turning, tip - frames[:, 1:, :3, 3])], axis=2)
    return np.swapaxes(J, 1, 2)


@njit(cache=True)
def link_frames(q, chain, out):
    """Fills `out` (8, 3, 4) with rotations and origins in W of links 0..6 and the flange (index 7).

    For compiled code: q (6,) [rad]; chain is (X_PJ (6, 4, 4), axes (6, 3), X_WB (4, 4), X_6F (4, 4)).
    """
    X_PJ, axes, X_WB, X_6F = chain
    for r in range(3):
        for c in range(4):
            out[0, r, c] = X_WB[r, c]
    R = np.empty((3, 3))
    for i in range(6):
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        s, c = np.sin(q[i]), np.cos(q[i])
        v = 1.0 - c
        R[0, 0], R[0, 1], R[0, 2] = c + x * x * v, x * y * v - z * s, x * z * v + y * s
        R[1, 0], R[1, 1], R[1, 2] = y * x * v + z * s, c + y * y * v, y * z * v - x * s
        R[2, 0], R[2, 1], R[2, 2] = z * x * v - y * s, z * y * v + x * s, c + z * z * v
        for r in range(3):
            p = out[i, r, 3]
            for k in range(3):
                p += out[i, r, k] * X_PJ[i, k, 3]
            out[i + 1, r, 3] = p
            for col in range(3):
                total = 0.0
                for k in range(3):
                    a = 0.0
                    for m in range(3):
                        a += X_PJ[i, k, m] * R[m, col]
                    total += out[i, r, k] * a
                out[i + 1, r, col] = total
    for r in range(3):
        p = out[6, r, 3]
        for k in range(3):
            p += out[6, r, k] * X_6F[k, 3]
        out[7, r, 3] = p
        for col in range(3):
            total = 0.0
            for k in range(3):
                total += out[6, r, k] * X_6F[k, col]
            out[7, r, col] = total
