"""A plan made by hand, with the shape of the real one: quick to make, and every figure in it is known."""

from dataclasses import replace

import numpy as np

from scanmotion.core.summary import Summary
from scanmotion.core.trajectory import Operation, Trajectory, piece
from scanmotion.core.viewpoint import Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.plan import Plan
from scanmotion.planning.segment import segment_from_operations, served_at
from scanmotion.sensing.holes.find import Hole, HoleReport


def smooth(share):
    """Quintic blend from 0 to 1 with its first two derivatives."""
    return (
        10 * share**3 - 15 * share**4 + 6 * share**5,
        30 * share**2 - 60 * share**3 + 30 * share**4,
        60 * share - 180 * share**2 + 120 * share**3,
    )


def trajectory_through(stops, kinds, seconds, viewpoints):
    """Rest to rest between `stops`, 100 Hz."""
    t, q, qd, qdd, operation, operations = [0.0], [stops[0]], [0 * stops[0]], [0 * stops[0]], [0], []
    for i, (kind, T) in enumerate(zip(kinds, seconds, strict=True)):
        delta, start = stops[i + 1] - stops[i], t[-1]
        for share in np.linspace(0, 1, round(100 * T) + 1)[1:]:
            s, v, a = smooth(share)
            t.append(start + share * T)
            q.append(stops[i] + s * delta)
            qd.append(v * delta / T)
            qdd.append(a * delta / T**2)
            operation.append(i)
        operations.append(
            Operation(
                index=i,
                kind=kind,
                viewpoints=viewpoints[i],
                t_start=start,
                t_end=t[-1],
                q_start=stops[i],
                q_end=stops[i + 1],
            )
        )
    return Trajectory(
        t=np.array(t),
        q=np.array(q),
        qd=np.array(qd),
        qdd=np.array(qdd),
        operation=np.array(operation),
        operations=tuple(operations),
    )


def fake_hole(kind="common"):
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    loop = np.column_stack([np.full(24, 0.1), 0.03 * np.cos(turn), 0.2 + 0.05 * np.sin(turn)])
    return Hole(
        boundary=loop,
        kind=kind,
        center=loop.mean(axis=0),
        normal=np.array([1.0, 0, 0]),
        X_OH=np.eye(4),
        extent=np.array([0.1, 0.06, 0.0]),
        perimeter=0.25,
        area=0.0047,
    )


def fake_plan(cell):
    """Two viewpoints are served, one is out of reach; the top is seen by the local one alone.

    Args:
        cell: a Cell; its home is where the trajectory starts.
    """
    part = box_part(0.2, 0.15, 0.4)
    samples = surface_samples(part, 4000, rng=np.random.default_rng(0))
    sides, top = np.abs(samples.normals[:, 2]) < 0.5, samples.normals[:, 2] > 0.5
    views = (
        Viewpoint(
            id="G1",
            X_OS=look_at(np.array([0.8, 0, 0.2]), np.array([-1.0, 0, 0])),
            standoff=0.7,
            step="global",
            kind="revolution",
        ),
        Viewpoint(
            id="L1.1",
            X_OS=look_at(np.array([0, 0, 1.1]), np.array([0, 0, -1.0])),
            standoff=0.7,
            step="local",
            kind="station",
        ),
        Viewpoint(
            id="L2.1",
            X_OS=look_at(np.array([0.3, 0, 1.0]), np.array([-0.3, 0, -1.0])),
            standoff=0.7,
            step="local",
            kind="station",
        ),
    )
    a = cell.home + np.deg2rad([10, 20, -10, 5, 20, 0, 0])
    b = a + np.array([0, 0, 0, 0, 0, 0, 2 * np.pi])
    c = b + np.deg2rad([5, -10, 5, 0, 10, 0, 0])
    trajectory = trajectory_through(
        [cell.home, a, b, c, c],
        ["transit", "revolution", "transit", "dwell"],
        [3.0, 8.0, 2.0, 0.5],
        [("G1",), ("G1",), ("L1.1",), ("L1.1",)],
    )
    by_id = {v.id: v for v in views}
    turn = segment_from_operations(piece(trajectory, 0, 1), by_id, step="global", floor=12.0)
    dwell = segment_from_operations(piece(trajectory, 2, 3), by_id, step="local", floor=0.0)
    why = "out of reach: 3.1 m <b>"
    lost = (*dwell.reaches, served_at(views[2], np.zeros((0, 7))))
    segments = (
        replace(turn, seen=sides.copy()),
        replace(dwell, seen=sides | top, reaches=lost, unreachable=(("L2.1", why),)),
    )
    summary = {
        "viewpoints": {"global": 1, "local": 2, "unreachable": [{"id": "L2.1", "reason": why}]},
        "completeness": {"after_global": 0.88, "final": 1.0, "final_of_whole": 0.93},
        "rounds": [],
        "accuracy": {"mean_abs_mm": 0.08, "sd_signed_mm": 0.1, "mean_signed_mm": 0.01},
        "time_s": {"total": 13.5, "arm": 5.0, "table": 8.0, "sweep": 0.0, "dwell": 0.5, "floor": 12.0},
        "budget": {"limit_s": 152.0, "ok": True},
        "findings": [],
        "planning_s": {"total": 3.0, "motion": 2.0},
    }
    holes = HoleReport(holes=(fake_hole(),), tiny=(), boundary_mask=np.zeros(0, bool), radius=0.0)
    return Plan(
        part=part, cell=cell, options=PlanOptions(seed=7), segments=segments, trajectory=trajectory,
        cloud=None, holes=holes, samples=samples, visible=sides | top,
        summary=Summary.model_validate(summary),
    )  # fmt: skip
