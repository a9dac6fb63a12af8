"""Files of the second list that are read with a word of doubt, or refused in a line that names the cause."""
# ruff: noqa: E501

import io
import struct
import zipfile

import numpy as np
from mesh_dialects import (
    TRI,
    XYZ,
    F,
    V,
    ascii_ply,
    binary_ply,
    binary_stl,
    faces,
    facets,
    head,
    obj,
    rows,
    text,
)
from second_clouds import CLOUDS, GROUPED
from second_list import Y_UP, glb, mf3
from test_cloud_dialects import P, S, pcd
from test_cloud_dialects import rows as table


def scaled(factor):
    """The lump as STL in another unit, which the file does not state."""
    out = ["solid part"]
    for t in F:
        out += [
            "facet normal 0 0 0",
            "outer loop",
            *("vertex {:.6f} {:.6f} {:.6f}".format(*(V[i] * factor)) for i in t),
        ]
        out += ["endloop", "endfacet"]
    return text([*out, "endsolid part"])


def open_sheet(sign):
    """A curved sheet whose facet normals agree with its winding, or not."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(12.0) * 10, np.arange(12.0) * 10))
    p = np.column_stack([x, y, 0.002 * (x - 55) ** 2])
    f = np.array([(i, i + 1, i + 13) for r in range(11) for i in range(12 * r, 12 * r + 11)])
    body = b"".join(struct.pack("<12fH", 0, 0, sign, *p[t].ravel(), 0) for t in f)
    return b"sheet".ljust(80) + struct.pack("<I", len(f)) + body


def with_unit(words):
    """The lump as OBJ with a comment at its top, in a tenth of mm's numbers."""
    return text(
        [
            words,
            *("v {:.5f} {:.5f} {:.5f}".format(*p) for p in V / 10),
            *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in F),
        ]
    )


SAID = {
    "inches.stl": (scaled(1 / 3), "if it is in another unit"),
    "blender.obj": (b"# Blender 3.6.5\n# www.blender.org\n" + obj(), "--up +y"),
    "blender_old.obj": (b"# Blender v2.79 (sub 0) OBJ File: 'a.blend'\n" + obj(), "--up +y"),
    "wrong_normals.stl": (open_sheet(-1.0), "against its winding"),
    "sketchup.obj": (with_unit("# File units = centimeters"), "unit cm"),
    "in_cm.obj": (with_unit("# units in cm"), "unit cm"),
    "one_unit.obj": (with_unit("# 1 unit = 1 cm"), "unit cm"),
    "stl_unit.stl": (b"UNITS=cm".ljust(80) + b"".join([struct.pack("<I", len(F)), *(struct.pack("<12fH", 0, 0, 0, *(V[t] / 10).ravel(), 0) for t in F)]), "unit cm"),
    "low_count.stl": (binary_stl(count=len(F) - 7), "claims"),
    "viewpoint.pcd": (CLOUDS["viewpoint.pcd"], "VIEWPOINT"),
    "range_grid.ply": (CLOUDS["range_grid.ply"], "range grid"),
    "zero_normals.ply": (CLOUDS["zero_normals.ply"], "normals were left aside"),
    "words.csv": (b"Abszisse,Ordinate,Applikate\n" + table(P, mark=","), "not understood"),
    "grid_first.txt": (CLOUDS["grid_first.txt"], "columns 1-2: rows and columns of the scan"),
    "german_groups.txt": (GROUPED["german_groups.txt"], "decimal commas"),
    "named_xyz.xyz": (CLOUDS["named_xyz.xyz"], "its ending says XYZ"),
    "x_cm.csv": (b"x_cm,y_cm,z_cm\n" + table(np.round(P / 10, 4), mark=","), "unit cm"),
    "x_in_cm.csv": (b"X in cm;Y in cm;Z in cm\n" + table(np.round(P / 10, 4), mark=";"), "unit cm"),
}  # fmt: skip

# What is refused ---------------------------------------------------------------------------------------------


def _zip(name, content):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr(name, content)
    return out.getvalue()


_PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(60)
_THREE = text(["ply", "format ascii 1.0", "element vertex 3", *(f"property {p}" for p in XYZ)])
REFUSED = {
    "depth.png": (_PNG, "picture"),
    "depth.tiff": (b"II*\0" + bytes(60), "picture"),
    "depth.xyz": (_PNG, "picture"),
    "photo.ply": (b"\xff\xd8\xff\xe0\0\x10JFIF" + bytes(60), "picture"),
    "sheet.stl": (b"%PDF-1.7\n" + bytes(60), "PDF"),
    "cloud.las": (b"LASF" + bytes(300), "LAS"),
    "cloud.laz": (b"LASF" + bytes(300), "LAS"),
    "las.xyz": (b"LASF" + bytes(300), "LAS"),
    "packed.zip": (b"PK\3\4" + bytes(60), "packed"),
    "packed.ply": (b"PK\3\4" + bytes(60), "packed"),
    "scan.ply.gz": (b"\x1f\x8b\x08" + bytes(60), "packed"),
    "scan.bz2.xyz": (b"BZh91AY&SY" + bytes(60), "packed"),
    "scan.xz.xyz": (b"\xfd7zXZ\0" + bytes(60), "packed"),
    "scan.zst.stl": (b"\x28\xb5\x2f\xfd" + bytes(60), "packed"),
    "part.step": (b"ISO-10303-21;\n", "STEP"),
    "part.igs": (b"x" * 72 + b"S      1\n", "IGES"),
    "part.fbx": (b"Kaydara FBX Binary  \0" + bytes(60), "FBX"),
    "part.wrl": (b"#VRML V2.0 utf8\n", "VRML"),
    "part.dae": (b"<?xml version='1.0'?><COLLADA></COLLADA>", "COLLADA"),
    "vrml.obj": (b"#VRML V2.0 utf8\nShape {}\n", "VRML"),
    "xml.stl": (b"<?xml version='1.0'?><VTKFile></VTKFile>", "XML"),
    "array.xyz": (b"\x93NUMPY\x01\0v\0{'descr': '<f8'}" + bytes(60), "NumPy"),
    "nothing.ply": (b"", "empty"),
    "blank.xyz": (b"\n\n   \n", "without points"),
    "zeros.stl": (bytes(84 + 500), "nothing but zeros"),
    "zeros.xyz": (bytes(5000), "nothing but zeros"),
    "zeros.ply": (bytes(5000), "nothing but zeros"),
    "no_vertices.ply": (text([*_THREE.decode().split("\n")[:2], "element vertex 0", *(f"property {p}" for p in XYZ), "end_header"]), "0 points"),
    "says_binary.ply": (ascii_ply().replace(b"format ascii", b"format binary_little_endian"), "text"),
    "says_ascii.ply": (binary_ply().replace(b"binary_little_endian", b"ascii"), "binary"),
    "from_one.ply": (text([*head("ascii", XYZ, TRI), *rows(), *faces(f=F + 1)]), f"vertex {len(V)} of {len(V)}"),
    "minus_one.ply": (text([*head("ascii", XYZ, TRI), *rows(), *faces(f=np.where(F == 5, -1, F))]), "vertex -1"),
    "twice.ply": (text([*head("ascii", (*XYZ, "float x"), TRI), *rows(extra=" 1"), *faces()]), "stands twice"),
    "two_vertices.ply": (text(["ply", "format ascii 1.0", "element vertex 3", *(f"property {p}" for p in XYZ), "element vertex 3", *(f"property {p}" for p in XYZ), "end_header", *rows()[:6]]), "element vertex stands twice"),
    "half_the_list.ply": (text([*head("ascii", XYZ, TRI), *rows(), *faces()])[:-200], "cut short"),
    "swapped.ply": (binary_ply().replace(b"little", b"big"), ""),
    "binary.off": (b"OFF BINARY\n" + bytes(60), "binary"),
    "coff4.off": (b"C4OFF\n1 1 1\n", "dimensions"),
    "no_word.off": (text([f"{len(V)} {len(F)} 0", *rows(), *faces()]), "first word"),
    "quads_half.stl": (text(facets())[: len(text(facets())) // 2], "cut short"),
    "half.stl": (binary_stl()[:4000], "has room for"),
    "no_facets.stl": (b"solid x\nendsolid x\n", "without facets"),
    "heights.csv": (table(np.arange(6400.0).reshape(40, 160), mark=","), "160 numbers"),
    "degrees.csv": (b"lon,lat,height\n" + table(P / 1000, mark=","), "degrees"),
    "polar.csv": (b"azimuth,elevation,range\n" + table(P, mark=","), "angles"),
    "glued.xyz": (b"-123.456-789.012-456.789\n" * 30, ""),
    "commas_both.csv": (b"1,25;3,50\n" * 30, "could not convert"),
    "matrix.txt": (b"1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", ""),
    "words.txt": (b"This is the scan of a statue.\nIt is not a cloud.\n" * 200, "no numbers"),
    "short_points.pcd": (pcd("x y z", "4 4 4", "F F F", "1 1 1", S, n=4000), "cut short"),
    "no_data.pcd": (b"VERSION 0.7\nFIELDS x y z\n", "DATA"),
    "no_xyz.ply": (text(["ply", "format ascii 1.0", "element vertex 3", "property float u", "property float v", "property float w", "end_header", "0 0 0", "9 0 0", "0 9 0"]), "x, y, z"),
    "wrapped.off": (text(["OFF", f"{len(V)} {len(F)} 0", *(r.replace(" ", "\n", 1) for r in rows()), *faces()]), "1 numbers where 3"),
    "draco.glb": (glb(Y_UP, F, more={"extensions": {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}}, extra={"extensionsUsed": ["KHR_draco_mesh_compression"], "extensionsRequired": ["KHR_draco_mesh_compression"]}), "KHR_draco_mesh_compression"),
    "no_bin.gltf": (glb(Y_UP, F, external=True)[0], "part.bin"),
    "lines.glb": (glb(Y_UP, np.arange(10), mode=1), "no triangles"),
    "no_model.3mf": (_zip("a.txt", b"x"), "3MF"),
    "elsewhere.3mf": (mf3(f=F[:0]), "no triangles"),
}  # fmt: skip
