"""Fixtures that all tests share."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

settings.register_profile("scanmotion", deadline=None, derandomize=True, print_blob=False)
settings.load_profile("scanmotion")


def pytest_sessionstart(session):
    """Kernels are compiled once, before several processes would all compile the same ones."""
    if not hasattr(session.config, "workerinput"):
        from scanmotion.geometry.compiled import compile_kernels

        compile_kernels()


SHARED = Path(__file__).resolve().parents[2] / "shared"


def _shared(folder: str) -> Path:
    path = SHARED / folder
    if not path.is_dir():
        message = f"needs the shared data at ../shared/{folder}, which is not here"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    return path


@pytest.fixture(scope="session")
def shared_data() -> Path:
    return _shared("data")


@pytest.fixture(scope="session")
def shared_tools() -> Path:
    return _shared("tools")


@pytest.fixture(scope="session")
def shared_cases() -> Path:
    return _shared("cases")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def kr240_cell():
    """The built-in cell without a part."""
    from scanmotion.cell.build import build_cell
    from scanmotion.cell.settings.cell import load_cell

    return build_cell(load_cell("kr240"))


@pytest.fixture(scope="session")
def pitted_plan():
    """Both steps of a block with a pit, coarsely; plans are not changed by those who look at them."""
    from judging import summarised
    from test_plan import TINY, pitted

    from scanmotion.cell.settings.cell import load_cell
    from scanmotion.planning.pipeline import PlanOptions, plan

    return summarised(plan(pitted(), load_cell("kr240"), options=PlanOptions(seed=5, **TINY)))


@pytest.fixture(scope="session")
def lump():
    """A closed lump without symmetry."""
    from scans import bumpy

    return bumpy()


@pytest.fixture(scope="session")
def clean_scan(lump):
    """Three turns about the lump with the stated noise."""
    from scans import turns

    from scanmotion.sensing.simulator.simulate import ScanErrors

    return turns(lump, ScanErrors())


@pytest.fixture(scope="session")
def lump_cloud(clean_scan):
    from scanmotion.sensing.fusion.fuse import fuse

    return fuse([clean_scan])
