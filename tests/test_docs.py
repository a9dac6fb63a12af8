"""The documents are true: every command runs, every link leads somewhere, the reference is current."""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import scanmotion as sm
from scanmotion.cell.settings.cell import load_cell
from scanmotion.cli import app
from scanmotion.geometry.parts.make_part import box_part, surface_samples
from scanmotion.studies.settings import StudySettings

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SLOW = {"plan", "verify", "show", "export", "compare", "layout"}


def commands(page: Path) -> list[str]:
    """Lines of the shell blocks of a page."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.S)
    return [
        line for block in blocks for line in block.splitlines() if line.strip() and not line.startswith("#")
    ]


def scanmotion_commands(page: Path) -> list[list[str]]:
    """Arguments of each `scanmotion` command in a page's shell blocks."""
    return [shlex.split(c, comments=True)[1:] for c in commands(page) if c.startswith("scanmotion ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_are_ours(page):
    for line in commands(page):
        assert line.split()[0] in ("scanmotion", "make", ".", "python", "pip"), line


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_has_the_options_it_is_given(page):
    """Also those that are too slow to be run here are parsed."""
    for args in scanmotion_commands(page):
        result = CliRunner().invoke(app, [*args, "--help"])
        assert result.exit_code == 0, (args, result.output)
        known = set(re.findall(r"--[a-z-]+", result.output))
        assert {a for a in args if a.startswith("--")} <= known, args


def test_make_targets_exist():
    text = (ROOT / "Makefile").read_text()
    for page in PAGES:
        for line in commands(page):
            if line.startswith("make "):
                assert re.search(rf"^{line.split()[1]}:", text, flags=re.M), line


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_cells_are_read(page, tmp_path):
    """Blocks of YAML are cells, whole or in part, or studies, which begin with their kind."""
    for block in re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.S):
        if block.startswith("kind:"):
            StudySettings.model_validate(yaml.safe_load(block))
            continue
        (tmp_path / "cell.yaml").write_text(block, encoding="utf-8")
        load_cell(tmp_path / "cell.yaml")


def test_every_room_stands_in_the_design():
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    for path in (ROOT / "scanmotion").iterdir():
        name = f"{path.name}/" if path.is_dir() else path.name
        assert (
            path.name.startswith(("__init__", "__pycache__", "_models", "py.typed")) or f"`{name}`" in text
        ), name


def test_cell_reference_is_current():
    made = runpy.run_path(str(ROOT / "docs" / "cell_reference.py"))["reference"]()
    assert (ROOT / "docs" / "cell.md").read_text(encoding="utf-8") == made, (
        "run: python docs/cell_reference.py"
    )


def test_cell_reference_names_every_key():
    from scanmotion.cell.settings.cell import cell_template

    text = (ROOT / "docs" / "cell.md").read_text(encoding="utf-8")
    for key in re.findall(r"^  (\w+):", cell_template(), flags=re.M):
        assert f"`{key}`" in text, key


def write_ply(
    file: Path, points: np.ndarray, triangles: np.ndarray, normals: np.ndarray | None = None
) -> None:
    """ASCII PLY in millimetres."""
    columns = points * 1e3 if normals is None else np.hstack([points * 1e3, normals])
    names = ["x", "y", "z", "nx", "ny", "nz"][: columns.shape[1]]
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(points)}",
        *(f"property float {n}" for n in names),
    ]
    if len(triangles):
        head += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    lines = [" ".join(f"{v:.4f}" for v in row) for row in columns]
    lines += ["3 " + " ".join(map(str, t)) for t in triangles]
    file.write_text("\n".join([*head, "end_header", *lines]) + "\n")


@pytest.fixture
def folder(files, tmp_path):
    """A folder of its own for each page, as a reader has it."""
    return Path(shutil.copytree(files, tmp_path / "work"))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """What the README takes for granted: a statue, a measured scan and two turns of it."""
    folder, rng = tmp_path_factory.mktemp("readme"), np.random.default_rng(0)
    part = box_part(0.16, 0.12, 0.25)
    write_ply(folder / "statue.ply", part.vertices, part.triangles)
    samples = surface_samples(part, 40_000, rng=rng)
    study = "kind: viewpoints\nrobots: [kr240, ur10e]\nparts: [{box_mm: [330, 200, 600]}]\n"
    (folder / "study.yaml").write_text(study)
    on = samples.normals[:, 2] > -0.5
    hole = (np.abs(samples.points - [0.08, 0.0, 0.12]) < [0.01, 0.02, 0.03]).all(axis=1)
    keep = on & ~hole
    write_ply(folder / "scan.ply", samples.points[keep], [], samples.normals[keep])
    for name, side in (("turn1.ply", 1.0), ("turn2.ply", -1.0)):
        half = on & (side * samples.points[:, 0] > -0.05)
        write_ply(folder / name, samples.points[half], [], samples.normals[half])
    return folder


def run_page(page: Path, folder: Path, monkeypatch, *, slow: bool) -> int:
    monkeypatch.chdir(folder)
    ran = 0
    for args in scanmotion_commands(page):
        if not slow and args[0] in SLOW:
            continue
        result = CliRunner().invoke(app, args)
        allowed = (0, 1) if args[0] in ("plan", "verify") else (0,)
        assert result.exit_code in allowed, (args, result.output)
        ran += 1
    return ran


def test_quick_commands_of_the_readme_run(folder, monkeypatch):
    assert run_page(ROOT / "README.md", folder, monkeypatch, slow=False) >= 7


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_runs_in_order(page, folder, monkeypatch):
    run_page(page, folder, monkeypatch, slow=True)


def test_python_of_the_readme_names_what_exists():
    import scanmotion as sm

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in re.findall(r"\bsm\.(\w+)", text):
        assert name in sm.__all__


@pytest.mark.slow
def test_python_of_the_readme_runs(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.S):
        exec(compile(block, "README.md", "exec"), {})
    assert "final" in capsys.readouterr().out
    assert (folder / "out" / "trajectory.csv").is_file()


def test_site_is_built_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
    made = subprocess.run([*command, ROOT / "docs", tmp_path], capture_output=True, text=True, cwd=ROOT)
    assert made.returncode == 0, made.stderr
    api = (tmp_path / "_generated" / "api.html").read_text(encoding="utf-8")
    commands = (tmp_path / "_generated" / "cli.html").read_text(encoding="utf-8")
    assert all(name in api for name in sm.__all__)
    assert "scanmotion plan" in commands and "--robot" in commands
