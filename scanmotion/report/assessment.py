"""The page of an assessment: figures, coloured map, histogram, sections; one file without a network."""

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from scanmotion import __version__
from scanmotion.core.part import Part
from scanmotion.core.support.threads import allowed_threads
from scanmotion.report.figures.maps import SIDES, new_figure
from scanmotion.report.figures.surface import picture_of, shaded, view_of
from scanmotion.report.html import image, page, table
from scanmotion.sensing.metrology.alignment import Alignment
from scanmotion.sensing.metrology.deviations import PERCENTILES, Deviations, RegionFigures, Spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOT_MEASURED = np.array([0.55, 0.55, 0.55])
_RED, _BLUE, _PALE = (np.array(c) / 255 for c in ((178.0, 24, 43), (33.0, 102, 172), (235.0, 235, 235)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Assessment:
    """A measured cloud held against a reference, and how it came to lie there."""

    measured: str
    reference: Part
    alignment: Alignment | None
    found: Deviations
    limit: float
    """Distance of the full colour [m]."""
    artefact: dict[str, float] | None = None
    """Figures on a sphere, a ball bar or a plane, in mm, where the reference is one."""


def assessment_record(a: Assessment) -> dict[str, object]:
    """assess.json: all figures in millimetres and shares."""
    d = a.found
    return {
        "software": f"scanmotion {__version__}", "units": "mm",
        "measured": a.measured, "reference": a.reference.name,
        "alignment": None
        if a.alignment is None
        else {
            "statement": a.alignment.statement, "start": a.alignment.start, "free_motions": a.alignment.free,
            "within_reach": round(a.alignment.within, 6), "rms_mm": _mm(a.alignment.rms),
            "T_reference_measured": _pose_mm(a.alignment.X),
        },
        "completeness": None if d.completeness is None else round(d.completeness, 6),
        "points_cut": d.cut, "all": _spread_mm(d.spread),
        "regions": [
            {
                "name": r.name, "completeness": None if r.completeness is None else round(r.completeness, 6),
                **(_spread_mm(r.spread) if r.spread is not None else {"points": 0}),
            }
            for r in d.regions
        ],
        "artefact": a.artefact,
    }  # fmt: skip


def _mm(metres: float) -> float:
    return round(metres * 1e3, 6)


def _pose_mm(X: np.ndarray) -> list[list[float]]:
    out = X.copy()
    out[:3, 3] *= 1e3
    return np.round(out, 9).tolist()


def _spread_mm(s: Spread) -> dict[str, object]:
    return {
        "points": s.points, "mean_abs_mm": _mm(s.mean_abs), "mean_signed_mm": _mm(s.mean_signed),
        "sd_signed_mm": _mm(s.sd_signed), "rms_mm": _mm(s.rms),
        "least_mm": _mm(s.least), "greatest_mm": _mm(s.greatest),
        "percentiles": {
            f"{p:g}": {"signed_mm": _mm(x), "abs_mm": _mm(y)}
            for p, x, y in zip(PERCENTILES, s.signed, s.absolute, strict=True)
        },
    }  # fmt: skip


def assessment_html(a: Assessment) -> str:
    """The page."""
    body = [
        f"<h1>{escape(a.measured)} against {escape(a.reference.name)}</h1>",
        table((), figure_rows(a)),
        '<p class="note">Accuracy is the mean of the absolute distance, standard deviation that of the '
        "signed one (both as in doi 10.3390/act14030139); positive is outside of the reference.</p>",
        "<h2>Where it deviates</h2>",
        image(map_figure(a), "deviation from six sides"),
        image(histogram_figure(a), "histogram of the signed distance"),
    ]
    if a.reference.is_mesh:
        body += ["<h2>Sections</h2>", image(section_figure(a), "three sections")]
    if a.found.regions:
        header = (
            "region",
            "points",
            "covered",
            "mean abs mm",
            "mean signed mm",
            "sd mm",
            "rms mm",
            "95 % abs mm",
        )
        body += ["<h2>Regions</h2>", table(header, [_region_row(r) for r in a.found.regions])]
    if a.artefact is not None:
        body += ["<h2>Artefact</h2>", table(("figure", "value"), list(a.artefact.items()))]
    return page(f"scanmotion: {a.measured}", "\n".join(body))


def _region_row(r: RegionFigures) -> tuple[str, ...]:
    covered = "-" if r.completeness is None else f"{r.completeness:.2%}"
    if r.spread is None or not r.spread.points:
        return (r.name, "0", covered, "-", "-", "-", "-", "-")
    s = r.spread
    last = s.absolute[PERCENTILES.index(95)]
    figures = (s.mean_abs, s.mean_signed, s.sd_signed, s.rms, last)
    return (r.name, str(s.points), covered, *(f"{_mm(x):.3f}" for x in figures))


def figure_rows(a: Assessment) -> list[tuple[str, str]]:
    """Name and value of each figure, for the page and the terminal."""
    s, covered = a.found.spread, a.found.completeness
    rows = [
        ("accuracy: mean of the absolute distance", f"{_mm(s.mean_abs):.4f} mm"),
        ("standard deviation of the signed distance", f"{_mm(s.sd_signed):.4f} mm"),
        ("mean of the signed distance", f"{_mm(s.mean_signed):+.4f} mm"),
        ("root mean square", f"{_mm(s.rms):.4f} mm"),
        (
            "percentiles of the absolute distance",
            ", ".join(f"{p:g} %: {_mm(x):.3f}" for p, x in zip(PERCENTILES, s.absolute, strict=True)),
        ),
        ("least and greatest", f"{_mm(s.least):+.3f} to {_mm(s.greatest):+.3f} mm"),
        (
            "completeness",
            "not known: the reference is a cloud of points" if covered is None else f"{covered:.2%}",
        ),
        ("points", f"{s.points}, {a.found.cut} cut off"),
    ]
    if a.alignment is not None:
        rows.append(("alignment", a.alignment.statement))
    return rows


def _colours(d: np.ndarray, limit: float) -> np.ndarray:
    x = np.clip(d / limit, -1.0, 1.0)[:, None]
    return np.where(x > 0, _PALE + x * (_RED - _PALE), _PALE - x * (_BLUE - _PALE))


def map_figure(a: Assessment) -> "Figure":
    """The reference from six sides, coloured by the nearest measured point; grey where there is none."""
    tree = cKDTree(a.found.points)
    scale = max(view_of(a.reference, azimuth=z, elevation=e, pixels=380).scale for _, z, e in SIDES)
    views = [view_of(a.reference, azimuth=z, elevation=e, scale=scale) for _, z, e in SIDES]
    figure = new_figure(11.5, 3.6)
    axes = figure.subplots(1, len(views), squeeze=False, width_ratios=[v.shape[1] for v in views])[0]
    for ax, view, (side, *_) in zip(axes, views, SIDES, strict=True):
        picture = picture_of(a.reference, view)
        far, k = tree.query(picture.points, distance_upper_bound=0.003, workers=allowed_threads())
        hit = np.isfinite(far)
        colours = np.tile(_NOT_MEASURED, (len(picture.points), 1))
        colours[hit] = _colours(a.found.distance[k[hit]], a.limit)
        ax.imshow(shaded(picture, colours), interpolation="nearest")
        ax.set_title(side, fontsize=8, loc="left")
        ax.axis("off")
    figure.suptitle(
        f"blue: inside, red: outside, full colour at {a.limit * 1e3:g} mm; grey: not measured", fontsize=8
    )
    return figure


def histogram_figure(a: Assessment) -> "Figure":
    """Signed distances within four times the limit of the colours; the title counts what lies beyond."""
    d, wide = a.found.distance * 1e3, 4 * a.limit * 1e3
    figure = new_figure(8.0, 2.8)
    ax = figure.subplots()
    ax.hist(d[np.abs(d) <= wide], bins=121, range=(-wide, wide), color="#4c8bc4")
    ax.set_xlabel("signed distance [mm]")
    ax.set_ylabel("points")
    ax.set_title(
        f"{int((np.abs(d) > wide).sum())} of {len(d)} points lie beyond the picture", fontsize=8, loc="left"
    )
    return figure


def section_figure(a: Assessment) -> "Figure":
    """Cuts through the middle of the reference: its outline, and the measured points near the cut."""
    figure = new_figure(11.5, 4.2)
    middle = a.reference.bounds.mean(axis=0)
    thick = max(0.002, 0.004 * float(a.reference.extent.max()))
    for axis, ax in enumerate(figure.subplots(1, 3)):
        u, v = (i for i in range(3) if i != axis)
        for start, end in cut_lines(a.reference, axis, float(middle[axis])):
            ax.plot([start[u] * 1e3, end[u] * 1e3], [start[v] * 1e3, end[v] * 1e3], color="#444", lw=0.5)
        near = np.abs(a.found.points[:, axis] - middle[axis]) < thick
        p = a.found.points[near]
        ax.scatter(p[:, u] * 1e3, p[:, v] * 1e3, s=1.5, c=_colours(a.found.distance[near], a.limit), zorder=3)
        ax.set_aspect("equal")
        ax.set_title(f"{'xyz'[axis]} = {middle[axis] * 1e3:.0f} mm", fontsize=8, loc="left")
        ax.tick_params(labelsize=7)
    return figure


def cut_lines(part: Part, axis: int, at: float) -> np.ndarray:
    """Segments in which the plane `axis` = `at` cuts the mesh, shape (k, 2, 3) [m]."""
    corners = part.vertices[part.triangles]
    side = corners[..., axis] - at
    side = np.where(np.abs(side) < 1e-12, 1e-12, side)
    crossed = np.stack([side[:, i] * side[:, (i + 1) % 3] < 0 for i in range(3)], axis=1)
    rows = np.flatnonzero(crossed.sum(axis=1) == 2)
    points = []
    for i in range(3):
        s, t = side[rows, i], side[rows, (i + 1) % 3]
        share = (s / np.where(s == t, 1.0, s - t))[:, None]
        points.append(corners[rows, i] + share * (corners[rows, (i + 1) % 3] - corners[rows, i]))
    stacked, mask = np.stack(points, axis=1), crossed[rows]
    return stacked[mask].reshape(-1, 2, 3)
