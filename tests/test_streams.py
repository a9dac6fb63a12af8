"""Each stage draws from a stream of its own, and nothing else makes random numbers."""

import ast
import re
from collections import Counter
from pathlib import Path

import numpy as np

from scanmotion.core.support.streams import Streams, fixed_stream

SOURCE = Path(__file__).parent.parent / "scanmotion"
HOME = SOURCE / "core" / "support" / "streams.py"
GOLDEN = [414284, 464607, 346960]


def _asked() -> list[tuple[str, str]]:
    """Every stream that the code asks for: (where, name)."""
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        if path == HOME:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called not in ("child", "rng", "fixed_stream"):
                continue
            where = f"{path.relative_to(SOURCE)}:{node.lineno}"
            first = node.args[0] if node.args else None
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                found.append((where, first.value))
            else:
                # The context hands names on; who asks it is found by `rng`.
                assert where.startswith("planning/context.py"), f"{where}: the stream's name is no literal"
    return found


def test_each_stream_is_asked_for_at_one_place() -> None:
    asked = _asked()
    assert {"local_round", "local_views", "prune", "confidence", "surface_samples"} <= {n for _, n in asked}
    twice = [n for n, count in Counter(name for _, name in asked).items() if count > 1]
    assert not twice, [item for item in asked if item[1] in twice]


def test_no_two_streams_share_their_draws() -> None:
    names = sorted({name for _, name in _asked()})
    numbers = [(), *((n,) for n in range(50)), *((a, b) for a in range(8) for b in range(8))]
    first = {}
    for seed in (0, 1, 2**40):
        for name in names:
            for n in numbers:
                draws = tuple(Streams(seed=seed).child(name, *n).integers(0, 2**63, 2).tolist())
                assert draws not in first, ((seed, name, n), first[draws])
                first[draws] = (seed, name, n)
    # Nor is what a stage spawns from its own stream another one.
    for name in names:
        for child in Streams(seed=0).child(name).spawn(50):
            draws = tuple(child.integers(0, 2**63, 2).tolist())
            assert draws not in first
            first[draws] = (0, name, "spawned")


def test_same_name_same_draws() -> None:
    one, two = (Streams(seed=7).child("local_round", 3).random(5) for _ in range(2))
    assert np.array_equal(one, two)
    assert np.array_equal(fixed_stream("silhouette").random(3), Streams(seed=0).child("silhouette").random(3))
    # What a version draws it draws in every later one, on every machine.
    assert Streams(seed=0).child("local_round", 1).integers(0, 10**6, 3).tolist() == GOLDEN


def test_nothing_else_makes_random_numbers() -> None:
    made = re.compile(
        r"default_rng\(|SeedSequence\(|RandomState|np\.random\.(?!Generator\b)|^(?:import|from) random\b",
        re.MULTILINE,
    )
    bad = {
        str(path.relative_to(SOURCE)): made.findall(path.read_text())
        for path in SOURCE.rglob("*.py")
        if path != HOME and made.search(path.read_text())
    }
    assert not bad
    assert made.search(HOME.read_text()), "the search finds what it is to find"
