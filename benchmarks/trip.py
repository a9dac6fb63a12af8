"""What a whole trip costs, by stage, in processor time and memory, on any machine: python benchmarks/trip.py

Each case is planned by a process of its own with the command line, so imports and pages count. A stage's wall
seconds come from its summary.json; processor seconds, cores used (processor by wall seconds) and the peak of
memory from the system. Every case is preceded by a reference computation (sorting and a product of matrices,
one thread), and its processor time is told as a ratio to that: a slowdown is seen on any machine
and under any load, where seconds alone say nothing.

    python benchmarks/trip.py --case help --case box > before.txt
    python benchmarks/trip.py --case help --case box --against before.txt --most 1.2
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

DATA = Path(__file__).resolve().parents[2] / "shared/data"
CASES: dict[str, list[str]] = {
    "help": ["--help"],
    "box": ["plan", "--box", "330", "200", "600"],
    "carving": ["plan"],
    "paper": ["plan", "--mode", "paper"],
    "scan": ["plan", "--scan", str(DATA / "holes/nefertiti_cloud.ply")],
}
REFERENCE = """
import numpy as np
rng = np.random.default_rng(0)
for _ in range(6):
    values = rng.random(1_500_000)
    np.sort(values)
    matrix = rng.random((700, 700))
    matrix @ matrix
"""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


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
        raise RuntimeError(f"{' '.join(command)}: status {child.returncode}: {told.strip()}")
    return Spent(
        cpu=usage.ru_utime + usage.ru_stime,
        wall=time.perf_counter() - start,
        peak=usage.ru_maxrss / (1 << 20),
    )


def case_lines(name: str, folder: Path) -> tuple[float, list[str]]:
    """A case's ratio to the reference, and the lines that tell of it."""
    words, stages = [*CASES[name]], {}
    if words[0] == "plan":
        words += ["--quiet", "--seed", "0", "--out", str(folder / name)]
    reference = spent_by([sys.executable, "-c", REFERENCE], os.environ | ONE_THREAD)
    run = spent_by([sys.executable, "-m", "scanmotion", *words], {**os.environ})
    if words[0] == "plan":
        summary = folder / name / "summary.json"
        if not summary.is_file():
            raise RuntimeError(f"{name}: no plan was made")
        stages = json.loads(summary.read_text())["planning_s"]
    ratio = run.cpu / reference.cpu
    lines = [
        f"{name} ratio {ratio:.2f} cpu {run.cpu:.1f} s reference {reference.cpu:.2f} s "
        f"cores {run.cpu / run.wall:.2f} peak {run.peak:.2f} GiB"
    ]
    lines += [f"  {stage} {seconds:.1f} s" for stage, seconds in stages.items()]
    return ratio, lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--case", action="append", choices=[*CASES], help="only this case")
    parser.add_argument("--against", type=Path, help="lines of an earlier run")
    parser.add_argument("--most", type=float, default=1.3, help="ratio to the earlier one that still passes")
    chosen = parser.parse_args()
    lines = chosen.against.read_text().splitlines() if chosen.against else []
    before = {words[0]: float(words[2]) for words in map(str.split, lines) if words[1:2] == ["ratio"]}
    slower = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen.case or [c for c in CASES if c != "scan" or DATA.is_dir()]:
            ratio, told = case_lines(name, Path(folder))
            late = name in before and ratio > chosen.most * before[name]
            slower += late
            told[0] += f"  SLOWER than {before[name]:.2f}" if late else ""
            print("\n".join(told), flush=True)
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
