"""Stepped rotary viewpoints: the global step over a bounding box (section 2 of the paper).

Zhang et al., Actuators 2025, 14(3), 139, doi 10.3390/act14030139. At each viewpoint the table turns once.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.deprecation import deprecated
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.sensing.visibility import in_view, revolution_poses

UPRIGHT = -np.pi / 2
"""Roll that stands the long side l upright, with the projector above the camera, clear of the table."""
_LOW, _ABOVE, _STEEP = np.deg2rad([-20.0, 30.0, 40.0])
_YAW, _WIDE_YAW = np.deg2rad([15.0, 25.0])
FAR = 0.95
"""The far turns stand at this share of the greatest range from the axis."""
_GAP, _GAP_SHARE = 0.03, 0.05
"""The nearest surface stays this far beyond the least range [m], but at most this share of the range."""
_ROW = 1.733
"""Greatest height of a row of turns, in long sides of the field at the middle of the range."""
_LEAST_HEIGHT = 0.02
"""Least height of the optical centre above the table [m]."""
_ENOUGH = 0.985
"""Turns are added until they see this share of the box's sides and top."""
_WORTH = 0.005
"""A turn that adds a smaller share than this is not added."""
_POSES = 30
_CLEAR, _CLEAR_SHARE = 0.25, 0.625
"""Added turns keep the optical centre so far outside the box's cylinder [m], but at most this share of the
least range."""
_NEAR_SHARE = 0.25
"""The nearest of the added turns stand at this share of the range."""
_STEP, _STEP_SHARE = 0.2, 0.54
"""Added turns aim at heights so far apart at most [m], and at most this share of the field's long side."""


def range_gap(scanner: Scanner) -> float:
    """How far beyond the least range the nearest surface of a turn stays [m]."""
    return min(_GAP, _GAP_SHARE * scanner.depth)


@dataclass(frozen=True, eq=False, kw_only=True)
class StepPlan:
    """The global viewpoints, and those of the method that the cell leaves no room for."""

    viewpoints: tuple[Viewpoint, ...]
    dropped: tuple[tuple[str, str], ...]
    """(id, reason)."""


def stepped_rotary(
    length: float,
    width: float,
    height: float,
    scanner: Scanner,
    *,
    standoff: float | None = None,
    mode: str | None = None,
    pedestal: float = 0.0,
) -> StepPlan:
    """Viewpoints that see a box of L x W x H [m] on the table's axis while the table turns.

    They keep the idea of the paper (`paper_stepped_rotary`) and choose inclination, distance and lateral
    offset by what they see and by the scanner's way between them. The four turns were found by exchange
    over 810 turns on eight sculptures and reliefs and six generated figures. Two of them look up from
    beside the table, three past the axis. Taller parts get more rows. Where these leave part of the box's
    own sides and top unseen, as on wide boxes, more turns are added by what they see of it.

    Args:
        length: L along x [m].
        width: W along y [m].
        height: H along z [m].
        scanner: field and range.
        standoff: deprecated: only `paper_stepped_rotary` takes it.
        mode: deprecated: "paper" stands for `paper_stepped_rotary`.
        pedestal: height of the box's base above the table [m].

    Raises:
        InputError: sides that are not positive, or an unknown mode.
    """
    if mode is not None:
        if mode not in ("default", "paper"):
            raise InputError(f"unknown mode {mode!r}; known: default, paper")
        deprecated("stepped_rotary: mode", "paper_stepped_rotary")
    if mode == "paper":
        return paper_stepped_rotary(length, width, height, scanner, standoff=standoff, pedestal=pedestal)
    _check_box(length, width, height)
    return _default(length, width, height, scanner, pedestal)


def paper_stepped_rotary(
    length: float,
    width: float,
    height: float,
    scanner: Scanner,
    *,
    standoff: float | None = None,
    pedestal: float = 0.0,
) -> StepPlan:
    """Section 2 of the paper literally.

    VP0 looks from 30 deg above the top; then come k = ceil(H / l) steps down; VPn looks from 30 deg below.

    Args:
        length: L along x [m].
        width: W along y [m].
        height: H along z [m].
        scanner: field and range.
        standoff: d, scanner to the box's side [m]; None for the middle of the range.
        pedestal: height of the box's base above the table [m].

    Raises:
        InputError: sides that are not positive.
    """
    _check_box(length, width, height)
    return _paper(length, height, scanner, scanner.middle if standoff is None else standoff, pedestal)


def _check_box(length: float, width: float, height: float) -> None:
    if not (np.isfinite([length, width, height]).all() and min(length, width, height) > 0):
        raise InputError(f"box {length:g} x {width:g} x {height:g} m: sides must be positive numbers")


def _view(name: str, p: np.ndarray, direction: np.ndarray, standoff: float, note: str) -> Viewpoint:
    return Viewpoint(
        id=name, X_OS=look_at(p, direction, roll=UPRIGHT), standoff=standoff, step="global",
        kind="revolution", slack=Slack(roll=False), note=note,
    )  # fmt: skip


