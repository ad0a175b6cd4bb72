"""Whether a library of Python is there, without importing it: for `touchfield doctor`."""

from __future__ import annotations

from importlib import metadata

from touchfield.adapters.check import Check

__all__ = ["library_check"]


def library_check(name: str, extra: str) -> Check:
    """Whether the distribution `name` is installed, and how to get it."""
    try:
        return Check(f"library {name}", True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(f"library {name}", False, "not installed", f'pip install "touchfield[{extra}]"')
