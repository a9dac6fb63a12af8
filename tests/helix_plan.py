"""Three turns about a box, joined to one helix: planned from configurations chosen by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from judged_plan import poses_in_object, station

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.tour import Stop, Tour
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.motion.order.helix_choice import joined_stops
from scanmotion.motion.timing.operations import time_plan
from scanmotion.motion.transit.plan import transits
from scanmotion.plan_io.write import plan_files

ARMS = np.deg2rad([[10, 20, -10, 5, 20, 0], [12, 14, -8, 5, 24, 4], [8, 8, -6, 0, 30, 8]])
"""The places, from home."""


def turning_cell():
    """The built-in cell with a box, its table endless, so that all turns may be one."""
    settings = load_cell("kr240")
    table = settings.turntable.model_copy(update={"endless": True})
    return build_cell(settings.model_copy(update={"turntable": table}), box_part(0.2, 0.15, 0.4))


def turns(cell):
    """A revolution at each place, to and fro."""
    stops = []
    for n, arm in enumerate(ARMS):
        q = np.append(np.asarray(cell.home)[:6] + arm, 0.0)
        ends = [q, q + np.array([0, 0, 0, 0, 0, 0, 2 * np.pi])]
        q_in, q_out = ends if n % 2 == 0 else ends[::-1]
        stops.append(Stop(viewpoints=(f"G{n}",), kind="revolution", q_in=q_in, q_out=q_out))
    return tuple(stops)


def helix_tour(cell, overlap):
    """The turns joined, with the paths there."""
    clearance = Clearance(cell)
    home = np.asarray(cell.home)
    stops = joined_stops(cell, clearance, home, turns(cell), [6.0, 2.0, 2.0], overlap)
    tour = Tour(start_q=home, stops=stops, seconds=0.0, floor=0.0)
    return tour, transits(cell, clearance, tour, rng=np.random.default_rng(0))


def helix_plan(cell, overlap=1.0):
    """What plan.plan_files needs of a Plan."""
    tour, paths = helix_tour(cell, overlap)
    X = poses_in_object(cell, np.array([s.q_in for s in turns(cell)]))
    views = tuple(station(f"G{n}", X[n], kind="revolution") for n in range(len(X)))
    plan: Any = SimpleNamespace(
        part=cell.part, cell=cell, trajectory=time_plan(cell, tour, paths), viewpoints=views,
        options=SimpleNamespace(seed=7, mode="default", strategy="two-step", source="mesh"),
        segments=(SimpleNamespace(unreachable=()),), cloud=None, holes=None, samples=None,
        visible=None,
    )  # fmt: skip
    plan.cycle = plan.trajectory
    plan.solvers = {}
    return plan


def helix_files(cell):
    """The files of its folder, by name."""
    return plan_files(helix_plan(cell))
