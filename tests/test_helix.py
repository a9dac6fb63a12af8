"""Turns joined to a helix: closed forms of its motion, spoiled ones before the judge, when it is taken."""

import itertools
import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helix_plan import ARMS, helix_files, helix_plan, helix_tour, turning_cell, turns
from judged_plan import Written
from judging import summarised
from test_plan import TINY, pitted

from scanmotion.cell.build import build_cell
from scanmotion.cell.kinematics import scanner_poses
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.errors import InputError, TimingError
from scanmotion.export import export_files
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.judge import verify
from scanmotion.judge.programme.check import verify_programme
from scanmotion.judge.programme.controller import controller_from
from scanmotion.judge.programme.world import ScriptedScanner
from scanmotion.motion.order.helix_choice import joined_stops
from scanmotion.motion.order.lower_bound import least_scanning_seconds
from scanmotion.motion.timing.helix import helix_motion, ramp_angle, turns_of, way_law
from scanmotion.motion.transit_cost import jerk_limited_seconds, move_model, stop_seconds
from scanmotion.plan_io.write import csv_text, plan_files
from scanmotion.planning.pipeline import PlanOptions, plan
from scanmotion.planning.steps import helices as joining

TURN = 2 * np.pi
OVERLAPS = (1.0, 0.5, 0.0)
TRANSIT, HELIX = 0, 1


@pytest.fixture(scope="module")
def cell():
    return turning_cell()


@pytest.fixture(scope="module")
def files(cell):
    return helix_files(cell)


@pytest.fixture
def written(files):
    return Written(files)


def helix_of(cell, overlap):
    (stop,) = helix_tour(cell, overlap)[0].stops
    return stop


# --- the motion -------------------------------------------------------------------------------------


@pytest.mark.parametrize("overlap", OVERLAPS)
def test_the_table_turns_by_the_closed_form_and_the_helix_lasts_as_long(cell, overlap):
    stop = helix_of(cell, overlap)
    motion = helix_motion(cell, stop)
    v, a, j = (0.9995 * x[6] for x in (cell.v_max, cell.a_max, cell.j_max))
    arm = sum(way_law(cell, way)[1].duration for way in stop.ways)
    angle = sum(stop.turns) + v * arm
    assert stop.q_out[6] - stop.q_in[6] == pytest.approx(angle, abs=1e-9)
    assert motion.duration == pytest.approx(angle / v + v / a + a / j, abs=1e-9)
    assert motion.floor <= motion.duration <= stop_seconds(move_model(cell), stop) * 1.002
    # Two neighbours' borders of 20 ms for the one between, one for each end.
    whole = 3 * TURN + (1 - overlap) * v * arm + 4 * 0.02 * v
    assert angle == pytest.approx(whole, abs=1e-9)


def test_turns_by_hand():
    found = turns_of([(1.0, 2.0), (3.0, 1.0)], 1.0, 1.0, 1.1)
    np.testing.assert_allclose(found, [TURN - 1 + 0.02, TURN - 5 + 0.04, TURN - 1 + 0.02])
    found = turns_of([(9.0, 9.0)], 1.0, 1.0, 1.1)
    np.testing.assert_allclose(found, [1.1, 1.1])
    np.testing.assert_allclose(turns_of([(9.0, 9.0)], 0.0, 1.0, 1.1), [TURN + 0.02] * 2)


@pytest.mark.parametrize("overlap", OVERLAPS)
def test_all_limits_hold_and_the_scanner_reaches_its_speed(cell, overlap):
    motion = helix_motion(cell, helix_of(cell, overlap))
    dt = 0.001
    q, qd, qdd = motion(np.arange(0.0, motion.duration + dt, dt))
    for n, limit in enumerate((cell.v_max, cell.a_max, cell.j_max), 1):
        assert (np.abs(np.diff(q, n=n, axis=0)).max(axis=0) / dt**n / limit).max() <= 1.001
    p = scanner_poses(cell, q)[:, :3, 3]
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / dt
    assert 0.099 < speed.max() <= 0.1
    np.testing.assert_allclose(np.gradient(q, dt, axis=0)[1:-1], qd[1:-1], atol=2e-4)
    np.testing.assert_allclose(np.gradient(qd, dt, axis=0)[1:-1], qdd[1:-1], atol=0.05)
    assert np.abs(np.vstack([qd[[0, -1]], qdd[[0, -1]]])).max() < 1e-9


