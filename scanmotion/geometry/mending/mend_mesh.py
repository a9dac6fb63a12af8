"""All that is mended in a mesh from a file, in order, with one sentence for each change.

Guarantees of what comes out: no two vertices are equal, no triangle is degenerate or stands twice, every
edge has one or two triangles, neighbours agree, closed bodies look outwards and their cavities inwards.
"""

from dataclasses import dataclass

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.core.read_report import counted
from scanmotion.geometry.files.raw import are_numbers
from scanmotion.geometry.mending.edges import areas_of, edges_of
from scanmotion.geometry.mending.floor import floor_under
from scanmotion.geometry.mending.keys import row_keys
from scanmotion.geometry.mending.manifold import parted
from scanmotion.geometry.mending.sides import sided
from scanmotion.geometry.mending.specks import mesh_specks, spread_samples
from scanmotion.geometry.mending.weld import border_welded, weld_tolerance, welded

_MOST_LOST = 0.01
"""Up to this share of the triangles may hang on a corner that is no number."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Mended:
    """A mesh that keeps the promises of this module, and what was done for it."""

    vertices: np.ndarray
    triangles: np.ndarray
    closed: bool
    bodies: int = 1
    specks: int = 0
    welded: int = 0
    turned: int = 0
    dropped: int = 0
    split: int = 0
    changes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def mended(
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    step: float = 0.0,
    up: np.ndarray | None = None,
    path: str = "",
) -> Mended:  # fmt: skip
    """Welds, drops, parts and turns what is plainly broken in a mesh, and says so.

    Args:
        vertices: shape (n, 3), in any unit.
        triangles: shape (m, 3).
        step: least difference of two coordinates that the file can tell apart.
        up: unit vector in the file's frame, shape (3,); a floor is sought where it is given.
        path: for the error.

    Raises:
        PartError: nothing of a surface is left, or much of it hangs on corners that are no numbers.
    """
    said: list[str] = []
    m = len(triangles)
    vertices, triangles = _finite(vertices, triangles, said, path)
    made = welded(vertices, triangles)
    merged = made.merged
    if merged:
        said.append(f"{merged} duplicate vertices were merged")
    size = float(np.ptp(vertices, axis=0).max(initial=0.0))
    vertices, triangles = made.vertices, _proper(made.vertices, made.triangles, size, said)
    if len(triangles):
        tolerance = weld_tolerance(size, step)
        near = border_welded(vertices, triangles, tolerance=tolerance)
        if near.merged:
            merged += near.merged
            said.append(
                f"{near.merged} vertices closer than {tolerance:.2g} (the file's resolution) were merged"
            )
            vertices, triangles = near.vertices, _proper(near.vertices, near.triangles, size, said)
    if len(triangles) == 0:
        raise PartError("no triangle of positive area", path=path)
    made = parted(vertices, triangles)
    if made.shared:
        how = f"{made.flaps} triangles that hung there were dropped" if made.flaps else ""
        how = " and ".join(x for x in (how, "what met there was parted" if made.doubled else "") if x)
        said.append(
            f"{made.shared} edges were shared by more than two triangles: {how or 'left as they are'}"
        )
    vertices, triangles = made.vertices, made.triangles
    triangles = _without_floor(vertices, triangles, up, said)
    speck, body, specks = mesh_specks(vertices, triangles, up)
    if specks:
        n = counted(int(speck.sum()), "triangle")
        said.append(f"{counted(specks, 'speck')} ({n}) floating off the part left out")
        triangles = triangles[~speck]
    if len(triangles) == 0:
        raise PartError("no surface is left once flaps and specks are dropped", path=path)
    side = sided(vertices, triangles)
    vertices, triangles = _used(vertices, side.triangles, said)
    return Mended(
        vertices=vertices, triangles=triangles, closed=side.closed, bodies=int(body.max()) + 1 - specks,
        specks=specks, welded=merged, turned=side.turned, dropped=m - len(triangles), split=made.doubled,
        changes=(*said, *side.changes), warnings=side.warnings,
    )  # fmt: skip


def _without_floor(
    vertices: np.ndarray, triangles: np.ndarray, up: np.ndarray | None, said: list[str]
) -> np.ndarray:
    """The triangles over a table's or floor's plane that was scanned too; an open mesh alone can have one."""
    if up is None or not (edges_of(triangles).count == 1).any():
        return triangles
    points, normals = spread_samples(vertices, triangles)
    floor = floor_under(points, up, normals=normals)
    if floor is None:
        return triangles
    if not floor.cut:
        said.append(
            f"a plane {floor.size:.4g} wide lies under it and was kept: it may be its ground or the table"
        )
        return triangles
    keep = floor.above(vertices)[triangles].all(axis=1)
    if not keep.any():
        return triangles
    said.append(
        f"a plane {floor.size:.4g} wide under it (table or floor, {int((~keep).sum())} triangles) was cut off"
    )
    return triangles[keep]


def _finite(
    vertices: np.ndarray, triangles: np.ndarray, said: list[str], path: str
) -> tuple[np.ndarray, np.ndarray]:
    bad = np.logical_not(are_numbers(vertices))
    if not bad.any():
        return vertices, triangles
    lost = bad[triangles].any(axis=1)
    if lost.sum() > _MOST_LOST * len(triangles):
        raise PartError(
            f"{int(bad.sum())} of {len(vertices)} points are not finite numbers, and {int(lost.sum())} of "
            f"{len(triangles)} triangles hang on them",
            path=path,
        )
    said.append(
        f"{int(bad.sum())} vertices that are not finite numbers and {int(lost.sum())} triangles were dropped"
    )
    rank = np.cumsum(~bad) - 1
    return vertices[~bad], rank[triangles[~lost]]


def _proper(vertices: np.ndarray, triangles: np.ndarray, size: float, said: list[str]) -> np.ndarray:
    """Triangles of positive area, each once."""
    a, b, c = triangles.T
    keep = (a != b) & (b != c) & (c != a) & (2 * areas_of(vertices, triangles) > 1e-16 * size * size)
    if not keep.all():
        said.append(f"{int((~keep).sum())} degenerate triangles were dropped")
        triangles = triangles[keep]
    if not len(triangles):
        return triangles
    _, first, inverse = np.unique(
        row_keys(np.sort(triangles, axis=1)), return_index=True, return_inverse=True
    )
    if len(first) == len(triangles):
        return triangles
    alike = triangles[np.sort(first)]
    none = _without_pairs(triangles, inverse.ravel(), len(first))
    if none is not None and _faults(none) < _faults(alike):
        said.append(f"{len(triangles) - len(none)} triangles of walls between bodies were dropped")
        return none
    said.append(f"{len(triangles) - len(alike)} duplicate triangles were dropped")
    return alike


def _without_pairs(triangles: np.ndarray, place: np.ndarray, n: int) -> np.ndarray | None:
    """The triangles without those that stand twice with opposite sense; None where there are none."""
    even = _even(triangles)
    balance = np.bincount(place, weights=np.where(even, 1.0, -1.0), minlength=n)
    count = np.bincount(place, minlength=n)
    wall = (count == 2) & (balance == 0)
    if not wall.any() or wall.all():
        return None
    left = triangles[~wall[place]]
    first = np.unique(row_keys(np.sort(left, axis=1)), return_index=True)[1]
    return left[np.sort(first)]


def _even(triangles: np.ndarray) -> np.ndarray:
    """Whether sorting a triangle's corners keeps its sense, shape (m,)."""
    a, b, c = triangles.T
    return ((a > b).astype(int) + (a > c) + (b > c)) % 2 == 0


def _faults(triangles: np.ndarray) -> int:
    """Edges that do not have two triangles."""
    return int((edges_of(triangles).count != 2).sum())


def _used(vertices: np.ndarray, triangles: np.ndarray, said: list[str]) -> tuple[np.ndarray, np.ndarray]:
    mark = np.zeros(len(vertices), bool)
    mark[triangles.ravel()] = True
    if mark.all():
        return vertices, triangles
    said.append(f"{int((~mark).sum())} vertices without a triangle were dropped")
    return vertices[mark], (np.cumsum(mark) - 1)[triangles]
