"""Coverage before and after, the holes, the viewpoints round the part, and the cell from above."""

import io
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.spatial import cKDTree

from scanmotion.cell.build import Cell
from scanmotion.core.part import Part
from scanmotion.core.support.streams import fixed_stream
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.planning.plan import Plan
from scanmotion.report.figures import palette
from scanmotion.report.figures.labels import add_labels
from scanmotion.report.figures.surface import (
    View,
    in_sight,
    picture_of,
    plain_image,
    status_image,
    status_of_samples,
    view_of,
)
from scanmotion.sensing.holes.find import HoleReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDES = (
    ("from +x", 0, 10),
    ("from +y", 90, 10),
    ("from -x", 180, 10),
    ("from -y", 270, 10),
    ("from above", 270, 89.9),
    ("from below", 270, -89.9),
)
"""Name, azimuth and elevation [deg] of the views that a row of pictures shows."""
MOST_PATCHES = 9
"""Unscanned patches that the picture of the coverage numbers."""


@cache
def _figure_class() -> type["Figure"]:
    from matplotlib.figure import Figure

    class Shown(Figure):
        """A figure that a notebook shows as the value of a cell; only pyplot's own are shown otherwise."""

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    return Shown


def new_figure(width: float, height: float) -> "Figure":
    """A figure that belongs to nobody's window."""
    return _figure_class()(figsize=(width, height), layout="constrained", dpi=140)


def coverage_figure(plan: Plan, *, after: Literal["global", "final"] = "final") -> "Figure":
    """Six sides of the part in two rows, after the global step or at the end.

    The numbers are those of the largest patches that stay unscanned, as the report lists them.
    """
    assert plan.samples is not None
    views = _views(plan.part, pixels=640)
    figure, axes = _gallery(views, 2)
    status = status_of_samples(plan, after=after)
    for ax, view, (side, *_) in zip(axes.ravel(), views, SIDES, strict=True):
        _image(ax, status_image(plan.part, view, plan.samples, status))
        ax.set_title(side, fontsize=9, loc="left")
        if after == "final":
            _patches(ax, plan, view)
    _legend(figure, list(zip(palette.STATUS_NAMES, palette.STATUS_COLOURS, strict=True)))
    return figure


def _patches(ax: "Axes", plan: Plan, view: View) -> None:
    """Rings and numbers at the largest patches that stay unscanned, on the sides that show them."""
    patches = sorted(plan.unscanned, key=lambda p: -p.area)[:MOST_PATCHES]
    if not patches:
        return
    centres = np.array([p.center for p in patches])
    column, row, _ = view.pixels(centres)
    # A patch in a deep hollow is drawn on the side from which the hollow opens.
    shown = np.flatnonzero(in_sight(picture_of(plan.part, view), centres, tolerance=0.015))
    ax.plot(column[shown], row[shown], "o", ms=6, mfc="none", mec="#c8102e", mew=0.8)
    add_labels(ax, np.column_stack([column, row])[shown], [str(n + 1) for n in shown], "#c8102e", size=8)


