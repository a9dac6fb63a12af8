"""Holes of a scanned surface: where samples are missing, how the rim runs, which way it looks.

Paper sections 3.1 and 3.2 (doi 10.3390/act14030139). `LargestAngle` is their way, literally: boundary
points by the largest angle (45 deg, radius of the 45th neighbour), then DBSCAN. The default looks at the
empty space itself (see `voronoi_gaps`). Its holes are the rims of regions that hold an empty disc, miss
enough samples, and lie on one sheet.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from scanmotion.core.errors import HoleError
from scanmotion.core.support.deprecation import deprecated
from scanmotion.core.support.streams import fixed_stream
from scanmotion.sensing.holes.boundary import check_points, check_unit, neighbour_radius
from scanmotion.sensing.holes.loops import (
    Kind,
    box_about,
    chains_of,
    kind_of,
    loop_length,
    ordered_loop,
    outward,
    vector_area,
    winding,
)
from scanmotion.sensing.holes.mesh_loops import MeshLoops, mesh_loops
from scanmotion.sensing.holes.orient import signs_by_spanning_tree
from scanmotion.sensing.holes.paper_clusters import LargestAngle, literal_rims
from scanmotion.sensing.holes.rims import Rim, Sampling, rims_of
from scanmotion.sensing.holes.sampling import even_samples, prepared


@dataclass(frozen=True, eq=False, kw_only=True)
class Hole:
    """A hole in the object frame O; H is the frame of its box."""

    boundary: np.ndarray
    """Rim points in order, outer loop first, shape (k, 3) [m]."""
    kind: Kind
    center: np.ndarray
    """Centre O' of the box, shape (3,) [m]."""
    normal: np.ndarray
    """Outward unit normal Z' of the missing patch, shape (3,)."""
    X_OH: np.ndarray
    """Pose of the box: Z' = normal, X' along the longer side of the middle plane, shape (4, 4)."""
    extent: np.ndarray
    """Full sides along X', Y', Z', shape (3,) [m]."""
    perimeter: float
    """Length of the outer loop [m]."""
    area: float
    """Area that the outer loop encloses, less its islands [m2]; the largest shadow where it is not plane."""
    coherence: float = 1.0
    """How well the rim agrees on the normal, 1 = wholly; under 0.6 the hole wraps round the part."""
    islands: tuple[np.ndarray, ...] = ()
    """Loops of the islands inside, each (k, 3) [m]."""
    indices: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    """Indices of the boundary in the cloud or mesh, shape (k,)."""

    @property
    def outer(self) -> int:
        """How many boundary points belong to the outer loop."""
        return len(self.boundary) - sum(len(one) for one in self.islands)

    def __post_init__(self) -> None:
        for name in ("boundary", "center", "normal", "X_OH", "extent", "indices"):
            value = np.array(getattr(self, name))
            value.setflags(write=False)
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False, kw_only=True)
class HoleReport:
    """What was found, and what was left out for which reason."""

    holes: tuple[Hole, ...]
    """Largest perimeter first."""
    tiny: tuple[Hole, ...]
    """Gaps under the least size, which nobody plans for."""
    boundary_mask: np.ndarray
    """Which points (or mesh vertices) lie on a boundary, shape (n,)."""
    radius: float
    """Radius of the neighbourhood [m]."""
    notes: tuple[str, ...] = ()
    """Why the answer is empty or partial, one sentence each."""


