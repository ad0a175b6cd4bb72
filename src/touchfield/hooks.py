"""Lets a low-level package call a function of a higher-level one without importing it: the higher one
registers the function here by name. Imports between packages so point one way.

``touchfield/__init__.py`` registers them by name; each is imported when it is first called.
"""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

_PROVIDERS: dict[str, str] = {}


def register(**providers: str) -> None:
    """Register functions: ``register(name="module:function")``."""
    _PROVIDERS.update(providers)


def hook(name: str) -> Callable[..., Any]:
    """Return the function registered under a name; KeyError if there is none."""
    function: Callable[..., Any] = resolve_name(_PROVIDERS[name])
    return function
