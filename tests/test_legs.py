"""What a segment leaves out for its seconds, and that the seconds are true."""

import re

import numpy as np
import pytest

from scanmotion.cell.build import build_cell
from scanmotion.cell.collision.clearance import Clearance
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.planning.segment import segment_from

DEAR = re.compile(r"not worth its seconds: it would cost (\d+\.\d) s")


@pytest.fixture(scope="module")
def cell():
    return build_cell(load_cell("kr240"), box_part(0.2, 0.15, 0.25))


@pytest.fixture(scope="module")
def clearance(cell):
    return Clearance(cell)


@pytest.fixture(scope="module")
def views():
    """A turn, and stations at three heights about it."""
    made = []
    for k, (azimuth, tilt) in enumerate([(0.0, 0.2), (0.5, 0.9), (-0.4, 1.2), (2.0, 0.4)]):
        out = np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)])
        made.append(
            Viewpoint(
                id=f"V{k}", X_OS=look_at([0, 0, 0.12] + 0.65 * out, -out), standoff=0.65, step="local",
                kind="station" if k else "revolution", slack=Slack(roll=True),
            )
        )  # fmt: skip
    return tuple(made)


@pytest.fixture(scope="module")
def segments(cell, clearance, views):
    """By what each viewpoint may cost [s]; the same draws for all."""

    def made(worth=None, **options):
        rng = np.random.default_rng(3)
        return segment_from(cell, clearance, views, cell.home, worth=worth, rng=rng, **options)

    return made


@pytest.fixture(scope="module")
def whole(segments):
    return segments()


def test_all_are_served_where_nothing_is_too_dear(segments, whole, views):
    assert whole.unreachable == () and set(whole.served) == set(views)
    rich = segments({v.id: 1e6 for v in views})
    assert rich.trajectory.q.tobytes() == whole.trajectory.q.tobytes()
    # What is not named may cost anything.
    assert segments({}).trajectory.q.tobytes() == whole.trajectory.q.tobytes()


def test_a_segment_from_which_all_is_left_out_is_empty(segments, views):
    poor = segments({v.id: 0.0 for v in views})
    assert poor.trajectory is None and poor.tour.stops == () == poor.served
    assert {name for name, reason in poor.unreachable if DEAR.fullmatch(reason)} == {v.id for v in views}


@pytest.mark.parametrize("name", ["V0", "V1", "V2", "V3"])
def test_what_is_left_out_saves_what_it_would_have_cost(segments, whole, name):
    poor = segments({name: 0.0})
    assert [lost for lost, _ in poor.unreachable] == [name]
    cost = float(DEAR.fullmatch(poor.unreachable[0][1])[1])
    assert cost > 0.2
    # The direct way past it is foreseen to within some tenths of a second, or another order is better still.
    saved = whole.trajectory.duration - poor.trajectory.duration
    assert saved > cost - 0.6
    stays = segments({name: cost + 0.1})
    assert stays.unreachable == () and stays.trajectory.q.tobytes() == whole.trajectory.q.tobytes()


def test_a_way_too_long_is_not_driven(segments, whole, views):
    ways = {o.viewpoints: o.t_end - o.t_start for o in whole.trajectory.operations if o.kind == "transit"}
    longest = max(ways, key=ways.__getitem__)
    limit = 0.5 * (ways[longest] + sorted(ways.values())[-2])
    left = segments(longest_way=limit)
    assert left.unreachable[0][0] == longest[0]
    assert f"the way there takes {ways[longest]:.1f} s" in left.unreachable[0][1]
    # What stays has short ways, or nothing stays.
    operations = left.trajectory.operations if left.trajectory is not None else ()
    assert all(o.t_end - o.t_start <= limit for o in operations if o.kind == "transit")
    assert len(left.served) + len(left.unreachable) == len(views) and bool(operations) == bool(left.served)
