"""One HTML page about a study: heat maps, seconds against completeness, ranking, the best cell's YAML.

It opens without a network. Figures are means over parts and seeds; the spread is half of largest minus
smallest over the seeds.
"""

import base64
import html
import io
import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from scanmotion.core.errors import InputError
from scanmotion.report.figures.maps import new_figure
from scanmotion.studies import table

MAPS = {
    "completeness": "share of what can be seen",
    "reachable": "share of the poses that are reached",
    "seconds": "seconds",
}
"""Figures that a heat map is made of."""
_WEIGHT = 1e4
"""Seconds that a whole share of completeness counts for in the ranking: 0.01 % is one second."""


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """One robot in one layout with one method, over parts and seeds."""

    robot: str
    layout: str
    method: str
    parts: int
    cases: int
    failed: int
    completeness: float | None
    seconds: float | None
    reachable: float | None
    spread_s: float
    """Half of the largest difference between seeds of one part [s]."""
    pareto: bool
    """No other has at least as much completeness in fewer seconds."""
    settings: dict[str, Any]


def ranking(rows: list[dict[str, Any]]) -> list[Ranked]:
    """Groups of rows, best first: fewest failures, then completeness against seconds, or what is reached."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[row["robot"], row["layout"], row["method"]].append(row)
    made = [_ranked(key, group) for key, group in groups.items()]
    whole = [(r.completeness, r.seconds) for r in made if r.failed == 0]
    marked = [_marked(r, whole) for r in made]
    return sorted(marked, key=_rank)


def _ranked(key: tuple[str, str, str], group: list[dict[str, Any]]) -> Ranked:
    def mean(name: str) -> float | None:
        values = [row[name] for row in group if row["status"] == "ok" and row[name] is not None]
        return float(np.mean(values)) if values else None

    by_part: dict[str, list[float]] = defaultdict(list)
    for row in group:
        if row["status"] == "ok" and row["seconds"] is not None:
            by_part[row["part"]].append(row["seconds"])
    spread = max((np.ptp(v) / 2 for v in by_part.values()), default=0.0)
    return Ranked(
        robot=key[0],
        layout=key[1],
        method=key[2],
        parts=len({row["part"] for row in group}),
        cases=len(group),
        failed=sum(row["status"] != "ok" for row in group),
        completeness=mean("completeness"),
        seconds=mean("seconds"),
        reachable=mean("reachable"),
        spread_s=float(spread),
        pareto=False,
        settings=json.loads(group[0]["settings"]),
    )


def _marked(item: Ranked, whole: list[tuple[float | None, float | None]]) -> Ranked:
    from dataclasses import replace

    if item.failed or item.completeness is None or item.seconds is None:
        return item
    beaten = any(
        c is not None
        and s is not None
        and c >= item.completeness
        and s <= item.seconds
        and (c > item.completeness or s < item.seconds)
        for c, s in whole
    )
    return replace(item, pareto=not beaten)


def _rank(item: Ranked) -> tuple[Any, ...]:
    share = item.completeness if item.completeness is not None else item.reachable
    worth = -np.inf if share is None else share * _WEIGHT - (item.seconds or 0.0)
    return (item.failed, -worth, item.robot, item.layout, item.method)


def study_html(path: Path) -> str:
    """The page of the table in file `path`.

    Raises:
        InputError: no table of a study, or no row in it.
    """
    with table.opened(path) as connection:
        rows = table.records(connection)
    if not rows:
        raise InputError(f"{path}: the table has no row yet")
    ranked = ranking(rows)
    maps = [heat_map(rows, name) for name in MAPS]
    pictures = [_picture(figure) for figure in (*maps, *pareto_charts(ranked)) if figure is not None]
    failed = [row for row in rows if row["status"] != "ok"]
    body = [
        f"<h1>Study {html.escape(path.name)}</h1>",
        f"<p>{_sentence(ranked[0], rows, failed)}</p>",
        *pictures,
        "<h2>Ranking</h2>",
        _ranking_table(ranked),
        "<p>Fewest failed cases first; then completeness against seconds, where "
        f"{1 / _WEIGHT:.2%} of what can be seen counts as much as one second.</p>",
        *(["<h2>Cases without a plan</h2>", _failed_table(failed)] if failed else []),
        "<h2>The first cell of the ranking</h2>",
        f"<pre>{html.escape(best_cell(ranked))}</pre>",
    ]
    return _PAGE.format(title=html.escape(path.name), body="\n".join(body))


def best_cell(ranked: list[Ranked]) -> str:
    """The YAML of the first cell of a ranking, ready for `scanmotion plan --cell`."""
    return yaml.safe_dump(ranked[0].settings, sort_keys=False, allow_unicode=True)


def heat_map(rows: list[dict[str, Any]], name: str) -> Any:
    """A figure's mean over parts and seeds: layouts down, robots and methods across; None if nowhere."""
    layouts = list(dict.fromkeys(row["layout"] for row in rows))
    columns = list(dict.fromkeys((row["robot"], row["method"]) for row in rows))
    values = defaultdict(list)
    for row in rows:
        if row[name] is not None:
            values[layouts.index(row["layout"]), columns.index((row["robot"], row["method"]))].append(
                row[name]
            )
    if not values:
        return None
    grid = np.full((len(layouts), len(columns)), np.nan)
    for place, found in values.items():
        grid[place] = np.mean(found)
    figure = new_figure(3.0 + 1.4 * len(columns), 1.6 + 0.4 * len(layouts))
    axes = figure.add_subplot()
    axes.imshow(grid, cmap="viridis_r" if name == "seconds" else "viridis", aspect="auto")
    axes.set_xticks(range(len(columns)), [f"{robot}\n{method}" for robot, method in columns])
    axes.set_yticks(range(len(layouts)), layouts)
    for (i, j), value in np.ndenumerate(grid):
        text = f"{value:.1f}" if name == "seconds" else f"{value:.2%}"
        box = {"facecolor": "white", "alpha": 0.7, "lw": 0}
        axes.text(j, i, text if np.isfinite(value) else "none", ha="center", va="center", bbox=box)
    axes.set_title(MAPS[name])
    return figure


