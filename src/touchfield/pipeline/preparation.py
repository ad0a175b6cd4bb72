"""source -> device filter (M) -> haptic filters -> medium, on the device's lattice (paper 3.1, 3.2, 4.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.codec.registry import coder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.cuda import needs_gpu
from touchfield.container import TouchReader
from touchfield.container.remote import is_remote
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters.contact import VibrationRule, vibrating
from touchfield.filters.device_filter import exact_forces, same_lattice
from touchfield.filters.registry import felt_medium
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.perception.hand_motion import Forces
from touchfield.pipeline.decoding import FILTERED, opened
from touchfield.pipeline.placement import Mapping, felt_objects, haptic_scene, mapping_of, stored_medium
from touchfield.pipeline.spec import COEFFICIENTS, OWN_FORCES, EncodeSpec
from touchfield.sources.options import SourceOptions, WatchedOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.stored import StoredScene

_HEIGHTS: Final = 36
"""Of pins that state none: as many as adapter `pins` tells apart."""

Source = str | Path | Scene | HapticMedium | ForceField
"""Sources of an encoding: a path or "sample:NAME", a scene, a medium, or a field, which is a medium of one
frame.
"""


def is_stream(source: Source) -> bool:
    """True if a source is a ``.touch`` file, by its name; a scene is none."""
    if is_remote(source):
        return True
    return (
        isinstance(source, str | Path) and Path(source).suffix.lower() == ".touch" and Path(source).is_file()
    )


class KeptScene(StoredScene):
    """A medium on its own lattice in the metres of the hand: neither scaled nor resampled nor clipped.

    It is for a device, whose F_max holds for what haptic filters add, and has its objects if it is made of
    any.
    """

    def __init__(
        self,
        medium: HapticMedium,
        chosen: Device,
        notes: tuple[str, ...],
        placement: Placement | None = None,
        objects: HapticScene | None = None,
    ) -> None:
        super().__init__(medium)
        self.device, self.placement, self.objects = chosen, placement or Placement(), objects
        self.tags, self.notes = medium.tags, notes


class StreamScene(KeptScene):
    """A stream's decoded medium, its objects if it has any, and the device, lattice and placement it was made
    for.

    The file is closed when the scene and its medium are no longer used. FormatError if it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        reader = TouchReader(path)
        stream = opened(reader)
        self.head, self.file_bytes = reader.head, reader.size
        notes = (
            "A .touch file keeps its own device, lattice and placement; options of the scene do nothing.",
        )
        super().__init__(stream.medium, stream.told_device, notes, stream.placement, stream.scene)


def as_source(source: object, device_name: str, grid: Grid | None = None) -> str | Path | Scene:
    """A path or a scene as it is, a medium as a `KeptScene`; newtons [.., nx, ny, nz, 3] are one with their
    grid.

    InvalidArgument if it is none of these, or an array without its grid.
    """
    if grid is not None and not isinstance(source, str | Path | Scene | HapticMedium | ForceField):
        source = HapticMedium.from_array(np.asarray(source), grid)
    if isinstance(source, ForceField):
        source = HapticMedium.from_frames([source], 30.0)
    if isinstance(source, HapticMedium):
        x, y, z = (1e3 * np.ptp(source.grid.box_m, axis=0)).tolist()
        chosen = replace(device(device_name), workspace_mm=(x, y, z), lattice=source.grid.shape)
        notes = ("The medium keeps its own lattice and its forces; options of the scene do nothing.",)
        return KeptScene(source, chosen, notes)
    if isinstance(source, str | Path | Scene):
        return source
    found = (
        f"an array {source.shape} without its grid"
        if isinstance(source, np.ndarray)
        else type(source).__name__
    )
    expected = "a path, a scene, a HapticMedium, a ForceField, or an array of newtons and grid="
    raise InvalidArgument("source", found, expected)


def decode(path: str | Path) -> HapticMedium:
    """The medium of a ``.touch`` file, whose frames are decoded when asked for; FormatError if it cannot be
    read.
    """
    return StreamScene(path).medium


_MOST_NAMES: Final = 8


