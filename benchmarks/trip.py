"""What a whole trip costs, by stage, in processor time and memory, on any machine: python benchmarks/trip.py

Each case is planned by a process of its own with the command line, so imports and pages count. Told are the
processor seconds, the cores used (processor by wall seconds) and the peak of memory of the whole, and
processor and wall seconds of each stage. Every case is preceded by a reference computation (sorting and a
product of matrices, one thread); its processor time is told as a ratio to that: a slowdown is seen on any
machine and under any load, where seconds alone say nothing. `trip.txt` beside this file is the stored
baseline.

    python benchmarks/trip.py --case help --case box                     compared with trip.txt
    python benchmarks/trip.py --case carving --against mine.txt --most 1.2
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[2] / "shared/data"
BASELINE = Path(__file__).with_suffix(".txt")
BOX = ["plan", "--box", "330", "200", "600"]
REFERENCE = """
import numpy as np
rng = np.random.default_rng(0)
for _ in range(6):
    values = rng.random(1_500_000)
    np.sort(values)
    matrix = rng.random((700, 700))
    matrix @ matrix
"""
CHILD = """
import json, os, runpy, sys, time
from contextlib import contextmanager
from scanmotion.core.support import stopwatch

spent = {}

class Both(stopwatch.Stopwatch):
    @contextmanager
    def __call__(self, stage):
        cpu, wall = time.process_time(), time.perf_counter()
        with super().__call__(stage):
            yield
        before = spent.get(stage, (0.0, 0.0))
        spent[stage] = (before[0] + time.process_time() - cpu, before[1] + time.perf_counter() - wall)

stopwatch.Stopwatch = Both
try:
    runpy.run_module("scanmotion", run_name="__main__", alter_sys=True)
finally:
    with open(os.environ["TRIP_STAGES"], "w") as file:
        json.dump(spent, file)
"""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def mesh_of(triangles: int) -> Callable[[Path], list[str]]:
    """A closed lump with waves and a scanner's roughness, of about so many triangles, as a binary PLY."""

    def words(folder: Path) -> list[str]:
        import trimesh

        rows = int(np.sqrt(triangles / 4))
        cols = 2 * rows
        rng = np.random.default_rng(1)
        tilt, turn = np.meshgrid(np.linspace(0, np.pi, rows + 2)[1:-1], 2 * np.pi * np.arange(cols) / cols)
        tilt, turn = tilt.T, turn.T
        wave = 1 + 0.12 * np.sin(5 * turn) * np.sin(tilt) ** 2 + 0.06 * np.cos(7 * tilt)
        radius = 200.0 * wave + rng.normal(0.0, 0.02, tilt.shape)
        p = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), 1.4 * np.cos(tilt)], axis=-1)
        points = (radius[..., None] * p).reshape(-1, 3)
        at = np.arange(rows * cols).reshape(rows, cols)
        a, b = at[:-1], at[1:]
        c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
        faces = np.concatenate(
            [np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)]
        )
        top, bottom = len(points), len(points) + 1
        points = np.vstack([points, [0, 0, 200 * 1.4 * 1.06], [0, 0, -200 * 1.4 * 0.94]])
        caps = [np.stack([np.full(cols, top), at[0], np.roll(at[0], -1)], -1)]
        caps.append(np.stack([np.full(cols, bottom), np.roll(at[-1], -1), at[-1]], -1))
        path = folder / f"lump{triangles}.ply"
        trimesh.Trimesh(points, np.concatenate([faces, *caps]), process=False).export(path)
        return ["plan", "--part", str(path)]

    return words


def views_of(count: int) -> Callable[[Path], list[str]]:
    """So many stations about a box, as a file of one's own viewpoints."""

    def words(folder: Path) -> list[str]:
        k = np.arange(count) + 0.5
        z = 0.15 + 0.75 * (k / count)
        turn = np.pi * (1 + 5**0.5) * k
        d = np.stack([np.cos(turn) * np.sqrt(1 - z**2), np.sin(turn) * np.sqrt(1 - z**2), z], axis=1)
        p = np.array([0, 0, 300.0]) + 700.0 * d
        lines = ["id,standoff_mm,x_mm,y_mm,z_mm,dx,dy,dz"]
        lines += [f"V{i},550," + ",".join(f"{x:.6f}" for x in (*p[i], *-d[i])) for i in range(count)]
        path = folder / f"views{count}.csv"
        path.write_text("\n".join(lines) + "\n")
        return [*BOX, "--viewpoints", str(path)]

    return words