def test_without_overlap_the_arm_stands_for_a_whole_turn_at_each_place(cell):
    stop = helix_of(cell, 0.0)
    motion = helix_motion(cell, stop)
    q, qd, _ = motion(np.arange(0.0, motion.duration, 0.01))
    for place in stop.places:
        still = (np.abs(qd[:, :6]).max(axis=1) < 1e-12) & (np.abs(q[:, :6] - place[:6]).max(axis=1) < 1e-9)
        assert np.ptp(q[still, 6]) >= TURN
    assert np.abs(np.array(stop.places)[:, :6] - np.asarray(cell.home)[:6] - ARMS).max() < 1e-12


@pytest.mark.parametrize("overlap", OVERLAPS)
def test_while_nearest_to_a_place_the_table_makes_a_whole_turn(cell, overlap):
    stop = helix_of(cell, overlap)
    motion = helix_motion(cell, stop)
    q = motion(np.arange(0.0, motion.duration, 0.01))[0]
    p, places = (scanner_poses(cell, x)[:, :3, 3] for x in (q, np.array(stop.places)))
    nearest = np.linalg.norm(p[:, None] - places[None], axis=2).argmin(axis=1)
    assert (np.diff(nearest) >= 0).all()
    for n in range(len(places)):
        assert np.ptp(q[nearest == n, 6]) >= TURN


def test_a_helix_whose_turns_do_not_add_up_is_refused(cell):
    stop = helix_of(cell, 1.0)
    for wrong in (stop.turns[:-1], (stop.turns[0] + 0.1, *stop.turns[1:]), (0.1, 9.0, 5.0)):
        with pytest.raises(TimingError):
            helix_motion(cell, replace(stop, turns=wrong))
    assert ramp_angle(cell) < TURN


# --- which turns are joined ---------------------------------------------------------------------------


def cheapest(cell, lengths, arm, bounds):
    """Least seconds over cuts into runs, senses and start angles on a grid of 90 deg."""
    low, high = bounds
    grid = np.deg2rad(np.arange(-720.0, 721.0, 90.0))

    def seconds(x):
        return (
            float(jerk_limited_seconds(x, cell.v_max[6], cell.a_max[6], cell.j_max[6])) if x > 1e-9 else 0.0
        )

    def rest(i, angle):
        if i == len(arm):
            return 0.0
        best = np.inf
        for j in range(i, len(arm)):
            length = lengths[i, j]
            for start, sense in itertools.product(grid, (1, -1)):
                end = start + sense * length
                if low - 1e-9 <= min(start, end) and max(start, end) <= high + 1e-9:
                    way = max(arm[i], seconds(abs(start - angle)))
                    best = min(best, way + seconds(length) + rest(j + 1, end))
        return best

    return rest(0, 0.0)


@pytest.mark.parametrize("reach_deg", [400.0, 720.0, 1500.0])
@pytest.mark.parametrize("overlap", [1.0, 0.0])
def test_no_cut_and_no_start_on_a_grid_is_faster(cell, reach_deg, overlap):
    bounds = np.deg2rad([-reach_deg, reach_deg])
    settings = load_cell("kr240")
    table = settings.turntable.model_copy(update={"range_deg": (-reach_deg, reach_deg)})
    own = build_cell(settings.model_copy(update={"turntable": table}), cell.part)
    every, arm = turns(own), [6.0, 2.0, 2.0]
    free: Any = SimpleNamespace(path_free=lambda q: (True, -1, ("", "")))
    made = joined_stops(own, free, np.asarray(own.home), every, arm, overlap)
    lengths = {}
    for i, j in itertools.combinations_with_replacement(range(3), 2):
        run = joined_stops(cell, free, np.zeros(7), every[i : j + 1], arm[i : j + 1], overlap)
        assert len(run) == 1
        lengths[i, j] = abs(run[0].q_out[6] - run[0].q_in[6])
    at, first, total = 0.0, 0, 0.0
    for stop in made:
        turn, length = abs(stop.q_in[6] - at), abs(stop.q_out[6] - stop.q_in[6])
        limits = own.v_max[6], own.a_max[6], own.j_max[6]
        total += max(arm[first], float(jerk_limited_seconds(turn, *limits)) if turn > 1e-9 else 0.0)
        total += float(jerk_limited_seconds(length, *limits))
        assert bounds[0] <= min(stop.q_in[6], stop.q_out[6]) <= max(stop.q_in[6], stop.q_out[6]) <= bounds[1]
        at, first = stop.q_out[6], first + len(stop.viewpoints)
    assert [v for s in made for v in s.viewpoints] == ["G0", "G1", "G2"]
    assert total <= cheapest(own, lengths, arm, bounds) + 1e-6


