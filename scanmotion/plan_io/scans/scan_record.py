"""holes.json and scan.npz: the first scan's holes, the fused cloud, and which surface was seen when."""

import io
import zipfile
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, JsonValue

from scanmotion.core.errors import PlanFileError
from scanmotion.core.summary import Open, Real, Triple
from scanmotion.plan_io.read import checked, inside, read_json
from scanmotion.planning.plan import Plan
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.holes.find import Hole, HoleReport, Kind

_MAX_ARRAYS = 512 << 20
_MAX_HOLES = 10_000
_Row = Annotated[list[Real], Field(min_length=4, max_length=4)]


class _Hole(Open):
    kind: Kind
    boundary: list[Triple] = Field(min_length=3, max_length=1_000_000)
    center: Triple
    normal: Triple
    X_OH: Annotated[list[_Row], Field(min_length=4, max_length=4)]
    extent: Triple
    perimeter: Real
    area: Real


class _Holes(Open):
    units: Literal["m"] = "m"
    holes: list[_Hole] = Field(max_length=_MAX_HOLES)


def hole_records(plan: Plan) -> list[dict[str, JsonValue]]:
    """The holes of the first scan, in metres in O."""
    return [
        {
            "kind": h.kind, "boundary": np.round(h.boundary, 6).tolist(), "center": h.center.tolist(),
            "normal": h.normal.tolist(), "X_OH": h.X_OH.tolist(), "extent": h.extent.tolist(),
            "perimeter": h.perimeter, "area": h.area,
        }
        for h in (plan.holes.holes if plan.holes is not None else ())
    ]  # fmt: skip


def arrays_data(plan: Plan) -> bytes:
    """What pictures need: the fused cloud, and which surface samples were seen when."""
    arrays: dict[str, np.ndarray] = {}
    if plan.cloud is not None:
        arrays |= {
            "cloud": plan.cloud.points.astype(np.float32),
            "normals": plan.cloud.normals.astype(np.float32),
        }
    if plan.samples is not None and plan.visible is not None:
        arrays |= {
            "samples": plan.samples.points.astype(np.float32),
            "sample_normals": plan.samples.normals.astype(np.float32),
            "visible": plan.visible,
            "seen": np.stack([item.seen for item in plan.segments])
            if plan.segments
            else np.zeros((0, 0), bool),
        }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def read_holes(folder: Path) -> HoleReport | None:
    """holes.json; None where there is none, or no hole in it.

    Raises:
        PlanFileError: it cannot be read.
    """
    if not (folder / "holes.json").exists():
        return None
    found = checked("holes.json", _Holes, read_json(folder, "holes.json"))
    holes = tuple(
        Hole(
            boundary=np.array(h.boundary), kind=h.kind, center=np.array(h.center), normal=np.array(h.normal),
            X_OH=np.array(h.X_OH), extent=np.array(h.extent), perimeter=h.perimeter, area=h.area,
        )
        for h in found.holes
    )  # fmt: skip
    none = np.zeros(0, bool)
    return HoleReport(holes=holes, tiny=(), boundary_mask=none, radius=0.0) if holes else None


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


def read_cloud(folder: Path) -> Cloud | None:
    """The fused cloud of a plan, the way to the cameras along the normals; None where scan.npz has none.

    Raises:
        PlanFileError: it cannot be read.
    """
    arrays = _arrays(folder, ("cloud", "normals"))
    if len(arrays) < 2:
        return None
    n = len(np.atleast_1d(arrays["cloud"]))
    _fits(arrays, {"cloud": (n, 3), "normals": (n, 3)}, "f")
    points, normals = arrays["cloud"].astype(float), arrays["normals"].astype(float)
    counts = np.ones(n, np.int64)
    return Cloud(points=points, normals=normals, view_directions=normals, counts=counts)


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
