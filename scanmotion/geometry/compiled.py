"""Kernels compiled ahead, in several processes: numba compiles under one lock, so that threads do not help.

`kernels.txt` lists the kernels that Python calls, each with its kinds of arguments, as a plan of the built-in
carving needs them (benchmarks/compiling.py writes it). numba keeps what is compiled beside the sources, or in
the user's cache where that cannot be written, or in NUMBA_CACHE_DIR. A stamp there says for which sources,
numba, Python and processor it is whole. A kernel or a kind of argument that is not in the list is compiled
when it is first called, as ever.

    python -m scanmotion.geometry.compiled
"""

import hashlib
import importlib
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from scanmotion.core.support.threads import allowed_threads

LIST = Path(__file__).with_name("kernels.txt")
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

    names = {name: getattr(types, name) for name in dir(types)}
    names |= {"Tuple": lambda *items: types.Tuple(items), "bool": types.boolean, "__builtins__": {}}
    return tuple(eval(kinds, names))  # our own file


def compile_kernels(*, progress: Callable[[str, float], None] | None = None) -> bool:
    """Compiles the listed kernels unless that was done before; whether there was anything to do.

    What fails is left to the first call of each kernel; so is all with SCANMOTION_COMPILE_AHEAD=0.

    Args:
        progress: told the stage and the share that is done.
    """
    stamp = _stamp() if os.environ.get("SCANMOTION_COMPILE_AHEAD", "1") != "0" else None
    if stamp is None or stamp.is_file():
        return False
    tell = progress or (lambda stage, share: None)
    rows = listed_kernels()
    shares = _shares(rows, max(1, min(_MOST, allowed_threads())))
    words = [sys.executable, "-c", f"from {__name__} import main; main()"]
    tell("compiling, this once", 0.0)
    children = [
        subprocess.Popen(
            [*words, *map(str, share)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        for share in shares
    ]
    whole = _heard(children, rows, tell)
    if whole:
        stamp.parent.mkdir(parents=True, exist_ok=True)
        stamp.write_text("The kernels that scanmotion lists are compiled.\n")
    return True


def _heard(
    children: Iterable["subprocess.Popen[str]"], rows: list[Row], tell: Callable[[str, float], None]
) -> bool:
    """Follows the processes to their end; whether all did all."""
    import selectors

    total, done, good = sum(row[3] for row in rows), 0.0, True
    with selectors.DefaultSelector() as ready:
        for child in children:
            assert child.stdout is not None
            ready.register(child.stdout, selectors.EVENT_READ, child)
        while ready.get_map():
            for key, _ in ready.select():
                line = key.fileobj.readline()  # pyright: ignore
                if line:
                    done += rows[int(line)][3]
                    tell("compiling, this once", min(done / total, 1.0))
                else:
                    ready.unregister(key.fileobj)
                    good &= key.data.wait() == 0
    return good


def _shares(rows: list[Row], count: int) -> list[list[int]]:
    """Indices of the rows for each process: modules stay whole, the heaviest go first to whom has least."""
    weight: dict[str, float] = {}
    for module, _, _, w in rows:
        weight[module] = weight.get(module, 0.0) + w
    load, owner = [0.0] * count, {}
    for module in sorted(weight, key=lambda m: (-weight[m], m)):
        least = load.index(min(load))
        owner[module] = least
        load[least] += weight[module]
    shares = [[i for i, row in enumerate(rows) if owner[row[0]] == k] for k in range(count)]
    return [share for share in shares if share]


def _stamp() -> Path | None:
    """The file that says that all is compiled; None where numba has no place for what it compiles."""
    import llvmlite.binding
    import numba

    from scanmotion.geometry.jit import copy_into

    folder = getattr(copy_into._cache, "cache_path", None)  # numba tells it in no other way
    if not folder:
        return None
    told = hashlib.sha256(LIST.read_bytes())
    for module in sorted({row[0] for row in listed_kernels()} | {"scanmotion.geometry.jit"}):
        path = Path(__file__).parents[1].joinpath(*module.split(".")[1:]).with_suffix(".py")
        told.update(path.read_bytes() if path.is_file() else b"")
    processor = llvmlite.binding.get_host_cpu_name()
    told.update(f"{numba.__version__} {platform.python_version()} {processor}".encode())
    return Path(folder) / f"scanmotion-{told.hexdigest()[:16]}.compiled"


def main(words: list[str] | None = None) -> None:
    """Compiles the rows whose indices are given, telling each on stdout; without any, all, with its share."""
    words = sys.argv[1:] if words is None else words
    if not words:
        compile_kernels(progress=lambda stage, share: print(f"{stage}: {share:.0%}", flush=True))  # noqa: T201
        return
    rows = listed_kernels()
    for index in map(int, words):
        module, name, kinds, _ = rows[index]
        getattr(importlib.import_module(module), name).compile(arguments_from(kinds))
        print(index, flush=True)  # noqa: T201


def kernel_lines(took: Mapping[tuple[str, str, str], float]) -> str:
    """The text of kernels.txt from the seconds that each (module, function, kinds) took to compile."""
    head = "# weight, module, function, kinds of arguments; written by benchmarks/compiling.py\n"
    rows = [f"{seconds:.2f}\t" + "\t".join(key) for key, seconds in sorted(took.items())]
    return head + "\n".join(rows) + "\n"


if __name__ == "__main__":
    main()
