"""A ``.touch`` file as a source: what was decoded can be filtered, measured and coded again (paper section 4)."""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import TYPE_CHECKING

from touchfield.container import TouchReader
from touchfield.devices import Device
from touchfield.job.stream import opened
from touchfield.sources.stored import StoredScene

if TYPE_CHECKING:
    from touchfield.sources.scene import Scene

__all__ = ["StreamScene", "is_stream"]


def is_stream(source: str | Path | Scene) -> bool:
    """Whether a source is a ``.touch`` file, by its name; a scene is none."""
    return isinstance(source, str | Path) and Path(source).suffix.lower() == ".touch" and Path(source).is_file()


class StreamScene(StoredScene):
    """A stream's decoded medium, its objects if it has any, and the device, lattice and placement it was made for.

    The file is closed when the scene and its medium are no longer used.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    FormatError
        If the file cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        reader = TouchReader(path)
        stream = opened(reader, Path(path).stat().st_size)
        weakref.finalize(stream.held, reader.close)
        super().__init__(stream.medium)
        self.objects = stream.scene
        head = reader.head
        self.path, self.head, self._device = Path(path), head, stream.told_device
        self.placement = stream.placement
        self.notes = ("A .touch file keeps its own device, lattice and placement; options of the scene do nothing.",)

    def device(self) -> Device:
        """The device that the stream was made for, as far as the stream tells; no profile is looked up."""
        return self._device