@dataclass(frozen=True)
class Prepared:
    """A source after the device filter and the haptic filters.

    `medium` is the voxel representation on the device's lattice; `scene` the objects, where these are to be
    coded and `medium` is made of them. ``exact(points_m [n, 3]) -> newtons [n, 3]`` is the field that the
    lattice samples, where it has a formula and no haptic filter changes it; `source` what the frames are made
    of through `mapping`: it tells how far it is, and what was learnt once they are made; `reference` what a
    promise of the coder is held against, `OWN_FORCES` of `touchfield.pipeline.spec` where nothing changed
    these, else `FILTERED`; `has_law` tells whether the force law of the spec made the forces, or the source
    had its own.
    """

    medium: HapticMedium
    device: Device
    placement: Placement
    spec: EncodeSpec
    notes: tuple[str, ...]
    scene: HapticScene | None = None
    exact: Forces | None = None
    source: Scene | None = None
    reference: str = FILTERED
    has_law: bool = True
    mapping: Mapping | None = None

    def __repr__(self) -> str:
        return f"<Prepared: {self.medium!r} for {self.device.name}>"

    @property
    def coding(self) -> Any:
        """The coder's spec, of which nothing is left open."""
        return coder(self.spec.coder).resolve(self.spec.coding, self.device.is_array)

    @property
    def learnt(self) -> tuple[str, ...]:
        """Notes that are known only once the frames have been made."""
        return self.source.learnt() if self.source is not None else ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            "frames": len(self.medium),
            "rate_hz": self.medium.rate_hz,
            "grid_shape": list(self.medium.grid.shape),
            "spacing_mm": [1e3 * h for h in self.medium.grid.spacing_m],
            "device": self.device.name,
            "force_max_n": self.device.force_max_n,
            "mapping_scale": self.placement.scale,
            "mapping_offset_m": list(self.placement.offset_m),
            "axes": self.medium.axes,
            "representation": "object" if self.scene else "voxel",
            **({"objects": len(self.scene.objects)} if self.scene else {}),
            **({"vibration": True} if self.medium.vibration else {}),
        }


def open_scene(source: str | Path | Scene, options: SourceOptions) -> Scene:
    """A path, ``sample:NAME`` or a scene, as a scene; options that do nothing for what it is are told in a
    note.
    """
    if isinstance(source, Scene):
        return source
    if not isinstance(source, str | Path):
        raise InvalidArgument("source", f"a {type(source).__name__}", "a path, sample:NAME or a scene")
    if is_stream(source):
        return StreamScene(source)
    watched: Any = WatchedOptions(options)
    if str(source).startswith("sample:"):
        from touchfield.sources.samples import sample

        scene: Scene = sample(str(source).removeprefix("sample:"), watched)
    else:
        scene = open_source(source, watched)
    idle = [*watched.unread(), *["device_compute"] * (needs_gpu() and not scene.has_gpu)]
    if idle:
        names = ", ".join("--" + name.replace("_", "-") for name in idle)
        scene.notes = (*scene.notes, f"Options that do nothing for this source: {names}.")
    return scene


