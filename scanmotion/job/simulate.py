"""The twin as the scanner of a job: it writes the files that a real scanner would have written."""

import csv
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from scanmotion.cell.build import build_cell
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.support.streams import Streams
from scanmotion.core.trajectory import Trajectory
from scanmotion.geometry.files.ply_write import ply_data, replaced
from scanmotion.job.adding import known_constants
from scanmotion.job.frame_files import depth_npz, intrinsics_of
from scanmotion.job.poses import LIST, programme_captures
from scanmotion.job.store import Job
from scanmotion.plan_io.load import load_plan
from scanmotion.sensing.simulator.captures import Captures, ScanErrors, inverse
from scanmotion.sensing.simulator.simulate import Scan, simulate
from scanmotion.sensing.visibility import scene_from

FORMATS = ("ply", "xyz", "npz")
LOG = "log.csv"
_LOG_S = 0.012
"""A controller's log has a line every 12 ms: the interpolation cycle of a KRC4."""


def write_simulated(
    job: Job,
    number: int,
    truth: Part,
    folder: Path,
    *,
    kind: str = "ply",
    stride: int = 2,
    progress: Callable[[float], None] = lambda f: None,
) -> int:
    """Lets the twin scan along a plan of the job, with the errors of the cell's section twin.

    Writes one file a frame in millimetres in S (or a depth image with intrinsics), frames.csv with file,
    index and time stamp, and the controller's log.

    Args:
        job: with the plan.
        number: of the plan, from 1.
        truth: the mesh that stands on the table.
        folder: where the files go; it is made.
        kind: of the frames, one of FORMATS.
        stride: every n-th pixel in x and y.
        progress: told the share done.

    Returns:
        how many frames were written.

    Raises:
        InputError: an unknown kind, or no mesh.
    """
    if kind not in FORMATS:
        raise InputError(f"unknown kind of frames {kind!r}; known: {', '.join(FORMATS)}")
    if not truth.is_mesh:
        raise InputError(f"{truth.name}: the twin scans a mesh, not a cloud")
    plan, settings, cell = load_plan(job.plan_folder(number)), job.settings, build_cell(job.settings)
    assert plan.trajectory is not None
    nominal = programme_captures(cell, plan.trajectory)
    pedestal = settings.pedestal
    scene = scene_from(
        truth.vertices, truth.triangles, table_radius=settings.turntable.diameter_m / 2,
        table_z=-pedestal.height_m, pedestal_radius=pedestal.diameter_m / 2,
    )  # fmt: skip
    # What the cell knows of latency and backlash is true; its section twin holds what it does not know.
    scan = simulate(
        scene, settings.scanner_model(), known_constants(nominal, job),
        errors=ScanErrors(**settings.twin_errors()), stride=stride,
        rng=Streams(seed=job.record.seed).child("job_scan", number), progress=progress,
    )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"frame-{k:05d}.{kind}" for k in range(len(nominal))]
    for k, name in enumerate(names):
        replaced(folder / name, _frame(scan, k, kind, job))
    replaced(folder / LOG, _log(plan.trajectory, cell.joint_names))
    replaced(folder / LIST, _list(names, nominal))
    return len(names)


def _frame(scan: Scan, k: int, kind: str, job: Job) -> bytes:
    """The bytes of one frame's file."""
    scanner = job.settings.scanner_model()
    if kind == "npz":
        return depth_npz(scan.range_image(k, scanner), intrinsics_of(scanner))
    one = slice(*np.searchsorted(scan.frame, [k, k + 1]))
    X_SO = inverse(scan.captures.X_OS[k][None])[0]
    p_S = (scan.points_O[one].astype(float) @ X_SO[:3, :3].T + X_SO[:3, 3]) * 1e3
    if kind == "ply":
        return ply_data(p_S)
    return "".join(f"{x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in p_S).encode()


def _list(names: list[str], captures: Captures) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("file", "index", "t_s"))
    writer.writerows((name, k, f"{t:.6f}") for k, (name, t) in enumerate(zip(names, captures.t, strict=True)))
    return text.getvalue().encode()


def _log(trajectory: Trajectory, names: tuple[str, ...]) -> bytes:
    """Joints in degrees every 12 ms, as a controller writes them."""
    path = CubicHermiteSpline(trajectory.t, trajectory.q, trajectory.qd)
    end = float(trajectory.t[-1])
    t = np.append(np.arange(0.0, end, _LOG_S), end)
    rows = [
        f"{a:.6f}," + ",".join(f"{v:.7f}" for v in q) for a, q in zip(t, np.rad2deg(path(t)), strict=True)
    ]
    return ("t_s," + ",".join(names) + "\n" + "\n".join(rows) + "\n").encode()
