"""The geometry module's public names: lazy, whole, and without robot or Drake."""

import importlib
import subprocess
import sys

import pytest

import scanmotion as sm
from scanmotion import viewpoints

ROBOT = (
    "pydrake",
    "scanmotion.cell",
    "scanmotion.motion",
    "scanmotion.planning.pipeline",
    "ompl",
    "py_opw_kinematics",
)


def loaded(code: str, names: tuple[str, ...]) -> list[str]:
    """Which modules are loaded after `code` ran in a fresh interpreter."""
    tail = f"\nimport sys; print(*[m for m in {names!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True)
    return out.stdout.split()


@pytest.mark.parametrize("name", viewpoints.__all__)
def test_each_name_is_that_of_its_home(name):
    home, is_module, _ = viewpoints._HOMES[name].partition(":")
    module = importlib.import_module(f"scanmotion.{home}")
    assert getattr(sm.viewpoints, name) is (module if is_module else getattr(module, name))


def test_import_alone_is_light():
    heavy = ("numpy", "scipy", "open3d", "numba", "meshcat", *ROBOT)
    assert loaded("import scanmotion.viewpoints", heavy) == []
    assert loaded("import scanmotion as sm; sm.viewpoints; dir(sm.viewpoints)", heavy) == []


def test_all_names_together_load_no_robot():
    code = "import scanmotion as sm\nfor name in sm.viewpoints.__all__: getattr(sm.viewpoints, name)"
    assert loaded(code, (*ROBOT, "scanmotion.views.next_best_views")) == ["scanmotion.views.next_best_views"]


def test_holes_and_viewpoints_without_robot_in_one_breath():
    code = (
        "import numpy as np, scanmotion as sm\n"
        "g = np.stack(np.meshgrid(*[np.linspace(-.1, .1, 81)] * 2), -1).reshape(-1, 2)\n"
        "p = np.column_stack([g, np.full(len(g), .2)])[np.hypot(*g.T) > .03]\n"
        "r = sm.viewpoints.holes_from_cloud(p, normals=np.tile([0, 0, 1.], (len(p), 1)))\n"
        "v = sm.viewpoints.local_viewpoints(r.holes, sm.Scanner(), standoff=.5)\n"
        "page = sm.viewpoints.show.scene(points=p, holes=r.holes, viewpoints=v).page()\n"
        "assert any(h.kind == 'common' for h in r.holes) and len(v) and 'MeshCat' in page\n"
    )
    assert loaded(code, ROBOT) == []


def test_an_unknown_name_is_named():
    with pytest.raises(AttributeError, match=r"scanmotion\.viewpoints.*nothing_like_it"):
        viewpoints.nothing_like_it  # noqa: B018
    assert set(dir(viewpoints)) == set(viewpoints.__all__)
