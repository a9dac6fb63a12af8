"""What people read first: one sentence, what is left out and why, a sheet to sign; readable labels."""

from dataclasses import replace

import numpy as np
import pytest
from fake_plan import fake_plan

from scanmotion.cli.inputs import meta_from
from scanmotion.core.errors import InputError
from scanmotion.core.summary import NOT_WORTH, Summary
from scanmotion.report.figures.labels import label_offsets
from scanmotion.report.words import GLOSSARY, first_sentence, hidden_shares, sheet


@pytest.fixture(scope="module")
def plan(kr240_cell):
    return fake_plan(kr240_cell)


def told(plan, **changes):
    return Summary.model_validate(plan.summary.document() | changes)


def test_the_first_sentence_names_share_seconds_and_the_underside(plan):
    """Of the block 0.2 x 0.15 x 0.4 m, the underside alone is hidden: its share is known in closed form."""
    down = plan.samples.normals[:, 2] < -0.5
    said = first_sentence(plan, told(plan, completeness={"after_global": 0.8, "final": 0.9989,
                                                         "final_of_whole": 0.9}))  # fmt: skip
    share = 0.2 * 0.15 / (2 * (0.2 * 0.15 + 0.2 * 0.4 + 0.15 * 0.4))
    hidden, under = hidden_shares(plan)
    assert hidden == under == np.mean(down) == pytest.approx(share, abs=0.015)
    assert said.startswith("99.8 % of what a scanner can see is scanned in 14 s; the underside")
    assert "turn the object over" in said
    all_seen = replace(plan, visible=np.ones(len(down), bool))
    assert first_sentence(all_seen, plan.summary).endswith("scanned in 14 s.")
    sides = replace(plan, visible=down)
    assert "cannot be seen as the object stands" in first_sentence(sides, plan.summary)
    none = {"after_global": None, "final": None, "final_of_whole": None}
    assert "not known" in first_sentence(replace(plan, samples=None), told(plan, completeness=none))


def test_what_is_not_worth_its_seconds_is_apart_from_what_is_unreachable(plan):
    dear = (("L9", f"{NOT_WORTH}: it would cost 3.0 s"),)
    made = replace(plan, dropped=dear)
    assert made.not_worth == dear
    assert [name for name, _ in made.unreachable] == ["L2.1"]
    assert sorted(made.left_out) == sorted(made.unreachable + made.not_worth)


def test_a_plan_says_itself_in_one_line_and_as_a_table(plan):
    made = replace(plan, part=replace(plan.part, name="a<b>"))
    assert repr(made) == (
        "Plan(part: a<b>; viewpoints served: 2; time: 13.5 s; scanned, of what can be seen: 100.00%; "
        "unreachable: 1; checks: 0 findings)"
    )
    shown = made._repr_html_()
    assert "<td>a&lt;b&gt;</td>" in shown and shown.count("<tr>") == repr(made).count(":")
    assert "not judged yet" in repr(replace(plan, summary=None))


def test_the_sheet_shows_what_was_noted_and_leaves_the_rest_open():
    page = sheet({"operator": "A <Meier>", "light": "dim"})
    assert "<th>operator</th><td>A &lt;Meier&gt;</td>" in page and "<th>light</th><td>dim</td>" in page
    for open_line in ("object", "date", "notes", "signature, date"):
        assert f"<th>{open_line}</th><td></td>" in page


def test_notes_are_key_and_value():
    assert meta_from(["object = Inv. 4=11", "a=b"]) == {"object": "Inv. 4=11", "a": "b"}
    for wrong in (["object"], ["=x"], ["x="], ["a=1", "a=2"], ["k" * 41 + "=1"]):
        with pytest.raises(InputError, match="--meta"):
            meta_from(wrong)


def test_notes_are_saved_and_come_back(pitted_plan, tmp_path):
    from scanmotion.plan_io.load import load_plan

    noted = {"object": "Inv. 4711", "operator": "A. Meier"}
    replace(pitted_plan, meta=noted).save(tmp_path / "plan")
    loaded = load_plan(tmp_path / "plan")
    assert dict(loaded.meta) == loaded.summary.meta == noted
    assert loaded.unreachable == pitted_plan.unreachable and loaded.not_worth == pitted_plan.not_worth


def test_no_two_labels_overlap_and_none_hides_a_point(rng):
    points = np.vstack([rng.uniform(0, 300, (60, 2)), np.tile([50.0, 50.0], (12, 1))])
    sizes = np.column_stack([rng.uniform(8, 30, len(points)), np.full(len(points), 8.0)])
    offsets = label_offsets(points, sizes)
    placed = [n for n, offset in enumerate(offsets) if offset is not None]
    assert len(placed) > 50
    middles = {n: points[n] + offsets[n] for n in placed}
    for n in placed:
        assert not (np.abs(points - middles[n]) < sizes[n] / 2).all(axis=1).any()
        for m in placed:
            apart = np.abs(middles[n] - middles[m]) >= (sizes[n] + sizes[m]) / 2 - 1e-9
            assert n == m or apart.any()


def test_every_term_is_explained_once():
    words = [word for word, _ in GLOSSARY]
    assert len(set(words)) == len(words) >= 12
    assert all(len(meaning) > 15 for _, meaning in GLOSSARY)
