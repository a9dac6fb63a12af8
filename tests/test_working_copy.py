"""The light copy of a heavy mesh is no farther off than it says, and distances to it are never too great."""

import numpy as np
import pytest
from scans import bumpy

from scanmotion.core.part import Part
from scanmotion.geometry.parts import working_copy as module
from scanmotion.geometry.parts.working_copy import WorkingCopy, decimated, working_copy


def triangle_distances(points: np.ndarray, part: Part) -> np.ndarray:
    """Brute force by trimesh, an oracle of its own."""
    import trimesh

    mesh = trimesh.Trimesh(part.vertices, part.triangles)
    return trimesh.proximity.ProximityQuery(mesh).on_surface(points)[1]


def sampled(part: Part, count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    k = rng.integers(0, len(part.triangles), count)
    w = rng.dirichlet((1, 1, 1), count)
    return np.einsum("nc,ncd->nd", w, part.vertices[part.triangles[k]])


@pytest.fixture(scope="module")
def copy(request):
    part = bumpy()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "LIGHT", 600)
        patch.setattr(module, "TOLERANCE_M", 0.02)
        patch.setattr(module, "_PIECE_M", 0.004)
        working_copy.cache_clear()
        made = working_copy(part)
    working_copy.cache_clear()
    return part, made


def test_few_triangles_are_their_own_copy():
    part = bumpy()
    assert working_copy(part).part is part and working_copy(part).deviation == 0.0


def test_the_deviation_bounds_every_point_of_the_surface(copy):
    part, made = copy
    assert isinstance(made, WorkingCopy) and len(made.part.triangles) < len(part.triangles) / 2
    off = triangle_distances(sampled(part, 500), made.part)
    assert 0.0 < off.max() <= made.deviation <= 0.02
    assert triangle_distances(made.part.vertices, part).max() <= made.back + 1e-6


def test_a_distance_less_the_deviation_is_never_too_great(copy):
    part, made = copy
    rng = np.random.default_rng(1)
    p = rng.normal(size=(60, 3)) * 0.3 + part.bounds.mean(axis=0)
    assert (triangle_distances(p, made.part) - made.deviation <= triangle_distances(p, part) + 1e-9).all()


def test_what_cannot_be_lightened_within_the_tolerance_stays_as_it_is(monkeypatch):
    part = bumpy()
    monkeypatch.setattr(module, "LIGHT", 20)
    monkeypatch.setattr(module, "TOLERANCE_M", 1e-6)
    monkeypatch.setattr(module, "_PIECE_M", 0.01)
    working_copy.cache_clear()
    made = working_copy(part)
    working_copy.cache_clear()
    assert made.part is part and made.deviation == 0.0


def test_decimation_is_the_same_each_time():
    part = bumpy()
    first, second = (decimated(part.vertices, part.triangles, 500) for _ in range(2))
    assert all((a == b).all() for a, b in zip(first, second, strict=True))
    assert len(first[1]) <= 520
