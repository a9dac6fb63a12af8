"""Local viewpoints over a hole's box: the paper's four cases, and the overlapping grid that mends them.

Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139), section 3.3 and figures 9 to 13.
"""

import logging
from collections.abc import Sequence

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.scanner import Scanner
from scanmotion.core.support.deprecation import deprecated
from scanmotion.core.viewpoint import Slack, Viewpoint
from scanmotion.sensing.holes.find import Hole

log = logging.getLogger(__name__)


def paper_positions(a: float, b: float, l: float, w: float) -> np.ndarray:  # noqa: E741 - the paper's letter
    """Where to stand over an a x b plane with an l x w field: the four cases of figure 9, (n, 2) [m].

    Case 3 covers up to a = 2 l, case 2 up to b = 2 w, case 4 up to a = 2 l.
    """
    if a <= l and b <= w:
        return np.array([[0.0, 0.0]])
    if a <= l:
        y = b / 2 - w / 2
        return np.array([[0.0, -y], [0.0, y]])
    if b <= w:
        x = a / 2 - l / 2
        return np.array([[-x, 0.0], [x, 0.0]])
    n = 2 * int(np.ceil(b / w - 1e-9))
    c = 2 * b / n
    x, y, out = a / 2 - l / 2, b / 2 - c / 2, []
    for i in range(1, n + 1):
        if i > 1:
            # Figure 13: across on even steps, down on odd ones.
            x, y = (-x, y) if i % 2 == 0 else (x, y - c)
        out.append((x, y))
    return np.array(out)


def grid_positions(a: float, b: float, l: float, w: float, overlap: float = 0.1) -> np.ndarray:  # noqa: E741
    """Evenly spaced positions over an a x b plane that cover it with an l x w field, serpentine, (n, 2) [m].

    Neighbouring fields overlap by at least `overlap` of their side; one field is used where one covers.
    """

    def along(side: float, field: float) -> np.ndarray:
        if side <= field:
            return np.zeros(1)
        n = int(np.ceil((side - field) / (field * (1 - overlap)) - 1e-9)) + 1
        return np.linspace(-(side - field) / 2, (side - field) / 2, n)

    rows = [
        [(x, y) for x in (along(a, l) if k % 2 == 0 else along(a, l)[::-1])]
        for k, y in enumerate(along(b, w))
    ]
    return np.array([p for row in rows for p in row])


def local_viewpoints(
    holes: Sequence[Hole],
    scanner: Scanner,
    *,
    standoff: float | None = None,
    overlap: float = 0.10,
    mode: str | None = None,
    table_z: float = 0.0,
) -> tuple[Viewpoint, ...]:
    """Viewpoints that look along -Z' at each hole's largest middle plane; those of one hole form a sweep.

    Args:
        holes: with their boxes, Z' outward.
        scanner: field of view.
        standoff: d, scanner to the middle plane [m]; None for the middle of the range.
        overlap: of neighbouring fields.
        mode: deprecated: "paper" stands for `paper_local_viewpoints`.
        table_z: viewpoints below the table's top are left out.

    Raises:
        InputError: an unknown mode, or a standoff outside the scanner's range.
    """
    if mode is not None:
        if mode not in ("default", "paper"):
            raise InputError(f"unknown mode {mode!r}; known: default, paper")
        deprecated("local_viewpoints: mode", "paper_local_viewpoints")
    if mode == "paper":
        return paper_local_viewpoints(holes, scanner, standoff=standoff, table_z=table_z)
    d, l, w = _field(scanner, standoff)  # noqa: E741
    views: list[Viewpoint] = []
    for n, hole in enumerate(holes, 1):
        positions = grid_positions(float(hole.extent[0]), float(hole.extent[1]), l, w, overlap)
        views += _over(hole, n, positions, d, table_z)
    return tuple(views)


def paper_local_viewpoints(
    holes: Sequence[Hole], scanner: Scanner, *, standoff: float | None = None, table_z: float = 0.0
) -> tuple[Viewpoint, ...]:
    """The paper's four cases over each hole, literally; warns where they leave a gap.

    Args:
        holes: with their boxes, Z' outward.
        scanner: field of view.
        standoff: d, scanner to the middle plane [m]; None for the middle of the range.
        table_z: viewpoints below the table's top are left out.

    Raises:
        InputError: a standoff outside the scanner's range.
    """
    d, l, w = _field(scanner, standoff)  # noqa: E741
    views: list[Viewpoint] = []
    for n, hole in enumerate(holes, 1):
        a, b = float(hole.extent[0]), float(hole.extent[1])
        if a > 2 * l or (a <= l and b > 2 * w):
            log.warning(
                "hole %d: %.0f x %.0f mm is more than the paper's case covers with %.0f x %.0f mm",
                n, a * 1e3, b * 1e3, l * 1e3, w * 1e3,
            )  # fmt: skip
        views += _over(hole, n, paper_positions(a, b, l, w), d, table_z)
    return tuple(views)


def _field(scanner: Scanner, standoff: float | None) -> tuple[float, float, float]:
    """The standoff, and the field's sides there [m]."""
    near, far = scanner.range
    d = scanner.middle if standoff is None else standoff
    if not near <= d <= far:
        raise InputError(f"standoff {d:g} m is outside the scanner's range {near:g} .. {far:g} m")
    l, w = (float(side) for side in scanner.field(d))  # noqa: E741
    return d, l, w


def _over(hole: Hole, n: int, positions: np.ndarray, standoff: float, table_z: float) -> list[Viewpoint]:
    """Viewpoints at `positions` of the middle plane; +x of S along X', so +y along -Y'."""
    views = []
    R_HS = np.diag([1.0, -1.0, -1.0])
    for i, (x, y) in enumerate(positions, 1):
        X_HS = np.eye(4)
        X_HS[:3, :3], X_HS[:3, 3] = R_HS, (x, y, standoff)
        X_OS = hole.X_OH @ X_HS
        if X_OS[2, 3] < table_z:
            continue
        views.append(
            Viewpoint(
                id=f"L{n}.{i}", X_OS=X_OS, standoff=standoff, step="local", kind="station",
                sweep=f"L{n}" if len(positions) > 1 else "",
                slack=Slack(standoff=(-0.05, 0.05), tilt=np.deg2rad(10.0), roll=False),
                note=f"{hole.kind} hole {n}, {hole.extent[0] * 1e3:.0f} x {hole.extent[1] * 1e3:.0f} mm",
            )
        )  # fmt: skip
    return views