def test_a_way_that_is_blocked_is_not_joined(cell):
    stops = turns(cell)
    whole = helix_motion(cell, helix_of(cell, 1.0))
    second = whole(np.array([whole.leaves[1] + 0.5 * whole.ways[1][1].duration]))[0][0, :6]

    def path_free(q):
        near = np.flatnonzero(np.abs(q[:, :6] - second).max(axis=1) < 0.01)
        return (True, -1, ("", "")) if len(near) == 0 else (False, max(int(near[0]) - 1, 0), ("tool", "part"))

    def free(q):
        return np.abs(q[:, :6] - second).max(axis=1) >= 0.01

    fenced: Any = SimpleNamespace(path_free=path_free, free=free, distance=lambda q: (0.0, ("tool", "part")))
    made = joined_stops(cell, fenced, np.asarray(cell.home), stops, [6.0, 2.0, 2.0], 1.0)
    assert [s.viewpoints for s in made] == [("G0", "G1"), ("G2",)]
    assert [s.kind for s in made] == ["helix", "revolution"]


def test_places_between_which_the_wrist_changes_over_are_not_joined(cell):
    free: Any = SimpleNamespace(path_free=lambda q: (True, -1, ("", "")))
    first, second, third = turns(cell)
    flip = np.array([0, 0, 0, np.pi, 0, -np.pi, 0])
    over = [q * [1, 1, 1, 1, -1, 1, 1] + flip for q in (second.q_in, second.q_out)]
    same, other = scanner_poses(cell, np.array([second.q_in, over[0]]))
    np.testing.assert_allclose(same, other, atol=1e-9)
    stops = [first, replace(second, q_in=over[0], q_out=over[1]), third]
    made = joined_stops(cell, free, np.asarray(cell.home), stops, [6.0, 2.0, 2.0], 1.0)
    assert [s.kind for s in made] == ["revolution"] * 3


def test_the_floor_of_a_helix_is_below_it(cell):
    stop = helix_of(cell, 1.0)
    floor = least_scanning_seconds(move_model(cell), stop, {})
    closed = 3 * TURN / cell.v_max[6] + cell.v_max[6] / cell.a_max[6] + cell.a_max[6] / cell.j_max[6]
    assert floor == pytest.approx(closed)
    assert floor <= helix_motion(cell, stop).duration


# --- the judge ----------------------------------------------------------------------------------------


def spoiled(written, tmp_path):
    return verify(written.write(tmp_path / "plan"))


def told(findings):
    return " ".join(f.message for f in findings)


def bump(written, share, axis, deg, width=60):
    """A smooth excursion of one axis at a share of the helix's time."""
    rows = written.rows_of(HELIX)
    middle = int(share * len(rows))
    own = rows[middle - width : middle + width + 1]
    written.deg[own, axis] += deg * np.sin(np.linspace(0, np.pi, len(own))) ** 4


def half_way(cell):
    """The share of the helix's time at which the arm is half-way from the first place to the second."""
    motion = helix_motion(cell, helix_of(cell, 1.0))
    return (motion.leaves[0] + 0.5 * motion.ways[0][1].duration) / motion.duration


def test_an_unspoiled_helix_passes(written, tmp_path):
    assert [o["kind"] for o in written.plan["operations"]] == ["transit", "helix"]
    assert spoiled(written, tmp_path) == []


def test_a_helix_that_is_too_fast_is_found(written, tmp_path):
    written.retimed(HELIX, 0.97 * (written.t[-1] - written.plan["operations"][HELIX]["t_start"]))
    found = spoiled(written, tmp_path)
    assert ("tcp_speed", "helix") in {(f.code, f.where) for f in found}
    assert ("velocity", "E1") in {(f.code, f.where) for f in found}


@pytest.mark.parametrize("share", [0.99, 0.8])
def test_a_helix_of_less_than_whole_turns_is_found(written, tmp_path, share):
    own = written.rows_of(HELIX)
    start = written.deg[own[0] - 1, 6]
    written.deg[own, 6] = start + share * (written.deg[own, 6] - start)
    written.agree()
    found = [f for f in spoiled(written, tmp_path) if "instead of 360" in f.message]
    assert {f.where for f in found} == {"G0", "G1", "G2"}


