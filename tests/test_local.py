"""Local viewpoints over a hole's box: the paper's four cases, and the grid that covers any rectangle."""

import logging

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scanmotion.core.errors import InputError
from scanmotion.core.scanner import Scanner
from scanmotion.sensing.holes.find import Hole
from scanmotion.views.hole_views import (
    grid_positions,
    local_viewpoints,
    paper_local_viewpoints,
    paper_positions,
)

SCANNER = Scanner()
L, W = (float(side) for side in SCANNER.field(0.7))
SIDES = st.floats(0.005, 2.0)


def hole(a, b, *, X=None):
    """A hole whose box has the middle plane a x b."""
    X_OH = np.eye(4) if X is None else X
    corners = np.array([[-a, -b, 0], [a, -b, 0], [a, b, 0], [-a, b, 0]]) / 2
    return Hole(
        boundary=corners @ X_OH[:3, :3].T + X_OH[:3, 3], kind="common", center=X_OH[:3, 3],
        normal=X_OH[:3, 2], X_OH=X_OH, extent=np.array([a, b, 0.01]), perimeter=2 * (a + b), area=a * b,
    )  # fmt: skip


def covered(a, b, fields, l, w):  # noqa: E741
    """Exact share of the a x b rectangle under l x w fields about the given places, by coordinate cells."""
    edges = []
    for side, half, at in ((a, l / 2, fields[:, 0]), (b, w / 2, fields[:, 1])):
        cuts = np.clip(np.concatenate([at - half, at + half, [-side / 2, side / 2]]), -side / 2, side / 2)
        edges.append(np.unique(cuts))
    (x, y), area = edges, 0.0
    for i in range(len(x) - 1):
        for j in range(len(y) - 1):
            at = np.array([x[i] + x[i + 1], y[j] + y[j + 1]]) / 2
            if (np.abs(fields - at) <= [l / 2, w / 2]).all(axis=1).any():
                area += (x[i + 1] - x[i]) * (y[j + 1] - y[j])
    return area / (a * b)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (100, 50, [(0, 0)]),
        (300, 290, [(0, -15.26), (0, 15.26)]),
        (500, 100, [(-62.44, 0), (62.44, 0)]),
        (500, 300, [(62.44, 75), (-62.44, 75), (-62.44, -75), (62.44, -75)]),
    ],
)
def test_the_four_cases_literally(a, b, expected):
    found = paper_positions(a / 1e3, b / 1e3, L, W) * 1e3
    np.testing.assert_allclose(found, expected, atol=6e-3)


@pytest.mark.parametrize(("a", "b", "about"), [(0.8, 0.2, 0.935), (0.9, 0.9, 0.836)])
def test_the_gap_of_the_paper_is_what_two_columns_leave(a, b, about):
    share = covered(a, b, paper_positions(a, b, L, W), L, W)
    assert share == pytest.approx(2 * L / a) and share == pytest.approx(about, abs=4e-3)


@given(SIDES, SIDES)
def test_the_paper_covers_exactly_where_its_conditions_hold(a, b):
    a, b = max(a, b), min(a, b)
    assume(min(abs(a - 2 * L), abs(a - L), abs(b - W), abs(b - 2 * W)) > 1e-6)
    share = covered(a, b, paper_positions(a, b, L, W), L, W)
    whole = a <= 2 * L if a > L else b <= 2 * W
    assert (share > 1 - 1e-9) == whole


@given(st.floats(L * 1.001, 2 * L), st.floats(W * 1.001, 2.0))
def test_case_four_is_a_serpentine_of_two_columns(a, b):
    p = paper_positions(a, b, L, W)
    n = 2 * int(np.ceil(b / W - 1e-9))
    assert len(p) == n
    np.testing.assert_allclose(np.abs(p[:, 0]), a / 2 - L / 2)
    step = np.abs(np.diff(p, axis=0))
    across, down = step[0::2], step[1::2]
    np.testing.assert_allclose(across, np.tile([a - L, 0], (len(across), 1)), atol=1e-12)
    np.testing.assert_allclose(down, np.tile([0, 2 * b / n], (len(down), 1)), atol=1e-12)
    assert p[-1, 1] == pytest.approx(-p[0, 1])


@given(SIDES, SIDES, st.floats(0.0, 0.5))
def test_the_grid_covers_any_rectangle(a, b, overlap):
    p = grid_positions(a, b, L, W, overlap)
    assert covered(a, b, p, L, W) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(p.mean(axis=0), 0, atol=1e-12)
    for axis, (side, field) in enumerate(((a, L), (b, W))):
        rows = np.unique(np.round(p[:, axis], 12))
        least = 1 if side <= field else int(np.ceil((side - field) / (field * (1 - overlap)) - 1e-9)) + 1
        assert len(rows) == least
        if len(rows) > 1:
            steps = np.diff(rows)
            np.testing.assert_allclose(steps, steps[0], atol=1e-9)
            assert steps[0] <= field * (1 - overlap) + 1e-9
            # No field reaches past the rectangle.
            assert rows[-1] + field / 2 == pytest.approx(side / 2)


