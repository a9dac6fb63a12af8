"""Why surface stays open: by brute force on tables made up, and on a block whose pit is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rounds import AROUND, SCANNER, TABLE, block_with_pit

from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.sensing.visibility import scene_from
from scanmotion.views.candidate_views import Candidates
from scanmotion.views.targets import Targets
from scanmotion.views.unscanned import (
    CANNOT_BE_REACHED,
    CANNOT_BE_SEEN,
    NOT_WORTH,
    REASONS,
    open_surface,
    patches,
    why_open,
)


def numbered(n):
    """Poses that carry their number."""
    X = np.tile(np.eye(4), (n, 1, 1))
    X[:, 0, 3] = np.arange(n)
    return X


@given(st.integers(0, 10_000))
def test_the_reasons_are_those_of_the_whole_table(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 120)), int(rng.integers(1, 40))
    sees = rng.random((n, m)) < rng.choice([0.01, 0.1, 0.4])
    free = rng.random(n) < rng.choice([0.0, 0.1, 0.9])
    asked = []

    def reachable(X):
        asked.extend(X[:, 0, 3].astype(int).tolist())
        return free[X[:, 0, 3].astype(int)]

    found = Candidates(numbered(n), np.zeros(n, bool), sees, reachable)
    left = np.flatnonzero(rng.random(m) < 0.8)
    why = why_open(found, left)
    for reason, t in zip(why, left, strict=True):
        expected = (
            CANNOT_BE_SEEN if not sees[:, t].any()
            else NOT_WORTH if (sees[:, t] & free).any()
            else CANNOT_BE_REACHED
        )  # fmt: skip
        assert reason == expected
    # Reach is dear: nothing is asked twice, and only what sees something open.
    assert len(asked) == len(set(asked)) and all(sees[k][left].any() for k in asked)


@given(st.integers(0, 10_000))
def test_patches_hold_all_of_the_area_and_hang_together(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 60))
    points = rng.uniform(0, 0.12, (n, 3)) * [1, 1, 0]
    areas, reasons = rng.uniform(1e-6, 1e-4, n), rng.integers(0, 3, n)
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    found = patches(Targets(points=points, normals=up, areas=areas), reasons)
    for r, name in enumerate(REASONS):
        mine = [p for p in found if p.reason == name]
        assert sum(p.area for p in mine) == pytest.approx(areas[reasons == r].sum())
        # Pieces of the graph of short steps, counted by merging sets one by one.
        groups = []
        for i in np.flatnonzero(reasons == r):
            touching = [g for g in groups if any(np.linalg.norm(points[i] - points[j]) <= 0.02 for j in g)]
            groups = [g for g in groups if g not in touching] + [{i}.union(*touching)]
        assert len(mine) == len(groups)
        centres = sorted(tuple(np.round(points[list(g)].mean(axis=0), 9)) for g in groups)
        assert centres == sorted(tuple(np.round(p.center, 9)) for p in mine)
    assert [p.area for p in found] == sorted((p.area for p in found), reverse=True)


@pytest.fixture(scope="module")
def pit():
    """A block with a shaft into which nothing looks, its open samples, and what could see them."""
    part = block_with_pit((0.2, 0.15, 0.2), (0.02, 0.02, 0.15))
    samples = surface_samples(part, 4000, rng=np.random.default_rng(0))
    p = samples.points
    deep = (np.abs(p[:, :2]) < 0.0105).all(axis=1) & (p[:, 2] < 0.1) & (p[:, 2] > 0.01)
    top = (p[:, 2] > 0.1999) & (p[:, 0] > 0.05)
    return part, samples, deep, top


def asked(pit, mask, visible, reachable):
    part, s, *_ = pit
    open_ = Targets(points=s.points[mask], normals=s.normals[mask], areas=np.full(int(mask.sum()), s.area))
    return open_surface(
        scene_from(part.vertices, part.triangles, table_radius=TABLE), SCANNER, open_,
        np.full(int(mask.sum()), visible), solid=part.vertices, reachable=reachable, table=AROUND,
    )  # fmt: skip


def test_a_free_face_is_not_worth_it_or_out_of_reach(pit):
    *_, top = pit
    assert top.any()
    assert (asked(pit, top, True, lambda X: np.ones(len(X), bool)) == NOT_WORTH).all()
    assert (asked(pit, top, True, lambda X: np.zeros(len(X), bool)) == CANNOT_BE_REACHED).all()
    # Only from below the top: from there nobody sees it.
    low = asked(pit, top, True, lambda X: X[:, 2, 3] < 0.19)
    assert (low == CANNOT_BE_REACHED).all()
    assert (asked(pit, top, False, lambda X: np.ones(len(X), bool)) == CANNOT_BE_SEEN).all()


def test_what_optics_allow_but_no_pose_of_the_scanner_is_out_of_reach(pit):
    _, _, deep, _ = pit
    assert deep.any()
    # Said to be visible though camera and projector, 150 mm apart, never both look into 20 mm.
    assert (asked(pit, deep, True, lambda X: np.ones(len(X), bool)) == CANNOT_BE_REACHED).all()
    assert (asked(pit, deep, False, lambda X: np.ones(len(X), bool)) == CANNOT_BE_SEEN).all()
