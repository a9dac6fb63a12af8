"""`scanmotion reach`: what it says is what reach finds, one layout or a sweep of layouts."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell, settings_from
from scanmotion.cli.app import app
from scanmotion.cli.cells.arms import DISTANCES_M, HEIGHTS_M, moved_table, reach_record, sweep_rows
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.motion.reach.find import ReachOptions, reach


def views():
    """From low to so high that some layouts do not reach them."""
    out = []
    for k, (h, a) in enumerate((h, a) for h in (0.1, 0.9, 1.5, 2.1) for a in (0.3, 2.0)):
        u = np.array([math.cos(a), math.sin(a), 0.0])
        X = look_at(0.9 * u + [0, 0, h], np.array([0, 0, -0.6 * (h > 1)]) - u)
        out.append(
            Viewpoint(id=f"V{k}", X_OS=X, standoff=0.7, step="local", kind="station", slack=Slack(roll=False))
        )
    return tuple(out)


def test_the_sweep_is_reach_in_each_layout():
    settings = settings_from({"base": {"position_m": [0.5, 0.2, 0.0], "yaw_deg": 30.0}, "turntable": {
        "position_m": [0.5 + 2.2 * math.cos(0.5), 0.2 + 2.2 * math.sin(0.5)]}})  # fmt: skip
    part, asked, told = box_part(0.6, 0.33, 0.2), views(), []
    rows = sweep_rows(settings, part, asked, lambda stage, fraction: told.append(fraction))
    assert [(r["distance_m"], r["height_m"]) for r in rows] == [
        (d, h) for d in DISTANCES_M for h in HEIGHTS_M
    ]
    assert told == sorted(told) and 0 <= told[-1] < 1
    shares = {r["share"] for r in rows}
    assert len(shares) > 1 and all(0 <= s <= 1 for s in shares)
    for row in rows[::5]:
        moved = moved_table(settings, row["distance_m"], row["height_m"])
        cell = build_cell(moved, part)
        assert np.linalg.norm(cell.X_WT[:2, 3] - cell.X_WB[:2, 3]) == pytest.approx(row["distance_m"])
        assert cell.X_WT[2, 3] == row["height_m"]
        way = cell.X_WT[:2, 3] - cell.X_WB[:2, 3]
        assert math.atan2(way[1], way[0]) == pytest.approx(0.5)
        found = reach(cell, asked, options=ReachOptions(remedies=False))
        assert row["share"] == sum(r.unreachable is None for r in found) / len(asked)


def test_a_layout_that_cannot_be_has_no_share(monkeypatch):
    monkeypatch.setattr("scanmotion.cli.cells.arms.DISTANCES_M", (9.0,))
    monkeypatch.setattr("scanmotion.cli.cells.arms.HEIGHTS_M", (0.7,))
    rows = sweep_rows(load_cell("kr240"), None, views(), lambda stage, fraction: None)
    assert rows == [{"distance_m": 9.0, "height_m": 0.7, "share": None}]


def test_a_record_holds_what_was_found():
    cell = build_cell(load_cell("kr240"), box_part(0.6, 0.33, 0.2))
    for item in reach(cell, views()):
        record = reach_record(item)
        assert record["configurations"] == len(item.q)
        if item.unreachable is None:
            assert record["clearance_mm"] == pytest.approx(1e3 * item.clearance.max(), abs=0.06)
            assert record["manipulability"] == pytest.approx(item.manipulability.max(), abs=6e-4)
            assert record["unreachable"] is None
            continue
        assert record["clearance_mm"] is None and record["manipulability"] is None
        lost, change = record["unreachable"], item.unreachable.change
        assert lost["cause"] == item.unreachable.cause
        assert ("raise_m" in lost) == (change is not None)


def test_the_command_prints_and_writes():
    runner = CliRunner()
    out = runner.invoke(app, ["reach", "--robot", "kr240", "--box", "600", "330", "200", "--json"])
    assert out.exit_code == 0, out.output
    rows = json.loads(out.stdout)
    assert rows and all(r["configurations"] > 0 for r in rows)
    swept = runner.invoke(
        app, ["reach", "--robot", "kr240", "--box", "600", "330", "200", "--sweep", "--json"]
    )
    assert swept.exit_code == 0, swept.output
    assert len(json.loads(swept.stdout)) == len(DISTANCES_M) * len(HEIGHTS_M)
    table = runner.invoke(app, ["reach", "--robot", "kr240", "--box", "600", "330", "200", "--sweep"])
    assert table.exit_code == 0 and "%" in table.stdout
