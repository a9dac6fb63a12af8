"""The same points come out of every dialect of clouds; what measures nothing is dropped and said."""

import struct

import numpy as np
import pytest
from scans import bumpy

from scanmotion.core.errors import PartError
from scanmotion.core.part import Part
from scanmotion.geometry.files.part_files import read_geometry
from scanmotion.geometry.parts.make_part import part_from_file, surface_samples

_LUMP = surface_samples(bumpy(20, size=0.05), 3000, rng=np.random.default_rng(1))
P = np.round(_LUMP.points * 1e3, 3)
N = np.round(_LUMP.normals, 4)
C = np.random.default_rng(2).integers(0, 256, (len(P), 3))
I = np.random.default_rng(3).integers(-2000, 2000, len(P))  # noqa: E741


def rows(*columns, mark=" ", form="{:g}", end="\n"):
    table = np.column_stack(columns)
    return (end.join(mark.join(form.format(v) for v in row) for row in table) + end).encode()


def ptx(points):
    pose = ["1 0 0", "0 1 0", "0 0 1"]
    matrix = ["1 0 0 0", "0 1 0 0", "0 0 1 0", "10 20 30 1"]
    lines = [str(len(points) + 5), "1", "10 20 30", *pose, *matrix]
    lines += ["0 0 0 0.5"] * 5 + [f"{x:.3f} {y:.3f} {z:.3f} 0.5" for x, y, z in points - [10, 20, 30]]
    return ("\n".join(lines) + "\n").encode()


def pcd(fields, sizes, types, counts, data, kind="ascii", n=3000, more=()):
    head = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {fields}", f"SIZE {sizes}",
            f"TYPE {types}", f"COUNT {counts}", f"WIDTH {n}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", *more,
            f"POINTS {n}", f"DATA {kind}"]  # fmt: skip
    return ("\n".join(head) + "\n").encode() + data


S = rows(P)
COMMA = S.replace(b".", b",")
CLOUDS = {
    "plain.xyz": S,
    "tabs.xyz": S.replace(b" ", b"\t"),
    "crlf.xyz": S.replace(b"\n", b"\r\n"),
    "cr.xyz": S.replace(b"\n", b"\r"),
    "bom.xyz": b"\xef\xbb\xbf" + S,
    "utf16.txt": b"\xff\xfe" + S.decode().encode("utf-16-le"),
    "no_end.xyz": S.rstrip(),
    "comma.csv": S.replace(b" ", b","),
    "comma_blank.csv": S.replace(b" ", b", "),
    "semicolon.asc": S.replace(b" ", b";"),
    "german.csv": COMMA.replace(b" ", b";"),
    "german_tab.txt": COMMA.replace(b" ", b"\t"),
    "trailing.csv": S.replace(b" ", b";").replace(b"\n", b";\n"),
    "quoted.csv": b'"x","y","z"\n' + S.replace(b" ", b","),
    "header.csv": b"x,y,z\n" + S.replace(b" ", b","),
    "units.csv": b"x [mm],y [mm],z [mm]\n" + S.replace(b" ", b","),
    "order.csv": b"z,intensity,y,x\n" + rows(P[:, 2], I, P[:, 1], P[:, 0], mark=","),
    "survey.csv": b"Name,Easting,Northing,Height\n" + rows(np.arange(len(P)), P, mark=","),
    "cloudcompare.asc": b"//X Y Z R G B Nx Ny Nz\n3000\n" + rows(P, C, N),
    "count.pts": b"3000\n" + rows(P, I, C),
    "two.pts": b"1000\n" + rows(P[:1000], I[:1000], C[:1000]) + b"2000\n" + rows(P[1000:], I[1000:], C[1000:]),  # noqa: E501
    "numbers.txt": rows(np.arange(1, len(P) + 1), P),
    "intensity.xyz": rows(P, I),
    "rgb.xyz": rows(P, C),
    "rgb_float.xyz": rows(P, np.round(C / 255, 4)),
    "rgb_normals.xyz": rows(P, C, N),
    "normals.xyz": rows(P, N),
    "normals_curvature.xyz": rows(P, N, np.abs(I) / 4000),
    "exponent.xyz": rows(P, form="{:.6e}"),
    "fortran.xyz": rows(P, form="{:.6e}").replace(b"e", b"D"),
    "comments.xyz": b"# made by hand\n// 2024\n; x\n\n" + S,
    "label.txt": b"\n".join(line + b" wood" for line in S.splitlines()) + b"\n",
    "cut.xyz": S + b"12.5 3",
    "nan.xyz": S + b"nan nan nan\nNaN 1 2\n1 2 -nan\n",
    "windows_nan.xyz": S + b"1.#QNAN 1.#QNAN 1.#QNAN\n",
    "empty_fields.csv": S.replace(b" ", b",") + b"1.5,,2\n,,\n",
    "zeros.xyz": S + b"0 0 0\n" * 40,
    "twice.xyz": S + S[: S.index(b"\n", 5000) + 1],
    "speck.xyz": S + b"0 0 -400\n0.1 0 -400\n0 0.1 -400\n",
    "scan.ptx": ptx(P),
    "ascii.pcd": pcd("x y z", "4 4 4", "F F F", "1 1 1", S),
    "extra.pcd": pcd("rgb x y z", "4 4 4 4", "U F F F", "1 1 1 1", rows(C[:, 0], P)),
    "histogram.pcd": pcd("x y z fpfh", "4 4 4 4", "F F F F", "1 1 1 3", rows(P, N)),
    "binary.pcd": pcd("x y z", "4 4 4", "F F F", "1 1 1", P.astype("<f4").tobytes(), "binary"),
    "double.pcd": pcd("x y z", "8 8 8", "F F F", "1 1 1", P.astype("<f8").tobytes(), "binary"),
    "padding.pcd": pcd(
        "x y z _", "4 4 4 1", "F F F U", "1 1 1 4",
        np.column_stack([P, np.zeros(len(P))]).astype("<f4").tobytes(), "binary",
    ),
}  # fmt: skip
WITH_NORMALS = {"cloudcompare.asc", "rgb_normals.xyz", "normals.xyz", "normals_curvature.xyz"}