def pareto_charts(ranked: list[Ranked]) -> list[Any]:
    """Seconds against completeness of every group; those that no other beats are named."""
    known = [r for r in ranked if r.completeness is not None and r.seconds is not None]
    if len(known) < 2:
        return []
    figure = new_figure(7.0, 4.5)
    axes = figure.add_subplot()
    for item in known:
        assert item.completeness is not None and item.seconds is not None
        colour = "tab:orange" if item.pareto else "tab:grey"
        axes.errorbar(item.seconds, item.completeness * 100, xerr=item.spread_s, fmt="o", color=colour)
        if item.pareto:
            axes.annotate(f" {item.robot}, {item.layout}", (item.seconds, item.completeness * 100))
    axes.set_xlabel("seconds of the programme")
    axes.set_ylabel("% of what can be seen")
    axes.set_title("orange: no other has as much in fewer seconds")
    return [figure]


def _picture(figure: Any) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">'


def _sentence(best: Ranked, rows: list[dict[str, Any]], failed: list[dict[str, Any]]) -> str:
    what = f"{len(rows)} cases, {len(failed)} of them without a plan. First of the ranking: "
    what += f"{best.robot}, {best.layout}, {best.method}"
    if best.completeness is not None and best.seconds is not None:
        what += (
            f": {best.completeness:.2%} of what can be seen in {best.seconds:.1f} s on the mean of its cases"
        )
    elif best.reachable is not None:
        what += f": {best.reachable:.1%} of the scanner's poses are reached"
    return html.escape(what + ".")


def _ranking_table(ranked: list[Ranked]) -> str:
    header = (
        "robot",
        "layout",
        "method",
        "cases",
        "failed",
        "completeness",
        "seconds",
        "spread s",
        "reached",
    )
    lines: list[tuple[str, ...]] = [header]
    for r in ranked:
        share = "" if r.completeness is None else f"{r.completeness:.2%}"
        seconds = "" if r.seconds is None else f"{r.seconds:.1f}"
        reached = "" if r.reachable is None else f"{r.reachable:.1%}"
        lines.append(
            (
                r.robot,
                r.layout,
                r.method,
                str(r.cases),
                str(r.failed),
                share,
                seconds,
                f"{r.spread_s:.1f}",
                reached,
            )
        )
    return _table(lines)


def _failed_table(failed: list[dict[str, Any]]) -> str:
    names = ("robot", "layout", "part", "method", "seed", "status", "reason")
    return _table([names, *(tuple(str(row[n]) for n in names) for row in failed[:200])])


def _table(lines: Sequence[tuple[str, ...]]) -> str:
    def row(line: tuple[str, ...], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(text)}</{tag}>" for text in line) + "</tr>"

    return "<table>" + row(lines[0], "th") + "".join(row(line, "td") for line in lines[1:]) + "</table>"


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title><style>
body {{ font: 15px/1.5 sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; }}
img {{ max-width: 100%; display: block; margin: 1em 0; }}
table {{ border-collapse: collapse; display: block; overflow-x: auto; }}
td, th {{ border: 1px solid #ccc; padding: 2px 8px; text-align: left; }}
pre {{ background: #f4f4f4; padding: 1em; overflow-x: auto; }}
</style></head><body>
{body}
</body></html>
"""
