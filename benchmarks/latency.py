"""Accuracy of a global scan with and without latency, as measured and as calibrated: python
benchmarks/latency.py"""

import numpy as np

from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.geometry.parts.make_part import box_part, carving
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.corrections.calibration import calibrate, corrected
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.simulator.captures import ScanErrors, captures_from_trajectory
from scanmotion.sensing.simulator.simulate import simulate
from scanmotion.sensing.visibility import scene_from

OTHERS = {
    "axis_m": (3e-4, -2e-4), "hand_eye_m": (2e-4, -1e-4, -3e-4), "backlash_rad": float(np.deg2rad(0.02)),
}  # fmt: skip


def main() -> None:
    part, settings = carving(), load_cell("kr240")
    made = plan(box_part(*part.extent), settings, options=PlanOptions(source="box"))
    cell = made.cell
    captures = captures_from_trajectory(
        made.trajectory,
        lambda q: scanner_poses(cell, q),
        fps=settings.process.fps,
        X_WT=cell.X_WT,
        X_TO=cell.X_TO,
    )
    scene = scene_from(part.vertices, part.triangles, table_radius=settings.turntable.diameter_m / 2)
    for latency, others in ((0.0, {}), (5e-4, {}), (2e-3, {}), (5e-3, {}), (2e-3, OTHERS)):
        errors = ScanErrors(latency_s=latency, **others)
        scan = simulate(
            scene, settings.scanner_model(), captures, errors=errors, stride=4, rng=np.random.default_rng(0)
        )
        found = calibrate([scan], points=150_000, latency=True)
        told = []
        for s in (scan, corrected(scan, found.errors)):
            a = accuracy(fuse([s]).points, part)
            told.append(f"{a.mean_abs * 1e3:.3f} / {a.sd_signed * 1e3:.3f}")
        ms, sd = found.errors.latency_s * 1e3, found.sd[-1] * 1e3
        name = f"{latency * 1e3:g} ms" + (", all others too" if others else "")
        print(f"| {name} | {told[0]} | {told[1]} | {ms:.2f} +- {sd:.2f} ms |", flush=True)


if __name__ == "__main__":
    main()
