"""The search from round to round: what it promises, keeps in hand, and does not try again."""

from types import SimpleNamespace

import numpy as np
import pytest
from judging import findings_of

import scanmotion.planning.evidence as module
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cell.view_costs import view_costs
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.table import TableGeometry
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.planning.evidence import Surroundings, next_views, no_evidence
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.sensing.fusion.fuse import Cloud

AROUND = Surroundings(table=TableGeometry(radius=0.76), costs=view_costs(load_cell("kr240")))
RATE, AREA = 2e-5, 0.5


def cloud(points):
    points = np.asarray(points, float)
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return Cloud(points=points, normals=up, view_directions=up, counts=np.ones(len(points), np.int64))


@pytest.fixture
def rounds(monkeypatch):
    """Calls of local_step, each of which promises to see ten points in a row of their own."""
    calls = []
    view = Viewpoint(
        id="L1", X_OS=look_at([0.5, 0, 0.2], [-1, 0, 0]), standoff=0.5, step="local", kind="station",
        slack=Slack(),
    )  # fmt: skip

    def step(points, normals, holes, scanner, **given):
        calls.append(given)
        row = np.column_stack([np.arange(10) * 0.01, np.full(10, float(len(calls))), np.zeros(10)])
        return SimpleNamespace(
            viewpoints=(view,), gains=(3e-4,), claimed=row, model=SimpleNamespace(area=AREA), unseen=()
        )

    monkeypatch.setattr(module, "local_step", step)
    nothing = no_evidence(Scanner(), AROUND, spacing=0.002, stride=4)

    def ask(evidence, points):
        found = next_views(
            evidence, cloud(points), (), rate=RATE, seconds=60.0, reachable=None, explain=False,
            rng=np.random.default_rng(0),
        )  # fmt: skip
        return found.evidence, calls[-1], found.worth

    # One frame that looks at nothing.
    return nothing.with_frames(np.eye(4)[None], np.zeros((1, 2, 2))), nothing, ask, calls


def promised(calls, share):
    """The first points of the row that the last call promised."""
    row = np.column_stack([np.arange(10) * 0.01, np.full(10, float(len(calls))), np.zeros(10)])
    return row[: round(10 * share)]


FAR = [[5.0, 5.0, 5.0]]


def test_a_round_that_keeps_its_promises_is_followed_by_one_like_it(rounds):
    evidence, _, ask, calls = rounds
    evidence, first, worth = ask(evidence, FAR)
    assert first["claimed"] is None and first["options"].wary == pytest.approx(np.deg2rad(8))
    assert first["options"].least_rate == RATE
    assert worth == {"L1": pytest.approx(3e-4 / (RATE * AREA))}
    for share in (1.0, 0.8, 0.5):
        evidence, given, worth = ask(evidence, np.concatenate([FAR, promised(calls, share)]))
        # What was not kept of the last promises is taken off the next ones; claimed places stay claimed.
        assert given["options"].least_rate == pytest.approx(RATE / share)
        assert given["options"].wary == pytest.approx(np.deg2rad(8))
        assert len(given["claimed"]) == 10 * (len(calls) - 1)


def test_a_round_in_vain_is_followed_by_warier_ones_that_may_try_the_same_places(rounds):
    evidence, _, ask, calls = rounds
    evidence, _, _ = ask(evidence, FAR)
    for wary in (20, 32):
        evidence, given, _ = ask(evidence, np.concatenate([FAR, promised(calls, 0.4)]))
        assert given["options"].wary == pytest.approx(np.deg2rad(wary)) and given["claimed"] is None
        assert given["options"].least_rate == pytest.approx(2 * RATE)
    # That was the last time: now little is hoped for.
    _, given, _ = ask(evidence, FAR)
    assert given["options"].wary == pytest.approx(np.deg2rad(32)) and len(given["claimed"]) == 10
    assert given["options"].least_rate == pytest.approx(RATE / 0.05)


def test_a_scan_without_frames_is_taken_warily(rounds):
    _, nothing, ask, _ = rounds
    _, given, _ = ask(nothing, FAR)
    assert given["options"].wary == pytest.approx(np.deg2rad(15)) and given["space"] is None


def test_evidence_is_a_value(rounds):
    """The same evidence gives the same round however often it is asked, and grows into others."""
    evidence, nothing, ask, _ = rounds
    first, _, _ = ask(evidence, FAR)
    assert (evidence.claimed, evidence.model, nothing.frames) == ((), None, 0)
    for _ in range(2):
        again, given, _ = ask(evidence, FAR)
        assert given["claimed"] is None and len(again.claimed) == 1 == len(first.claimed)
    place = look_at([0.5, 0, 0.2], [-1, 0, 0])
    tried = evidence.with_tried([place])
    assert evidence.untried(place[None]).all() and not tried.untried(place[None]).any()


def test_a_space_with_more_frames_leaves_the_first_as_it_was():
    """A frame that looks down past a place has looked through it; the space before has not."""
    down, place = look_at([0, 0, 1.0], [0, 0, -1]), np.array([[0.0, 0.0, 0.5]])
    before = no_evidence(Scanner(), AROUND, spacing=0.002, stride=1).space
    after = before.with_frames(down[None], np.full((1, 8, 8), 0.9))
    more = after.with_frames(look_at([0, 0, -1.0], [0, 0, 1])[None], np.full((1, 8, 8), 0.1))
    assert not before.passed(place).any() and after.passed(place).all() and more.passed(place).all()


def lying_ring(radius=0.2, tube=0.03, around=60, facets=40):
    """A torus that lies on the table, of flat facets."""
    a = 2 * np.pi * np.arange(around) / around
    b = 2 * np.pi * np.arange(facets) / facets
    r = radius + tube * np.cos(b)
    z = np.broadcast_to(tube + tube * np.sin(b), (around, facets))
    x, y = np.outer(np.cos(a), r), np.outer(np.sin(a), r)
    at = np.arange(around * facets).reshape(around, facets)
    right, up = np.roll(at, -1, axis=0), np.roll(at, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    quads = [[at, right, both], [at, both, up]]
    triangles = np.concatenate([np.stack(q, axis=-1).reshape(-1, 3) for q in quads])
    return Part(name="ring", vertices=np.stack([x, y, z], axis=-1).reshape(-1, 3), triangles=triangles)


@pytest.mark.slow
def test_a_strip_whose_slope_is_guessed_wrong_is_seen_in_the_end():
    """The inner wall of a ring, just above the table: the smooth guess leans 20 deg less than it does."""
    made = plan(lying_ring(), load_cell("kr240"), options=PlanOptions())
    done = made.completeness()
    assert done["after_global"] < 0.98 and done["final"] > 0.998
    assert not findings_of(made)
