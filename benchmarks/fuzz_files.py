"""Damaged files of parts and scans by the thousand: each ends in a part or in one clear line.

    python benchmarks/fuzz_files.py --files 100000

The files go by batches, each in a process of its own that is forked from this one, so that nothing is
imported twice and a reader that crashes is counted too. Every traceback, warning, hang and reach for memory
is counted and its file kept; the status is 1 if there was one. GLB and 3MF, whose library runs in a process
of its own, come once in --rare files.
"""

import argparse
import multiprocessing
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from mesh_dialects import MESHES
from second_clouds import CLOUDS as MORE_CLOUDS
from second_clouds import GROUPED
from second_list import MESHES as MORE_MESHES
from test_cloud_dialects import CLOUDS
from test_fuzz import damaged

from scanmotion.core.errors import PartError
from scanmotion.geometry.parts.make_part import part_from_file

SECONDS = 20.0
GIB = 1 << 30
LINES = 320
"""Clouds of text are cut to so many lines: damage is as likely, reading ten times as fast."""

NUMBERS = (
    b"0", b"-0", b"1", b"3", b"-1", b"255", b"1e30", b"-1e308", b"1e-320", b"nan", b"inf", b"2147483648",
    b"1e400", b"7.", b".5", b"+2", b"1d3", b"--", b"50", b"9.99999999999999999",
)  # fmt: skip


@dataclass
class Batch:
    """What became of some files."""

    read: int = 0
    refused: int = 0
    slowest: tuple[float, str] = (0.0, "")
    peak: int = 0
    """Memory beyond the start [byte]."""
    said: Counter = field(default_factory=Counter)
    """The refusals by their first words."""
    failures: list[tuple[str, str, str]] = field(default_factory=list)
    """File's number, its name, and the last lines of the traceback."""


class Hang(BaseException):
    """A file took longer than its limit."""


def main() -> int:
    ask = argparse.ArgumentParser()
    ask.add_argument("--files", type=int, default=2000)
    ask.add_argument("--seed", type=int, default=0)
    ask.add_argument("--batch", type=int, default=2500)
    ask.add_argument("--rare", type=int, default=1000)
    ask.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "fuzz")
    a = ask.parse_args()
    seeds, rare = common_seeds(), rare_seeds()
    signal.signal(signal.SIGPROF, _stop)
    whole, began, done = Batch(), time.process_time(), 0
    while done < a.files:
        n = min(a.batch, a.files - done)
        made = in_a_fork(a, done, n, seeds, rare)
        whole.read, whole.refused = whole.read + made.read, whole.refused + made.refused
        whole.slowest, whole.peak = max(whole.slowest, made.slowest), max(whole.peak, made.peak)
        whole.said.update(made.said)
        whole.failures += made.failures
        done += n
        for number, name, what in made.failures:
            print(f"-- file {number} of seed {a.seed} ({name}), kept in {a.keep}:\n{what}", flush=True)
        print(f"{done} files, {len(whole.failures)} failures", flush=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{a.files} damaged files of seed {a.seed}: {whole.read} read, {whole.refused} refused, "
        f"{len(whole.failures)} failures; slowest {whole.slowest[0]:.2f} s of CPU ({whole.slowest[1]}), peak "
        f"{whole.peak / 2**20:.0f} MiB over the start; "
        f"{used.ru_utime + used.ru_stime + time.process_time() - began:.0f} s of CPU"
    )
    for words, n in whole.said.most_common(40):
        print(f"{n:8d}  {words}")
    return 1 if whole.failures else 0


def common_seeds() -> dict[str, bytes]:
    """The dialects of meshes and of clouds, both lists, short."""
    clouds = {**CLOUDS, **MORE_CLOUDS, **GROUPED}
    seeds = {**MESHES, **MORE_MESHES, **{f"c_{name}": shortened(name, data) for name, data in clouds.items()}}
    return {name: data for name, data in seeds.items() if not name.endswith((".glb", ".3mf"))}


