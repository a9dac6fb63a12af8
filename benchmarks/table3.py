"""Makes docs/results.md's tables: table 3 of the paper on many objects, with ablations and several seeds.

    python benchmarks/table3.py --data ../shared/data [--seeds 3] [--cache build/table3] [--write-only]

Objects are the built-in carving and every mesh of the folder. Each finished plan is kept in the cache under a
digest of the programme's sources, so that the run can be stopped and taken up again; --write-only makes the
page from what is there. First come the default, the paper's mode and the two other methods on every object
with seed 0, then the other rows on three objects, then further seeds.
"""

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import scanmotion
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.part import Part
from scanmotion.geometry.parts.make_part import carving, part_from_file
from scanmotion.planning.worth.comparison import (
    MEANINGS,
    PAPER_TABLE_3,
    VARIANTS,
    Figures,
    Row,
    figures,
    row_from,
)

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results.md"
BEGIN, END = "<!-- table3: begin -->", "<!-- table3: end -->"
METHODS = ("two-step", "as-found", "paper-mode", "cad-slicing", "surface-partitioning")
ABLATED = ("carving", "nefertiti_bust", "ugolino")
COMPLETE, MEAN_MM, SD_MM, FLOOR, AGAINST_PAPER = 0.999, 0.10, 0.12, 1.10, 0.5
BUDGET_S = {"carving": 101.0, "relief_dancing_girl": 101.0}
"""Half of the paper's seconds for a carving of this size; for all others half of those for its statue."""
STATUE_S = 76.0


@dataclass(frozen=True)
class Job:
    """One plan."""

    object: str
    variant: str
    seed: int

    @property
    def file(self) -> str:
        """Its name in the cache."""
        return f"{self.object}--{self.variant}--{self.seed}.json"


def digest() -> str:
    """Of all sources that a plan depends on."""
    root, h = Path(scanmotion.__file__).parent, hashlib.sha256()
    leaves = {"cli", "figures", "export", "judge", "report.py", "show.py", "comparison.py"}
    for path in sorted(root.rglob("*")):
        parts = path.relative_to(root).parts
        if path.is_file() and "__pycache__" not in parts and parts[0] not in leaves:
            h.update("/".join(parts).encode() + path.read_bytes())
    return h.hexdigest()[:12]


def jobs(objects: Sequence[str], seeds: int) -> Iterator[Job]:
    """What is planned, in order."""
    ablated = [name for name in ABLATED if name in objects] or list(objects[:3])
    rest = [v for v in VARIANTS if v not in METHODS]
    for seed in range(seeds):
        for variant in METHODS:
            yield from (Job(name, variant, seed) for name in objects)
        for name in ablated:
            yield from (Job(name, variant, seed) for variant in rest)


def load(data: Path | None, name: str) -> Part:
    """The built-in carving, or a mesh of the folder."""
    if name == "carving":
        return carving()
    assert data is not None
    return part_from_file(data / f"{name}.ply")


def run(todo: Sequence[Job], data: Path | None, cache: Path, robot: str) -> None:
    """Plans what is not in the cache yet."""
    cache.mkdir(parents=True, exist_ok=True)
    settings = load_cell(robot)
    for k, job in enumerate(todo):
        target = cache / job.file
        if target.is_file():
            continue
        try:
            part = load(data, job.object)
            found = asdict(figures(part, settings, job.variant, seed=job.seed))
            record = {"extent_mm": [round(float(s) * 1e3) for s in part.extent], "figures": found}
            line = f"{found['integrity']:.2%} {found['time_s']:.1f} s, planned in {found['planning_s']:.0f} s"
        except Exception as error:  # one failed plan must not cost the others
            record = {"error": f"{type(error).__name__}: {error}"}
            line = record["error"]
        whole = target.with_suffix(".part")
        whole.write_text(json.dumps(record))
        os.replace(whole, target)
        print(f"{k + 1}/{len(todo)} {job.object}, {job.variant}, seed {job.seed}: {line}", flush=True)