def prepare(source: Source, spec: EncodeSpec | None = None) -> Prepared:
    """A source, filtered for a device (paper 3.1, 3.2, 4.1): a lazy medium on the device's lattice.

    A ``.touch`` file has been filtered for its device before: it keeps its device, lattice and placement. A
    medium or a field keeps its lattice and its forces.
    """
    spec = spec or EncodeSpec()
    scene = open_scene(as_source(source, spec.device), spec.source)
    if spec.frames is not None:
        start, stop = spec.frames
        scene.take(start, scene.frame_count if stop is None else stop)

    mapping, origin = None, scene
    if isinstance(scene, KeptScene):
        chosen, placement = scene.device, scene.placement
    else:
        chosen = device(spec.device)
        spec, promise = _suited(spec, chosen)
        mapping = mapping_of(scene, chosen, spec)
        placement = mapping.placement
        if mapping.is_own and isinstance(scene, StoredScene):
            origin = StoredScene(scene.to_the_bit())

    objects = _objects(origin, chosen, mapping, spec)
    if objects is not None:
        medium = objects.voxelise()
    else:
        lattice = mapping.medium(origin) if mapping else origin.medium  # type: ignore[attr-defined]
        medium = felt_medium(lattice, spec.chain, chosen.force_max_n)
    notes = (*origin.notes, *((*mapping.notes, *promise) if mapping else ()), *_notes_of(objects, spec))

    beside = {name: value for name in COEFFICIENTS if (value := getattr(spec, name)) is not None}
    medium, objects = replace(medium, **beside), objects and replace(objects, **beside)
    if spec.vibration is not None:
        medium = vibrating(medium, VibrationRule.parse(spec.vibration), chosen.force_max_n)
    elif medium.vibration is None and getattr(stored_medium(scene), "vibration", None) is not None:
        notes += ("The vibration of the source is left out: it lies on another lattice, or beside objects",)

    if spec.frames is not None:
        stop = len(medium) if stop is None else stop
        medium, objects = medium.between(start, stop), objects and objects.between(start, stop)
    if objects is not None:
        return Prepared(medium, chosen, placement, spec, notes, objects, has_law=scene.has_law)
    exact, stored, reference = None, stored_medium(origin), FILTERED
    if mapping and isinstance(origin, AnalyticScene) and not (spec.chain or chosen.is_array):
        exact = exact_forces(origin, mapping.placement, mapping.profile, chosen.force_max_n)
    if stored is not None and not spec.chain:
        is_own = mapping is None or same_lattice(mapping.placement.to_scene(mapping.grid), stored.grid)
        reference = OWN_FORCES if is_own else FILTERED
    made_of = origin if mapping else None
    return Prepared(
        medium, chosen, placement, spec, notes, None, exact, made_of, reference, scene.has_law, mapping
    )


def _suited(spec: EncodeSpec, chosen: Device) -> tuple[EncodeSpec, tuple[str, ...]]:
    """The spec with the promise that pins need where none is asked for: half a step; and a note that tells
    it.
    """
    usual, touch, levels = TouchSpec(), spec.touch, chosen.levels or _HEIGHTS
    k = 0.5 / max(levels - 1, 1)
    is_asked = spec.coder != "touch" or (touch.k, touch.f0_n, touch.mode) != (usual.k, usual.f0_n, usual.mode)
    if chosen.shows != "height" or is_asked or k >= usual.k:
        return spec, ()
    f0_n = k * chosen.force_max_n
    note = f"k {k:.3g} and F_0 {f0_n:.3g} N: every pin within half a step of {levels} heights (--k, --f0-n)"
    return replace(spec, touch=replace(touch, k=k, f0_n=f0_n)), (note,)


def _objects(scene: Scene, chosen: Device, mapping: Mapping | None, spec: EncodeSpec) -> HapticScene | None:
    """The object representation behind the haptic filters; None where the voxel representation is to be
    coded.
    """
    is_asked = spec.representation == "object"
    if is_asked and chosen.is_array:
        said = f"representation object works with a point device, not with {chosen.name}"
        raise InvalidArgument(f"{said}: an array pools the depth of the whole scene; take voxel or auto")
    if not is_asked:  # objects have no samples that could vibrate
        is_of_bodies = isinstance(scene, BodyScene | KeptScene) or getattr(scene, "is_of_bodies", False)
        if (
            spec.representation == "voxel"
            or chosen.is_array
            or spec.vibration is not None
            or not is_of_bodies
        ):
            return None
    objects = (
        scene.objects if isinstance(scene, KeptScene) else haptic_scene(scene, mapping) if mapping else None
    )
    if objects is None and is_asked:
        raise InvalidArgument("representation", "object for a stream of voxels", "voxel or auto")
    return objects and felt_objects(objects, spec.chain)


def _notes_of(objects: HapticScene | None, spec: EncodeSpec) -> tuple[str, ...]:
    """The number of objects, and the names of the rigid ones without any force."""
    if objects is None:
        return ()
    count = len(objects.objects)
    note = f"{count} object{'s' * (count > 1)}, fields with pose tracks"
    if spec.representation == "auto":
        note += "; --representation voxel makes voxels"
    lost = [repr(one.name) for one in objects.objects if one.is_rigid and not one.field(0).support_count]
    if not lost:
        return (note,)
    names = ", ".join(lost[:_MOST_NAMES]) + (", ..." if len(lost) > _MOST_NAMES else "")
    return note, f"Not felt, as too small for the lattice or outside the workspace: {names} (--nw, --mapping)"
