"""Why a viewpoint cannot be reached, by how much, and what would mend it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from scanmotion.cell.clearance import Clearance
from scanmotion.cell.kinematics import branches, joint_excess, wrist_shortfall
from scanmotion.cell.plant import Cell
from scanmotion.viewpoints.viewpoint import Viewpoint

Cause = Literal["out_of_reach", "joint_limit", "collision", "singular"]
_LIFTS = (0.1, 0.2, 0.3, 0.45, 0.6)
_SHIFTS = (-0.2, -0.4, 0.2, 0.4)


@dataclass(frozen=True, kw_only=True)
class Unreachable:
    """The reason why no configuration serves a viewpoint."""

    cause: Cause
    detail: str
    """Evidence: which way and how far, which joint, which pair of bodies."""
    remedy: str
    """What was found to mend it, or that nothing tried does."""

    def __str__(self) -> str:
        return f"{self.cause.replace('_', ' ')}: {self.detail}; {self.remedy}"


def cause_of(
    cell: Cell,
    viewpoint: Viewpoint,
    clearance: Clearance,
    X_WS: np.ndarray,
    table: np.ndarray,
    q: np.ndarray,
) -> Unreachable:
    """The cause nearest to being mended.

    Args:
        cell: the cell.
        viewpoint: what could not be reached.
        clearance: the cell's checker.
        X_WS: poses that were tried, shape (n, 4, 4).
        table: the table angle of each, shape (n,) [rad].
        q: configurations inside the limits, all blocked, shape (m, 7); (0, 7) where there are none.
    """
    if len(q):
        detail, cause = _blocked(clearance, viewpoint, q), "collision"
    else:
        short = wrist_shortfall(cell, X_WS)
        best = int(np.argmin(short))
        if short[best] > 0:
            cause = "out_of_reach"
            shoulder = cell.X_WB[:3, 3] + cell.X_WB[:3, :3] @ np.array([0, 0, cell.robot.X_PJ[0, 2, 3]])
            far = np.linalg.norm(X_WS[best, :3, 3] - shoulder) > 1.2
            side = "farther out" if far else "closer in"
            detail = (
                f"the wrist would have to be {short[best] * 1e3:.0f} mm {side} "
                f"than the arm goes, at best with the table at {np.rad2deg(table[best]):.0f} deg"
            )
        else:
            cause = "joint_limit"
            joint, excess, index = joint_excess(cell, X_WS)
            detail = (
                f"{cell.joint_names[joint]} would pass its limit by {np.rad2deg(excess):.1f} deg, "
                f"at best with the table at {np.rad2deg(table[index]):.0f} deg"
            )
    return Unreachable(cause=cause, detail=detail, remedy=_remedy(cell, X_WS))


def _blocked(clearance: Clearance, viewpoint: Viewpoint, q: np.ndarray) -> str:
    """The pair that blocks the least blocked of some configurations."""
    spread = q[np.linspace(0, len(q) - 1, min(len(q), 12)).astype(int)]
    worst: tuple[float, tuple[str, str], float] = (-np.inf, ("", ""), 0.0)
    for row in spread:
        rows = [row]
        if viewpoint.kind == "revolution":
            rows = [np.append(row[:6], e) for e in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
        distance, pair, angle = min(((*clearance.distance(r), r[6]) for r in rows), key=lambda d: d[0])
        if distance > worst[0]:
            worst = (distance, pair, angle)
    distance, pair, angle = worst
    how = "touch" if distance <= 0 else f"come within {distance * 1e3:.0f} mm"
    return (
        f"{pair[0]} and {pair[1]} {how} in the best of {len(q)} configurations "
        f"(table at {np.rad2deg(angle):.0f} deg), {clearance.clearance * 1e3:.0f} mm are asked for"
    )


def _remedy(cell: Cell, X_WS: np.ndarray) -> str:
    """The smallest change of pedestal or base distance that gives solutions, collisions aside."""
    toward = cell.X_WT[:3, 3] - cell.X_WB[:3, 3]
    toward[2] = 0.0
    toward /= max(np.linalg.norm(toward), 1e-9)
    trials = [(f"a pedestal {lift * 1e3:.0f} mm higher", np.array([0, 0, lift])) for lift in _LIFTS]
    trials += [
        (f"the table {abs(s) * 1e3:.0f} mm {'closer' if s < 0 else 'farther'}", s * toward) for s in _SHIFTS
    ]
    base = len(branches(cell, X_WS, windings=False).q)
    for words, shift in trials:
        moved = X_WS.copy()
        moved[:, :3, 3] += shift
        if base == 0 and len(branches(cell, moved, windings=False).q):
            return f"{words} brings it into reach"
    return "no pedestal or table distance that was tried mends it" if base == 0 else "more room would mend it"
