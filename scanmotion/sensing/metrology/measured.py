"""Measured clouds and references read from files, in metres, where they are."""

from pathlib import Path

import numpy as np

from scanmotion.core.errors import InputError
from scanmotion.core.part import Part
from scanmotion.geometry.part_files import read_geometry
from scanmotion.geometry.parts import UNITS, repaired, surface_samples
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
    _check(raw.vertices, path)
    if not len(raw.triangles):
        return Part(
            name=path.stem, vertices=raw.vertices * scale, triangles=np.zeros((0, 3), int),
            normals=_unit(raw.normals), closed=False,
        )  # fmt: skip
    vertices, triangles, repairs, closed = repaired(raw.vertices, raw.triangles, str(path))
    return Part(
        name=path.stem, vertices=vertices * scale, triangles=triangles, closed=closed, repairs=tuple(repairs)
    )


def measured_cloud(path: Path, units: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m] and outward normals (n, 3) of a measured cloud or mesh.

    Raises:
        InputError: unknown unit, or the file cannot be used.
        HoleError: normals that the file lacks cannot be oriented.
    """
    raw = read_geometry(path)
    scale = _scale(units)
    _check(raw.vertices, path)
    if len(raw.triangles):
        part = Part(name=path.stem, vertices=raw.vertices * scale, triangles=raw.triangles)
        samples = surface_samples(part, _SAMPLES, rng=np.random.default_rng(0))
        return samples.points, samples.normals
    points = raw.vertices * scale
    normals = _unit(raw.normals)
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
