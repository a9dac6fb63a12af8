"""A study's results: one SQLite table, one row a case.

Guarantees: a row is written whole or not at all and never twice (the case's id is the key); a study that is
killed at any moment leaves the rows that were finished. Only one process writes: the one that runs the study.
"""

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scanmotion.core.errors import InputError
from scanmotion.studies.case import FIGURES, CaseRow
from scanmotion.studies.settings import Case

_TEXT = ("id", "status", "reason", "kind", "robot", "layout", "part", "method", "settings", "options")
_COLUMNS = (*_TEXT, "seed", "version", "plan_sha256", "planning_s", *FIGURES)


@contextmanager
def opened(path: Path, *, make: bool = False) -> Iterator[sqlite3.Connection]:
    """The table in file `path`.

    Args:
        path: the file.
        make: whether it is made where it does not exist.

    Raises:
        InputError: missing, no table of a study, or in use by another study.
    """
    if not make and not path.is_file():
        raise InputError(f"{path}: no such file")
    connection = sqlite3.connect(path, timeout=5.0)
    try:
        numbers = ", ".join(f"{name} REAL" for name in ("planning_s", *FIGURES))
        texts = ", ".join(f"{name} TEXT NOT NULL" for name in (*_TEXT[1:], "version", "plan_sha256"))
        if make:
            connection.execute("PRAGMA journal_mode=WAL")
            with connection:
                connection.execute(
                    "CREATE TABLE IF NOT EXISTS cases "
                    f"(id TEXT PRIMARY KEY, seed INTEGER NOT NULL, {texts}, {numbers})"
                )
        connection.execute(f"SELECT {', '.join(_COLUMNS)} FROM cases LIMIT 1")
        yield connection
    except sqlite3.DatabaseError as error:
        raise InputError(f"{path}: is not the table of a study ({error})") from None
    finally:
        connection.close()


def finished(connection: sqlite3.Connection) -> set[str]:
    """Ids of the cases that have a row."""
    return {row[0] for row in connection.execute("SELECT id FROM cases")}


def add(connection: sqlite3.Connection, rows: Iterable[tuple[Case, CaseRow]]) -> None:
    """Writes rows in one transaction; a case that has a row already keeps it."""
    marks = ", ".join("?" * len(_COLUMNS))
    with connection:
        connection.executemany(
            f"INSERT OR IGNORE INTO cases ({', '.join(_COLUMNS)}) VALUES ({marks})",
            [_values(case, row) for case, row in rows],
        )


def _values(case: Case, row: CaseRow) -> tuple[Any, ...]:
    settings = json.dumps(case.settings, sort_keys=True)
    options = json.dumps(case.options, sort_keys=True)
    text = (row.id, row.status, row.reason, case.kind, case.robot, case.layout, case.part, case.method)
    numbers = (row.planning_s, *(row.figures[name] for name in FIGURES))
    return (*text, settings, options, case.seed, row.version, row.plan_sha256, *numbers)


def records(connection: sqlite3.Connection) -> list[dict[str, Any]]:
    """All rows as mappings, in the order of robot, layout, part, method and seed."""
    order = "kind, robot, layout, part, method, seed, id"
    found = connection.execute(f"SELECT {', '.join(_COLUMNS)} FROM cases ORDER BY {order}")
    return [dict(zip(_COLUMNS, values, strict=True)) for values in found]
