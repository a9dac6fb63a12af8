"""The scan twin against Open3D's ray casting alone, and what fusing a whole global scan takes.

    python benchmarks/scan.py [--part statue.ply] [--frames 60] [--stride 2] [--turns 3] [--seed 0]

The peer casts the rays of every pixel that the twin is asked for, made beforehand, and does nothing else; the
twin also tests incidence, range and the projector's shadow, draws noise and writes points. The second peer
casts only those rays that may meet the part (the twin leaves the others out). All take turns, and the
medians count. Peak memory is that of the process, less what it was before the scan. Exit status 1 where it
passes 2 GiB.
"""

import argparse
import resource
import sys
import time

import numpy as np

from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.parts.make_part import part_from_file
from scanmotion.sensing.fusion.fuse import fuse
from scanmotion.sensing.fusion.merge import merged
from scanmotion.sensing.simulator.captures import Captures, still_captures
from scanmotion.sensing.simulator.kernels import frame_rays
from scanmotion.sensing.simulator.simulate import _Grid, _spans, simulate
from scanmotion.sensing.visibility import Scene, revolution_poses, scene_from
from scanmotion.views.stepped_rotary import stepped_rotary


def statue(rings: int = 224, *, height: float = 0.5) -> Part:
    """A lumpy closed body of 100k triangles on the floor."""
    theta = np.linspace(0.02, np.pi - 0.02, rings)
    phi = 2 * np.pi * np.arange(rings) / rings
    T, P = np.meshgrid(theta, phi, indexing="ij")
    u = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=-1)
    r = 1 + 0.2 * np.sin(5 * u[..., 0] + 1) * np.cos(6 * u[..., 1]) + 0.15 * np.sin(9 * u[..., 2] + P)
    p = (u * r[..., None] * [0.4, 0.4, 1.0] * height / 2).reshape(-1, 3)
    i, j = (m.ravel() for m in np.meshgrid(np.arange(rings - 1), np.arange(rings), indexing="ij"))
    a, b = i * rings + j, i * rings + (j + 1) % rings
    triangles = np.vstack([np.column_stack([a, a + rings, b]), np.column_stack([b, a + rings, b + rings])])
    return Part(name="statue", vertices=p - [0, 0, p[:, 2].min()], triangles=triangles)


def rays_of(
    scene: Scene, scanner: Scanner, captures: Captures, stride: int, *, hull: bool
) -> list[np.ndarray]:
    """The pixels' rays of every frame, shape (k, 6) float32 each."""
    grid, out = _Grid(scanner, stride), []
    for k, X in enumerate(captures.X_OS):
        columns, rows = grid.phase(k)
        low, high = _spans(X, rows, scene.outline if hull else None)
        out.append(frame_rays(X, columns, rows, low, high)[0])
    return out


def clocks() -> np.ndarray:
    """Wall and processor seconds; the latter of all threads."""
    return np.array([time.perf_counter(), time.process_time()])


def cast(scene: Scene, rays: list[np.ndarray]) -> np.ndarray:
    begin = clocks()
    for r in rays:
        scene.raycaster.cast_rays(r)["t_hit"].numpy()
    return clocks() - begin


def peak() -> float:
    """Most memory the process ever held [GiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", help="mesh in mm; a lumpy body of 100k triangles unless given")
    parser.add_argument("--frames", type=int, default=60, help="of each turn of the table")
    parser.add_argument("--stride", type=int, default=2)
    parser.add_argument("--turns", type=int, default=3, help="repetitions")
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    part = part_from_file(a.part) if a.part else statue()
    scanner = Scanner()
    scene = scene_from(part.vertices, part.triangles, table_radius=0.4, table_z=-0.3, pedestal_radius=0.1)
    length, width, height = part.extent
    views = [v.X_OS for v in stepped_rotary(length, width, height, scanner).viewpoints]
    captures = still_captures(np.concatenate([revolution_poses(X, a.frames) for X in views]))
    print(f"{part.name}: {len(part.triangles)} triangles, {len(views)} turns, {len(captures)} frames")

    def scanned(captures: Captures):
        return simulate(scene, scanner, captures, stride=a.stride, rng=np.random.default_rng(a.seed))

    few = scanned(still_captures(captures.X_OS[:: len(captures) // 4]))
    merged(fuse([few]), fuse([few]))  # compiles
    before = peak()
    seconds, scan, cloud = [], few, fuse([few])
    for turn in range(a.turns):
        begin = clocks()
        scan = scanned(captures)
        middle = clocks()
        cloud = fuse([scan])
        row = [middle - begin, clocks() - middle]
        if turn == 0:
            memory = peak() - before
            every, inside = (rays_of(scene, scanner, captures, a.stride, hull=h) for h in (False, True))
        seconds.append([*row, cast(scene, every), cast(scene, inside)])
    twin, fusing, alone, hull = np.median(seconds, axis=0)
    asked, kept = sum(map(len, every)), sum(map(len, inside))
    print(f"{'':28}{'rays':>12}{'seconds':>10}{'rays/s':>12}{'processor s':>13}")
    for name, n, s in (
        ("scanmotion simulate", scan.rays, twin), ("cast_rays, every pixel", asked, alone),
        ("cast_rays, pixels on the part", kept, hull),
    ):  # fmt: skip
        print(f"{name:29}{n:11d}{s[0]:10.2f}{n / s[0]:12.3g}{s[1]:13.2f}")
    ratio, part_only = (scan.rays / twin) / (asked / alone), hull / twin
    for k, clock in enumerate(("wall clock", "processor")):
        print(f"rays/s over cast_rays alone, {clock}: {ratio[k]:.2f} (the part's pixels: {part_only[k]:.2f})")
    print(f"fuse: {len(scan)} points -> {len(cloud)} in {fusing[0]:.2f} s; both hold {memory:.2f} GiB")
    return int(memory > 2.0)


if __name__ == "__main__":
    sys.exit(main())
