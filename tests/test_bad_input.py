"""Bad input of every kind is answered with one line on stderr and status 2, and leaves nothing behind."""

import struct
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
}
"""What each file of the folder that the cases run in holds."""

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
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    for name, content in FILES.items():
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder


def test_the_list_is_long_enough():
    assert len(CASES) >= 60


@pytest.mark.parametrize("name", CASES)
def test_one_line_status_2_and_nothing_written(name, folder, monkeypatch, capfd):
    monkeypatch.chdir(folder)
    before = {p: p.stat().st_mtime_ns for p in Path(".").rglob("*")}
    result = CliRunner().invoke(app, CASES[name].split())
    said = result.stderr + capfd.readouterr().err
    assert result.exit_code == 2, f"{result.exit_code}: {result.output}"
    assert said.startswith("scanmotion: "), said
    assert said.count("\n") == 1, said
    assert "Traceback" not in said
    assert result.stdout == ""
    assert {p: p.stat().st_mtime_ns for p in Path(".").rglob("*")} == before


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
