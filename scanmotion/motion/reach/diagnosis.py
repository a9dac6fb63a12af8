"""Why a viewpoint cannot be reached, by how much, and what would mend it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from scanmotion.cell.build import Cell, build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.kinematics import joint_excess, wrist_shortfall
from scanmotion.core.errors import CellError
from scanmotion.core.viewpoint import Viewpoint

Cause = Literal["out_of_reach", "joint_limit", "collision", "singular"]
_LIFTS_M = (0.1, 0.2, 0.3, 0.45, 0.6)
_SHIFTS_M = (-0.2, -0.4, 0.2, 0.4)
_LOOKED_AT = 3
"""Blocked configurations whose exact distances are measured to name the pair."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """A change of the cell's layout."""

    raise_m: float = 0.0
    """By how much the pedestal grows [m]."""
    shift_m: float = 0.0
    """By how much the table goes away from the robot, negative towards it [m]."""

    def __str__(self) -> str:
        if self.raise_m:
            return f"a pedestal {abs(self.raise_m) * 1e3:.0f} mm {'higher' if self.raise_m > 0 else 'lower'}"
        return f"the table {abs(self.shift_m) * 1e3:.0f} mm {'farther' if self.shift_m > 0 else 'closer'}"

    def applied(self, cell: Cell) -> Cell:
        """The cell with this change.

        Raises:
            CellError: the cell cannot be so.
        """
        settings = cell.settings
        toward = cell.X_WT[:2, 3] - cell.X_WB[:2, 3]
        toward = toward / max(float(np.linalg.norm(toward)), 1e-9)
        x, y = np.array(settings.turntable.position_m) + self.shift_m * toward
        height = settings.pedestal.height_m + self.raise_m
        if height < 0:
            raise CellError("a pedestal cannot be lower than the table", key="pedestal.height_m")
        update = {
            "turntable": settings.turntable.model_copy(update={"position_m": (float(x), float(y))}),
            "pedestal": settings.pedestal.model_copy(update={"height_m": height}),
        }
        return build_cell(settings.model_copy(update=update), cell.part)


@dataclass(frozen=True, kw_only=True)
class Unreachable:
    """The reason why no configuration serves a viewpoint."""

    cause: Cause
    detail: str
    """Evidence: which way and how far, which joint, which pair of bodies."""
    remedy: str = "what would mend it was not looked for"
    """What was found to mend it, or that nothing tried does."""
    change: Change | None = None
    """The change of the layout that mends it, found by reaching the viewpoint there; None for none."""

    def __str__(self) -> str:
        return f"{self.cause.replace('_', ' ')}: {self.detail}; {self.remedy}"

    def mended_by(self, change: Change | None) -> "Unreachable":
        """The same reason with the outcome of the search for a remedy."""
        remedy = "no pedestal height or table distance that was tried mends it"
        if change is not None:
            remedy = f"{change} brings it into reach"
        return replace(self, remedy=remedy, change=change)


class Remedies:
    """Layouts a little different from the cell's, made when first asked for.

    Args:
        cell: the cell.
        clearance: its checker.
        serves: which of some viewpoints are reached in another cell, shape (n,).
    """

    def __init__(
        self,
        cell: Cell,
        clearance: Clearance,
        serves: Callable[[Cell, Clearance, list[Viewpoint]], np.ndarray],
    ) -> None:
        self._cell, self._clearance, self._serves = cell, clearance, serves
        lifts = sorted([*_LIFTS_M, *(-v for v in _LIFTS_M if v < cell.settings.pedestal.height_m)], key=abs)
        self._changes = [Change(raise_m=v) for v in lifts] + [Change(shift_m=v) for v in _SHIFTS_M]
        self._made: dict[Change, tuple[Cell, Clearance] | None] = {}

    def _layout(self, change: Change) -> tuple[Cell, Clearance] | None:
        if change not in self._made:
            try:
                cell = change.applied(self._cell)
                checker = Clearance(cell, clearance=self._clearance.clearance, like=self._clearance)
                self._made[change] = cell, checker
            except CellError:
                self._made[change] = None
        return self._made[change]

    def of(self, viewpoints: Sequence[Viewpoint]) -> list[Change | None]:
        """For each viewpoint the first change in which it is reached."""
        found: list[Change | None] = [None] * len(viewpoints)
        for change in self._changes:
            todo = [n for n, known in enumerate(found) if known is None]
            layout = self._layout(change) if todo else None
            if layout is None:
                continue
            served = self._serves(*layout, [viewpoints[n] for n in todo])
            for n, yes in zip(todo, served, strict=True):
                found[n] = change if yes else None
        return found


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
        cause, detail = "collision", _blocked(clearance, viewpoint, q)
    else:
        cause, detail = _not_solved(cell, X_WS, table)
    return Unreachable(cause=cause, detail=detail)


def _not_solved(cell: Cell, X_WS: np.ndarray, table: np.ndarray) -> tuple[Cause, str]:
    """Cause and evidence where no pose has a configuration inside the limits."""
    short = wrist_shortfall(cell, X_WS)
    best = int(np.argmin(short))
    if short[best] > 0:
        shoulder = cell.X_WB[:3, 3] + cell.X_WB[:3, :3] @ np.array([0, 0, cell.robot.X_PJ[0, 2, 3]])
        nearer = X_WS[best : best + 1].copy()
        nearer[0, :3, 3] += 1e-3 * (shoulder - nearer[0, :3, 3]) / np.linalg.norm(shoulder - nearer[0, :3, 3])
        side = "farther out" if wrist_shortfall(cell, nearer)[0] < short[best] else "closer in"
        return "out_of_reach", (
            f"the wrist would have to be {short[best] * 1e3:.0f} mm {side} "
            f"than the arm goes, at best with the table at {np.rad2deg(table[best]):.0f} deg"
        )
    joint, excess, index = joint_excess(cell, X_WS)
    if not np.isfinite(excess):
        return "singular", "the wrist is in reach, but every pose is singular"
    return "joint_limit", (
        f"{cell.joint_names[joint]} would pass its limit by {np.rad2deg(excess):.1f} deg, "
        f"at best with the table at {np.rad2deg(table[index]):.0f} deg"
    )


def _blocked(clearance: Clearance, viewpoint: Viewpoint, q: np.ndarray) -> str:
    """The pair that blocks the least blocked of some configurations."""
    turns = viewpoint.kind == "revolution"
    count = min(len(q), 2 if turns else _LOOKED_AT)
    worst: tuple[float, float, tuple[str, str], float] = (-np.inf, 0.0, ("", ""), 0.0)
    for row in q[np.linspace(0, len(q) - 1, count).astype(int)]:
        rows = [row]
        if turns:
            rows = [np.append(row[:6], e) for e in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
        measured = [(*clearance.distance(r), r[6]) for r in rows]
        least = min(((d - clearance.asked(pair), d, pair, e) for d, pair, e in measured), key=lambda m: m[0])
        worst = max(worst, least, key=lambda m: m[0])
    _, distance, pair, angle = worst
    how = "touch" if distance <= 0 else f"come within {distance * 1e3:.0f} mm"
    return (
        f"{pair[0]} and {pair[1]} {how} in the best of {count} configurations measured "
        f"(table at {np.rad2deg(angle):.0f} deg), "
        f"{clearance.asked(pair) * 1e3:.0f} mm are asked for"
    )
