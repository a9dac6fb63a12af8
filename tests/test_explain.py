"""Which stage lost what: every viewpoint is counted once, and an empty plan says where it ended."""

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.core.summary import NOT_WORTH
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.planning.explain import explained, losing_stage
from scanmotion.planning.options import PlanOptions
from scanmotion.planning.pipeline import plan
from scanmotion.report.used import used_packages


@pytest.mark.parametrize(
    ("reason", "stage"),
    [
        ("out of reach: the wrist would have to be 90 mm closer in than the arm goes", "reach"),
        ("joint limit: A5 would pass its limit by 3.0 deg", "reach"),
        ("collision: scanner and table touch", "reach"),
        ("the table's range of 300 deg holds no whole turn", "order"),
        ("no collision-free way there: a and b touch on the way", "way there"),
        (f"{NOT_WORTH}: it would cost 5.0 s", "worth"),
        ("no seconds are left for it in the budget: it adds 0.1 %", "budget"),
        ("the table hides what a view from below would see", "candidates"),
    ],
)
def test_reasons_belong_to_their_stage(reason, stage):
    assert losing_stage(reason) == stage


def test_every_viewpoint_is_counted_once():
    made = plan(box_part(0.33, 0.2, 0.6), load_cell("kr240"), options=PlanOptions(source="box"))
    stages = explained(made)
    assert [s.name for s in stages] == [
        "candidates",
        "reach",
        "order",
        "way there",
        "worth",
        "budget",
        "served",
    ]
    known = {v.id for v in made.viewpoints} | {name for name, _ in made.dropped}
    served = {v.id for item in made.segments for v in item.served}
    assert stages[0].given == len(known) and stages[-1].given == len(served)
    assert sum(s.lost for s in stages) == len(known) - len(served)
    assert all(sum(n for _, n, _ in s.causes) == s.lost for s in stages[:-1])
    assert stages[0].lost == 1 and stages[0].causes[0][2].startswith("VPn: the table hides")
    assert "4 by analytic" in stages[1].note
    used = dict(used_packages(made))
    ways = [path.method for item in made.segments for path in item.paths]
    assert ("ompl" in used) == ("planned" in ways)
    transits = [o for o in made.trajectory.operations if o.kind == "transit"]
    assert used["toppra"] == f"time profile of {len(transits)} transits"
    assert "py-opw-kinematics" in used and "by search" not in used["drake"]
    parallel = replace(made, cell=build_cell(load_cell("ur10e")))
    assert "py-opw-kinematics" not in dict(used_packages(parallel))
    assert "toppra" not in dict(used_packages(replace(made, trajectory=None)))


def test_an_empty_plan_says_where_it_ended(tmp_path):
    """A wall round the table: nothing is reached, and the line of reach says so."""
    walls = "\n".join(
        f"  - {{name: wall {n}, centre_m: [{2.2 + x}, {y}, 1.6], size_m: [0.3, 0.3, 3.0]}}"
        for n, (x, y) in enumerate([(-0.95, -0.4), (-0.95, 0.0), (-0.95, 0.4)])
    )
    (tmp_path / "cell.yaml").write_text(f"robot: {{home_deg: [0, -90, 90, 0, 0, 0]}}\nobstacles:\n{walls}\n")
    words = [
        "plan",
        "--cell",
        str(tmp_path / "cell.yaml"),
        "--box",
        "60",
        "60",
        "60",
        "--out",
        str(tmp_path / "o"),
    ]
    done = CliRunner().invoke(app, [*words, "--explain", "--no-html", "--json"])
    told = json.loads(done.output[: done.output.rindex("}") + 1]) if "{" in done.output else {}
    assert "explain" in told, done.output[:500]
    by_name = {stage["name"]: stage for stage in told["explain"]}
    assert by_name["reach"]["lost"] > 0 or by_name["way there"]["lost"] > 0
    assert by_name["served"]["given"] == by_name["candidates"]["given"] - sum(
        stage["lost"] for stage in told["explain"]
    )
