"""Boundary points of a cloud: ours against Open3D's compute_boundary_points, in one run.

    python benchmarks/holes.py [--large]

Each side runs in a process of its own on the same cloud, normals and radius (the median distance to the 30th
neighbour, 90 degrees). Printed: seconds of the call alone (the better of two), how many times faster ours is,
the most memory each process ever held, and on what share of the points the masks agree.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIZES = (100_000, 1_000_000)
LARGE = 5_000_000
NEIGHBOURS = 30


def cloud(n: int) -> tuple[np.ndarray, np.ndarray, float]:
    """A dented sphere with about 40 round holes: points [m], normals, radius [m]."""
    from scipy.spatial import cKDTree

    from scanmotion.sensing.holes.boundary import neighbour_radius

    rng = np.random.default_rng(0)
    centre = rng.normal(size=(40, 3))
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    unit = rng.normal(size=(int(1.2 * n), 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[(unit @ centre.T < np.cos(0.08)).all(axis=1)][:n]
    wave = 1.0 + 0.1 * np.sin(6.0 * unit[:, 0])
    slope = np.zeros_like(unit)
    slope[:, 0] = 0.6 * np.cos(6.0 * unit[:, 0])
    slope -= unit * np.einsum("ij,ij->i", slope, unit)[:, None]
    normals = wave[:, None] * unit - slope
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = 0.3 * wave[:, None] * unit
    return points, normals, neighbour_radius(cKDTree(points), NEIGHBOURS)


def ours(points: np.ndarray, normals: np.ndarray, radius: float):
    from scanmotion.sensing.holes.boundary import boundary_points

    return lambda rows: boundary_points(points[:rows], normals[:rows], radius=radius)


def open3d(points: np.ndarray, normals: np.ndarray, radius: float):
    import open3d as o3d

    def run(rows: int) -> np.ndarray:
        made = o3d.t.geometry.PointCloud(o3d.core.Tensor(points[:rows]))
        made.point.normals = o3d.core.Tensor(normals[:rows])
        # max_nn over every true count: a smaller one widens gaps
        return made.compute_boundary_points(radius, 120, 90.0)[1].numpy()

    return run


def peak() -> float:
    """Most memory this process has held [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def child(side: str, folder: Path) -> None:
    points, normals = np.load(folder / "points.npy"), np.load(folder / "normals.npy")
    run = {"ours": ours, "open3d": open3d}[side](points, normals, float(np.load(folder / "radius.npy")))
    run(2000)
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        mask = run(len(points))
        seconds.append(time.perf_counter() - start)
    print(min(seconds), peak())
    np.save(folder / f"{side}.npy", mask)


def compare(n: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for key, value in zip(("points", "normals", "radius"), cloud(n), strict=True):
            np.save(folder / f"{key}.npy", value)
        figures = {}
        for side in ("open3d", "ours"):
            command = [sys.executable, __file__, "--side", side, "--folder", name]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            figures[side] = [float(word) for word in done.stdout.split()[-2:]]
        same = np.load(folder / "ours.npy") == np.load(folder / "open3d.npy")
    (t_o, m_o), (t_u, m_u) = figures["open3d"], figures["ours"]
    print(f"{n:>9} {t_u:9.2f} {t_o:9.2f} {t_o / t_u:9.1f} {m_u:9.0f} {m_o:9.0f} {same.mean():9.6f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--large", action="store_true", help="5 million points too")
    parser.add_argument("--side", choices=("ours", "open3d"), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.side:
        child(options.side, options.folder)
        return
    heads = ("points", "ours s", "Open3D s", "times", "ours MB", "O3D MB", "agreement")
    print(" ".join(f"{head:>9}" for head in heads))
    for n in (*SIZES, LARGE) if options.large else SIZES:
        compare(n)


if __name__ == "__main__":
    main()