def _paper(length: float, height: float, scanner: Scanner, d: float, pedestal: float) -> StepPlan:
    side = float(scanner.field(d)[0])
    k = int(np.ceil(height / side - 1e-9))
    step = height / k
    c, s = np.cos(np.deg2rad(30.0)), np.sin(np.deg2rad(30.0))
    views = [
        _view("G0", np.array([length / 2 + d * c, 0, height + d * s]), np.array([-c, 0, -s]), d, "VP0, top")
    ]
    for i in range(1, k + 1):
        p = np.array([length / 2 + d, 0.0, height - step * i])
        views.append(_view(f"G{i}", p, np.array([-1.0, 0, 0]), d, f"VP{i}, side"))
    bottom = _view(
        f"G{k + 1}", np.array([length / 2 + d * c, 0, -d * s]), np.array([-c, 0, s]), d, "VPn, bottom"
    )
    if pedestal >= d * s:
        return StepPlan(viewpoints=(*views, bottom), dropped=())
    reason = (
        f"VPn lies {d * s * 1e3:.0f} mm below the part's base, behind the table; "
        f"a pedestal of {d * s * 1e3:.0f} mm instead of {pedestal * 1e3:.0f} mm would let it see"
    )
    return StepPlan(viewpoints=tuple(views), dropped=((bottom.id, reason),))


def _default(length: float, width: float, height: float, scanner: Scanner, pedestal: float) -> StepPlan:
    radius = float(np.hypot(length, width)) / 2
    near, far = scanner.range
    size = np.array([length, width, height])
    rows = max(1, int(np.ceil(height / (_ROW * float(scanner.field(scanner.middle)[0])) - 1e-9)))

    def distance(tilt: float, share: float) -> float:
        """From the nearest that keeps the box in range (0) to far off (1)."""
        close = near + radius * float(np.cos(tilt)) + range_gap(scanner)
        return close + share * max(FAR * far - close, 0.0)

    turns = [(_STEEP, _YAW, height * (1 - 0.2 / rows), 0.5, "from steeply above, past the axis")]
    for k in reversed(range(rows)):
        turns.append((_ABOVE, -_YAW, height * (k + 0.2) / rows, 0.5, "from above, past the axis"))
    for k in reversed(range(rows)):
        turns.append((_LOW, 0.0, height * (k + 0.8) / rows, 1.0, "from below"))
        turns.append((_LOW, _WIDE_YAW, height * (k + 0.2) / rows, 1.0, "from below, past the axis"))
    views = []
    for n, (tilt, yaw, aim, share, note) in enumerate(turns):
        d = distance(tilt, share)
        X_OS = oblique_turn(tilt, yaw, aim, d, radius=radius, floor=_LEAST_HEIGHT - pedestal)
        views.append(
            Viewpoint(
                id=f"G{n}", X_OS=X_OS, step="global", kind="revolution", slack=Slack(roll=False), note=note,
                standoff=turn_standoff(X_OS, size, scanner, otherwise=d),
            )
        )  # fmt: skip
    views += _added(length, width, height, scanner, views, floor=_LEAST_HEIGHT - pedestal)
    reason = "the table hides what a view from below would see; a pedestal would let it see more"
    return StepPlan(viewpoints=tuple(views), dropped=() if pedestal > 0.05 else (("VPn", reason),))


def _added(
    length: float, width: float, height: float, scanner: Scanner, views: list[Viewpoint], *, floor: float
) -> list[Viewpoint]:
    """Turns for what `views` leave of the box's sides and top, greedily."""
    points, normals = _faces(length, width, height)

    def seen_by(poses: np.ndarray) -> np.ndarray:
        # A convex box hides nothing from an eye that its faces are turned to.
        frames = np.concatenate([revolution_poses(X, _POSES) for X in poses])
        seen = in_view(scanner, frames, points, normals)
        return np.asarray(seen.reshape(len(poses), _POSES, -1).any(axis=1))

    seen = seen_by(np.array([v.X_OS for v in views])).any(axis=0)
    if seen.mean() >= _ENOUGH:
        return []
    poses, distances = _steps(float(np.hypot(length, width)) / 2, height, scanner, floor)
    if len(poses) == 0:
        return []
    size = np.array([length, width, height])
    table = seen_by(poses)
    out: list[Viewpoint] = []
    while seen.mean() < _ENOUGH:
        gain = (table & ~seen).mean(axis=1)
        best = int(np.argmax(gain))
        if gain[best] < _WORTH:
            break
        seen |= table[best]
        out.append(
            Viewpoint(
                id=f"G{len(views) + len(out)}", X_OS=poses[best], step="global", kind="revolution",
                standoff=turn_standoff(poses[best], size, scanner, otherwise=distances[best]),
                slack=Slack(roll=False), note=f"adds {gain[best]:.1%} of the box",
            )
        )  # fmt: skip
    return out


