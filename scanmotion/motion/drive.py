"""What transit and timing share: the curve that a transit is driven on, its derivatives and the limits."""

import functools

import numpy as np

from scanmotion.cell.kinematics import scanner_poses, tcp_jacobian
from scanmotion.cell.plant import Cell
from scanmotion.motion.profile import Derivatives, Limits, floor_seconds, parameter_grid
from scanmotion.motion.scale import TimeLaw, fastest_law
from scanmotion.motion.spline import JointSpline, spline_beside, subdivided


def limits_of(cell: Cell, tcp: float) -> Limits:
    """The cell's axis limits with a scanner speed of `tcp` [m/s]."""
    return Limits(v=cell.v_max, a=cell.a_max, j=cell.j_max, tcp=tcp)


def transit_limits(cell: Cell) -> Limits:
    """Limits while the scanner is off."""
    return limits_of(cell, float(cell.settings.process.transit_speed_m_s))


def positions(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Origin of S in W, shape (n, 3) [m]."""
    return scanner_poses(cell, q)[:, :3, 3]


def transit_spline(cell: Cell, q: np.ndarray) -> JointSpline:
    """The curve that a transit along the polyline `q` (k, 7) is driven on."""
    return spline_beside(subdivided(q, positions(cell, q)))


def derivatives_on(cell: Cell, path: JointSpline, *, spacing: float = 1.0) -> Derivatives:
    """Derivatives of `path` on its grid; a `spacing` above 1 makes the grid coarser."""
    s = parameter_grid(path, spacing=spacing)

    def tcp(s: np.ndarray) -> np.ndarray:
        J = tcp_jacobian(cell, path(s))[:, 3:]
        return np.linalg.norm(np.einsum("nij,nj->ni", J, path(s, 1)), axis=1)

    return Derivatives(s=s, q1=path(s, 1), q2=path(s, 2), q3=path(s, 3), tcp=tcp)


def floor_along(cell: Cell, q: np.ndarray) -> float:
    """About how long a transit along the polyline `q` (k, 7) takes where nothing limits the jerk [s]."""
    return floor_seconds(derivatives_on(cell, transit_spline(cell, q), spacing=3.0), transit_limits(cell))


def transit_law(cell: Cell, q: np.ndarray) -> tuple[JointSpline, TimeLaw]:
    """The curve driven along the polyline `q` (k, 7), and its time law; remembered, for two stages ask."""
    q = np.ascontiguousarray(q, dtype=float)
    return _transit_law(cell, q.shape[0], q.tobytes())


@functools.lru_cache(maxsize=512)
def _transit_law(cell: Cell, k: int, data: bytes) -> tuple[JointSpline, TimeLaw]:
    path = transit_spline(cell, np.frombuffer(data).reshape(k, 7))
    return path, fastest_law(path, derivatives_on(cell, path), transit_limits(cell))
