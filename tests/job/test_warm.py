"""Groups of kernels that are compiled ahead: each is a small job that runs."""

from __future__ import annotations

import pytest

from touchfield.job.setup import GROUPS


@pytest.mark.parametrize("name", GROUPS)
def test_a_group_runs(name: str) -> None:
    GROUPS[name]()
