"""Bad input of every kind is answered with one line on stderr and status 2, and leaves nothing behind."""

import os
import struct
from itertools import pairwise
from pathlib import Path

import pytest
from typer.testing import CliRunner

from scanmotion.cli import app

TETRA = ((0, 0, 0), (100, 0, 0), (0, 100, 0), (0, 0, 100))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def ply(vertices, faces, *, n_vertices=None, n_faces=None):
    lines = [
        "ply", "format ascii 1.0", f"element vertex {len(vertices) if n_vertices is None else n_vertices}",
        "property float x", "property float y", "property float z",
        f"element face {len(faces) if n_faces is None else n_faces}",
        "property list uchar int vertex_indices",
        "end_header",
    ]  # fmt: skip
    lines += [" ".join(map(str, v)) for v in vertices] + [f"3 {' '.join(map(str, f))}" for f in faces]
    return "\n".join(lines) + "\n"


def scaled(factor):
    return [tuple(factor * c for c in v) for v in TETRA]


def obstacle(name, centre, size):
    return f"obstacles:\n  - {{name: {name!r}, centre_m: {list(centre)}, size_m: {list(size)}}}\n"


ROW = "v1,local,station,,700,0,0,800,0,1,0,0,0,0,0,0,"


def views(*rows):
    from scanmotion.export.viewpoints import HEADER

    return "\n".join([",".join(HEADER), *rows]) + "\n"


def poses(more='"note": ""', *, x="0", last="0,0,0,1"):
    return f'{{"scans": {{"good.ply": {{"T_object_scan": [1,0,0,{x},0,1,0,0,0,0,1,0,{last}], {more}}}}}}}'


