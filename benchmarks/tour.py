"""The order: gap to the proven optimum, OR-Tools beside it; stops in order at 10, 100 and 1,000 viewpoints.

    python benchmarks/tour.py [--seed 0] [--sizes 10 100 1000] [--skip-stops]

Instances are those of ../shared/data/robotsp/ where that lies beside the checkout, grids whose optimum is
known in closed form, and random points, whose gap is that to the Held-Karp bound. Exit status 1 where an
optimum is missed by more than the targets: 0 % up to 50 cities, 0.5 % beyond.
"""

import argparse
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

from scanmotion.cell.build import Cell, build_cell
from scanmotion.cell.kinematics import branches, object_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.viewpoint import Viewpoint, look_at
from scanmotion.motion.order.salesman.tsp import tour_from_cost
from scanmotion.motion.order.sequence import by_distance, sequence
from scanmotion.motion.reach.find import Reach
from scanmotion.motion.transit_cost import move_model, stop_seconds

ROBOTSP = Path(__file__).resolve().parents[2] / "shared" / "data" / "robotsp"


def distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def grid(columns: int, rows: int) -> tuple[np.ndarray, float]:
    """Points of a grid, and its shortest closed tour: a step a point, and a diagonal if the count is odd."""
    points = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2).astype(float)
    odd = len(points) % 2
    return points, len(points) - odd + odd * np.sqrt(2.0)


def instances(seed: int) -> list[tuple[str, np.ndarray, float | None]]:
    """(name, points, proven optimum or None)."""
    found: list[tuple[str, np.ndarray, float | None]] = []
    for path in sorted(ROBOTSP.glob("*.json")) if ROBOTSP.is_dir() else []:
        file = json.loads(path.read_text())
        targets = np.array(file["targets"])
        found += [(f"{path.stem}[:{n}]", targets[: int(n)], best) for n, best in file["exact_tour_m"].items()]
    for columns, rows in ((7, 7), (35, 7), (50, 20), (50, 40)):
        found.append((f"grid {columns}x{rows}", *grid(columns, rows)))
    rng = np.random.default_rng(seed)
    found += [(f"random {n}", rng.random((n, 3)), None) for n in (50, 245, 1000)]
    return found


def or_tools_tour(cost: np.ndarray, seconds: int) -> float:
    """OR-Tools' routing solver with guided local search for a whole number of seconds."""
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    manager = pywrapcp.RoutingIndexManager(len(cost), 1, 0)
    routing = pywrapcp.RoutingModel(manager)
    whole = np.round(cost * 1e6 / max(cost.max(), 1e-12)).astype(int).tolist()

    def step(i: int, j: int) -> int:
        return whole[manager.IndexToNode(i)][manager.IndexToNode(j)]

    routing.SetArcCostEvaluatorOfAllVehicles(routing.RegisterTransitCallback(step))
    asked = pywrapcp.DefaultRoutingSearchParameters()
    asked.first_solution_strategy = routing_enums_pb2.FirstSolutionStrategy.PATH_CHEAPEST_ARC
    asked.local_search_metaheuristic = routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    asked.time_limit.seconds = seconds
    solution = routing.SolveWithParameters(asked)
    node, total = routing.Start(0), 0.0
    while not routing.IsEnd(node):
        after = solution.Value(routing.NextVar(node))
        total += cost[manager.IndexToNode(node), manager.IndexToNode(after)]
        node = after
    return total


def tours(seed: int) -> bool:
    """Table of closed Euclidean tours; whether the targets are met."""
    print(
        f"{'instance':16} {'n':>5} {'gap':>9} {'against':>9} {'seconds':>8} {'OR-Tools gap':>13} {'in s':>5}"
    )
    good = True
    for name, points, best in instances(seed):
        cost = distances(points)
        begun = time.perf_counter()
        result = tour_from_cost(cost, closed=True, rng=np.random.default_rng(seed))
        took = time.perf_counter() - begun
        reference = best if best is not None else result.lower_bound
        gap = result.cost / reference - 1
        limit = max(1, round(took))
        other = or_tools_tour(cost, limit) / reference - 1 if len(points) <= 1000 else np.nan
        if best is not None:
            good &= gap <= (1e-6 if len(points) <= 50 else 0.005)
        print(
            f"{name:16} {len(points):5d} {gap:9.4%} {'optimum' if best is not None else 'bound':>9} "
            f"{took:8.3f} {other:13.4%} {limit:5d}"
        )
    return good


