"""Strict YAML: what is wrong is named by its dotted key in one line; a template reads back as what it was."""

import math

import fcl
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from scanmotion.cell.build import build_cell, check_room
from scanmotion.cell.settings.cell import CellSettings, builtin_cells, cell_template, load_cell, settings_from
from scanmotion.core.errors import CellError, ScanMotionError
from scanmotion.geometry.parts.make_part import box_part

FAULTS = [
    ({"turntable": {"heigth_m": 0.7}}, "turntable.heigth_m", "unknown"),
    ({"robots": {}}, "robots", "unknown"),
    ({"obstacles": [{"name": "a", "centre_m": [0, 0, 0], "size_m": [1, 1, 1], "colour": 1}]},
     "obstacles.0.colour", "unknown"),
    ({"turntable": {"height_m": 700}}, "turntable.height_m", "metres"),
    ({"turntable": {"diameter_m": 1520.0}}, "turntable.diameter_m", "metres"),
    ({"process": {"standoff_m": 700}}, "process.standoff_m", "metres"),
    ({"process": {"clearance_m": 30}}, "process.clearance_m", "metres"),
    ({"tool": {"tilt_deg": 1000}}, "tool.tilt_deg", "degrees"),
    ({"turntable": {"height_m": -0.1}}, "turntable.height_m", "below"),
    ({"turntable": {"height_m": float("nan")}}, "turntable.height_m", "finite"),
    ({"turntable": {"height_m": float("inf")}}, "turntable.height_m", "finite"),
    ({"base": {"position_m": [0, float("nan"), 0]}}, "base.position_m.1", "finite"),
    ({"turntable": {"height_m": "0.7 m"}}, "turntable.height_m", "number"),
    ({"turntable": {"height_m": True}}, "turntable.height_m", "number"),
    ({"turntable": {"height_m": None}}, "turntable.height_m", "number"),
    ({"turntable": {"position_m": [2.2]}}, "turntable.position_m", ""),
    ({"turntable": {"position_m": [2.2, 0, 0]}}, "turntable.position_m", ""),
    ({"turntable": [1, 2]}, "turntable", ""),
    ({"robot": {"acceleration": "fast"}}, "robot.acceleration", ""),
    ({"robot": {"velocity_scale": 1.5}}, "robot.velocity_scale", "above"),
    ({"scanner": {"rays": [424]}}, "scanner.rays", ""),
    ({"name": 3}, "name", ""),
]  # fmt: skip


@pytest.mark.parametrize(("data", "key", "word"), FAULTS, ids=lambda v: str(v)[:40])
def test_a_fault_is_named_in_one_line(data, key, word):
    with pytest.raises(CellError) as caught:
        settings_from(data)
    text = str(caught.value)
    assert key in text and word in text
    assert "\n" not in text and len(text) < 400 and "pydantic" not in text
    assert isinstance(caught.value, ScanMotionError)


JOINT_FAULTS = [
    ({"scanner": {"range_m": [1.0, 0.4]}}, "scanner.range_m"),
    ({"process": {"standoff_m": 0.3}}, "process.standoff_m"),
    ({"turntable": {"range_deg": [-90, 90]}}, "turntable.range_deg"),
    ({"robot": {"home_deg": [0, 0, 0]}}, "robot.home_deg"),
    ({"robot": {"acceleration": [1, 1, 1, 1, 1, -1]}}, "robot.acceleration"),
    ({"scanner": {"rays": [4, 4]}}, "scanner.rays"),
]


@pytest.mark.parametrize(("data", "key"), JOINT_FAULTS, ids=lambda v: str(v)[:40])
def test_settings_that_disagree_are_refused(data, key):
    with pytest.raises(CellError, match=key.replace(".", r"\.")):
        settings_from(data)


@pytest.mark.parametrize(
    ("data", "key"),
    [
        ({"robot": {"model": "kr999"}}, "robot.model"),
        ({"robot": {"model": "../robots/kr240"}}, "robot.model"),
        ({"robot": {"home_deg": [0, 0, 0, 0, 0, 0]}}, "robot.home_deg"),
        ({"robot": {"joints": ["A1", "A2", "A3", "A4", "A5", "A7"]}}, "robot.joints"),
        ({"robot": {"flange": "nothing"}}, "robot.flange"),
        ({"turntable": {"position_m": [9.0, 0.0]}}, "robot.home_deg"),
    ],
    ids=lambda v: str(v)[:40],
)
def test_a_cell_that_cannot_be_built_says_which_key(data, key):
    with pytest.raises(CellError) as caught:
        build_cell(settings_from(data))
    assert caught.value.key == key and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", builtin_cells())
def test_template_reads_back_as_the_cell(name, tmp_path):
    path = tmp_path / "cell.yaml"
    path.write_text(cell_template(name))
    again, first = load_cell(path), load_cell(name)
    assert again.model_dump() == first.model_dump()
    # Each key of each section stands in the file, most with what it means.
    text = path.read_text()
    for section in ("robot", "turntable", "process"):
        for key in type(getattr(first, section)).model_fields:
            assert f"  {key}: " in text
    assert text.count("#") > 30


