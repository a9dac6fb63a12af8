"""Charts of a trajectory over time with its limits, and where the seconds go."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.core.summary import BudgetSummary
from scanmotion.core.trajectory import Trajectory
from scanmotion.report.figures.maps import new_figure
from scanmotion.report.figures.palette import JOINT_COLOURS, OPERATION_COLOURS, TIME_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def joint_figure(trajectory: Trajectory, cell: Cell) -> "Figure":
    """Position inside its range, speed and acceleration of each joint, as shares of the limits."""
    figure = new_figure(11.0, 7.0)
    axes = figure.subplots(3, 1, sharex=True)
    keep = _thin(len(trajectory.t))
    t, low, high = trajectory.t[keep], cell.q_min, cell.q_max
    # An endless table has no range; its position is drawn as a share of one turn.
    endless = ~np.isfinite(high - low)
    low, span = np.where(endless, 0.0, low), np.where(endless, 2 * np.pi, high - low)
    curves = (
        ("position in its range [%]", 100 * (trajectory.q[keep] - low) / span, (0, 100)),
        ("speed [% of limit]", 100 * trajectory.qd[keep] / cell.v_max, (-100, 100)),
        ("acceleration [% of limit]", 100 * trajectory.qdd[keep] / cell.a_max, (-100, 100)),
    )
    for ax, (label, values, limits) in zip(axes, curves, strict=True):
        _operations(ax, trajectory)
        for joint, name in enumerate(cell.joint_names):
            ax.plot(t, values[:, joint], color=JOINT_COLOURS[joint], lw=0.8, label=name)
        _limits(ax, limits)
        ax.set_ylabel(label, fontsize=8)
    axes[-1].set(xlabel="time [s]", xlim=_span(trajectory))
    axes[0].legend(ncols=7, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return figure


def tcp_speed(t: np.ndarray, p_WS: np.ndarray) -> np.ndarray:
    """Speed of the optical centre by central differences, shape (N,) [m/s].

    Args:
        t: times, shape (N,) [s].
        p_WS: positions, shape (N, 3) [m].
    """
    return np.linalg.norm(np.gradient(p_WS, t, axis=0), axis=1)


def tcp_figure(trajectory: Trajectory, p_WS: np.ndarray, limit: float) -> "Figure":
    """Speed of the scanner's optical centre over time, with its limit [m/s]."""
    figure = new_figure(11.0, 2.6)
    ax = figure.subplots()
    _operations(ax, trajectory, legend=True)
    speed = tcp_speed(trajectory.t, p_WS)
    ax.plot(trajectory.t, speed, color="#1b6ca8", lw=0.9)
    _limits(ax, (limit,))
    ax.annotate(
        f"limit {limit:g} m/s",
        (1, limit),
        xycoords=("axes fraction", "data"),
        fontsize=7,
        color="#c8102e",
        ha="right",
        va="bottom",
    )
    top = 1.12 * max(limit, float(speed.max()))
    ax.set(xlabel="time [s]", ylabel="scanner speed [m/s]", ylim=(0, top), xlim=_span(trajectory))
    return figure


def time_figure(time_s: Mapping[str, float], budget: float) -> "Figure":
    """Seconds by kind of work against the budget and the proven floor."""
    figure = new_figure(11.0, 1.6)
    ax, left = figure.subplots(), 0.0
    for name, colour in TIME_COLOURS.items():
        ax.barh(0, time_s[name], left=left, color=colour, label=f"{name} {time_s[name]:.1f} s")
        left += time_s[name]
    for value, style, label in ((budget, "-", "budget"), (time_s["floor"], ":", "floor")):
        ax.axvline(value, color="#c8102e", ls=style, lw=1.2, label=f"{label} {value:.1f} s")
    ax.set(yticks=[], xlabel="time [s]", xlim=(0, 1.05 * max(left, budget)))
    ax.legend(ncols=6, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return figure


def curve_figure(budget: BudgetSummary) -> "Figure":
    """Completeness against seconds: of this programme as it goes on, and of shorter ones."""
    figure = new_figure(11.0, 2.8)
    ax = figure.subplots()
    for line, colour, label in (
        (budget.by_order, "#777777", "this programme up to then"),
        (budget.curve, "#1b6ca8", "without its least worthy stops"),
    ):
        points = sorted((p.seconds, 100 * p.completeness) for p in line)
        ax.plot(*zip(*points, strict=True), color=colour, marker=".", lw=0.9, label=label)
    ax.axvline(budget.limit_s, color="#c8102e", lw=1.2, label=f"budget {budget.limit_s:.1f} s")
    least = min((p.completeness for p in budget.by_order), default=0.0)
    ax.set(xlabel="time [s]", ylabel="seen of what can be [%]", ylim=(100 * max(least - 0.02, 0.0), 100.5))
    ax.legend(ncols=3, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return figure


def _span(trajectory: Trajectory) -> tuple[float, float]:
    return float(trajectory.t[0]), float(trajectory.t[-1])


def _thin(n: int, most: int = 4000) -> slice:
    """Every k-th sample, so that a chart stays small; limits are judged elsewhere, on all of them."""
    return slice(None, None, max(1, n // most))


def _operations(ax: "Axes", trajectory: Trajectory, *, legend: bool = False) -> None:
    named: set[str] = set()
    for operation in trajectory.operations:
        label = operation.kind if legend and operation.kind not in named else None
        named.add(operation.kind)
        ax.axvspan(
            operation.t_start,
            operation.t_end,
            color=OPERATION_COLOURS[operation.kind],
            alpha=0.15,
            lw=0,
            label=label,
        )
    if legend:
        ax.legend(ncols=4, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), frameon=False)


def _limits(ax: "Axes", values: tuple[float, ...]) -> None:
    for value in values:
        ax.axhline(value, color="#c8102e", lw=0.8, ls="--")
