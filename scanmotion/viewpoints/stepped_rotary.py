"""Stepped rotary viewpoints: the global step over a bounding box (section 2 of the paper).

Zhang et al., Actuators 2025, 14(3), 139, doi 10.3390/act14030139. At each viewpoint the table turns once.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.errors import InputError
from scanmotion.scanner import Scanner
from scanmotion.viewpoints.viewpoint import Slack, Viewpoint, look_at

UPRIGHT = -np.pi / 2
"""Roll that stands the long side l upright, with the projector above the camera, clear of the table."""
_LOW_TILT = np.deg2rad(-5.0)
_HIGH_TILT = np.deg2rad(30.0)
_STEEP_TILT = np.deg2rad(55.0)
_LEAST_HEIGHT = 0.03
"""Least height of the optical centre above the table in the default mode [m]."""


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
    standoff: float = 0.7,
    mode: str = "default",
    pedestal: float = 0.0,
) -> StepPlan:
    """Viewpoints that see a box of L x W x H [m] on the table's axis while the table turns.

    Mode "paper" is section 2 literally: VP0 from 30 deg above the top, k = ceil(H / l) steps down, VPn
    from 30 deg below. The default keeps the idea and chooses what a box allows to choose: the distance from
    the axis so that near and far side lie in range, bands no higher than the field, a slight look upward at
    the sides, one view from 30 deg above and, where the part is wider than high, one from 55 deg.

    Args:
        length: L along x [m].
        width: W along y [m].
        height: H along z [m].
        scanner: field and range.
        standoff: d of the paper, scanner to the box's side [m].
        mode: "default" or "paper".
        pedestal: height of the box's base above the table [m].

    Raises:
        InputError: sides that are not positive, or an unknown mode.
    """
    if not (np.isfinite([length, width, height]).all() and min(length, width, height) > 0):
        raise InputError(f"box {length:g} x {width:g} x {height:g} m: sides must be positive numbers")
    if mode == "paper":
        return _paper(length, height, scanner, standoff, pedestal)
    if mode != "default":
        raise InputError(f"unknown mode {mode!r}; known: default, paper")
    return _default(length, width, height, scanner, pedestal)


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
    # The axis stands a little inside the range's end, the nearest point a little beyond its start.
    distance = float(np.clip(0.95 * far, near + radius + 0.02, max(far, near + radius + 0.02)))
    band = 1.1 * float(scanner.field(distance - radius / 2)[0])
    k = max(1, int(np.ceil(height / band - 1e-9)))
    plans = [(_LOW_TILT, height * (1 - (i + 0.5) / k), "side") for i in range(k)]
    plans.append((_HIGH_TILT, 0.6 * height, "from above"))
    if 2 * radius > 1.3 * height:
        plans.append((_STEEP_TILT, 0.5 * height, "from steeply above"))
    views = []
    for n, (tilt, aim, note) in enumerate(reversed(plans)):
        u = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        p = np.array([0.0, 0.0, aim]) + distance * u
        p[2] = max(p[2], _LEAST_HEIGHT - pedestal)
        direction = np.array([0.0, 0.0, max(aim, p[2]) if tilt < 0 else aim]) - p
        views.append(_view(f"G{n}", p, direction, distance - radius, note))
    reason = "the table hides what a view from below would see; a pedestal would let it see more"
    return StepPlan(viewpoints=tuple(views), dropped=() if pedestal > 0.05 else (("VPn", reason),))
