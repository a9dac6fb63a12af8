"""Table 3 in our cell: what differs between rows, spreads, tables, the other methods, the page's maker."""

import json
import runpy
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from test_plan import TINY, pitted
from typer.testing import CliRunner

from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.core.errors import InputError, PartError
from scanmotion.core.part import Part
from scanmotion.core.scanner import Scanner
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.planning.pipeline import PlanOptions
from scanmotion.planning.worth import comparison
from scanmotion.planning.worth.comparison import (
    HEADER,
    MEANINGS,
    PAPER_TABLE_3,
    VARIANTS,
    Figures,
    cells,
    compare,
    document,
    figures,
    markdown,
    row_from,
)
from scanmotion.views.cad_slicing import _offset, cad_slicing
from scanmotion.views.surface_partitioning import surface_partitioning

ROOT = Path(__file__).resolve().parents[1]
OPTIONS = PlanOptions(**TINY)
PAIRS = [f.name for f in fields(Figures) if f.name not in ("variant", "seed")]


def made(variant="two-step", seed=0, **changed) -> Figures:
    values = {
        "after_global": 0.9, "integrity": 0.99, "of_reach": 0.995, "mean_abs_mm": 0.05, "sd_signed_mm": 0.07,
        "time_s": 80.0, "global_s": 40.0, "floor_s": 75.0, "viewpoints": 12, "unreachable": 1,
        "planning_s": 9.0,
    }  # fmt: skip
    return Figures(variant=variant, seed=seed, **{**values, **changed})


# The rows.


@pytest.fixture(scope="module")
def settings():
    return load_cell("kr240")


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def table(settings, told):
    """Two rows of two seeds, and the default with one, on a block with a pit."""
    rows = compare(
        pitted(), settings, variants=("paper-mode", "without-occlusion"), seeds=(0, 1),
        options=OPTIONS, progress=lambda name, share: told.append((name, share)),
    )  # fmt: skip
    return compare(pitted(), settings, variants=("two-step",), seeds=(0,), options=OPTIONS) + rows


def test_rows_stand_in_the_order_asked_for(table, told):
    assert [row.variant for row in table] == ["two-step", "paper-mode", "without-occlusion"]
    assert [row.seeds for row in table] == [(0,), (0, 1), (0, 1)]
    shares = [share for _, share in told]
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] == 1.0 and len(shares) == 5


def test_figures_are_possible(table):
    for row in table:
        assert 0.0 < row.after_global[0] <= row.integrity[0] <= 1.0
        assert row.integrity[1] >= 0.0
        assert 0.0 < row.floor_s[0] <= row.time_s[0]
        assert 0.0 < row.global_s[0] <= row.time_s[0]
        assert (row.global_s[0] < row.time_s[0]) or row.after_global == row.integrity
        # The mean of |x| is at most the root mean square, which the signed deviation and the bias make up.
        assert 0.0 < row.mean_abs_mm[0] < 0.3 and 0.0 < row.sd_signed_mm[0] < 0.5
        assert row.viewpoints[0] >= 1


def test_the_default_sees_into_the_pit_where_the_published_formulas_do_not(table):
    ours, paper, blind = table
    assert ours.integrity[0] > paper.integrity[0] + paper.integrity[1]
    assert ours.integrity[0] > blind.integrity[0] + blind.integrity[1]
    # The ablation touches the local step only.
    assert ours.after_global[0] == pytest.approx(blind.after_global[0], abs=blind.after_global[1] + 1e-12)


def test_a_row_repeats_what_single_plans_say(table, settings):
    again = [figures(pitted(), settings, "paper-mode", seed=s, options=OPTIONS) for s in (0, 1)]
    fresh, row = row_from(again), table[1]
    for name in set(PAIRS) - {"planning_s"}:
        assert getattr(fresh, name) == getattr(row, name), name


def test_seeds_differ(table):
    assert any(getattr(table[1], name)[1] > 0 for name in ("integrity", "mean_abs_mm", "sd_signed_mm"))


@pytest.fixture
def asked(monkeypatch):
    """Options of every plan that is asked for; nothing is planned."""
    seen = []

    def plan(part, settings, *, options):
        seen.append((part, settings, options))
        raise Halt

    monkeypatch.setattr(comparison, "plan", plan)
    return seen


