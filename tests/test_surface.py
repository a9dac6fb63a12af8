"""The reconstructed surface and the coloured deviation mesh."""

import numpy as np

from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.sensing.assess import accuracy
from scanmotion.sensing.fusion.fuse import Cloud
from scanmotion.sensing.fusion.surface import deviation_mesh, surface


def test_surface_is_trimmed_to_the_data(lump, lump_cloud):
    seen = lump_cloud.points[:, 2] < 0.12
    cut = Cloud(
        **{n: getattr(lump_cloud, n)[seen] for n in ("points", "normals", "view_directions", "counts")}
    )
    vertices, triangles = surface(cut, depth=7)
    assert vertices[:, 2].max() < 0.12 + 0.004
    assert triangles.max() == len(vertices) - 1
    a = accuracy(vertices, lump)
    assert a.mean_abs < 0.10e-3
    corners = vertices[triangles]
    area = (
        0.5
        * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    assert area > 0.9 * len(cut) * 0.002**2 * 0.6
    again = surface(cut, depth=7)
    np.testing.assert_array_equal(vertices, again[0])


def test_deviation_mesh_colours_by_sign(lump, tmp_path):
    d = deviation_mesh(lump.vertices * [1.01, 1.01, 1.0], lump.triangles, lump, limit=2e-4)
    outside = d.distance > 1e-4
    assert outside.sum() > 0.5 * len(d.distance)
    assert (d.colors[outside, 0] > d.colors[outside, 2]).all()
    fit = deviation_mesh(lump.vertices, lump.triangles, lump)
    assert np.ptp(fit.colors) <= 3
    d.save(tmp_path / "deviation.ply")
    back = read_geometry(tmp_path / "deviation.ply")
    np.testing.assert_allclose(back.vertices, d.vertices * 1e3, atol=1e-4)
    np.testing.assert_array_equal(back.triangles, d.triangles)
