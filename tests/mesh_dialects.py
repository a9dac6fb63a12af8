"""One closed mesh written in the many ways in which programs write PLY, STL, OBJ and OFF.

Each layout is one that was reported to MeshLab, CloudCompare, Open3D, trimesh, PCL, assimp or Blender as not
read, or read wrongly.
"""

import struct

import numpy as np
from scans import bumpy

_LUMP = bumpy(8, size=0.05)
V = np.round(_LUMP.vertices * 1e3, 4)
F = _LUMP.triangles
VERTICES, FACES = len(V), len(F)
QUADS = [tuple(int(i) for i in f) for f in F]


def head(kind, vertex, face, *, n=VERTICES, m=FACES, more=(), between=()):
    lines = ["ply", f"format {kind} 1.0", *more, f"element vertex {n}", *(f"property {p}" for p in vertex)]
    return [*lines, *between, f"element face {m}", *(f"property {p}" for p in face), "end_header"]


XYZ = ("float x", "float y", "float z")
TRI = ("list uchar int vertex_indices",)


def text(lines, end="\n"):
    return (end.join(lines) + end).encode("latin-1")


def rows(points=V, extra=""):
    return [" ".join(f"{c:.4f}" for c in p) + extra for p in points]


def faces(before="", after="", f=F):
    return [f"{before}{len(t)} {' '.join(map(str, t))}{after}" for t in f]


def ascii_ply(vertex=XYZ, face=TRI, *, extra="", before="", after="", end="\n", **more):
    return text([*head("ascii", vertex, face, **more), *rows(extra=extra), *faces(before, after)], end)


def binary_ply(vertex=XYZ, face=TRI, *, order="<", place="f4", pack=None, end="\n", tail=b"", **more):
    kind = "binary_little_endian" if order == "<" else "binary_big_endian"
    pack = pack or (lambda t: struct.pack(order + "B3i", 3, *t))
    body = V.astype(order + place).tobytes() + b"".join(pack(t) for t in F)
    return text(head(kind, vertex, face, **more), end) + body + tail


def mixed_ply(order):
    """Two triangles that share an edge are written as a quad."""
    first = F[0]
    other = next(k for k in range(1, FACES) if len(set(F[k]) & set(first)) == 2)
    second = F[other]
    shared = [i for i in first if i in second]
    a = next(i for i in first if i not in shared)
    b = next(i for i in second if i not in shared)
    at = list(first).index(a)
    quad = [a, first[(at + 1) % 3], b, first[(at + 2) % 3]]
    body = V.astype(order + "f4").tobytes() + struct.pack(order + "B4i", 4, *quad)
    body += b"".join(struct.pack(order + "B3i", 3, *t) for k, t in enumerate(F) if k not in (0, other))
    kind = "binary_little_endian" if order == "<" else "binary_big_endian"
    return text(head(kind, XYZ, TRI, m=len(F) - 1)) + body


def strips():
    strip = [str(i) for t in F for i in (*t, -1)]
    lines = head("ascii", XYZ, TRI)[:6] + [
        "element tristrips 1",
        "property list int int vertex_indices",
        "end_header",
    ]
    return text([*lines, *rows(), f"{len(strip)} {' '.join(strip)}"])


def facets(form="{:.4f} {:.4f} {:.4f}", *, normal="facet normal 0 0 0", name="part", indent="  ", f=F):
    out = [f"solid {name}"]
    for t in f:
        out += [normal, f"{indent}outer loop", *(f"{indent}vertex {form.format(*V[i])}" for i in t)]
        out += [f"{indent}endloop", "endfacet"]
    return [*out, f"endsolid {name}"]


def binary_stl(count=None, header=b"", attribute=0, tail=b"", f=F):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *V[t].ravel(), attribute) for t in f)
    return header.ljust(80, b" ") + struct.pack("<I", len(f) if count is None else count) + body + tail


