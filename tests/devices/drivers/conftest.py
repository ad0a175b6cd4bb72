"""The stand-in for the library of Force Dimension, for the tests of drivers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_driver import FakeDriver, built


@pytest.fixture(scope="module")
def dhd_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled library; each module has its own."""
    return built("fake_dhd", tmp_path_factory.mktemp("dhd"))


@pytest.fixture
def dhd(dhd_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeDriver]:
    """The library with one unit, of serial number 301; at the end it has seen no wrong call."""
    monkeypatch.setenv("TOUCHFIELD_FORCEDIMENSION_LIBRARY", str(dhd_path))
    driver = FakeDriver(dhd_path)
    driver.library.fake_unit(301, 1)
    yield driver
    assert not driver.faults, driver.faults
