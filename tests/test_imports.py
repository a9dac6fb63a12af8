"""The import graph points one way, heavy libraries stay out of the light modules, and rooms stay small."""

import ast
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1] / "scanmotion"
FILES = sorted(p for p in ROOT.rglob("*.py") if "_models" not in p.parts)

LAYERS = (
    {"core"},
    {"geometry"},
    {"cell", "sensing"},
    {"views", "motion"},
    {"planning"},
    {"plan_io"},
    {"judge", "export", "report"},
    {"studies", "job", "controller"},
    {"cli", "viewpoints"},
    {"__main__"},
)
"""From the ground up: a room imports itself and lower layers, never its neighbours or what is above."""
RANK = {room: rank for rank, layer in enumerate(LAYERS) for room in layer}
CONVENIENCE = {
    ("planning.plan", "plan_io"), ("planning.plan", "plan_io.save"), ("planning.plan", "judge"),
    ("cell.model", "cell.drake_model"),
}  # fmt: skip
"""`Plan.save` and `Cell.drake`, for users: the places where a noun calls what is made of it."""
PYDRAKE = {"cell", "motion/transit", "motion/profile", "report/scene.py", "controller/plant.py"}
STAGES = {"reach": "find", "order": "sequence", "transit": "plan", "timing": "operations"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path) -> set[str]:
    """Dotted names below scanmotion that a file imports, at any depth."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names |= {node.module} | {f"{node.module}.{a.name}" for a in node.names}
    return names


MODULES = {module_name(p): p for p in FILES}
INNER = {
    name: {n.removeprefix("scanmotion.") for n in imported(path) if n.startswith("scanmotion.")}
    & set(MODULES) - {upper for lower, upper in CONVENIENCE if lower == name}
    for name, path in MODULES.items()
}


@pytest.mark.parametrize("name", [n for n in MODULES if n])
def test_imports_point_downward(name):
    room = name.split(".")[0]
    assert room in RANK, f"{name} is in no layer"
    for other in INNER[name] - {""}:
        below = other.split(".")[0]
        allowed = below == room or RANK[below] < RANK[room]
        assert allowed, f"{name} may not import {other}"


def folders_of(name: str) -> tuple[str, ...]:
    """The folders that a module stands in, from the top: ("motion", "order") for motion.order.stops."""
    return MODULES[name].relative_to(ROOT).parent.parts


def test_folders_beside_each_other_point_one_way():
    """Of two folders in the same folder at most one imports from the other, at any depth below them."""
    arrows = {}
    for name, others in INNER.items():
        for other in others - {""}:
            here, there = folders_of(name), folders_of(other)
            common = next((i for i, (a, b) in enumerate(zip(here, there, strict=False)) if a != b), None)
            if common is not None:
                arrows.setdefault((here[: common + 1], there[: common + 1]), (name, other))
    assert len(arrows) > 30, "the search finds what it is to find"
    both = {(a, b): (found, arrows[b, a]) for (a, b), found in arrows.items() if (b, a) in arrows}
    assert not both, both


MOST_FILES = 12


def test_folders_are_small():
    count = Counter(path.parent.relative_to(ROOT).as_posix() for path in FILES)
    assert len(count) > 30
    assert {folder: n for folder, n in count.items() if n > MOST_FILES} == {}


@pytest.mark.parametrize(
    ("module", "method", "count"), [("planning.plan", "save", 2), ("cell.model", "drake", 1)]
)
def test_the_convenience_is_inside_of_its_method(module, method, count):
    tree = ast.parse(MODULES[module].read_text())
    (asked,) = (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == method)
    inside = {id(node) for node in ast.walk(asked)}
    for_types = (
        n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)
    )
    hidden = {id(node) for block in for_types for node in ast.walk(block)}
    upward = {"scanmotion." + upper for lower, upper in CONVENIENCE if lower == module}
    found = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module in upward]
    found = [n for n in found if id(n) not in hidden]
    assert len(found) == count and all(id(node) in inside for node in found)


def test_the_judge_knows_nothing_of_the_planner():
    """Core, readers of geometry files, the cell's settings, and the schema and reader of a plan's folder."""
    todo, seen = {"judge"} | {n for n in MODULES if n.startswith("judge.")}, set()
    while todo:
        name = todo.pop()
        seen.add(name)
        todo |= INNER[name] - seen - {""}
    settings = {n for n in seen if n == "cell" or n.split(".")[:2] == ["cell", "settings"]}
    rooms = {name for name in seen if not name.startswith(("judge", "core", "geometry"))} - settings
    assert rooms <= {"plan_io", "plan_io.schema", "plan_io.read", "plan_io.files"}, rooms


def test_no_plan_is_of_any_type():
    """Between planning, plan_io, report, export and cli a plan, its cell and its summary have their types."""
    anything = re.compile(r"\b(plan|made|summary|trajectory|cell|options|report): (Any|object)\b")
    for room in ("planning", "plan_io", "report", "export"):
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text()
            assert not anything.search(text), path
            if room == "plan_io":
                assert not re.search(r"\bAny\b", text), path
                assert "SimpleNamespace" not in text, path


def test_stages_do_not_import_stages():
    entries = {f"motion.{room}.{module}" for room, module in STAGES.items()}
    for entry in entries:
        assert not INNER[entry] & (entries - {entry}), entry


def test_no_cycles():
    done, path = set(), []

    def visit(name):
        assert name not in path, " -> ".join([*path[path.index(name) :], name])
        if name in done:
            return
        path.append(name)
        for other in sorted(INNER[name] - {name}):
            visit(other)
        path.pop()
        done.add(name)

    for name in MODULES:
        if name:
            visit(name)


def test_drake_has_few_homes():
    for path in FILES:
        rel = path.relative_to(ROOT).as_posix()
        if any(n.split(".")[0] == "pydrake" for n in imported(path)):
            assert any(rel == home or rel.startswith(home + "/") for home in PYDRAKE), rel


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_rooms_are_small(path):
    text = path.read_text()
    assert text.count("\n") <= 400, f"{path.name} has {text.count(chr(10))} lines"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno - node.body[0].lineno + 1 <= 60, f"{path.name}: {node.name} is too long"


def test_importing_the_package_is_light():
    heavy = ("open3d", "pydrake", "matplotlib", "numba", "scipy", "numpy", "ompl")
    code = f"import sys, scanmotion; print([m for m in {heavy!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_every_public_name_loads():
    import scanmotion

    assert len(scanmotion.__all__) <= 30
    for name in scanmotion.__all__:
        assert getattr(scanmotion, name) is not None


@pytest.mark.parametrize("path", sorted((ROOT / "planning").rglob("*.py")), ids=lambda p: p.stem)
def test_planning_assigns_no_attribute(path):
    """A state is a value: nothing in planning/ changes one, and every class there is frozen."""
    tree = ast.parse(path.read_text())
    allowed = {
        id(node)
        for method in ast.walk(tree)
        if isinstance(method, ast.FunctionDef) and method.name == "__post_init__"
        for node in ast.walk(method)
    }
    for node in ast.walk(tree):
        targets = {
            ast.Assign: lambda n: n.targets, ast.AugAssign: lambda n: [n.target],
            ast.AnnAssign: lambda n: [n.target], ast.Delete: lambda n: n.targets,
            ast.For: lambda n: [n.target], ast.With: lambda n: [i.optional_vars for i in n.items],
        }.get(type(node), lambda n: [])(node)  # fmt: skip
        for target in (inner for t in targets if t is not None for inner in ast.walk(t)):
            stored = isinstance(target, ast.Attribute) and not isinstance(target.ctx, ast.Load)
            assert not stored or id(target) in allowed, f"line {target.lineno} assigns an attribute"
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            assert name not in ("setattr", "object.__setattr__") or id(node) in allowed, f"line {node.lineno}"
        if isinstance(node, ast.ClassDef) and "Protocol" not in {ast.unparse(b) for b in node.bases}:
            frozen = [d for d in node.decorator_list if "frozen=True" in ast.unparse(d)]
            assert frozen, f"class {node.name} is not a frozen dataclass"
