"""The answer to a measured scan that lacks nothing: no programme, a summary and a report that say so."""

import html as markup
from pathlib import Path
from typing import TYPE_CHECKING

from scanmotion.cli.app import print_table, say_json

if TYPE_CHECKING:
    from scanmotion.planning.plan import Plan

ANSWER = "nothing is missing: the scan has no hole that a viewpoint could fill"


def is_complete(made: "Plan") -> bool:
    """Whether a plan is empty because nothing is left to do, and not because something stood in the way."""
    return made.options.source == "scan" and made.trajectory is None and not made.left_out


def write_answer(made: "Plan", out: Path, *, html: bool) -> None:
    """Writes summary.json and report.html into a folder that holds no plan."""
    import json

    out.mkdir(parents=True, exist_ok=True)
    for stale in out.iterdir():
        if stale.is_file():
            stale.unlink()
    (out / "summary.json").write_text(json.dumps(summary_of(made), indent=1, allow_nan=False) + "\n")
    if html:
        (out / "report.html").write_text(page_of(made), encoding="utf-8")


def summary_of(made: "Plan") -> dict[str, object]:
    """What summary.json says where there is no programme."""
    part, tiny = made.part, made.holes.tiny if made.holes is not None else ()
    return {
        "answer": ANSWER,
        "nothing_missing": True,
        "viewpoints": {"global": 0, "local": 0, "unreachable": []},
        "holes": {"found": len(made.holes.holes) if made.holes is not None else 0, "tiny": len(tiny)},
        "unscanned": [
            {
                "center_mm": [round(float(c) * 1e3, 3) for c in patch.center],
                "area_mm2": round(float(patch.area) * 1e6, 1),
                "reason": patch.reason,
            }
            for patch in made.unscanned
        ],
        "time_s": {"total": 0.0},
        "budget": {"limit_s": made.cell.settings.process.budget_s, "ok": True},
        "findings": [],
        "read": None if part.report is None else part.report.record(),
    }


def page_of(made: "Plan") -> str:
    """The report: the answer, what was read, and a picture of the scan."""
    import base64
    import io

    from scanmotion.report.figures.maps import hole_figure

    picture = ""
    if made.holes is not None:
        buffer = io.BytesIO()
        hole_figure(made.part, made.holes).savefig(buffer, format="png")
        data = base64.b64encode(buffer.getvalue()).decode("ascii")
        picture = f'<img alt="the scan" style="max-width:100%" src="data:image/png;base64,{data}">'
    lines = [ANSWER[0].upper() + ANSWER[1:] + "."]
    if tiny := len(made.holes.tiny) if made.holes is not None else 0:
        lines.append(f"{tiny} gaps are too small to be planned for.")
    lines += [f"{area} stay open: {reason}." for area, reason in _open(made)]
    if made.part.report is not None:
        lines.append(f"Read: {made.part.report.line}.")
    rows = "".join(f"<p>{markup.escape(line)}</p>" for line in lines)
    title = f"scanmotion: {markup.escape(made.part.name)}"
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title></head>'
        f"<body style='font-family:sans-serif;max-width:60em;margin:2em auto'><h1>{title}</h1>{rows}"
        f"{picture}</body></html>\n"
    )


def _open(made: "Plan") -> list[tuple[str, str]]:
    """How much surface stays open, and why, patch by patch."""
    return [(f"{round(float(patch.area) * 1e6, 1):g} mm2", patch.reason) for patch in made.unscanned]


def say_answer(made: "Plan", out: Path, *, html: bool, quiet: bool, json: bool) -> None:
    """One line, and where the files are."""
    if json:
        say_json(summary_of(made))
    elif not quiet:
        open_ = [(f"{area} stay open", reason) for area, reason in _open(made)]
        print_table("The scan", (), [("answer", ANSWER), *open_])
        names = ["summary.json"] + (["report.html"] if html else [])
        print_table("Files", (), [(name.split(".")[0], str(out / name)) for name in names])


def holds_answer(folder: Path) -> bool:
    """Whether a folder holds such an answer, which another run may replace."""
    names = {p.name for p in folder.iterdir()}
    return "summary.json" in names and names <= {"summary.json", "report.html"}
