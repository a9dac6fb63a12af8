"""The notebooks hold calls only, no stored outputs, and run from top to bottom."""

import ast
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SLOW = ("01", "05")


def test_all_are_there():
    assert [p.name[:2] for p in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_calls_only_and_no_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type != "code":
            continue
        assert cell.outputs == [] and cell.execution_count is None
        tree = ast.parse(cell.source)
        for node in ast.walk(tree):
            assert not isinstance(
                node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda | ast.For | ast.While
            ), ast.unparse(node)
        assert cell.source.count("\n") < 20


def run(path, folder, monkeypatch):
    from nbclient import NotebookClient

    # The kernel finds this environment's packages, and its font cache, wherever it starts.
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=[pytest.mark.slow] if p.name.startswith(SLOW) else []) for p in NOTEBOOKS],
    ids=lambda p: p.stem,
)
def test_runs(path, tmp_path, monkeypatch):
    notebook = run(path, tmp_path, monkeypatch)
    outputs = [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]
    assert all(o.output_type == "execute_result" for o in outputs), "libraries speak to the reader"
    shown = [kind for o in outputs for kind in o.data if kind in ("image/png", "text/html", "text/markdown")]
    # Whoever writes a figure's cell means its picture, not its name.
    figures = sum("_figure(" in c.source or "_map(" in c.source for c in notebook.cells)
    assert shown.count("image/png") == figures and len(shown) >= 1
