"""Viewpoints as CSV or JSON, written and strictly read back."""

import csv
import io
import json
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from scanmotion.core.errors import InputError
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.export.job import ExportJob, Files
from scanmotion.export.source import checked_id, checked_line, write_files
from scanmotion.plan_io.schema import ViewpointRecord

HEADER: tuple[str, ...] = (
    "id", "step", "kind", "sweep", "standoff_mm", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz",
    "slack_near_mm", "slack_far_mm", "slack_tilt_deg", "slack_roll", "note",
)  # fmt: skip
DEFAULTS: dict[str, str] = {
    "step": "local", "kind": "station", "sweep": "", "slack_near_mm": "0", "slack_far_mm": "0",
    "slack_tilt_deg": "0", "slack_roll": "1", "note": "",
}  # fmt: skip
"""What a column means that a file of somebody's own may lack."""
DIRECTION = ("dx", "dy", "dz")
"""Columns of a viewing direction in place of a quaternion; the scanner's long side is then horizontal."""
_QUATERNION = {"qw", "qx", "qy", "qz"}
VERSION = 1
MAX_VIEWPOINTS = 100_000
_MAX_BYTES = 64 << 20


def viewpoint_files(job: ExportJob) -> Files:
    """Every viewpoint of a plan, served or not, as CSV and as JSON."""
    source, name = job.source, job.name
    views = [_view(v) for v in source.record.viewpoints]
    return {
        f"{name}_viewpoints.csv": viewpoints_csv(views),
        f"{name}_viewpoints.json": viewpoints_json(views),
    }


def write_viewpoints(viewpoints: Iterable[Viewpoint], path: str | Path) -> Path:
    """Writes viewpoints to a .csv or .json file, whole or not at all.

    Raises:
        InputError: another ending, or the file cannot be written.
    """
    path, views = Path(path), list(viewpoints)
    text = viewpoints_csv(views) if _suffix(path) == ".csv" else viewpoints_json(views)
    return write_files(path.parent, {path.name: text})[0]


def read_viewpoints(path: str | Path) -> tuple[Viewpoint, ...]:
    """Viewpoints of a .csv or .json file that `write_viewpoints` wrote, or that somebody wrote like it.

    Raises:
        InputError: with the file, the line or entry, and what is wrong with it.
    """
    path = Path(path)
    suffix = _suffix(path)
    if not path.is_file():
        # Reading a pipe or a device might never end.
        raise InputError(f"{path}: cannot be read ({'not a file' if path.exists() else 'no such file'})")
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path}: more than {_MAX_BYTES >> 20} MiB of viewpoints")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text") from None
    views = _from_csv(path, text) if suffix == ".csv" else _from_json(path, text)
    if not 0 < len(views) <= MAX_VIEWPOINTS:
        raise InputError(f"{path}: between 1 and {MAX_VIEWPOINTS} viewpoints are expected, not {len(views)}")
    seen: set[str] = set()
    for v in views:
        if v.id in seen:
            raise InputError(f"{path}: viewpoint {v.id} is there twice")
        seen.add(v.id)
    return tuple(views)


def viewpoints_csv(views: Iterable[Viewpoint]) -> str:
    """One row a viewpoint; lengths in mm, the orientation of S in O as a unit quaternion."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEADER)
    for v in views:
        lengths = [v.standoff, *v.p_OS]
        slack = [v.slack.standoff[0] * 1e3, v.slack.standoff[1] * 1e3, math.degrees(v.slack.tilt)]
        rows.writerow(
            [
                checked_id(v.id), v.step, v.kind, checked_line(v.sweep, f"{v.id}: sweep"),
                *(_digits(x * 1e3) for x in lengths), *(_digits(x) for x in quaternion(v.X_OS[:3, :3])),
                *(_digits(x) for x in slack), int(v.slack.roll), checked_line(v.note, f"{v.id}: note"),
            ]
        )  # fmt: skip
    return text.getvalue()


def viewpoints_json(views: Iterable[Viewpoint]) -> str:
    """A document with the entries of plan.json: metres, radians, poses as 4x4 matrices."""
    entries = [
        {
            "id": checked_id(v.id), "X_OS": v.X_OS.tolist(), "standoff_m": v.standoff, "step": v.step,
            "kind": v.kind, "sweep": checked_line(v.sweep, f"{v.id}: sweep"),
            "slack_standoff_m": list(v.slack.standoff), "slack_tilt_rad": v.slack.tilt,
            "slack_roll": v.slack.roll, "note": checked_line(v.note, f"{v.id}: note"),
        }
        for v in views
    ]  # fmt: skip
    return json.dumps({"version": VERSION, "viewpoints": entries}, indent=1, allow_nan=False) + "\n"


def quaternion(R: np.ndarray) -> np.ndarray:
    """Unit quaternion (w, x, y, z) of a rotation matrix, w >= 0, shape (4,).

    The eigenvector of Bar-Itzhack's symmetric matrix: as exact at half a turn as anywhere else.
    """
    K = np.array(
        [
            [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2]],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]],
            [R[1, 0] - R[0, 1], R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    q = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0 else -q


def rotation(q: np.ndarray) -> np.ndarray:
    """Rotation matrix of a unit quaternion (w, x, y, z), shape (3, 3)."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _digits(value: float) -> str:
    """Shortest text that reads back to the same number to 1e-12."""
    return f"{round(float(value), 12) + 0.0:.12f}".rstrip("0").rstrip(".")


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".json"):
        raise InputError(f"{path}: viewpoints are written and read as .csv or .json")
    return suffix


