"""Dask: workers on this machine, or a scheduler that exists. Nothing of ours schedules.

Guarantees: without an address everything listens on the loopback interface only; parts go to each worker
once, those that join later included; a worker takes only as many cases at once as its memory allows, by
Dask's resources.
"""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.studies.case import CaseRow, row_of
from scanmotion.studies.settings import Case

KILLS = 3
"""A case that brought down this many workers gets a row and is not tried again."""
MEMORY = "scanmotion_MiB"
"""Name of the resource by which workers tell how much memory they have for cases."""
_SPARE = 0.8
"""Share of the free memory that local workers may use."""


def dask() -> Any:
    """The module dask.distributed.

    Raises:
        InputError: it is not installed.
    """
    try:
        import distributed
    except ImportError:
        raise InputError("a study needs Dask: pip install 'scanmotion[study]'") from None
    return distributed


def worker_count(asked: int | None, memory_gib: float) -> int:
    """Workers on this machine: as many as asked for or as cores, but no more than the memory bears."""
    import psutil

    free = psutil.virtual_memory().available * _SPARE / 2**30
    return max(1, min(asked or os.cpu_count() or 1, int(free / memory_gib)))


@contextmanager
def client_of(scheduler: str | None, workers: int | None, memory_gib: float) -> Iterator[Any]:
    """A client of the scheduler at `scheduler`, or of a cluster on this machine.

    Args:
        scheduler: address such as tcp://127.0.0.1:8786; None starts a cluster.
        workers: processes of that cluster; None is one a core.
        memory_gib: what one case may need [GiB].

    Raises:
        InputError: Dask is not installed, or nothing answers at the address.
    """
    distributed = dask()
    import dask as base

    base.config.set(
        {
            "distributed.scheduler.allowed-failures": KILLS - 1,
            "distributed.worker.memory.terminate": False,
            "distributed.comm.timeouts.connect": "10s",
        }
    )
    if scheduler is not None:
        try:
            client = distributed.Client(scheduler, timeout="10s")
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"--scheduler {scheduler}: nothing answers there ({type(error).__name__})"
            ) from None
        with client:
            yield client
        return
    count = worker_count(workers, memory_gib)
    cores = max(1, (os.cpu_count() or 1) // count)
    threads = {name: str(cores) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    limit = int(max(memory_gib, 0.5) * 2**30)
    base.config.set({"distributed.nanny.pre-spawn-environ": threads})
    with (
        distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=limit,
            resources={MEMORY: limit / 2**20},
            silence_logs=50,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def memory_resource(client: Any, case: Case) -> dict[str, float]:
    """What a case asks of Dask's resources; nothing where the workers declare none."""
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    told = [w.get("resources", {}).get(MEMORY) for w in workers]
    known = [r for r in told if r]
    return {MEMORY: min(case.memory_gib * 1024, *known)} if known and len(known) == len(told) else {}


def send_parts(client: Any, parts: dict[str, Part]) -> None:
    """Brings each part to every worker once, those that join later included."""
    plugin_of = _part_plugin()
    for hash_, part in parts.items():
        client.register_plugin(plugin_of(hash_, _packed(part)), name=f"scanmotion-part-{hash_}")


def _packed(part: Part) -> bytes:
    """The arrays of a part as an .npz file."""
    data = io.BytesIO()
    np.savez(
        data,
        vertices=part.vertices,
        triangles=part.triangles,
        name=np.array(part.name),
        closed=np.array(part.closed),
    )
    return data.getvalue()


def _part_plugin() -> Any:
    from distributed import WorkerPlugin

    class PartOnWorker(WorkerPlugin):
        """Puts a part on the disk of its worker, for all cases that come there."""

        idempotent = True

        def __init__(self, hash_: str, data: bytes) -> None:
            self.hash_, self.data = hash_, data

        def setup(self, worker: Any) -> None:
            folder = Path(worker.local_directory) / "scanmotion-parts"
            folder.mkdir(parents=True, exist_ok=True)
            partial = folder / f".{self.hash_}.partial"
            partial.write_bytes(self.data)
            partial.rename(folder / f"{self.hash_}.npz")
            self.data = b""

    return PartOnWorker


def run_on_worker(case: Case, keep_in: str | None) -> CaseRow:
    """What a worker runs: the case, on the part that it holds."""
    from distributed import get_worker

    path = Path(get_worker().local_directory) / "scanmotion-parts" / f"{case.part_hash}.npz"
    return row_of(case, _part_in(path), keep_in=None if keep_in is None else Path(keep_in))


@lru_cache(maxsize=1)
def _part_in(path: Path) -> Part:
    """The part that a worker holds on its disk; cases come part by part, so the last one is kept at hand."""
    with np.load(path, allow_pickle=False) as file:
        return Part(
            name=str(file["name"]),
            vertices=file["vertices"],
            triangles=file["triangles"],
            closed=bool(file["closed"]),
        )