class Halt(Exception):
    pass


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_changes_what_it_says_and_nothing_else(asked, settings, variant):
    part, base = pitted(), replace(OPTIONS, samples=1234)
    for seed in (0, 5):
        with pytest.raises(Halt):
            figures(part, settings, variant, seed=seed, options=base)
    for seed, (given_part, given_settings, options) in zip((0, 5), asked, strict=True):
        assert given_part is part and given_settings is settings
        assert options.seed == seed
        differs = {f.name for f in fields(PlanOptions) if getattr(options, f.name) != getattr(base, f.name)}
        assert differs - {"seed"} == set(VARIANTS[variant])
        assert options.errors == base.errors and options.samples == base.samples


def test_methods_are_counted_on_the_same_samples(settings):
    results = {
        name: comparison.plan(
            pitted(), settings, options=replace(OPTIONS, seed=3, samples=1500, **VARIANTS[name])
        )
        for name in ("paper-mode", "without-occlusion")
    }
    one, other = results.values()
    assert one.samples is not None and other.samples is not None
    assert np.array_equal(one.samples.points, other.samples.points)
    # What can be seen is found by search, and what a plan sees besides counts too.
    assert np.mean(one.visible != other.visible) < 0.002
    assert one.options.errors == other.options.errors


def test_every_row_has_a_meaning():
    assert list(MEANINGS) == list(VARIANTS)


# Means, spreads, text.


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6))
def test_mean_and_half_spread(values):
    row = row_from([made(seed=s, integrity=v) for s, v in enumerate(values)])
    assert row.integrity[0] == pytest.approx(sum(values) / len(values))
    assert row.integrity[1] == pytest.approx((max(values) - min(values)) / 2)
    assert row.time_s == (80.0, 0.0)
    assert row.seeds == tuple(range(len(values)))


def test_a_row_is_of_one_variant():
    with pytest.raises(InputError):
        row_from([made(), made("cad-slicing")])
    with pytest.raises(InputError):
        row_from([])


def test_the_papers_figures_stand_beside_ours():
    printed = {
        "cad-slicing": (0.8905, 1.86, 2.71, 145), "surface-partitioning": (0.9708, 0.97, 1.12, 120),
        "two-step": (1.0, 0.26, 0.31, 152), "paper-mode": (1.0, 0.26, 0.31, 152),
    }  # fmt: skip
    for name in VARIANTS:
        assert row_from([made(name)]).paper == printed.get(name)
    assert cells(row_from([made("cad-slicing")]))[-1] == "89.05%, 1.86, 2.71, 145"
    assert cells(row_from([made("thorough")]))[-1] == ""
    assert set(PAPER_TABLE_3) == set(printed) - {"paper-mode"}


def test_text_of_a_row():
    row = row_from([made(integrity=0.98, time_s=80.0), made(seed=1, integrity=1.0, time_s=84.0)])
    line = dict(zip(HEADER, cells(row), strict=True))
    assert line["integrity"] == "99.00% +- 1.00%"
    assert line["time s"] == "82.0 +- 2.0"
    assert line["time / floor"] == "1.09"
    assert line["views"] == "12"


def test_markdown_has_a_line_for_each_row_and_as_many_cells_in_each():
    rows = [row_from([made(name)]) for name in VARIANTS]
    lines = markdown(rows).splitlines()
    assert len(lines) == len(rows) + 2
    assert {line.count("|") for line in lines} == {len(HEADER) + 1}


def test_what_is_not_known_is_said_so():
    row = row_from([made(mean_abs_mm=float("nan"), floor_s=0.0, time_s=0.0)])
    line = dict(zip(HEADER, cells(row), strict=True))
    assert line["mean mm"] == "not known" and line["time / floor"] == "not known"
    found = json.loads(json.dumps(document("x", [row]), allow_nan=False))
    assert found["rows"][0]["mean_abs_mm"] == [None, None]
    assert found["rows"][0]["integrity"] == [0.99, 0.0]


# The command.


@pytest.fixture
def quick(monkeypatch):
    """Planted figures in place of plans."""
    ran = []

    def planted(part, settings, variant, *, seed, options=None):
        ran.append((variant, seed))
        return made(variant, seed, integrity=0.9 + 0.02 * seed)

    monkeypatch.setattr(comparison, "figures", planted)
    return ran


