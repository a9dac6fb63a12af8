"""Sphinx: the site of the documents, built by `make docs`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import scanmotion

project = "scanmotion"
author = "the scanmotion authors"
copyright = "2026, the scanmotion authors"
version = release = scanmotion.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "images"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"scanmotion {release}"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
suppress_warnings = ["myst.header", "myst.xref_missing"]


def _api_page() -> str:
    """Every public name of the package with its docstring, in the order of the pipeline."""
    lines = ["# Python API", "", "`import scanmotion as sm`; every name is loaded when it is first used.", ""]
    for module in (scanmotion, scanmotion.viewpoints):
        prefix = module.__name__
        lines += [
            f"## {prefix}",
            "",
            *(_entry(prefix, name, getattr(module, name)) for name in module.__all__),
        ]
    return "\n".join(lines)


def _entry(prefix: str, name: str, value: object) -> str:
    import inspect

    if inspect.ismodule(value):
        return f"`{prefix}.{name}`: {(value.__doc__ or name).splitlines()[0]}\n"
    kind = "autoclass" if inspect.isclass(value) else "autofunction"
    home = f"{value.__module__}.{value.__qualname__}"  # type: ignore[attr-defined]
    members = "   :members:\n" if kind == "autoclass" and not issubclass(value, Exception) else ""  # type: ignore[arg-type]
    return f"### {prefix}.{name}\n\n```{{eval-rst}}\n.. {kind}:: {home}\n   :no-index:\n{members}```\n"


def _cli_page() -> str:
    """Every command with its options, from the commands themselves."""
    import typer.main
    from typer.cli import get_docs_for_click

    from scanmotion.cli import app

    command = typer.main.get_command(app)
    import click

    with click.Context(command, info_name="scanmotion") as context:
        return "# Commands\n\n" + get_docs_for_click(
            obj=command, ctx=context, name="scanmotion", title="scanmotion"
        )


def setup(app: object) -> None:
    """Writes the pages that are made from the code."""
    folder = Path(__file__).parent / "_generated"
    folder.mkdir(exist_ok=True)
    (folder / "api.md").write_text(_api_page(), encoding="utf-8")
    (folder / "cli.md").write_text(_cli_page(), encoding="utf-8")