def holes_from_cloud(
    points: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    view_directions: np.ndarray | None = None,
    by_angle: LargestAngle | None = None,
    mode: str | None = None,
    radius: float | None = None,
    threshold: float | None = None,
    eps: float | None = None,
    min_points: int | None = None,
    min_size: float | None = None,
    voxel: float | None = None,
) -> HoleReport:
    """Finds the holes of a scanned surface.

    Args:
        points: cloud, shape (n, 3) [m].
        normals: outward unit normals, shape (n, 3). They and the view directions only settle where out is.
        view_directions: unit vectors point -> sensor, shape (n, 3).
        by_angle: the paper's search; None for the empty space itself.
        mode: deprecated: "paper" stands for `LargestAngle()`.
        radius: of the neighbourhood [m]; median distance to the 30th neighbour unless given.
        threshold: deprecated: of a `LargestAngle`, as are eps and min_points.
        eps: deprecated.
        min_points: deprecated.
        min_size: perimeter under which a hole is tiny [m]; by default the missing samples decide.
        voxel: width of the cells in which the points are averaged first [m]; 0 for never; by default only
            where the pitch is uneven, as in overlapping range scans.

    Returns:
        Holes, largest perimeter first, and notes that say why there are none.

    Raises:
        HoleError: fewer points than a neighbourhood needs, bad shapes, numbers that are not finite.
    """
    by_angle = by_angle or _by_angle(mode, threshold, eps, min_points)
    number = 30 if by_angle is None else by_angle.neighbours
    points = check_points(points, number + 1)
    directions = (
        None if view_directions is None else check_unit(view_directions, len(points), "view directions")
    )
    if directions is None and normals is not None:
        directions = check_unit(normals, len(points), "normals")
    cloud = prepared(points, directions, number + 1, voxel, by_angle is not None)
    if isinstance(cloud, str):
        return _nothing(len(points), radius or 0.0, (cloud,))
    sampling, notes = cloud.sampling, cloud.notes
    if radius is None:
        radius = neighbour_radius(sampling.tree, number)
    if by_angle is not None:
        rims, tiny = literal_rims(sampling, radius, by_angle)
    else:
        rims, tiny = rims_of(sampling, averaged=cloud.averaged)
    if directions is None and (rims or tiny):
        notes = (*notes, "normals were oriented by a spanning tree: no view directions given")
    out = _out_of(sampling, cloud.directions) if rims or tiny else sampling.normals
    holes = [_hole_from_rim(sampling.points, out, rim, cloud.first) for rim in rims + tiny]
    small = [i >= len(rims) if min_size is None else h.perimeter < min_size for i, h in enumerate(holes)]
    holes, small = _islands_put_in(holes, small)
    return _report(holes, small, len(points), radius, notes)


def _by_angle(
    mode: str | None, threshold: float | None, eps: float | None, min_points: int | None
) -> LargestAngle | None:
    """What the deprecated arguments ask for; None for the default."""
    if mode not in (None, "default", "paper"):
        raise HoleError(f"mode must be default or paper, got {mode!r}")
    if mode is None and threshold is None and eps is None and min_points is None:
        return None
    deprecated("holes_from_cloud: mode, threshold, eps and min_points", "by_angle=LargestAngle(..)")
    if mode != "paper" and threshold is None and eps is None and min_points is None:
        return None
    wide = LargestAngle() if mode == "paper" else LargestAngle(neighbours=30, threshold=np.pi / 2)
    return replace(
        wide, eps=eps, threshold=wide.threshold if threshold is None else threshold,
        min_points=wide.min_points if min_points is None else min_points,
    )  # fmt: skip


def _islands_put_in(holes: list[Hole], small: list[bool]) -> tuple[list[Hole], list[bool]]:
    """Rims that look outwards and lie inside another hole's loop become its islands."""
    inside: dict[int, list[int]] = {}
    for i, one in enumerate(holes):
        hosts = [j for j, host in enumerate(holes) if one.kind == "edge" and j != i and _lies_in(one, host)]
        if hosts:
            inside.setdefault(min(hosts, key=lambda j: holes[j].perimeter), []).append(i)
    taken = {i for group in inside.values() for i in group}
    out = [
        _with_islands(hole, [holes[i] for i in inside[j]]) if j in inside else hole
        for j, hole in enumerate(holes)
    ]
    kept = [j for j in range(len(holes)) if j not in taken]
    return [out[j] for j in kept], [small[j] for j in kept]


def _lies_in(one: Hole, host: Hole) -> bool:
    """Whether a rim lies wholly inside another's loop, near its middle plane."""
    outer = (host.boundary[: host.outer] - host.center) @ host.X_OH[:3, :3]
    inner = (one.boundary - host.center) @ host.X_OH[:3, :3]
    near = np.abs(inner[:, 2]).max() <= 0.5 * host.extent[2] + 0.25 * host.extent[1]
    return bool(near and (winding(outer[:, :2], inner[:, :2]) != 0).all())


def _with_islands(host: Hole, islands: list[Hole]) -> Hole:
    area = host.area - sum(one.area for one in islands)
    return replace(
        host,
        boundary=np.concatenate([host.boundary, *(one.boundary for one in islands)]),
        indices=np.concatenate([host.indices, *(one.indices for one in islands)]),
        islands=(*host.islands, *(one.boundary for one in islands)),
        area=max(area, 0.0),
        kind="island",
    )


