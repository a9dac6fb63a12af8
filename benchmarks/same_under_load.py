"""Plans the same small job many times while the cores are busy, and compares the bytes.

    python benchmarks/same_under_load.py --runs 20 --threads 1 2 4

Each run is a process of its own: a box with its global step; and a block with a pit, scanned by the twin
with errors, calibrated, with a local round. The figures change with the run: the number of threads
(OpenMP's, numba's, OpenBLAS's), the byte with which glibc fills memory that is taken and given back, and
the size of the environment, which moves the stack; Python's hashes change by themselves. One line a run:
the first hexadecimal digits of a hash of each file or stage. Meanwhile one process a core keeps it busy.

`--job stages` is lighter: scan, cloud, holes, closed surface and local viewpoints of the carving.
"""

import argparse
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def hash_of(*arrays: Any) -> str:
    """First digits of a hash of some arrays' bytes."""
    told = hashlib.sha256()
    for array in arrays:
        told.update(np.ascontiguousarray(array).tobytes())
    return told.hexdigest()[:10]


def stages() -> dict[str, str]:
    """From scan to local viewpoints: a hash of each stage's arrays."""
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
    return {
        "scan": hash_of(scan.points_O, scan.depth),
        "cloud": hash_of(cloud.points, cloud.normals, cloud.view_directions, cloud.counts),
        "holes": hash_of(*(a for h in holes for a in (h.boundary, h.X_OH, h.extent, h.normal, h.center))),
        "closed": hash_of(step.model.vertices, step.model.triangles, step.model.distance),
        "views": hash_of(*(v.X_OS for v in step.viewpoints), step.gains, step.targets),
    }


def plans() -> dict[str, str]:
    """Two small plans from the part to the files: a hash of each file whose bytes a plan decides."""
    from scanmotion.cell.settings.cell import load_cell
    from scanmotion.core.part import Part
    from scanmotion.geometry.parts.make_part import box_part
    from scanmotion.plan_io.write import plan_files
    from scanmotion.planning.pipeline import PlanOptions, plan
    from scanmotion.sensing.simulator.captures import ScanErrors

    vertices, triangles = pitted_block()
    coarse = PlanOptions(rounds=1, samples=4000, stride=4, voxel=0.004, seed=3)
    errors = ScanErrors(hand_eye_m=(2e-4, 0.0, -1e-4), backlash_rad=1e-4)
    told = {}
    for name, part, changed in (
        ("box", box_part(0.2, 0.15, 0.3), {"source": "box"}),
        (
            "pit",
            Part(name="pit", vertices=vertices, triangles=triangles),
            {"errors": errors, "calibrate": True},
        ),
    ):
        from dataclasses import replace

        made = plan(part, load_cell("kr240"), options=replace(coarse, **changed))
        files = plan_files(made)
        for file in ("plan.json", "trajectory.csv", "frames.csv", "holes.json"):
            if file in files:
                data = files[file]
                told[f"{name}:{file}"] = hash_of(
                    np.frombuffer(data if isinstance(data, bytes) else data.encode(), np.uint8)
                )
        if made.cloud is not None:
            told[f"{name}:cloud"] = hash_of(made.cloud.points, made.cloud.normals, made.seen)
    return told


def pitted_block() -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] and triangles of a block with a deep narrow pit in its top: no turn sees all of it."""
    ring = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    outer, inner = ring * (0.2, 0.15), ring * (0.05, 0.05)
    layers = ((outer, 0.0), (outer, 0.2), (inner, 0.2), (inner, 0.12))
    vertices = np.vstack([np.column_stack([xy, np.full(4, z)]) for xy, z in layers])
    triangles = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for low in (0, 4, 8):
        for i in range(4):
            a, b = low + i, low + (i + 1) % 4
            triangles += [[a, b, b + 4], [a, b + 4, a + 4]]
    return vertices, np.array(triangles)


JOBS: dict[str, Callable[[], dict[str, str]]] = {"plans": plans, "stages": stages}
BURN = "import os\nos.nice(10)\nwhile True: pass"
"""What a process does that keeps a core busy; it gives way to the run, but the run is moved about."""


def environment(threads: int, n: int) -> dict[str, str]:
    """The n-th run's: so many threads, and memory that is laid out and filled in another way."""
    return {
        **os.environ,
        **dict.fromkeys(VARIABLES, str(threads)),
        "MALLOC_PERTURB_": str(1 + 37 * n % 255),
        "SCANMOTION_PADDING": "x" * (97 * n),
    }


def lines_under_load(threads: list[int], runs: int, job: str = "plans") -> list[tuple[int, str]]:
    """(threads, line) of each run, the thread counts in turn, while every core is kept busy."""
    busy = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(os.cpu_count() or 1)]
    try:
        found = []
        for n in range(runs):
            count = threads[n % len(threads)]
            command = [sys.executable, __file__, "--one", "--job", job]
            done = subprocess.run(
                command, capture_output=True, text=True, env=environment(count, n), check=True
            )
            found.append((count, done.stdout.strip()))
            print(count, found[-1][1], flush=True)
        return found
    finally:
        for burner in busy:
            burner.kill()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--job", choices=[*JOBS], default="plans")
    parser.add_argument("--one", action="store_true", help="one run in this process")
    chosen = parser.parse_args()
    if chosen.one:
        print(" ".join(f"{name} {told}" for name, told in JOBS[chosen.job]().items()))
        return 0
    different = {line for _, line in lines_under_load(chosen.threads, chosen.runs, chosen.job)}
    print(f"{len(different)} different of {chosen.runs}")
    return 0 if len(different) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