class Results:
    """What the cache holds."""

    def __init__(self, todo: Sequence[Job], cache: Path) -> None:
        self.found: dict[tuple[str, str], list[Figures]] = {}
        self.errors: dict[tuple[str, str], str] = {}
        self.extent: dict[str, list[float]] = {}
        for job in todo:
            path = cache / job.file
            if not path.is_file():
                continue
            record = json.loads(path.read_text())
            if "error" in record:
                self.errors[job.object, job.variant] = record["error"]
                continue
            self.extent[job.object] = record["extent_mm"]
            made = Figures(**record["figures"])
            self.found.setdefault((job.object, job.variant), []).append(made)

    def row(self, name: str, variant: str) -> Row | None:
        """Mean and half spread over the seeds."""
        found = self.found.get((name, variant))
        return row_from(found) if found else None

    def rows(self, variant: str) -> dict[str, Row]:
        """By object."""
        return {name: row for name in self.extent if (row := self.row(name, variant)) is not None}


def pair(value: tuple[float, float], form: str) -> str:
    """Mean and half spread."""
    mean, spread = value
    return f"{mean:{form}}" + (f" ± {spread:{form}}" if spread > 0 else "")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def as_far_as(row: Row, other: Row | None) -> str:
    """Seconds until the default has seen what the paper's way sees in all, over the latter's seconds."""
    if other is None or other.time_s[0] <= 0 or row.integrity[0] < other.integrity[0]:
        return ""
    seconds = row.global_s[0] if row.after_global[0] >= other.integrity[0] else row.time_s[0]
    return f"{seconds / other.time_s[0]:.2f}"


def default_table(results: Results) -> str:
    """Every object under the default."""
    lines = []
    for name, row in results.rows("two-step").items():
        other = results.row(name, "paper-mode")
        against = f"{row.time_s[0] / other.time_s[0]:.2f}" if other and other.time_s[0] > 0 else ""
        same = as_far_as(row, other)
        floor = f"{row.time_s[0] / row.floor_s[0]:.2f}"
        lines.append([
            name, " x ".join(map(str, results.extent[name])), pair(row.after_global, ".2%"),
            pair(row.integrity, ".2%"), pair(row.of_reach, ".2%"), pair(row.mean_abs_mm, ".3f"),
            pair(row.sd_signed_mm, ".3f"), pair(row.time_s, ".1f"), pair(row.global_s, ".1f"),
            floor, against, same,
            pair(row.viewpoints, ".0f"), str(len(row.seeds)),
            pair(row.planning_s, ".0f"),
        ])  # fmt: skip
    header = (
        "object", "size mm", "after the global step", "complete", "of what is within reach", "mean mm",
        "sd mm", "time s",
        "of which global", "time / floor", "time / paper's way", "as far as the paper's way", "views",
        "seeds", "planning s",
    )  # fmt: skip
    return table(header, lines)


def method_table(results: Results) -> str:
    """Means over the objects that all have, beside the paper's."""
    by_method = {variant: results.rows(variant) for variant in METHODS}
    common = [n for n in results.extent if all(n in rows for rows in by_method.values())]
    lines = []
    for variant, rows in by_method.items():
        if not common:
            continue
        key = variant if variant in PAPER_TABLE_3 else "two-step"
        values = {
            f: np.mean([getattr(rows[n], f)[0] for n in common])
            for f in ("integrity", "mean_abs_mm", "sd_signed_mm", "time_s", "viewpoints", "unreachable")
        }
        worst = min(rows[n].integrity[0] for n in common)
        lines.append([
            variant, f"{values['integrity']:.2%} (worst {worst:.2%})", f"{values['mean_abs_mm']:.3f}",
            f"{values['sd_signed_mm']:.3f}", f"{values['time_s']:.0f}", f"{values['viewpoints']:.0f}",
            f"{values['unreachable']:.1f}", "{:.2%}, {:.2f}, {:.2f}, {:.0f}".format(*PAPER_TABLE_3[key]),
        ])  # fmt: skip
    header = ("method", "integrity", "mean mm", "sd mm", "time s", "views", "left out", "the paper's own")
    words = "\n".join(f"- {v}: {MEANINGS[v]}" for v in METHODS)
    return f"Means over {len(common)} objects.\n\n" + table(header, lines) + f"\n{words}\n"


def object_table(results: Results, variants: Sequence[str], names: Sequence[str]) -> str:
    """Integrity and seconds of each variant on each object."""
    lines = []
    for name in names:
        line = [name]
        for variant in variants:
            row = results.row(name, variant)
            if row is None:
                line.append("failed" if (name, variant) in results.errors else "")
                continue
            out = f", {row.unreachable[0]:.0f} out" if row.unreachable[0] else ""
            line.append(
                f"{pair(row.integrity, '.2%')}, {row.time_s[0]:.0f} s, {row.viewpoints[0]:.0f} views{out}"
            )
        lines.append(line)
    return table(("object", *variants), lines)


