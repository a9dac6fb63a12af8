"""The paper's experiments: the tour's lengths against brute force, and the whole page."""

import itertools
import json

import numpy as np
import pytest
from test_plan import TINY, pitted

from scanmotion.cell.settings.cell import load_cell
from scanmotion.planning.options import PlanOptions
from scanmotion.report.paper import (
    METHODS,
    paper_experiments,
    paper_html,
    paper_record,
    situations_figure,
    tour_lengths,
)


def test_the_tour_is_the_shortest_of_all_orders(rng):
    places = rng.random((7, 3))
    found = tour_lengths(places, rng=np.random.default_rng(0))
    every = [
        np.linalg.norm(np.diff(places[list(o)], axis=0), axis=1).sum()
        for o in itertools.permutations(range(7))
    ]
    assert found.optimised == pytest.approx(min(every)) and found.bound <= min(every) + 1e-9
    assert found.as_found == pytest.approx(every[0])
    assert found.at_random == pytest.approx(np.mean(every), rel=0.05)
    none = tour_lengths(np.zeros((0, 3)), rng=rng)
    assert none.places == 0 and none.optimised == 0


def test_the_four_situations_are_drawn():
    figure = situations_figure(load_cell("kr240"))
    views = [int(ax.get_title(loc="left").split(", ")[1].split()[0]) for ax in figure.axes]
    assert views[:4] == [1, 2, 2, 4]


@pytest.mark.slow
def test_the_whole_page():
    found = paper_experiments(pitted(), load_cell("kr240"), options=PlanOptions(**TINY))
    record = paper_record(found)
    html = paper_html(found)
    assert html.count("data:image/png") == 6 and "763.9" in html and "585.7" in html
    assert [row.variant for row in found.table] == list(METHODS)
    assert record["budgets_s"]["wood carving, section 4"]["kept"]
    json.dumps(record, allow_nan=False)
