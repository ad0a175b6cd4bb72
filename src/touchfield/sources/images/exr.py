"""Reads one channel of an OpenEXR picture as depth or height, floats [height, width] (extra: exr).

The channel is Z, Depth or V (also of a layer: ``ViewLayer.Depth.Z``), else the only one, else R if R, G and B
are equal. Renderers write 1e10, or the largest half float (65504), where there is no surface: these become 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, import_extra
from touchfield.files import library_faults

EXR_MAGIC: Final = b"\x76\x2f\x31\x01"
_NAMES: Final = ("z", "depth", "v", "y", "distance")
_NO_SURFACE: Final = 65504.0  # the largest half float
_EXPECTED: Final = "a channel Z, Depth or V, or one channel"


@contextmanager
def _opened(path: Path, header_only: bool) -> Iterator[Any]:
    library = import_extra("OpenEXR", str(path), "OpenEXR", "exr")
    with library_faults(path, "an EXR that is damaged", "a whole EXR picture", "Copy the file again."):
        yield library.File(str(path), separate_channels=True, header_only=header_only)


def _channel(path: Path, names: list[str]) -> str:
    """Return the name of the channel to read."""
    for wanted in _NAMES:
        for name in names:
            if name.rpartition(".")[2].lower() == wanted:
                return name
    if len(names) == 1:
        return names[0]
    colours = [name for name in names if name.rpartition(".")[2] == "R"]
    if len(colours) == 1:
        return colours[0]
    raise SourceError(str(path), f"the channels {', '.join(names)[:80]}", _EXPECTED)


def exr_size(path: Path) -> tuple[int, int]:
    """Return width and height, from the header.

    Raises `MissingExtra` without the library, `SourceError` if the file is invalid or has no such channel.
    """
    with _opened(path, header_only=True) as file:
        header = file.header()
        low, high = header["dataWindow"]
        _channel(path, [channel.name for channel in header["channels"]])
        return int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1


def read_exr(path: Path) -> NDArray[Any]:
    """Read the channel, float32 [height, width]; 0 where there is no surface. Raises as `exr_size`."""
    with _opened(path, header_only=False) as file:
        channels = file.channels()
        name = _channel(path, list(channels))
        values = np.array(channels[name].pixels, np.float32)
    prefix, _, last = name.rpartition(".")
    if last == "R":
        for other in ("G", "B"):
            key = f"{prefix}.{other}" if prefix else other
            if key not in channels or not np.array_equal(channels[key].pixels, channels[name].pixels):
                raise SourceError(str(path), "a picture in colour", _EXPECTED, "Save the depth itself.")
    values[~(values < _NO_SURFACE)] = 0
    return np.ascontiguousarray(values)