def run(*args):
    return CliRunner().invoke(app, ["compare", *map(str, args)])


def test_help_names_every_row_and_option():
    text = " ".join(run("--help").output.replace("│", " ").split())
    for name in (*VARIANTS, "--variants", "--variant", "--seeds", "--json", "--out"):
        assert name in text, name


def test_all_rows_by_default(quick):
    assert run("--json").exit_code == 0
    assert quick == [(name, 0) for name in VARIANTS]


@pytest.mark.parametrize(
    "args",
    [
        ("--variants", "cad-slicing,two-step"),
        ("--variant", "cad-slicing", "--variant", "two-step"),
        ("--variants", "cad-slicing, two-step", "--variants", "cad-slicing"),
    ],
)
def test_rows_by_list_or_repeated(quick, args):
    result = run(*args, "--seeds", 2)
    assert result.exit_code == 0, result.output
    assert quick == [("cad-slicing", 0), ("cad-slicing", 1), ("two-step", 0), ("two-step", 1)]
    lines = result.output.splitlines()
    assert lines[0].split("\t") == list(HEADER)
    assert [line.split("\t")[0] for line in lines[1:]] == ["cad-slicing", "two-step"]
    assert lines[1].split("\t")[2] == "91.00% +- 1.00%"


@pytest.mark.parametrize("name", ["table.md", "table.json"])
def test_out_writes_both_forms(quick, tmp_path, name):
    result = run("--variants", "paper-mode", "--seeds", 3, "--out", tmp_path / name, "--quiet")
    assert result.exit_code == 0 and result.output == ""
    rows = json.loads((tmp_path / "table.json").read_text())["rows"]
    assert [row["variant"] for row in rows] == ["paper-mode"] and rows[0]["seeds"] == [0, 1, 2]
    text = (tmp_path / "table.md").read_text()
    assert text.startswith(f"| {HEADER[0]} |") and "| paper-mode |" in text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["table.json", "table.md"]


def test_json_is_one_document(quick):
    found = json.loads(run("--json", "--variants", "two-step").output)
    assert found["part"] == "carving" and found["rows"][0]["paper"] == [1.0, 0.26, 0.31, 152.0]


