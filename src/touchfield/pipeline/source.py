"""Opens what a user wants to encode as a scene: a path, a sample such as ``sample:terrain``, a stream, a
medium, a field or an array."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from touchfield.compute.cuda import needs_gpu
from touchfield.container import TouchReader
from touchfield.container.map_record import MAP_LEFT_OUT
from touchfield.container.remote import is_remote
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.medium.stores.zarr_store import read_zarr
from touchfield.pipeline.decoding import stream_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions, WatchedOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.sources.stored import StoredScene


class DataArray(Protocol):
    """An xarray DataArray of heights (`touchfield.sources.terrain.height_files.scene_of_xarray`)."""

    @property
    def dims(self) -> Any:
        """Names of the dimensions."""

    @property
    def coords(self) -> Any:
        """Coordinates by name."""


Openable = str | Path | Scene | DataArray
Source = str | Path | Scene | HapticMedium | ForceField | DataArray
"""Source of an encoding: a path, "sample:NAME", a scene, a medium, a field (a medium of one frame), or a
DataArray of heights."""


def scene_of(source: Source | ArrayLike, spec: EncodeSpec, grid: Grid | None = None) -> Scene:
    """The scene of a source, restricted to the frames of `spec`; an array has newtons on `grid`.

    An xarray DataArray without a grid has heights.
    """
    scene = open_scene(as_source(source, spec.device, grid), spec.source)
    if spec.frames is not None:
        start, stop = spec.frames
        scene.restrict_frames(start, scene.frame_count if stop is None else stop)
    return scene


def as_source(source: object, device_name: str, grid: Grid | None = None) -> Openable:
    """What `open_scene` opens unchanged; a medium, field or array of newtons as a `FixedLatticeScene`.

    An array [nx, ny, nz, 3] or [frame, nx, ny, nz, 3] needs its `grid`; an xarray DataArray without one has
    heights. InvalidArgument for anything else.
    """
    if grid is not None and not isinstance(source, str | Path | Scene | HapticMedium | ForceField):
        source = HapticMedium.from_array(np.asarray(source), grid)
    if isinstance(source, ForceField):
        source = HapticMedium.from_frames([source], 30.0)
    if isinstance(source, HapticMedium):
        x, y, z = (1e3 * np.ptp(source.grid.box_m, axis=0)).tolist()
        target = replace(device(device_name), workspace_mm=(x, y, z), lattice=source.grid.shape)
        notes = ("The medium keeps its own lattice and its forces; options of the scene do nothing.",)
        return FixedLatticeScene(source, target, notes)
    if isinstance(source, str | Path | Scene) or is_data_array(source):
        return source
    if isinstance(source, np.ndarray):
        found = f"an array {source.shape} without its grid"
    else:
        found = type(source).__name__
    expected = (
        "a path, a scene, a HapticMedium, a ForceField, an xarray DataArray of heights, or an array of "
        "newtons and grid="
    )
    raise InvalidArgument("source", found, expected)


def open_scene(source: Openable, options: SourceOptions) -> Scene:
    """Open a path, ``sample:NAME`` or an xarray DataArray of heights as a scene.

    A note names the options without effect for it.
    """
    if isinstance(source, Scene):
        return source
    watched: Any = WatchedOptions(options)
    if is_data_array(source):
        from touchfield.sources.terrain.height_files import scene_of_xarray

        scene: Scene = scene_of_xarray(source, watched)
    elif not isinstance(source, str | Path):
        raise InvalidArgument("source", f"a {type(source).__name__}", "a path, sample:NAME or a scene")
    elif is_stream(source):
        return StreamScene(source)
    elif is_remote(source):
        scene = StoredScene(read_zarr(source))
    elif str(source).startswith("sample:"):
        from touchfield.sources.samples import sample

        scene = sample(str(source).removeprefix("sample:"), watched)
    else:
        scene = open_source(source, watched)
    unused = [*watched.unread(), *["device_compute"] * (needs_gpu() and not scene.has_gpu)]
    if unused:
        names = ", ".join("--" + name.replace("_", "-") for name in unused)
        scene.notes = (*scene.notes, f"Options that do nothing for this source: {names}.")
    return scene


def is_data_array(source: object) -> TypeGuard[DataArray]:
    """True for an xarray DataArray; xarray is not imported."""
    return type(source).__name__ == "DataArray" and type(source).__module__.partition(".")[0] == "xarray"


def is_stream(source: object) -> bool:
    """True if a source is the path or the address of a ``.touch`` file: any address but that of a store."""
    if not isinstance(source, str | Path):
        return False
    if is_remote(source):
        return not str(source).lower().endswith(".zarr")
    return Path(source).suffix.lower() == ".touch" and Path(source).is_file()


class FixedLatticeScene(StoredScene):
    """A medium on its own lattice, in hand metres: not scaled, not resampled and not clipped.

    `device` has the F_max that limits the output of haptic filters; `objects` are those that the medium is
    made of, if any.
    """

    def __init__(
        self,
        medium: HapticMedium,
        device: Device,
        notes: tuple[str, ...],
        placement: Placement | None = None,
        objects: HapticScene | None = None,
    ) -> None:
        super().__init__(medium)
        self.device, self.placement, self.objects = device, placement or Placement(), objects
        self.tags, self.notes = medium.tags, notes

    @property
    def is_of_bodies(self) -> bool:
        """True if the medium is made of objects."""
        return self.objects is not None


class StreamScene(FixedLatticeScene):
    """A stream's decoded medium and objects, with the device, lattice and placement that it declares.

    The file is closed when the scene and its medium are no longer used. FormatError if it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        reader = TouchReader(path)
        stream = stream_of(reader)
        self.head, self.file_bytes = reader.head, reader.size
        notes: tuple[str, ...] = (
            "A .touch file keeps its own device, lattice and placement; options of the scene do nothing.",
        )
        if reader.has_map:
            notes += (f"{reader.name}: {MAP_LEFT_OUT}",)
        super().__init__(stream.medium, stream.declared_device, notes, stream.placement, stream.scene)


def decode(path: str | Path) -> HapticMedium:
    """The medium of a ``.touch`` file; its frames are decoded on access. FormatError if it cannot be read."""
    return StreamScene(path).stored
