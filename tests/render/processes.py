"""For the tests of processes: nothing may be left of them."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from touchfield.render.block import PREFIX, shared_folder

OTHERS_S = 20.0
"""Longest life of a block that a test of another process has."""


def _blocks() -> set[Path]:
    return set(shared_folder().glob(PREFIX + "*"))


@pytest.fixture(autouse=True)
def no_leftovers() -> object:
    """No block in shared memory and no process after each test."""
    before = _blocks()
    yield
    new, until_s = _blocks() - before, time.monotonic() + OTHERS_S
    while new and time.monotonic() < until_s:  # one of another process, which tests beside this one, goes
        time.sleep(0.05)
        new &= _blocks()
    assert not new
    if os.path.exists("/proc"):
        assert not _children()


def _children() -> list[str]:
    """Processes started by this one that serve a device."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
            command = (path / "cmdline").read_text()
        except (OSError, ValueError, IndexError):
            continue
        if parent == os.getpid() and "spawn_main" in command:
            found.append(command)
    return found


def runs(pid: int) -> bool:
    """Whether a process exists that is not a zombie."""
    try:
        os.kill(pid, 0)
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
