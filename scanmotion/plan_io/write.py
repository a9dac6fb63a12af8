"""A plan as the files of its folder: plan.json, trajectory.csv, and what pictures need beside them."""

import json
from collections.abc import Mapping

import numpy as np
from pydantic import BaseModel

from scanmotion import __version__
from scanmotion.cell.own_solids import in_folder
from scanmotion.core.errors import InputError
from scanmotion.core.trajectory import Trajectory
from scanmotion.core.viewpoint import Viewpoint
from scanmotion.geometry.files.ply_write import ply_data
from scanmotion.plan_io.scans.frames import frame_files
from scanmotion.plan_io.scans.scan_record import arrays_data, hole_records
from scanmotion.plan_io.schema import CSV_HEADER, VERSION, PlanRecord
from scanmotion.planning.plan import Plan

__all__ = ["csv_text", "json_text", "plan_files", "plan_record", "trajectory_json"]


def _lost(unreachable: tuple[tuple[str, str], ...]) -> str:
    """How many viewpoints each cause took, the commonest first, each with one example."""
    if not unreachable:
        return "no viewpoint was asked for: what is scanned has nothing missing, or nothing that can be seen"
    by_cause: dict[str, list[tuple[str, str]]] = {}
    for name, reason in unreachable:
        cause = reason.partition(": ")[0] if ": " in reason[:40] else "other"
        by_cause.setdefault(cause, []).append((name, reason))
    parts = [
        f"{cause} {len(lost)} of {len(unreachable)} viewpoints ({lost[0][0]}: {lost[0][1]})"
        for cause, lost in sorted(by_cause.items(), key=lambda item: -len(item[1]))
    ]
    return "; ".join(parts)


def plan_files(plan: Plan) -> dict[str, bytes | str]:
    """The files of a plan folder but summary.json and the pages."""
    if plan.trajectory is None:
        raise InputError(f"nothing could be planned: {_lost(plan.left_out)}")
    solid, cycle = plan.cell.part, plan.cycle
    assert solid is not None and cycle is not None
    return {
        "plan.json": json_text(plan_record(plan)),
        "trajectory.csv": csv_text(cycle),
        "trajectory.json": trajectory_json(cycle, plan.cell.joint_names),
        **frame_files(plan.trajectory, plan.viewpoints, plan.cell),
        "robot.urdf": plan.cell.robot.record,
        **plan.cell.robot.meshes,
        "part.ply": ply_data(solid.vertices, triangles=solid.triangles, double=True),
        **{mesh.file: mesh.data for mesh in plan.cell.meshes},
        "cell.json": in_folder(plan.cell.settings, plan.cell.meshes).model_dump_json(indent=1) + "\n",
        "holes.json": json_text({"units": "m", "holes": hole_records(plan)}),
        "scan.npz": arrays_data(plan),
        **frame_files(cycle, plan.viewpoints, plan.cell),
    }


def plan_record(plan: Plan) -> PlanRecord:
    """The plan in the schema of plan.json."""
    cell, process = plan.cell, plan.cell.settings.process
    frames, cycle = {7: "flange", 8: "table", 9: "world"}, plan.cycle
    solvers = plan.solvers
    assert cycle is not None

    def finite(values: np.ndarray) -> list[float | None]:
        return [float(v) if np.isfinite(v) else None for v in values]

    return PlanRecord.model_validate(
        {
            "software": f"scanmotion {__version__}",
            "robot": cell.settings.robot.model,
            "part": plan.part.name,
            "source": plan.options.source, "mode": plan.options.mode, "strategy": plan.options.strategy,
            "seed": plan.options.seed,
            "joint_names": cell.joint_names, "robot_joints": cell.settings.robot.joints,
            "flange_link": cell.settings.robot.flange,
            "limits": {
                "position_min_rad": finite(cell.q_min), "position_max_rad": finite(cell.q_max),
                "velocity_rad_s": cell.v_max.tolist(), "acceleration_rad_s2": cell.a_max.tolist(),
                "jerk_rad_s3": cell.j_max.tolist(),
            },
            "X_WB": cell.X_WB.tolist(), "X_FS": cell.X_FS.tolist(), "X_WT": cell.X_WT.tolist(),
            "X_TO": cell.X_TO.tolist(), "home": cell.home.tolist(),
            "process": {
                k: getattr(process, k)
                for k in ("scan_speed_m_s", "transit_speed_m_s", "fps", "dwell_s", "clearance_m", "budget_s")
            },
            "bodies": [
                {
                    "name": b.name, "frame": frames[b.link], "shape": b.shape, "size_m": b.size,
                    "X": b.X_LG.tolist(),
                }
                for b in cell.bodies if b.link in frames and not b.mesh
            ] + [
                {
                    "name": m.name, "frame": frames[m.link], "shape": "mesh", "size_m": (m.scale,) * 3,
                    "X": m.X_LM.tolist(), "file": m.file,
                }
                for m in cell.meshes
            ],
            "urdf_file": "robot.urdf", "part_file": "part.ply", "cell_file": "cell.json",
            "viewpoints": [_view_record(v, solvers.get(v.id, "")) for v in plan.viewpoints],
            "unreachable": [pair for item in plan.segments for pair in item.unreachable],
            "operations": [
                {
                    "index": o.index, "kind": o.kind, "viewpoints": o.viewpoints,
                    "t_start": round(o.t_start, 6), "t_end": round(o.t_end, 6),
                    "q_start": o.q_start.tolist(), "q_end": o.q_end.tolist(),
                }
                for o in cycle.operations
            ],
        }
    )  # fmt: skip


def _view_record(v: Viewpoint, solver: str) -> dict[str, object]:
    return {
        "id": v.id, "X_OS": v.X_OS.tolist(), "standoff_m": v.standoff, "step": v.step, "kind": v.kind,
        "sweep": v.sweep, "slack_standoff_m": v.slack.standoff, "slack_tilt_rad": v.slack.tilt,
        "slack_roll": v.slack.roll, "note": v.note, "solver": solver,
    }  # fmt: skip


def json_text(record: BaseModel | Mapping[str, object]) -> str:
    """JSON, one value a line, keys in the schema's order."""
    data = record.model_dump(mode="json") if isinstance(record, BaseModel) else dict(record)
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def csv_text(trajectory: Trajectory) -> str:
    """trajectory.csv: seconds with 4 decimals, degrees with 8."""
    kinds = [o.kind for o in trajectory.operations]
    degrees = np.rad2deg(trajectory.q)
    # Adding zero turns -0.0 into 0.0.
    rows = (
        f"{t:.4f}," + ",".join(f"{round(v, 8) + 0.0:.8f}" for v in q) + f",{o},{kinds[o]}"
        for t, q, o in zip(trajectory.t, degrees, trajectory.operation, strict=True)
    )
    return CSV_HEADER + "\n" + "\n".join(rows) + "\n"


def trajectory_json(trajectory: Trajectory, joint_names: tuple[str, ...]) -> str:
    """trajectory.json: the same samples in SI units with velocities and accelerations."""
    return json.dumps(
        {
            "version": VERSION,
            "joint_names": list(joint_names),
            "units": {"time": "s", "position": "rad", "velocity": "rad/s", "acceleration": "rad/s2"},
            "time": np.round(trajectory.t, 6).tolist(),
            "position": np.round(trajectory.q, 10).tolist(),
            "velocity": np.round(trajectory.qd, 8).tolist(),
            "acceleration": np.round(trajectory.qdd, 6).tolist(),
            "operation": trajectory.operation.tolist(),
        }
    )
