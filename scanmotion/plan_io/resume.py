"""The rest of a programme that was broken off: the operations that are left, with a checked way back in.

Unlike `replan`, nothing is ordered or timed anew: the operations stay as they were judged. Only the way from
where the robot stands to where the first of them begins is planned.
"""

from pathlib import Path

import numpy as np

from scanmotion.cell.build import Cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.core.errors import InputError, PathError
from scanmotion.core.support.streams import Streams
from scanmotion.core.trajectory import Trajectory, joined
from scanmotion.core.trajectory import piece as piece_of
from scanmotion.motion.transit.plan import transit
from scanmotion.plan_io.load import cell_of, viewpoint_of
from scanmotion.plan_io.read import read_plan, read_trajectory
from scanmotion.plan_io.scans.frames import frame_files
from scanmotion.plan_io.schema import PlanRecord
from scanmotion.plan_io.write import csv_text, json_text, trajectory_json
from scanmotion.planning.steps.way_home import transit_alone

_THERE = 1e-5
"""So near [rad] no way back in is needed."""


def rest_files(folder: str | Path, step: int, q: np.ndarray | None = None) -> dict[str, bytes | str]:
    """The files of a plan of what is left.

    Args:
        folder: of the plan.
        step: number of the first step that is left, from 1.
        q: where the robot stands, shape (7,) [rad]; None is where that step begins.

    Returns:
        a plan's files by name; no summary, for what was scanned before is not in them.

    Raises:
        InputError: no such step, or no collision-free way back in.
        PlanFileError: the folder cannot be read.
    """
    record = read_plan(folder)
    trajectory = read_trajectory(Path(folder), record)
    cell = cell_of(Path(folder), record)[1]
    operations = trajectory.operations
    if not 1 <= step <= len(operations):
        raise InputError(f"--step {step}: the plan has the steps 1 to {len(operations)}")
    # A transit is replaced by the way back in, which leads where it would have led.
    first = step - 1 if operations[step - 1].scanning else step
    if first >= len(operations) or not any(o.scanning for o in operations[first:]):
        raise InputError(f"--step {step}: nothing is left to scan from there on")
    rest = piece_of(trajectory, first, len(operations) - 1)
    start = rest.q[0] if q is None else np.asarray(q, float)
    if np.abs(start - rest.q[0]).max() > _THERE:
        rest = joined(_way_in(cell, record.seed, start, rest), rest)
    return _files(record, cell, rest, Path(folder))


def _way_in(cell: Cell, seed: int, start: np.ndarray, rest: Trajectory) -> Trajectory:
    outside = (start < cell.q_min - 1e-6) | (start > cell.q_max + 1e-6)
    if outside.any():
        name = cell.joint_names[int(np.flatnonzero(outside)[0])]
        raise InputError(f"--at: {name} is outside of its range")
    rng = Streams(seed=seed).child("way_in")
    try:
        path = transit(cell, Clearance(cell), start, rest.q[0], rng=rng)
    except PathError as error:
        raise InputError(
            f"no collision-free way from where the robot stands to step {rest.operations[0].kind}: {error}; "
            "drive it clear by hand and say where it stands (--at)"
        ) from None
    return transit_alone(cell, path, rest.operations[0].viewpoints)


def _files(record: PlanRecord, cell: Cell, rest: Trajectory, folder: Path) -> dict[str, bytes | str]:
    served = {v for o in rest.operations if o.scanning for v in o.viewpoints}
    operations = [
        {
            "index": o.index, "kind": o.kind, "viewpoints": o.viewpoints, "t_start": round(o.t_start, 6),
            "t_end": round(o.t_end, 6), "q_start": o.q_start.tolist(), "q_end": o.q_end.tolist(),
        }
        for o in rest.operations
    ]  # fmt: skip
    told: dict[str, object] = {
        **record.model_dump(),
        "viewpoints": [v.model_dump() for v in record.viewpoints if v.id in served],
        "unreachable": [],
        "operations": operations,
    }
    return {
        "plan.json": json_text(type(record).model_validate(told)),
        "trajectory.csv": csv_text(rest),
        "trajectory.json": trajectory_json(rest, record.joint_names),
        "robot.urdf": cell.robot.record,
        **cell.robot.meshes,
        "part.ply": (folder / record.part_file).read_bytes(),
        "cell.json": (folder / record.cell_file).read_bytes(),
        **frame_files(rest, tuple(viewpoint_of(v) for v in record.viewpoints if v.id in served), cell),
    }
