"""Points of a measured scan from a file, in the scan's own frame: nothing is moved, no floor is sought."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanmotion.core.errors import PartError
from scanmotion.core.read_report import ReadReport
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.mending.mend_cloud import (
    MendedCloud,
    measured_points,
    mended_cloud,
    with_checked_normals,
)
from scanmotion.geometry.mending.mend_mesh import mended
from scanmotion.geometry.parts.placing import UNITS, check_size, check_steps, report_of, unit_of


@dataclass(frozen=True, eq=False, kw_only=True)
class FileCloud:
    """A scan's points in metres and in double precision, and what was read."""

    points: np.ndarray
    """In the file's frame, shape (n, 3) [m]."""
    normals: np.ndarray | None
    """Outward unit normals where the file has them (a mesh has), shape (n, 3)."""
    report: ReadReport


def cloud_from_file(
    path: str | Path, *, units: str | None = None, up: np.ndarray | None = None, any_size: bool = False
) -> FileCloud:
    """Reads a scan: what measures nothing is dropped; of a mesh its vertices are taken.

    Args:
        path: the file.
        units: of its coordinates; by default what the file states, else mm.
        up: unit vector in the file's frame, shape (3,); specks and a floor are left out where it is given.
        any_size: whether a size that no part has is let pass (a fragment of a scan may be small).

    Raises:
        PartError: as part_from_file.
    """
    raw, name = read_geometry(path), str(path)
    if units and units not in UNITS:
        raise PartError(f"unknown unit {units!r}; known: {', '.join(UNITS)}", path=name)
    if len(raw.triangles):
        mesh = mended(raw.vertices, raw.triangles, step=raw.step, up=up, path=name)
        made = MendedCloud(points=mesh.vertices, normals=vertex_normals(mesh.vertices, mesh.triangles))
        unit, units_from = unit_of(raw, units, made.points, guess=False)
        report = report_of(raw, mesh, name, unit, units_from, np.ptp(made.points, axis=0) * UNITS[unit])
    else:
        if up is None:
            made = with_checked_normals(measured_points(raw.vertices, raw.normals, name))
        else:
            made = mended_cloud(raw.vertices, raw.normals, up=up, path=name, islands=False)
        unit, units_from = unit_of(raw, units, made.points, guess=False)
        report = report_of(raw, made, name, unit, units_from, np.ptp(made.points, axis=0) * UNITS[unit])
    check_steps(made.points, raw.step, name)
    points = made.points * UNITS[unit]
    if not any_size:
        check_size(points, unit, name)
    return FileCloud(points=points, normals=made.normals, report=report)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals of a mesh's vertices, each triangle by its area; shape (n, 3)."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    corner = triangles.ravel()
    summed = [
        np.bincount(corner, weights=np.repeat(cross[:, i], 3), minlength=len(vertices)) for i in range(3)
    ]
    normals = np.column_stack(summed)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals[length[:, 0] == 0] = (0.0, 0.0, 1.0)
    return normals / np.where(length > 0, length, 1.0)
