"""How many threads this process may use: what OMP_NUM_THREADS says, or every core that the system allows it.

Nothing that is planned depends on the number. Everything that works on threads asks here: ray casts, searches
for neighbours, fusing; compiled loops and linear algebra take their own variables from the same number, which
they read when they are loaded.
"""

import os
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import TypeVar

from scanmotion.core.errors import InputError

OPENMP = "OMP_NUM_THREADS"
T = TypeVar("T")
_PIECES = 16
"""Work is cut into so many pieces at most."""
_FOLLOWERS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def allowed_threads() -> int:
    """Threads that one call may use, at least 1."""
    told = os.environ.get(OPENMP, "").split(",")[0].strip()
    if told.isdecimal() and int(told) > 0:
        return int(told)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0)) or 1
    return os.cpu_count() or 1


def allow_threads(count: int) -> None:
    """Sets the number for this process and those that it starts, before the libraries are loaded.

    Args:
        count: threads, at least 1.

    Raises:
        InputError: it is less than 1.
    """
    if count < 1:
        raise InputError(f"--threads {count}: must be at least 1")
    for name in (OPENMP, *_FOLLOWERS):
        os.environ[name] = str(count)


def follow_openmp() -> None:
    """Gives numba the number of OpenMP, which it does not read itself; nothing where numba is loaded."""
    told = os.environ.get(OPENMP, "")
    if told.isdecimal() and int(told) > 0 and "numba" not in sys.modules:
        os.environ.setdefault("NUMBA_NUM_THREADS", told)


def by_pieces(work: Callable[[int, int], T], count: int, *, least: int) -> list[T]:
    """What `work(first, last)` gives for pieces of 0..count, in order, made on the allowed threads.

    The pieces do not depend on the number of threads. Only work that lets go of the interpreter gains.

    Args:
        work: of a half-open range; several run at once.
        count: of what there is to do; one piece even where it is 0.
        least: fewer than this are not worth a piece of their own.
    """
    pieces = max(1, min(_PIECES, count // max(least, 1)))
    ends = [count * k // pieces for k in range(pieces + 1)]
    threads = min(allowed_threads(), pieces)
    if threads == 1:
        return [work(first, last) for first, last in pairwise(ends)]
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(max_workers=threads) as pool:
        return list(pool.map(work, ends[:-1], ends[1:]))
