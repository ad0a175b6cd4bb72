"""Functions that a lower package calls and a higher one provides, so that imports point one way.

The package's ``__init__`` registers them by name, and each is imported when it is first called.
"""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

_PROVIDERS: dict[str, str] = {}


def register(**providers: str) -> None:
    """Provide functions: ``register(name="module:function")``."""
    _PROVIDERS.update(providers)


def hook(name: str) -> Callable[..., Any]:
    """The function that is registered under a name; KeyError if there is none."""
    function: Callable[..., Any] = resolve_name(_PROVIDERS[name])
    return function
