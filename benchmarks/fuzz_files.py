"""Damaged files of parts and scans by the thousand: each ends in a part or in one clear line.

    python benchmarks/fuzz_files.py --files 100000

Prints how many were read and refused, the slowest and the peak of memory; ends with status 1 at the first
traceback, at a file that takes longer than a limit, or at more than 1 GiB beyond the start.
"""

import argparse
import resource
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from mesh_dialects import MESHES
from test_cloud_dialects import CLOUDS
from test_fuzz import damaged

from scanmotion.core.errors import PartError
from scanmotion.geometry.parts.make_part import part_from_file

SECONDS = 20.0
GIB = 1 << 20


def main() -> int:
    ask = argparse.ArgumentParser()
    ask.add_argument("--files", type=int, default=2000)
    ask.add_argument("--seed", type=int, default=0)
    a = ask.parse_args()
    seeds = {**MESHES, **CLOUDS}
    names = list(seeds)
    rng = np.random.default_rng(a.seed)
    read = refused = 0
    slowest, start = (0.0, ""), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory() as folder:
        for i in range(a.files):
            name = names[i % len(names)]
            path = Path(folder) / name
            path.write_bytes(damaged(seeds[name], rng))
            began = time.process_time()
            try:
                part_from_file(path, guess=True)
                read += 1
            except PartError as error:
                refused += 1
                assert "\n" not in str(error), name
            except Exception:
                traceback.print_exc()
                path.rename(Path(tempfile.gettempdir()) / f"fuzz-{a.seed}-{i}-{name}")
                print(f"file {i} of seed {a.seed} ({name}) ended in a traceback", file=sys.stderr)
                return 1
            slowest = max(slowest, (time.process_time() - began, name))
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start
            if slowest[0] > SECONDS or peak > GIB:
                print(f"file {i} ({name}): {slowest[0]:.1f} s, {peak / GIB:.2f} GiB", file=sys.stderr)
                return 1
            path.unlink()
    print(
        f"{a.files} damaged files: {read} read, {refused} refused; "
        f"slowest {slowest[0]:.2f} s of CPU ({slowest[1]}), "
        f"peak {peak / 1024:.0f} MiB over the start"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
