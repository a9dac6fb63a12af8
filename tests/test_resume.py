"""A scan that is broken off and taken up again sees the same surface: the twin looks from every frame."""

import numpy as np
import pytest

from scanmotion.cell.kinematics import scanner_in_object
from scanmotion.controller.log import executed_text, log_text, read_executed, read_log
from scanmotion.controller.simulate import Circumstances, run_programme
from scanmotion.export import export_files
from scanmotion.export.source import write_files
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.judge import verify
from scanmotion.plan_io.read import read_plan
from scanmotion.plan_io.resume import rest_files
from scanmotion.sensing.visibility import scene_from, sees


@pytest.fixture(scope="module")
def made(pitted_plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "plan"
    pitted_plan.save(folder)
    export_files(folder, "krl-timed")
    return folder


def executed(folder, how=None):
    """Runs the folder's programme and leaves the log there, as the command does; what was executed."""
    found = run_programme(folder / "scan.src", folder, how or Circumstances(), dynamics=False)
    write_files(
        folder, {"run.csv": log_text(found.log), "executed.json": executed_text(found.executed)}
    )  # fmt: skip
    return read_executed(folder)


@pytest.fixture(scope="module")
def looked(pitted_plan):
    """Which samples of the surface the frames of the folder's last run see."""
    cell, part = pitted_plan.cell, pitted_plan.part
    samples = surface_samples(part, 3000, rng=np.random.default_rng(2))
    scene = scene_from(part.vertices, part.triangles)

    def seen(folder):
        log = read_log(folder)
        X = scanner_in_object(cell, np.deg2rad(log.q[log.frame > 0]))
        return sees(scene, cell.settings.scanner_model(), X, samples.points, samples.normals).any(axis=0)

    return seen


@pytest.fixture(scope="module")
def whole(made, looked):
    assert executed(made).ended
    seen = looked(made)
    assert 0.8 < seen.mean() <= 1
    return seen


@pytest.mark.parametrize("place", ["power lost in a turn", "scanner fault", "stop on the way"])
def test_the_rest_completes_the_coverage(place, made, whole, looked, tmp_path):
    operations = read_plan(made).operations
    if place == "scanner fault":
        how = Circumstances(faults=(2,), patience=0)
    else:
        kind = "revolution" if place.startswith("power") else "transit"
        o = [o for o in operations if o.kind == kind][1]
        how = Circumstances(stop_at=(o.t_start + o.t_end) / 2)
    done = executed(made, how)
    assert not done.ended and 0 < done.completed < len(operations)
    before = looked(made)
    rest = tmp_path / "rest"
    write_files(rest, rest_files(made, done.completed + 1, np.deg2rad(done.q_deg)))
    assert verify(rest) == []
    export_files(rest, "krl-timed")
    assert executed(rest).ended
    both = before | looked(rest)
    assert before.mean() < whole.mean() - 0.01
    # Frames of the second run are taken at other instants of the same motion.
    assert abs(both.mean() - whole.mean()) < 0.002 and (whole & ~both).mean() < 0.002
