"""What a device needs of libraries: checks for `touchfield doctor`, and drivers that come as shared libraries."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata, util
from typing import Any

from touchfield.errors import DeviceError

__all__ = ["Check", "DriverLibrary", "library_check"]


@dataclass(frozen=True)
class Check:
    """One thing that a device or a format needs.

    Attributes
    ----------
    what : str
        Such as "library websockets", "service on port 10001".
    is_there : bool
    found : str
        Such as "16.0", "connection refused".
    mend : str
        One line on how to mend it; "" where there is nothing to mend.
    """

    what: str
    is_there: bool
    found: str
    mend: str = ""


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


@dataclass(frozen=True)
class DriverLibrary:
    """How a driver is named on each system.

    Parameters
    ----------
    title : str
        For messages, such as "OpenHaptics".
    variable : str
        Environment variable that names the file, when it lies elsewhere.
    linux, windows, mac : tuple of str
        Names that the system's own search is asked for, the likeliest first.
    mend : str
        How to get it, one line.
    """

    title: str
    variable: str
    linux: tuple[str, ...]
    windows: tuple[str, ...]
    mac: tuple[str, ...]
    mend: str

    def load(self, functions: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> Any:
        """The library, its functions given results and arguments: ``{name: (result, arguments)}``.

        Raises
        ------
        DeviceError
            If no file can be loaded, or one lacks a function.
        """
        library, name = self._found()
        for function, (result, arguments) in functions.items():
            try:
                entry = getattr(library, function)
            except AttributeError:
                raise DeviceError(
                    name, f"no function {function}", f"the library of {self.title}", self._mend
                ) from None
            entry.restype, entry.argtypes = result, arguments
        return library

    def check(self) -> Check:
        """For `touchfield doctor`."""
        what = f"driver of {self.title}"
        try:
            return Check(what, True, self._found()[1])
        except DeviceError as error:
            return Check(what, False, error.found, self._mend)

    @property
    def names(self) -> tuple[str, ...]:
        """What is tried, in order."""
        asked = os.environ.get(self.variable)
        if asked:
            return (asked,)
        if sys.platform == "win32":
            return self.windows
        return self.mac if sys.platform == "darwin" else self.linux

    @property
    def _mend(self) -> str:
        return f"{self.mend}, or name its file in {self.variable}."

    def _found(self) -> tuple[ctypes.CDLL, str]:
        reasons = []
        for name in self.names:
            try:
                return ctypes.CDLL(name), name
            except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
                reasons.append(str(error) if name in str(error) else f"{name}: {error}")
        found = "; ".join(reasons)[:200]
        raise DeviceError(f"driver of {self.title}", found, f"one of {', '.join(self.names)}", self._mend)
