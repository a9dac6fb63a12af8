"""Labels of points that do not lie on one another."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RINGS = (7.0, 12.0, 18.0, 26.0, 36.0)
"""Distances from its point at which a label is tried [points]."""
_WAYS = 12
"""Directions at each."""
_LINE_FROM = 10.0
"""A label further off than this has a line to its point [points]."""


def add_labels(ax: "Axes", points: np.ndarray, texts: Sequence[str], colour: str, *, size: float) -> None:
    """Writes each text beside its point; the places are found when the figure is drawn for the first time.

    Args:
        ax: its limits hold the points.
        points: in data, shape (n, 2).
        texts: one for each.
        colour: of all.
        size: of the letters [points].
    """
    for point, text, offset in zip(points, texts, _offsets(ax, points, texts, size), strict=True):
        if offset is None:
            continue
        far = float(np.hypot(*offset)) > _LINE_FROM
        ax.annotate(
            text, (float(point[0]), float(point[1])), fontsize=size, color=colour, ha="center", va="center",
            textcoords="offset points", xytext=(float(offset[0]), float(offset[1])),
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.4, "shrinkA": 4} if far else None,
        )  # fmt: skip


def _offsets(ax: "Axes", points: np.ndarray, texts: Sequence[str], size: float) -> list[np.ndarray | None]:
    """Offsets of the labels in the axes as they will be drawn."""
    figure = ax.get_figure()
    assert figure is not None
    if not len(points):
        return []
    figure.draw_without_rendering()  # the layout decides how far apart the points are drawn
    places = ax.transData.transform(points) * 72.0 / figure.dpi
    sizes = np.array([(0.62 * size * len(t) + 1.0, 1.15 * size) for t in texts])
    return label_offsets(places, sizes)


def label_offsets(points: np.ndarray, sizes: np.ndarray) -> list[np.ndarray | None]:
    """Where the middles of labels stand beside their points, so that no two overlap and none hides a point.

    Greedy, in order; None for a label that finds no free place near its point.

    Args:
        points: shape (n, 2).
        sizes: width and height of each label, shape (n, 2).
    """
    angles = np.pi / 6 + 2 * np.pi * np.arange(_WAYS) / _WAYS
    around = np.concatenate([r * np.column_stack([np.cos(angles), np.sin(angles)]) for r in _RINGS])
    taken: list[tuple[np.ndarray, np.ndarray]] = []
    out: list[np.ndarray | None] = []
    for point, half in zip(points, sizes / 2, strict=True):
        out.append(None)
        for way in around:
            offset = way + np.sign(np.round(way, 9)) * (half - np.minimum(half, 3.0))
            middle = point + offset
            if (np.abs(points - middle) < half).all(axis=1).any():
                continue
            if all((np.abs(middle - m) >= half + h).any() for m, h in taken):
                taken.append((middle, half))
                out[-1] = offset
                break
    return out
