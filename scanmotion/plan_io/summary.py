"""summary.json, holes.json and scan.npz of a plan's folder, read strictly: pages and reports rely on them.

What a page does not show may be in the files too, and is left as it is.
"""

import io
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from scanmotion.core.errors import PlanFileError
from scanmotion.plan_io.schema import inside, read_json

_MAX_ARRAYS = 512 << 20
_MAX_HOLES = 10_000

Real = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Triple = Annotated[list[Real], Field(min_length=3, max_length=3)]
_Row = Annotated[list[Real], Field(min_length=4, max_length=4)]
Count = Annotated[int, Field(ge=0, le=10**9)]


class _Open(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)


class _LeftOut(_Open):
    id: str
    reason: str


class _Viewpoints(_Open):
    global_: Count = Field(alias="global")
    local: Count
    unreachable: list[_LeftOut]


class _Completeness(_Open):
    after_global: Real | None
    final: Real | None
    final_of_whole: Real | None


class _Reach(_Open):
    share: Real | None
    scanned: Real | None


class _Round(_Open):
    step: str
    viewpoints: Count
    completeness: Real | None


class _Patch(_Open):
    center_mm: Triple
    area_mm2: Real
    reason: str


class _Accuracy(_Open):
    mean_abs_mm: Real | None
    sd_signed_mm: Real | None
    mean_signed_mm: Real | None


class _Time(_Open):
    total: Real
    arm: Real
    table: Real
    sweep: Real
    dwell: Real
    floor: Real


class _Cost(_Open):
    operation: Count
    kind: str
    viewpoints: list[str]
    seconds: Real
    of_which_way: Real
    completeness_lost_without: Real | None


class _Point(_Open):
    seconds: Real
    completeness: Real


class _Budget(_Open):
    limit_s: Real
    ok: bool
    costliest: list[_Cost] = []
    by_order: list[_Point] = []
    curve: list[_Point] = []
    advice: list[str] = []


class _Helix(_Open):
    taken: bool
    note: str


class _Read(_Open):
    file: str
    format: str
    points: Count
    triangles: Count
    size_mm: Triple
    units: str
    units_from: str
    columns: list[str]
    bodies: Count
    specks: Count
    changes: list[str]
    warnings: list[str]


class _Summary(_Open):
    viewpoints: _Viewpoints
    completeness: _Completeness
    within_reach: _Reach = _Reach(share=None, scanned=None)
    rounds: list[_Round]
    searched: list[_Round] = []
    unscanned: list[_Patch] = []
    accuracy: _Accuracy
    time_s: _Time
    budget: _Budget
    helix: _Helix | None = None
    findings: list[str | dict[str, Any]]
    planning_s: dict[str, Real]
    read: _Read | None = None


class _Hole(_Open):
    kind: str
    boundary: list[Triple] = Field(min_length=3, max_length=1_000_000)
    center: Triple
    normal: Triple
    X_OH: Annotated[list[_Row], Field(min_length=4, max_length=4)]
    extent: Triple
    perimeter: Real
    area: Real


_ARRAYS = ("boundary", "center", "normal", "X_OH", "extent")


class _Holes(_Open):
    units: Literal["m"] = "m"
    holes: list[_Hole] = Field(max_length=_MAX_HOLES)


def read_summary(folder: Path) -> dict[str, Any]:
    """summary.json.

    Raises:
        PlanFileError: it cannot be read, or a key that pages show is missing or of another type.
    """
    data = read_json(folder, "summary.json")
    _check("summary.json", _Summary, data)
    return data


def read_holes(folder: Path) -> Any:
    """holes.json, with `holes`, `tiny` and `notes`; None where there is none, or no hole in it.

    Raises:
        PlanFileError: it cannot be read.
    """
    if not (folder / "holes.json").exists():
        return None
    data = read_json(folder, "holes.json")
    _check("holes.json", _Holes, data)
    holes = [
        SimpleNamespace(**{k: np.array(item[k]) if k in _ARRAYS else item[k] for k in _Hole.model_fields})
        for item in data["holes"]
    ]
    return SimpleNamespace(holes=tuple(holes), tiny=(), notes=()) if holes else None


def read_arrays(folder: Path, rounds: int) -> dict[str, np.ndarray]:
    """Samples, their normals, what can be seen and what each round saw; empty where scan.npz has none.

    Args:
        folder: of the plan.
        rounds: how many rows `seen` must have.

    Raises:
        PlanFileError: it cannot be read, or the arrays do not fit one another.
    """
    arrays = _arrays(folder, ("samples", "sample_normals", "visible", "seen"))
    if len(arrays) < 4:
        return {}
    n = len(np.atleast_1d(arrays["visible"]))
    _fits(arrays, {"samples": (n, 3), "sample_normals": (n, 3)}, "f")
    _fits(arrays, {"visible": (n,), "seen": (rounds, n)}, "b")
    return arrays


def read_cloud(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """The fused cloud of a plan: points and their normals, shape (n, 3) each [m].

    Raises:
        PlanFileError: it cannot be read, or is missing.
    """
    arrays = _arrays(folder, ("cloud", "normals"))
    if len(arrays) < 2:
        raise PlanFileError("scan.npz: the measured cloud is missing")
    n = len(np.atleast_1d(arrays["cloud"]))
    _fits(arrays, {"cloud": (n, 3), "normals": (n, 3)}, "f")
    return arrays["cloud"].astype(float), arrays["normals"].astype(float)


def _arrays(folder: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Those of the arrays of scan.npz that are there."""
    if not (folder / "scan.npz").exists():
        return {}
    path = inside(folder, "scan.npz")
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(i.file_size for i in archive.infolist()) > _MAX_ARRAYS:
                raise PlanFileError("scan.npz: holds more than a plan's arrays")
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            return {name: data[name] for name in names if name in data.files}
    except PlanFileError:
        raise
    except Exception as error:
        # numpy and zipfile raise a dozen kinds of errors at damaged files, SyntaxError among them.
        text = " ".join(str(error).split())[:80] or type(error).__name__
        raise PlanFileError(f"scan.npz: cannot be read ({text})") from None


def _fits(arrays: dict[str, np.ndarray], shapes: dict[str, tuple[int, ...]], kind: str) -> None:
    for name, shape in shapes.items():
        array = arrays[name]
        if array.shape != shape or array.dtype.kind != kind or not np.isfinite(array).all():
            raise PlanFileError(f"scan.npz: {name} is not what belongs there")


def _check(name: str, model: type[BaseModel], data: Any) -> None:
    try:
        model.model_validate(data)
    except (ValidationError, RecursionError) as error:
        text = "is nested too deeply"
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            text = f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
        raise PlanFileError(f"{name}: {' '.join(text.split())[:200]}") from None
