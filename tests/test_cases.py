"""The inputs of ../shared/cases/README.md, each with the value that is right for it."""

import shutil

import numpy as np
import pytest
from scipy.spatial import cKDTree

from scanmotion.core.errors import PartError
from scanmotion.geometry.mending.edges import areas_of
from scanmotion.geometry.parts.make_part import part_from_file
from scanmotion.sensing.holes.find import holes_from_mesh


@pytest.fixture(scope="module")
def meshes(shared_cases):
    return shared_cases / "meshes"


@pytest.fixture(scope="module")
def clouds(shared_cases):
    return shared_cases / "clouds"


def holes(part):
    return holes_from_mesh(part.vertices, part.triangles, weld=False).holes


AS_REFERENCE = (
    "ref.ply", "p01b_scalar_first3.ply", "p01e_rgb_first.ply", "p02_tristrips_bin.ply", "p03_latin1_comment.ply",  # noqa: E501
    "p04_cr_asc.ply", "n01_bom_unused_last.obj", "o02_continuation.obj", "o03_latin1.obj", "s03_trailing.stl",
    "s08_upper.stl",
)  # fmt: skip


@pytest.mark.parametrize("name", AS_REFERENCE)
def test_the_figurine_with_its_hole(meshes, name):
    part = part_from_file(meshes / name)
    np.testing.assert_allclose(part.extent * 1e3, (134.6, 130.2, 300.0), atol=0.06)
    assert len(part.triangles) == 3694 and not part.closed
    (hole,) = holes(part)
    assert hole.perimeter * 1e3 == pytest.approx(195.5, abs=0.1)
    assert hole.area * 1e6 == pytest.approx(1515, abs=1)
    assert part.report.triangles == 3694 and part.report.units == "mm"


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("g01c_ulp_closed.stl", "resolution"),
        ("m01_fin.ply", "more than two"),
        ("g04_floater_below.ply", "speck"),
    ],
)
def test_the_closed_figurine_mended_and_said(meshes, name, word):
    part, whole = part_from_file(meshes / name), part_from_file(meshes / "closed.ply")
    assert part.closed and not holes(part)
    assert word in part.report.line
    np.testing.assert_allclose(part.extent, whole.extent, atol=1e-6)
    np.testing.assert_allclose(part.bounds, whole.bounds, atol=1e-6)
    assert part.report.specks == (1 if "floater" in name else 0)


def test_concave_faces_are_not_cut_across_their_notch(meshes):
    part = part_from_file(meshes / "o10_concave_ngon.obj")
    assert part.closed
    assert areas_of(part.vertices, part.triangles).sum() * 1e6 == pytest.approx(52_800, abs=0.1)


def test_each_body_is_turned_by_itself(meshes):
    one, two = (part_from_file(meshes / f"g02_two_{name}.ply") for name in ("flipped", "ok"))
    normal = [
        np.cross(*(p.vertices[p.triangles[:, i]] - p.vertices[p.triangles[:, 0]] for i in (1, 2)))
        for p in (one, two)
    ]
    np.testing.assert_allclose(normal[0], normal[1], atol=1e-12)
    assert "1 of 2 bodies" in one.report.line and "turned" not in two.report.line


def test_an_open_bowl_keeps_the_side_of_its_file(meshes):
    part = part_from_file(meshes / "g03_bowl.ply")
    (hole,) = [h for h in holes(part) if h.perimeter < 0.3]
    assert hole.normal[2] > 0.5, "the viewpoint is above the bowl"
    assert "turned" not in " ".join(part.report.changes)


@pytest.mark.parametrize("name", ["x07_header_names.xyz", "x09_semicolon.xyz", "x10_decimal_comma.xyz"])
def test_dialects_of_text_are_the_reference(clouds, name):
    a, b = part_from_file(clouds / name), part_from_file(clouds / "x01_ref.xyz")
    np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-12)
    assert a.normals is None


def test_colours_are_no_normals(clouds):
    a, b = (part_from_file(clouds / f"x20_mx_{name}.xyz") for name in ("rgb", "plain"))
    np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-12)
    assert a.normals is None and "colours: columns 4-6" in a.report.line


def test_pixels_without_a_point_are_dropped(clouds):
    part = part_from_file(clouds / "d03_organised_nan.pcd")
    assert len(part.vertices) == 14400 - 4464 and "4464 of 14400" in part.report.line
    assert len(part_from_file(clouds / "d02b_count0.pcd").vertices) == 12000


def test_far_coordinates_are_fused_about_a_local_origin(clouds, tmp_path):
    from scanmotion.geometry.files.part_files import read_geometry
    from scanmotion.sensing.scans.scan_files import fuse_files

    fuse_files([clouds / "g12_utm_m.xyz"], tmp_path / "far.ply", units="m", voxel=0.004)
    fuse_files([clouds / "x01_ref.xyz"], tmp_path / "near.ply", voxel=0.004)
    far, near = (read_geometry(tmp_path / f"{n}.ply").vertices for n in ("far", "near"))
    assert np.linalg.norm(far.mean(axis=0)) > 5.6e9
    np.testing.assert_allclose(np.ptp(far, axis=0), np.ptp(near, axis=0), atol=3.0)
    with pytest.raises(PartError, match="not on the table"):
        part_from_file(clouds / "g12_utm_m.xyz", units="m", place="keep")


def test_four_scans_without_normals_become_one_outward_cloud(shared_cases, meshes, tmp_path):
    from scanmotion.cli.fusing import measured_scans, scan_files
    from scanmotion.sensing.scans.scan_files import fuse_measured

    folder = tmp_path / "scans"
    folder.mkdir()
    for i, ending in enumerate(("ply", "PLY", "Ply", "ply")):
        shutil.copy(shared_cases / "fuse" / f"v{i}.ply", folder / f"v{i}.{ending}")
    files = scan_files([folder])
    assert len(files) == 4
    fused = fuse_measured(measured_scans(files, {}, "", lambda stage, share: None))
    assert all(r.trusted for r in fused.registrations)
    whole = part_from_file(meshes / "closed.ply", place="keep")
    a, b, c = (whole.vertices[whole.triangles[:, i]] for i in range(3))
    near = cKDTree((a + b + c) / 3).query(fused.cloud.points)[1]
    outward = np.einsum("ij,ij->i", fused.cloud.normals, np.cross(b - a, c - a)[near]) > 0
    assert outward.mean() > 0.999


@pytest.mark.slow
def test_a_complete_scan_is_an_answer(meshes, tmp_path):
    import json

    from typer.testing import CliRunner

    from scanmotion.cli import app

    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["plan", "--scan", str(meshes / "closed.ply"), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "nothing is missing" in done.stdout
    assert json.loads((out / "summary.json").read_text())["read"]["triangles"] == 3744
    assert "nothing is missing" in (out / "report.html").read_text().lower()
