"""Re-planning: executed operations stay sample by sample, the rest is planned from there; all is judged."""

import json
from functools import cache

import numpy as np
import pytest
from judging import summarised
from test_plan import TINY
from typer.testing import CliRunner

from scanmotion.cli.app import app
from scanmotion.core.errors import InputError, PlanFileError
from scanmotion.judge import verify
from scanmotion.plan_io.load import load_plan
from scanmotion.plan_io.read import read_json, read_plan, read_trajectory
from scanmotion.planning.pipeline import PlanOptions
from scanmotion.planning.replan import FAILED, last_operation, replan

OPTIONS = PlanOptions(**TINY)


@pytest.fixture(scope="module")
def old(pitted_plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("old") / "plan"
    pitted_plan.save(folder)
    return folder


@pytest.fixture(scope="module")
def again(old):
    """Planned again from an interruption, once for all who ask."""
    return cache(lambda done: replan(load_plan(old), done=done, options=OPTIONS))


@pytest.fixture(scope="module")
def order(old):
    """Viewpoints in the order in which they are served."""
    return [v for o in read_plan(old).operations if o.kind != "transit" for v in o.viewpoints]


def served(folder):
    return [v for o in read_plan(folder).operations if o.kind != "transit" for v in o.viewpoints]


def check_kept(old, new, count):
    """The first operations and all of their samples are those of the old plan; later ones follow on."""
    before, after = read_plan(old), read_plan(new)
    assert before.operations[:count] == after.operations[:count]
    a = (old / "trajectory.csv").read_text().splitlines()
    b = (new / "trajectory.csv").read_text().splitlines()
    kept = sum(1 for line in a[1:] if int(line.split(",")[8]) < count)
    assert a[: kept + 1] == b[: kept + 1]
    if count:
        assert abs(read_trajectory(new, after).t[kept - 1] - before.operations[count - 1].t_end) < 1e-6


@pytest.mark.parametrize("place", [0, 1, -1])
def test_what_is_done_stays_and_the_rest_is_planned(old, again, order, tmp_path, place):
    done = order[place]
    made = again(done)
    assert made.save(tmp_path / "new") == [] == verify(tmp_path / "new")
    assert made.trajectory is not None
    count = last_operation(made.trajectory.operations, done) + 1
    check_kept(old, tmp_path / "new", count)
    new = served(tmp_path / "new")
    assert sorted(new) == sorted(order) and new[: order.index(done) + 1] == order[: order.index(done) + 1]
    assert made.viewpoints and {v.id for v in made.viewpoints} == {v.id for v in load_plan(old).viewpoints}


def test_the_whole_surface_is_counted_as_before(old, again, order):
    made = again(order[1])
    before, after = read_json(old, "summary.json"), summarised(made).summary.document()
    # The surface samples are the same, and so is what revolutions see from the same places.
    assert after["completeness"]["after_global"] == pytest.approx(
        before["completeness"]["after_global"], abs=2e-3
    )
    assert after["completeness"]["final"] == pytest.approx(before["completeness"]["final"], abs=5e-3)
    assert after["time_s"]["floor"] <= after["time_s"]["total"]
    # Which solver served what was executed is remembered; the rest is served anew, maybe by another.
    done = set(order[:2])
    now, then = (d["viewpoints"].pop("solvers") for d in (after, before))
    assert {v: s for v, s in now.items() if v in done} == {v: s for v, s in then.items() if v in done}
    assert set(now) == set(then) and all(now.values())
    assert after["viewpoints"] == before["viewpoints"]


def test_a_failed_viewpoint_is_left_out_with_its_reason(old, order, tmp_path):
    failed = order[-1]
    made = replan(load_plan(old), done=order[-2], failed=[failed], options=OPTIONS)
    assert made.save(tmp_path / "new") == []
    assert served(tmp_path / "new") == order[:-1]
    assert dict(made.unreachable)[failed] == FAILED
    assert failed in {v.id for v in made.viewpoints}
    record, before = read_plan(tmp_path / "new"), load_plan(old).trajectory
    end = last_operation(before.operations, order[-2])
    # Behind what is done there is the way home, and nothing else.
    assert [o.viewpoints for o in record.operations[end + 1 :]] in ([()], [])
    assert made.trajectory.duration == pytest.approx(before.operations[end].t_end)
    written = read_trajectory(tmp_path / "new", record)
    assert written.duration == pytest.approx(record.operations[-1].t_end)
    assert np.allclose(written.q[-1], made.cell.home, atol=1e-9) or made.no_way_home


def test_an_operation_may_be_named_by_its_number(old, order, tmp_path):
    made = replan(load_plan(old), done="0", options=OPTIONS)
    assert made.save(tmp_path / "new") == []
    check_kept(old, tmp_path / "new", 1)
    assert sorted(served(tmp_path / "new")) == sorted(order)


def test_nothing_done_is_a_plan_from_home(old, order, tmp_path):
    made = replan(load_plan(old), failed=order[-1:], options=OPTIONS)
    assert made.save(tmp_path / "new") == [] and made.trajectory is not None
    assert np.allclose(made.trajectory.q[0], made.cell.home)
    assert sorted(served(tmp_path / "new")) == sorted(order[:-1])


def test_the_same_interruption_gives_the_same_plan(old, again, order):
    first, second = again(order[1]), replan(load_plan(old), done=order[1], options=OPTIONS)
    assert first.trajectory is not None and second.trajectory is not None
    assert np.array_equal(first.trajectory.q, second.trajectory.q)


def test_it_can_be_interrupted_twice_into_the_same_folder(again, order, tmp_path):
    folder = tmp_path / "again"
    again(order[0]).save(folder)
    then = served(folder)
    assert replan(load_plan(folder), done=then[1], options=OPTIONS).save(folder) == []
    assert served(folder)[:2] == then[:2] and sorted(served(folder)) == sorted(order)


def test_wrong_names_are_refused(old, order, tmp_path):
    with pytest.raises(InputError, match="--done nowhere.*serve " + order[0]):
        replan(load_plan(old), done="nowhere")
    with pytest.raises(InputError, match="--done 999"):
        replan(load_plan(old), done="999")
    with pytest.raises(InputError, match="--failed nowhere: not one of"):
        replan(load_plan(old), failed=["nowhere"])
    with pytest.raises(InputError, match=f"--failed {order[0]}: operation .* is done"):
        replan(load_plan(old), done=order[1], failed=[order[0]])
    with pytest.raises(PlanFileError):
        replan(load_plan(tmp_path / "nothing"))
    with pytest.raises(InputError, match="no viewpoint is left"):
        replan(load_plan(old), failed=order)


def test_from_the_command_line(old, order, tmp_path):
    def run(*args):
        return CliRunner().invoke(app, ["plan", *map(str, args), "--no-html"])

    out = tmp_path / "out"
    result = run("--keep", old, "--done", order[-1], "--budget", 400, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["budget"]["limit_s"] == 400.0
    assert served(out) == order and read_plan(out).process.budget_s == 400.0
    for wrong in (["--done", order[0]], ["--failed", order[0]], ["--keep", old, "--box", 100, 100, 100]):
        result = run(*wrong, "--out", tmp_path / "wrong")
        assert result.exit_code != 0 and "--" in result.output
        assert not (tmp_path / "wrong").exists()
