"""Running a study: unfinished cases to the workers, rows into the table as they come.

Guarantees: a study that is stopped, or loses workers or its scheduler, goes on where it was when it is run
again; a finished case is never done twice; a case that brings down its worker three times is a row with that
reason.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanmotion import __version__
from scanmotion.core.errors import ScanMotionError
from scanmotion.geometry.compiled import compile_kernels
from scanmotion.studies import table
from scanmotion.studies.case import FIGURES, CaseRow
from scanmotion.studies.cluster import KILLS, client_of, memory_resource, run_on_worker, send_parts
from scanmotion.studies.settings import Case, Study, study_from, study_from_yaml

Progress = Callable[[str, float], None]
_AT_ONCE = 2000
"""Cases that the scheduler holds at a time."""


class StudyError(ScanMotionError):
    """A study ended before its cases did; what is finished is in the table."""


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """How a study is run; none of it changes a row."""

    table: Path
    """File of the results."""
    scheduler: str | None = None
    """Address of a Dask scheduler; None starts workers on this machine."""
    workers: int | None = None
    """Workers on this machine; None is one a core, as far as the memory bears them."""
    keep_in: Path | None = None
    """Folder for the plans' own folders; on a cluster of several machines one that all of them see."""


@dataclass(frozen=True, kw_only=True)
class StudyResult:
    """What a study has in its table when it ends."""

    table: Path
    cases: int
    new: int
    """Rows of this run."""
    ok: int
    """Rows of the study's cases with figures."""


def study(
    told: Path | str | dict[str, Any], *, options: StudyOptions, progress: Progress | None = None
) -> StudyResult:
    """Runs the cases of a study that have no row yet.

    Args:
        told: a YAML file, or the mapping that one holds.
        options: where the table is, and who works.
        progress: told what is done, and the share of it.

    Raises:
        InputError: the study, the table or the scheduler's address is not usable.
        StudyError: the scheduler went away; what is finished is kept.
    """
    made = study_from(told, folder=Path.cwd()) if isinstance(told, dict) else study_from_yaml(Path(told))
    tell = progress or (lambda what, share: None)
    with table.opened(options.table, make=True) as connection:
        done = table.finished(connection)
        todo = [case for case in made.cases if case.id not in done]
        if todo:
            compile_kernels(progress=tell)  # once, not by every worker
            _run(made, todo, options, connection, tell)
        ids = {case.id for case in made.cases}
        rows = [r for r in table.records(connection) if r["id"] in ids]
    return StudyResult(
        table=options.table, cases=len(made.cases), new=len(todo), ok=sum(r["status"] == "ok" for r in rows)
    )


def _run(made: Study, todo: list[Case], options: StudyOptions, connection: Any, tell: Progress) -> None:
    """Brings the parts to the workers and writes rows in batches as they come."""
    memory = max(case.memory_gib for case in todo)
    with client_of(options.scheduler, options.workers, memory) as client:
        needed = {case.part_hash for case in todo}
        send_parts(client, {h: part for h, part in made.parts.items() if h in needed})
        done, total = len(made.cases) - len(todo), len(made.cases)
        for first in range(0, len(todo), _AT_ONCE):
            for rows in _batches(client, todo[first : first + _AT_ONCE], options.keep_in):
                table.add(connection, rows)
                done += len(rows)
                tell(f"{done} of {total} cases", done / total)


def _batches(client: Any, cases: list[Case], keep_in: Path | None) -> Iterator[list[tuple[Case, CaseRow]]]:
    """Cases with their rows, a batch at a time, in the order in which they are done."""
    from distributed import as_completed

    keep = None if keep_in is None else str(keep_in.resolve())
    futures = client.map(
        run_on_worker,
        cases,
        [keep] * len(cases),
        key=[f"scanmotion-{case.id}" for case in cases],
        pure=True,
        retries=0,
        resources=memory_resource(client, cases[0]) or None,
    )
    by_key = {future.key: case for future, case in zip(futures, cases, strict=True)}
    for batch in as_completed(futures, with_results=True, raise_errors=False).batches():
        yield [(by_key[future.key], _row(by_key[future.key], future, result)) for future, result in batch]


def _row(case: Case, future: Any, result: Any) -> CaseRow:
    """The row of a finished case, or of one that killed its workers.

    Raises:
        StudyError: the case was lost with its scheduler.
    """
    if future.status == "finished":
        return result
    error = result[1] if isinstance(result, tuple) else result
    if type(error).__name__ == "KilledWorker":
        reason = f"brought down its worker {KILLS} times, by lack of memory perhaps"
        return _empty(case, "killed", reason)
    if future.status in ("cancelled", "lost") or isinstance(error, OSError):
        raise StudyError(
            "the scheduler went away; finished cases are in the table, run the study again to go on"
        )
    return _empty(case, "fault", f"{type(error).__name__}: {error}"[:500])


def _empty(case: Case, status: str, reason: str) -> CaseRow:
    return CaseRow(
        id=case.id,
        status=status,
        reason=reason,
        figures=dict.fromkeys(FIGURES),
        plan_sha256="",
        planning_s=0.0,
        version=__version__,
    )
