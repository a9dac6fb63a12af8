"""The same bytes from scan to local viewpoints whatever the load and the number of threads."""

import runpy
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "same_under_load.py"


@pytest.mark.slow
def test_load_and_threads_change_no_byte():
    lines = runpy.run_path(str(SCRIPT))["lines_under_load"]
    found = lines([1, 2, 4], 3)
    assert [count for count, _ in found] == [1, 2, 4]
    assert len({line for _, line in found}) == 1 and "cloud" in found[0][1]
