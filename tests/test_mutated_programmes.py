"""Faults of eighteen kinds in the text of each format: found, or harmless by a stated bound."""

from dataclasses import dataclass

import pytest
from exported_plan import made_by_hand
from mutants import missed

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell
from scanmotion.export import export_files
from scanmotion.export.source import write_files
from scanmotion.geometry.parts.make_part import box_part
from scanmotion.plan_io.write import plan_files

FORMATS = {
    "krl": ("kr240", "krl"), "krl-timed": ("kr240", "krl"), "rapid": ("irb6700", "rapid"),
    "urscript": ("ur10e", "urscript"),
}  # fmt: skip
"""The cell that a format is for, and its language."""


@dataclass
class Good:
    folder: object
    file: object
    language: str


@pytest.fixture(scope="module", params=FORMATS)
def good(request, tmp_path_factory):
    cell, language = FORMATS[request.param]
    size = (0.1, 0.08, 0.2) if cell == "ur10e" else (0.2, 0.15, 0.4)
    folder = tmp_path_factory.mktemp("plan")
    write_files(folder, plan_files(made_by_hand(build_cell(load_cell(cell), box_part(*size)))))
    file = export_files(folder, request.param, out=tmp_path_factory.mktemp("good"))[0]
    return Good(folder, file, language)


def test_a_few_mutated_programmes_are_found_or_harmless(good, tmp_path):
    wrong, left = missed(good.file, good.folder, tmp_path, 10, 3, good.language)
    assert wrong == [] and len(left) <= 5


@pytest.mark.slow
def test_five_hundred_mutated_programmes_are_found_or_harmless(good, tmp_path):
    """A hundred and twenty-five of each of the four formats."""
    wrong, left = missed(good.file, good.folder, tmp_path, 125, 11, good.language)
    assert wrong == [] and len(left) < 40
