"""Fixtures shared by the tests of servers."""

from __future__ import annotations

import threading

import pytest


@pytest.fixture
def client_dropped(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Set once a server leaves a client that does not read."""
    from touchfield.network import access

    event = threading.Event()

    class RecordingDropped(access.ClientDropped):
        def __init__(self) -> None:
            event.set()

    monkeypatch.setattr(access, "ClientDropped", RecordingDropped)
    return event
