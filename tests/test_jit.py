"""The small compiled pieces say what numpy says."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanmotion.core.support.threads import by_pieces
from scanmotion.geometry.jit import copy_into, first_not_less, sort_in_place, turn_round
from scanmotion.sensing.fusion.moving_least_squares import _by_rotations

ROOT = Path(__file__).resolve().parents[1] / "scanmotion"


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(-50, 50), max_size=120), st.integers(0, 120))
def test_sorting_is_numpys(values, n):
    row = np.array(values, dtype=np.int64)
    n = min(n, len(row))
    expected = np.concatenate([np.sort(row[:n]), row[n:]])
    sort_in_place(row, n)
    assert (row == expected).all()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(-50, 50), max_size=60), st.integers(-60, 60))
def test_searching_is_numpys(values, value):
    row = np.sort(np.array(values, dtype=np.int64))
    assert first_not_less(row, value) == np.searchsorted(row, value, side="left")


@pytest.mark.parametrize(("i", "j"), [(0, 6), (2, 5), (3, 3), (4, 3)])
def test_a_stretch_is_turned_round(i, j):
    row = np.arange(7)
    turn_round(row, i, j)
    expected = np.arange(7)
    expected[i : j + 1] = expected[i : j + 1][::-1]
    assert (row == expected).all()


def test_copies_fill_the_front():
    to = np.arange(5)
    copy_into(to, np.array([9, 8, 7]))
    assert to.tolist() == [9, 8, 7, 3, 4]


@pytest.mark.parametrize(
    "values", [(1.0, 1.0, 3.0), (1.0, 2.0, 3.0), (1.0, 1.0 + 1e-9, 5.0), (0.0, 1.0, 1.0)]
)
def test_rotations_find_the_least_direction(values):
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    A = (Q * np.array(values)) @ Q.T
    A = (A + A.T) / 2
    n = np.empty(3)
    _by_rotations(A, n)
    assert abs(np.linalg.norm(n) - 1.0) < 1e-12
    assert n @ A @ n - np.linalg.eigvalsh(A)[0] < 1e-14


@pytest.mark.parametrize("threads", ["1", "2", "5"])
@pytest.mark.parametrize("count", [0, 1, 15, 1000])
def test_pieces_are_whole_and_in_order(monkeypatch, threads, count):
    monkeypatch.setenv("OMP_NUM_THREADS", threads)
    found = by_pieces(lambda a, b: list(range(a, b)), count, least=10)
    assert [n for piece in found for n in piece] == list(range(count))
    assert len(found) == max(1, min(16, count // 10))


def test_kernels_come_from_one_home_and_run_on_one_thread():
    for path in ROOT.rglob("*.py"):
        text = path.read_text()
        if path.name != "jit.py":
            assert not re.search(r"^from numba import|^\s+from numba import njit", text, re.M), path
        assert "parallel=True" not in text, path
