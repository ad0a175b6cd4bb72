"""The devices that touchfield knows, and those that a user describes.

A new device is one more file in ``devices/profiles``; a user's own is named by the path of its TOML file.
OWO (10 electrical zones) and Woojer (6 transducers) are left out: their actuators lie on no regular lattice,
so that neither a pitch nor the cut-off of the paper's section 3.2 can be stated for them. Ultrasound arrays
are left out because they have no open interface.
"""

from __future__ import annotations

import difflib
import tomllib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final

from touchfield.devices.profile import Device, device_of_table
from touchfield.errors import DeviceError, InvalidArgument, SourceError
from touchfield.files import require_plain

__all__ = ["device", "device_names", "devices"]

MAX_PROFILE_BYTES: Final = 1 << 16


@cache
def device_names() -> tuple[str, ...]:
    """The names that `device` takes, sorted."""
    folder = resources.files("touchfield.devices") / "profiles"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def devices() -> tuple[Device, ...]:
    """All devices that come with touchfield, sorted by name."""
    return tuple(_shipped(name) for name in device_names())


def device(name_or_path: str | Path) -> Device:
    """The device of a name, or of the path of a TOML profile.

    Raises
    ------
    InvalidArgument
        If it is neither a known name nor the path of a file.
    DeviceError
        If the profile cannot be read or is unusable.
    """
    text = str(name_or_path)
    if text in device_names():
        return _shipped(text)
    if text.endswith(".toml") or Path(text).name != text:
        return _parsed(_file_bytes(Path(text)), text)
    names = device_names()
    near = difflib.get_close_matches(text.lower(), names, n=1, cutoff=0.4)
    mend = f"Did you mean {near[0]}?" if near else "Or give the path of a TOML profile."
    raise InvalidArgument("device", repr(text), f"one of {', '.join(names)}", mend)


@cache
def _shipped(name: str) -> Device:
    profile = resources.files("touchfield.devices") / "profiles" / f"{name}.toml"
    return _parsed(profile.read_bytes(), profile.name)


def _file_bytes(path: Path) -> bytes:
    try:
        require_plain(path, "a TOML profile")
        with path.open("rb") as file:
            data = file.read(MAX_PROFILE_BYTES + 1)
    except SourceError as error:
        raise DeviceError(error.where, error.found, error.expected) from error
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        raise DeviceError(str(path), f"a file that cannot be read ({error})", "a TOML profile") from error
    if len(data) > MAX_PROFILE_BYTES:
        raise DeviceError(str(path), f"more than {MAX_PROFILE_BYTES} bytes", "a TOML profile of a few kilobytes")
    return data


def _parsed(data: bytes, where: str) -> Device:
    try:
        table = tomllib.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise DeviceError(where, f"no TOML ({error})", "a TOML profile") from error
    return device_of_table(table, where)
