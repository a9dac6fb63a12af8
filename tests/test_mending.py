"""What is mended in meshes: against the exact volume, area and edges of what was broken on purpose."""

import numpy as np
import pytest
from scans import bumpy

from scanmotion.core.errors import PartError
from scanmotion.geometry.mending.edges import areas_of, edges_of
from scanmotion.geometry.mending.keys import equal_points, row_keys
from scanmotion.geometry.mending.manifold import parted
from scanmotion.geometry.mending.mend_mesh import mended
from scanmotion.geometry.parts.make_part import box_part

BOX = box_part(100.0, 60.0, 40.0)
LUMP = bumpy(16, size=50.0)


def volume(v, t):
    a, b, c = (v[t[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def together(*bodies):
    v, t, n = [], [], 0
    for vertices, triangles in bodies:
        v.append(vertices)
        t.append(triangles + n)
        n += len(vertices)
    return np.concatenate(v), np.concatenate(t)


def box(size, at=(0, 0, 0), inward=False):
    t = BOX.triangles[:, ::-1] if inward else BOX.triangles
    return (BOX.vertices / [100, 60, 40] - [0, 0, 0.5]) * size + at, t


def soup(v, t):
    return v[t].reshape(-1, 3), np.arange(3 * len(t)).reshape(-1, 3)


@pytest.mark.parametrize("crack", [3e-5, 5e-4])
def test_cracks_of_the_files_resolution_are_closed(crack):
    v, t = soup(LUMP.vertices, LUMP.triangles)
    v = v + np.random.default_rng(0).uniform(-0.5, 0.5, v.shape) * crack / np.sqrt(3)
    made = mended(v, t, step=3e-5)
    assert made.closed and len(made.vertices) == len(LUMP.vertices)
    assert "resolution" in " ".join(made.changes)


def test_a_real_slit_stays_open():
    v, t = soup(LUMP.vertices, LUMP.triangles)
    v = np.where((np.arange(len(v)) < 1500)[:, None], v + 0.05, v)
    assert not mended(v, t, step=3e-5).closed


def test_small_features_are_not_welded():
    v, t = box((1e-3, 60.0, 40.0))
    made = mended(*together((v, t), box((50.0, 50.0, 50.0), (100, 0, 0))), step=3e-5)
    assert made.closed and made.bodies == 2 and len(made.vertices) == 16


@pytest.mark.parametrize("turned", [(False, False), (True, False), (False, True), (True, True)])
def test_a_cavity_looks_inwards_whatever_the_file_says(turned):
    outer, inner = box((100, 100, 100), inward=turned[0]), box((40, 40, 40), inward=turned[1])
    made = mended(*together(outer, inner))
    assert volume(made.vertices, made.triangles) == pytest.approx(100**3 - 40**3)


def test_a_body_in_a_cavity_looks_outwards():
    bodies = [box((s, s, s), inward=True) for s in (100, 60, 20)]
    made = mended(*together(*bodies))
    assert volume(made.vertices, made.triangles) == pytest.approx(100**3 - 60**3 + 20**3)


def test_bodies_that_cross_are_not_nested():
    made = mended(*together(box((100, 100, 100)), box((60, 20, 20), (60, 0, 0), inward=True)))
    assert volume(made.vertices, made.triangles) == pytest.approx(100**3 + 60 * 20 * 20)


def test_an_open_sheet_keeps_its_side_and_a_nearly_closed_one_is_turned():
    v, t = box((100, 100, 100), inward=True)
    up = np.cross(v[t[:, 1]] - v[t[:, 0]], v[t[:, 2]] - v[t[:, 0]])[:, 2]
    made = mended(v, t[up >= 0])
    assert volume(made.vertices - [0, 0, 50], made.triangles) < 0 and any(
        "hollow" in w for w in made.warnings
    )
    made = mended(LUMP.vertices, LUMP.triangles[3:, ::-1])
    assert not made.closed and volume(made.vertices, made.triangles) > 0
    assert "inside out" in " ".join(made.changes)


def test_a_fin_is_dropped_and_a_wall_is_parted():
    v, t = LUMP.vertices, LUMP.triangles
    fin = np.concatenate([v, [v[t[50, 0]] * 1.05]])
    made = mended(fin, np.concatenate([t, [[t[50, 0], t[50, 1], len(v)]]]))
    assert made.closed and len(made.triangles) == len(t)
    v, t = box((100, 100, 100))
    ring = np.array([[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]], float)
    assert edges_of(t).count.max() == 2 and len(ring) == 4


def test_boxes_that_touch_in_an_edge_stay_two_bodies_without_a_crowded_edge():
    a, b = box((20, 20, 20)), box((20, 20, 20), (20, 20, 0))
    made = mended(*together(a, b))
    assert edges_of(made.triangles).count.tolist() == [2] * 36
    assert made.closed and made.split == 2 and len(made.vertices) == 16
    assert volume(made.vertices, made.triangles) == pytest.approx(2 * 20**3)


def test_boxes_that_share_a_wall_become_one():
    a, b = box((20, 20, 20)), box((20, 20, 20), (20, 0, 0))
    b = (b[0] * [-1, 1, 1] + [40, 0, 0], b[1][:, ::-1])
    made = mended(*together(a, b))
    assert made.closed and volume(made.vertices, made.triangles) == pytest.approx(2 * 20**3)


def test_boxes_that_touch_in_a_corner():
    made = mended(*together(box((20, 20, 20)), box((20, 20, 20), (20, 20, 20))))
    assert made.closed and volume(made.vertices, made.triangles) == pytest.approx(2 * 20**3)


def test_a_sheet_with_both_sides_becomes_one_sheet():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(10.0), np.arange(10.0)))
    v = np.column_stack([x, y, 0 * x]) * 10
    i = np.arange(90).reshape(9, 10)[:, :9].ravel()
    t = np.concatenate([np.column_stack([i, i + 1, i + 11]), np.column_stack([i, i + 11, i + 10])])
    made = mended(v, np.concatenate([t, t[:, ::-1]]))
    assert len(made.triangles) == len(t) and areas_of(made.vertices, made.triangles).sum() == pytest.approx(
        8100
    )


def test_a_band_with_one_side_is_said():
    n = 40
    a = np.arange(n) * 2 * np.pi / n
    across = np.column_stack([np.cos(a / 2) * np.cos(a), np.cos(a / 2) * np.sin(a), np.sin(a / 2)])
    middle = np.column_stack([np.cos(a), np.sin(a), 0 * a]) * 50
    v = np.concatenate([middle - 10 * across, middle + 10 * across])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    low, high = np.where(j == 0, n, j), np.where(j == 0, 0, j + n)
    t = np.concatenate([np.column_stack([i, low, i + n]), np.column_stack([i + n, low, high])])
    made = mended(v, t)
    assert any("one side" in w for w in made.warnings) and len(made.triangles) == 2 * n


def test_specks_are_left_out_and_details_stay():
    main = (LUMP.vertices, LUMP.triangles)
    speck = box((0.5, 0.5, 0.5), (0, 0, -80))
    button = box((2.0, 2.0, 2.0), LUMP.vertices[:, :].max(axis=0) * [1, 0, 0] + [1.0, 0, 50])
    large = box((30.0, 30.0, 30.0), (0, 150, 20))
    made = mended(*together(main, speck, button, large))
    assert made.specks == 1 and made.bodies == 3 and "1 speck" in " ".join(made.changes)
    assert made.vertices[:, 2].min() == LUMP.vertices[:, 2].min()


def test_an_island_that_floats_is_left_out_and_one_that_stands_is_kept():
    main, up = (LUMP.vertices, LUMP.triangles), np.array([0.0, 0, 1])
    floats, stands = box((12.0, 12.0, 12.0), (0, 0, -60)), box((12.0, 12.0, 12.0), (0, 150, 6))
    made = mended(*together(main, floats, stands), up=up)
    assert made.specks == 1 and made.bodies == 2
    assert made.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9) and made.vertices[:, 1].max() > 150


