"""CSV of the trajectory: seconds, degrees, and what the scanner does."""

import csv
import io

import numpy as np

from scanmotion.core.trajectory import SCANNING
from scanmotion.export.job import ExportJob, Files

AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
HEADER: tuple[str, ...] = (
    "t_s", *(f"{a}_deg" for a in AXES), *(f"{a}_deg_s" for a in AXES),
    "operation", "kind", "scanning", "viewpoints",
)  # fmt: skip


def csv_files(job: ExportJob) -> Files:
    """One row a sample: time, positions, velocities, operation, scanning or not, viewpoint ids."""
    source, name = job.source, job.name
    t = source.trajectory
    # Adding zero turns -0.0 into 0.0.
    q = np.round(np.rad2deg(t.q), 8) + 0.0
    qd = np.round(np.rad2deg(t.qd), 5) + 0.0
    labels = [(o.kind, int(o.kind in SCANNING), " ".join(o.viewpoints)) for o in t.operations]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEADER)
    for i, operation in enumerate(t.operation.tolist()):
        numbers = [f"{t.t[i]:.4f}", *(f"{v:.8f}" for v in q[i]), *(f"{v:.5f}" for v in qd[i])]
        rows.writerow([*numbers, operation, *labels[operation]])
    return {f"{name}.csv": text.getvalue()}
