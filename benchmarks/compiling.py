"""What is compiled at a first run, by kernel: python benchmarks/compiling.py [--write] [-- plan ...]

Plans the built-in carving (or what stands after --) with an empty cache and tells the processor seconds of
each kernel that numba compiles, with and without what it calls. `--write` makes
scanmotion/geometry/kernels.txt of it; weights are those seconds, by which the processes that compile
ahead share the work.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

LISTENER = """
import json, os, runpy, sys, time
from numba.core import event


class Listener(event.Listener):
    def __init__(self):
        self.stack, self.rows = [], []

    def on_start(self, e):
        self.stack.append([time.thread_time(), 0.0])

    def on_end(self, e):
        start, inner = self.stack.pop()
        took = time.thread_time() - start
        if self.stack:
            self.stack[-1][1] += took
        f, kinds = e.data["dispatcher"].py_func, str(e.data["args"])
        self.rows.append((f.__module__, f.__qualname__, kinds, took - inner, took, len(self.stack)))


listener = Listener()
event.register("numba:compile", listener)
try:
    runpy.run_module("scanmotion", run_name="__main__", alter_sys=True)
finally:
    with open(os.environ["COMPILED_ROWS"], "w") as file:
        json.dump(listener.rows, file)
"""


def main() -> None:
    import json

    from scanmotion.geometry.compiled import LIST, kernel_lines

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--write", action="store_true", help="make kernels.txt of it")
    parser.add_argument("words", nargs=argparse.REMAINDER, help="after --: what is run")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder, "rows.json")
        lazy = {"NUMBA_CACHE_DIR": folder, "COMPILED_ROWS": str(told), "SCANMOTION_COMPILE_AHEAD": "0"}
        words = [
            sys.executable,
            "-c",
            LISTENER,
            *(chosen.words[1:] or ["plan", "--no-html", "--quiet"]),
            "--out",
            str(Path(folder, "out")),
        ]
        subprocess.run(words, env={**os.environ, **lazy}, check=False)
        rows = json.loads(told.read_text())
    ours = [row for row in rows if row[0].startswith("scanmotion.")]
    spent = sum(row[3] for row in rows)
    print(f"compiled {len(rows)} functions, {len(ours)} of them ours, in {spent:.1f} s of processor time")
    for module, name, kinds, own, whole, depth in sorted(ours, key=lambda r: -r[3]):
        print(f"{own:6.2f} {whole:6.2f} {'door' if depth == 0 else '    '} {module}.{name} {kinds[:120]}")
    if chosen.write:
        doors = {(m, n, k): whole for m, n, k, _, whole, depth in ours if depth == 0}
        LIST.write_text(kernel_lines(doors))
        print(f"{LIST.name}: {len(doors)} kernels")


if __name__ == "__main__":
    main()