def _views(part: Part, pixels: int = 420) -> list[View]:
    """SIDES in one scale, `pixels` for the longest side among them; fewer where a cloud would show gaps."""
    if not part.is_mesh:
        few = part.vertices[:: max(1, len(part.vertices) // 2000)]
        apart = float(np.quantile(cKDTree(part.vertices).query(few, k=7)[0][:, -1], 0.9))
        pixels = int(np.clip(1.5 * part.extent.max() / max(apart, 1e-6), 100, pixels))
    scale = max(view_of(part, azimuth=a, elevation=e, pixels=pixels).scale for _, a, e in SIDES)
    return [view_of(part, azimuth=a, elevation=e, scale=scale) for _, a, e in SIDES]


def _gallery(views: list[View], rows: int) -> tuple["Figure", np.ndarray]:
    """A figure with the views in `rows` rows of axes, in one scale."""
    sizes = np.array([view.shape for view in views]).reshape(rows, -1, 2)
    heights, widths, width = sizes[..., 0].max(axis=1), sizes[..., 1].max(axis=0), 11.5
    scale = min(width / widths.sum(), 4.5 / heights.max())
    figure = new_figure(width, float(heights.sum()) * scale + 0.3 * rows + 0.4)
    return figure, figure.subplots(
        rows, sizes.shape[1], squeeze=False, width_ratios=widths, height_ratios=heights
    )


def hole_figure(part: Part, report: HoleReport) -> "Figure":
    """Six sides of the part with the boundary of each hole, coloured by kind and numbered."""
    views = _views(part)
    figure, axes = _gallery(views, 1)
    for ax, view, (side, *_) in zip(axes[0], views, SIDES, strict=True):
        image, picture = plain_image(part, view)
        _image(ax, image)
        ax.set_title(side, fontsize=8, loc="left")
        for number, hole in enumerate(report.holes, start=1):
            loop = np.vstack([hole.boundary, hole.boundary[:1]])
            shown = in_sight(picture, loop)
            if not shown.any():
                continue
            column, row, _ = picture.view.pixels(loop)
            colour = palette.HOLE_COLOURS.get(hole.kind, "#444444")
            ax.plot(np.where(shown, column, np.nan), np.where(shown, row, np.nan), color=colour, lw=1.2)
            ax.annotate(f"H{number}", (column[shown][0], row[shown][0]), color=colour, fontsize=7)
    kinds = sorted({hole.kind for hole in report.holes})
    _legend(figure, [(kind, palette.HOLE_COLOURS.get(kind, "#444444")) for kind in kinds])
    return figure


def reach_figure(plan: Plan) -> "Figure":
    """Viewpoints of a plan round the part; colour says served, or why not."""
    radius = plan.cell.settings.turntable.diameter_m / 2
    return reach_map(plan.viewpoints, causes_of(plan), plan.part, radius)


def reach_map(
    views: Sequence[Viewpoint], causes: Mapping[str, str], part: Part | None, table_radius: float
) -> "Figure":
    """Viewpoints from above and from the side.

    Args:
        views: the viewpoints.
        causes: for each id "served" or the cause for which it is left out.
        part: what stands on the table, None for nothing.
        table_radius: [m].
    """
    figure = new_figure(10.0, 4.4)
    above, beside = figure.subplots(1, 2)
    for view in views:
        colour = palette.CAUSE_COLOURS[causes[view.id]]
        tip = view.p_OS + view.standoff * view.direction
        radius, tip_radius = np.hypot(*view.p_OS[:2]), np.hypot(*tip[:2])
        for ax, x, y, dx, dy in (
            (above, view.p_OS[0], view.p_OS[1], *(tip - view.p_OS)[:2]),
            (beside, radius, view.p_OS[2], tip_radius - radius, tip[2] - view.p_OS[2]),
        ):
            ax.plot(x, y, marker="o" if view.kind == "revolution" else "s", ms=4, color=colour)
            ax.plot([x, x + 0.25 * dx], [y, y + 0.25 * dy], color=colour, lw=0.8)
    for ax, places in (
        (above, [v.p_OS[:2] for v in views]),
        (beside, [(np.hypot(*v.p_OS[:2]), v.p_OS[2]) for v in views]),
    ):
        add_labels(ax, np.array(places).reshape(-1, 2), [v.id for v in views], "#222222", size=7)
    _silhouette(above, beside, part, table_radius)
    used = sorted(set(causes.values()), key=list(palette.CAUSE_COLOURS).index)
    _legend(figure, [(name.replace("_", " "), palette.CAUSE_COLOURS[name]) for name in used])
    return figure


def causes_of(plan: Plan) -> dict[str, str]:
    """For each viewpoint "served" or the cause for which it was left out."""
    lost = dict(plan.left_out)
    causes = {}
    for view in plan.viewpoints:
        reason = lost.get(view.id)
        known = (c for c in palette.CAUSE_COLOURS if reason is not None and c in reason.replace(" ", "_"))
        causes[view.id] = "served" if reason is None else next(known, "other")
    return causes


def _silhouette(above: "Axes", beside: "Axes", part: Part | None, radius: float) -> None:
    points = np.zeros((0, 3)) if part is None else part.vertices[:: max(1, len(part.vertices) // 4000)]
    if part is not None and part.is_mesh:
        points = surface_samples(part, 8000, rng=fixed_stream("silhouette")).points
    above.plot(points[:, 0], points[:, 1], ",", color="#b0b0b0", zorder=0)
    beside.plot(np.hypot(points[:, 0], points[:, 1]), points[:, 2], ",", color="#b0b0b0", zorder=0)
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    above.plot(radius * np.cos(turn), radius * np.sin(turn), color="#b0b0b0", lw=0.8)
    beside.plot([0.0, radius], [0.0, 0.0], color="#b0b0b0", lw=2.0)
    above.set(xlabel="x of O [m]", ylabel="y of O [m]", aspect="equal", title="viewpoints from above")
    beside.set(
        xlabel="distance from the table's axis [m]",
        ylabel="z of O [m]",
        aspect="equal",
        title="viewpoints from the side",
    )


def cell_figure(cell: Cell, trajectory: Trajectory, X_WS: np.ndarray) -> "Figure":
    """The way of the scanner's optical centre in the cell, from above and from the side.

    Args:
        cell: robot and table.
        trajectory: what the robot drives.
        X_WS: pose of S at each time of the trajectory, shape (N, 4, 4).
    """
    figure = new_figure(10.0, 3.4)
    views = figure.subplots(1, 2)
    p = X_WS[:, :3, 3]
    for operation in trajectory.operations:
        inside = (trajectory.t >= operation.t_start) & (trajectory.t <= operation.t_end)
        colour = palette.OPERATION_COLOURS[operation.kind]
        still = np.ptp(p[inside], axis=0).max() < 1e-6
        for ax, second in zip(views, (1, 2), strict=True):
            ax.plot(p[inside, 0], p[inside, second], "o" if still else "-", color=colour, ms=4, lw=1.2)
    table, base = cell.X_WT[:3, 3], cell.X_WB[:3, 3]
    radius, turn = cell.settings.turntable.diameter_m / 2, np.linspace(0.0, 2.0 * np.pi, 100)
    views[0].plot(table[0] + radius * np.cos(turn), table[1] + radius * np.sin(turn), color="#b0b0b0")
    views[1].plot(table[0] + radius * np.array([-1, 1]), table[[2, 2]], color="#b0b0b0", lw=2)
    for ax, second, name in zip(views, (1, 2), "yz", strict=True):
        ax.plot(base[0], base[second], "^", color="#444444", ms=9)
        ax.annotate("robot", (base[0], base[second]), textcoords="offset points", xytext=(6, 6), fontsize=7)
        title = "the scanner's way, from " + ("above" if name == "y" else "the side")
        ax.set(xlabel="x of W [m]", ylabel=f"{name} of W [m]", aspect="equal")
        ax.set_title(title, fontsize=9)
        ax.grid(alpha=0.3)
    kinds = dict.fromkeys(o.kind for o in trajectory.operations)
    _legend(figure, [(kind, palette.OPERATION_COLOURS[kind]) for kind in kinds])
    return figure


def _image(ax: "Axes", image: np.ndarray) -> None:
    ax.imshow(image, interpolation="nearest", aspect="equal")
    ax.set_axis_off()


def _legend(figure: "Figure", entries: list[tuple[str, str]]) -> None:
    from matplotlib.patches import Patch

    if entries:
        handles = [Patch(color=colour, label=name) for name, colour in entries]
        figure.legend(
            handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False
        )
