"""Clouds of the second list: all are the points P of the first, or P far from the origin."""
# ruff: noqa: E501

import numpy as np
from mesh_dialects import TRI, XYZ, head, text
from second_list import glb
from test_cloud_dialects import C, N, P, S, pcd
from test_cloud_dialects import rows as table

_GRID = np.column_stack([np.arange(len(P)) // 60, np.arange(len(P)) % 60])


def grouped(value, group, point):
    """1.234,567 and its like."""
    return f"{value:,.3f}".replace(",", "\0").replace(".", point).replace("\0", group)


FAR = P + [2500.0, 1500.0, 4000.0]
"""Beyond a thousand, so that the groups of digits are parted."""


def grouped_rows(group, point, mark):
    return "\n".join(mark.join(grouped(c, group, point) for c in p) for p in FAR).encode() + b"\n"


CLOUDS = {
    "count_0_faces.ply": text(head("ascii", XYZ, TRI, n=len(P), m=0) + [" ".join(f"{c:g}" for c in p) for p in P]),
    "range_grid.ply": text(
        ["ply", "format ascii 1.0", "obj_info num_cols 50", f"element vertex {len(P)}", *(f"property {p}" for p in XYZ),
         f"element range_grid {len(P) + 2}", "property list uchar int vertex_indices", "end_header"]
        + [" ".join(f"{c:g}" for c in p) for p in P] + ["0", "0", *(f"1 {i}" for i in range(len(P)))]
    ),
    "wires.ply": text(
        ["ply", "format ascii 1.0", f"element vertex {len(P)}", *(f"property {p}" for p in XYZ),
         "element edge 1", "property int vertex1", "property int vertex2", "end_header"]
        + [" ".join(f"{c:g}" for c in p) for p in P] + ["0 1"]
    ),
    "zero_normals.ply": text(
        ["ply", "format ascii 1.0", f"element vertex {len(P)}", *(f"property {p}" for p in XYZ),
         *(f"property float n{a}" for a in "xyz"), "end_header"] + [" ".join(f"{c:g}" for c in p) + " 0 0 0" for p in P]
    ),
    "short_coordinates.ply": text(
        ["ply", "format binary_little_endian 1.0", "comment units: um", f"element vertex {len(P)}",
         *(f"property int {a}" for a in "xyz"), "end_header"]
    ) + np.rint(P * 1e3).astype("<i4").tobytes(),
    "points.obj": b"".join(b"v %s\n" % row for row in S.splitlines()),
    "points_normals.obj": "".join("v {:g} {:g} {:g}\nvn {:g} {:g} {:g}\n".format(*p, *n) for p, n in zip(P, N, strict=True)).encode(),
    "points.off": text(["OFF", f"{len(P)} 0 0"]) + S,
    "points.glb": glb(P[:, [0, 2, 1]] * [1, 1, -1] * 1e-3, mode=0),
    "normals_rgb.xyz": table(P, N, C),
    "normals_intensity_rgb.xyz": table(P, np.arange(len(P)) % 7, N, C),
    "long_normals.csv": b"x,y,z,nx,ny,nz\n" + table(P, N * 2.5, mark=","),
    "grid_first.txt": table(_GRID, P, np.arange(len(P)) % 97, C),
    "numbers_gaps.txt": table(1000 + 3 * np.arange(len(P)) + np.arange(len(P)) % 2, P),
    "numbers_from_500.txt": table(500 + np.arange(len(P)), P),
    "pandas.csv": b",x,y,z\n" + table(np.arange(len(P)), P, mark=","),
    "r_table.txt": b'"x" "y" "z"\n' + b"".join(b'"%d" %s\n' % (i + 1, r) for i, r in enumerate(S.splitlines())),
    "paraview.csv": b'"Normals:0","Normals:1","Normals:2","Points:0","Points:1","Points:2"\n' + table(N, P, mark=","),
    "paraview_59.csv": b'"scalar","Points_0","Points_1","Points_2"\n' + table(C[:, 0], P, mark=","),
    "labels_first.txt": b"".join(b"P%d %s\n" % (i, r) for i, r in enumerate(S.splitlines())),
    "labels_comma.csv": b"name,x,y,z\n" + b"".join(b"P%d,%s\n" % (i, r.replace(b" ", b",")) for i, r in enumerate(S.splitlines())),
    "times_first.csv": b"time,x,y,z\n" + b"".join(b"2024-05-01T10:%02d:%02d,%s\n" % (i // 60 % 60, i % 60, r.replace(b" ", b",")) for i, r in enumerate(S.splitlines())),
    "rechts_hoch.csv": "Punkt;Hochwert;Rechtswert;Höhe\n".encode() + table(np.arange(len(P)), P[:, 1], P[:, 0], P[:, 2], mark=";"),
    "est_nord.csv": b"Nord;Est;Quota\n" + table(P[:, 1], P[:, 0], P[:, 2], mark=";"),
    "northing_first.csv": b"Northing,Easting,Elev.\n" + table(P[:, 1], P[:, 0], P[:, 2], mark=","),
    "pixels_first.csv": b"x,y,X,Y,Z\n" + table(_GRID, P, mark=","),
    "x_mm.csv": b"x_mm,y_mm,z_mm,quality\n" + table(P, C[:, 0], mark=","),
    "german_colours.csv": "X;Y;Z;Rot;Grün;Blau;Intensität\n".encode() + table(P, C, C[:, 0], mark=";"),
    "spaced_names.csv": b"Point ID, X Coord, Y Coord, Z Coord, Normal X, Normal Y, Normal Z\n" + table(np.arange(len(P)), P, N, mark=","),
    "header_reversed.txt": b"# z y x\n" + table(P[:, ::-1]),
    "comment_between.xyz": S[: S.index(b"\n", 9000) + 1] + b"# second station\n\n// 12\n" + S[S.index(b"\n", 9000) + 1 :],
    "trailing_zeros.xyz": S + b"\0" * 700,
    "count_and_comment.xyz": b"3000\nmade by hand\n" + S,
    "tab_header.txt": b"X\tY\tZ\tIntensity\tScan ID\n" + table(P, C[:, :2], mark="\t"),
    "pipe.txt": S.replace(b" ", b"|"),
    "zero_one_intensity.xyz": table(P, np.round(C[:, 0] / 255, 3)),
    "version_5.pcd": b"COLUMNS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3000\nPOINTS 3000\nDATA ascii\n" + S,
    "version_6.pcd": b"# .PCD v.6\nVERSION .6\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 60\nHEIGHT 50\nPOINTS 3000\nDATA binary\n"
    + np.column_stack([P, np.full(len(P), np.nan)]).astype("<f4").tobytes(),
    "no_points.pcd": b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 50\nVIEWPOINT 0 0 0 1 0 0 0\nDATA ASCII\n" + S,
    "capital_fields.pcd": pcd("X Y Z", "4 4 4", "F F F", "1 1 1", S),
    "crlf.pcd": pcd("x y z", "4 4 4", "F F F", "1 1 1", S).replace(b"\n", b"\r\n"),
    "crlf_binary.pcd": pcd("x y z", "4 4 4", "F F F", "1 1 1", b"", "binary").replace(b"\n", b"\r\n") + P.astype("<f4").tobytes(),
    "viewpoint.pcd": pcd("x y z", "4 4 4", "F F F", "1 1 1", S).replace(b"0 0 0 1 0 0 0", b"1 2 3 0 1 0 0"),
    "named_xyz.xyz": b"VERSION 0.7\n" + pcd("x y z", "4 4 4", "F F F", "1 1 1", S).split(b"\n", 2)[2],
    "obj_named.xyz": b"# points\n" + b"".join(b"v %s\n" % row for row in S.splitlines()),
}  # fmt: skip
HAVE_NORMALS = {
    "points_normals.obj", "normals_rgb.xyz", "normals_intensity_rgb.xyz", "long_normals.csv", "paraview.csv",
    "spaced_names.csv",
}  # fmt: skip
GROUPED = {
    "german_groups.txt": grouped_rows(".", ",", " "),
    "german_groups.csv": grouped_rows(".", ",", ";"),
    "french_groups.txt": grouped_rows("\N{NO-BREAK SPACE}", ",", "\t"),
    "narrow_groups.csv": grouped_rows("\N{NARROW NO-BREAK SPACE}", ",", ";"),
    "english_groups.txt": grouped_rows(",", ".", " "),
    "swiss_groups.txt": grouped_rows("'", ".", " "),
}
"""All are FAR."""
