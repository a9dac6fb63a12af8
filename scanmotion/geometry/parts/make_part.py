"""Parts: read from files, checked and brought into the object frame O; the box and the built-in carving."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part, SurfaceSamples
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.files.raw import RawGeometry
from scanmotion.geometry.mending.mend_cloud import MendedCloud, mended_cloud
from scanmotion.geometry.mending.mend_mesh import Mended, mended
from scanmotion.geometry.parts.placing import UNITS, check_size, check_steps, report_of, unit_of, upright


def surface_samples(part: Part, n: int, *, rng: np.random.Generator) -> SurfaceSamples:
    """`n` random points on the mesh, uniform by area.

    Raises:
        PartError: the part is a cloud.
    """
    if not part.is_mesh:
        raise PartError("a point cloud has no surface to sample; give a mesh")
    corners = part.vertices[part.triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(cross, axis=1)
    # Stratified along the cumulated area: the count per region strays far less than with independent draws.
    edges = np.concatenate([[0.0], np.cumsum(areas)])
    at = (np.arange(n) + rng.random(n)) / n * edges[-1]
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(areas) - 1)
    u, v = rng.random(n), rng.random(n)
    flip = u + v > 1.0
    u[flip], v[flip] = 1.0 - u[flip], 1.0 - v[flip]
    a, b, c = corners[index, 0], corners[index, 1], corners[index, 2]
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    normals = cross[index] / np.linalg.norm(cross[index], axis=1, keepdims=True)
    return SurfaceSamples(points=points, normals=normals, area=float(edges[-1] / n))


def box_part(length: float, width: float, height: float) -> Part:
    """The closed box of L x W x H [m] on the table's centre: all that is known of an unseen object.

    Raises:
        PartError: a side is not a positive, finite number.
    """
    sides = np.array([length, width, height], dtype=float)
    if not np.isfinite(sides).all() or (sides <= 0).any():
        raise PartError(f"box of {length:g} x {width:g} x {height:g} m: sides must be positive numbers")
    corners = np.array([[x, y, z] for z in (0.0, 1.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Part(name="box", vertices=corners * sides, triangles=np.array(triangles))


def part_from_file(
    path: str | Path, *, units: str | None = None, up: str = "", place: str = "centre", guess: bool = False
) -> Part:
    """Loads a mesh or a cloud of any kind that `read_geometry` knows into frame O.

    Args:
        path: the file.
        units: unit of the file's coordinates: mm, cm, m, in, ft or um; by default what the file states, and
            mm where it states none.
        up: axis of the file that points up: +x, -x, +y, -y, +z or -z; by default what the format's standard
            says (+y in glTF), else +z.
        place: "centre" stands the box's centre on the table's axis and its base at z = 0; "keep" takes the
            file's x, y, z as they are (a scan measured in the turntable's frame).
        guess: whether a size that is absurd in mm may be taken for metres.

    Returns:
        The part; its `report` says what was read, assumed and changed.

    Raises:
        PartError: missing, broken, empty, flat, or absurd in size; the line says what.
    """
    return part_from_raw(read_geometry(path), str(path), units=units, up=up, place=place, guess=guess)


def part_from_raw(
    raw: RawGeometry, name: str, *, units: str | None, up: str, place: str, guess: bool = False
) -> Part:
    """Checks and mends what was read from the file `name`, or made in memory; arguments as part_from_file."""
    if units and units not in UNITS:
        raise PartError(f"unknown unit {units!r}; known: {', '.join(UNITS)}", path=name)
    if place not in ("centre", "keep"):
        raise PartError(f"unknown placement {place!r}; known: centre, keep", path=name)
    if len(raw.vertices) < 3:
        raise PartError(f"only {len(raw.vertices)} points", path=name)
    R = upright(up or raw.up or "+z", name)
    doubts = (raw.up_doubt,) if raw.up_doubt and not up else ()
    if raw.up and not up:
        raw = replace(raw, columns=(*raw.columns, f"{raw.up} is up by the standard of its format"))
    raw = replace(raw, doubts=(*raw.doubts, *doubts))
    made: Mended | MendedCloud
    if len(raw.triangles):
        made = mended(raw.vertices, raw.triangles, step=raw.step, up=R[2], path=name)
    else:
        made = mended_cloud(raw.vertices, raw.normals, up=R[2], path=name)
    points = made.vertices if isinstance(made, Mended) else made.points
    check_steps(points, raw.step, name)
    unit, units_from = unit_of(raw, units, points, guess=guess)
    scaled = points @ R.T * UNITS[unit]
    check_size(scaled, unit, name)
    shift = _shift(scaled, place, name)
    X_OI = np.eye(4)
    X_OI[:3, :3], X_OI[:3, 3] = R * UNITS[unit], shift
    normals = made.normals if isinstance(made, MendedCloud) else None
    return Part(
        name=Path(name).stem, vertices=scaled + shift,
        triangles=made.triangles if isinstance(made, Mended) else raw.triangles,
        normals=None if normals is None else normals @ R.T, X_OI=X_OI,
        closed=isinstance(made, Mended) and made.closed,
        repairs=(*made.changes, *made.warnings) if isinstance(made, Mended) else made.changes,
        report=report_of(raw, made, name, unit, units_from, np.ptp(scaled, axis=0)),
    )  # fmt: skip


def _shift(scaled: np.ndarray, place: str, path: str) -> np.ndarray:
    """What brings points in metres, z up, to their place on the table, shape (3,)."""
    low, high = scaled.min(axis=0), scaled.max(axis=0)
    if place == "centre":
        return -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    if not -0.02 <= low[2] <= 0.5:
        raise PartError(
            f"its lowest point is at z = {low[2] * 1e3:.0f} mm, not on the table; use --place centre",
            path=path,
        )
    return np.zeros(3)


def check_fits(part: Part, table_radius: float, max_height: float) -> None:
    """Refuses a part that hangs over the table's edge or is taller than `max_height` [m].

    Raises:
        PartError: with the size found and the size allowed.
    """
    if part.radius > table_radius:
        raise PartError(
            f"reaches {part.radius * 1e3:.0f} mm from the table's axis; "
            f"the table's radius is {table_radius * 1e3:.0f} mm"
        )
    if part.extent[2] > max_height:
        raise PartError(f"is {part.extent[2] * 1e3:.0f} mm tall, the cell takes {max_height * 1e3:.0f} mm")


def carving() -> Part:
    """The built-in part: a carving of 600 x 330 x 200 mm, made by models/parts/carving.py."""
    return replace(part_from_file(models_dir() / "parts" / "carving.ply"), name="carving", report=None)


def models_dir() -> Path:
    """The folder of robots, cells and parts: in the checkout, or installed inside the package."""
    here = Path(__file__).resolve().parents[2]
    for folder in (here / "_models", here.parent / "models"):
        if folder.is_dir():
            return folder
    raise PartError("the models folder is missing; install scanmotion again")
