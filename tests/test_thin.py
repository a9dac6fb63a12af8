"""What is more than a limit is thinned while it is read, and said; the surface stays."""

import struct

import numpy as np
import pytest
from scans import bumpy
from test_cloud_dialects import P, S
from test_cloud_dialects import pcd as pcd_file

from scanmotion.core.errors import PartError
from scanmotion.geometry.files import part_files, thin
from scanmotion.geometry.files.clouds import pcd
from scanmotion.geometry.files.formats import ply_read, stl
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.files.ply_write import ply_data
from scanmotion.geometry.parts.make_part import part_from_file

LUMP = bumpy(60, size=0.05)


def volume(part):
    a, b, c = (part.vertices[part.triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@pytest.fixture
def small_limits(monkeypatch):
    for module, name, value in (
        (thin, "MAX_TRIANGLES", 4000), (stl, "MAX_TRIANGLES", 4000), (thin, "TARGET", 2500),
        (thin, "CHUNK", 700), (stl, "CHUNK", 700), (ply_read, "MAX_POINTS", 1300), (pcd, "MAX_POINTS", 1300),
        (part_files, "MAX_TEXT", 30_000), (part_files, "_MAPPED", 1000),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, value)


def write_stl(path, corners):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in corners)
    path.write_bytes(b"big".ljust(80) + struct.pack("<I", len(corners)) + body)


@pytest.mark.parametrize("kind", ["stl", "ply"])
def test_a_large_mesh_keeps_its_surface(tmp_path, small_limits, kind):
    assert len(LUMP.triangles) > 7000
    path = tmp_path / f"lump.{kind}"
    if kind == "stl":
        write_stl(path, LUMP.vertices[LUMP.triangles] * 1e3)
    else:
        path.write_bytes(ply_data(LUMP.vertices * 1e3, triangles=LUMP.triangles))
    part = part_from_file(path)
    assert 1000 < len(part.triangles) <= 4000
    assert f"{len(LUMP.triangles)} triangles were thinned" in part.report.line
    assert part.closed, part.report.line
    assert volume(part) == pytest.approx(volume(LUMP), rel=0.02)
    np.testing.assert_allclose(part.extent, LUMP.extent, atol=0.004)


def test_corners_that_are_no_numbers_do_not_set_the_cells(tmp_path, small_limits):
    corners = LUMP.vertices[LUMP.triangles] * 1e3
    corners[5, 1, 2], corners[9, 0, 0] = np.nan, 3e38
    write_stl(tmp_path / "nan.stl", corners)
    raw = read_geometry(tmp_path / "nan.stl")
    assert np.isfinite(raw.vertices).all() and np.ptp(raw.vertices, axis=0).max() < 200


def test_a_large_binary_cloud(tmp_path, small_limits):
    (tmp_path / "a.ply").write_bytes(ply_data(P))
    packed = P.astype("<f4").tobytes()
    (tmp_path / "a.pcd").write_bytes(pcd_file("x y z", "4 4 4", "F F F", "1 1 1", packed, "binary"))
    for name in ("a.ply", "a.pcd"):
        raw = read_geometry(tmp_path / name)
        np.testing.assert_allclose(raw.vertices, P[::3], atol=1e-4)
        assert "one of 3 was read" in raw.notes[0]


@pytest.mark.parametrize("head", [b"", b"//X Y Z\n", b"3000\n"])
def test_lines_of_a_large_text_cloud(tmp_path, small_limits, monkeypatch, head):
    monkeypatch.setattr(thin, "_TEXT_CHUNK", 7777)
    (tmp_path / "a.pts").write_bytes(head + S)
    raw = read_geometry(tmp_path / "a.pts")
    first = bool(head)
    number = np.arange(3000) + first
    np.testing.assert_allclose(raw.vertices, P[(number < 200) | (number % 3 == 0)], atol=1e-9)
    assert "one of 3 was read" in raw.notes[0]


def test_what_would_take_more_memory_than_there_is_free_is_refused():
    with pytest.raises(PartError, match="GiB are free"):
        part_files._check_memory(1 << 50)
    part_files._check_memory(1 << 20)
