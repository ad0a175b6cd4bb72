"""A ``.touch`` file, or a medium of the user's, as a source: filtered, measured and coded again (paper section 4)."""

from __future__ import annotations

import weakref
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from touchfield.container import TouchReader
from touchfield.container.remote import is_remote
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.grid import Placement
from touchfield.sources.scene import Scene
from touchfield.sources.stored import StoredScene
from touchfield.stream.opened import opened

if TYPE_CHECKING:
    from touchfield.medium import HapticScene


Source = str | Path | Scene | HapticMedium | ForceField
"""Sources of an encoding: a path or "sample:NAME", a scene, a medium, or a field, which is a medium of one frame."""


def is_stream(source: Source) -> bool:
    """True if a source is a ``.touch`` file, by its name; a scene is none."""
    if is_remote(source):
        return True
    return isinstance(source, str | Path) and Path(source).suffix.lower() == ".touch" and Path(source).is_file()


class StreamScene(StoredScene):
    """A stream's decoded medium, its objects if it has any, and the device, lattice and placement it was made for.

    The file is closed when the scene and its medium are no longer used. FormatError if it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        reader = TouchReader(path)
        stream = opened(reader, reader.size)
        weakref.finalize(stream.held, reader.close)
        super().__init__(stream.medium)
        self.objects: HapticScene | None = stream.scene
        head = reader.head
        self.head, self._device, self.file_bytes = head, stream.told_device, reader.size
        self.placement: Placement = stream.placement
        self.notes = ("A .touch file keeps its own device, lattice and placement; options of the scene do nothing.",)

    def device(self) -> Device:
        """The device that the stream was made for, as far as the stream tells; no profile is looked up."""
        return self._device


class MediumScene(StreamScene):
    """A medium of the user's, on its own lattice in the metres of the hand: neither scaled nor resampled nor clipped.

    It is for a device of that name, whose F_max holds for what haptic filters add.
    """

    def __init__(self, medium: HapticMedium, device_name: str) -> None:
        StoredScene.__init__(self, medium)
        x, y, z = (1e3 * np.ptp(medium.grid.box_m, axis=0)).tolist()
        known = device(device_name)
        self._device = replace(known, workspace_mm=(x, y, z), lattice=medium.grid.shape)
        self.objects, self.placement, self.tags = None, Placement(), medium.tags
        self.notes = ("The medium keeps its own lattice and its forces; options of the scene do nothing.",)


def as_source(source: object, device_name: str, grid: Grid | None = None) -> str | Path | Scene:
    """A path or a scene as it is, a medium as a `MediumScene`; newtons [.., nx, ny, nz, 3] are one with their grid.

    InvalidArgument if it is none of these, or an array without its grid.
    """
    if grid is not None and not isinstance(source, str | Path | Scene | HapticMedium | ForceField):
        source = HapticMedium.from_array(np.asarray(source), grid)
    if isinstance(source, ForceField):
        source = HapticMedium.from_frames([source], 30.0)
    if isinstance(source, HapticMedium):
        return MediumScene(source, device_name)
    if isinstance(source, str | Path | Scene):
        return source
    found = f"an array {source.shape} without its grid" if isinstance(source, np.ndarray) else type(source).__name__
    expected = "a path, a scene, a HapticMedium, a ForceField, or an array of newtons and grid="
    raise InvalidArgument("source", found, expected)


def decode(path: str | Path) -> HapticMedium:
    """The medium of a ``.touch`` file; its frames are decoded when they are asked for.

    FormatError if the file cannot be read.
    """
    return StreamScene(path).medium
