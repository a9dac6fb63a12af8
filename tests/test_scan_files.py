"""Scans, clouds and pose files on the disk."""

import numpy as np
import pytest
from scans import wrong

from scanmotion.core.errors import InputError, PartError
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.corrections.registration import transformed
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.scans.scan_files import (
    fuse_files,
    fuse_folder,
    load_scan,
    save_cloud,
    save_scan,
    scans_from_poses,
)
from scanmotion.sensing.simulator.captures import inverse, motion, turned


def test_scans_and_clouds_survive_the_disk(clean_scan, lump_cloud, tmp_path):
    save_scan(tmp_path / "scan.npz", clean_scan)
    back = load_scan(tmp_path / "scan.npz")
    for name in ("points_O", "frame", "depth", "pixel", "seen"):
        np.testing.assert_array_equal(getattr(back, name), getattr(clean_scan, name))
    np.testing.assert_array_equal(back.captures.X_OS, clean_scan.captures.X_OS)
    save_cloud(tmp_path / "cloud.ply", lump_cloud)
    cloud = read_geometry(tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud.vertices, lump_cloud.points * 1e3, atol=1e-4)
    assert cloud.normals is not None
    assert sorted(f.name for f in tmp_path.iterdir()) == ["cloud.ply", "scan.npz"]
    for name, content in (("no.npz", None), ("bad.npz", b"nonsense"), ("cloud.ply", b"")):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError):
            load_scan(tmp_path / name)


def folder_of_scans(tmp_path, cloud, errors):
    """Four scans of the lump with a pose file whose poses are wrong by `errors`."""
    import json

    entries = {}
    azimuth = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    for k in range(4):
        X = turned(np.array([k * np.pi / 2]))[0] @ motion(np.array([[0.1, 0.2, 0.3, 0.5, 0.1, 0.0]]))[0]
        mine = np.abs((azimuth - k * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi) < 1.2
        local = inverse(X[None])[0]
        piece = transformed(Cloud(**{n: getattr(cloud, n)[mine] for n in vars(cloud)}), local)
        save_cloud(tmp_path / f"{k}.ply", piece)
        given_ = errors[k] @ X
        given_[:3, 3] *= 1e3
        view = -turned(np.array([k * np.pi / 2]))[0][:3, 0]
        entries[f"{k}.ply"] = {"T_object_scan": given_.tolist(), "nominal_view_direction": view.tolist()}
    (tmp_path / "poses.json").write_text(json.dumps({"units": "mm", "scans": entries}))


def test_a_folder_of_scans_with_poses(tmp_path, lump_cloud, lump):
    errors = [np.eye(4)] + [wrong(0.6, 1.0, k) for k in range(3)]
    folder_of_scans(tmp_path, lump_cloud, errors)
    bare = accuracy(fuse_folder(tmp_path, registered=False).cloud.points, lump)
    fused = fuse_folder(tmp_path)
    a = accuracy(fused.cloud.points, lump)
    assert bare.mean_abs > 0.2e-3 and a.mean_abs < 0.08e-3
    assert all(r.trusted for r in fused.registrations)
    lines = fuse_files([tmp_path], tmp_path / "out.ply")
    assert len(lines) == 4 and "4 scans" in lines[-1]
    assert len(read_geometry(tmp_path / "out.ply").vertices) == len(fused.cloud)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[]", "names no"),
        ('{"scans": {}}', "names no"),
        ('{"units": "furlong", "scans": {"a.ply": {}}}', "unknown unit"),
        ('{"scans": {"a.ply": {}}}', "not a pose"),
        ('{"scans": {"a.ply": {"T_object_scan": [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}}', "not a pose"),
        ('{"scans": {"../a.ply": {}}}', "lie in the folder"),
        (
            '{"scans": {"a.ply": {"T_object_scan": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}}',
            "no such file",
        ),
    ],
)
def test_a_bad_pose_file_is_named(tmp_path, text, message):
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises((InputError, PartError), match=message):
        scans_from_poses(tmp_path / "poses.json")
