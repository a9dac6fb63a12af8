"""What a motion costs in seconds, before it is planned: transits, sweeps, revolutions.

A transit moves the arm with the scanner on a straight line in W where both ends lie in the same branch of
the arm's first three axes, and evenly in its joints elsewhere; the table turns beside it by its own
ramps. The arm's time is that of one path parameter from rest to rest, capped by the axes' velocities and by
the scanner's transit speed; its acceleration is capped by the axes', and jerk prolongs the ramps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scanmotion.core.tour import Stop
from scanmotion.geometry.jit import copy_into, njit
from scanmotion.geometry.rest_to_rest import jerk_limited_seconds as jerk_limited_seconds
from scanmotion.geometry.rest_to_rest import trapezoid_second

if TYPE_CHECKING:
    from scanmotion.cell.build import Cell


_BASE_RAD = 2.6
"""A greater turn of A1 cannot keep the scanner on a straight line [rad]."""
_WRIST_RAD = 3.0
"""Greater turns of A4 or A6 make the first three axes swing, which costs `_WRIST_S_PER_RAD` [rad]."""
_WRIST_S_PER_RAD = 0.6
"""Fitted to the times of planned transits [s/rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MoveModel:
    """What the cost of a motion depends on: where the scanner is, and what the axes may do."""

    axes: np.ndarray
    """Unit direction of A1..A6 in W where all joints are at zero, positive turns, shape (6, 3)."""
    points: np.ndarray
    """A point on each of these axes, shape (6, 3) [m]."""
    p_WS: np.ndarray
    """Scanner's origin in W where all joints are at zero, shape (3,) [m]."""
    p_WC: np.ndarray
    """Wrist centre in W where all joints are at zero, shape (3,) [m]."""
    v: np.ndarray
    """Greatest joint velocities, shape (7,) [rad/s]."""
    a: np.ndarray
    """Greatest joint accelerations, shape (7,) [rad/s2]."""
    j: np.ndarray
    """Greatest joint jerks, shape (7,) [rad/s3]."""
    transit_speed: float
    """Greatest speed of the scanner in W during a transit [m/s]."""
    scan_speed: float
    """Greatest speed of the scanner relative to the part during a sweep [m/s]."""
    dwell_s: float
    """How long a dwell lasts [s]."""


def move_model(cell: Cell) -> MoveModel:
    """The cell's arm as six screw axes, found from its forward kinematics, and its limits."""
    from scanmotion.cell.kinematics import scanner_poses

    q = np.vstack([np.zeros(7), np.eye(7)[:6]])
    X = np.asarray(scanner_poses(cell, q))
    axes, points = np.empty((6, 3)), np.empty((6, 3))
    for i in range(6):
        axes[i], points[i] = _screw(X[i + 1] @ np.linalg.inv(X[0]))
    process = cell.settings.process
    return MoveModel(
        axes=axes,
        points=points,
        p_WS=np.ascontiguousarray(X[0, :3, 3]),
        p_WC=_nearest_to_axes(axes[3:], points[3:]),
        v=np.array(cell.v_max, dtype=float),
        a=np.array(cell.a_max, dtype=float),
        j=np.array(cell.j_max, dtype=float),
        transit_speed=float(process.transit_speed_m_s),
        scan_speed=float(process.scan_speed_m_s),
        dwell_s=float(process.dwell_s),
    )


def _screw(X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axis and a point on it of a turn by 1 rad."""
    R, p = X[:3, :3], X[:3, 3]
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    w /= np.linalg.norm(w)
    # (I - R) r = p has the axis as its null space: the least-squares solution is its foot point.
    return w, np.linalg.lstsq(np.eye(3) - R, p, rcond=1e-9)[0]


def _nearest_to_axes(axes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The point nearest to some axes in the least-squares sense: where they meet, if they do."""
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    return np.linalg.lstsq(
        across.reshape(-1, 3), np.einsum("nij,nj->ni", across, points).ravel(), rcond=1e-9
    )[0]


@dataclass(frozen=True, eq=False)
class PlacedNodes:
    """Configurations, with all that the time of a transit between them depends on."""

    q: np.ndarray
    """Shape (n, 7) [rad]."""
    p: np.ndarray
    """The scanner's origin in W, shape (n, 3) [m]."""
    change: np.ndarray
    """Its change with each of A1..A6, shape (n, 6, 3) [m]."""
    branch: np.ndarray
    """Which way elbow and shoulder are bent, 0..3, shape (n,)."""

    def __getitem__(self, rows: np.ndarray | slice) -> PlacedNodes:
        return PlacedNodes(self.q[rows], self.p[rows], self.change[rows], self.branch[rows])


def placed_nodes(model: MoveModel, q: np.ndarray | PlacedNodes) -> PlacedNodes:
    """Forward kinematics of configurations (n, 7) or (7,); what is placed already is returned as it is."""
    if isinstance(q, PlacedNodes):
        return q
    q = np.ascontiguousarray(np.atleast_2d(q), dtype=float)
    q = q if q.flags.writeable else q.copy()  # a read-only one would have the kernels compiled anew
    p, change = _tangents(model.axes, model.points, model.p_WS, q)
    return PlacedNodes(q, p, change, _branches(model.axes, model.points, model.p_WC, q))


def joined_nodes(parts: Sequence[PlacedNodes]) -> PlacedNodes:
    """All configurations in one."""
    return PlacedNodes(
        *(np.concatenate([getattr(x, name) for x in parts]) for name in ("q", "p", "change", "branch"))
    )


def scanner_positions(model: MoveModel, q: np.ndarray) -> np.ndarray:
    """The scanner's origin in W, shape (n, 3) [m], for configurations (n, 7)."""
    return placed_nodes(model, q).p


def edge_seconds(cell: Cell, qa: np.ndarray, qb: np.ndarray) -> np.ndarray:
    """Time of transits from rest to rest, shape (n,) [s].

    Args:
        cell: the axes' limits, the transit speed and the scanner's place.
        qa: start configurations, shape (n, 7) [rad].
        qb: end configurations, shape (n, 7) [rad].
    """
    return move_seconds(move_model(cell), qa, qb)


def move_seconds(model: MoveModel, qa: np.ndarray | PlacedNodes, qb: np.ndarray | PlacedNodes) -> np.ndarray:
    """`edge_seconds` for a model made before."""
    return _times(model, True, placed_nodes(model, qa), placed_nodes(model, qb))[:, 0]


def move_matrix(model: MoveModel, qa: np.ndarray | PlacedNodes, qb: np.ndarray | PlacedNodes) -> np.ndarray:
    """Time of a transit from each of qa (n, 7) to each of qb (m, 7), shape (n, m) [s].

    The length of the scanner's way along a joint line is that of the cubic through both ends' tangents, taken
    as the mean of its chord and its control polygon (Gravesen, Computational Geometry 8(1), 1997, 13-31,
    doi 10.1016/0925-7721(95)00054-2).
    """
    return _times(model, False, placed_nodes(model, qa), placed_nodes(model, qb))


def _times(model: MoveModel, paired: bool, a: PlacedNodes, b: PlacedNodes) -> np.ndarray:
    m = model
    return _transits(
        m.v, m.a, float((m.a / m.j).max()), 1.0 / m.v, 1.0 / m.a, 1.0 / m.transit_speed, paired,
        a.q, a.p, a.change, a.branch, b.q, b.p, b.change, b.branch,
    )  # fmt: skip


def revolution_seconds(model: MoveModel) -> float:
    """Time of one whole turn of the table [s]."""
    return float(jerk_limited_seconds(2 * np.pi, model.v[6], model.a[6], model.j[6]))


def stop_seconds(model: MoveModel, stop: Stop) -> float:
    """Time that a stop takes by itself [s]."""
    if stop.kind == "revolution":
        return revolution_seconds(model)
    if stop.kind == "helix":
        turn = abs(float(stop.q_out[6] - stop.q_in[6]))
        return float(jerk_limited_seconds(turn, model.v[6], model.a[6], model.j[6]))
    if stop.kind == "path":
        ways = sum(float(move_seconds(model, way[:1], way[-1:])[0]) for way in stop.ways)
        return ways + sum(stop.dwells)
    return model.dwell_s if stop.path is None else path_seconds(model, stop.path)


def path_seconds(model: MoveModel, path: np.ndarray) -> float:
    """Time of a sweep along a dense joint path with the table still, shape (k, 7) [s].

    One path parameter, the scanner's distance, is driven with the least of what the axes allow along it.
    """
    steps = np.linalg.norm(np.diff(scanner_positions(model, path), axis=0), axis=1)
    length = float(steps.sum())
    if length <= 0.0:
        return 0.0
    rate = np.abs(np.diff(path, axis=0)).max(axis=0) / max(float(steps.mean()), 1e-12)
    rate = np.maximum(rate, 1e-12)
    speed = min(model.scan_speed, float((model.v / rate).min()))
    a, j = float((model.a / rate).min()), float((model.j / rate).min())
    return float(jerk_limited_seconds(length, speed, a, j))


@njit(cache=True)
def _cross(x, y, z, w):
    return y * w[2] - z * w[1], z * w[0] - x * w[2], x * w[1] - y * w[0]


@njit(cache=True, nogil=True)
def _branches(axes, points, p, q):
    """Signs of the elbow and of the wrist centre's side of A1, as bits."""
    out = np.empty(len(q), dtype=np.int64)
    ahead = _cross(axes[0, 0], axes[0, 1], axes[0, 2], axes[1])
    c, arm = np.empty(3), np.empty(3)
    for n in range(len(q)):
        copy_into(c, p)
        bits = 0
        for i in (2, 1):
            w, r = axes[i], points[i]
            c[0], c[1], c[2] = _turned(
                w, np.cos(q[n, i]), np.sin(q[n, i]), c[0] - r[0], c[1] - r[1], c[2] - r[2]
            )
            for m in range(3):
                c[m] += r[m]
            if i == 2:
                a, b = points[1], points[2]
                for m in range(3):
                    arm[m] = c[m] - b[m]
                x, y, z = _cross(b[0] - a[0], b[1] - a[1], b[2] - a[2], arm)
                if x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2] > 0.0:
                    bits |= 1
        a = points[0]
        if (c[0] - a[0]) * ahead[0] + (c[1] - a[1]) * ahead[1] + (c[2] - a[2]) * ahead[2] > 0.0:
            bits |= 2
        out[n] = bits
    return out


@njit(cache=True, nogil=True)
def _tangents(axes, points, p, q):
    """Scanner's origin, shape (n, 3), and its change with each of A1..A6, shape (n, 6, 3)."""
    n = len(q)
    place, change = np.empty((n, 3)), np.zeros((n, 6, 3))
    for k in range(n):
        x, y, z = p[0], p[1], p[2]
        for m in range(5, -1, -1):
            c, s = np.cos(q[k, m]), np.sin(q[k, m])
            w, r = axes[m], points[m]
            x, y, z = _turned(w, c, s, x - r[0], y - r[1], z - r[2])
            change[k, m, 0] = w[1] * z - w[2] * y
            change[k, m, 1] = w[2] * x - w[0] * z
            change[k, m, 2] = w[0] * y - w[1] * x
            for i in range(m + 1, 6):
                t = change[k, i]
                t[0], t[1], t[2] = _turned(w, c, s, t[0], t[1], t[2])
            x, y, z = x + r[0], y + r[1], z + r[2]
        place[k, 0], place[k, 1], place[k, 2] = x, y, z
    return place, change


@njit(cache=True)
def _turned(w, c, s, x, y, z):
    d = (w[0] * x + w[1] * y + w[2] * z) * (1.0 - c)
    return (
        c * x + s * (w[1] * z - w[2] * y) + d * w[0],
        c * y + s * (w[2] * x - w[0] * z) + d * w[1],
        c * z + s * (w[0] * y - w[1] * x) + d * w[2],
    )


@njit(cache=True)
def _speed_of(change, k, qa, n, qb, m):
    """Change of the scanner at configuration k along the joint line from a to b."""
    x, y, z = 0.0, 0.0, 0.0
    for i in range(6):
        d = qb[m, i] - qa[n, i]
        x += change[k, i, 0] * d
        y += change[k, i, 1] * d
        z += change[k, i, 2] * d
    return x, y, z


@njit(cache=True)
def _bent_way(qa, pa, ca, n, qb, pb, cb, m):
    """Length of the scanner's way along a joint line."""
    ex, ey, ez = pb[m, 0] - pa[n, 0], pb[m, 1] - pa[n, 1], pb[m, 2] - pa[n, 2]
    ax, ay, az = _speed_of(ca, n, qa, n, qb, m)
    bx, by, bz = _speed_of(cb, m, qa, n, qb, m)
    hull = np.sqrt(ax * ax + ay * ay + az * az) + np.sqrt(bx * bx + by * by + bz * bz)
    mx, my, mz = 3.0 * ex - ax - bx, 3.0 * ey - ay - by, 3.0 * ez - az - bz
    hull += np.sqrt(mx * mx + my * my + mz * mz)
    return (np.sqrt(ex * ex + ey * ey + ez * ez) + hull / 3.0) / 2.0


@njit(cache=True)
def _joint_limits(per_v, per_a, qa, n, qb, m):
    """Least durations of a joint line at the axes' velocities, and their squares at the accelerations."""
    rate, slow = 0.0, 0.0
    for i in range(6):
        x = abs(qb[m, i] - qa[n, i])
        y, z = x * per_v[i], x * per_a[i]
        rate = y if y > rate else rate
        slow = z if z > slow else slow
    return rate, slow


@njit(cache=True, nogil=True)
def _transits(v, a, soft, per_v, per_a, per_tcp, paired, qa, pa, ca, ba, qb, pb, cb, bb):
    """Times from each a to each b, shape (n, m), or where `paired` from each a to its b, shape (n, 1)."""
    out = np.empty((len(qa), 1 if paired else len(qb)))
    for n in range(out.shape[0]):
        for k in range(out.shape[1]):
            m = n if paired else k
            rate, slow = _joint_limits(per_v, per_a, qa, n, qb, m)
            if ba[n] == bb[m] and abs(qb[m, 0] - qa[n, 0]) < _BASE_RAD:
                x, y, z = pb[m, 0] - pa[n, 0], pb[m, 1] - pa[n, 1], pb[m, 2] - pa[n, 2]
                way = np.sqrt(x * x + y * y + z * z)
            else:
                way = _bent_way(qa, pa, ca, n, qb, pb, cb, m)
            rate = max(rate, way * per_tcp)
            # The path parameter's greatest speed is 1 / rate, its acceleration 1 / slow.
            seconds = rate + slow / rate if rate * rate >= slow > 0.0 else 2.0 * np.sqrt(slow)
            turn = abs(qb[m, 6] - qa[n, 6])
            if turn > 0.0:
                seconds = max(seconds, trapezoid_second(turn, v[6], a[6]))
            far = max(abs(qb[m, 3] - qa[n, 3]), abs(qb[m, 5] - qa[n, 5])) - _WRIST_RAD
            extra = soft + _WRIST_S_PER_RAD * far if far > 0.0 else soft
            out[n, k] = seconds + extra if seconds > 1e-9 else 0.0
    return out
