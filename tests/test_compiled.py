"""Kernels compiled ahead: the list holds, what is stale goes, and nothing is left for the first plan."""

import importlib
import json
import os
import subprocess
import sys

import pytest

from scanmotion.geometry import compiled
from scanmotion.geometry.compiled import arguments_from, compile_kernels, kernel_lines, listed_kernels

LISTENER = """
import json, os, runpy, sys
from numba.core import event
names = []
class Listener(event.Listener):
    def on_start(self, e):
        names.append(e.data["dispatcher"].py_func.__module__)
    def on_end(self, e):
        pass
event.register("numba:compile", Listener())
try:
    runpy.run_module("scanmotion", run_name="__main__", alter_sys=True)
finally:
    print(json.dumps([n for n in names if n.startswith("scanmotion.")]))
"""


def test_every_listed_kernel_is_there_and_takes_so_many_arguments():
    rows = listed_kernels()
    assert len({row[:3] for row in rows}) == len(rows) > 30
    for module, name, kinds, weight in rows:
        kernel = getattr(importlib.import_module(module), name)
        assert len(arguments_from(kinds)) == kernel.py_func.__code__.co_argcount, (module, name)
        assert weight >= 0.0


def test_the_list_is_read_as_it_is_written(tmp_path, monkeypatch):
    took = {
        ("a.b", "f", "(int64, float64)"): 0.25,
        ("a.b", "g", "(Array(float64, 2, 'C', False, aligned=True),)"): 1.5,
    }
    monkeypatch.setattr(compiled, "LIST", tmp_path / "kernels.txt")
    compiled.LIST.write_text(kernel_lines(took))
    assert {row[:3]: row[3] for row in listed_kernels()} == took


@pytest.mark.parametrize(
    "kinds",
    [
        "(int64, float64, bool)",
        "(Array(float64, 2, 'C', False, aligned=True), Array(uint64, 1, 'A', True, aligned=True))",
        "(Tuple((Array(float64, 3, 'C', False, aligned=True), UniTuple(int64, 2), float64)),)",
    ],
)
def test_kinds_are_told_as_numba_tells_them(kinds):
    assert str(arguments_from(kinds)) == kinds


@pytest.fixture
def house(tmp_path, monkeypatch):
    """Three modules with kernels, of which a calls b, and c neither."""
    root = tmp_path / "scanmotion"
    (root / "room").mkdir(parents=True)
    head = "from numba import njit\n@njit(cache=True)\n"
    (root / "room/a.py").write_text(
        "from scanmotion.room.b import g\n" + head + "def f(x):\n    return g(x)\n"
    )
    (root / "room/b.py").write_text(head + "def g(x):\n    return x\n")
    (root / "room/c.py").write_text(head + "def h(x):\n    return x\n")
    monkeypatch.setattr(compiled, "_ROOT", root)
    return root / "room"


def test_what_a_kernel_calls_from_another_file_counts(house):
    before = compiled._fingerprints()
    assert set(before) == {"scanmotion.room.a", "scanmotion.room.b", "scanmotion.room.c"}
    (house / "b.py").write_text((house / "b.py").read_text().replace("return x", "return x + 1"))
    after = compiled._fingerprints()
    assert {m for m in before if before[m] != after[m]} == {"scanmotion.room.a", "scanmotion.room.b"}


def test_only_the_modules_own_are_forgotten(house):
    folder = house / "__pycache__"
    folder.mkdir()
    for name in ("a.f-3.py311.nbi", "a.f-3.py311.1.nbc", "b.g-3.py311.nbi", "a.cpython-311.pyc"):
        (folder / name).write_text("")
    compiled._forget("scanmotion.room.a")
    assert sorted(p.name for p in folder.iterdir()) == ["a.cpython-311.pyc", "b.g-3.py311.nbi"]


def test_work_is_shared_by_weight_and_modules_stay_whole():
    rows = [(f"m{k // 2}", f"f{k}", "(int64,)", float(1 + k)) for k in range(10)]
    shares = compiled._shares(rows, 3)
    assert sorted(m for share in shares for m in share) == [f"m{k}" for k in range(5)]
    load = [sum(row[3] for row in rows if row[0] in share) for share in shares]
    assert max(load) == 19.0


def test_what_is_compiled_is_not_compiled_again(tmp_path, monkeypatch):
    stamp = tmp_path / "stamp"
    monkeypatch.setattr(compiled, "_stamp", lambda: stamp)
    monkeypatch.setattr(compiled, "_looked_at", set())
    monkeypatch.setattr(compiled.subprocess, "Popen", None)
    monkeypatch.delenv("SCANMOTION_COMPILE_AHEAD", raising=False)
    stamp.write_text(json.dumps(compiled._fingerprints()))
    assert not compile_kernels()
    stamp.write_text("no json")
    monkeypatch.setenv("SCANMOTION_COMPILE_AHEAD", "0")
    assert not compile_kernels()


@pytest.mark.slow
def test_after_compiling_ahead_a_first_plan_compiles_nothing(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    words = ["plan", "--quiet", "--no-html", "--out", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-c", LISTENER, *words], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 1), done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == []
