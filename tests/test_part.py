"""Loading, repair and refusal of parts; samples of the surface; the built-in carving."""

import importlib.util
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanmotion.core.errors import PartError
from scanmotion.geometry.parts.make_part import (
    box_part,
    carving,
    check_fits,
    models_dir,
    part_from_file,
    surface_samples,
)

BOX = box_part(0.2, 0.1, 0.3)


def write_ply(path, vertices, triangles, *, ascii=False):
    head = f"ply\nformat {'ascii' if ascii else 'binary_little_endian'} 1.0\nelement vertex {len(vertices)}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    if ascii:
        body = "\n".join(" ".join(f"{x:.9g}" for x in v) for v in vertices)
        body += "\n" + "\n".join("3 " + " ".join(map(str, t)) for t in triangles) + "\n"
        path.write_text(head + body)
    else:
        faces = b"".join(struct.pack("<B3i", 3, *t) for t in triangles)
        path.write_bytes(head.encode() + np.asarray(vertices, "<f4").tobytes() + faces)
    return path


def volume(part):
    a, b, c = (part.vertices[part.triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@pytest.mark.parametrize("kind", ["ply", "ply-ascii", "stl", "stl-ascii", "obj"])
def test_formats_give_the_same_box(tmp_path, kind):
    v, t = BOX.vertices * 1e3, BOX.triangles
    path = tmp_path / f"box.{kind.split('-')[0]}"
    if kind.startswith("ply"):
        write_ply(path, v, t, ascii=kind.endswith("ascii"))
    elif kind == "stl":
        rows = b"".join(struct.pack("<12fH", 0, 0, 0, *v[f].ravel(), 0) for f in t)
        path.write_bytes(b"x" * 80 + struct.pack("<I", len(t)) + rows)
    elif kind == "stl-ascii":
        facet = "facet normal 0 0 0\nouter loop\n{}\nendloop\nendfacet\n"
        text = "".join(facet.format("\n".join("vertex {} {} {}".format(*p) for p in v[f])) for f in t)
        path.write_text(f"solid box\n{text}endsolid\n")
    else:
        lines = ["v {} {} {}".format(*p) for p in v]
        # One quad and the rest triangles, with texture and normal slots and a negative index.
        lines += ["f " + " ".join(f"{i + 1}/1/1" for i in f) for f in t[:-1]]
        lines += ["f " + " ".join(str(i - len(v)) for i in t[-1])]
        path.write_text("\n".join(lines))
    part = part_from_file(path)
    assert part.closed
    np.testing.assert_allclose(part.extent, (0.2, 0.1, 0.3), atol=1e-7)
    assert volume(part) == pytest.approx(0.2 * 0.1 * 0.3, rel=1e-6)


@pytest.mark.parametrize("up", ["+x", "-x", "+y", "-y", "+z", "-z"])
@pytest.mark.parametrize("unit", ["mm", "cm", "m", "in"])
def test_up_and_units(tmp_path, up, unit):
    scale = {"mm": 1e3, "cm": 1e2, "m": 1.0, "in": 1 / 0.0254}[unit]
    path = write_ply(tmp_path / "b.ply", BOX.vertices * scale + 7.0, BOX.triangles)
    part = part_from_file(path, units=unit, up=up)
    assert part.extent[2] == pytest.approx({"x": 0.2, "y": 0.1, "z": 0.3}[up[1]], abs=1e-6)
    assert volume(part) > 0, "a rotation, not a mirror"
    assert part.bounds[0, 2] == pytest.approx(0.0, abs=1e-6)
    file_points = BOX.vertices * scale + 7.0
    back = file_points @ part.X_OI[:3, :3].T + part.X_OI[:3, 3]
    assert np.abs(np.sort(back, axis=0) - np.sort(part.vertices, axis=0)).max() < 1e-5


def test_inverted_duplicated_and_mixed_faces_are_repaired_and_said(tmp_path):
    v, t = BOX.vertices * 1e3, BOX.triangles
    soup = v[t].reshape(-1, 3)
    faces = np.arange(len(soup)).reshape(-1, 3)[:, ::-1].copy()
    faces[3] = faces[3][::-1]
    faces = np.concatenate([faces, faces[:1], [[0, 0, 1]]])
    part = part_from_file(write_ply(tmp_path / "bad.ply", soup, faces))
    assert part.closed and len(part.triangles) == 12 and len(part.vertices) == 8
    assert volume(part) == pytest.approx(0.006, rel=1e-6)
    said = " ".join(part.repairs)
    for word in ("duplicate vertices", "degenerate", "duplicate triangles", "neighbours", "inside out"):
        assert word in said


def test_open_surface_is_said(tmp_path):
    part = part_from_file(write_ply(tmp_path / "open.ply", BOX.vertices * 1e3, BOX.triangles[2:]))
    assert not part.closed and "4 boundary edges" in " ".join(part.repairs)


BAD = {
    "missing.ply": None,
    "empty.ply": b"",
    "text.ply": b"hello world",
    "cut.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n" + b"0" * 20,
    "billion.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n"
    b"property float y\nproperty float z\nelement face 1000000000\nproperty list uchar int vertex_indices\n"
    b"end_header\n" + b"0" * 36,
    "nan.xyz": b"0 0 0\n1 nan 0\n0 1 0\n5 5 5\n",
    "two.xyz": b"0 0 0\n100 0 0\n",
    "line.xyz": b"0 0 0\n100 0 0\n200 0 0\n300 0 0\n",
    "words.xyz": b"a b c\nd e f\n",
    "beyond.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "flat.obj": b"v 0 0 0\nv 100 0 0\nv 200 0 0\nf 1 2 3\n",
    "short.stl": b"x" * 80 + struct.pack("<I", 4_000_000_000) + b"0" * 50,
    "packed.pcd": b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 3\nDATA binary_compressed\n000",
    "a.fbx": b"xx",
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_get_one_clear_line(tmp_path, name):
    path = tmp_path / name
    if BAD[name] is not None:
        path.write_bytes(BAD[name])
    with pytest.raises(PartError) as caught:
        part_from_file(path)
    assert "\n" not in str(caught.value) and name in str(caught.value)


def test_wrong_units_are_guessed_at(tmp_path):
    path = write_ply(tmp_path / "b.ply", BOX.vertices, BOX.triangles)
    with pytest.raises(PartError, match="--units"):
        part_from_file(path)
    path = write_ply(tmp_path / "c.ply", BOX.vertices * 1e6, BOX.triangles)
    with pytest.raises(PartError, match="--units"):
        part_from_file(path)


def test_too_large_for_the_table():
    with pytest.raises(PartError, match="760 mm"):
        check_fits(box_part(1.6, 0.2, 0.2), 0.76, 2.0)
    with pytest.raises(PartError, match="tall"):
        check_fits(box_part(0.2, 0.2, 2.2), 0.76, 2.0)
    check_fits(box_part(0.6, 0.33, 0.2), 0.76, 2.0)


@settings(max_examples=400)
@given(st.sampled_from(["ply", "stl", "obj", "pcd", "xyz"]), st.data())
def test_mutated_files_end_in_a_part_or_a_part_error(tmp_path_factory, kind, data):
    folder = tmp_path_factory.getbasetemp()
    v = BOX.vertices * 1e3
    seeds = {
        "ply": write_ply(folder / "seed.ply", v, BOX.triangles, ascii=data.draw(st.booleans())).read_bytes(),
        "stl": b"x" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", 0, 0, 0, *v[:3].ravel(), 0),
        "obj": b"v 0 0 0\nv 100 0 0\nv 0 100 0\nf 1 2 3\n",
        "pcd": b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 3\n"
        b"DATA ascii\n0 0 0\n9 99 9\n50 1 2\n",
        "xyz": b"0 0 0\n100 0 0\n0 100 0\n0 0 100\n",
    }
    raw = bytearray(seeds[kind])
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(raw) - 1))
        action = data.draw(st.sampled_from(["set", "cut", "insert"]))
        if action == "set":
            raw[at] = data.draw(st.integers(0, 255))
        elif action == "cut":
            del raw[at : at + data.draw(st.integers(1, 40))]
        else:
            raw[at:at] = data.draw(st.binary(max_size=8))
        if not raw:
            break
    path = folder / f"fuzz.{kind}"
    path.write_bytes(bytes(raw))
    try:
        part = part_from_file(path)
    except PartError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(part.vertices).all()


def test_samples_lie_on_the_surface_uniformly(rng):
    samples = surface_samples(BOX, 40_000, rng=rng)
    top = samples.points[:, 2] > 0.3 - 1e-12
    assert samples.area * 40_000 == pytest.approx(2 * (0.2 * 0.1 + 0.2 * 0.3 + 0.1 * 0.3))
    assert top.sum() * samples.area == pytest.approx(0.02, rel=1e-3)
    on_face = np.min(
        np.abs(np.concatenate([samples.points - BOX.bounds[0], samples.points - BOX.bounds[1]], 1)), 1
    )
    assert on_face.max() < 1e-12
    assert (np.einsum("ij,ij->i", samples.normals, samples.points - [0, 0, 0.15]) > 0).all()


def test_carving_is_what_its_script_makes():
    spec = importlib.util.spec_from_file_location("carving", models_dir() / "parts" / "carving.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    vertices, triangles = script.carving()
    part = carving()
    assert part.closed and not part.repairs
    np.testing.assert_allclose(part.extent, (0.6, 0.33, 0.2), atol=1e-6)
    assert len(part.triangles) == len(triangles)
    # Trigonometric functions may differ in the last bit between machines, so not byte for byte.
    np.testing.assert_allclose(part.vertices, vertices * 1e-3, atol=2e-6)