def shortened(name: str, data: bytes) -> bytes:
    """Text of few lines; what counts its points is left as it is."""
    if name.endswith((".pts", ".ptx", ".pcd")) or b"\0" in data:
        return data
    mark = b"\n" if b"\n" in data else b"\r"
    return mark.join(data.split(mark)[:LINES])


def rare_seeds() -> dict[str, bytes]:
    """Files of the kinds that a library reads."""
    return {name: data for name, data in MORE_MESHES.items() if name.endswith((".glb", ".3mf"))}


def altered(seed: bytes, rng: np.random.Generator) -> bytes:
    """Up to six words or bytes are others: many such files are read, so that what follows is tried too."""
    data = bytearray(seed)
    for _ in range(rng.integers(1, 7)):
        at = int(rng.integers(len(data)))
        word = re.compile(rb"[^\s,;]+").search(data, at)
        if b"\0" in seed or word is None or word.end() - at > 40:
            data[at] = int(rng.integers(256))
        else:
            data[word.start() : word.end()] = NUMBERS[int(rng.integers(len(NUMBERS)))]
    return bytes(data)


def in_a_fork(a: argparse.Namespace, first: int, n: int, seeds: dict, rare: dict) -> Batch:
    """The files `first` to `first` + n, in a process of their own."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_send, args=(theirs, a, first, n, seeds, rare))
    child.start()
    theirs.close()
    try:
        made = ours.recv()
    except EOFError:
        made = None
    child.join()
    if made is None:
        made = Batch(
            failures=[(f"{first}..{first + n - 1}", "?", f"its process ended with {child.exitcode}")]
        )
    return made


def _send(pipe, a: argparse.Namespace, first: int, n: int, seeds: dict, rare: dict) -> None:
    pipe.send(batch(a, first, n, seeds, rare))


def batch(a: argparse.Namespace, first: int, n: int, seeds: dict, rare: dict) -> Batch:
    """Reads damaged files; any can be made again from its number and the seed."""
    made, names, others = Batch(), list(seeds), list(rare)
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory() as folder:
        for i in range(first, first + n):
            odd = i % a.rare == a.rare - 1
            name = others[i // a.rare % len(others)] if odd else names[i % len(names)]
            rng = np.random.default_rng([a.seed, i])
            whole = (rare if odd else seeds)[name]
            data = damaged(whole, rng) if i % 2 else altered(whole, rng)
            path = Path(folder) / name
            path.write_bytes(data)
            began = time.process_time()
            before = len(made.failures)
            _read(path, i, made)
            made.slowest = max(made.slowest, (time.process_time() - began, name))
            peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start) * 1024
            if peak > GIB and made.peak <= GIB:
                made.failures.append((str(i), name, f"{peak / GIB:.2f} GiB over the start"))
            made.peak = max(made.peak, peak)
            if len(made.failures) > before:
                a.keep.mkdir(parents=True, exist_ok=True)
                (a.keep / f"{a.seed}-{i}-{name}").write_bytes(data)
            path.unlink()
    return made


def _read(path: Path, number: int, made: Batch) -> None:
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            part = part_from_file(path, guess=True)
        if not np.isfinite(part.vertices).all():
            raise AssertionError("points that are not finite")
        made.read += 1
    except PartError as error:
        made.refused += 1
        words = str(error).removeprefix(f"{path}: ")
        made.said[" ".join("#" if any(c.isdigit() for c in w) else w for w in words.split()[:7])] += 1
        if "\n" in str(error) or len(str(error)) > 600:
            made.failures.append((str(number), path.name, f"more than a line: {str(error)[:300]}"))
    except Hang:
        made.failures.append((str(number), path.name, f"more than {SECONDS} s"))
    except Exception:
        made.failures.append((str(number), path.name, traceback.format_exc(limit=-4)))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _stop(*_: object) -> None:
    raise Hang


if __name__ == "__main__":
    sys.exit(main())
