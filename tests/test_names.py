"""A public name is defined once: whoever reads it knows which thing it is."""

import ast
from collections import defaultdict
from pathlib import Path

SOURCE = Path(__file__).parent.parent / "scanmotion"


def _defined(tree: ast.Module) -> set[str]:
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    return {node.name for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")}


def test_no_public_name_is_defined_twice() -> None:
    # A command's function bears the command's name, and with it often that of the library function it calls:
    # cli/ and __main__ are left out.
    where = defaultdict(list)
    for path in sorted(SOURCE.rglob("*.py")):
        inside = path.relative_to(SOURCE)
        if inside.parts[0] not in ("cli", "__main__.py"):
            for name in _defined(ast.parse(path.read_text())):
                where[name].append(str(inside))
    assert len(where) > 500, "the search finds what it is to find"
    assert {name: paths for name, paths in where.items() if len(paths) > 1} == {}
