"""The geometry with scanners of other ranges, tables and speeds than the built-in cell's."""

from dataclasses import replace

import numpy as np
import pytest
from rounds import AROUND, SCANNER, TABLE, Rounds, block_with_pit

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.cell.settings.scanner_presets import scanner_presets
from scanmotion.cell.table_of import table_of
from scanmotion.cell.view_costs import view_costs
from scanmotion.cli.cells.cell_files import check_home
from scanmotion.core.errors import CellError
from scanmotion.geometry.parts.make_part import box_part, carving, surface_samples
from scanmotion.motion.profile.jerk_limited import ruckig_law
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.sensing.visibility import scene_from
from scanmotion.views.candidate_views import CandidateOptions, candidates
from scanmotion.views.next_best_views import SelectOptions
from scanmotion.views.stepped_rotary import stepped_rotary
from scanmotion.views.targets import Targets

NEAR = replace(SCANNER, range=(0.15, 0.35), baseline=0.08)
USUAL, FAR = SCANNER, replace(SCANNER, range=(1.1, 2.0), baseline=0.3)
COARSE = CandidateOptions(seeds=25, directions=60, per_seed=20)
SIZE, PIT = (0.2, 0.15, 0.2), (0.05, 0.05, 0.08)


def depth_of(X_OS, vertices, triangles):
    """Distance along +z of one pose to the nearest triangle (Moeller and Trumbore 1997), inf for none."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    p, z = X_OS[:3, 3], X_OS[:3, 2]
    across = np.cross(z, c - a)
    det = np.einsum("ij,ij->i", b - a, across)
    det = np.where(np.abs(det) < 1e-15, np.nan, det)
    u = np.einsum("ij,ij->i", p - a, across) / det
    other = np.cross(p - a, b - a)
    v = (other @ z) / det
    t = np.einsum("ij,ij->i", c - a, other) / det
    hit = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (t > 0)
    return float(t[hit].min()) if hit.any() else np.inf


def usual(depths, scanner):
    """The depths in range, or if there is none all of them."""
    depths = [d for d in depths if np.isfinite(d)]
    return [d for d in depths if scanner.range[0] <= d <= scanner.range[1]] or depths


def turned(X_OS, n):
    """A pose as the part sees it while the table turns once."""
    out = []
    for angle in -2 * np.pi * np.arange(n) / n:
        c, s = np.cos(angle), np.sin(angle)
        out.append(np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) @ X_OS)
    return out


@pytest.mark.parametrize("scanner", [NEAR, USUAL, FAR], ids=["near", "usual", "far"])
def test_stations_stand_off_inside_the_scanners_own_range(scanner):
    part = block_with_pit(SIZE, PIT)
    samples = surface_samples(part, 300, rng=np.random.default_rng(3))
    some = samples.points[:, 2] > 0.05
    targets = Targets(
        points=samples.points[some], normals=samples.normals[some], areas=np.ones(int(some.sum()))
    )
    scene = scene_from(part.vertices, part.triangles, table_radius=TABLE)
    found = candidates(scene, scanner, targets, solid=part.vertices, table=AROUND, options=COARSE)
    stations = found.X_OS[~found.turns]
    useful = found.sees[~found.turns].any(axis=1)
    assert len(stations) > 200 and useful.mean() > 0.9
    # Each looks at its seed along its axis: the nearest target to the axis.
    to = targets.points[None] - stations[:, None, :3, 3]
    depth = np.einsum("ijk,ik->ij", to, stations[:, :3, 2])
    beside = np.linalg.norm(to - depth[..., None] * stations[:, None, :3, 2], axis=2)
    seed = np.argmin(np.where(depth > 0, beside, np.inf), axis=1)
    d = depth[np.arange(len(stations)), seed]
    assert beside[np.arange(len(stations)), seed].max() < 1e-9
    assert d.min() >= scanner.range[0] and d.max() <= scanner.range[1]
    # All of the range is used, not one end of it.
    share = (d - scanner.range[0]) / scanner.depth
    assert share.min() < 0.2 and share.max() > 0.6
    assert found.sees.any(axis=0).mean() > 0.9


def test_the_built_in_scanner_keeps_its_standoffs():
    from scanmotion.views.candidate_views import _BESIDE, _STANDOFFS, _share_of_range

    assert _share_of_range(SCANNER, _STANDOFFS) == (0.45, 0.62, 0.8)
    assert _share_of_range(SCANNER, _BESIDE) == (0.45, 0.97)


def test_a_scanner_that_sees_nothing_is_told_of(caplog):
    part = box_part(0.2, 0.2, 0.2)
    # A target deep inside the block: no eye has a free line to it.
    targets = Targets(points=np.array([[0, 0, 0.1]]), normals=np.array([[0, 0, 1.0]]), areas=np.ones(1))
    scene = scene_from(part.vertices, part.triangles, table_radius=TABLE)
    found = candidates(scene, SCANNER, targets, solid=part.vertices, table=AROUND, options=COARSE)
    assert not found.sees.any()
    assert "sees any of what was missed with a scanner of 0.4 to 1 m" in caplog.text


@pytest.mark.parametrize("scanner", [NEAR, USUAL, FAR], ids=["near", "usual", "far"])
def test_a_local_viewpoints_standoff_is_where_its_axis_meets_the_surface(scanner):
    part = block_with_pit((0.12, 0.1, 0.12), (0.04, 0.04, 0.03))
    rounds = Rounds(part, scanner=scanner, samples=3000)
    length, width, height = (float(side) for side in part.extent)
    rounds.turn(stepped_rotary(length, width, height, scanner).viewpoints[:1])
    step = rounds.local(options=SelectOptions(candidates=COARSE, least_rate=1e-7))
    assert len(step.viewpoints) >= 1
    met = 0
    for v in step.viewpoints:
        poses = turned(v.X_OS, 30) if v.kind == "revolution" else [v.X_OS]
        known = [depth_of(X, step.model.vertices, step.model.triangles) for X in poses]
        known = usual(known, scanner)
        if known:
            met += 1
            assert v.standoff == pytest.approx(np.median(known), abs=1e-4), v
        if v.kind == "station":
            assert scanner.range[0] - 0.01 < v.standoff < scanner.range[1] + 0.01
            # Where it is measured, the model is the part.
            measured = step.model.triangles[step.model.distance <= step.model.cell]
            if known and depth_of(v.X_OS, step.model.vertices, measured) == known[0]:
                true = depth_of(v.X_OS, part.vertices, part.triangles)
                assert v.standoff == pytest.approx(true, abs=2 * step.model.cell)
    assert met >= 0.5 * len(step.viewpoints)


@pytest.mark.parametrize("scanner", [NEAR, USUAL, FAR], ids=["near", "usual", "far"])
@pytest.mark.parametrize("size", [(0.33, 0.2, 0.6), (0.6, 0.33, 0.2), (0.9, 0.1, 0.5), (0.1, 0.1, 0.1)])
def test_a_turns_standoff_is_where_its_axis_meets_the_box(scanner, size):
    part = box_part(*size)
    for v in stepped_rotary(*size, scanner).viewpoints:
        depths = [depth_of(X, part.vertices, part.triangles) for X in turned(v.X_OS, 30)]
        depths = usual(depths, scanner)
        if depths:
            assert v.standoff == pytest.approx(np.median(depths), abs=1e-9)


def test_costs_follow_the_cells_speeds():
    usual = load_cell("kr240")
    fast = usual.model_copy(
        update={
            "process": usual.process.model_copy(update={"transit_speed_m_s": 0.4, "dwell_s": 1.3}),
            "turntable": usual.turntable.model_copy(update={"speed_rpm": 30.0, "acceleration_rad_s2": 2.0}),
        }
    )
    for cell in (usual, fast):
        costs, table = view_costs(cell), cell.turntable
        v, a = table.speed_rpm * 2 * np.pi / 60, table.acceleration_rad_s2
        turn = ruckig_law(2 * np.pi, v, a, a / table.jerk_time_s).duration
        assert costs.revolution_s == pytest.approx(turn + 1.0, abs=1e-6)
        few = ruckig_law(np.deg2rad(15.0), v, a, a / table.jerk_time_s).duration
        assert costs.station_s == pytest.approx(cell.process.dwell_s + few, abs=1e-6)
        assert costs.seconds_per_metre == pytest.approx(1.2 / cell.process.transit_speed_m_s)
    assert list(view_costs(fast).own_seconds(np.array([True, False]))) == [
        view_costs(fast).revolution_s, view_costs(fast).station_s,
    ]  # fmt: skip


def test_the_tables_geometry_is_the_cells():
    usual = table_of(load_cell("kr240"))
    assert (usual.radius, usual.z, usual.eye_above, usual.rim_near, usual.rim_far) == pytest.approx(
        (0.76, 0.0, 0.08, 0.1, 0.17)
    )
    other = table_of(
        settings_from(
            {
                "turntable": {"diameter_m": 1.0},
                "pedestal": {"height_m": 0.4, "diameter_m": 0.2},
                "tool": {"scanner_size_m": [0.1, 0.6, 0.08]},
                "process": {"clearance_m": 0.1},
            }
        )
    )
    assert (other.radius, other.z, other.pedestal_radius) == (0.5, -0.4, 0.1)
    # Half the short side, and half the long one with the clearance: the housing touches nothing.
    assert other.eye_above > 0.05 and other.rim_near > 0.05 and other.rim_far > 0.3 + 0.1


def preset_cell(name):
    """A cell with a preset; the table of the long-range one stands farther off."""
    table = {"turntable": {"position_m": [3.0, 0.0]}} if name == "photoneo-phoxi-l" else {}
    return settings_from({"scanner": {"model": name}, **table})


@pytest.mark.parametrize("name", scanner_presets())
def test_a_preset_has_stations_for_the_carving(name):
    settings = preset_cell(name)
    check_home(build_cell(settings))
    scanner, table = settings.scanner_model(), table_of(settings)
    part = carving()
    samples = surface_samples(part, 150, rng=np.random.default_rng(3))
    targets = Targets(points=samples.points, normals=samples.normals, areas=np.ones(150))
    scene = scene_from(part.vertices, part.triangles, table_radius=table.radius)
    options = CandidateOptions(seeds=40, directions=60, per_seed=12)
    found = candidates(scene, scanner, targets, solid=part.vertices, table=table, options=options)
    stations, usual = found.sees[~found.turns], load_cell("kr240").scanner_model()
    assert len(stations) > 200 and stations.any(axis=1).mean() > 0.8
    same = candidates(scene, usual, targets, solid=part.vertices, table=table, options=options)
    assert stations.any(axis=0).sum() > 0.9 * same.sees[~same.turns].any(axis=0).sum()


def test_presets_differ_from_the_built_in_scanner_and_from_one_another():
    assert len(scanner_presets()) >= 3
    optics = {load_cell("kr240").scanner_model().range}
    for name in scanner_presets():
        settings = preset_cell(name)
        low, high = settings.scanner.range_m
        assert (low, high) not in optics and low < settings.process.standoff_m < high
        optics.add((low, high))


def test_a_cell_goes_before_its_preset_but_not_in_the_scanner():
    name = "artec-leo"
    own = settings_from({"scanner": {"model": name}, "process": {"standoff_m": 0.5}, "tool": {"arm_m": 0.5}})
    assert (own.process.standoff_m, own.tool.arm_m, own.process.fps) == (0.5, 0.5, 22.0)
    with pytest.raises(CellError, match=r"scanner.model artec-leo has \[0.35, 1.2\]; leave out this key"):
        settings_from({"scanner": {"model": name, "range_m": [0.4, 1.0]}})
    with pytest.raises(CellError, match="unknown scanner 'leo'; known: artec-leo, artec-space-spider, photo"):
        settings_from({"scanner": {"model": "leo"}})
    # What a plan's folder keeps of its cell is read back as it was.
    assert settings_from(own.model_dump(mode="json")) == own


@pytest.mark.slow
@pytest.mark.parametrize("name", scanner_presets())
def test_a_preset_plans_the_carving(name, tmp_path):
    settings = preset_cell(name)
    options = PlanOptions(rounds=1, samples=8000, voxel=0.004, stride=4, seed=0)
    made = plan(carving(), settings, options=options)
    near, far = settings.scanner.range_m
    local = [v for v in made.viewpoints if v.step == "local"]
    assert local and all(near <= v.standoff <= far for v in made.viewpoints)
    share = made.completeness()
    assert share["final"] > share["after_global"] + 0.002 and share["final"] > 0.8
