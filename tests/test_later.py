"""Heavy modules that libraries import in passing load when they are used, and then are the true ones."""

import subprocess
import sys

import pytest


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_open3d_is_imported_without_dash_and_draws_all_the_same():
    code = """
import sys, scanmotion
import open3d as o3d
early = {"dash", "IPython", "plotly.graph_objects"} & set(sys.modules)
points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]))
figures = [type(o3d.visualization.get_plotly_fig([points])).__name__ for _ in range(2)]
true = sys.modules["open3d.visualization.draw_plotly"]
same = o3d.visualization.draw_plotly is true.draw_plotly and true.__file__ is not None
print(early, figures, same, "dash" in sys.modules)
"""
    assert run(code) == "set() ['Figure', 'Figure'] True True"


def test_what_is_imported_already_is_left_alone():
    code = """
import open3d.visualization
before = open3d.visualization.draw_plotly
import sys, scanmotion
print(open3d.visualization.draw_plotly is before, before.__code__.co_filename.endswith("draw_plotly.py"))
"""
    assert run(code) == "True True"


def test_toppra_is_imported_without_pyplot_and_has_it_when_asked():
    code = """
import sys
import scanmotion.motion.profile.toppra_profile
early = "matplotlib.pyplot" in sys.modules
import toppra.parametrizer, matplotlib.pyplot as plt
print(early, toppra.parametrizer.plt.plot is plt.plot, sys.modules["matplotlib.pyplot"] is plt)
print(hasattr(plt, "__file__"))
"""
    assert run(code).split() == ["False", "True", "True", "True"]


@pytest.mark.parametrize("command", ["--help", "plan --help"])
def test_help_imports_no_heavy_library(command):
    code = f"""
import sys
sys.argv = ["scanmotion", *"{command}".split()]
from scanmotion.__main__ import main
try:
    main()
except SystemExit:
    pass
heavy = set(sys.modules) & {{"numpy", "scipy", "numba", "open3d", "pydrake", "matplotlib", "yaml"}}
print(heavy)
"""
    assert run(code).endswith("set()")


def test_help_parses_neither_markdown_nor_python_and_both_work_when_asked():
    code = """
import io, sys
import scanmotion.cli
import typer.rich_utils
early = {"markdown_it", "pygments"} & set(sys.modules)
from rich.console import Console
out = Console(file=io.StringIO(), width=60)
out.print(typer.rich_utils.Markdown("**word**"))
try:
    1 / 0
except ZeroDivisionError:
    out.print_exception()
import rich.markdown, rich.traceback
made = typer.rich_utils.Markdown("word")
told = out.file.getvalue()
print(early, isinstance(made, rich.markdown.Markdown), rich.traceback.__file__ is not None)
print("word" in told, "**" in told, "ZeroDivisionError" in told)
"""
    assert run(code).split() == ["set()", "True", "True", "True", "False", "True"]
