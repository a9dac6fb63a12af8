"""What a study costs beside its cases: overhead and bytes per case, and what a second worker gains.

The cases are viewpoint counts, which cost next to nothing; the peer is the same loop in one process.
"""

import pickle
import tempfile
import time
from pathlib import Path

from scanmotion.studies.case import row_of
from scanmotion.studies.run import StudyOptions, study
from scanmotion.studies.settings import study_from

CASES = 1000


def main() -> None:
    told = {
        "kind": "viewpoints",
        "parts": [{"box_mm": [330, 200, 600]}],
        "seeds": list(range(CASES)),
    }
    made = study_from(told, folder=Path.cwd())
    part = next(iter(made.parts.values()))
    start = time.perf_counter()
    rows = [row_of(case, part) for case in made.cases]
    alone = (time.perf_counter() - start) / CASES
    print(f"bytes of a case {len(pickle.dumps(made.cases[0]))}, of its row {len(pickle.dumps(rows[0]))}")
    print(f"one process, no table: {alone * 1e3:.2f} ms a case")
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            first = {**told, "seeds": [10**6]}
            options = StudyOptions(table=Path(folder) / "t.sqlite", workers=workers)
            start = time.perf_counter()
            study(first, options=options)
            setup = time.perf_counter() - start
            start = time.perf_counter()
            study(told, options=options)
            each = (time.perf_counter() - start - setup) / CASES
            more = (each - alone) * 1e3
            print(f"{workers} workers: start {setup:.1f} s, {each * 1e3:.2f} ms a case, overhead {more:.2f}")


if __name__ == "__main__":
    main()