@pytest.mark.parametrize("name", CLOUDS)
def test_a_dialect(tmp_path, name):
    (tmp_path / name).write_bytes(CLOUDS[name])
    part = part_from_file(tmp_path / name, units="mm")
    _, first = np.unique(P, axis=0, return_index=True)
    want = P[np.sort(first)]
    assert len(part.vertices) == len(want), part.report.line
    back = np.linalg.inv(part.X_OI)
    got = part.vertices @ back[:3, :3].T + back[:3, 3]
    np.testing.assert_allclose(
        got, want, atol=1e-4 if "pcd" in name or "exp" in name or "for" in name else 1e-9
    )
    assert (part.normals is not None) == (name in WITH_NORMALS), part.report.line
    if part.normals is not None:
        assert (np.einsum("ij,ij->i", part.normals, N[np.sort(first)]) > 0.999).all()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nan.xyz", "3 of 3003"), ("zeros.xyz", "40 of 3040"), ("twice.xyz", "stand twice"), ("cut.xyz", "last line"),  # noqa: E501
        ("speck.xyz", "1 speck"), ("numbers.txt", "points' numbers"), ("rgb.xyz", "colours"),
        ("label.txt", "words"), ("german.csv", "decimal commas"), ("scan.ptx", "5 pixels"), ("normals.xyz", "unit vectors"),  # noqa: E501
        ("intensity.xyz", "left aside"), ("empty_fields.csv", "2 of 3002"),
    ],
)  # fmt: skip
def test_what_was_done_is_said(tmp_path, name, said):
    (tmp_path / name).write_bytes(CLOUDS[name])
    assert said in part_from_file(tmp_path / name, units="mm").report.line