def target_table(results: Results) -> str:
    """On how many objects the default is inside each target, and where it is not."""
    rows = results.rows("two-step")
    paper = results.rows("paper-mode")
    half = {n: BUDGET_S.get(n, STATUE_S) for n in rows}
    tests = [
        (f"complete >= {COMPLETE:.1%}", {n: r.integrity[0] >= COMPLETE for n, r in rows.items()}),
        (
            f"complete >= {COMPLETE:.1%} of what is within reach",
            {n: r.of_reach[0] >= COMPLETE for n, r in rows.items()},
        ),
        (f"mean <= {MEAN_MM:.2f} mm", {n: r.mean_abs_mm[0] <= MEAN_MM for n, r in rows.items()}),
        (f"standard deviation <= {SD_MM:.2f} mm", {n: r.sd_signed_mm[0] <= SD_MM for n, r in rows.items()}),
        (
            "half of the paper's time: 76 s, carvings 101 s",
            {n: r.time_s[0] <= half[n] for n, r in rows.items()},
        ),
        (f"time <= {FLOOR:.2f} floor", {n: r.time_s[0] <= FLOOR * r.floor_s[0] for n, r in rows.items()}),
        (
            f"time <= {AGAINST_PAPER} of the paper's way",
            {n: r.time_s[0] <= AGAINST_PAPER * paper[n].time_s[0] for n, r in rows.items() if n in paper},
        ),
    ]
    lines = [
        [what, f"{sum(ok.values())} of {len(ok)}", ", ".join(n for n, good in ok.items() if not good)]
        for what, ok in tests
    ]
    return table(("target", "met on", "missed on"), lines)


def page_block(results: Results) -> str:
    """All tables, between the two marks of the page."""
    names = list(results.extent)
    ablated = [n for n in names if any((n, v) in results.found for v in VARIANTS if v not in METHODS)]
    others = [v for v in VARIANTS if v not in METHODS]
    parts = [
        "### Every object, default\n",
        default_table(results),
        "### Targets\n",
        target_table(results),
        "### Table 3: the methods\n",
        method_table(results),
        "### Each method on each object\n",
        object_table(results, METHODS, names),
    ]
    if ablated:
        parts += [
            "### Ablations\n",
            object_table(results, ("two-step", *others), ablated),
            "\n".join(f"- {v}: {MEANINGS[v]}" for v in ("two-step", *others)) + "\n",
        ]
    if results.errors:
        lines = [f"- {name}, {variant}: {text}" for (name, variant), text in results.errors.items()]
        parts += ["### Plans that failed\n", "\n".join(lines) + "\n"]
    return "\n".join(parts)


def write_page(page: Path, block: str) -> None:
    """Replaces what stands between the marks; the words round them stay."""
    text = page.read_text(encoding="utf-8")
    before, found, rest = text.partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (found and closed):
        raise SystemExit(f"{page}: the marks {BEGIN} and {END} are not there")
    page.write_text(f"{before}{BEGIN}\n{block}{END}{after}", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of meshes in mm, z up")
    parser.add_argument("--objects", help="only these, separated by commas")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--robot", default="kr240")
    parser.add_argument("--cache", type=Path, default=ROOT / "build" / "table3")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--write-only", action="store_true", help="plan nothing")
    given = parser.parse_args()
    names = ["carving", *sorted(p.stem for p in given.data.glob("*.ply"))] if given.data else ["carving"]
    if given.objects:
        asked = given.objects.split(",")
        if unknown := [n for n in asked if n not in names]:
            parser.error(f"unknown object {unknown[0]}; known: {', '.join(names)}")
        names = asked
    todo, cache = list(jobs(names, given.seeds)), given.cache / digest()
    try:
        if not given.write_only:
            run(todo, given.data, cache, given.robot)
    finally:
        results = Results(todo, cache)
        if results.found:
            write_page(given.page, page_block(results))
    done = sum(len(v) for v in results.found.values())
    print(f"{given.page}: {done} of {len(todo)} plans, {len(results.errors)} failed")
    return 1 if results.errors else 0


if __name__ == "__main__":
    sys.exit(main())