FILES = {
    "empty.ply": b"",
    "text.ply": b"this is not a mesh\n",
    "header.ply": b"ply\nformat ascii 1.0\nelement vertex 3\n",
    "binary.ply": b"ply\nformat binary_little_endian 1.0\n" + bytes(range(256)),
    "billion.ply": ply(TETRA, FACES, n_faces=1_000_000_000),
    "vertices.ply": ply(TETRA, FACES, n_vertices=4_000_000_000),
    "negative.ply": ply(TETRA, FACES, n_faces=-4),
    "nan.ply": ply([*TETRA[:3], ("nan", 0, 0)], FACES),
    "inf.ply": ply([*TETRA[:3], ("inf", 0, 0)], FACES),
    "index.ply": ply(TETRA, [(0, 1, 9)]),
    "flat.ply": ply(TETRA, [(0, 0, 1), (1, 1, 2)]),
    "line.ply": ply([(i * 10, 0, 0) for i in range(4)], FACES),
    "point.ply": ply([(0, 0, 0)] * 4, FACES),
    "small.ply": ply(scaled(1e-3), FACES),
    "large.ply": ply(scaled(1e4), FACES),
    "wide.ply": ply(scaled(30), FACES),
    "tall.ply": ply([(0, 0, 0), (100, 0, 0), (0, 100, 0), (0, 0, 5000)], FACES),
    "good.ply": ply(TETRA, FACES),
    "short.stl": b"\0" * 50,
    "billion.stl": b"\0" * 80 + struct.pack("<I", 1_000_000_000) + b"\0" * 100,
    "text.stl": b"solid x\nfacet nonsense\nendsolid\n",
    "words.obj": b"v a b c\nf 1 2 3\n",
    "no_faces.obj": b"",
    "zero.obj": b"v 0 0 0\nv 100 0 0\nv 0 100 0\nf 0 1 2\n",
    "two.xyz": b"0 0 0\n1 1 1\n",
    "words.xyz": b"a b c\n" * 20,
    "text.pcd": b"# .PCD v0.7\nVERSION 0.7\nFIELDS q\n",
    "part.step": b"ISO-10303-21;",
    "part": b"x",
    "empty.yaml": b"",
    "list.yaml": b"- 1\n- 2\n",
    "tabs.yaml": b"a:\n\t- b: [\n",
    "tag.yaml": b"!!python/object/apply:os.system ['echo hacked']\n",
    "latin.yaml": b"name: \xff\xfe\xfa\n",
    "key.yaml": b"scanner:\n  standof: 0.7\n",
    "section.yaml": b"robbot: {}\n",
    "unit.yaml": b"process:\n  standoff_m: 700\n",
    "word.yaml": b"process:\n  standoff_m: 0.7 m\n",
    "nan.yaml": b"process:\n  standoff_m: .nan\n",
    "inf.yaml": b"turntable:\n  speed_rpm: .inf\n",
    "bool.yaml": b"process:\n  fps: true\n",
    "count.yaml": b"scanner:\n  field_deg: [30.0]\n",
    "negative.yaml": b"turntable:\n  acceleration_rad_s2: -1\n",
    "robot.yaml": b"robot:\n  model: r2d2\n",
    "path.yaml": b"robot:\n  model: ../../../etc/passwd\n",
    "home.yaml": b"robot:\n  home_deg: [0, 0, 0]\n",
    "limits.yaml": b"robot:\n  home_deg: [0, 500, 0, 0, 0, 0]\n",
    "own.yaml": b"robot:\n  model: bomb.urdf\n  acceleration: [1, 1, 1, 1, 1, 1]\n",
    "far.yaml": b"turntable:\n  position_m: [50.0, 0.0]\n",
    "bomb.urdf": b'<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>',
    "null.yaml": b"process: null\n",
    "bad.csv": b"not,viewpoints\n1,2\n",
    "bad.json": b"{",
    "empty.json": b'{"scans": {}}',
    "sheared.json": b'{"scans": {"good.ply": {"T_object_scan": [2,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}}',
    "a_file": b"x",
    # obstacles
    "through.yaml": obstacle("wall", (2.2, 0.0, 1.0), (1.0, 1.0, 1.0)),
    "beside.yaml": obstacle("wall", (2.2, 0.8, 1.0), (0.1, 0.1, 1.0)),
    "robot_in_wall.yaml": obstacle("wall", (0.0, 0.0, 1.0), (1.0, 1.0, 2.0)),
    "floor.yaml": obstacle("floor", (0.5, 0.0, 1.0), (1.0, 1.0, 1.0)),
    "markup.yaml": obstacle("<x>", (5.0, 0.0, 1.0), (1.0, 1.0, 1.0)),
    "flat_wall.yaml": obstacle("wall", (5.0, 0.0, 1.0), (1.0, 0.0, 1.0)),
    "twice.yaml": obstacle("a", (5.0, 0.0, 1.0), (1.0, 1.0, 1.0)) * 2,
    "same_name.yaml": obstacle("a", (5.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    + obstacle("a", (6.0, 0.0, 1.0), (1.0, 1.0, 1.0)).removeprefix("obstacles:\n"),
    "crowd.yaml": "obstacles:\n"
    + "".join(f"  - {{name: o{i}, centre_m: [5, {i}, 1], size_m: [1, 1, 1]}}\n" for i in range(201)),
    # more of YAML
    "key_twice.yaml": "process:\n  fps: 10\n  fps: 20\n",
    "two.yaml": "process: {}\n---\nprocess: {}\n",
    "date.yaml": "process:\n  fps: 2024-01-01\n",
    "utf16.yaml": "process: {}\n".encode("utf-16"),
    "number_key.yaml": "1: 2\n",
    "deep.yaml": "[" * 5_000,
    "laughs.yaml": "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in pairwise("abcdefgh")),
    "range.yaml": "scanner:\n  range_m: [1.0, 0.4]\n",
    "half_turn.yaml": "turntable:\n  range_deg: [0, 180]\n",
    "rays.yaml": "scanner:\n  rays: [100000, 100000]\n",
    "five.yaml": "robot:\n  acceleration: [1, 2, 3, 4, 5]\n",
    "heavy.yaml": "robot:\n  acceleration: heavy\n",
    "joints.yaml": "robot:\n  joints: [A1, A1, A2, A3, A4, A5]\n",
    "flange.yaml": "robot:\n  flange: nowhere\n",
    # viewpoints
    "none.csv": views(),
    "good.csv": views(ROW),
    "nan.csv": views(ROW.replace("700", "nan")),
    "behind.csv": views(ROW.replace("700", "-700")),
    "beyond.csv": views(ROW.replace("800", "8e300")),
    "quaternion.csv": views(ROW.replace("0,1,0,0", "0,0,0,0")),
    "double.csv": views(ROW, ROW),
    "kind.csv": views(ROW.replace("station", "statoin")),
    "short.csv": views("v1,local"),
    "formula.csv": views(ROW + "=cmd"),
    "quote.csv": views('"v1'),
    "deep.json": '{"version":1,"viewpoints":' + "[" * 50_000,
    "list.json": "[]",
    "version.json": '{"version":2,"viewpoints":[]}',
    # poses
    "direction2.json": poses('"nominal_view_direction": [0, 0]'),
    "direction_word.json": poses('"nominal_view_direction": ["a", 0, 0]'),
    "direction0.json": poses('"nominal_view_direction": [0, 0, 0]'),
    "last_row.json": poses(last="5,0,0,1"),
    "far.json": poses(x="1e308"),
    "deep_poses.json": '{"scans":' + "[" * 50_000,
    "list_poses.json": "[1]",
    # more of meshes and clouds
    "no_faces.ply": ply(TETRA, ()),
    "before.ply": ply(TETRA, [(0, 1, -2), (0, 2, 1), (1, 2, 3)]),
    "denormal.ply": ply(scaled(1e-310), FACES),
    "comments.ply": "ply\nformat ascii 1.0\n" + "comment x\n" * 20_000,
    "zip.ply": b"PK\x03\x04" + b"\0" * 100,
    "back.obj": "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf -1 -2 -9\n",
    "nan.stl": b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", *[float("nan")] * 12, 0),
    "nan.xyz": "nan 0 0\n" * 50,
    "same.xyz": "1 2 3\n" * 200,
    "row.xyz": "".join(f"{i} 0 0\n" for i in range(200)),
    "claims.pcd": "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    "WIDTH 4000000000\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4000000000\nDATA binary\n",
}
"""What each file of the folder that the cases run in holds."""

PIPES = (
    ("plan --part", ".ply"), ("plan --scan", ".xyz"), ("plan --cell", ".yaml"),
    ("reach --viewpoints", ".csv"), ("holes", ".stl"), ("fuse good.ply --out fused.ply --poses", ".json"),
    ("fuse --out fused.ply", ".ply"),
)  # fmt: skip
CELLS = (
    "robot_in_wall", "floor", "markup", "flat_wall", "twice", "same_name", "crowd", "key_twice", "two",
    "date", "utf16", "number_key", "deep", "laughs", "range", "half_turn", "rays", "five", "heavy", "joints",
    "flange",
)  # fmt: skip
VIEWS = (
    "none.csv", "nan.csv", "behind.csv", "beyond.csv", "quaternion.csv", "double.csv", "kind.csv",
    "short.csv", "formula.csv", "quote.csv", "deep.json", "list.json", "version.json",
)  # fmt: skip
POSES = (
    "direction2", "direction_word", "direction0", "last_row", "far", "deep_poses", "list_poses",
)  # fmt: skip
MESHES = (
    "no_faces.ply",
    "list.ply",
    "before.ply",
    "denormal.ply",
    "comments.ply",
    "zip.ply",
    "back.obj",
    "nan.stl",
)
CLOUDS = ("nan.xyz", "same.xyz", "row.xyz", "claims.pcd")
CASES = {
    # the command line itself
    "unknown command": "plam",
    "unknown option": "plan --robott kr240",
    "option without value": "plan --part",
    "word for a number": "plan --seed seven",
    "negative seed": "plan --seed -1",
    "fraction as seed": "plan --seed 1.5",
    "extra argument": "plan good.ply",
    "two sides of a box": "plan --box 600 330",
    "unknown mode": "plan --mode fast --part good.ply",
    "unknown strategy": "plan --strategy magic",
    "unknown robot": "plan --robot kr9000",
    "robot and cell": "plan --robot kr240 --cell empty.yaml",
    "part and box": "plan --part good.ply --box 600 330 200",
    "part and scan": "plan --part good.ply --scan good.ply",
    "zero budget": "plan --budget 0",
    "negative budget": "plan --budget -3",
    "nan budget": "plan --budget nan",
    "endless budget": "plan --budget inf",
    "out is a file": "plan --out a_file",
    "out below a file": "plan --out a_file/out",
    "out holds something else": "plan --out .",
    # the part
    "no such part": "plan --part nowhere.ply",
    "a folder as part": "plan --part .",
    "no suffix": "plan --part part",
    "CAD file": "plan --part part.step",
    "empty file": "plan --part empty.ply",
    "text as PLY": "plan --part text.ply",
    "header without end": "plan --part header.ply",
    "broken binary PLY": "plan --part binary.ply",
    "a billion triangles claimed": "plan --part billion.ply",
    "four billion vertices claimed": "plan --part vertices.ply",
    "negative count": "plan --part negative.ply",
    "nan vertex": "plan --part nan.ply",
    "infinite vertex": "plan --part inf.ply",
    "face without vertex": "plan --part index.ply",
    "no area": "plan --part flat.ply",
    "all on a line": "plan --part line.ply",
    "all in a point": "plan --part point.ply",
    "too small for mm": "plan --part small.ply",
    "too large for mm": "plan --part large.ply",
    "wider than the table": "plan --part wide.ply",
    "taller than the cell": "plan --part tall.ply",
    "metres for millimetres": "plan --part good.ply --units m",
    "unknown unit": "plan --part good.ply --units furlong",
    "unknown up": "plan --part good.ply --up north",
    "unknown place": "plan --part good.ply --place corner",
    "short STL": "plan --part short.stl",
    "a billion triangles in STL": "plan --part billion.stl",
    "nonsense in STL": "plan --part text.stl",
    "words in OBJ": "plan --part words.obj",
    "empty OBJ": "plan --part no_faces.obj",
    "index zero in OBJ": "plan --part zero.obj",
    "cloud as part": "plan --part two.xyz",
    "two points": "plan --scan two.xyz",
    "words in XYZ": "plan --scan words.xyz",
    "PCD without points": "plan --scan text.pcd",
    "flat box": "plan --box 600 330 0",
    "negative box": "plan --box 600 -330 200",
    "nan box": "plan --box nan 330 200",
    "endless box": "plan --box inf 330 200",
    "box wider than the table": "plan --box 6000 330 200",
    # the cell
    "no such cell": "plan --cell nowhere.yaml",
    "empty cell": "plan --cell empty.yaml",
    "list as cell": "plan --cell list.yaml",
    "not YAML": "plan --cell tabs.yaml",
    "YAML that wants to run code": "plan --cell tag.yaml",
    "not UTF-8": "plan --cell latin.yaml",
    "unknown key": "plan --cell key.yaml",
    "unknown section": "plan --cell section.yaml",
    "millimetres for metres": "plan --cell unit.yaml",
    "number with its unit": "plan --cell word.yaml",
    "nan setting": "plan --cell nan.yaml",
    "infinite setting": "plan --cell inf.yaml",
    "bool for a number": "plan --cell bool.yaml",
    "one value for two": "plan --cell count.yaml",
    "negative acceleration": "plan --cell negative.yaml",
    "section without settings": "plan --cell null.yaml",
    "unknown robot model": "cell check robot.yaml",
    "model outside the folder": "cell check path.yaml",
    "three values of home": "cell check home.yaml",
    "home outside the limits": "cell check limits.yaml",
    "XML with entities": "cell check own.yaml",
    "table out of reach": "cell check far.yaml",
    "check of nothing": "cell check nowhere.yaml",
    "init over a file": "cell init a_file",
    "init in no folder": "cell init nowhere/cell.yaml",
    "init of an unknown robot": "cell init new.yaml --robot r2d2",
    # plans and single stages
    "verify nothing": "verify nowhere",
    "verify a file": "verify a_file",
    "verify no plan": "verify .",
    "show nothing": "show nowhere --no-browser",
    "export nothing": "export nowhere --to csv",
    "export without a target": "export nowhere",
    "holes of nothing": "holes nowhere.ply",
    "holes in an unknown mode": "holes good.ply --mode wild",
    "viewpoints of nothing": "viewpoints",
    "viewpoints of two things": "viewpoints --box 1 2 3 --part good.ply",
    "viewpoints into a strange file": "viewpoints --box 300 300 300 --out views.txt",
    "viewpoints of a flat box": "viewpoints --box 300 300 0",
    "reach of nothing": "reach",
    "reach of bad CSV": "reach --viewpoints bad.csv",
    "reach of bad JSON": "reach --viewpoints bad.json",
    "reach of no file": "reach --viewpoints nowhere.csv",
    "fuse nothing": "fuse --out fused.ply",
    "fuse a missing scan": "fuse nowhere.ply --out fused.ply",
    "fuse with bad poses": "fuse good.ply --poses bad.json --out fused.ply",
    "fuse with empty poses": "fuse good.ply --poses empty.json --out fused.ply",
    "fuse with sheared poses": "fuse good.ply --poses sheared.json --out fused.ply",
    "fuse into a strange file": "fuse good.ply --out fused.step",
    "fuse with no voxels": "fuse good.ply --out fused.ply --voxel 0",
    "compare an unknown variant": "compare --variant magic",
    "compare with no seed": "compare --seeds 0",
    "compare with no variant": "compare --variants ,",
    "compare into no folder": "compare --out nowhere/table.md",
    "compare into a strange file": "compare --out table.txt",
    # where options contradict one another, or what they need is missing
    "unit of a box": "plan --box 600 330 200 --units m",
    "up of the carving": "plan --up +y",
    "place of the carving": "plan --place keep",
    "done of nothing": "plan --done L1",
    "failed of nothing": "plan --failed L1",
    "keep nothing": "plan --keep nowhere",
    "keep no plan": "plan --keep .",
    "keep and part": "plan --keep nowhere --part good.ply",
    "helix without a twin": "plan --box 100 100 100 --helix",
    "tiny box": "plan --box 1e-9 1 1",
    "box beyond numbers": "plan --box 1e308 1e308 1e308",
    "out is a device": "plan --out /dev/null",
    "out below a device": "plan --out /dev/null/x",
    "map into a strange file": "reach --box 100 100 100 --map map.jpg",
    "map into no folder": "reach --box 100 100 100 --map nowhere/map.png",
    "holes into no folder": "holes good.ply --out nowhere/holes.json",
    "holes into a strange file": "holes good.ply --out holes.txt",
    "holes of a folder": "holes .",
    "viewpoints into no folder": "viewpoints --box 100 100 100 --out nowhere/v.csv",
    "fuse into no folder": "fuse good.ply --out nowhere/fused.ply",
    "fuse an empty folder": "fuse hollow --out fused.ply",
    "fuse without its poses": "fuse good.ply --poses nowhere.json --out fused.ply",
    "nothing left to fuse": "fuse good.ply --out fused.ply",
    "voxels of no number": "fuse good.ply --out fused.ply --voxel nan",
    "verify a folder without a plan": "verify hollow",
    "show a folder live without a plan": "show hollow --live --no-browser",
    # what is no plain file
    **{f"pipe as {a.split()[-1]}": f"{a} pipe{b}" for a, b in PIPES},
    **{f"endless device as {a.split()[-1]}": f"{a} device{b}" for a, b in PIPES},
    "a link in a circle": "plan --part circle.ply",
    "a link to nothing": "plan --part dangling.ply",
    # cells, viewpoints, poses, meshes
    **{f"cell {n}": f"cell check {n}.yaml" for n in CELLS},
    "cell through": "plan --part good.ply --cell through.yaml",
    "cell beside": "plan --box 1500 100 900 --cell beside.yaml",
    **{f"viewpoints {n}": f"reach --viewpoints {n}" for n in VIEWS},
    **{f"poses {n}": f"fuse good.ply --out fused.ply --poses {n}.json" for n in POSES},
    **{f"mesh {n}": f"plan --part {n}" for n in MESHES},
    **{f"cloud {n}": f"plan --scan {n}" for n in CLOUDS},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    for name, content in FILES.items():
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    (folder / "hollow").mkdir()
    (folder / "circle.ply").symlink_to("circle.ply")
    (folder / "dangling.ply").symlink_to("nowhere.ply")
    for _, suffix in dict.fromkeys(PIPES):
        if not (folder / f"pipe{suffix}").exists():
            os.mkfifo(folder / f"pipe{suffix}")
            (folder / f"device{suffix}").symlink_to("/dev/zero")
    return folder


def test_the_list_is_long_enough():
    assert len(CASES) >= 200


@pytest.mark.parametrize("name", CASES)
def test_one_line_status_2_and_nothing_written(name, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    before = {p: p.lstat().st_mtime_ns for p in Path(".").rglob("*")}
    result = CliRunner().invoke(app, CASES[name].split())
    said = result.stderr + capfd.readouterr().err
    assert result.exit_code == 2, f"{result.exit_code}: {result.output}"
    assert said.startswith("scanmotion: "), said
    assert said.count("\n") == 1, said
    assert "Traceback" not in said
    assert result.stdout == ""
    assert {p: p.lstat().st_mtime_ns for p in Path(".").rglob("*")} == before


@pytest.mark.parametrize(
    "command, word",
    [
        ("plan --cell key.yaml", "scanner.standof"),
        ("plan --cell unit.yaml", "process.standoff_m"),
        ("plan --cell nan.yaml", "process.standoff_m"),
        ("plan --cell count.yaml", "scanner.field_deg"),
        ("plan --part small.ply", "--units"),
        ("plan --part wide.ply", "760 mm"),
        ("plan --robot kr9000", "kr240"),
        ("plan --cell nowhere.yaml", "cell init"),
        ("plan --out .", "not a plan"),
        ("plam", "Did you mean 'plan'"),
    ],
)
def test_the_line_names_the_evidence(command, word, folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert word in CliRunner().invoke(app, command.split()).stderr