@pytest.mark.parametrize(
    "args",
    [
        ("--variants", "magic"), ("--variants", "two-step,magic"), ("--variants", ""), ("--seeds", 0),
        ("--out", "table.txt"), ("--out", "nowhere/table.md"), ("--part", "nowhere.ply"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_before_anything_is_planned(quick, args, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(*args)
    assert result.exit_code == 2 and quick == []
    assert list(tmp_path.iterdir()) == []


def test_no_variant_and_no_seed(settings):
    with pytest.raises(InputError, match="known: two-step"):
        compare(box_part(0.1, 0.1, 0.1), settings, variants=("magic",))
    with pytest.raises(InputError):
        compare(box_part(0.1, 0.1, 0.1), settings, variants=())
    with pytest.raises(InputError):
        compare(box_part(0.1, 0.1, 0.1), settings, seeds=())


# The two other methods.


def distance_to_polygon(p, corners):
    """Of each point from the boundary of a polygon, by brute force over its sides."""
    a, b = corners, np.roll(corners, -1, axis=0)
    t = np.einsum("pij,ij->pi", p[:, None] - a, b - a) / ((b - a) ** 2).sum(axis=1)
    foot = a + np.clip(t, 0, 1)[..., None] * (b - a)
    return np.linalg.norm(p[:, None] - foot, axis=2).min(axis=1)


@given(st.integers(0, 10_000), st.floats(0.3, 0.9), st.floats(0.1, 0.4))
def test_views_stand_on_the_offset_of_the_profile(seed, standoff, width):
    profile = np.random.default_rng(seed).normal(size=(12, 2)) * [0.2, 0.1]
    corners = profile[ConvexHull(profile).vertices]
    views = _offset(profile, standoff, width)
    p, out = np.array([v for v, _ in views]), -np.array([d for _, d in views])
    assert np.allclose(distance_to_polygon(p, corners), standoff, atol=1e-9)
    assert np.allclose(distance_to_polygon(p - standoff * out, corners), 0.0, atol=1e-9)
    assert np.allclose(np.linalg.norm(out, axis=1), 1.0)
    # Steiner: the offset's length is the perimeter and a full circle; neighbours are one even step apart.
    perimeter = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).sum()
    length = perimeter + 2 * np.pi * standoff
    assert len(views) == max(4, np.ceil(length / width))
    gaps = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1)
    assert (gaps <= length / len(views) + 1e-9).all()


def test_slices_of_a_box():
    scanner = Scanner()
    views = cad_slicing(box_part(0.3, 0.2, 0.6), scanner, standoff=0.7)
    heights = np.unique([round(v.p_OS[2], 9) for v in views])
    tall = 2 * 0.7 * np.tan(np.deg2rad(15)) * 0.9
    assert len(heights) == np.ceil(0.6 / tall) == 2
    assert heights == pytest.approx([0.15, 0.45], abs=2e-3)
    for v in views:
        assert abs(v.direction[2]) < 1e-12 and abs(v.X_OS[2, 0]) == pytest.approx(1.0)
    assert len({v.id for v in views}) == len(views)


@pytest.mark.parametrize("table_z", [0.0, -0.3])
def test_a_small_box_has_one_patch_on_each_face_but_its_base(table_z):
    side, standoff = 0.1, 0.7
    views = surface_partitioning(box_part(side, side, side), Scanner(), standoff=standoff, table_z=table_z)
    faces = {tuple(np.round(-v.direction).astype(int).tolist()) for v in views}
    assert faces == {(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1)} and len(views) == 5
    for v in views:
        normal = np.round(-v.direction)
        middle = normal * side / 2 + [0, 0, side / 2]
        assert np.linalg.norm(v.p_OS + standoff * v.direction - middle) < 0.005
        # Level where the table lets it be, otherwise just above the table.
        level = normal[2] > 0.5 or table_z < 0
        assert np.allclose(-v.direction, normal, atol=1e-9) if level else v.p_OS[2] == pytest.approx(0.15)


def test_an_overhang_is_not_looked_at_through_the_table():
    roof = box_part(0.3, 0.3, 0.04)
    lifted = Part(name="roof", vertices=roof.vertices + [0, 0, 0.1], triangles=roof.triangles)
    post = box_part(0.05, 0.05, 0.1)
    triangles = np.vstack([lifted.triangles, post.triangles + len(lifted.vertices)])
    part = Part(name="mushroom", vertices=np.vstack([lifted.vertices, post.vertices]), triangles=triangles)
    views = surface_partitioning(part, Scanner())
    assert min(v.p_OS[2] for v in views) >= 0.15 - 1e-12
    assert max(v.direction[2] for v in views) < np.sin(np.deg2rad(30))
    deep = surface_partitioning(part, Scanner(), table_z=-1.0)
    assert any(v.direction[2] > 0.99 for v in deep)


def test_patches_of_a_long_box_fit_the_field():
    scanner, standoff = Scanner(), 0.7
    views = surface_partitioning(box_part(0.9, 0.1, 0.1), scanner, standoff=standoff)
    top = [v for v in views if v.direction[2] < -0.99]
    assert len(top) >= np.ceil(0.9 / (0.85 * scanner.field(standoff)[0])) == 3
    # Together their fields reach from end to end.
    x = np.sort([v.p_OS[0] for v in top])
    assert np.diff(x).max() < scanner.field(standoff)[0]
    assert x[0] < -0.45 + scanner.field(standoff)[0] / 2 and x[-1] > 0.45 - scanner.field(standoff)[0] / 2


@pytest.mark.parametrize("method", [cad_slicing, surface_partitioning])
def test_both_methods_need_the_mesh(method):
    cloud = Part(name="cloud", vertices=np.eye(3), triangles=np.zeros((0, 3), int))
    with pytest.raises(PartError):
        method(cloud, Scanner())


@pytest.mark.parametrize("method", [cad_slicing, surface_partitioning])
def test_both_methods_repeat_themselves(method):
    one, two = (method(pitted(), Scanner()) for _ in range(2))
    assert np.array_equal([v.X_OS for v in one], [v.X_OS for v in two]) and len(one) > 4


# The maker of the results page.


@pytest.fixture(scope="module")
def table3():
    return runpy.run_path(str(ROOT / "benchmarks" / "table3.py"))


def test_methods_come_first_then_ablations_then_further_seeds(table3):
    names = ["carving", "a", "b", "c"]
    todo = list(table3["jobs"](names, 2))
    assert len({job.file for job in todo}) == len(todo)
    first = todo[: len(table3["METHODS"]) * len(names)]
    assert {(j.object, j.variant, j.seed) for j in first} == {
        (n, v, 0) for n in names for v in table3["METHODS"]
    }
    half = len(todo) // 2
    assert [j.seed for j in todo] == [0] * half + [1] * half
    assert {j.variant for j in todo} == set(VARIANTS)


def test_a_stopped_run_goes_on_where_it_stopped(table3, tmp_path, monkeypatch):
    ran = []

    def planted(part, settings, variant, *, seed, options=None):
        ran.append((variant, seed))
        if len(ran) == 3:
            raise KeyboardInterrupt
        if variant == "cad-slicing":
            raise PartError("planted")
        return made(variant, seed)

    monkeypatch.setitem(table3["run"].__globals__, "figures", planted)
    todo = list(table3["jobs"](["carving"], 1))
    with pytest.raises(KeyboardInterrupt):
        table3["run"](todo, None, tmp_path, "kr240")
    assert len(list(tmp_path.iterdir())) == 2
    table3["run"](todo, None, tmp_path, "kr240")
    assert ran[2] == ran[3] and len(ran) == len(todo) + 1
    before = len(ran)
    table3["run"](todo, None, tmp_path, "kr240")
    assert len(ran) == before
    results = table3["Results"](todo, tmp_path)
    assert results.errors == {("carving", "cad-slicing"): "PartError: planted"}
    assert set(results.found) == {("carving", v) for v in VARIANTS if v != "cad-slicing"}
    text = table3["page_block"](results)
    assert "PartError: planted" in text and "| carving |" in text


def test_targets_are_counted(table3, tmp_path):
    """Planted: one object inside every target, one outside each."""
    plans = [
        ("good", "two-step", made(integrity=0.9991, of_reach=0.9995, time_s=70.0, floor_s=65.0)),
        ("good", "paper-mode", made("paper-mode", time_s=141.0)),
        ("bad", "two-step", made(integrity=0.9989, mean_abs_mm=0.2, sd_signed_mm=0.2, floor_s=10.0)),
        ("bad", "paper-mode", made("paper-mode", time_s=100.0)),
    ]
    todo = [table3["Job"](name, variant, 0) for name, variant, _ in plans]
    for job, (_, _, found) in zip(todo, plans, strict=True):
        record = {"extent_mm": [1, 2, 3], "figures": {f.name: getattr(found, f.name) for f in fields(found)}}
        (tmp_path / job.file).write_text(json.dumps(record))
    lines = table3["target_table"](table3["Results"](todo, tmp_path)).splitlines()[2:]
    assert len(lines) == 7
    for line in lines:
        assert line.split("|")[2:4] == [" 1 of 2 ", " bad "], line


def test_seconds_until_as_much_is_seen(table3):
    ours = row_from([made(after_global=0.95, integrity=0.99, global_s=40.0, time_s=80.0)])
    for seen, expected in ((0.94, "0.40"), (0.97, "0.80"), (0.995, "")):
        theirs = row_from([made("paper-mode", integrity=seen, time_s=100.0)])
        assert table3["as_far_as"](ours, theirs) == expected
    assert table3["as_far_as"](ours, None) == ""


def test_only_what_stands_between_the_marks_is_replaced(table3, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"words\n{table3['BEGIN']}\nold\n{table3['END']}\nmore\n")
    for _ in range(2):
        table3["write_page"](page, "new\n")
        assert page.read_text() == f"words\n{table3['BEGIN']}\nnew\n{table3['END']}\nmore\n"
    page.write_text("no marks")
    with pytest.raises(SystemExit):
        table3["write_page"](page, "new\n")
    assert page.read_text() == "no marks"


def test_the_results_page_has_its_marks(table3):
    text = table3["PAGE"].read_text(encoding="utf-8")
    assert text.count(table3["BEGIN"]) == text.count(table3["END"]) == 1
