"""A second list of what real files hold, beside that of the cases: one feature a file, each made here.

`MESHES` are all the closed lump, `CLOUDS` its points, `REFUSED` name the cause. The features come from public
reports to MeshLab, CloudCompare, Open3D, PCL, trimesh, assimp, Blender and ParaView, and from the formats' own
descriptions.
"""
# ruff: noqa: E501

import io
import json
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
    off,
    rows,
    text,
)

# PLY ---------------------------------------------------------------------------------------------------------


def faces_first(kind):
    lines = ["ply", f"format {kind} 1.0", f"element face {len(F)}", *(f"property {p}" for p in TRI)]
    lines += [f"element vertex {len(V)}", *(f"property {p}" for p in XYZ), "end_header"]
    if kind == "ascii":
        return text([*lines, *faces(), *rows()])
    return text(lines) + b"".join(struct.pack("<B3i", 3, *t) for t in F) + V.astype("<f4").tobytes()


def vertex_lists():
    """Vertices with a list of their own, before and behind the coordinates."""
    lines = head("binary_little_endian", ("list uchar int seen_by", *XYZ, "list uchar float weights"), TRI)
    body = b"".join(
        struct.pack("<B", i % 3) + struct.pack(f"<{i % 3}i", *range(i % 3)) + struct.pack("<3f", *p) + b"\0"
        for i, p in enumerate(V)
    )
    return text(lines) + body + b"".join(struct.pack("<B3i", 3, *t) for t in F)


def vertex_lists_ascii():
    lines = head("ascii", ("list uchar int seen_by", *XYZ), TRI)
    return text([*lines, *(f"{i % 3} {'7 ' * (i % 3)}{r}" for i, r in enumerate(rows())), *faces()])


def strips_big():
    strip = [i for t in F for i in (*t, -1)]
    lines = [*head("binary_big_endian", XYZ, TRI)[:6], "element tristrips 1",
             "property list int int vertex_indices", "end_header"]  # fmt: skip
    return text(lines) + V.astype(">f4").tobytes() + struct.pack(f">{len(strip) + 1}i", len(strip), *strip)


def two_face_elements():
    lines = head("ascii", XYZ, TRI, m=30)[:-1] + [
        f"element polygon {len(F) - 30}",
        "property list uchar int vertex_index",
        "end_header",
    ]
    return text([*lines, *rows(), *faces()])


# GLB and 3MF -------------------------------------------------------------------------------------------------


def glb(points, indices=None, *, mode=4, more=None, extra=None, external=False):
    """A GLB of one primitive; indices as uint32, `more` goes into the primitive, `extra` into the document."""
    blob = np.asarray(points, "<f4").tobytes()
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": len(blob)}]
    accessors = [{"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3",
                  "min": np.min(points, axis=0).tolist(), "max": np.max(points, axis=0).tolist()}]  # fmt: skip
    primitive = {"attributes": {"POSITION": 0}, "mode": mode}
    if indices is not None:
        flat = np.asarray(indices, "<u4").ravel()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": flat.nbytes})
        accessors.append({"bufferView": 1, "componentType": 5125, "count": len(flat), "type": "SCALAR"})
        primitive["indices"] = 1
        blob += flat.tobytes()
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{**primitive, **(more or {})}]}], "accessors": accessors,
        "bufferViews": views, "buffers": [{"byteLength": len(blob)}], **(extra or {}),
    }  # fmt: skip
    if external:
        document["buffers"][0]["uri"] = "part.bin"
        return json.dumps(document).encode(), blob
    words = json.dumps(document).encode()
    words += b" " * (-len(words) % 4)
    blob += b"\0" * (-len(blob) % 4)
    body = (
        struct.pack("<II", len(words), 0x4E4F534A) + words + struct.pack("<II", len(blob), 0x004E4942) + blob
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


Y_UP = V[:, [0, 2, 1]] * [1, 1, -1] * 1e-3
"""The lump as glTF has it: metres, y up."""


def strip_of_triangles():
    """All triangles in one strip, joined by degenerate ones, each at an even place."""
    out = []
    for t in F.tolist():
        out += [out[-1], t[0]] if out else []
        out += t if len(out) % 2 == 0 else [t[0], *t]
    return out


def mf3(
    model_unit='unit="millimeter" ',
    *,
    scale=1.0,
    transform="",
    build='<item objectid="1"{}/>',
    objects="",
    f=F,
):
    vertices = "".join('<vertex x="{:.5f}" y="{:.5f}" z="{:.5f}"/>'.format(*(p * scale)) for p in V)
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*t) for t in f)
    model = (
        f'<?xml version="1.0" encoding="UTF-8"?><model {model_unit}'
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh>'
        f"</object>{objects}</resources><build>{build.format(transform)}</build></model>"
    )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("3D/3dmodel.model", model)
    return out.getvalue()


