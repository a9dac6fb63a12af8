"""Which pairs are left out, by each of the three lists; tables of near pairs; what is surely blocked."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fcl_check import FclCell
from test_last_word import moved
from test_side_branches import PLAIN, cell_of, with_side

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision import pairs
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.collision.last_word import DrakeJudge
from scanmotion.cell.collision.near_tables import way_to_blocked
from scanmotion.cell.collision.pairs import Exempt, exempt_pairs
from scanmotion.cell.drake_scene import drake_of
from scanmotion.cell.model import TOOL
from scanmotion.cell.settings.cell import load_cell
from scanmotion.geometry.parts.make_part import box_part

PART = box_part(0.33, 0.2, 0.6)


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), PART)


def drawn(cell, count, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(cell.q_min[:6], cell.q_max[:6], (count, 6)), np.zeros(count)])


def meets_itself(cell, links, count=4000):
    """A configuration in which solids of two links touch and nothing else comes near, by FCL."""
    second = FclCell(cell)
    for q in drawn(cell, count, seed=3):
        frames = second.frames(q)[0]
        for body, shape in zip(cell.bodies, second.shapes, strict=True):
            if body.link <= TOOL:
                X = frames[body.link] @ body.X_LG
                shape.setTransform(second_transform(X))
        hit = any(
            touches(x, y)
            for a, x in zip(cell.bodies, second.shapes, strict=True)
            for b, y in zip(cell.bodies, second.shapes, strict=True)
            if (a.link, b.link) == links
        )
        if hit and second.distances(q)[0] > 0.05:
            return q
    raise AssertionError("no such configuration")


def second_transform(X):
    import fcl

    return fcl.Transform(np.ascontiguousarray(X[:3, :3]), np.ascontiguousarray(X[:3, 3]))


def touches(a, b):
    import fcl

    return bool(fcl.collide(a, b, fcl.CollisionRequest(), fcl.CollisionResult()))


def test_only_what_is_joined_is_left_out_of_the_kr240(cell):
    """Base and link 2, link 4 and link 6, link 5 and the tool are free in some positions: all are held."""
    assert not [pair for pair in exempt_pairs(cell) if pair.meets]
    told = {frozenset((pair.a, pair.b)): pair.reason for pair in DrakeJudge(cell).not_held}
    chain = ["base_link", *(f"link_{i}" for i in range(1, 7))]
    joined = {frozenset(both): f"joined by A{n + 1}" for n, both in enumerate(pairwise(chain))}
    fixed = {frozenset(("link_6", "tool")): "fixed to one another"}
    robot = {*chain, "tool"}
    assert {k: v for k, v in told.items() if k <= robot} == joined | fixed
    assert all(told.values())


@pytest.mark.parametrize("links", [(0, 2), (4, 6)])
def test_neighbours_but_one_are_held_apart_by_all_three(cell, links):
    q = meets_itself(cell, links)[None]
    checker = Clearance(cell)
    assert not checker.fast_free(q)[0] and not checker.exactly_free(q)[0] and not drake_of(cell).free(q)[0]
    found = DrakeJudge(cell).judge(moved(np.repeat(q, 2, axis=0))).findings
    names = [b.carrier for b in cell.bodies if b.link == links[1]]
    assert any(f.code == "collision" and names[0] in f.where for f in found)


def test_drake_asks_nothing_of_the_planners_list(cell, monkeypatch):
    """A planner that leaves out every pair of the robot's is contradicted by the last word."""
    bodies = [b for b in cell.bodies if b.link <= TOOL]
    everything = tuple(
        Exempt(a=a, b=b, reason="blind", meets=True) for n, a in enumerate(bodies) for b in bodies[:n]
    )
    q = np.repeat(meets_itself(cell, (4, 6))[None], 2, axis=0)
    monkeypatch.setattr("scanmotion.cell.drake_scene.exempt_pairs", lambda _: everything)
    monkeypatch.setattr(pairs, "exempt_pairs", lambda _: everything)
    other = replace(cell)
    assert drake_of(other).free(q)[0]
    assert DrakeJudge(other).judge(moved(q)).findings


