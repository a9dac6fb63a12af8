"""How many threads are allowed is asked at one place, and changes no byte of a plan."""

import hashlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from scanmotion.core.errors import InputError
from scanmotion.core.support.threads import OPENMP, allow_threads, allowed_threads

ROOT = Path(__file__).resolve().parents[1] / "scanmotion"


@pytest.mark.parametrize(("told", "count"), [("3", 3), ("1", 1), ("2,4", 2)])
def test_openmp_says_how_many(monkeypatch, told, count):
    monkeypatch.setenv(OPENMP, told)
    assert allowed_threads() == count


@pytest.mark.parametrize("told", [None, "", "0", "-2", "many"])
def test_without_a_number_it_is_every_core_that_the_system_allows(monkeypatch, told):
    monkeypatch.delenv(OPENMP, raising=False)
    if told is not None:
        monkeypatch.setenv(OPENMP, told)
    assert allowed_threads() == len(os.sched_getaffinity(0))


def test_no_thread_at_all_is_refused():
    with pytest.raises(InputError, match="at least 1"):
        allow_threads(0)


def test_what_works_on_threads_asks_for_their_number():
    casts = re.compile(
        r"\.(cast_rays|test_occlusions|compute_\w*distance|compute_closest_points)\(|RaycastingScene\("
    )
    for path in ROOT.rglob("*.py"):
        text = path.read_text()
        assert not re.search(r"\bworkers=-1", text), path
        calls = len(casts.findall(text))
        assert text.count("nthreads=allowed_threads()") == calls, path


@pytest.mark.parametrize("how", ["option", "variable"])
def test_numba_has_the_same_number(how):
    code = (
        "from scanmotion.core.support.threads import allow_threads; allow_threads(1)"
        if how == "option"
        else ""
    )
    code += "\nimport scanmotion\nfrom numba import config\nprint(config.NUMBA_NUM_THREADS)"
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    environment |= {OPENMP: "1"} if how == "variable" else {}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.strip() == "1"


@pytest.mark.parametrize("count", [1, 4])
def test_a_plan_is_the_same_with_any_number_of_threads(monkeypatch, pitted_plan, count):
    from test_plan import TINY, pitted

    from scanmotion.cell.settings.cell import load_cell
    from scanmotion.planning.pipeline import PlanOptions, plan

    monkeypatch.setenv(OPENMP, str(count))
    made = plan(pitted(), load_cell("kr240"), options=PlanOptions(seed=5, **TINY))
    for name in ("t", "q"):
        assert getattr(made.trajectory, name).tobytes() == getattr(pitted_plan.trajectory, name).tobytes()
    for name in ("points", "normals", "counts"):
        assert getattr(made.cloud, name).tobytes() == getattr(pitted_plan.cloud, name).tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("subject", [["--box", "330", "200", "600"], ["--mode", "paper"]])
def test_threads_change_no_byte(tmp_path, subject):
    told = set()
    for count in (1, 2, 4):
        out = tmp_path / str(count)
        words = ["plan", *subject, "--no-html", "--quiet", "--threads", str(count), "--out", str(out)]
        done = subprocess.run([sys.executable, "-m", "scanmotion", *words], check=False)
        assert done.returncode in (0, 1)
        told.add(
            hashlib.sha256(
                (out / "plan.json").read_bytes() + (out / "trajectory.csv").read_bytes()
            ).hexdigest()
        )
    assert len(told) == 1
