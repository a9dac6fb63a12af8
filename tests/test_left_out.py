"""Each pair that the judge does not look at is named with its reason, and no other."""

import json
from itertools import combinations

import pytest
from test_robot_files import PLAIN, cell_of
from typer.testing import CliRunner

from scanmotion.cli import app
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge.left_out import not_judged
from scanmotion.judge.motion import arm_of
from scanmotion.judge.solids import meeting_solids, pairs_of, solids_of
from scanmotion.plan_io.read import read_plan
from scanmotion.planning.pipeline import PlanOptions, plan


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A plan with a lamp on the base and a collar that always meets its neighbours."""
    place = tmp_path_factory.mktemp("left_out")
    text = PLAIN
    for name, parent, xyz, size in (
        ("lamp", "base_link", "-0.5 0.9 1.0", "0.1 0.1 0.1"),
        ("collar", "link_5", "0.12 0 0", "0.3 0.02 0.02"),
    ):
        text = text.replace(
            "</robot>",
            f'<link name="{name}"><collision><origin xyz="{xyz}"/><geometry><box size="{size}"/>'
            f'</geometry></collision></link><joint name="j_{name}" type="fixed"><parent link="{parent}"/>'
            f'<child link="{name}"/></joint></robot>',
        )
    part = box_part(0.2, 0.16, 0.15)
    plan(part, cell_of(text, place, part).settings, options=PlanOptions(source="box")).save(place / "plan")
    return place / "plan"


def test_every_pair_is_judged_or_named(folder):
    record = read_plan(folder)
    arm = arm_of(folder, record)
    solids = solids_of(folder, record, arm)
    judged = pairs_of(solids, 0.03, arm.joined, meeting_solids(solids, record, arm))
    judged = {frozenset((id(a), id(b))) for a, b, _ in judged}

    def name(solid):
        return "tool" if solid.group == 7 else f"link {solid.carrier}" if solid.carrier else solid.name

    named = {frozenset((pair["a"], pair["b"])): pair["reason"] for pair in not_judged(folder)}
    for a, b in combinations(solids, 2):
        left_out = frozenset((id(a), id(b))) not in judged
        single = frozenset((f"{name(a)}: {a.name}", f"{name(b)}: {b.name}"))
        told = frozenset((name(a), name(b))) in named or single in named
        assert left_out == (name(a) == name(b) or told), (a.name, b.name)
    assert named[frozenset(("link link_2", "link link_3"))] == "joined by A3"
    assert named[frozenset(("link link_6", "tool"))] == "fixed to one another"
    assert named[frozenset(("link collar", "link link_6"))].startswith("they meet in 100% of the positions")
    assert not any("link lamp" in pair and "tool" in pair for pair in named)
    assert named[frozenset(("part", "table"))] == "the part stands on it"
    assert named[frozenset(("link base_link", "floor"))] == "neither moves"
    assert all(named.values())


def test_verify_names_them(folder):
    done = CliRunner().invoke(app, ["verify", str(folder), "--json"])
    assert json.loads(done.output)["not_judged"] == not_judged(folder)