def random_reach(cell: Cell, viewpoint: Viewpoint, most: int) -> Reach:
    """Configurations over table angles and rolls without regard to collisions."""
    rows, poses = [], []
    table = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    X_WO = object_poses(cell, np.column_stack([np.zeros((24, 6)), table]))
    turns = [np.diag([s, s, 1.0, 1.0]) for s in (1.0, -1.0)]
    X_OS = np.array([viewpoint.X_OS @ turn for turn in turns])
    found = branches(cell, (X_WO[:, None] @ X_OS[None]).reshape(-1, 4, 4), windings=False)
    keep = np.flatnonzero(found.manipulability > 0.05)
    keep = keep[np.unique(np.linspace(0, len(keep) - 1, most).astype(int))] if len(keep) else keep
    rows = np.column_stack([found.q[keep], table[found.pose_index[keep] // 2]])
    poses = X_OS[found.pose_index[keep] % 2]
    return Reach(
        viewpoint=viewpoint,
        q=rows,
        clearance=np.zeros(len(rows)),
        manipulability=found.manipulability[keep],
        X_OS=poses,
    )


def random_viewpoints(n: int, rng: np.random.Generator) -> list[Viewpoint]:
    """Stations round a part of 300 mm across and 600 mm high."""
    views = []
    for k in range(n):
        azimuth, tilt = rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.8)
        flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        out = np.cos(tilt) * flat + np.array([0.0, 0.0, np.sin(tilt)])
        p = 0.15 * flat + np.array([0.0, 0.0, rng.uniform(0.1, 0.6)]) + 0.65 * out
        views.append(
            Viewpoint(id=f"L{k}", X_OS=look_at(p, -out), standoff=0.65, step="local", kind="station")
        )
    return views


def stops(seed: int, sizes: list[int]) -> None:
    """Table of orders over viewpoints, configurations and table angles."""
    cell = build_cell(load_cell("kr240"))
    model = move_model(cell)
    warm = [random_reach(cell, v, 8) for v in random_viewpoints(3, np.random.default_rng(1))]
    sequence(cell, warm, start_q=cell.home, rng=np.random.default_rng(0))
    head = f"{'viewpoints':>10} {'ways':>7} {'tour s':>8} {'floor s':>8} {'ratio':>6}"
    print(f"{head} {'paper s':>8} {'ordered in s':>13} {'peak MiB':>9}")
    for n in sizes:
        views = random_viewpoints(n, np.random.default_rng(seed))
        reaches = [r for r in (random_reach(cell, v, 96) for v in views) if len(r.q)]
        begun = time.perf_counter()
        tour = sequence(cell, reaches, start_q=cell.home, rng=np.random.default_rng(seed))
        took = time.perf_counter() - begun
        paper = sequence(
            cell, reaches, start_q=cell.home, ordering=by_distance, rng=np.random.default_rng(seed)
        )
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        ways = sum(len(r.q) for r in reaches)
        assert tour.seconds >= sum(stop_seconds(model, s) for s in tour.stops)
        print(
            f"{len(reaches):10d} {ways:7d} {tour.seconds:8.1f} {tour.floor:8.1f} "
            f"{tour.seconds / tour.floor:6.3f} {paper.seconds:8.1f} {took:13.2f} {peak:9.0f}"
        )


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--sizes", type=int, nargs="+", default=[10, 100, 1000])
    asked.add_argument("--skip-stops", action="store_true")
    given = asked.parse_args()
    tour_from_cost(
        distances(np.random.default_rng(0).random((20, 2))), closed=True, rng=np.random.default_rng(0)
    )
    good = tours(given.seed)
    if not given.skip_stops:
        stops(given.seed, given.sizes)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