def _nothing(n: int, radius: float, notes: tuple[str, ...]) -> HoleReport:
    return HoleReport(holes=(), tiny=(), boundary_mask=np.zeros(n, bool), radius=radius, notes=notes)


def _out_of(sampling: Sampling, toward: np.ndarray | None) -> np.ndarray:
    """Outward normals: on the side of what was given, or by a spanning tree."""
    if toward is None:
        near = sampling.nearest[:, :10]
        return sampling.normals * signs_by_spanning_tree(sampling.points, sampling.normals, near)[:, None]
    side = np.einsum("ij,ij->i", sampling.normals, toward)
    return sampling.normals * np.where(side < 0.0, -1.0, 1.0)[:, None]


def _report(holes, small, n, radius, notes) -> HoleReport:
    mask = np.zeros(n, bool)
    for hole in holes:
        mask[hole.indices] = True
    by_size = sorted(zip(holes, small, strict=True), key=lambda pair: (-pair[0].perimeter, *pair[0].center))
    found = tuple(hole for hole, tiny in by_size if not tiny)
    if not found:
        notes = (*notes, "no hole found" + (f" larger than the {len(holes)} tiny gaps" if holes else ""))
    return HoleReport(
        holes=found,
        tiny=tuple(hole for hole, tiny in by_size if tiny),
        boundary_mask=mask,
        radius=float(radius),
        notes=notes,
    )


def _hole_from_rim(points: np.ndarray, normals: np.ndarray, rim: Rim, kept: np.ndarray) -> Hole:
    """A hole from its rim points: chains in order, the longest is the outer loop."""
    chains = chains_of(points[rim.points], rim.opening)
    loops = [chain[ordered_loop(points[rim.points[chain]])] for chain in chains]
    outer = rim.points[loops[0]]
    islands = [rim.points[chain] for chain in loops[1:]]
    return hole_from_loops(
        points[outer],
        normals[outer],
        rim.opening[loops[0]],
        islands=[points[island] for island in islands],
        indices=kept[np.concatenate([outer, *islands])],
    )


def hole_from_loops(
    outer: np.ndarray,
    normals: np.ndarray,
    opening: np.ndarray,
    *,
    islands: list[np.ndarray],
    indices: np.ndarray,
) -> Hole:
    """A hole from ordered loops.

    Args:
        outer: ordered rim, shape (k, 3) [m].
        normals: outward unit normals there, shape (k, 3).
        opening: unit vectors from the rim into the hole, shape (k, 3).
        islands: ordered rims of islands inside [m].
        indices: of all rim points, outer loop first.
    """
    normal, coherence = outward(normals, opening)
    rim = np.concatenate([outer, *islands])
    X_OH, extent = box_about(rim, normal)
    area = np.linalg.norm(vector_area(outer)) - sum(np.linalg.norm(vector_area(i)) for i in islands)
    return Hole(
        boundary=rim,
        kind=kind_of(outer, opening, islands=len(islands)),
        center=X_OH[:3, 3],
        normal=normal,
        X_OH=X_OH,
        extent=extent,
        perimeter=loop_length(outer),
        area=float(max(area, 0.0)),
        coherence=coherence,
        islands=tuple(islands),
        indices=indices,
    )


