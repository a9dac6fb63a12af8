"""Kernels compiled ahead, in several processes: numba compiles under one lock, so that threads do not help.

`kernels.txt` lists the kernels that Python calls, each with its kinds of arguments, as a plan of the built-in
carving needs them (benchmarks/compiling.py writes it). numba keeps what is compiled beside the sources, or in
the user's cache where that cannot be written, or in NUMBA_CACHE_DIR. A file there says for which sources,
numba, Python and processor it is whole. A kernel or a kind of argument that is not in the list is compiled
when it is first called, as ever.

    python -m scanmotion.geometry.compiled
"""

import ast
import hashlib
import importlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from scanmotion.core.support.threads import allowed_threads
from scanmotion.core.support.whole_file import write_whole

LIST = Path(__file__).with_name("kernels.txt")
STAGE = "compiling, this once"
_ROOT = Path(__file__).parents[1]
_looked_at: set[Path] = set()
"""Once in a process is enough."""
_IMPORTED = re.compile(r"^from (scanmotion[\w.]*) import", re.M)
_MOST = 8
"""Processes at once: each takes some 200 MB and a second to load numba."""
Row = tuple[str, str, str, float]
"""Module, function, kinds of arguments, and how long it takes against others."""


def listed_kernels() -> list[Row]:
    """The rows of kernels.txt."""
    rows = [line.split("\t") for line in LIST.read_text().splitlines() if line and line[0] != "#"]
    return [(module, name, kinds, float(weight)) for weight, module, name, kinds in rows]


def arguments_from(kinds: str) -> tuple[Any, ...]:
    """Types of numba from the words by which numba itself tells them.

    Args:
        kinds: as "(Array(float64, 2, 'C', False, aligned=True), int64)".
    """
    from numba import types

    def value(node: ast.expr) -> Any:
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Tuple):
            return tuple(value(item) for item in node.elts)
        if isinstance(node, ast.Name):
            return types.boolean if node.id == "bool" else getattr(types, node.id)
        assert isinstance(node, ast.Call)
        named = {str(word.arg): value(word.value) for word in node.keywords}
        return value(node.func)(*map(value, node.args), **named)

    return value(ast.parse(kinds, mode="eval").body)


