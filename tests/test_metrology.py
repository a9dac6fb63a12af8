"""Assessment: alignment, moments against trimesh, regions, and figures on artefacts against planted ones."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scans import bumpy
from scipy.spatial import cKDTree
from test_simulate import sphere
from typer.testing import CliRunner

from scanmotion.cli import app
from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.files.ply_write import write_ply
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.report.assessment import cut_lines
from scanmotion.sensing.metrology.acceptance import Table, acceptance
from scanmotion.sensing.metrology.alignment import aligned
from scanmotion.sensing.metrology.artefacts import ball_bar_from, ball_from, plane_from
from scanmotion.sensing.metrology.deviations import DeviationLimits, deviations, deviations_at_points
from scanmotion.sensing.simulator.captures import ScanErrors, motion


@pytest.fixture(scope="module")
def measured(lump):
    """Points of the lump with a wave of 0.3 mm on them, none below z = 30 mm."""
    s = surface_samples(lump, 30_000, rng=np.random.default_rng(2))
    rng = np.random.default_rng(3)
    d = 3e-4 * np.sin(40 * s.points[:, 0]) + 1e-4 + 5e-5 * rng.standard_normal(len(s.points))
    keep = s.points[:, 2] > 0.03
    return (s.points + d[:, None] * s.normals)[keep], s.normals[keep]


def test_all_figures_agree_with_trimesh(lump, measured):
    points, normals = measured
    found = deviations(points, normals, lump, limits=DeviationLimits(samples=20_000))
    mesh = trimesh.Trimesh(lump.vertices, lump.triangles, process=False)
    _, near = cKDTree(mesh.triangles_center).query(points, k=40)
    each = np.repeat(points, 40, axis=0)
    at = trimesh.triangles.closest_point(mesh.triangles[near.ravel()], each).reshape(-1, 40, 3)
    away = np.linalg.norm(at - points[:, None], axis=2)
    best = away.argmin(axis=1)
    rows = np.arange(len(points))
    at, far, triangle = at[rows, best], away[rows, best], near[rows, best]
    d = far * np.sign(np.einsum("ij,ij->i", points - at, mesh.face_normals[triangle]))
    s = found.spread
    for name, value in {
        "mean_abs": np.abs(d).mean(), "mean_signed": d.mean(), "sd_signed": d.std(),
        "rms": np.sqrt((d * d).mean()),
    }.items():  # fmt: skip
        assert getattr(s, name) == pytest.approx(value, rel=0.01), name
    assert s.absolute[2] == pytest.approx(np.percentile(np.abs(d), 95), rel=0.01)
    assert s.least == pytest.approx(d.min(), rel=0.01) and s.greatest == pytest.approx(d.max(), rel=0.01)
    # The open bottom: what lies below 30 mm less the reach of 3 mm is not covered.
    share = (surface_samples(lump, 20_000, rng=np.random.default_rng(9)).points[:, 2] > 0.03).mean()
    assert found.completeness == pytest.approx(share, abs=0.02)


def test_regions_part_the_points_and_the_surface(lump, measured):
    found = deviations(*measured, lump, limits=DeviationLimits(samples=20_000))
    bands, facings = found.regions[:4], found.regions[4:]
    for group in (bands, facings):
        spreads = [r.spread for r in group if r.spread is not None]
        assert sum(s.points for s in spreads) == found.spread.points
        mean = sum(s.points * s.mean_signed for s in spreads) / found.spread.points
        assert mean == pytest.approx(found.spread.mean_signed, abs=1e-12)
    assert bands[0].completeness < 0.6 < bands[1].completeness
    box = {"head": np.array([[-1, -1, 0.1], [1, 1, 1]])}
    (head,) = deviations(*measured, lump, limits=DeviationLimits(samples=20_000), boxes=box).regions
    assert head.name == "head" and head.completeness > 0.999
    assert head.spread.points == pytest.approx((measured[0][:, 2] > 0.1).sum(), abs=30)


@pytest.mark.parametrize(("how", "twist"), [
    ("fine", [2e-3, -1e-3, 1e-3, 0.02, -0.01, 0.02]),
    ("auto", [0.3, -0.2, 0.5, 1.5, 2.0, -0.7]),
    ("global", [0.0, 0.1, 0.0, 0.0, 0.0, 3.0]),
])  # fmt: skip
def test_a_moved_cloud_finds_its_way_back(lump, measured, how, twist):
    X = motion(np.array([twist]))[0]
    there = measured[0] @ X[:3, :3].T + X[:3, 3]
    found = aligned(there, lump, how=how)
    home = aligned(measured[0], lump, how="fine")
    back = there @ found.X[:3, :3].T + found.X[:3, 3]
    still = measured[0] @ home.X[:3, :3].T + home.X[:3, 3]
    assert np.abs(back - still).max() < 5e-6
    assert found.free == 0 and found.within > 0.99


def test_a_free_motion_is_not_made_and_is_said():
    vertices, triangles = sphere(0.05, np.zeros(3))
    ball = Part(name="ball", vertices=vertices, triangles=triangles)
    p = surface_samples(ball, 3000, rng=np.random.default_rng(0)).points
    found = aligned(p + [1e-3, 0, 0], ball, how="fine")
    assert found.free == 3 and "free" in found.statement
    np.testing.assert_allclose(found.X[:3, 3], [-1e-3, 0, 0], atol=2e-6)


def test_ball_figures_are_those_planted(rng):
    u = rng.standard_normal((20_000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    u = u[u[:, 2] > -0.2]
    r = 0.0301 + rng.uniform(-5e-5, 5e-5, len(u))
    p = u * r[:, None] + [0.4, -0.1, 0.7]
    p[:20] += 0.002 * u[:20]
    ball = ball_from(p, nominal=0.06)
    np.testing.assert_allclose(ball.centre, [0.4, -0.1, 0.7], atol=3e-6)
    assert ball.size_error == pytest.approx(2e-4, abs=5e-6)
    assert ball.form_all == pytest.approx(1e-4, rel=0.03) and ball.form_95 == pytest.approx(0.95e-4, rel=0.03)
    with pytest.raises(InputError):
        ball_from(np.column_stack([rng.random((50, 2)), np.zeros(50)]))


def test_bar_and_plane_figures_are_those_planted(rng):
    u = rng.standard_normal((4000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    other = np.array([0.1, 0.3, 0.2])
    bar = ball_bar_from(np.vstack([0.02 * u, 0.02 * u + other]), diameter=0.0401, spacing=0.4)
    assert bar.spacing == pytest.approx(np.linalg.norm(other), abs=1e-9)
    assert bar.spacing_error == pytest.approx(np.linalg.norm(other) - 0.4, abs=1e-9)
    assert bar.balls[0].size_error == pytest.approx(-1e-4, abs=1e-9)
    z = rng.uniform(-1e-4, 1e-4, 20_000)
    R = motion(np.array([[0, 0, 0, 0.3, -0.5, 0.1]]))[0][:3, :3]
    flat = plane_from(np.column_stack([rng.uniform(-0.2, 0.2, (20_000, 2)), z]) @ R.T + 1.0)
    assert flat.flatness == pytest.approx(2e-4, rel=0.01) and flat.form_95 == pytest.approx(1.9e-4, rel=0.01)
    assert abs(flat.normal @ R[:, 2]) == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(InputError):
        plane_from(np.outer(np.arange(30.0), [1, 2, 3]))


def test_probed_points_see_the_offset(lump):
    s = surface_samples(lump, 60_000, rng=np.random.default_rng(4))
    probed = surface_samples(lump, 300, rng=np.random.default_rng(5))
    reference = Part(
        name="cmm", vertices=probed.points, triangles=np.zeros((0, 3), int), normals=probed.normals
    )
    found = deviations_at_points(s.points + 2e-4 * s.normals, reference)
    assert found.spread.mean_signed == pytest.approx(2e-4, abs=2e-5)
    with pytest.raises(InputError, match="normals"):
        deviations_at_points(
            s.points, Part(name="x", vertices=probed.points, triangles=np.zeros((0, 3), int))
        )


def test_a_section_of_a_box_is_its_outline():
    lines = cut_lines(box_part(0.2, 0.1, 0.3), 2, 0.15)
    assert np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum() == pytest.approx(0.6)
    np.testing.assert_allclose(lines[..., 2], 0.15)


def test_the_command_writes_what_it_says(measured, tmp_path):
    part = bumpy(40)
    write_ply(tmp_path / "cad.ply", part.vertices * 1e3, triangles=part.triangles)
    X = motion(np.array([[2e-3, 0, 1e-3, 0, 0.01, 0]]))[0]
    moved = measured[0] @ X[:3, :3].T + X[:3, 3]
    write_ply(tmp_path / "scan.ply", moved * 1e3, normals=measured[1] @ X[:3, :3].T)
    (tmp_path / "boxes.json").write_text(json.dumps({"top": [[-500, -500, 100], [500, 500, 500]]}))
    out = tmp_path / "out"
    args = ["assess", str(tmp_path / "scan.ply"), "--reference", str(tmp_path / "cad.ply"), "--out", str(out)]
    result = CliRunner().invoke(app, [*args, "--regions", str(tmp_path / "boxes.json"), "--json"])
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record == json.loads((out / "assess.json").read_text())
    assert 0.1 < record["all"]["mean_abs_mm"] < 0.4 and record["regions"][0]["name"] == "top"
    page = (out / "assess.html").read_text()
    assert page.count("data:image/png") == 3 and "http" not in page.replace("http-equiv", "")
    assert len(read_geometry(out / "deviation.ply").vertices) == record["all"]["points"]
    assert CliRunner().invoke(app, args).exit_code == 0
    refused = CliRunner().invoke(app, [*args[:-1], str(tmp_path)])
    assert refused.exit_code == 2 and "not an assessment" in refused.output


def test_a_simulated_acceptance_test_shows_what_was_planted():
    """Without errors all figures vanish but for the mesh's chords; a scale of 1e-3 is read off spacing and
    size."""
    scanner = Scanner(rays=(212, 148))
    table = Table(speed=np.pi / 3, acceleration=0.5, fps=4.0)
    clean = acceptance(scanner, table, ScanErrors.none(), stride=2).record()
    assert abs(clean["sphere spacing SD, D_CC"]) < 0.02 and abs(clean["probing size PS"]) < 0.05
    assert clean["flatness F"] < 0.05
    # The axis 0.3 mm off along the line of sight makes everything larger or smaller by twice of it at most.
    off = acceptance(scanner, table, replace(ScanErrors.none(), axis_m=(3e-4, 0.0)), stride=2).record()
    assert 0.2 < abs(off["probing size PS"]) < 0.8
    assert off["probing form PF"] > clean["probing form PF"]
