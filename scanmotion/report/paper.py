"""The paper's experiments as one page: table 3, figures 9 to 13 and 16 to 20, the tour by its GA, its two
budgets.

Zhang et al., Actuators 2025, 14(3), 139 (doi 10.3390/act14030139). Guarantees: every figure on the page is
computed when the page is made, the paper's own figures stand beside it and are marked as such. Assumes: the
paper's carving is not at hand; the built-in one, or the given mesh, stands in for it, so that the figures
compare methods and not objects.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from scanmotion.cell.settings.cell import CellSettings
from scanmotion.core.part import Part
from scanmotion.core.support.streams import Streams
from scanmotion.motion.order.salesman.tsp import tour_from_cost
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.pipeline import plan
from scanmotion.planning.plan import Plan
from scanmotion.planning.worth.comparison import HEADER, Row, cells, compare
from scanmotion.report.assessment import Assessment, histogram_figure, map_figure
from scanmotion.report.figures.maps import coverage_figure, hole_figure, new_figure, reach_figure
from scanmotion.report.html import image, page, table
from scanmotion.sensing.metrology.deviations import DeviationLimits, deviations
from scanmotion.views.hole_views import grid_positions, paper_positions

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

PAPER_TOUR_MM = (763.9, 585.7)
"""Length of the scan path before and after the paper's GA, its figure 18."""
PAPER_BUDGETS_S = {"wood carving, section 4": 202.0, "marble, table 3": 152.0}
PAPER_CARVING = (0.77, 1.02)
"""Accuracy and standard deviation of the wood carving, section 4 [mm]."""
SITUATIONS = ((0.10, 0.05), (0.30, 0.29), (0.50, 0.10), (0.50, 0.30))
"""Sides a x b of a hole in the four situations of figure 9, with the field at 0.7 m [m]."""
METHODS = ("two-step", "paper-mode", "cad-slicing", "surface-partitioning")

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class TourLengths:
    """The way over the local viewpoints' places, as found and by the GA."""

    places: int
    as_found: float
    """In the order of the holes [m]."""
    at_random: float
    """Mean over 100 random orders [m]: the paper's start is a random path."""
    optimised: float
    """By the evolutionary search [m]."""
    bound: float
    """No order is shorter [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PaperExperiments:
    """What the page shows."""

    part: Part
    settings: CellSettings
    table: tuple[Row, ...]
    made: Plan
    """The plan of the default method."""
    tour: TourLengths


def paper_experiments(
    part: Part,
    settings: CellSettings,
    *,
    seeds: Sequence[int] = (0,),
    options: PlanOptions | None = None,
    progress: Progress = lambda s, f: None,
) -> PaperExperiments:
    """Plans and simulates everything that the page shows.

    Args:
        part: a mesh.
        settings: the cell.
        seeds: of table 3.
        options: what all plans share.
        progress: told the stage and the share done.
    """
    made = plan(part, settings, options=options, progress=progress)
    rows = compare(part, settings, variants=METHODS, seeds=tuple(seeds), options=options, progress=progress)
    places = np.array([v.p_OS for v in made.viewpoints if v.step == "local"]).reshape(-1, 3)
    return PaperExperiments(
        part=part, settings=settings, table=rows, made=made,
        tour=tour_lengths(places, rng=Streams(seed=seeds[0]).child("paper_tour")),
    )  # fmt: skip


def tour_lengths(places: np.ndarray, *, rng: np.random.Generator) -> TourLengths:
    """Lengths of the open way over places, shape (n, 3) [m], as the paper's figure 18 compares them.

    Args:
        places: in the order in which the holes were found.
        rng: of the random orders and of the search.
    """
    n = len(places)
    if n < 2:
        return TourLengths(places=n, as_found=0.0, at_random=0.0, optimised=0.0, bound=0.0)

    def length(order: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(places[order], axis=0), axis=1).sum())

    distances = np.linalg.norm(places[:, None] - places[None], axis=2)
    found = tour_from_cost(distances, rng=rng)
    return TourLengths(
        places=n, as_found=length(np.arange(n)),
        at_random=float(np.mean([length(rng.permutation(n)) for _ in range(100)])),
        optimised=length(np.asarray(found.order)), bound=float(found.lower_bound),
    )  # fmt: skip


def paper_record(it: PaperExperiments) -> dict[str, object]:
    """The page's figures for machines."""
    from scanmotion.planning.worth.comparison import document

    t, exact = it.tour, it.made.accuracy()
    before, after = PAPER_TOUR_MM
    return {
        "table_3": document(it.part.name, it.table),
        "tour_mm": {
            "places": t.places, "as_found": _mm(t.as_found), "at_random": _mm(t.at_random),
            "optimised": _mm(t.optimised), "bound": _mm(t.bound),
            "shorter": _shorter(t.at_random, t.optimised),
            "paper": {"before": before, "after": after, "shorter": round(1 - after / before, 4)},
        },
        "budgets_s": {
            name: {"paper": limit, "ours": ours, "kept": kept} for name, limit, ours, kept in budgets_kept(it)
        },
        "accuracy_mm": {
            "mean_abs": None if exact is None else _mm(exact.mean_abs),
            "sd_signed": None if exact is None else _mm(exact.sd_signed),
            "paper_carving": list(PAPER_CARVING),
        },
        "holes": len(it.made.holes.holes) if it.made.holes is not None else 0,
    }  # fmt: skip