def compile_kernels(*, progress: Callable[[str, float], None] | None = None) -> bool:
    """Compiles the listed kernels unless that was done before; whether there was anything to do.

    numba keeps a kernel for as long as its own file stays as it is; here what it calls from other files
    counts too, and what is stale by that is thrown away. What fails is left to the first call of each kernel;
    so is all with SCANMOTION_COMPILE_AHEAD=0.

    Args:
        progress: told the stage and the share that is done.
    """
    stamp = _stamp() if os.environ.get("SCANMOTION_COMPILE_AHEAD", "1") != "0" else None
    if stamp is None or stamp in _looked_at:
        return False
    _looked_at.add(stamp)
    now, before = _fingerprints(), _read(stamp)
    stale = sorted(module for module in now if before.get(module) != now[module])
    if not stale:
        return False
    tell = progress or (lambda stage, share: None)
    tell(STAGE, 0.0)
    for module in stale:
        _forget(module)
    rows = [row for row in listed_kernels() if row[0] in stale]
    shares = _shares(rows, max(1, min(_MOST, allowed_threads())))
    words = [sys.executable, "-c", "from scanmotion.geometry.compiled import main; main()"]
    children = [
        subprocess.Popen([*words, *share], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for share in shares
    ]
    if _heard(children, rows, tell):
        stamp.parent.mkdir(parents=True, exist_ok=True)
        write_whole(stamp, json.dumps(now, indent=0))
    return True


def _heard(
    children: Iterable["subprocess.Popen[str]"], rows: list[Row], tell: Callable[[str, float], None]
) -> bool:
    """Follows the processes to their end; whether all did all."""
    import selectors

    total, done, good = max(sum(row[3] for row in rows), 1e-9), 0.0, True
    weight = {"\t".join(row[:3]): row[3] for row in rows}
    with selectors.DefaultSelector() as ready:
        for child in children:
            assert child.stdout is not None
            ready.register(child.stdout, selectors.EVENT_READ, child)
        while ready.get_map():
            for key, _ in ready.select():
                out: Any = key.fileobj
                line = out.readline()
                if line:
                    done += weight.get(line.rstrip("\n"), 0.0)
                    tell(STAGE, min(done / total, 1.0))
                else:
                    ready.unregister(key.fileobj)
                    good &= key.data.wait() == 0
    return good


def _shares(rows: list[Row], count: int) -> list[list[str]]:
    """Modules for each process: the heaviest go first to whom has least."""
    weight: dict[str, float] = {}
    for module, _, _, seconds in rows:
        weight[module] = weight.get(module, 0.0) + seconds
    shares: list[list[str]] = [[] for _ in range(count)]
    load = [0.0] * count
    for module in sorted(weight, key=lambda m: (-weight[m], m)):
        least = load.index(min(load))
        shares[least].append(module)
        load[least] += weight[module] + 1e-3
    return [share for share in shares if share]


def _stamp() -> Path | None:
    """The file that says what is compiled; None where numba has no place for it."""
    folder = _folder_of(Path(__file__).with_name("jit.py"))
    return None if folder is None else folder / "scanmotion.compiled"


def _folder_of(source: Path) -> Path | None:
    """Where numba keeps what it compiles of a source; None where it has no place for it."""
    from numba.core import caching

    for locator in (
        caching.UserProvidedCacheLocator, caching.InTreeCacheLocator, caching.UserWideCacheLocator
    ):  # fmt: skip
        found = locator.from_function(_folder_of, str(source))
        if found is not None:
            return Path(found.get_cache_path())
    return None


def _forget(module: str) -> None:
    """Throws away what numba keeps of a module."""
    source = _ROOT.joinpath(*module.split(".")[1:]).with_suffix(".py")
    folder = _folder_of(source)
    if folder is not None:
        for kept in [*folder.glob(f"{source.stem}.*.nbi"), *folder.glob(f"{source.stem}.*.nbc")]:
            kept.unlink(missing_ok=True)


def _read(stamp: Path) -> dict[str, str]:
    try:
        told = json.loads(stamp.read_text())
    except (OSError, ValueError):
        return {}
    return told if isinstance(told, dict) else {}


def _fingerprints() -> dict[str, str]:
    """Of each module with kernels: its text, that of all such modules that it imports from,
    numba and processor.
    """
    import llvmlite.binding
    import numba

    texts: dict[str, str] = {}
    for path in _ROOT.rglob("*.py"):
        text = path.read_text()
        if "import" in text and "@njit" in text:
            texts[".".join(("scanmotion", *path.relative_to(_ROOT).with_suffix("").parts))] = text
    calls = {
        module: {name for name in _IMPORTED.findall(text) if name in texts} for module, text in texts.items()
    }
    listed = "".join(sorted(f"{row[:3]}" for row in listed_kernels()))
    about = (numba.__version__, platform.python_version(), llvmlite.binding.get_host_cpu_name(), listed)
    found = {}
    for module in texts:
        todo, known = [module], {module}
        while todo:
            new = calls[todo.pop()] - known
            known |= new
            todo += new
        whole = "".join(texts[name] for name in sorted(known))
        found[module] = hashlib.sha256(repr((about, whole)).encode()).hexdigest()[:24]
    return found


def _compile_module(module: str) -> None:
    """Compiles the listed kernels of a module, telling each on stdout.

    A row that no longer fits its kernel is passed over: the list saves time and decides nothing.
    """
    for row in listed_kernels():
        if row[0] == module:
            with suppress(Exception):
                getattr(importlib.import_module(module), row[1]).compile(arguments_from(row[2]))
            print("\t".join(row[:3]), flush=True)  # noqa: T201


def main(words: list[str] | None = None) -> None:
    """Compiles the kernels of the modules that are given; without any, all that is stale, with its share."""
    words = sys.argv[1:] if words is None else words
    if not words:
        compile_kernels(progress=lambda stage, share: print(f"{stage}: {share:.0%}", flush=True))  # noqa: T201
    for module in words:
        _compile_module(module)


def kernel_lines(took: Mapping[tuple[str, str, str], float]) -> str:
    """The text of kernels.txt from the seconds that each (module, function, kinds) took to compile."""
    head = "# weight, module, function, kinds of arguments; written by benchmarks/compiling.py\n"
    rows = [f"{seconds:.2f}\t" + "\t".join(key) for key, seconds in sorted(took.items())]
    return head + "\n".join(rows) + "\n"


if __name__ == "__main__":
    main()
