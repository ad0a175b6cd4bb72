"""Groups of kernels compiled in advance: each is a small job that runs."""

from __future__ import annotations

import pytest
from numba.core.event import Event, Listener, install_listener

from touchfield.tasks.setup import GROUPS


@pytest.mark.parametrize("name", GROUPS)
def test_a_group_runs(name: str) -> None:
    compiled: list[str] = []

    class Compiled(Listener):
        def on_start(self, event: Event) -> None:
            compiled.append(str(event.data.get("dispatcher")))

        def on_end(self, event: Event) -> None:
            return

    GROUPS[name]()
    with install_listener("numba:compile", Compiled()):
        GROUPS[name]()
    assert not compiled, "the first run has compiled all that the second one needs"
