"""What the tests of all integrations share."""

from __future__ import annotations

from pathlib import Path

import pytest
from builders import make_plate


@pytest.fixture(scope="session")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate of 2 mm."""
    return make_plate(tmp_path_factory.mktemp("plate") / "plate.touch")