def _from_csv(path: Path, text: str) -> list[Viewpoint]:
    try:
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except csv.Error as error:
        raise InputError(f"{path}: is not CSV ({error})") from None
    header = _header(path, [name.strip() for name in rows[0]] if rows else [])
    views = []
    for n, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise InputError(f"{path}: row {n} has {len(row)} fields instead of {len(header)}")
        cell = DEFAULTS | dict(zip(header, (text.strip() for text in row), strict=True))
        try:
            entry = _entry(cell)
        except ValueError as error:
            raise InputError(f"{path}: row {n}: {error}") from None
        views.append(_checked(path, f"row {n}", entry))
    return views


def _header(path: Path, header: list[str]) -> list[str]:
    """The names of the columns, in any order; those with a default may lack.

    Raises:
        InputError: with the column that is unknown, there twice, or lacking.
    """
    known = {*HEADER, *DIRECTION}
    strange = [name for name in header if name not in known]
    if strange:
        raise InputError(
            f"{path}: column {strange[0][:40]!r} is unknown; known: {', '.join(HEADER)}, dx, dy, dz"
        )
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise InputError(f"{path}: column {twice[0]} is there twice")
    turned, aimed = _QUATERNION & set(header), set(DIRECTION) & set(header)
    if turned and aimed:
        raise InputError(f"{path}: give the quaternion qw, qx, qy, qz or the direction dx, dy, dz, not both")
    needed = [name for name in HEADER if name not in DEFAULTS and name not in _QUATERNION]
    needed += DIRECTION if aimed else sorted(_QUATERNION)
    lacking = [name for name in needed if name not in header]
    if lacking:
        raise InputError(f"{path}: column {lacking[0]} is missing in the first line")
    return header


def _pose(number: dict[str, float]) -> np.ndarray:
    """X_OS, shape (4, 4) [m], of the columns of a row."""
    p_OS = np.array([number[key] * 1e-3 for key in ("x_mm", "y_mm", "z_mm")])
    if DIRECTION[0] in number:
        along = np.array([number[key] for key in DIRECTION])
        if not 1e-9 < np.linalg.norm(along) < 1e9:
            raise ValueError("dx, dy, dz is not a direction")
        return look_at(p_OS, along)
    q = np.array([number[key] for key in ("qw", "qx", "qy", "qz")])
    if np.abs(q).max() > 2 or abs(np.linalg.norm(q) - 1) > 1e-3:
        raise ValueError("qw, qx, qy, qz is not a unit quaternion")
    X_OS = np.eye(4)
    X_OS[:3, :3] = rotation(q / np.linalg.norm(q))
    X_OS[:3, 3] = p_OS
    return X_OS


def _entry(cell: dict[str, str]) -> dict[str, object]:
    """A row in the schema of plan.json."""
    words = ("id", "step", "kind", "sweep", "slack_roll", "note")
    number = {key: float(text) for key, text in cell.items() if key not in words}
    if not all(map(math.isfinite, number.values())):
        raise ValueError("a number is not finite")
    if cell["slack_roll"] not in ("0", "1"):
        raise ValueError(f"slack_roll is 0 or 1, not {cell['slack_roll'][:20]!r}")
    X = _pose(number)
    return {
        "id": cell["id"], "step": cell["step"], "kind": cell["kind"], "sweep": cell["sweep"],
        "standoff_m": number["standoff_mm"] * 1e-3, "X_OS": X.tolist(),
        "slack_standoff_m": (number["slack_near_mm"] * 1e-3, number["slack_far_mm"] * 1e-3),
        "slack_tilt_rad": math.radians(number["slack_tilt_deg"]),
        "slack_roll": cell["slack_roll"] == "1", "note": cell["note"],
    }  # fmt: skip


def _from_json(path: Path, text: str) -> list[Viewpoint]:
    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not a number of JSON")

    try:
        data = json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({' '.join(str(error).split())[:120]})") from None
    if not isinstance(data, dict) or data.get("version") != VERSION or set(data) != {"version", "viewpoints"}:
        raise InputError(f"{path}: an object with version {VERSION} and viewpoints is expected")
    if not isinstance(data["viewpoints"], list):
        raise InputError(f"{path}: viewpoints is not a list")
    return [_checked(path, f"viewpoint {n}", entry) for n, entry in enumerate(data["viewpoints"], 1)]


def _checked(path: Path, where: str, entry: object) -> Viewpoint:
    try:
        record = ViewpointRecord.model_validate(entry)
        checked_id(record.id)
        checked_line(record.sweep, "sweep")
        checked_line(record.note, "note")
    except (ValidationError, RecursionError) as error:
        text = "is nested too deeply"
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            text = f"{'.'.join(str(p) for p in first['loc'])}: {first['msg']}"
        raise InputError(f"{path}: {where}: {' '.join(text.split())[:200]}") from None
    except InputError as error:
        raise InputError(f"{path}: {where}: {error}") from None
    return _view(record)


def _view(v: ViewpointRecord) -> Viewpoint:
    return Viewpoint(
        id=v.id, X_OS=np.array(v.X_OS), standoff=v.standoff_m, step=v.step, kind=v.kind, sweep=v.sweep,
        slack=Slack(standoff=v.slack_standoff_m, tilt=v.slack_tilt_rad, roll=v.slack_roll), note=v.note,
    )  # fmt: skip
