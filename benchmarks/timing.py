"""Worst use of every limit on random tours, by 1 ms differences, and the time over the jerk-free floor.

    python benchmarks/timing.py [--tours 200] [--stops 5] [--speed 0.1] [--seed 0]

Tours mix revolutions, sweeps and dwells; half of the transits follow the scanner's line or a joint line as
transit.py proposes them, half go over a random corner as a planned path does. Nothing is checked for
collisions here. Exit status 1 where a limit is passed by more than 0.1%.
"""

import argparse
import sys
import time

import numpy as np

from scanmotion.cell.build import Cell, build_cell
from scanmotion.cell.kinematics import scanner_poses, tcp_jacobian
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.tour import Path, Stop, Tour
from scanmotion.motion.timing.operations import motions, time_plan
from scanmotion.motion.transit.straight_line import least_seconds, ways

LOW = np.radians([-40, -110, 60, -90, -100, -150, -300])
HIGH = np.radians([40, -50, 130, 90, 100, 150, 300])
STEP = 0.001


def random_tour(cell: Cell, rng: np.random.Generator, n: int) -> tuple[Tour, list[Path]]:
    at = rng.uniform(LOW, HIGH)
    start, stops, paths = at, [], []
    for _ in range(n):
        q_in = at + rng.choice([0.03, 0.1, 0.3, 0.6]) * (rng.uniform(LOW, HIGH) - at)
        kind = rng.choice(["revolution", "sweep", "dwell"])
        q_out, path = q_in.copy(), None
        if kind == "revolution":
            q_out[6] -= 2 * np.pi * np.sign(q_in[6])
        elif kind == "sweep":
            path = sweep(cell, q_in, rng.normal(size=3) * rng.choice([0.02, 0.1]))
            q_out = path[-1].copy()
        stops.append(Stop(viewpoints=("V",), kind=str(kind), q_in=q_in, q_out=q_out, path=path))
        corner = (at + q_in) / 2 + rng.normal(size=7) * 0.1 * np.abs(q_in - at).max()
        if rng.random() < 0.5:
            candidates = ways(cell, at, q_in)
            q = candidates[rng.integers(len(candidates))][1]
        else:
            q = np.array([at, np.clip(corner, cell.q_min, cell.q_max), q_in])
        paths.append(Path(q=q, seconds=0.0, method="planned"))
        at = q_out
    return Tour(start_q=start, stops=tuple(stops), seconds=0.0, floor=0.0), paths


def sweep(cell: Cell, q: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Joint path of a straight line of the scanner, orientation kept (damped Newton steps)."""
    X = scanner_poses(cell, q[None])[0]
    count = max(int(np.ceil(np.linalg.norm(way) / 0.01)), 8)
    rows = [q]
    for k in range(1, count + 1):
        row = rows[-1].copy()
        for _ in range(10):
            now = scanner_poses(cell, row[None])[0]
            E = now[:3, :3].T @ X[:3, :3]
            turn = now[:3, :3] @ np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
            miss = np.concatenate([turn, X[:3, 3] + way * k / count - now[:3, 3]])
            J = tcp_jacobian(cell, row[None])[0][:, :6]
            row[:6] += J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), miss)
        rows.append(row)
    return np.array(rows)


def shares(cell: Cell, q: np.ndarray, speed: float) -> dict[str, float]:
    """Greatest use of each limit by differences of samples STEP apart; 1 is the limit."""
    p = scanner_poses(cell, q)[:, :3, 3]
    use = {"tcp": float(np.linalg.norm(np.diff(p, axis=0), axis=1).max() / STEP / speed)}
    for name, order, limit in (("v", 1, cell.v_max), ("a", 2, cell.a_max), ("j", 3, cell.j_max)):
        use[name] = float((np.abs(np.diff(q, n=order, axis=0)).max(axis=0) / STEP**order / limit).max())
    middle, half = (cell.q_max + cell.q_min) / 2, (cell.q_max - cell.q_min) / 2
    use["q"] = float((np.abs(q - middle) / half).max())
    return use


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tours", type=int, default=200)
    parser.add_argument("--stops", type=int, default=5)
    parser.add_argument("--speed", type=float, default=0.1, help="transit speed [m/s]")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    settings = load_cell("kr240")
    process = settings.process.model_copy(update={"transit_speed_m_s": args.speed})
    cell = build_cell(settings.model_copy(update={"process": process}))
    worst = dict.fromkeys(("tcp", "v", "a", "j", "q"), 0.0)
    driven = floor = transit = least = seconds = 0.0
    count = 0
    for n in range(args.tours):
        tour, paths = random_tour(cell, np.random.default_rng((args.seed, n)), args.stops)
        began = time.perf_counter()
        trajectory = time_plan(cell, tour, paths, sample_s=STEP)
        seconds += time.perf_counter() - began
        speed = max(args.speed, float(process.scan_speed_m_s))
        for name, use in shares(cell, trajectory.q, speed).items():
            worst[name] = max(worst[name], use)
        for motion in motions(cell, tour, paths):
            driven, floor = driven + motion.duration, floor + motion.floor
            if motion.kind == "transit":
                transit, count = transit + motion.duration, count + 1
                ends = motion.path(np.array([0.0, motion.path.end]))
                least += float(least_seconds(cell, ends[:1], ends[1:])[0])
    print(
        f"{args.tours} tours of {args.stops} stops, transit speed {args.speed:g} m/s, differences over 1 ms"
    )
    print("worst use of limits: " + "  ".join(f"{name} {use:.5f}" for name, use in worst.items()))
    print(f"duration {driven:.1f} s = {driven / floor:.4f} of the floor without a jerk limit")
    print(f"{count} transits, mean {transit / count:.2f} s; straight-line bound {least / count:.2f} s")
    print(f"time_plan: {1000 * seconds / args.tours:.0f} ms a tour, {1000 * seconds / count:.1f} ms a stop")
    return int(max(worst.values()) > 1.001)


if __name__ == "__main__":
    sys.exit(main())