def test_an_arm_that_sets_out_too_early_is_found(written, tmp_path):
    own = written.rows_of(HELIX)
    early = np.minimum(np.arange(len(own)) + 40, len(own) - 1)
    arm = written.deg[own][:, :6][early]
    blend = np.clip(np.arange(len(own)) / 100, 0, 1)[:, None]
    written.deg[own, :6] += blend * (arm - written.deg[own, :6])
    written.agree()
    found = [f for f in spoiled(written, tmp_path) if "instead of 360" in f.message]
    assert [f.where for f in found] == ["G0"]


def test_a_table_that_turns_back_is_found(written, tmp_path):
    bump(written, 0.3, 6, -60.0)
    assert "turns back" in told(spoiled(written, tmp_path))


def test_a_scanner_that_leaves_its_line_is_found(written, tmp_path, cell):
    bump(written, half_way(cell), 0, 1.0)
    assert "beside the straight line on the way from G0 to G1" in told(spoiled(written, tmp_path))


def test_a_scanner_that_looks_aside_is_found(written, tmp_path, cell):
    bump(written, half_way(cell), 4, 12.0)
    assert "deg aside on the way from G0 to G1" in told(spoiled(written, tmp_path))


def test_an_arm_that_is_not_where_the_viewpoint_is_is_found(written, tmp_path):
    own = written.rows_of(HELIX)
    written.deg[own, 1] += 1.0 * np.clip(np.arange(len(own)) / 100, 0, 1)
    written.agree()
    found = {(f.code, f.where) for f in spoiled(written, tmp_path)}
    assert {("viewpoint", "G1"), ("viewpoint", "G2")} <= found


def test_a_helix_past_a_station_is_found(written, tmp_path):
    written.plan["viewpoints"][1]["kind"] = "station"
    assert "G1 asks for a station, operation 1 is a helix" in told(spoiled(written, tmp_path))


@pytest.mark.parametrize(
    ("serves", "text"),
    [(["G2", "G1", "G0"], "out of order"), (["G0"], "does not serve two"), (["G0", "G9", "G2"], "G9")],
)
def test_a_helix_that_serves_otherwise_is_found(written, tmp_path, serves, text):
    written.plan["operations"][HELIX]["viewpoints"] = serves
    assert text in told(spoiled(written, tmp_path))


def test_a_moving_arm_called_a_revolution_is_found(written, tmp_path):
    written.plan["operations"][HELIX]["kind"] = "revolution"
    assert "the arm moves" in told(spoiled(written, tmp_path))


def test_a_part_in_the_way_of_a_helix_is_a_collision(tmp_path, cell):
    taller = helix_plan(cell)
    taller.cell = build_cell(cell.settings, box_part(1.3, 1.3, 1.2))
    found = verify(Written(plan_files(taller)).write(tmp_path / "plan"))
    assert any(f.code in ("collision", "clearance") and "part" in f.where for f in found)


# --- exports ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(files, tmp_path_factory):
    return Written(files).write(tmp_path_factory.mktemp("helix") / "plan")


def test_tables_call_it_a_helix_and_the_scanner_is_on(folder, tmp_path):
    (path,) = export_files(folder, "csv", out=tmp_path)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    at = {name: k for k, name in enumerate(rows[0])}
    own = [r for r in rows[1:] if r[at["kind"]] == "helix"]
    assert own and {r[at["scanning"]] for r in own} == {"1"}
    assert {r[at["viewpoints"]] for r in own} == {"G0 G1 G2"}
    (path,) = export_files(folder, "json", out=tmp_path)
    assert [(o["kind"], o["scanning"]) for o in json.loads(path.read_text())["operations"]] == [
        ("transit", False), ("helix", True),
    ]  # fmt: skip


@pytest.mark.parametrize("to", ["krl", "krl-timed"])
def test_krl_programmes_drive_the_helix_and_back_after_a_fault(to, folder, tmp_path):
    file = export_files(folder, to, out=tmp_path, name="scan_a")[0]
    assert verify_programme(file, folder, clearance=False).findings == ()
    controller = controller_from(file, folder)
    signals = controller.signals
    scanner = ScriptedScanner(signals=signals, faults=frozenset([1]), fault_after=6.0, patience=1)
    run, _ = controller.run(scanner)
    assert run.ended and scanner.recordings == 2
    own = run.q[run.step == HELIX + 1]
    start = np.rad2deg(controller.trajectory.operations[HELIX].q_start)
    away = np.abs(own - start).max(axis=1)
    # It went some way, came back to the start by small steps of the same path, and went again.
    gone = int(np.flatnonzero(away > 20)[0])
    home = gone + int(away[gone:].argmin())
    assert away[home] < 1e-3 and away[-1] > 3 * away[:home].max()


