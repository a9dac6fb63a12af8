"""What every writer starts from, which text it may pass on, and how files reach the disk."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scanmotion.core.errors import InputError, PlanFileError
from scanmotion.core.support.whole_file import write_together
from scanmotion.core.trajectory import Operation, Trajectory
from scanmotion.plan_io.read import read_plan, read_trajectory
from scanmotion.plan_io.schema import PlanRecord

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,39}")
_WINDOWS = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch:
    """An operation with its samples, the instant at which it starts included."""

    operation: Operation
    t: np.ndarray
    """Shape (n,) [s], n >= 2."""
    q: np.ndarray
    """Shape (n, 7) [rad]."""
    qd: np.ndarray
    """Shape (n, 7) [rad/s]."""

    @property
    def duration(self) -> float:
        """Seconds from rest to rest."""
        return float(self.t[-1] - self.t[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """A plan as it stands in its folder."""

    folder: Path
    record: PlanRecord
    trajectory: Trajectory

    def stretches(self) -> list[Stretch]:
        """The operations in order; those that last no time are left out."""
        t = self.trajectory
        found = []
        for index in np.unique(t.operation):
            own = np.flatnonzero(t.operation == index)
            span = slice(max(own[0] - 1, 0), own[-1] + 1)
            if span.stop - span.start >= 2:
                operation = t.operations[index]
                found.append(Stretch(operation=operation, t=t.t[span], q=t.q[span], qd=t.qd[span]))
        return found


def source_from(folder: str | Path) -> Source:
    """Reads a plan for export. A plan starts and ends at rest, so its first and last velocity are zero.

    Raises:
        PlanFileError: the plan cannot be read, its operations are not in order, or an id is not plain.
    """
    folder = Path(folder)
    record = read_plan(folder)
    trajectory = read_trajectory(folder, record)
    if (np.diff(trajectory.operation) < 0).any():
        raise PlanFileError("trajectory.csv: the operations are not in order")
    for name in {i for o in trajectory.operations for i in o.viewpoints} | {v.id for v in record.viewpoints}:
        checked_id(name)
    qd = trajectory.qd.copy()
    qd[[0, -1]] = 0.0
    return Source(folder=folder, record=record, trajectory=replace(trajectory, qd=qd))


def checked_name(name: str) -> str:
    """A name for files that no system takes for a path, an option or a device.

    Raises:
        InputError: another name.
    """
    if not _NAME.fullmatch(name) or _WINDOWS.fullmatch(name):
        raise InputError(
            f"--name {name[:80]!r}: is no name for a programme (letters, digits and _, a letter first)"
        )
    return name


def checked_id(name: str) -> str:
    """The id of a viewpoint, which goes into programmes and tables.

    Raises:
        InputError: it holds more than letters, digits, dots, dashes, plus signs and underscores.
    """
    if not _ID.fullmatch(name):
        raise InputError(
            f"viewpoint {name[:80]!r}: an id of up to 40 letters, digits, '.', '-', '+' or '_' is expected"
        )
    return name


def checked_line(text: str, what: str) -> str:
    """Free text that goes into a comment or a table's cell: one printable line and no spreadsheet formula.

    Raises:
        InputError: with `what` in front.
    """
    if not text.isprintable() or text.startswith(("=", "+", "-", "@")):
        raise InputError(f"{what} {text[:80]!r}: one line of plain text is expected")
    return text


def check_targets(source: Source, target: Path, files: Mapping[str, bytes | str]) -> None:
    """An export never replaces a file that the plan itself is made of.

    Raises:
        InputError: with the file's name.
    """
    try:
        own = target.resolve() == source.folder.resolve()
    except OSError:
        own = False
    record = source.record
    plan = {"plan.json", "summary.json", "trajectory.csv", "trajectory.json", "holes.json", "scan.npz"}
    plan |= {"frames.csv", "frames.json"}
    plan |= {record.urdf_file.lower(), record.part_file.lower(), record.cell_file.lower()}
    for name in files:
        if own and name.lower() in plan:
            raise InputError(f"{name}: is a file of the plan; choose another --name or --out")


def write_files(folder: Path, files: Mapping[str, bytes | str]) -> list[Path]:
    """Writes all files under temporary names first, then renames them; a failure leaves the old ones.

    Args:
        folder: made if missing.
        files: content by name; a name may lie in a folder of its own ("bag/metadata.yaml").

    Raises:
        InputError: the folder cannot be written.
    """
    paths = {folder / name: content for name, content in files.items()}
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
        write_together(paths)
    except IsADirectoryError as error:
        raise InputError(f"{error.filename}: is a folder") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
    return list(paths)
