"""Seconds spent by stage; kept apart from the plan, whose bytes must not depend on them."""

import time
from collections.abc import Generator
from contextlib import contextmanager


class Stopwatch:
    """Adds up the seconds that each stage takes.

    The one thing in a plan's context that changes while it is planned: nothing reads it before the end.
    """

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._spent: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Generator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._spent[stage] = self._spent.get(stage, 0.0) + time.perf_counter() - start

    def seconds(self) -> dict[str, float]:
        """Total and by stage [s]."""
        return {"total": time.perf_counter() - self._start} | self._spent
