"""Damaged part, cell and plan files end in a value or in one line, never in a traceback."""

import copy
import io
import json
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from fake_plan import fake_plan
from judged_plan import hand_made_files

from scanmotion.cell.settings.cell import cell_template, load_cell
from scanmotion.core.errors import CellError, InputError, PartError
from scanmotion.core.part import Part
from scanmotion.export import export_files
from scanmotion.geometry.parts.make_part import part_from_file
from scanmotion.plan_io.load import load_plan

V = 100.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]])
TOKENS = (
    b"nan",
    b"-1",
    b"1e308",
    b"inf",
    b"0",
    b"4294967295",
    b"99999999999999999999",
    b"",
    b"\n",
    b"\x00",
    b"end_header",
    b"element vertex 1000000000",
    b"property list uchar int x",
    b"property float x",
    b"format ascii 1.0",
    b"\xff\xfe",
    b"f 1 2 3",
    b"f 1//1 2//2 -9",
    b"v",
    b"solid",
    b"POINTS 7",
    b"DATA binary",
    b"{",
    b"- [",
    b"!!python/name:os.system",
    b": ",
    b"&a [*a]",
    b"true",
    b"null",
    b"1 2",
    b"1.5.2",
)


def ply(binary: bool) -> bytes:
    kind = "binary_little_endian" if binary else "ascii"
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex {len(V)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(F)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if binary:
        return head + V.astype("<f4").tobytes() + b"".join(struct.pack("<B3i", 3, *f) for f in F)
    rows = [" ".join(map(str, v)) for v in V] + [f"3 {a} {b} {c}" for a, b, c in F]
    return head + "\n".join(rows).encode() + b"\n"


def stl(binary: bool) -> bytes:
    if binary:
        rows = [struct.pack("<12fH", 0, 0, 1, *V[f].ravel(), 0) for f in F]
        return b"\0" * 80 + struct.pack("<I", len(F)) + b"".join(rows)
    text = ["solid s"]
    for f in F:
        corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in V[f])
        text.append(f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet")
    return "\n".join([*text, "endsolid s\n"]).encode()


def lines(rows, form: str) -> bytes:
    return "\n".join(form.format(*row) for row in rows).encode() + b"\n"


PCD = (
    b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 1\n"
    b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 5\nDATA "
)
SEEDS = {
    "a.ply": ply(False),
    "b.ply": ply(True),
    "a.stl": stl(False),
    "b.stl": stl(True),
    "a.obj": lines(V, "v {} {} {}") + lines(F + 1, "f {} {} {}"),
    "a.xyz": lines(V, "{} {} {}"),
    "a.pcd": PCD + b"ascii\n" + lines(V, "{} {} {}"),
    "b.pcd": PCD + b"binary\n" + V.astype("<f4").tobytes(),
}


def damaged(seed: bytes, rng: np.random.Generator) -> bytes:
    """One to four wounds: a flipped byte, a cut, a repeated or lost stretch, a foreign token."""
    data = bytearray(seed)
    for _ in range(rng.integers(1, 5)):
        if not data:
            break
        at, size = int(rng.integers(len(data))), int(rng.integers(1, 12))
        match rng.integers(6):
            case 0:
                data[at] = int(rng.integers(256))
            case 1:
                del data[at:]
            case 2:
                del data[at : at + size]
            case 3:
                data[at:at] = data[at : at + 4 * size]
            case 4:
                data[at : at + size] = TOKENS[int(rng.integers(len(TOKENS)))]
            case _:
                line = data.find(b"\n", at) + 1
                data[line:line] = TOKENS[int(rng.integers(len(TOKENS)))] + b"\n"
    return bytes(data)


def one_line(error: Exception) -> None:
    text = str(error)
    assert text and "\n" not in text and len(text) < 600, text


def fuzz_parts(folder: Path, number: int, seed: int) -> int:
    """Loads `number` damaged parts; returns how many were still usable."""
    rng, good, names = np.random.default_rng(seed), 0, list(SEEDS)
    for i in range(number):
        name = names[i % len(names)]
        file = folder / name
        file.write_bytes(damaged(SEEDS[name], rng))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                part = part_from_file(file)
        except PartError as error:
            one_line(error)
        else:
            good += 1
            assert isinstance(part, Part) and np.isfinite(part.vertices).all()
            assert len(part.triangles) == 0 or part.triangles.max() < len(part.vertices)
    return good


def fuzz_cells(folder: Path, number: int, seed: int) -> int:
    """Loads `number` damaged cells; returns how many were still usable."""
    rng, good, template = np.random.default_rng(seed), 0, cell_template().encode()
    file = folder / "cell.yaml"
    for _ in range(number):
        file.write_bytes(damaged(template, rng))
        try:
            settings = load_cell(file)
        except CellError as error:
            one_line(error)
        else:
            good += 1
            assert 0.1 <= settings.process.standoff_m <= 5.0
    return good


JUNK = (
    None, True, -1, 0, 1e308, 1e-300, 12345678901234567890, "", "x" * 50, "\0", "../x", "<b>", [], {}, [1, 2],
    {"a": 1}, "nan",
)  # fmt: skip


def changed_json(text: str, rng: np.random.Generator) -> bytes:
    """JSON with one to three entries removed, doubled, added or replaced, anywhere in the tree."""
    data = json.loads(text)
    for _ in range(rng.integers(1, 4)):
        node, at = data, None
        while isinstance(node, dict | list) and node and (at is None or rng.random() < 0.7):
            keys = list(node) if isinstance(node, dict) else range(len(node))
            at = (node, keys[int(rng.integers(len(keys)))])
            node = node[at[1]]
        if at is None:
            break
        where, key = at
        match rng.integers(4):
            case 0:
                del where[key]
            case 1 if isinstance(where, list):
                where.append(copy.deepcopy(where[key]))
            case 1:
                where["another"] = 1
            case _:
                where[key] = copy.deepcopy(JUNK[int(rng.integers(len(JUNK)))])
    return json.dumps(data).encode()


def changed_arrays(data: bytes, rng: np.random.Generator) -> bytes:
    """Arrays of which one is missing, shorter, of another shape or kind, or pickled."""
    with np.load(io.BytesIO(data)) as found:
        arrays = {name: found[name] for name in found.files}
    name = list(arrays)[int(rng.integers(len(arrays)))]
    a = arrays.pop(name)
    others = (a[:3], np.zeros((2, 2, 2)), np.array("x"), a.astype("c16"), a.astype(float) * np.nan, a.T)
    if (n := int(rng.integers(len(others) + 2))) <= len(others):
        arrays[name] = others[n] if n < len(others) else np.array([{}], dtype=object)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def whole_plan(kr240_cell):
    """The files of a plan with summary, holes and arrays."""
    fake, files = fake_plan(kr240_cell), dict(hand_made_files())
    rounds = [{"step": "global", "viewpoints": 1, "completeness": 0.9}]
    patch = {"center_mm": [1.0, 2.0, 3.0], "area_mm2": 4.0, "reason": "cannot be seen"}
    files["summary.json"] = json.dumps(fake.summary.document() | {"rounds": rounds, "unscanned": [patch]})
    loop = [[0.1, 0.0, 0.1], [0.1, 0.05, 0.1], [0.1, 0.05, 0.2]]
    hole = {
        "kind": "common",
        "boundary": loop,
        "center": loop[0],
        "normal": [1.0, 0, 0],
        "X_OH": np.eye(4).tolist(),
    }
    files["holes.json"] = json.dumps(
        {"units": "m", "holes": [hole | {"extent": [0.1, 0.05, 0.0], "perimeter": 0.2, "area": 0.005}]}
    )
    buffer = io.BytesIO()
    points = np.zeros((9, 3), np.float32)
    np.savez(
        buffer, samples=points, sample_normals=points, visible=np.ones(9, bool), seen=np.ones((1, 9), bool)
    )
    files["scan.npz"] = buffer.getvalue()
    return {name: data if isinstance(data, bytes) else data.encode() for name, data in files.items()}


def fuzz_plans(whole: dict[str, bytes], folder: Path, number: int, seed: int) -> int:
    """Reads and exports `number` damaged plans; returns how many could still be read."""
    rng, good = np.random.default_rng(seed), 0
    names = [
        "plan.json",
        "summary.json",
        "holes.json",
        "scan.npz",
        "cell.json",
        "trajectory.csv",
        "robot.urdf",
    ]
    plan = folder / "plan"
    plan.mkdir()
    for name, content in whole.items():
        (plan / name).write_bytes(content)
    for i in range(number):
        name, formats = names[i % len(names)], ("csv", "viewpoints", "krl")
        data = whole[name]
        if rng.random() < 0.3 or name.endswith((".csv", ".urdf")):
            data = damaged(data, rng)
        else:
            data = changed_arrays(data, rng) if name == "scan.npz" else changed_json(data.decode(), rng)
        (plan / name).write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                load_plan(plan)
                export_files(plan, formats[i % 3], out=folder / "out")
        except InputError as error:
            one_line(error)
        else:
            good += 1
        (plan / name).write_bytes(whole[name])
    return good


def test_the_whole_plan_is_read(whole_plan, tmp_path):
    for name, content in whole_plan.items():
        (tmp_path / name).write_bytes(content)
    read = load_plan(tmp_path)
    assert len(read.holes.holes) == 1 and read.seen is not None and read.seen.all()


def test_damaged_plans(whole_plan, tmp_path):
    assert 0 < fuzz_plans(whole_plan, tmp_path, 70, seed=3) < 70


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_many_damaged_plans(whole_plan, tmp_path, seed):
    fuzz_plans(whole_plan, tmp_path, 2000, seed=300 + seed)


def test_undamaged_files_load(tmp_path):
    for name, content in SEEDS.items():
        (tmp_path / name).write_bytes(content)
        part = part_from_file(tmp_path / name)
        assert part.is_mesh == (not name.endswith((".xyz", ".pcd")))
        np.testing.assert_allclose(part.extent, 0.1, atol=1e-6)


def test_damaged_parts(tmp_path):
    assert 0 < fuzz_parts(tmp_path, 1600, seed=1) < 1600


def test_damaged_cells(tmp_path):
    assert 0 < fuzz_cells(tmp_path, 150, seed=2) < 150


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_many_damaged_parts(tmp_path, seed):
    fuzz_parts(tmp_path, 3000, seed=100 + seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_many_damaged_cells(tmp_path, seed):
    fuzz_cells(tmp_path, 1000, seed=200 + seed)
