"""Repeats the stages from scan to local viewpoints while the cores are busy, and compares their bytes.

    python benchmarks/same_under_load.py --runs 20 --threads 1 2 4

Each run is a process of its own: it simulates two turns of the built-in carving, fuses them, finds holes, and
chooses local viewpoints, with so many threads (OpenMP's, numba's, OpenBLAS's) in turn. One line a run: the
first hexadecimal digits of a hash of each stage's arrays. Meanwhile one process a core keeps it busy.
"""

import argparse
import hashlib
import os
import subprocess
import sys
from typing import Any

import numpy as np

STAGES = ("scan", "cloud", "holes", "closed", "views")
VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def hash_of(*arrays: Any) -> str:
    """First digits of a hash of some arrays' bytes."""
    told = hashlib.sha256()
    for array in arrays:
        told.update(np.ascontiguousarray(array).tobytes())
    return told.hexdigest()[:10]


def one_run() -> str:
    """Runs the stages once; one line of hashes."""
    from scanmotion.cell.settings.cell import load_cell
    from scanmotion.cell.table_of import table_of
    from scanmotion.cell.view_costs import view_costs
    from scanmotion.geometry.parts.make_part import carving
    from scanmotion.sensing.free_space import Space
    from scanmotion.sensing.fusion.fuse import fuse
    from scanmotion.sensing.holes.find import holes_from_cloud
    from scanmotion.sensing.simulator.captures import Captures
    from scanmotion.sensing.simulator.images import depth_images
    from scanmotion.sensing.simulator.simulate import simulate
    from scanmotion.sensing.visibility import revolution_poses, scene_from
    from scanmotion.views.candidate_views import CandidateOptions
    from scanmotion.views.next_best_views import SelectOptions, local_step
    from scanmotion.views.stepped_rotary import stepped_rotary

    cell, part = load_cell("kr240"), carving()
    scanner, table = cell.scanner_model(), table_of(cell)
    length, width, height = (float(side) for side in part.extent)
    turns = stepped_rotary(length, width, height, scanner).viewpoints[:2]
    X_OS = np.concatenate([revolution_poses(v.X_OS, 24) for v in turns])
    captures = Captures(
        t=np.arange(len(X_OS)) / 10,
        X_WS=X_OS,
        table_angle=np.zeros(len(X_OS)),
        X_WT=np.eye(4),
        X_TO=np.eye(4),
    )
    scene = scene_from(part.vertices, part.triangles, table_radius=table.radius)
    scan = simulate(scene, scanner, captures, stride=4, rng=np.random.default_rng(0))
    cloud = fuse([scan], voxel=0.004)
    holes = holes_from_cloud(cloud.points, view_directions=cloud.view_directions).holes
    space = Space(scanner, edge=0.004, stride=4)
    space.add(captures.X_OS, depth_images(scan, scanner, stride=4))
    coarse = CandidateOptions(seeds=25, directions=60, per_seed=12)
    step = local_step(
        cloud.points, cloud.normals, holes, scanner, spacing=0.004, table=table, costs=view_costs(cell),
        space=space, options=SelectOptions(candidates=coarse), rng=np.random.default_rng(0),
    )  # fmt: skip
    hashes = (
        hash_of(scan.points_O, scan.depth),
        hash_of(cloud.points, cloud.normals, cloud.view_directions, cloud.counts),
        hash_of(*(a for h in holes for a in (h.boundary, h.X_OH, h.extent, h.normal, h.center))),
        hash_of(step.model.vertices, step.model.triangles, step.model.distance),
        hash_of(*(v.X_OS for v in step.viewpoints), step.gains, step.targets),
    )
    return " ".join(f"{name} {told}" for name, told in zip(STAGES, hashes, strict=True))


BURN = "while True: pass"
"""What a process does that keeps a core busy."""


def lines_under_load(threads: list[int], runs: int) -> list[tuple[int, str]]:
    """(threads, line) of each run, the thread counts in turn, while every core is kept busy."""
    busy = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(os.cpu_count() or 1)]
    try:
        found = []
        for n in range(runs):
            count = threads[n % len(threads)]
            environment = {**os.environ, **dict.fromkeys(VARIABLES, str(count))}
            done = subprocess.run(
                [sys.executable, __file__, "--one"],
                capture_output=True,
                text=True,
                env=environment,
                check=True,
            )
            found.append((count, done.stdout.strip()))
            print(count, found[-1][1], flush=True)
        return found
    finally:
        for burner in busy:
            burner.kill()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--one", action="store_true", help="one run in this process")
    chosen = parser.parse_args()
    if chosen.one:
        print(one_run())
        return 0
    different = {line for _, line in lines_under_load(chosen.threads, chosen.runs)}
    print(f"{len(different)} different of {chosen.runs}")
    return 0 if len(different) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