def obj(vertex="v {:.4f} {:.4f} {:.4f}", face="f {} {} {}", *, more=(), end="\n", shift=1):
    lines = [vertex.format(*p) for p in V] + [face.format(*(i + shift for i in t)) for t in F]
    return text([*more, *lines], end)


def off(first="OFF", *, colour="", comment=()):
    return text([first, *comment, f"{len(V)} {len(F)} 0", *rows(extra=colour), *faces()])


FLAG, QUALITY = "uchar flag", "float quality"
MESHES = {
    # PLY
    "big_endian.ply": binary_ply(order=">"),
    "double.ply": binary_ply(("double x", "double y", "double z"), place="f8"),
    "uint_list.ply": binary_ply(face=("list uint8 uint32 vertex_index",)),
    "int_counts.ply": binary_ply(
        face=("list int int vertex_indices",), pack=lambda t: struct.pack("<4i", 3, *t)
    ),
    "short_indices.ply": binary_ply(
        face=("list uchar ushort vertex_indices",), pack=lambda t: struct.pack("<B3H", 3, *t)
    ),
    "flag_first.ply": binary_ply(face=(FLAG, *TRI), pack=lambda t: struct.pack("<BB3i", 7, 3, *t)),
    "colours_behind.ply": binary_ply(
        face=(*TRI, "uchar red", "uchar green", "uchar blue"),
        pack=lambda t: struct.pack("<B3i3B", 3, *t, 1, 2, 3),
    ),
    "texture_list.ply": binary_ply(
        face=(*TRI, "list uchar float texcoord"), pack=lambda t: struct.pack("<B3iB6f", 3, *t, 6, *[0.5] * 6)
    ),
    "texture_list_first.ply": binary_ply(
        face=("list uchar float texcoord", *TRI), pack=lambda t: struct.pack("<B6fB3i", 6, *[0.5] * 6, 3, *t)
    ),
    "uneven_textures.ply": binary_ply(
        face=("list uchar float texcoord", *TRI),
        pack=lambda t: struct.pack("<BB3i", 0, 3, *t) if t[0] % 2 else struct.pack("<B2fB3i", 2, 0, 0, 3, *t),
    ),
    "mixed.ply": mixed_ply("<"),
    "mixed_big.ply": mixed_ply(">"),
    "cr_binary.ply": binary_ply(end="\r"),
    "crlf_binary.ply": binary_ply(end="\r\n"),
    "trailing.ply": binary_ply(tail=b"\0" * 17),
    "edges.ply": text(
        head("ascii", XYZ, TRI)[:-1]
        + ["element edge 1", "property int vertex1", "property int vertex2", "end_header"]
        + rows()
        + faces()
        + ["0 1"]
    ),
    "camera_first.ply": text(
        ["ply", "format ascii 1.0", "element camera 1", "property float view_px", "property float fov"]
        + head("ascii", XYZ, TRI)[2:]
        + ["1.5 2.5"]
        + rows()
        + faces()
    ),
    "ascii_colours.ply": ascii_ply((*XYZ, "uchar red", "uchar green", "uchar blue"), extra=" 1 2 3"),
    "ascii_quality.ply": ascii_ply((*XYZ, QUALITY), (*TRI, QUALITY), extra=" 0.5", after=" 0.25"),
    "ascii_flag_first.ply": ascii_ply(face=(FLAG, *TRI), before="9 "),
    "ascii_texture_first.ply": ascii_ply(face=("list uchar float texcoord", *TRI), before="2 0.5 0.5 "),
    "ascii_crlf.ply": ascii_ply(end="\r\n"),
    "ascii_tabs.ply": ascii_ply().replace(b" ", b" \t ").replace(b"\nelement", b"\n\nelement"),
    "ascii_bom.ply": b"\xef\xbb\xbf" + ascii_ply(),
    "ascii_utf8.ply": ascii_ply(more=("comment Skulptur K\xf6nig",)),
    "ascii_blank.ply": ascii_ply() + b"\n\n  \n",
    "strips.ply": strips(),
    "capitals.ply": ascii_ply().replace(b" x\n", b" X\n").replace(b" y\n", b" Y\n").replace(b" z\n", b" Z\n"),
    # STL
    "solid_binary.stl": binary_stl(header=b"solid made by a program"),
    "count_0.stl": binary_stl(count=0),
    "count_max.stl": binary_stl(count=0xFFFFFFFF),
    "attributes.stl": binary_stl(attribute=0x7FFF, header=b"COLOR=\xff\xff\xff\xff"),
    "trailing.stl": binary_stl(tail=b"\0" * 33),
    "two_binary.stl": binary_stl(f=F[:20]) + binary_stl(f=F[20:]),
    "ascii.stl": text(facets()),
    "ascii_capital.stl": text(facets()).upper(),
    "ascii_crlf.stl": text(facets(), "\r\n"),
    "ascii_cr.stl": text(facets(), "\r"),
    "ascii_flush.stl": text(facets(indent="")),
    "ascii_tabs.stl": text(facets(indent="\t")).replace(b" ", b"\t"),
    "ascii_exponent.stl": text(facets("{:.6e} {:.6e} {:.6e}"))
    .replace(b"e+0", b"e+00")
    .replace(b"e-0", b"e-00"),
    "ascii_name.stl": text(facets(name="vertex facet loop")),
    "ascii_two.stl": text(facets(f=F[:20]) + facets(f=F[20:], name="b")),
    "ascii_no_end.stl": text(facets()[:-1]),
    "ascii_comma.stl": text(facets()).replace(b".", b","),
    "ascii_latin.stl": text(facets(name="K\xf6nig")),
    "ascii_words.stl": text(facets(normal="facet")),
    # OBJ
    "plain.obj": obj(),
    "normals.obj": obj(face="f {0}//{0} {1}//{1} {2}//{2}", more=["vn 0 0 1"]),
    "textures.obj": obj(face="f {0}/1 {1}/1 {2}/1", more=["vt 0.5 0.5"]),
    "all.obj": obj(face="f {0}/1/1 {1}/1/1 {2}/1/1", more=["vt 0 0", "vn 0 0 1"]),
    "back.obj": obj(shift=-len(V)),
    "back_all.obj": obj(face="f {0}/-1/-1 {1}/-1/-1 {2}/-1/-1", shift=-len(V)),
    "colours.obj": obj("v {:.4f} {:.4f} {:.4f} 0.1 0.5 1"),
    "weights.obj": obj("v {:.4f} {:.4f} {:.4f} 1.0"),
    "groups.obj": obj(more=["mtllib a.mtl", "o part", "g a b", "s off", "usemtl x"]),
    "indented.obj": obj("  v  {:.4f}  {:.4f}  {:.4f} ", "\tf {} {} {}  "),
    "crlf.obj": obj(end="\r\n"),
    "cr.obj": obj(end="\r"),
    "comments.obj": obj("v {:.4f} {:.4f} {:.4f} # 1", "f {} {} {} # 2"),
    "lines.obj": obj() + b"l 1 2 3\np 4\n",
    "faces_first.obj": text(
        [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in F] + [f"v {p[0]} {p[1]} {p[2]}" for p in V]
    ),
    "utf16.obj": b"\xff\xfe" + obj().decode().encode("utf-16-le"),
    "no_end.obj": obj().rstrip(b"\n"),
    # OFF
    "plain.off": off(),
    "colours.off": off("COFF", colour=" 10 20 30 255"),
    "comment.off": off(comment=["# a comment", ""]),
    "one_line.off": off().replace(b"OFF\n", b"OFF "),
    "crlf.off": off().replace(b"\n", b"\r\n"),
}
"""Name and content; all are the lump, closed."""
