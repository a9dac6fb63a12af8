"""Programmes of whole parts: seconds over the proven floor, and over the paper's way on the same viewpoints.

    python benchmarks/tour_time.py [--only carving hermes ...] [--data FOLDER] [--seed 0] [--whole]

Each part is planned as `scanmotion plan` does. Then the viewpoints of each of its rounds that the plan serves
are ordered by mode "paper" in the same cell: a genetic algorithm on the Euclidean distance, the table turned
only for what the arm cannot reach; nothing is left out for taking long. `both` counts the viewpoints that the
paper's way serves, too, of those that the plan serves; `moves` compares the transits alone, for revolutions
and dwells take the same time either way. With --whole the paper's own viewpoints are planned, too: seconds
and completeness of mode "paper" from end to end. Parts are those of ../shared/data/ where that lies beside
the checkout, and the built-in carving. Exit status 1 where a programme passes 1.10 of its floor or 0.5 of
the paper's.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.part import Part
from scanmotion.core.trajectory import Trajectory
from scanmotion.geometry.parts.make_part import carving, part_from_file
from scanmotion.planning.methods import PAPER
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import segment_from

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
OVER_FLOOR, OF_PAPER = 1.10, 0.5


def parts(folder: Path, only: list[str]) -> Iterable[tuple[str, Part]]:
    """(name, part) of the carving and of every object that the folder's manifest lists."""
    if not only or "carving" in only:
        yield "carving", carving()
    listed = folder / "manifest.json"
    for item in json.loads(listed.read_text())["objects"] if listed.is_file() else ():
        if (not only or item["name"] in only) and item.get("kind", "mesh") == "mesh":
            yield item["name"], part_from_file(folder / item["file"], units=item["units"], up=item["up"])


def moves(trajectory: Trajectory | None) -> float:
    """Seconds of the transits."""
    operations = () if trajectory is None else trajectory.operations
    return sum(o.t_end - o.t_start for o in operations if o.kind == "transit")


def paper_seconds(made: Plan, seed: int) -> tuple[float, float, int]:
    """The paper's way over the served viewpoints, round by round: seconds, of its transits, and how many."""
    clearance = Clearance(made.cell)
    at, seconds, served = made.cell.home, 0.0, 0
    moved = 0.0
    for number, item in enumerate(made.segments):
        segment = segment_from(
            made.cell, clearance, item.served, at,
            method=PAPER, longest_way=math.inf, rng=np.random.default_rng([seed, number]),
        )  # fmt: skip
        if segment.trajectory is not None:
            at, seconds = segment.trajectory.q[-1], seconds + segment.trajectory.duration
            moved += moves(segment.trajectory)
        served += len(segment.served)
    return seconds, moved, served


def row(name: str, part: Part, seed: int, whole: bool) -> tuple[float, float]:
    """Prints the line of a part; its two ratios."""
    settings = load_cell("kr240")
    begun = time.perf_counter()
    made = plan(part, settings, options=PlanOptions(seed=seed))
    took = time.perf_counter() - begun
    times = made.time_s()
    paper, moved, both = paper_seconds(made, seed)
    views = sum(len(item.served) for item in made.segments)
    over, of = times["total"] / times["floor"], times["total"] / paper
    line = (
        f"{name:20} {views:5d} {both:5d} {times['total']:8.1f} {times['floor']:8.1f} {over:8.3f} {paper:8.1f}"
    )
    line += f" {of:8.3f} {moves(made.trajectory) / moved:6.3f} {took:9.1f} {share(made):>8}"
    if whole:
        literal = plan(part, settings, options=PlanOptions(seed=seed, mode="paper"))
        line += f" {literal.time_s()['total']:8.1f} {share(literal):>8}"
    print(line, flush=True)
    return over, of


def share(made: Plan) -> str:
    """What a plan sees of what can be seen."""
    return f"{made.completeness()['final']:.2%}"


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--only", nargs="+", default=[])
    asked.add_argument("--data", type=Path, default=DATA)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--whole", action="store_true")
    given = asked.parse_args()
    head = f"{'part':20} {'views':>5} {'both':>5} {'total s':>8} {'floor s':>8} {'/ floor':>8} {'paper s':>8}"
    head += f" {'/ paper':>8} {'moves':>6} {'planned s':>9} {'complete':>8}"
    print(head + (f" {'whole s':>8} {'complete':>8}" if given.whole else ""), flush=True)
    rows = [row(name, part, given.seed, given.whole) for name, part in parts(given.data, given.only)]
    if not rows:
        print("no such part")
        return 1
    over, of = np.array(rows).T
    print(
        f"worst: {over.max():.3f} of the floor (target {OVER_FLOOR}), {of.max():.3f} of the paper's "
        f"(target {OF_PAPER}); median {np.median(over):.3f} and {np.median(of):.3f}"
    )
    return int(over.max() > OVER_FLOOR or of.max() > OF_PAPER)


if __name__ == "__main__":
    sys.exit(main())
