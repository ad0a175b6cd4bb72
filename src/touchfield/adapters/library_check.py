"""Whether a library of Python is there, without importing it: for `touchfield doctor`."""

from __future__ import annotations

from importlib import metadata, util

from touchfield.adapters.check import Check

__all__ = ["library_check"]


def library_check(name: str, extra: str = "", module: str = "", purpose: str = "") -> Check:
    """Whether a library is installed, and how to get it.

    Parameters
    ----------
    name : str
        Of its distribution.
    extra : str
        Of touchfield, which brings it; "" for the core.
    module : str
        What is imported; "" where it has the distribution's name.
    purpose : str
        What it is for, told where it is not plain from the device.
    """
    what = f"{name}, for {purpose}" if purpose else f"library {name}"
    if util.find_spec(module or name) is None:
        wanted = f"touchfield[{extra}]" if extra else "touchfield"
        return Check(what, False, "not installed", f'pip install "{wanted}"')
    try:
        return Check(what, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(what, True, "of unknown version")
