"""Solids of the cell that are meshes: obstacles from its CAD, an own housing, an own fixture.

Guarantees: each body of a mesh is held by convex pieces, which planner and Drake keep clear of; its triangles
go into the plan's folder for the judge. What is closed round a hollow in one piece counts as filled.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scanmotion.cell.arm.robot import Body
from scanmotion.cell.arm.robot_solids import MOST_M, hull_body
from scanmotion.cell.arm.urdf import mesh_from
from scanmotion.core.errors import CellError
from scanmotion.geometry.convex import convex_pieces

_KINDS = (".stl", ".obj", ".ply", ".dae")
_MOST_PIECES = 8
"""Convex pieces of one body of a mesh."""
_MOST_BODIES = 400
_WELD_M = 1e-6
"""Corners nearer than this are one [m]."""
MOST_BYTES = 64 << 20


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshSolid:
    """A mesh as it stands in the cell, for the plan's folder."""

    name: str
    link: int
    """As Body.link."""
    file: str
    """Its plain name in a plan's folder."""
    data: bytes
    """The file as it was."""
    scale: float
    """Metres to its unit."""
    X_LM: np.ndarray
    """Pose of the mesh in its link's frame, shape (4, 4)."""


def mesh_solid(
    path: Path, name: str, link: int, *, file: str, unit: str | None, X_LM: np.ndarray, key: str
) -> tuple[MeshSolid, list[Body]]:
    """A mesh, and its convex pieces as bodies of the cell.

    Args:
        path: STL, OBJ, PLY or DAE.
        name: what findings call it.
        link: as Body.link.
        file: plain name for a plan's folder, without its ending.
        unit: "m" or "mm".
        X_LM: pose of the mesh in the link, shape (4, 4).
        key: of the settings, for messages.

    Raises:
        CellError: no such file, not readable, too large.
    """
    if path.suffix.lower() not in _KINDS:
        raise CellError(f"{path.name}: is not read; {', '.join(_KINDS)} are", key=key)
    if not path.is_file():
        raise CellError(f"{path.name}: no such file beside the cell's YAML", key=key)
    if path.stat().st_size > MOST_BYTES:
        raise CellError(f"{path.name}: more than {MOST_BYTES >> 20} MiB", key=key)
    data, scale = path.read_bytes(), 1e-3 if unit == "mm" else 1.0
    try:
        vertices, triangles = mesh_from(data, path.name)
    except CellError as error:
        raise CellError(str(error).partition(": ")[2] if error.key else str(error), key=key) from None
    vertices = vertices * scale
    size = float(np.ptp(vertices, axis=0).max())
    if size > MOST_M:
        hint = "; is it in millimetres? unit: mm" if unit == "m" else ""
        raise CellError(f"{path.name}: a mesh of {size:.0f} m{hint}", key=key)
    solid = MeshSolid(
        name=name, link=link, file=f"{file}{path.suffix.lower()}", data=data, scale=scale, X_LM=X_LM
    )
    hulls = [h for part in _bodies(vertices, triangles, path.name, key)
             for h in convex_pieces(vertices, part, most=_MOST_PIECES)]  # fmt: skip
    pieces = [
        replace(
            hull_body(hull.points, name if len(hulls) == 1 else f"{name}_{n}", link, X_LM, path.name),
            mesh=name,
        )
        for n, hull in enumerate(hulls)
    ]
    return solid, pieces


def _bodies(vertices: np.ndarray, triangles: np.ndarray, name: str, key: str) -> Sequence[np.ndarray]:
    """Triangles (m, 3) of each connected body, the largest number of triangles first."""
    _, of = np.unique(np.round(vertices / _WELD_M).astype(np.int64), axis=0, return_inverse=True)
    t = of.reshape(-1)[triangles]
    edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]]])
    size = int(of.max()) + 1
    graph = coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(size, size))
    count, label = connected_components(graph, directed=False)
    own = label[t[:, 0]]
    used = np.unique(own)
    if len(used) > _MOST_BODIES:
        raise CellError(f"{name}: {len(used)} separate bodies; up to {_MOST_BODIES} are read", key=key)
    assert count >= len(used)
    return [triangles[own == n] for n in used]
