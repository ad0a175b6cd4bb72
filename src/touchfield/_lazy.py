"""Makes a package import its submodules, and the names that they define, only when a program first uses them.
The packages of touchfield call it so that ``import touchfield`` is fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any


def lazy_attributes(package: str, modules: Mapping[str, Sequence[str]] | None = None) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package.

    Parameters
    ----------
    package : str
        Its full name, ``__name__`` in its ``__init__``.
    modules : mapping, optional
        For each submodule, the names that it defines and the package offers as its own.
    """
    module_of = {name: module for module, names in (modules or {}).items() for name in names}

    def attribute(name: str) -> Any:
        if name in module_of:
            return getattr(import_module(f"{package}.{module_of[name]}"), name)
        if name.startswith("_") or find_spec(f"{package}.{name}") is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(f"{package}.{name}")

    return attribute
