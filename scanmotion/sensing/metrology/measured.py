"""Measured clouds and references read from files, in metres, where they are."""

from pathlib import Path

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.core.support.streams import fixed_stream
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.mending.mend_cloud import measured_points, with_checked_normals
from scanmotion.geometry.mending.mend_mesh import mended
from scanmotion.geometry.parts.make_part import surface_samples
from scanmotion.geometry.parts.placing import UNITS
from scanmotion.sensing.holes.boundary import oriented_normals

_SAMPLES = 300_000
"""A measured mesh is compared at so many points, uniform by area: its vertices crowd where it is curved."""


def reference_part(path: Path, units: str) -> Part:
    """A reference mesh, or probed points, in the file's own frame.

    Raises:
        InputError: unknown unit, or the file cannot be used.
    """
    raw = read_geometry(path)
    scale = _scale(units)
    if not len(raw.triangles):
        _check(raw.vertices, path)
        return Part(
            name=path.stem, vertices=raw.vertices * scale, triangles=np.zeros((0, 3), int),
            normals=_unit(raw.normals), closed=False,
        )  # fmt: skip
    made = mended(raw.vertices, raw.triangles, step=raw.step, path=str(path))
    return Part(
        name=path.stem, vertices=made.vertices * scale, triangles=made.triangles, closed=made.closed,
        repairs=(*made.changes, *made.warnings),
    )  # fmt: skip


def measured_cloud(path: Path, units: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m] and outward normals (n, 3) of a measured cloud or mesh.

    Raises:
        InputError: unknown unit, or the file cannot be used.
        HoleError: normals that the file lacks cannot be oriented.
    """
    raw = read_geometry(path)
    scale = _scale(units)
    if len(raw.triangles):
        if not np.isfinite(raw.vertices).all():
            raise InputError(f"{path}: vertices that are not finite numbers")
        part = Part(name=path.stem, vertices=raw.vertices * scale, triangles=raw.triangles)
        samples = surface_samples(part, _SAMPLES, rng=fixed_stream("measured_samples"))
        return samples.points, samples.normals
    made = with_checked_normals(measured_points(raw.vertices, raw.normals, str(path)))
    points, normals = made.points * scale, made.normals
    return points, oriented_normals(points) if normals is None else normals


def _scale(units: str) -> float:
    if units not in UNITS:
        raise InputError(f"unknown unit {units!r}; known: {', '.join(UNITS)}")
    return UNITS[units]


def _check(points: np.ndarray, path: Path) -> None:
    bad = int((~np.isfinite(points).all(axis=1)).sum())
    if bad:
        raise InputError(f"{path}: {bad} of {len(points)} points are not finite numbers")
    if len(points) < 10:
        raise InputError(f"{path}: only {len(points)} points")


def _unit(normals: np.ndarray | None) -> np.ndarray | None:
    if normals is None or not np.isfinite(normals).all():
        return None
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / length if (length > 1e-6).all() else None