def test_a_speck_over_a_large_face_is_measured_to_the_face():
    plate = box((300.0, 300.0, 2.0))
    made = mended(*together(plate, box((1.0, 1.0, 1.0), (0, 0, 3.0))))
    assert made.specks == 0 and made.bodies == 2, "it stands a millimetre over the plate's middle"


def test_corners_that_are_no_numbers():
    v = np.concatenate([LUMP.vertices, [[np.nan] * 3] * 5])
    assert mended(v, LUMP.triangles).closed
    v = LUMP.vertices.copy()
    v[100] = np.nan
    made = mended(v, LUMP.triangles)
    assert not made.closed and np.isfinite(made.vertices).all() and "not finite" in made.changes[0]
    v[::3] = np.nan
    with pytest.raises(PartError, match="hang on them"):
        mended(v, LUMP.triangles)


def test_a_floor_under_an_open_mesh_is_cut_off_and_a_plinth_stays():
    x, y = np.meshgrid(np.linspace(-300, 300, 61), np.linspace(-300, 300, 61))
    v = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.5)])
    i = (np.arange(60)[:, None] * 61 + np.arange(60)).ravel()
    t = np.concatenate([np.column_stack([i, i + 1, i + 62]), np.column_stack([i, i + 62, i + 61])])
    made = mended(*together((LUMP.vertices, LUMP.triangles), (v, t)), up=np.array([0.0, 0, 1]))
    assert "was cut off" in " ".join(made.changes)
    assert np.ptp(made.vertices, axis=0) == pytest.approx(np.ptp(LUMP.vertices, axis=0), rel=0.02)
    plinth = box((400.0, 400.0, 20.0), (0, 0, -10))
    opened = LUMP.triangles[5:]
    made = mended(*together((LUMP.vertices, opened), plinth), up=np.array([0.0, 0, 1]))
    assert "cut off" not in " ".join(made.changes) and np.ptp(made.vertices, axis=0)[0] == pytest.approx(400)


def test_keys_are_unique_rows(rng):
    p = rng.integers(0, 6, (500, 3)) - 3.0
    first, place = equal_points(p)
    assert (p[first][place] == p).all() and len(first) == len(np.unique(p, axis=0))
    assert (np.diff(first) > 0).all()
    r = rng.integers(0, 9, (400, 3)) * 10**12
    assert len(np.unique(row_keys(r))) == len(np.unique(r, axis=0))


def test_parting_leaves_a_good_mesh_alone():
    made = parted(LUMP.vertices, LUMP.triangles)
    assert made.vertices is LUMP.vertices and made.triangles is LUMP.triangles
