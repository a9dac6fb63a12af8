"""The rules of docs/design.md that can be read from the code."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import scanmotion

ROOT = Path(__file__).resolve().parents[1] / "scanmotion"
FILES = {p.relative_to(ROOT).as_posix(): p for p in sorted(ROOT.rglob("*.py")) if "_models" not in p.parts}

UNTYPED = {
    "cli/app.py": "click",
    "export/ros.py": "rosbags",
    "report/figures/surface.py": "Open3D",
    "report/scene.py": "Drake's stubs, which know no arrays",
    "report/viewpoint_scene.py": "meshcat",
}
"""Files at the border of a library without types, where `Any` is what is known."""
TYPED = ("planning", "plan_io", "report", "export", "cli")


def functions(tree: ast.AST) -> list[ast.FunctionDef]:
    return [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]


def arguments(function: ast.FunctionDef) -> list[ast.arg]:
    a = function.args
    return [x for x in (*a.posonlyargs, *a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")]


def untyped(tree: ast.AST) -> list[str]:
    """Functions and fields whose annotation holds `Any`."""
    found = []
    for node in ast.walk(tree):
        annotations = []
        if isinstance(node, ast.FunctionDef):
            more = [a for a in (node.args.vararg, node.args.kwarg) if a is not None]
            annotations = [a.annotation for a in (*arguments(node), *more)] + [node.returns]
        elif isinstance(node, ast.ClassDef):
            annotations = [f.annotation for f in node.body if isinstance(f, ast.AnnAssign)]
        if any(a is not None and re.search(r"\bAny\b", ast.unparse(a)) for a in annotations):
            found.append(node.name)
    return found


@pytest.mark.parametrize("name", [n for n in FILES if n.split("/")[0] in TYPED and n not in UNTYPED])
def test_what_passes_between_the_rooms_has_its_type(name):
    assert untyped(ast.parse(FILES[name].read_text())) == []


def test_any_is_found_where_it_is():
    assert untyped(ast.parse("def f(a: int, *b: Any) -> None: ...")) == ["f"]
    assert untyped(ast.parse("class C:\n    x: dict[str, Any]\n    def f(self) -> 'Any': ...")) == ["C", "f"]
    assert all(untyped(ast.parse(FILES[name].read_text())) for name in UNTYPED)


def test_no_type_is_waved_through():
    waved = re.compile(r"#\s*(pyright|type):\s*ignore")
    assert [name for name, path in FILES.items() if waved.search(path.read_text())] == []


MANY = {
    "cell/arm/robot_file.py": {"_robot"}, "cell/arm/urdf.py": {"_replace"}, "cell/suggest.py": {"_yaml"},
    "cell/mesh_solids.py": {"mesh_solid"}, "controller/export_plan.py": {"export_plan"},
    "job/flow.py": {"start_job"}, "job/simulate.py": {"write_simulated"},
    "judge/contact.py": {"_judge_pair"}, "judge/limits.py": {"_over"},
    "motion/continuous/choose.py": {"__init__"}, "motion/continuous/nodes.py": {"nodes_from"},
    "motion/continuous/search.py": {"annealed"}, "motion/order/helix_choice.py": {"_fastest"},
    "motion/order/sequence.py": {"_seeds", "sequence"},
    "motion/profile/jerk_limited.py": {"_jerk_limited", "_milder"},
    "motion/transit/rrt_connect.py": {"plan_round"}, "planning/evidence.py": {"next_views"},
    "planning/segment.py": {"segment_from"}, "planning/steps/continuous.py": {"continuous_programme"},
    "sensing/corrections/calibration_plan.py": {"best_turns"},
    "sensing/corrections/corrected_scan.py": {"corrected_scan"},
    "sensing/holes/find.py": {"holes_from_cloud", "holes_from_mesh"},
    "sensing/simulator/range_frames.py": {"_hits"},
    "sensing/scans/scan_files.py": {"fuse_files"}, "sensing/simulator/simulate.py": {"simulate"},
    "sensing/simulator/turns.py": {"turn_captures"}, "views/candidate_views.py": {"_both_eyes", "candidates"},
    "views/next_best_views.py": {"local_step", "views_of_surface"},
    "views/stepped_rotary.py": {"oblique_turn", "stepped_rotary"},
    "views/surface_partitioning.py": {"_grown", "_patches"}, "views/targets.py": {"missed"},
    "views/unscanned.py": {"open_surface"},
}  # fmt: skip
"""Functions with more than six arguments; the list only grows shorter."""


@pytest.mark.parametrize("name", [n for n in FILES if not n.startswith("cli/")])
def test_more_than_six_arguments_is_a_missing_type(name):
    """Compiled loops take plain arrays, and the arguments of a command are its options: neither is meant."""
    many = {
        f.name
        for f in functions(ast.parse(FILES[name].read_text()))
        if len(arguments(f)) > 6 and not any("njit" in ast.unparse(d) for d in f.decorator_list)
    }
    assert many <= MANY.get(name, set())


PRIVATE = {
    "test_comparison.py": {"_offset"}, "test_continuous.py": {"_around"},
    "test_coverage.py": {"_in_views", "_in_views_here"}, "test_judge_contact.py": {"_judge_pair"},
    "test_own_robot.py": {"_Bodies"}, "test_simulate.py": {"_spans"}, "test_viewpoints_room.py": {"_HOMES"},
    "test_other_scanners.py": {"_BESIDE", "_STANDOFFS", "_share_of_range"}, "test_refine.py": {"_cost"},
    "test_show.py": {"_Bodies", "_changes", "_frames", "_poses", "_slices", "_with_overlay"},
    "test_studies.py": {"_row"},
    "test_thin.py": {"_check_memory"}, "test_jit.py": {"_by_rotations"},
    "test_compiled.py": {"_fingerprints", "_forget", "_shares"},
    "test_timing.py": {"_emitted_law", "_excess", "_running_max"},
}  # fmt: skip
"""Names of ours with an underscore that tests reach for; the list only grows shorter."""


@pytest.mark.parametrize("path", sorted(Path(__file__).parent.glob("*.py")), ids=lambda p: p.name)
def test_tests_reach_into_no_private_name(path):
    tree, ours, reached = ast.parse(path.read_text()), set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("scanmotion"):
            ours |= {a.asname or a.name for a in node.names}
            reached |= {a.name for a in node.names if a.name.startswith("_")}
        elif isinstance(node, ast.Import):
            ours |= {a.asname for a in node.names if a.asname and a.name.startswith("scanmotion")}
    for node in ast.walk(tree):
        of = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ours
        if of and re.match(r"_[A-Za-z]", node.attr):
            reached.add(node.attr)
    assert reached <= PRIVATE.get(path.name, set())


UNIT = r"\[|unit normal|unit vector|indices|mask|any unit"


def entry_of(doc: str, name: str) -> str:
    """What the section Args says of an argument, with the lines that go on."""
    found = re.search(rf"^( +){re.escape(name)}: .*(?:\n\1 +.*)*", doc, re.MULTILINE)
    return found[0] if found else ""


def array_arguments() -> list[tuple[str, str, str]]:
    """(function, argument, what is said of it) of the public names."""
    found = []
    for room in (scanmotion, scanmotion.viewpoints):
        for name in room.__all__:
            value = getattr(room, name)
            inner = vars(value) if inspect.isclass(value) else {name: value}
            for label, function in inner.items():
                if inspect.isfunction(function) and not label.startswith("_"):
                    doc = inspect.getdoc(function) or ""
                    found += [
                        (f"{name}.{label}", p.name, entry_of(doc, p.name))
                        for p in inspect.signature(function).parameters.values()
                        if "ndarray" in str(p.annotation)
                    ]
    return found


def test_public_arrays_state_shape_and_unit():
    every = array_arguments()
    assert len(every) > 40, "the search finds what it is to find"
    bad = [
        (f, a)
        for f, a, told in every
        if not (re.search(r"shape \(|a number or shape", told) and re.search(UNIT, told))
    ]
    assert bad == []


def test_sums_over_all_points_do_not_depend_on_threads():
    """`J.T @ r` of a tall J goes through column_products: OpenBLAS adds up by thread."""
    tall = re.compile(r"\b(?!R\b|Rt\b)[JA-Za-z]*[Jj][a-z]?\.T @")
    assert tall.search("J.T @ r") and tall.search("Ji.T @ (w * Ji)") and not tall.search("R.T @ p")
    found = [n for n, p in FILES.items() if n.startswith("sensing/") and tall.search(p.read_text())]
    assert found == []