# --- when it is taken ---------------------------------------------------------------------------------


def leg(seconds, kinds=("revolution", "revolution")):
    stops = tuple(SimpleNamespace(kind=k, viewpoints=("G0", "G1")[: 1 + (k == "helix")]) for k in kinds)
    return SimpleNamespace(
        trajectory=SimpleNamespace(duration=seconds), tour=SimpleNamespace(stops=stops)
    )  # fmt: skip


@pytest.mark.parametrize(
    ("seen", "taken", "scans"),
    [
        ({30.0: 9990, 35.0: 10_000, 40.0: 10_000}, 30.0, 2),
        ({30.0: 9989, 35.0: 9991, 40.0: 10_000}, 35.0, 3),
        ({30.0: 9000, 35.0: 9000, 40.0: 9000}, 50.0, 4),
        ({}, 50.0, 1),
    ],
)
def test_the_fastest_is_taken_that_sees_all_but_a_thousandth(monkeypatch, seen, taken, scans):
    order, asked = iter([35.0, 30.0, 40.0] if seen else [None] * 3), []

    def form(*args: Any, rng):
        seconds = next(order)
        return None if seconds is None else leg(seconds, ("helix",))

    def simulated(trajectory, rng):
        asked.append(trajectory.duration)
        mask = np.arange(20_000) < {50.0: 10_000, **seen}[trajectory.duration]
        return SimpleNamespace(seen=mask)

    monkeypatch.setattr(joining, "joined_segment", form)
    nothing: Any = None
    still: Any = leg(50.0)
    made = joining.fastest_form(nothing, nothing, still, simulated, np.random.default_rng(0))  # type: ignore[arg-type]
    assert made.segment.trajectory is not None and made.segment.trajectory.duration == taken
    assert made.joining.taken == (taken < 50.0)
    assert f"{taken:.1f} s" in made.joining.note
    assert len(asked) == scans and made.scan.seen.sum() == {50.0: 10_000, **seen}[taken]


def test_what_no_twin_scans_cannot_be_compared():
    for source in ("box", "scan"):
        with pytest.raises(InputError, match="not scanned by the twin"):
            PlanOptions(source=source, helix=True)


@pytest.fixture(scope="module")
def allowed():
    """The global step of the pitted block, turns joined where the twin allows it."""
    return plan(
        pitted(), load_cell("kr240"), options=PlanOptions(seed=5, helix=True, **(TINY | {"rounds": 0}))
    )


def test_without_the_option_nothing_is_said_of_it(pitted_plan):
    assert "helix" not in pitted_plan.summary.document()
    assert all(o.kind != "helix" for o in pitted_plan.trajectory.operations)


def test_not_taken_the_plan_is_that_without_the_option(pitted_plan, monkeypatch):
    monkeypatch.setattr(joining, "joined_segment", lambda *a, **k: None)
    options = PlanOptions(seed=5, helix=True, **(TINY | {"rounds": 0}))
    made = plan(pitted(), load_cell("kr240"), options=options)
    assert made.joining is not None and made.joining.taken is False
    text = csv_text(made.trajectory).splitlines()
    assert csv_text(pitted_plan.trajectory).splitlines()[: len(text)] == text
    assert np.array_equal(made.segments[0].seen, pitted_plan.segments[0].seen)


def test_taken_it_is_faster_and_judged(allowed, pitted_plan):
    still = next(r for r in pitted_plan.segments if r.step == "global")
    assert allowed.joining.taken
    assert allowed.trajectory.duration < still.trajectory.duration
    assert allowed.joining.still_seconds == pytest.approx(still.trajectory.duration, abs=1e-3)
    assert allowed.segments[0].seen.sum() >= 0.999 * still.seen.sum()
    assert any(o.kind == "helix" for o in allowed.trajectory.operations)
    judged = summarised(allowed)
    assert judged.summary.findings == [] and judged.summary.helix.taken
    assert judged.summary.time_s.floor <= allowed.trajectory.duration
    served = {v for o in allowed.trajectory.operations if o.scanning for v in o.viewpoints}
    assert served == {v.id for v in still.served}
