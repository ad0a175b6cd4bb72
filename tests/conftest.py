"""Shared fixtures: the optional folder of real inputs, and random sparse fields."""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from touchfield.medium import ForceField, Grid

common = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
settings.register_profile("touchfield", max_examples=60, derandomize=True, **common)  # reproducible
settings.register_profile("thorough", max_examples=600, **common)  # a new search every time
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "touchfield"))

_RUNTIME_FOLDER = tempfile.TemporaryDirectory(prefix="touchfield-tests-")
os.environ["XDG_RUNTIME_DIR"] = _RUNTIME_FOLDER.name  # locks of devices are those of this process
os.environ["TOUCHFIELD_HELPERS"] = "0"  # tested commands compile by themselves
_PROGRAM = sys.modules["__main__"]
_PROGRAM.__spec__ = _PROGRAM.__file__ = None  # spawned processes need not import pytest again

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


gc.disable()  # until all tests are collected: imported modules stay


EXTERNAL = (
    *("compute/test_cuda.py", "conformance/test_c.py", "conformance/test_c_head.py"),
    *("conformance/test_c_encode.py", "conformance/test_c_queries.py", "conformance/test_native_module.py"),
    *("integrations", "viewer/test_browser.py", "viewer/test_dash_players.py"),
    "viewer/test_timeline_page.py",
    "network/test_repackaging.py::test_a_copied_movie",
    "test_docs.py::test_the_site_builds",
    "test_release.py::test_the_decoders_of_the_archives",
)
"""Tests that need other tools, by the start of their paths below this folder."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that need other tools as external."""
    for item in items:
        if item.nodeid.removeprefix("tests/").startswith(EXTERNAL):
            item.add_marker("external")


def pytest_collection_finish() -> None:
    """Exempt modules and tests, which stay until the end, from garbage collection."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)
    gc.enable()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The optional folder of real inputs next to the checkout."""
    if not SHARED.is_dir():
        pytest.skip("the optional folder of real inputs, ../shared/data, is not there")
    return SHARED


@pytest.fixture
def wavy_field() -> ForceField:
    """A smooth sheet of force, 4 samples thick, on a 24 x 20 x 17 grid: small, sparse, not brick-aligned."""
    grid = Grid((24, 20, 17), (0.001, 0.002, 0.0015), (-0.01, 0.0, 0.02))
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    depth = z - (8 + 3 * np.sin(x / 4) * np.cos(y / 5))
    amplitude = np.where((depth > 0) & (depth < 4), depth / 4, 0)
    normal = np.stack([np.sin(x / 7), np.cos(y / 9), -np.ones_like(x)], axis=-1)
    return ForceField.from_dense(grid, (amplitude[..., None] * normal).astype(np.float32))
