"""The same bytes whatever the load, the number of threads, and the layout of memory."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scanmotion.geometry.column_products import column_products

SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "same_under_load.py"
CODE = """
import hashlib
import numpy as np
from scanmotion.geometry.column_products import column_products
rng = np.random.default_rng(0)
J, w = rng.standard_normal((100_000, 12)), rng.random(100_000)
both = column_products(J, w[:, None] * J).tobytes() + column_products(J, w).tobytes()
print(hashlib.sha256(both).hexdigest())
"""


def test_column_products_are_the_products(rng):
    A, B = rng.standard_normal((500, 4)), rng.standard_normal((500, 3))
    np.testing.assert_allclose(column_products(A, B), A.T @ B, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(column_products(A, B[:, 0]), A.T @ B[:, 0], rtol=1e-12, atol=1e-12)


def test_sums_over_many_points_do_not_depend_on_threads():
    """Of the same product by `@` OpenBLAS gives other last digits with one thread than with two."""
    told = {
        subprocess.run(
            [sys.executable, "-c", CODE],
            env={**os.environ, "OPENBLAS_NUM_THREADS": str(n), "MALLOC_PERTURB_": str(50 + n)},
            capture_output=True, text=True, check=True,
        ).stdout
        for n in (1, 2, 4)
    }  # fmt: skip
    assert len(told) == 1 and len(next(iter(told)).strip()) == 64


@pytest.mark.slow
@pytest.mark.parametrize("job", ["stages", "plans"])
def test_load_and_threads_change_no_byte(job):
    lines = runpy.run_path(str(SCRIPT))["lines_under_load"]
    found = lines([1, 2, 4], 3, job)
    assert [count for count, _ in found] == [1, 2, 4]
    assert len({line for _, line in found}) == 1 and "cloud" in found[0][1]
