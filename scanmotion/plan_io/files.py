"""The plan's folder on disk: it is replaced as a whole, or stays as it was."""

import ctypes
import os
import re
import shutil
import tempfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path

from scanmotion.core.errors import PlanFileError

PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
MARK = "plan.json"
_AT_FDCWD, _EXCHANGE = -100, 2
"""Linux: paths relative to the working directory; renameat2's RENAME_EXCHANGE."""


def atomic_folder(target: str | Path, files: Mapping[str, bytes | str], *, mark: str = MARK) -> Path:
    """Writes a folder of files so that a killed run leaves the old folder or the new one, never a mixture.

    Args:
        target: a new folder, an empty one, or a plan's folder, which is replaced.
        files: contents by plain file name.
        mark: name of the file by which a folder that may be replaced is known.

    Raises:
        PlanFileError: the folder cannot be written, or holds what is not such a folder.
    """
    check_names(files)
    with fresh_folder(target, mark=mark) as fresh:
        fill(fresh, files, target)
    return Path(os.path.realpath(target))


@contextmanager
def fresh_folder(target: str | Path, *, mark: str = MARK) -> Generator[Path]:
    """An empty folder that takes the place of `target` when the block ends without an exception.

    Args:
        target: a new folder, an empty one, or a plan's folder.
        mark: name of the file by which a folder that may be replaced is known.

    Raises:
        PlanFileError: the folder cannot be written, or holds what is not a plan.
    """
    target = Path(os.path.realpath(target))
    try:
        if target.exists() and not (target.is_dir() and _replaceable(target, mark)):
            raise PlanFileError(f"{target}: holds something that is not a plan; it is left as it is")
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise _unwritable(target, error) from None
    try:
        fresh = work / "new"
        try:
            fresh.mkdir()
        except OSError as error:
            raise _unwritable(target, error) from None
        yield fresh
        try:
            _take_place(fresh, target, work / "old")
        except OSError as error:
            raise _unwritable(target, error) from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def check_names(names: Mapping[str, bytes | str]) -> None:
    """Refuses names that lead out of the folder.

    Raises:
        PlanFileError: with the name.
    """
    for name in names:
        if not PLAIN_NAME.fullmatch(name):
            raise PlanFileError(f"{name!r} is not a plain file name")


def fill(folder: Path, files: Mapping[str, bytes | str], told: str | Path) -> None:
    """Writes files into a fresh folder.

    Args:
        folder: where to.
        files: contents by plain file name.
        told: the folder's name in messages.

    Raises:
        PlanFileError: a file cannot be written.
    """
    check_names(files)
    try:
        for name, content in files.items():
            data = content.encode("utf-8") if isinstance(content, str) else content
            (folder / name).write_bytes(data)
    except OSError as error:
        raise _unwritable(Path(os.path.realpath(told)), error) from None


def _unwritable(target: Path, error: OSError) -> PlanFileError:
    return PlanFileError(f"{target}: cannot be written ({error.strerror})")


def _replaceable(folder: Path, mark: str) -> bool:
    return (folder / mark).is_file() or not any(folder.iterdir())


def _take_place(fresh: Path, target: Path, old: Path) -> None:
    """Puts `fresh` where `target` is, in one step where the system has one."""
    if not target.exists():
        os.replace(fresh, target)
        return
    if _exchanged(fresh, target):
        return
    # Two steps elsewhere: in between, the old folder lies beside the target under its temporary name.
    os.replace(target, old)
    try:
        os.replace(fresh, target)
    except OSError:
        os.replace(old, target)
        raise


def _exchanged(a: Path, b: Path) -> bool:
    """Whether the two folders have changed places by Linux's renameat2."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    return rename(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _EXCHANGE) == 0
