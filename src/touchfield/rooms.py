"""Modules of a room that are opened when they are first named: `touchfield.render.sampler` needs no import."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any


def modules_of(room: str) -> Callable[[str], Any]:
    """The ``__getattr__`` of a room."""

    def module(name: str) -> Any:
        if name.startswith("_") or find_spec(f"{room}.{name}") is None:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        return import_module(f"{room}.{name}")

    return module