def budgets_kept(it: PaperExperiments) -> list[tuple[str, float, float, bool]]:
    """Each of the paper's times: its name, the paper's seconds, ours, and whether ours are no more."""
    ours = it.made.time_s()["total"]
    return [(name, limit, round(ours, 2), bool(ours <= limit)) for name, limit in PAPER_BUDGETS_S.items()]


def _mm(metres: float) -> float:
    return round(metres * 1e3, 2)


def _shorter(before: float, after: float) -> float | None:
    return round(1 - after / before, 4) if before > 0 else None


def paper_html(it: PaperExperiments) -> str:
    """The page."""
    made, t = it.made, it.tour
    shorter, (before, after) = _shorter(t.at_random, t.optimised), PAPER_TOUR_MM
    percent = "-" if shorter is None else f"{shorter:.1%}"
    rows = [
        (f"{t.places} places of local viewpoints", f"{_mm(t.at_random):.1f}", f"{_mm(t.optimised):.1f}",
         percent),
        ("the paper, figure 18 (its text says 30%)", before, after, f"{1 - after / before:.1%}"),
    ]  # fmt: skip
    budgets = [
        (name, limit, f"{ours:.1f}", "kept" if kept else "NOT kept")
        for name, limit, ours, kept in budgets_kept(it)
    ]
    body = [
        f"<h1>The paper's experiments on {escape(it.part.name)}</h1>",
        '<p class="note">Zhang et al., Actuators 2025, 14(3), 139. The paper measured a wood carving and a '
        "marble sculpture that are not at hand; here the twin scans this object.</p>",
        "<h2>Table 3: three methods, and the published formulas literally</h2>",
        table(HEADER, [cells(row) for row in it.table]),
        "<h2>Figures 9 to 13: viewpoints over a hole of a x b</h2>",
        image(situations_figure(it.settings), "four situations"),
        "<h2>Figures 16 and 17: holes of the global model, and local viewpoints over them</h2>",
        *([image(hole_figure(it.part, made.holes), "holes")] if made.holes is not None else []),
        image(reach_figure(made), "viewpoints"),
        "<h2>Figure 18: the way over the local viewpoints</h2>",
        table(("", "random order, mm", "by the genetic algorithm, mm", "shorter"), rows),
        f'<p class="note">As the holes were found: {_mm(t.as_found):.1f} mm; '
        f'no order is shorter than {_mm(t.bound):.1f} mm.</p>',
        "<h2>Figure 19: what is seen after the global and after the local scan</h2>",
        image(coverage_figure(made), "coverage"),
        "<h2>Figure 20: deviation of the fused model</h2>", *_deviation(it),
        "<h2>The paper's times as budgets</h2>",
        table(("budget", "paper s", "ours s", ""), budgets),
    ]  # fmt: skip
    return page(f"scanmotion: the paper on {it.part.name}", "\n".join(body))


def _deviation(it: PaperExperiments) -> list[str]:
    cloud, exact = it.made.cloud, it.made.accuracy()
    if cloud is None or exact is None:
        return []
    found = deviations(cloud.points, cloud.normals, it.part, limits=DeviationLimits(samples=20_000))
    held = Assessment(measured="fused model", reference=it.part, alignment=None, found=found, limit=0.5e-3)
    mean, sd = PAPER_CARVING
    rows = [
        ("this object, in the twin", f"{_mm(exact.mean_abs):.2f}", f"{_mm(exact.sd_signed):.2f}"),
        ("the paper's wood carving", f"{mean:.2f}", f"{sd:.2f}"),
    ]  # fmt: skip
    return [
        table(("", "accuracy mm", "standard deviation mm"), rows),
        image(map_figure(held), "deviation from six sides"), image(histogram_figure(held), "histogram"),
    ]  # fmt: skip


def situations_figure(settings: CellSettings) -> "Figure":
    """Figures 9 to 13: fields over the hole's middle plane, by the paper's four cases and by the even
    grid.
    """
    scanner, d = settings.scanner_model(), settings.process.standoff_m
    long, short = (float(s) for s in scanner.field(d))
    figure = new_figure(11.5, 5.6)
    axes = figure.subplots(2, len(SITUATIONS))
    for k, (a, b) in enumerate(SITUATIONS):
        both = (paper_positions(a, b, long, short), grid_positions(a, b, long, short))
        for ax, places, name in zip(axes[:, k], both, ("paper", "default"), strict=True):
            ax.add_patch(_box(np.zeros(2), a, b, face="#d9d9d6", edge="none"))
            for p in places:
                ax.add_patch(_box(p, long, short, face="none", edge="#4c8bc4", wide=0.8))
            ax.plot(places[:, 0] * 1e3, places[:, 1] * 1e3, "o-", color="#c8102e", ms=3, lw=0.8)
            ax.set_title(
                f"{name}: {a * 1e3:.0f} x {b * 1e3:.0f} mm, {len(places)} views", fontsize=7, loc="left"
            )
            ax.set_aspect("equal")
            ax.autoscale_view()
            ax.tick_params(labelsize=6)
    return figure


def _box(centre: np.ndarray, a: float, b: float, *, face: str, edge: str, wide: float = 1.0) -> "Rectangle":
    """A field of a x b [m] about a centre, shape (2,) [m], drawn in mm."""
    from matplotlib.patches import Rectangle

    x, y = float(centre[0] - a / 2) * 1e3, float(centre[1] - b / 2) * 1e3
    return Rectangle((x, y), a * 1e3, b * 1e3, facecolor=face, edgecolor=edge, lw=wide)
