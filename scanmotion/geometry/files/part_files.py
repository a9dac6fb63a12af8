"""The door for files of meshes and clouds: what each ending is read by, and the checks before it.

A file is read whole or refused in one clear line. Every count that a header claims is held against the
file's size before anything is allocated. docs/files.md says what each reader understands.
"""

import mmap
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.geometry.files.clouds.pcd import read_pcd
from scanmotion.geometry.files.clouds.ptx import read_ptx
from scanmotion.geometry.files.clouds.text_clouds import read_text_cloud
from scanmotion.geometry.files.formats.obj import read_obj, read_off
from scanmotion.geometry.files.formats.ply_read import read_ply
from scanmotion.geometry.files.formats.stl import read_stl
from scanmotion.geometry.files.in_process import read_by_library
from scanmotion.geometry.files.raw import RawGeometry
from scanmotion.geometry.files.strangers import content_kind, stranger_by_content, stranger_by_name
from scanmotion.geometry.files.thin import MAX_TEXT, MAX_TRIANGLES, lines_by_number, stride_of, thinned

__all__ = ["MAX_BYTES", "MAX_TRIANGLES", "MESHES", "SUFFIXES", "RawGeometry", "read_geometry"]

MAX_BYTES = 4 << 30
"""Of files that are read whole. A binary STL is read piece by piece, a text cloud's lines are thinned."""
_MAPPED = 1 << 28
"""A larger STL is looked at where it lies, not copied."""
_TIMES, _LEAST = 5, 1 << 30
"""Reading and mending takes some GiB, and memory of so many times the file."""
_READERS: dict[str, Callable[[bytes], RawGeometry]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".off": read_off,
    ".pcd": read_pcd,
    ".ptx": read_ptx,
}
_LIBRARIES = (".glb", ".gltf", ".3mf", ".e57")
_TEXTS = (".xyz", ".asc", ".txt", ".csv", ".pts", ".xyzn", ".xyzrgb", ".neu")
SUFFIXES = (*_READERS, ".stl", *_LIBRARIES, *_TEXTS)
MESHES = (".ply", ".stl", ".obj", ".off", ".glb", ".gltf", ".3mf")


def read_geometry(path: str | Path) -> RawGeometry:
    """Reads a mesh or a cloud.

    Raises:
        PartError: no such file, unknown kind of file, or content that is not what its header says.
    """
    path = Path(path)
    if not path.exists():
        raise PartError("no such file", path=str(path))
    if not path.is_file():
        raise PartError("is not a file", path=str(path))
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        if what := stranger_by_name(suffix):
            raise PartError(what, path=str(path))
        raise PartError(f"unknown kind of file {suffix!r}; known: {', '.join(SUFFIXES)}", path=str(path))
    size = path.stat().st_size
    if size == 0:
        raise PartError("the file is empty", path=str(path))
    try:
        return thinned(_read(path, suffix))
    except MemoryError:
        raise PartError("needs more memory than there is; decimate it", path=str(path)) from None
    except PartError as error:
        raise PartError(str(error), path=str(path)) from None
    except (ValueError, IndexError, KeyError, OverflowError, TypeError, struct.error) as error:
        raise PartError(f"is not a readable {suffix[1:].upper()} file ({error})", path=str(path)) from None
    except OSError as error:
        raise PartError(f"cannot be read ({error.strerror})", path=str(path)) from None


def _read(path: Path, suffix: str) -> RawGeometry:
    with path.open("rb") as file:
        head = file.read(2048)
    if what := stranger_by_content(head, suffix):
        raise PartError(what)
    kind = content_kind(head, suffix)
    if kind in _LIBRARIES:
        if kind != suffix:
            raise PartError(f"its content is that of a {kind[1:].upper()} file; name it so")
        return read_by_library(path)
    data, note = _content(path, kind)
    if not head.strip(b"\0") and not data[:].strip(b"\0"):
        raise PartError("holds nothing but zeros: writing or copying it failed")
    # Damaged numbers (signalling NaN, infinities) are found and said later; numpy need not warn of them.
    with np.errstate(all="ignore"):
        if kind in _TEXTS:
            raw = read_text_cloud(data[:], kind[1:].upper(), whole=not note)
        else:
            raw = read_stl(data) if kind == ".stl" else _READERS[kind](data[:])
    if note:
        raw = replace(raw, notes=(note, *raw.notes))
    if kind != suffix:
        raw = replace(
            raw, notes=(f"its ending says {suffix[1:].upper()}, its content {raw.format}", *raw.notes)
        )
    return raw


def _content(path: Path, kind: str) -> tuple[bytes | mmap.mmap, str]:
    """The bytes of a file, and what is to be said if they are not all.

    Raises:
        PartError: it is too large to be read whole.
    """
    size = path.stat().st_size
    if kind in _TEXTS and (every := stride_of(size, MAX_TEXT)) > 1:
        _check_memory(MAX_TEXT)
        return lines_by_number(path, every), f"its lines were thinned: one of {every} was read"
    if kind == ".stl" and size > _MAPPED:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), ""
    if size > MAX_BYTES:
        raise PartError(
            f"{size / 2**30:.1f} GiB is more than the {MAX_BYTES >> 30} GiB that are read of its kind; "
            "as binary STL or text cloud it is thinned"
        )
    _check_memory(size)
    return path.read_bytes(), ""


def _check_memory(size: int) -> None:
    """Refuses what would take more memory than is free, where the system tells: it would be killed.

    Raises:
        PartError: with both.
    """
    needed = _TIMES * size + _LEAST
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        free = next(int(x.split()[1]) << 10 for x in lines if x.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError, IndexError):
        return
    if size > 1 << 28 and needed > free:
        raise PartError(
            f"needs some {needed / 2**30:.0f} GiB of memory, {free / 2**30:.1f} GiB are free; decimate it"
        )
