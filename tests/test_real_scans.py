"""The ten range scans of the Stanford bunny through the code of `scanmotion fuse`."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from scanmotion.cli.fusing import measured_scans, read_poses
from scanmotion.geometry.parts.make_part import part_from_file, surface_samples
from scanmotion.sensing.assess import completeness_by_distance
from scanmotion.sensing.holes.find import holes_from_cloud
from scanmotion.sensing.scans.scan_files import fuse_measured
from scanmotion.sensing.simulator.captures import inverse, motion

VOXEL = 0.002


@pytest.fixture(scope="module")
def folder(shared_data):
    return shared_data / "bunny_range_scans"


@pytest.fixture(scope="module")
def truth(folder):
    return json.loads((folder / "coverage_gt.json").read_text())


@pytest.fixture(scope="module")
def scans(folder):
    poses = folder / "poses.json"
    files = [folder / name for name in json.loads(poses.read_text())["scans"]]
    return measured_scans(files, read_poses(poses, files), "mm", lambda stage, share: None)


@pytest.fixture(scope="module")
def samples(shared_data):
    bunny = part_from_file(shared_data / "stanford_bunny.ply", place="keep")
    return surface_samples(bunny, 30_000, rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def four(scans, truth):
    return fuse_measured(
        [s for s in scans if s.name in truth["subset_4"]["scans"]], voxel=VOXEL, registered=False
    ).cloud


@pytest.fixture(scope="module")
def registered(scans):
    return fuse_measured(scans, voxel=VOXEL)


def perturbed(scan, rng, *, metres=2e-3, degrees=1.0):
    """The scan with its pose off by 2 mm and 1 degree about its own middle."""
    u, v = rng.standard_normal((2, 3))
    slip = [*(metres * v / np.linalg.norm(v)), *(np.deg2rad(degrees) * u / np.linalg.norm(u))]
    middle = np.eye(4)
    middle[:3, 3] = scan.points.mean(axis=0)
    return replace(scan, X=scan.X @ middle @ motion(np.array([slip]))[0] @ inverse(middle[None])[0])


def apart(scan, X, Y):
    """Mean distance of the scan's points at two poses [m]."""
    p = scan.points
    return np.linalg.norm(p @ (X - Y)[:3, :3].T + (X - Y)[:3, 3], axis=1).mean()


@pytest.mark.parametrize("name", ["subset_4", "all_scans"])
def test_completeness_agrees_with_the_known_coverage(scans, truth, samples, name):
    known = truth[name]
    some = [s for s in scans if s.name in known.get("scans", [s.name])]
    assert len(some) == {"subset_4": 4, "all_scans": 10}[name]
    cloud = fuse_measured(some, voxel=VOXEL, registered=False).cloud
    tau = known["tau_mm"] * 1e-3
    found = completeness_by_distance(samples, cloud.points, cloud.normals, distance=tau, angle=np.pi)
    # The truth asks the raw points; a voxel's fitted point lies up to half a voxel from them.
    assert 1 - found.of_whole == pytest.approx(known["unobserved_area_fraction"], abs=0.006)
    facing = completeness_by_distance(samples, cloud.points, cloud.normals, distance=tau)
    assert found.of_whole - 0.005 < facing.of_whole <= found.of_whole


def test_known_gaps_are_open_and_found(four, truth):
    gaps = [p for p in truth["subset_4"]["patches"] if p["equiv_diameter_mm"] > 15]
    assert len(gaps) == 3
    holes = holes_from_cloud(four.points, view_directions=four.view_directions).holes
    for gap in gaps:
        centre = np.array(gap["centre"]) * 1e-3
        assert np.linalg.norm(four.points - centre, axis=1).min() > 1e-3
        rims = [np.linalg.norm(h.boundary - centre, axis=1).min() for h in holes]
        assert min(rims) < 0.75e-3 * gap["equiv_diameter_mm"]


def test_registration_finds_back_from_wrong_poses(scans, registered):
    rng = np.random.default_rng(0)
    bad = [scans[0], *(perturbed(s, rng) for s in scans[1:])]
    found = [r.X for r in fuse_measured(bad, voxel=VOXEL).registrations]
    best = [r.X for r in registered.registrations]
    assert all(r.trusted for r in registered.registrations)
    assert min(apart(s, s.X, b.X) for s, b in zip(scans[1:], bad[1:], strict=True)) > 2e-3
    # Wherever it starts it ends at the same poses, to a hundredth of the scans' noise of 0.45 mm.
    assert max(apart(s, X, Y) for s, X, Y in zip(scans, found, best, strict=True)) < 0.005e-3
    # The given poses were fitted by others, to the same scans: 0.7 mm away with the first scan held,
    assert np.mean([apart(s, s.X, X) for s, X in zip(scans[1:], found[1:], strict=True)]) < 0.8e-3
    # and each within 0.65 mm once one motion that all share is taken out.
    shared = common_motion(scans, found)
    assert max(apart(s, s.X, shared @ X) for s, X in zip(scans, found, strict=True)) < 0.65e-3


def common_motion(scans, poses):
    """The motion of all scans at once that brings them nearest to their own poses (Kabsch)."""
    moved = np.concatenate(
        [s.points[::20] @ X[:3, :3].T + X[:3, 3] for s, X in zip(scans, poses, strict=True)]
    )
    fixed = np.concatenate([s.points[::20] @ s.X[:3, :3].T + s.X[:3, 3] for s in scans])
    a, b = moved.mean(axis=0), fixed.mean(axis=0)
    U, _, Vt = np.linalg.svd((moved - a).T @ (fixed - b))
    out = np.eye(4)
    out[:3, :3] = Vt.T @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ U.T
    out[:3, 3] = b - out[:3, :3] @ a
    return out


def test_registered_scans_fit_one_another_better(scans, registered):
    """Distance of each scan's points to every other scan along its normal, at the given poses and at ours."""
    alone = [fuse_measured([replace(s, X=np.eye(4))], voxel=VOXEL, registered=False).cloud for s in scans]
    trees = [cKDTree(c.points) for c in alone]
    spread = []
    for poses in ([s.X for s in scans], [r.X for r in registered.registrations]):
        heights = []
        for i, j in itertools.permutations(range(len(scans)), 2):
            X = inverse(poses[j][None])[0] @ poses[i]
            p = alone[i].points[::10] @ X[:3, :3].T + X[:3, 3]
            d, k = trees[j].query(p, distance_upper_bound=VOXEL)
            k, p = k[np.isfinite(d)], p[np.isfinite(d)]
            heights.append(np.einsum("ij,ij->i", p - alone[j].points[k], alone[j].normals[k]))
        spread.append(np.concatenate(heights))
    assert len(spread[1]) > 0.98 * len(spread[0])
    assert spread[1].std() < 0.97 * spread[0].std()
    assert np.median(np.abs(spread[1])) < 0.3e-3
