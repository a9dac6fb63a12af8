"""`scanmotion plan --placements`: several placements of the part, each a programme of its own."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scanmotion.cli.app import CHECK_FAILED, OK, Progress, print_table, say_json
from scanmotion.cli.plans.pages import pages
from scanmotion.core.errors import InputError

if TYPE_CHECKING:
    from scanmotion.cell.settings.cell import CellSettings
    from scanmotion.core.part import Part
    from scanmotion.core.viewpoint import Viewpoint
    from scanmotion.planning.options import PlanOptions
    from scanmotion.planning.placements.plan_placements import PlacedPlan, PlacementOptions
    from scanmotion.planning.plan import Plan

AUTO = 3
"""Placements at most where the number is left to us."""
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, eq=False, kw_only=True)
class OwnViews:
    """The user's own viewpoints, and whether their order stays."""

    viewpoints: "tuple[Viewpoint, ...]"
    order: Literal["fastest", "given"]


def own_views_from(
    file: Path | None, order: str, *, placements: str, keep: Path | None, motion: str
) -> OwnViews | None:
    """What --viewpoints and --order ask for; None without the former.

    Raises:
        InputError: the file cannot be read, an unknown order, or an option that does not go with them.
    """
    if order != "fastest" and order != "given":
        raise InputError(f"--order {order}: fastest or given is expected")
    if file is None:
        if order == "given":
            raise InputError("--order given: only together with --viewpoints")
        return None
    with_it = {"--placements": placements.strip() != "1", "--keep": keep is not None}
    wrong = [name for name, is_there in {**with_it, "--motion": motion != "stops"}.items() if is_there]
    if wrong:
        raise InputError(f"--viewpoints: not together with {wrong[0]}")
    from scanmotion.export.viewpoints import read_viewpoints

    return OwnViews(viewpoints=read_viewpoints(file), order=order)


@dataclass(frozen=True, eq=False, kw_only=True)
class New:
    """A plan that begins with nothing."""

    part: "Part"
    settings: "CellSettings"
    options: "PlanOptions"
    own: "OwnViews | None" = None

    def planned(self, progress: Progress) -> "Plan":
        """The plan."""
        from scanmotion.planning.pipeline import plan

        own = self.own
        return plan(
            self.part, self.settings, options=self.options, progress=progress,
            viewpoints=None if own is None else own.viewpoints,
            order="fastest" if own is None else own.order,
        )  # fmt: skip


def placing_from(placements: str, forbid: str) -> "PlacementOptions | None":
    """What the words of --placements and --forbid mean; None for one placement.

    Raises:
        InputError: no number, no list of axes.
    """
    from scanmotion.planning.placements.plan_placements import PlacementOptions

    words = placements.strip()
    if words == "1":
        if forbid:
            raise InputError("--forbid: only together with --placements")
        return None
    down = tuple(_axis("--forbid", word) for word in forbid.split(",") if word.strip())
    if words == "auto":
        return PlacementOptions(most=AUTO, forbid=down)
    if words.isdigit():
        if not 2 <= int(words) <= 6:
            raise InputError(f"--placements {words}: a number from 1 to 6 is expected")
        return PlacementOptions(most=int(words), forbid=down)
    ups = tuple(_axis("--placements", word) for word in words.split(","))
    return PlacementOptions(most=1 + len(ups), ups=ups, forbid=down)


def _axis(option: str, word: str) -> tuple[float, float, float]:
    text = word.strip()
    if len(text) != 2 or text[0] not in "+-" or text[1] not in _AXES:
        raise InputError(f"{option} {text}: auto, a number, or axes such as +y,-z are expected")
    sign = 1.0 if text[0] == "+" else -1.0
    x, y, z = (sign * v for v in _AXES[text[1]])
    return (x, y, z)


def plan_placed(
    request: New, placing: "PlacementOptions", *, out: Path, html: bool, progress: Progress
) -> "PlacedPlan":
    """Plans all placements and writes their folder."""
    from scanmotion.judge import margins_of, verify
    from scanmotion.plan_io.placed_folder import save_placed
    from scanmotion.planning.placements.plan_placements import plan_placements
    from scanmotion.report.placements_page import placements_html

    made = plan_placements(
        request.part, request.settings, options=request.options, placing=placing, progress=progress
    )
    for placement in made.placements:
        if placement.plan.trajectory is None:
            raise InputError(f"nothing could be planned: {_why(placement.plan)}")
    save_placed(
        made, out, judge=verify, measure=margins_of,
        pages=partial(pages, progress=progress) if html else None,
        page=(lambda p: {"report.html": placements_html(p)}) if html else None,
    )  # fmt: skip
    return made


def _why(plan: "Plan") -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in plan.left_out[:3])


def say_placed(out: Path, *, quiet: bool, json: bool) -> int:
    """Tells what the placements achieve; the status of the command."""
    import json as reader

    summary = reader.loads((out / "summary.json").read_text(encoding="utf-8"))
    if json:
        say_json(summary)
    elif not quiet:
        rows = [_row(item) for item in summary["placements"]]
        print_table("Placements", ("folder", "rests", "adds", "seconds", "found again", "mind"), rows)
        share = summary["completeness"]
        total = (
            ("of what a floating part shows", f"{share['of_ceiling']:.2%}"),
            ("of the whole surface", f"{share['of_whole']:.2%}"),
            ("robot time", f"{summary['time_s']['total']:.1f} s, handling not counted"),
            ("files", str(out)),
        )
        print_table("Together", (), list(total))
        if summary["findings"]:
            print_table("The judge found", ("finding",), [(line,) for line in summary["findings"]])
    return CHECK_FAILED if summary["findings"] else OK


def _row(item: dict) -> tuple[str, ...]:
    found = item["registration"]
    words = "" if found is None else ("trusted" if found["trusted"] else "NOT trusted")
    words += "" if found is None else f", {found['simulated_mm']:.2f} mm"
    return (
        item["folder"], item["rests"], f"{item['adds_of_ceiling']:.2%}", f"{item['time_s']:.1f}", words,
        "; ".join(item["warnings"]),
    )  # fmt: skip
