"""One time-parameterisation problem without a jerk limit, four solvers: what each answers and costs.

    python benchmarks/timing_solvers.py [--transits 12] [--seed 0]

Random transits on the curve and grid that are driven on, with the axes' velocities and accelerations and the
scanner's 0.1 m/s. The limits are the same numbers for all but Drake's Toppra, which computes the scanner's
speed from the plant, at the grid points alone, so that it is passed between them.

- compiled: speed_profile.py, for the many ways that are only compared
- toppra: the library with its Seidel solver, for what is emitted
- Drake's Toppra
- copp-py: TOPP2-RA in Rust (`pip install copp-py`); the scanner's speed goes in as an eighth joint

CPU is processor time of one thread. Exit status 1 where toppra's time differs from the compiled one's by more
than 1e-6 of it.
"""

import argparse
import sys
import time
from collections.abc import Callable

import numpy as np
from pydrake.multibody.optimization import Toppra
from pydrake.trajectories import PiecewisePolynomial
from timing import HIGH, LOW

from scanmotion.cell.build import build_cell
from scanmotion.cell.ik.slack_plant import SlackPlant
from scanmotion.cell.settings.cell import load_cell
from scanmotion.motion.profile.speed_profile import (
    Derivatives,
    Limits,
    fastest_profile,
    profile_seconds,
    speed_caps,
)
from scanmotion.motion.profile.spline import JointSpline
from scanmotion.motion.profile.toppra_profile import toppra_profile
from scanmotion.motion.transit.drive import derivatives_on, transit_limits, transit_spline


def by_drake(plant: SlackPlant, path: JointSpline, d: Derivatives, limits: Limits) -> float:
    """Drake's Toppra on a cubic through the curve's points and slopes."""
    q, q1 = (np.array([plant.positions(row) for row in path(d.s, k)]).T for k in (0, 1))
    # Toppra keeps no copy of the curve.
    curve = PiecewisePolynomial.CubicHermite(d.s, q, q1)
    toppra = Toppra(curve, plant.plant, d.s)
    v, a = plant.positions(limits.v), plant.positions(limits.a)
    toppra.AddJointVelocityLimit(-v, v)
    toppra.AddJointAccelerationLimit(-a, a)
    toppra.AddFrameTranslationalSpeedLimit(plant.frame_S, limits.tcp)
    return float(toppra.SolvePathParameterization().end_time())


def by_copp(path: JointSpline, d: Derivatives, cap: np.ndarray, limits: Limits) -> float:
    """copp-py's TOPP2-RA; NaN where it is not installed."""
    try:
        import copp_py as copp
    except ImportError:
        return np.nan
    n = len(d.s)
    robot = copp.Robot(8, capacity=n)
    robot.append_s(d.s)
    rate, none = 1 / np.sqrt(cap), np.zeros(n)
    robot.set_q(
        np.column_stack([path(d.s), none]), np.column_stack([d.q1, rate]), np.column_stack([d.q2, none]), 0
    )
    v, a = np.append(limits.v, 1.0), np.append(limits.a, 1e9)
    robot.add_velocity_limits(v, -v, start_idx_s=0)
    robot.add_acceleration_limits(a, -a, start_idx_s=0)
    topp = copp.solver.topp2_ra
    x = topp.solve(topp.Problem(robot.constraints, idx_s_interval=(0, n - 1), a_boundary=(0.0, 0.0)))
    return profile_seconds(d.s, np.asarray(x))


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--transits", type=int, default=12)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    cell = build_cell(load_cell("kr240"))
    plant, limits, rng = (
        SlackPlant(cell, part="none"),
        transit_limits(cell),
        np.random.default_rng(given.seed),
    )
    seconds, cpu, points = [], [], []
    for _ in range(given.transits + 1):
        a = rng.uniform(LOW, HIGH)
        path = transit_spline(cell, np.array([a, a + 0.2 * (rng.uniform(LOW, HIGH) - a)]))
        d = derivatives_on(cell, path)
        cap, most = speed_caps(d, d.tcp(d.s), limits), np.tile(limits.a, (len(d.s), 1))
        calls: list[Callable[[], float]] = [
            lambda d=d, cap=cap, most=most: profile_seconds(d.s, fastest_profile(d, cap, most)),
            lambda d=d, cap=cap, most=most: profile_seconds(d.s, toppra_profile(d, cap, most)),
            lambda path=path, d=d: by_drake(plant, path, d, limits),
            lambda path=path, d=d, cap=cap: by_copp(path, d, cap, limits),
        ]
        took, found = [], []
        for call in calls:
            began = time.process_time()
            found.append(call())
            took.append(time.process_time() - began)
        seconds.append(found)
        cpu.append(took)
        points.append(len(d.s))
    # The first one compiles.
    times, cost = np.array(seconds[1:]), 1e3 * np.array(cpu[1:])
    print(f"{given.transits} transits, {np.mean(points[1:]):.0f} grid points in the mean")
    for n, name in enumerate(("compiled", "toppra, Seidel", "Drake's Toppra", "copp-py")):
        told = f"{times[:, n].mean():9.4f} s, median {np.median(cost[:, n]):8.2f} ms of CPU"
        print(f"{name:16} {told if np.isfinite(times[:, n]).all() else 'not installed'}")
    return int(np.abs(times[:, 1] / times[:, 0] - 1).max() > 1e-6)


if __name__ == "__main__":
    sys.exit(main())
