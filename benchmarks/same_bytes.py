"""Plans six standard cases and prints a hash of plan.json and trajectory.csv for each.

A move of code must not change a plan. Run this before and after it and compare the lines:

    python benchmarks/same_bytes.py > before.txt
    python benchmarks/same_bytes.py --against before.txt

The cases are the built-in carving, a box, a measured scan, an interrupted plan taken up again, a plan with
helices and the paper's own method, each with seed 0. The bytes depend on processor and library versions, so
both runs belong on one machine.
"""

import argparse
import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

SCAN = Path(__file__).resolve().parents[2] / "shared/data/holes/nefertiti_cloud.ply"
CASES: dict[str, list[str]] = {
    "box": ["--box", "330", "200", "600"],
    "carving": [],
    "helix": ["--helix"],
    "paper": ["--mode", "paper"],
    "scan": ["--scan", str(SCAN)],
    "keep": ["--keep", "{carving}", "--done", "2"],
}


def hashes(folder: Path, name: str, arguments: list[str]) -> str:
    """One line for the case `name`, planned into a folder below `folder`."""
    out = folder / name
    words = [a.replace("{carving}", str(folder / "carving")) for a in arguments]
    command = [
        sys.executable,
        "-m",
        "scanmotion",
        "plan",
        *words,
        "--out",
        str(out),
        "--quiet",
        "--seed",
        "0",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        return f"{name} exit {done.returncode} {done.stderr.strip()}"
    parts = [hashlib.sha256((out / f).read_bytes()).hexdigest()[:16] for f in ("plan.json", "trajectory.csv")]
    return " ".join([name, *parts])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, help="lines of an earlier run")
    parser.add_argument("--case", action="append", choices=[*CASES], help="only this case")
    chosen = parser.parse_args()
    before = set(chosen.against.read_text().splitlines()) if chosen.against else None
    differ = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen.case or CASES:
            line = hashes(Path(folder), name, CASES[name])
            same = before is None or line in before
            differ += not same
            print(line + ("" if same else "  DIFFERS"), flush=True)
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
