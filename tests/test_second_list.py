"""Each feature of the second list is read right or refused in one line that names its cause."""

from dataclasses import replace

import numpy as np
import pytest
from second_clouds import CLOUDS, FAR, GROUPED, HAVE_NORMALS
from second_doubts import REFUSED, SAID
from second_list import MESHES, Y_IS_UP
from test_cloud_dialects import N, P
from test_mesh_dialects import TRUE, is_the_lump, volume

from scanmotion.core.errors import PartError
from scanmotion.geometry.parts.make_part import part_from_file


def in_the_file(part):
    """Its points in the file's frame and unit."""
    back = np.linalg.inv(part.X_OI)
    return part.vertices @ back[:3, :3].T + back[:3, 3]


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh(tmp_path, name):
    (tmp_path / name).write_bytes(MESHES[name])
    part = part_from_file(tmp_path / name)
    if name == "moved.3mf":
        part = part_from_file(tmp_path / name)
        assert part.closed and volume(part) == pytest.approx(TRUE, rel=1e-4)
        return
    if name in Y_IS_UP:  # turned by a quarter about the vertical
        part = replace(part, vertices=part.vertices[:, [1, 0, 2]] * [1, -1, 1])
    assert is_the_lump(part, tolerance=1e-5) == pytest.approx(TRUE, rel=1e-3), part.report.line
    assert ("+y" in part.report.line) == (name in Y_IS_UP), part.report.line


def sorted_rows(points, *, order):
    return points[np.lexsort(np.round(points, 2).T)] if order else points


@pytest.mark.parametrize("name", CLOUDS)
def test_a_cloud(tmp_path, name):
    (tmp_path / name).write_bytes(CLOUDS[name])
    part = part_from_file(tmp_path / name, units=None if "glb" in name or "short" in name else "mm")
    _, first = np.unique(P, axis=0, return_index=True)
    want = P[np.sort(first)]
    got = in_the_file(part)
    if "glb" in name:
        got = got[:, [0, 2, 1]] * [1e3, -1e3, 1e3]
    if "short" in name:
        got = got / 1e3
    assert got.shape == want.shape, part.report.line
    np.testing.assert_allclose(got, want, atol=2e-3, err_msg=part.report.line)
    assert (part.normals is not None) == (name in HAVE_NORMALS), part.report.line
    if part.normals is not None:
        assert (np.einsum("ij,ij->i", part.normals, N[np.sort(first)]) > 0.999).all()


@pytest.mark.parametrize("name", GROUPED)
def test_groups_of_digits(tmp_path, name):
    (tmp_path / name).write_bytes(GROUPED[name])
    part = part_from_file(tmp_path / name, units="mm")
    _, first = np.unique(FAR, axis=0, return_index=True)
    np.testing.assert_allclose(in_the_file(part), FAR[np.sort(first)], atol=1e-3, err_msg=part.report.line)


@pytest.mark.parametrize("name", SAID)
def test_what_is_doubtful_is_said(tmp_path, name):
    content, words = SAID[name]
    (tmp_path / name).write_bytes(content)
    line = part_from_file(tmp_path / name).report.line
    assert words in line, line


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_names_its_cause(tmp_path, name):
    content, words = REFUSED[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PartError) as caught:
        part_from_file(tmp_path / name)
    line = str(caught.value)
    assert words in line and "\n" not in line, line
