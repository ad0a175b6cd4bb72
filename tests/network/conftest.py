"""What the tests of servers share."""

from __future__ import annotations

import threading

import pytest


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Set once a server leaves a client that does not read."""
    from touchfield.network import access

    told = threading.Event()

    class Left(access.ClientDropped):
        def __init__(self) -> None:
            told.set()

    monkeypatch.setattr(access, "ClientDropped", Left)
    return told