def test_packed_pcd_of_another_writer(tmp_path):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(P))
    cloud.normals = o3d.utility.Vector3dVector(N)
    for ascii_, packed in ((True, False), (False, False), (False, True)):
        path = tmp_path / f"{ascii_}{packed}.pcd"
        assert o3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=packed)
        raw = read_geometry(path)
        np.testing.assert_allclose(raw.vertices, P, atol=1e-4)
        np.testing.assert_allclose(raw.normals, N, atol=1e-4)
    whole = path.read_bytes()
    for cut in (len(whole) - 100, len(whole) // 2):
        path.write_bytes(whole[:cut])
        with pytest.raises(PartError, match="cut short"):
            read_geometry(path)


@pytest.mark.parametrize("name", ["a.xyz", "a.xyzn", "a.xyzrgb", "a.pts", "a.ply", "ascii.ply"])
def test_clouds_of_another_writer(tmp_path, name):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(P))
    if not name.endswith((".xyzrgb", ".pts")):
        cloud.normals = o3d.utility.Vector3dVector(N)
    cloud.colors = o3d.utility.Vector3dVector(C / 255)
    assert o3d.io.write_point_cloud(str(tmp_path / name), cloud, write_ascii="ascii" in name)
    raw = read_geometry(tmp_path / name)
    np.testing.assert_allclose(raw.vertices, P, atol=1e-6)
    assert (raw.normals is not None) == name.endswith((".xyzn", ".ply"))
    if raw.normals is not None:
        np.testing.assert_allclose(raw.normals, N, atol=1e-6)


def test_e57(tmp_path):
    pye57 = pytest.importorskip("pye57")
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    rows = {f"cartesian{a}": P[:, i] * 1e-3 for i, a in enumerate("XYZ")}
    file.write_scan_raw(rows, translation=np.array([1.0, 2.0, 3.0]))
    file.close()
    raw = read_geometry(tmp_path / "a.e57")
    assert raw.units == "m"
    np.testing.assert_allclose(raw.vertices, P * 1e-3 + [1, 2, 3], atol=1e-6)


def test_inward_normals_are_turned_and_a_bowls_are_not(tmp_path):
    (tmp_path / "in.xyz").write_bytes(rows(P, -N))
    part = part_from_file(tmp_path / "in.xyz")
    assert "looked inwards" in part.report.line
    assert (np.einsum("ij,ij->i", part.normals, N) > 0.99).mean() > 0.999
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-80, 80, 60), np.linspace(-80, 80, 60)))
    z = (x**2 + y**2) / 150
    n = np.column_stack([-2 * x / 150, -2 * y / 150, np.ones_like(x)])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    (tmp_path / "bowl.xyz").write_bytes(rows(np.column_stack([x, y, z]), np.round(n, 5)))
    part = part_from_file(tmp_path / "bowl.xyz")
    assert part.normals[:, 2].min() > 0


def test_a_floor_is_cut_off_and_a_relief_keeps_its_ground(tmp_path):
    rng = np.random.default_rng(5)
    above = P - [0, 0, P[:, 2].min() - 1]
    r, t = 250 * np.sqrt(rng.random(20000)), 2 * np.pi * rng.random(20000)
    table = np.column_stack([r * np.cos(t), r * np.sin(t), 0.02 * rng.standard_normal(20000)])
    (tmp_path / "table.xyz").write_bytes(rows(np.concatenate([above, table]), form="{:.4f}"))
    part = part_from_file(tmp_path / "table.xyz")
    assert "was cut off" in part.report.line
    np.testing.assert_allclose(part.extent, np.ptp(P, axis=0) * 1e-3, atol=2e-3)
    xy = rng.uniform(-150, 150, (30000, 2))
    relief = 12 * np.exp(-((xy / 60) ** 2).sum(axis=1))
    (tmp_path / "relief.xyz").write_bytes(rows(np.column_stack([xy, relief]), form="{:.4f}"))
    part = part_from_file(tmp_path / "relief.xyz")
    assert "cut off" not in part.report.line and part.extent[0] > 0.29


