"""JSON of the trajectory: SI units, with the operations and the frames that give the joints their meaning."""

import json

import numpy as np

from scanmotion.export.job import ExportJob, Files

VERSION = 1
UNITS = {
    "time": "s", "position": "rad", "velocity": "rad/s", "acceleration": "rad/s2", "frames": "m",
}  # fmt: skip


def json_files(job: ExportJob) -> Files:
    """One document: joints over time, operations and their viewpoints, poses of base, tool, table, object."""
    source, name = job.source, job.name
    record, t = source.record, source.trajectory
    document = {
        "version": VERSION,
        "software": record.software,
        "robot": record.robot,
        "part": record.part,
        "units": UNITS,
        "joint_names": list(record.joint_names),
        "frames": {key: getattr(record, key) for key in ("X_WB", "X_FS", "X_WT", "X_TO")},
        "operations": [
            {
                "index": o.index, "kind": o.kind, "scanning": o.scanning,
                "viewpoints": list(o.viewpoints), "t_start": o.t_start, "t_end": o.t_end,
            }
            for o in t.operations
        ],
        "time": np.round(t.t, 6).tolist(),
        "position": np.round(t.q, 10).tolist(),
        "velocity": np.round(t.qd, 8).tolist(),
        "acceleration": np.round(t.qdd, 6).tolist(),
        "operation": t.operation.tolist(),
    }  # fmt: skip
    return {f"{name}.json": json.dumps(document, allow_nan=False) + "\n"}