def holes_from_mesh(
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    method: Literal["loops", "resample"] = "loops",
    spacing: float | None = None,
    min_size: float | None = None,
    min_vertices: int = 8,
    weld: bool = True,
    rng: np.random.Generator | None = None,
    **options: Any,
) -> HoleReport:
    """Finds the holes of a triangle mesh.

    Args:
        vertices: shape (n, 3) [m].
        triangles: indices of vertices, counter-clockwise seen from outside, shape (m, 3).
        method: "loops" walks the mesh's own boundary edges; "resample" spreads points evenly over the
            triangles and looks for holes in those (paper section 3.1; for meshes with torn topology).
        spacing: of the resampled points [m]; the median edge unless given.
        min_size: perimeter under which a loop is tiny [m]; 10 median edges unless given.
        min_vertices: a loop of fewer vertices is tiny ("loops" only).
        weld: whether vertices of equal coordinates are one; not so for a part from a file ("loops" only).
        rng: for "resample"; a fixed stream unless given.
        options: of `holes_from_cloud`; `by_angle` asks for "resample".

    Returns:
        As `holes_from_cloud`; `indices` and the mask refer to the mesh's vertices ("loops") and are empty
        otherwise.

    Raises:
        HoleError: no triangles, bad indices, numbers that are not finite.
    """
    if method not in ("loops", "resample"):
        raise HoleError(f"method must be loops or resample, got {method!r}")
    mesh = mesh_loops(vertices, triangles, weld=weld)
    corner = mesh.vertices[mesh.triangles]
    if not len(corner):
        raise HoleError("all triangles of the mesh are degenerate")
    edge = float(np.median(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)))
    if method == "resample" or options.get("by_angle") or options.get("mode") == "paper":
        rng = fixed_stream("hole_samples") if rng is None else rng
        points, normals = even_samples(mesh.vertices, mesh.triangles, spacing or edge, rng=rng)
        report = holes_from_cloud(points, normals=normals, min_size=min_size, **options)
        return replace(report, boundary_mask=np.zeros(len(vertices), bool))
    least = 10.0 * edge if min_size is None else min_size
    holes = [_hole_from_loop(mesh, i) for i in range(len(mesh.loops))]
    small = [hole.perimeter < least or len(hole.boundary) < min_vertices for hole in holes]
    return _report(holes, small, len(vertices), edge, ())


def _hole_from_loop(mesh: MeshLoops, number: int) -> Hole:
    loop, third, normals = mesh.loops[number], mesh.opposite[number], mesh.normals[number]
    here = mesh.vertices[loop]
    along = np.roll(here, -1, axis=0) - here
    inside = mesh.vertices[third] - here
    length = np.einsum("ij,ij->i", along, along)
    foot = np.einsum("ij,ij->i", inside, along) / np.where(length > 0, length, 1.0)
    away = along * foot[:, None] - inside
    size = np.linalg.norm(away, axis=1, keepdims=True)
    opening = away / np.where(size > 0, size, 1.0)
    return hole_from_loops(here, normals, opening, islands=[], indices=mesh.source[loop])


def hole_report_to_json(report: HoleReport, unit: Any = "m") -> dict[str, Any]:
    """The report as written by `scanmotion holes --out`, in the file's own units and frame.

    Args:
        report: of holes in O [m].
        unit: "m", "mm", .., or the Part whose file the holes were found in: its similarity X_OI is undone.

    Returns:
        {"holes": [{"boundary_points": [[x, y, z], ..], "kind", "center", "normal", "extent", "perimeter",
        "area"}, ..], "tiny": [..], "notes": [..]}.

    Raises:
        HoleError: the unit is unknown.
    """
    X_IO = _to_file(unit)
    scale = float(np.cbrt(abs(np.linalg.det(X_IO[:3, :3]))))
    return {
        "holes": [_as_json(hole, X_IO, scale) for hole in report.holes],
        "tiny": [_as_json(hole, X_IO, scale) for hole in report.tiny],
        "notes": list(report.notes),
    }


UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "um": 1e-6, "in": 0.0254, "ft": 0.3048}


def _to_file(unit: Any) -> np.ndarray:
    """Similarity from O in metres to the file, shape (4, 4)."""
    if isinstance(unit, str):
        if unit not in UNITS:
            raise HoleError(f"unit {unit!r} is unknown; known: {', '.join(UNITS)}")
        return np.diag([1.0 / UNITS[unit]] * 3 + [1.0])
    return np.eye(4) if unit.X_OI is None else np.linalg.inv(unit.X_OI)


def _as_json(hole: Hole, X_IO: np.ndarray, scale: float) -> dict[str, Any]:
    def placed(points: np.ndarray) -> np.ndarray:
        return points @ X_IO[:3, :3].T + X_IO[:3, 3]

    return {
        "boundary_points": placed(hole.boundary).tolist(),
        "kind": hole.kind,
        "center": placed(hole.center).tolist(),
        "normal": (X_IO[:3, :3] @ hole.normal / scale).tolist(),
        "extent": (hole.extent * scale).tolist(),
        "perimeter": hole.perimeter * scale,
        "area": hole.area * scale**2,
    }