@given(SIDES, SIDES)
def test_the_grid_is_passed_by_short_steps(a, b):
    p = grid_positions(a, b, L, W)
    assert (np.count_nonzero(np.abs(np.diff(p, axis=0)) > 1e-12, axis=1) == 1).all()
    assert len(np.unique(np.round(p, 12), axis=0)) == len(p)


@given(st.floats(0.01, 2 * L / 1.12), st.floats(0.01, W))
def test_grid_and_paper_agree_where_one_row_of_the_paper_covers(a, b):
    ours, theirs = grid_positions(a, b, L, W, 0.0), paper_positions(a, b, L, W)
    np.testing.assert_allclose(np.sort(ours[:, 0]), np.sort(theirs[:, 0]), atol=1e-12)
    np.testing.assert_allclose(ours[:, 1], theirs[:, 1], atol=1e-12)


@given(st.integers(0, 2**32 - 1), SIDES, SIDES, st.floats(0.4, 1.0))
def test_viewpoints_stand_over_the_box_and_their_fields_cover_it(seed, a, b, d):
    rng = np.random.default_rng(seed)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.from_rotvec(rng.normal(0, 2, 3)).as_matrix(), rng.normal(0, 0.3, 3)
    views = local_viewpoints([hole(a, b, X=X)], SCANNER, standoff=d, table_z=-np.inf)
    l, w = (float(side) for side in SCANNER.field(d))  # noqa: E741
    at = np.array([np.linalg.inv(X) @ v.X_OS for v in views])
    np.testing.assert_allclose(at[:, 2, 3], d, atol=1e-9)
    np.testing.assert_allclose(at[:, :3, 2], np.tile([0, 0, -1], (len(at), 1)), atol=1e-9)
    np.testing.assert_allclose(np.abs(at[:, 0, 0]), 1, atol=1e-9)
    assert covered(a, b, at[:, :2, 3], l, w) == pytest.approx(1.0, abs=1e-6)
    assert {v.sweep for v in views} == ({"L1"} if len(views) > 1 else {""})
    assert [v.id for v in views] == [f"L1.{i}" for i in range(1, len(views) + 1)]


@pytest.mark.parametrize("size", [(0.8, 0.2), (0.9, 0.9), (0.3, 0.29), (0.1, 0.05), (0.5, 0.3), (0.37, 0.6)])
def test_the_paper_warns_exactly_where_it_leaves_a_gap(size, caplog):
    a, b = size
    with caplog.at_level(logging.WARNING, logger="scanmotion"):
        views = paper_local_viewpoints([hole(a, b)], SCANNER)
    assert len(views) == len(paper_positions(a, b, L, W))
    gap = covered(a, b, paper_positions(a, b, L, W), L, W) < 1 - 1e-9
    assert bool(caplog.records) == gap
    if gap:
        assert f"hole 1: {a * 1e3:.0f} x {b * 1e3:.0f} mm" in caplog.text


def test_the_default_never_warns(caplog):
    with caplog.at_level(logging.WARNING, logger="scanmotion"):
        local_viewpoints([hole(0.9, 0.9)], SCANNER)
    assert not caplog.records


def test_viewpoints_below_the_table_are_left_out():
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 0.1
    assert local_viewpoints([hole(0.1, 0.05, X=down)], SCANNER) == ()
    assert len(local_viewpoints([hole(0.1, 0.05, X=down)], SCANNER, table_z=-0.7)) == 1


def test_holes_are_numbered_in_their_order():
    views = local_viewpoints([hole(0.5, 0.1), hole(0.1, 0.05)], SCANNER)
    assert [v.id.split(".")[0] for v in views] == ["L1"] * (len(views) - 1) + ["L2"]
    assert views[-1].sweep == "" and {v.sweep for v in views[:-1]} == {"L1"}
    assert local_viewpoints([], SCANNER) == ()


@pytest.mark.parametrize("d", [0.0, 0.39, 1.01, np.nan])
def test_standoffs_out_of_range_are_refused(d):
    with pytest.raises(InputError, match="outside the scanner's range"):
        local_viewpoints([hole(0.1, 0.1)], SCANNER, standoff=d)


def test_the_deprecated_mode_is_the_papers_function():
    with pytest.deprecated_call():
        old = local_viewpoints([hole(0.5, 0.3)], SCANNER, mode="paper")
    new = paper_local_viewpoints([hole(0.5, 0.3)], SCANNER)
    assert np.array_equal([v.X_OS for v in old], [v.X_OS for v in new])


def test_an_unknown_mode_is_refused():
    with pytest.raises(InputError, match=r"unknown mode 'grid'.*default, paper"):
        local_viewpoints([], SCANNER, mode="grid")
