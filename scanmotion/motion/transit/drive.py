"""What transit and timing share: the curve that a transit is driven on, its derivatives and the limits."""

import functools
import logging

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.core.errors import TimingError
from scanmotion.geometry.jit import njit
from scanmotion.motion.profile.jerk_limited import TimeLaw, fastest_law, law_with
from scanmotion.motion.profile.speed_profile import Derivatives, Limits, parameter_grid, profile_floor
from scanmotion.motion.profile.spline import JointSpline, spline_beside, subdivided
from scanmotion.motion.transit_cost import MoveModel, move_model, scanner_positions

log = logging.getLogger(__name__)


def limits_of(cell: Cell, tcp: float) -> Limits:
    """The cell's axis limits with a scanner speed of `tcp` [m/s]."""
    return Limits(v=cell.v_max, a=cell.a_max, j=cell.j_max, tcp=tcp)


def transit_limits(cell: Cell) -> Limits:
    """Limits while the scanner is off."""
    return limits_of(cell, float(cell.settings.process.transit_speed_m_s))


def positions(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Origin of S in W for configurations (n, 7), shape (n, 3) [m]."""
    return scanner_positions(_model(cell), q)


def speeds(cell: Cell, q: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """Speed of S in W, shape (n,), for configurations and joint speeds (n, 7)."""
    model = _model(cell)
    return _speeds(model.axes, model.points, model.p_WS, q, q1)


@functools.lru_cache(maxsize=8)
def _model(cell: Cell) -> MoveModel:
    return move_model(cell)


@njit(cache=True)
def _speeds(axes: np.ndarray, points: np.ndarray, p: np.ndarray, q: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """From the scanner back to the base: each joint turns place and velocity, then adds its own."""
    out = np.empty(len(q))
    for n in range(len(q)):
        x, y, z = p[0], p[1], p[2]
        u, v, w = 0.0, 0.0, 0.0
        for i in range(5, -1, -1):
            a, b, c = axes[i]
            x, y, z = x - points[i, 0], y - points[i, 1], z - points[i, 2]
            cos, sin = np.cos(q[n, i]), np.sin(q[n, i])
            d = (a * x + b * y + c * z) * (1.0 - cos)
            e = (a * u + b * v + c * w) * (1.0 - cos)
            x, y, z = (
                cos * x + sin * (b * z - c * y) + d * a,
                cos * y + sin * (c * x - a * z) + d * b,
                cos * z + sin * (a * y - b * x) + d * c,
            )
            u, v, w = (
                cos * u + sin * (b * w - c * v) + e * a + q1[n, i] * (b * z - c * y),
                cos * v + sin * (c * u - a * w) + e * b + q1[n, i] * (c * x - a * z),
                cos * w + sin * (a * v - b * u) + e * c + q1[n, i] * (a * y - b * x),
            )
            x, y, z = x + points[i, 0], y + points[i, 1], z + points[i, 2]
        out[n] = np.sqrt(u * u + v * v + w * w)
    return out


def transit_spline(cell: Cell, q: np.ndarray) -> JointSpline:
    """The curve that a transit along the polyline `q` (k, 7) is driven on."""
    return spline_beside(subdivided(q, positions(cell, q)))


def derivatives_on(cell: Cell, path: JointSpline, *, spacing: float = 1.0) -> Derivatives:
    """Derivatives of `path` on its grid; a `spacing` above 1 makes the grid coarser."""
    s = parameter_grid(path, spacing=spacing)

    def tcp(s: np.ndarray) -> np.ndarray:
        return speeds(cell, path(s), path(s, 1))

    return Derivatives(s=s, q1=path(s, 1), q2=path(s, 2), q3=path(s, 3), tcp=tcp)


def floor_along(cell: Cell, q: np.ndarray) -> float:
    """About how long a transit along the polyline `q` (k, 7) takes where nothing limits the jerk [s]."""
    return profile_floor(derivatives_on(cell, transit_spline(cell, q), spacing=3.0), transit_limits(cell))


def transit_law(cell: Cell, q: np.ndarray, *, tcp: float | None = None) -> tuple[JointSpline, TimeLaw]:
    """The curve driven along the polyline `q` (k, 7), and its time law; remembered, for two stages ask.

    `tcp` is the scanner's greatest speed [m/s], the transit speed where it is None.
    """
    q = np.ascontiguousarray(q, dtype=float)
    tcp = float(cell.settings.process.transit_speed_m_s) if tcp is None else tcp
    return _transit_law(cell, q.shape[0], q.tobytes(), tcp)


def emitted_law(cell: Cell, q: np.ndarray) -> tuple[JointSpline, TimeLaw]:
    """As `transit_law` at the transit speed, its profile made by the toppra library: what is emitted."""
    q = np.ascontiguousarray(q, dtype=float)
    return _emitted_law(cell, q.shape[0], q.tobytes())


@functools.lru_cache(maxsize=512)
def _emitted_law(cell: Cell, k: int, data: bytes) -> tuple[JointSpline, TimeLaw]:
    from scanmotion.motion.profile.toppra_profile import toppra_profile

    path, law = transit_law(cell, np.frombuffer(data).reshape(k, 7))
    try:
        return path, law_with(toppra_profile, path, derivatives_on(cell, path), transit_limits(cell), law)
    except TimingError as error:
        # The library's solver gives up on a few paths by rounding; the compiled one solves the same problem.
        log.info("%s; the compiled profile is taken", error)
        return path, law


@functools.lru_cache(maxsize=512)
def _transit_law(cell: Cell, k: int, data: bytes, tcp: float) -> tuple[JointSpline, TimeLaw]:
    path = transit_spline(cell, np.frombuffer(data).reshape(k, 7))
    return path, fastest_law(path, derivatives_on(cell, path), limits_of(cell, tcp))