def test_a_large_cloud_is_thinned_with_a_word():
    from scanmotion.geometry.mending.mend_cloud import MendedCloud, thinned_cloud

    rng = np.random.default_rng(6)
    p = rng.random((200_000, 3)) * [1, 1, 0.001]
    made = thinned_cloud(MendedCloud(points=p, normals=None), most=20_000)
    assert 12_000 < len(made.points) <= 20_000 and "thinned" in made.changes[-1]
    assert np.ptp(made.points, axis=0).min() > 0.0009


REFUSED = {
    "pointer.ply": (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 9\n", "Git LFS"),
    "page.stl": (b"<!DOCTYPE html><html></html>", "web page"),
    "packed.xyz": (b"\x1f\x8b\x08" + b"0" * 50, "gzip"),
    "step.obj": (b"ISO-10303-21;\n", "STEP"),
    "binary.xyz": (bytes(range(256)) * 4, "binary"),
    "commas.csv": (b"1,250,3,500,7,750\n" * 20, "semicolons"),
    "two_columns.xyz": (b"1 2\n3 4\n5 6\n", "2 numbers"),
    "short.pts": (b"5000\n" + S, "claims 5000"),
    "short.ptx": (ptx(P)[:-3000], "cut short"),
    "letters.xyz": (S[:500] + b"1 2 o\n" + S[500:], "could not"),
    "quads.stl": (b"solid\nfacet normal 0 0 1\nouter loop\n" + b"vertex 1 2 3\n" * 4 + b"endloop\nendfacet\n", "facet"),  # noqa: E501
    "nurbs.obj": (b"v 0 0 0\nv 1 0 0\nv 1 1 0\ncstype bspline\nsurf 0 1 0 1 1 2 3\n", "free-form"),
    "corner.obj": (b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2.5 3\n", "whole"),
    "zero.obj": (b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 0 1 2\n", "counts from 1"),
    "list.ply": (b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"  # noqa: E501
                 b"element face 1\nproperty float a\nend_header\n0 0 0\n9 0 0\n0 9 0\n1\n", "no list of corners"),  # noqa: E501
    "half.ply": (b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"  # noqa: E501
                 b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n9 0 0\n0 9 0\n3 0 1\n", "cut short"),  # noqa: E501
    "float32_utm.xyz": (None, "the surface is lost"),
    "four.off": (b"4OFF\n1 1 1\n", "dimensions"),
    "claims.off": (b"OFF\n900000000 1 0\n", "claims more"),
    "counts.pcd": (pcd("x y z", "4 4", "F F F", "1 1 1", S), "different length"),
    "kind.pcd": (pcd("x y z", "4 4 4", "F F Q", "1 1 1", S), "no type"),
    "fields.pcd": (pcd("a b c", "4 4 4", "F F F", "1 1 1", S), "x, y, z"),
    "broken.glb": (b"glTF\2\0\0\0" + b"\xff" * 60, "GLB"),
    "broken.3mf": (b"PK\3\4" + b"0" * 90, "3MF"),
    "broken.e57": (b"ASTM-E57" + b"0" * 90, "E57"),
    "named.ply": (b"glTF\2\0\0\0" + b"\xff" * 60, "name it so"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_names_its_cause(tmp_path, name):
    content, said = REFUSED[name]
    path = tmp_path / name
    if content is None:
        far = (P + [4.0e8, 5.6e9, 0]).astype(np.float32)
        path = tmp_path / "utm.pcd"
        content = pcd("x y z", "4 4 4", "F F F", "1 1 1", far.tobytes(), "binary")
    path.write_bytes(content)
    with pytest.raises(PartError) as caught:
        part_from_file(path)
    line = str(caught.value)
    assert said in line and "\n" not in line and str(path) in line


def test_a_part_in_memory_has_no_report():
    assert Part(name="a", vertices=P, triangles=np.zeros((0, 3), int)).report is None


def test_sizes_beyond_what_a_header_may_claim(tmp_path):
    path = tmp_path / "bomb.ply"
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 90000000\n" + "".join(
        f"property double {a}\n" for a in "xyz"
    )
    path.write_bytes(head.encode() + b"end_header\n" + struct.pack("<9d", *range(9)) + b"\0" * 90_000_000)
    with pytest.raises(PartError, match="cut short"):
        read_geometry(path)