def _faces(length: float, width: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly over the box's sides and top, and their normals, shape (n, 3) each."""
    size = np.array([length, width, height])
    pitch = np.sqrt((length * width + 2 * height * (length + width)) / 2500)
    points, normals = [], []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1)):
        u, v = (a for a in range(3) if a != axis)
        nu, nv = (max(2, int(np.ceil(size[a] / pitch))) for a in (u, v))
        grid = np.stack(
            np.meshgrid((np.arange(nu) + 0.5) / nu - 0.5, (np.arange(nv) + 0.5) / nv - 0.5), axis=-1
        )
        face = np.full((nu * nv, 3), 0.5 * sign)
        face[:, [u, v]] = grid.reshape(-1, 2)
        points.append(face * size + [0, 0, height / 2])
        normals.append(np.tile(sign * np.eye(3)[axis], (nu * nv, 1)))
    return np.concatenate(points), np.concatenate(normals)


def _steps(radius: float, height: float, scanner: Scanner, floor: float) -> tuple[np.ndarray, list[float]]:
    """Turns aimed at steps across the top and up the sides of the box's cylinder, and their distances."""
    near, far = scanner.range
    step = min(_STEP, _STEP_SHARE * float(scanner.field(scanner.middle)[0]))
    clear = min(_CLEAR, _CLEAR_SHARE * near)
    rows = max(2, int(np.ceil(height / step)))
    aims = [(radius * share, height) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]
    aims += [(radius * share, height * (i + 0.5) / rows) for i in range(rows) for share in (0.6, 1.0)]
    poses, distances = [], []
    for across, up in aims:
        for tilt in np.deg2rad([-20.0, 0.0, 20.0, 40.0, 60.0, 80.0]):
            for distance in (near + _NEAR_SHARE * scanner.depth, scanner.middle, FAR * far):
                for yaw in (-_YAW, 0.0, _YAW):
                    c, s = np.cos(tilt), np.sin(tilt)
                    line = np.array([c * np.cos(yaw), c * np.sin(yaw), s])
                    p = np.array([across, 0.0, up]) + distance * line
                    if p[2] >= floor and (np.hypot(*p[:2]) > radius + clear or p[2] > height + clear):
                        poses.append(look_at(p, -line, roll=UPRIGHT))
                        distances.append(distance)
    return np.array(poses).reshape(-1, 4, 4), distances


def turn_standoff(X_OS: np.ndarray, size: np.ndarray, scanner: Scanner, *, otherwise: float) -> float:
    """Distance along the optical axis to a box on the table, the median over a turn's angles [m].

    Angles at which it is in the scanner's range count, all where it never is.

    Args:
        X_OS: pose of the turn, shape (4, 4).
        size: sides of the box, which stands on z = 0 about the axis, shape (3,) [m].
        scanner: its range.
        otherwise: what is taken where the axis passes the box at every angle [m].
    """
    poses = revolution_poses(X_OS, _POSES)
    p, direction = poses[:, :3, 3], poses[:, :3, 2]
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0.0]), np.array([size[0] / 2, size[1] / 2, size[2]])
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - p) / direction, (high - p) / direction
    first = np.nanmax(np.fmin(a, b), axis=1)
    last = np.nanmin(np.fmax(a, b), axis=1)
    hit = (first <= last) & (first > 0)
    usual = scanner.usual_depth(first[hit])
    return otherwise if usual is None else usual


def oblique_turn(
    tilt: float,
    yaw: float,
    aim: float,
    distance: float,
    *,
    radius: float,
    floor: float,
    roll: float = 0.0,
) -> np.ndarray:
    """Pose X_OS of a turn whose line of sight passes beside the table's axis.

    A line that misses the axis meets the sides of a cavity from an angle of its own, and meets the other side
    half a turn later; turns at +yaw and -yaw see what radial ones leave.

    Args:
        tilt: inclination of the scanner above the aimed point, negative for a look upward [rad].
        yaw: angle between the line of sight and the axial plane [rad].
        aim: height of the aimed point [m].
        distance: from the scanner to the aimed point [m].
        radius: of the part about the axis; the line passes the axis at 0.7 radius tan(yaw) [m].
        floor: least height of the optical centre [m].
        roll: about the optical axis; 0 has the long side horizontal [rad].
    """
    p = np.array([0.0, 0.0, aim]) + distance * np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    p[2] = max(p[2], floor)
    line = np.array([0.0, 0.0, aim]) - p
    c, s = np.cos(yaw), np.sin(yaw)
    direction = np.array([c * line[0] - s * line[1], s * line[0] + c * line[1], line[2]])
    target = np.array([0.0, 0.7 * radius * np.tan(yaw), aim])
    return look_at(target - direction, direction, roll=roll)
