"""Lazy packages: submodules, and names that submodules define, are imported when they are first used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any


def lazy_attributes(package: str, names: Mapping[str, str] | None = None) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package.

    Parameters
    ----------
    package : str
        Its full name, ``__name__`` in its ``__init__``.
    names : mapping, optional
        The submodule that defines each name which the package offers as its own.
    """
    definitions = dict(names or {})

    def attribute(name: str) -> Any:
        if name in definitions:
            return getattr(import_module(f"{package}.{definitions[name]}"), name)
        if name.startswith("_") or find_spec(f"{package}.{name}") is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(f"{package}.{name}")

    return attribute
