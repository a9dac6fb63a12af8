"""A cloud grown scan by scan against the fusion of all raw points at once."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.core.viewpoint import look_at
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.fusion.fuse import Cloud, fuse
from scanmotion.sensing.fusion.merge import merged
from scanmotion.sensing.holes.find import holes_from_cloud
from scanmotion.sensing.simulator.simulate import simulate, still_captures
from scanmotion.sensing.visibility import scene_from

SCANNER = Scanner(rays=(212, 148))
VOXEL = 0.002


def vase(rings=120, *, height=0.2):
    """A waisted body of revolution on the floor, closed at both ends."""
    z = np.linspace(0, height, rings)
    r = 0.06 + 0.02 * np.cos(4 * np.pi * z / height)
    phi = 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    side = np.stack(
        [r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), np.repeat(z[:, None], len(phi), 1)], axis=-1
    ).reshape(-1, 3)
    w = len(phi)
    i, j = (m.ravel() for m in np.meshgrid(np.arange(rings - 1), np.arange(w), indexing="ij"))
    a, b = i * w + j, i * w + (j + 1) % w
    k = np.arange(w)
    last, bottom, top = (rings - 1) * w, len(side), len(side) + 1
    triangles = np.concatenate(
        [
            np.column_stack([a, b, a + w]), np.column_stack([b, b + w, a + w]),
            np.column_stack([np.full(w, bottom), (k + 1) % w, k]),
            np.column_stack([np.full(w, top), last + k, last + (k + 1) % w]),
        ]
    )  # fmt: skip
    return Part(
        name="vase", vertices=np.vstack([side, [[0, 0, 0], [0, 0, height]]]), triangles=triangles
    )  # fmt: skip


@pytest.fixture(scope="module")
def part():
    return vase()


@pytest.fixture(scope="module")
def scans(part):
    """Two thirds of a ring from aside, and two stations that see the rest of it and a part of the same."""
    scene = scene_from(part.vertices, part.triangles, table_radius=0.4)

    def at(angle, height):
        p = np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), height])
        return look_at(p, np.array([0, 0, 0.1]) - p)

    ring = np.stack([at(a, 0.15) for a in np.linspace(0, 4 * np.pi / 3, 24)])
    stations = np.stack([at(a, 0.3) for a in np.linspace(4.6, 4.9, 6)])
    return [
        simulate(scene, SCANNER, still_captures(X), stride=1, rng=np.random.default_rng(k))
        for k, X in enumerate((ring, stations))
    ]


@pytest.fixture(scope="module")
def grown(scans):
    return merged(fuse(scans[:1]), fuse(scans[1:]))


@pytest.fixture(scope="module")
def at_once(scans):
    return fuse(scans)


def by_cell(cloud):
    return {tuple(c): k for k, c in enumerate(cloud.cells)}


def test_cells_are_the_voxels_of_the_raw_points(scans, at_once):
    raw = np.unique(np.floor(np.concatenate([s.points_O for s in scans]) / np.float64(VOXEL)), axis=0)
    assert {tuple(c) for c in at_once.cells} <= {tuple(c) for c in raw.astype(int)}
    assert len(at_once) > 0.99 * len(raw)
    np.testing.assert_allclose(at_once.points, (at_once.cells + 0.5) * VOXEL, atol=1.5 * VOXEL)


def test_a_grown_cloud_is_the_fusion_of_all(part, grown, at_once):
    a, b = by_cell(grown), by_cell(at_once)
    common = sorted(set(a) & set(b))
    assert len(common) == len(grown) >= 0.998 * len(at_once)
    i, j = np.array([(a[c], b[c]) for c in common]).T
    np.testing.assert_array_equal(grown.counts[i], at_once.counts[j])
    off = np.linalg.norm(grown.points[i] - at_once.points[j], axis=1)
    assert np.median(off) < 0.01e-3 and np.percentile(off, 99) < 0.25e-3
    assert np.median((grown.normals[i] * at_once.normals[j]).sum(axis=1)) > 0.9999
    np.testing.assert_allclose(np.linalg.norm(grown.normals, axis=1), 1.0, atol=1e-9)
    ours, theirs = (accuracy(c.points, part) for c in (grown, at_once))
    assert ours.mean_abs < 1.1 * theirs.mean_abs


def test_the_same_holes_are_found(grown, at_once):
    ours, theirs = (
        holes_from_cloud(c.points, view_directions=c.view_directions).holes for c in (grown, at_once)
    )
    assert len(ours) == len(theirs) >= 1
    near, k = cKDTree([h.center for h in theirs]).query([h.center for h in ours])
    assert near.max() < 2 * VOXEL and len(set(k)) == len(theirs)
    for hole, other in zip(ours, [theirs[i] for i in k], strict=True):
        assert hole.perimeter == pytest.approx(other.perimeter, rel=0.1)
        assert hole.area == pytest.approx(other.area, rel=0.1)
        assert hole.normal @ other.normal > 0.99


def test_order_and_empty_clouds(scans, grown):
    a, b = fuse(scans[:1]), fuse(scans[1:])
    other = merged(b, a)
    one, two = by_cell(grown), by_cell(other)
    assert set(one) == set(two)
    index = [two[c] for c in one]
    np.testing.assert_array_equal(other.counts[index], grown.counts[list(one.values())])
    off = np.abs(other.points[index] - grown.points[list(one.values())]).max(axis=1)
    # Opposite sides with equal counts: the first cloud's stays.
    assert (off > 1e-12).mean() < 1e-3
    nothing = Cloud(
        points=np.zeros((0, 3)), normals=np.zeros((0, 3)), view_directions=np.zeros((0, 3)),
        counts=np.zeros(0, int),
    )  # fmt: skip
    assert merged(nothing, b) is b and merged(b, nothing) is b
    with pytest.raises(InputError, match="voxel"):
        merged(a, b, voxel=0.0)


def test_opposite_sides_in_one_voxel_are_not_averaged():
    def one(z, up, count):
        n = np.array([[0.0, 0.0, up]])
        return Cloud(
            points=np.array([[0.001, 0.001, z]]), normals=n, view_directions=n, counts=np.array([count])
        )

    both = merged(one(0.0005, 1.0, 3), one(0.0015, -1.0, 9))
    assert len(both) == 1 and both.counts[0] == 12
    np.testing.assert_array_equal(both.points[0], [0.001, 0.001, 0.0015])
    np.testing.assert_array_equal(both.normals[0], [0, 0, -1])
    same = merged(one(0.0005, 1.0, 3), one(0.0015, 1.0, 9))
    np.testing.assert_allclose(same.points[0, 2], (3 * 0.0005 + 9 * 0.0015) / 12)


def test_a_cloud_that_does_not_say_its_voxels(scans):
    a, b = fuse(scans[:1]), fuse(scans[1:])
    guessed = merged(replace(a, cells=None), b)
    known = merged(a, b)
    assert abs(len(guessed) - len(known)) < 0.02 * len(known)