def test_what_always_meets_is_left_out_by_planner_and_drake_and_named(tmp_path):
    """A collar on link 5 that stands in the tool's plate at every angle of A6."""
    collar = cell_of(with_side("collar", "link_5", "0.24 0 0", "0.12 0.02 0.02"), tmp_path)
    left_out = {(e.a.name, e.b.name) for e in exempt_pairs(collar) if e.meets}
    assert any("collar" in pair for pair in left_out)
    drakes = [pair for pair in DrakeJudge(collar).not_held if pair.ids]
    # Drake asks a millimetre of what two joints guide, the planner more of what hangs on a branch.
    assert drakes and {frozenset((p.a, p.b)) for p in drakes} <= {frozenset(pair) for pair in left_out}
    assert DrakeJudge(collar).judge(moved(np.repeat(collar.home[None], 2, axis=0))).findings == ()
    assert all("100% of 200 random configurations" in p.reason for p in drakes)
    assert Clearance(collar).free(collar.home[None])[0]


@pytest.mark.parametrize("name", ["kr240", "ur10e"])
def test_a_free_cell_of_a_table_keeps_the_clearance(name):
    """Random configurations: where no table speaks against it, FCL finds the links apart; and it speaks."""
    cell = build_cell(load_cell(name))
    f = Clearance(cell).filter
    tables, joints = f.boxes[5], f.boxes[6]
    assert len(tables)
    second, near = FclCell(cell), {(0, 2), (4, 6), (5, TOOL)}
    asked, spoken = 1e-3, 0
    q = drawn(cell, 600, seed=1)
    # Half of them are at the edge of what is blocked, where a gap would show.
    ways = np.array([way_to_blocked(row, tables, joints, 1.0) for row in q])
    for row, way in zip(q, ways, strict=True):
        frames = second.frames(row)[0]
        robot = [(b, s) for b, s in zip(cell.bodies, second.shapes, strict=True) if b.link <= TOOL]
        for body, shape in robot:
            shape.setTransform(second_transform(frames[body.link] @ body.X_LG))
        least = min(distance(x, y) for a, x in robot for b, y in robot if (a.link, b.link) in near)
        spoken += way < 0
        assert way < 0 or least >= asked - 1e-9
    assert 0 < spoken < 400


def distance(a, b):
    import fcl

    return -1.0 if touches(a, b) else fcl.distance(a, b, fcl.DistanceRequest(), fcl.DistanceResult())


@pytest.mark.parametrize("ball", [False, True])
def test_what_is_surely_blocked_is_blocked(cell, ball, tmp_path):
    """Against FCL on all solids and the part: Drake's tier alone does not know the part."""
    own = cell
    if ball:
        text = PLAIN.replace(
            "</robot>",
            '<link name="ball"><collision name="ball"><geometry><sphere radius="0.2"/></geometry></collision>'
            '</link><joint name="jb" type="fixed"><parent link="link_3"/><child link="ball"/>'
            '<origin xyz="0.5 0 0.45"/></joint></robot>',
        )
        own = cell_of(text, tmp_path, PART)
        assert next(b for b in own.bodies if b.name == "ball").shape == "sphere"
    checker, second = Clearance(own), FclCell(own)
    q = drawn(own, 1500, seed=5)
    sure = np.flatnonzero(checker.surely_blocked(q))
    assert len(sure) > 50
    process = own.settings.process
    for row in q[sure]:
        outside, inside = second.distances(row)
        # What hangs on a link by a side branch is held against its neighbours too.
        robot = [(b, s) for b, s in zip(own.bodies, second.shapes, strict=True) if b.link <= TOOL]
        balls = [s for b, s in robot if b.name == "ball"]
        others = [s for b, s in robot if b.name != "ball" and b.link != 3]
        inside = min([inside, *(distance(a, b) for a in balls for b in others)])
        assert outside < process.clearance_m or inside < process.self_clearance_m