_COMPONENT = '<object id="2" type="model"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 5 6 7"/></components></object>'
_UNUSED = '<object id="3" type="model"><mesh><vertices><vertex x="0" y="0" z="900"/><vertex x="9" y="0" z="900"/><vertex x="0" y="9" z="900"/></vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh></object>'

MESHES = {
    "faces_first.ply": faces_first("ascii"),
    "faces_first_binary.ply": faces_first("binary_little_endian"),
    "vertex_lists.ply": vertex_lists(),
    "vertex_lists_ascii.ply": vertex_lists_ascii(),
    "strips_big.ply": strips_big(),
    "two_face_elements.ply": two_face_elements(),
    "ushort_list.ply": binary_ply(face=("list uint16 int vertex_indices",), pack=lambda t: struct.pack("<H3i", 3, *t)),
    "int8_list.ply": binary_ply(face=("list int8 uint16 vertex_index",), pack=lambda t: struct.pack("<b3H", 3, *t)),
    "uint_list_uchar.ply": binary_ply(order=">", face=("list uint uint vertex_indices",), pack=lambda t: struct.pack(">4I", 3, *t)),
    "int64_corners.ply": binary_ply(face=("list uchar int64 vertex_indices",), pack=lambda t: struct.pack("<B3q", 3, *t)),
    "float_corners.ply": ascii_ply(face=("list uchar float vertex_indices",)),
    "mixed_ends.ply": binary_ply().replace(b"end_header\n", b"end_header\r\n"),
    "spaces_in_header.ply": ascii_ply().replace(b"ply\n", b"ply  \n").replace(b"\nproperty", b"\n property").replace(b" x\n", b" x \n"),
    "obj_info.ply": binary_ply(more=("obj_info num_cols 512", "obj_info element 3", "comment property float q")),
    "mixed_types.ply": text(head("binary_little_endian", ("double x", "float y", "double z"), TRI))
    + b"".join(struct.pack("<dfd", *p) for p in V) + b"".join(struct.pack("<B3i", 3, *t) for t in F),
    "colour_between.ply": text(head("binary_little_endian", ("float x", "uchar red", "float y", "float z", "double q"), TRI))
    + b"".join(struct.pack("<fBffd", p[0], 7, p[1], p[2], 0.5) for p in V) + b"".join(struct.pack("<B3i", 3, *t) for t in F),
    "soup.ply": text([*head("ascii", XYZ, TRI, n=3 * len(F)), *rows(V[F].reshape(-1, 3)), *faces(f=np.arange(3 * len(F)).reshape(-1, 3))]),
    "two_corner_faces.ply": text([*head("ascii", XYZ, TRI, m=len(F) + 2), *rows(), *faces(), "2 0 1", "0"]),
    "trailing_zeros.ply": ascii_ply() + b"\0" * 40,
    # STL
    "magics_colours.stl": binary_stl(header=b"COLOR=\x10\x20\x30\xff,MATERIAL=" + b"\x01" * 12, attribute=0x8421),
    "low_count.stl": binary_stl(count=len(F) - 7),
    "ascii_plus.stl": text(facets("{:+.4f} {:+.4f} {:+.4f}")),
    "ascii_blank_first.stl": b"\n\n  " + text(facets()),
    "ascii_trailing_zeros.stl": text(facets()) + b"\0" * 512,
    "ascii_utf16.stl": b"\xff\xfe" + text(facets()).decode("latin-1").encode("utf-16-le"),
    "ascii_wrong_normals.stl": text(facets(normal="facet normal nan nan nan")),
    "ascii_one_line.stl": b" ".join(text(facets()).split()),
    "named_obj.obj": text(facets()),
    "named_ply.ply": text(facets()),
    "mesh.xyz": obj(),
    "named_stl.stl": off(),
    # OBJ
    "old_faces.obj": obj(face="fo {} {} {}"),
    "capitals.obj": obj("V {:.4f} {:.4f} {:.4f}", "F {} {} {}"),
    "continued_faces.obj": obj(face="f {} \\\n{} \\\r\n {}"),
    "negative_mixed.obj": text([r for t in F for r in (*(f"v {V[i][0]:.4f} {V[i][1]:.4f} {V[i][2]:.4f}" for i in t), "f -3//-1 -2//-1 -1//-1")]),
    "colours_and_weight.obj": obj("v {:.4f} {:.4f} {:.4f} 1.0 0.1 0.5 1"),
    "groups_between.obj": text([r for i, p in enumerate(V) for r in (f"v {p[0]:.4f} {p[1]:.4f} {p[2]:.4f}", f"g {i}", "vn 0 0 1", "vt 0 0")]
                               + [f"f {a + 1}/1/1 {b + 1}/1/1 {c + 1}/1/1" for a, b, c in F]),
    "exponents.obj": obj("v {:.6e} {:.6E} {:.6e}"),
    "trailing_zeros.obj": obj() + b"\0" * 33,
    "free_form_besides.obj": obj(more=["vp 0.1 0.2", "cstype bspline", "deg 3", "curv 0 1 1 2 3", "end"]),
    # OFF
    "noff.off": text(["NOFF", f"{len(V)} {len(F)} 0", *rows(extra=" 0 0 1"), *faces()]),
    "cnoff.off": text(["CNOFF", f"{len(V)} {len(F)} 0", *rows(extra=" 0 0 1 0.1 0.2 0.3 1"), *faces()]),
    "stoff.off": text(["STOFF", f"{len(V)} {len(F)} 0", *rows(extra=" 0.5 0.5"), *faces()]),
    "face_colours.off": text(["OFF", f"{len(V)} {len(F)} 0", *rows(), *faces(after=" 255 0 0")]),
    "no_edges.off": text(["OFF", f"{len(V)} {len(F)}", *rows(), *faces()]),
    "bom.off": b"\xef\xbb\xbf" + off(),
    # 3MF
    "plain.3mf": mf3(),
    "no_unit.3mf": mf3(""),
    "metres.3mf": mf3('unit="meter" ', scale=1e-3),
    "microns.3mf": mf3('unit="micron" ', scale=1e3),
    "moved.3mf": mf3(transform=' transform="0 1 0 -1 0 0 0 0 1 90 80 70"'),
    "mirrored.3mf": mf3(transform=' transform="1 0 0 0 1 0 0 0 1 0 0 0"', f=F),
    "component.3mf": mf3(objects=_COMPONENT, build='<item objectid="2"/>'),
    "not_built.3mf": mf3(objects=_UNUSED),
    # GLB
    "y_up.glb": glb(Y_UP, F),
    "strip.glb": glb(Y_UP, strip_of_triangles(), mode=5),
    "node_scale.glb": glb(Y_UP * 1e3, F, extra={"nodes": [{"mesh": 0, "scale": [1e-3] * 3}]}),
    "nested.glb": glb(Y_UP, F, extra={"nodes": [{"children": [1], "translation": [1, 2, 3]}, {"mesh": 0}]}),
}  # fmt: skip
Y_IS_UP = ("y_up.glb", "strip.glb", "node_scale.glb", "nested.glb")