@given(
    st.floats(0.1, 1.5), st.floats(0.1, 3.0), st.floats(-180, 180), st.floats(0.45, 0.95), st.booleans(),
)  # fmt: skip
def test_any_settings_survive_yaml(height, diameter, yaw, standoff, endless):
    data = {
        "turntable": {"height_m": height, "diameter_m": diameter, "endless": endless},
        "base": {"yaw_deg": yaw},
        "process": {"standoff_m": standoff},
        "obstacles": [{"name": "post", "centre_m": [1, 2, 3], "size_m": [height, 1, 1]}],
    }
    first = settings_from(data)
    again = settings_from(yaml.safe_load(yaml.safe_dump(first.model_dump(mode="json"))))
    assert again == first
    assert again.base.yaw_deg == yaw and again.turntable.endless is endless


@pytest.mark.parametrize(
    "text",
    ["", "- 1\n- 2\n", "robot: [", "a: !!python/object/apply:os.getcwd []", "x: *y", "\x00", "3"],
)
def test_what_is_no_cell_is_refused_in_one_line(text, tmp_path):
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    with pytest.raises(CellError) as caught:
        load_cell(path)
    assert "\n" not in str(caught.value) and "cell.yaml" in str(caught.value)


def test_binary_and_huge_files_are_refused(tmp_path):
    path = tmp_path / "cell.yaml"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(CellError, match="readable"):
        load_cell(path)
    path.write_text("# " + "x" * (1 << 20) + "\n")
    with pytest.raises(CellError, match="1 MiB"):
        load_cell(path)


def test_unknown_names_list_what_is_known():
    with pytest.raises(CellError) as caught:
        load_cell("kr241")
    assert all(name in str(caught.value) for name in builtin_cells())


def test_settings_are_frozen_and_in_si_where_they_leave():
    settings = load_cell("kr240")
    with pytest.raises(Exception, match="frozen"):
        settings.name = "x"  # pyright: ignore[reportAttributeAccessIssue]
    scanner = settings.scanner_model()
    assert scanner.fov == pytest.approx((math.radians(30), math.radians(21)))
    assert scanner.sigma_at_near == pytest.approx(5e-5)
    cell = build_cell(settings)
    assert cell.v_max[6] == pytest.approx(10 * 2 * math.pi / 60)
    assert cell.a_max[6] == settings.turntable.acceleration_rad_s2
    assert (cell.j_max[:6] == cell.a_max[:6] / settings.robot.jerk_time_s).all()


def test_every_section_forbids_what_it_does_not_know():
    def sections(model):
        for field in model.model_fields.values():
            inner = field.annotation
            if hasattr(inner, "model_fields"):
                yield inner
                yield from sections(inner)

    for model in (CellSettings, *sections(CellSettings)):
        assert model.model_config["extra"] == "forbid" and model.model_config["frozen"]


def collide(radius, low, high, p_WT, obstacle):
    """FCL's word on a round solid about the table's axis and the obstacle's box."""
    yaw = math.radians(obstacle["yaw_deg"])
    R = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    box = fcl.CollisionObject(fcl.Box(*obstacle["size_m"]), fcl.Transform(R, obstacle["centre_m"]))
    middle = np.array([p_WT[0], p_WT[1], (low + high) / 2])
    round_one = fcl.CollisionObject(fcl.Cylinder(radius, high - low), fcl.Transform(np.eye(3), middle))
    return bool(fcl.collide(box, round_one, fcl.CollisionRequest(), fcl.CollisionResult()))


def test_obstacles_are_refused_where_the_table_turns_by_fcl(rng):
    part, table = box_part(1.4, 0.1, 0.5), load_cell("kr240").turntable
    p_WT, refused, tried = np.array([*table.position_m, table.height_m]), 0, 0
    for _ in range(300):
        obstacle = {
            "name": "post", "size_m": rng.uniform(0.02, 0.8, 3).tolist(), "yaw_deg": rng.uniform(-180, 180),
            "centre_m": (p_WT + rng.uniform(-1.3, 1.3, 3)).tolist(),
        }  # fmt: skip
        turning = (
            (table.diameter_m / 2, p_WT[2] - table.thickness_m, p_WT[2]),
            (math.hypot(0.7, 0.05), p_WT[2], p_WT[2] + 0.5),
        )
        answers = {
            e: any(collide(r + e, low - e, high + e, p_WT, obstacle) for r, low, high in turning)
            for e in (-1e-3, 1e-3)
        }
        if answers[-1e-3] != answers[1e-3]:
            continue
        tried += 1
        try:
            check_room(build_cell(settings_from({"obstacles": [obstacle]}), part))
        except CellError as error:
            assert answers[1e-3] and error.key == "obstacles.0", obstacle
            refused += 1
        else:
            assert not answers[1e-3], obstacle
    assert 50 < refused < tried - 50