CASES: dict[str, list[str] | Callable[[Path], list[str]]] = {
    "help": ["--help"],
    "box": BOX,
    "carving": ["plan"],
    "paper": ["plan", "--mode", "paper"],
    "bust": ["plan", "--part", str(DATA / "nefertiti_bust.ply")],
    "ugolino": ["plan", "--part", str(DATA / "ugolino.ply")],
    "scan": ["plan", "--scan", str(DATA / "holes/nefertiti_cloud.ply")],
    "views10": views_of(10),
    "views100": views_of(100),
    "views1000": views_of(1000),
    "1.6M": mesh_of(1_600_000),
    "6M": mesh_of(6_000_000),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Spent:
    """What a process took."""

    cpu: float
    """Processor time of the user and the system [s]."""
    wall: float
    """[s]."""
    peak: float
    """Largest resident memory [GiB]."""


def spent_by(command: list[str], environment: dict[str, str]) -> Spent:
    """Runs a command to its end; what it took.

    Raises:
        RuntimeError: it ended with another status than 0 (passes) or 1 (a check failed).
    """
    start = time.perf_counter()
    child = subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert child.stderr is not None
    told = child.stderr.read()
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(command[-8:])}: status {child.returncode}: {told.strip()}")
    return Spent(
        cpu=usage.ru_utime + usage.ru_stime,
        wall=time.perf_counter() - start,
        peak=usage.ru_maxrss / (1 << 20),
    )


def case_lines(name: str, folder: Path) -> tuple[float, list[str]]:
    """A case's ratio to the reference, and the lines that tell of it."""
    made = CASES[name]
    words = list(made) if isinstance(made, list) else made(folder)
    if words[0] == "plan":
        words += ["--quiet", "--seed", "0", "--out", str(folder / name)]
    reference = spent_by([sys.executable, "-c", REFERENCE], os.environ | ONE_THREAD)
    told = folder / "stages.json"
    if words[0] == "plan":
        run = spent_by([sys.executable, "-c", CHILD, *words], {**os.environ, "TRIP_STAGES": str(told)})
        stages = {k: tuple(v) for k, v in json.loads(told.read_text()).items()}
        stages["imports, judge, pages"] = tuple(
            total - sum(v[i] for v in stages.values()) for i, total in enumerate((run.cpu, run.wall))
        )
    else:
        run = spent_by([sys.executable, "-m", "scanmotion", *words], {**os.environ})
        stages = {}
    ratio = run.cpu / reference.cpu
    lines = [
        f"{name} ratio {ratio:.2f} cpu {run.cpu:.1f} s wall {run.wall:.1f} s reference {reference.cpu:.2f} s "
        f"cores {run.cpu / run.wall:.2f} peak {run.peak:.2f} GiB"
    ]
    lines += [
        f"  {stage}: ratio {cpu / reference.cpu:.2f} cpu {cpu:.1f} s wall {wall:.1f} s"
        for stage, (cpu, wall) in stages.items()
    ]
    return ratio, lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--case", action="append", choices=[*CASES], help="only this case")
    parser.add_argument("--against", type=Path, default=BASELINE, help="lines of an earlier run")
    parser.add_argument("--most", type=float, default=1.3, help="ratio to the earlier one that still passes")
    chosen = parser.parse_args()
    lines = chosen.against.read_text().splitlines() if chosen.against.is_file() else []
    before = {words[0]: float(words[2]) for words in map(str.split, lines) if words[1:2] == ["ratio"]}
    slower = 0
    lacking = set() if DATA.is_dir() else {"scan", "bust", "ugolino"}
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen.case or [c for c in CASES if c not in lacking]:
            ratio, told = case_lines(name, Path(folder))
            late = name in before and ratio > chosen.most * before[name]
            slower += late
            told[0] += f"  SLOWER than {before[name]:.2f}" if late else ""
            print("\n".join(told), flush=True)
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
