"""source -> device filter (M) -> haptic filters -> medium on the device's lattice (paper 3.1, 3.2, 4.1)."""

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
from touchfield.filters.contact import VibrationRule, add_vibration
from touchfield.filters.device_filter import exact_forces, same_lattice
from touchfield.filters.registry import filter_and_limit
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.perception.hand_motion import Forces
from touchfield.pipeline.decoding import FILTERED, stream_of
from touchfield.pipeline.placement import Mapping, filter_objects, haptic_scene, mapping_of, stored_medium
from touchfield.pipeline.spec import COEFFICIENTS, SOURCE_FORCES, EncodeSpec
from touchfield.sources.options import SourceOptions, WatchedOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.stored import StoredScene

_DEFAULT_PIN_HEIGHTS: Final = 36
"""Heights of a pin display whose profile does not state them: those of the driver `pins`."""

Source = str | Path | Scene | HapticMedium | ForceField
"""Source of an encoding: a path, "sample:NAME", a scene, a medium, or a field (a medium of one frame)."""


def is_stream(source: Source) -> bool:
    """True if a source is the path or the address of a ``.touch`` file."""
    if is_remote(source):
        return True
    if not isinstance(source, str | Path):
        return False
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


class StreamScene(FixedLatticeScene):
    """A stream's decoded medium and objects, with the device, lattice and placement that it declares.

    The file is closed when the scene and its medium are no longer used. FormatError if it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        reader = TouchReader(path)
        stream = stream_of(reader)
        self.head, self.file_bytes = reader.head, reader.size
        notes = (
            "A .touch file keeps its own device, lattice and placement; options of the scene do nothing.",
        )
        super().__init__(stream.medium, stream.declared_device, notes, stream.placement, stream.scene)


def as_source(source: object, device_name: str, grid: Grid | None = None) -> str | Path | Scene:
    """A path or a scene unchanged; a medium, field or array of newtons as a `FixedLatticeScene`.

    An array [nx, ny, nz, 3] or [frame, nx, ny, nz, 3] needs its `grid`. InvalidArgument for anything else.
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
    if isinstance(source, str | Path | Scene):
        return source
    if isinstance(source, np.ndarray):
        found = f"an array {source.shape} without its grid"
    else:
        found = type(source).__name__
    expected = "a path, a scene, a HapticMedium, a ForceField, or an array of newtons and grid="
    raise InvalidArgument("source", found, expected)


def decode(path: str | Path) -> HapticMedium:
    """The medium of a ``.touch`` file; its frames are decoded on access. FormatError if it cannot be read."""
    return StreamScene(path).medium


_MAX_NAMES: Final = 8


@dataclass(frozen=True)
class Prepared:
    """A source after the device filter and the haptic filters.

    `medium` is the voxel representation on the device's lattice. `scene` has the objects, if these are to be
    coded; `medium` is then made of them. ``exact(points_m [n, 3]) -> newtons [n, 3]`` is the field that the
    lattice samples, if it has a formula and no haptic filter changes it. `source` is the scene from which
    `mapping` makes the frames; it reports progress, and notes once they are made. `reference` is the field
    that the error bound refers to: `SOURCE_FORCES` of `touchfield.pipeline.spec` if nothing changed these,
    else `FILTERED`. `has_law` is True if the force law of the spec made the forces, not the source.
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
        """The coder's spec, with every default resolved."""
        return coder(self.spec.coder).resolve(self.spec.coding, self.device.is_array)

    @property
    def learnt(self) -> tuple[str, ...]:
        """Notes of the source that are complete only once all frames have been made."""
        return self.source.late_notes() if self.source is not None else ()

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
    """Open a path or ``sample:NAME`` as a scene; a note names the options without effect for it."""
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
    unused = [*watched.unread(), *["device_compute"] * (needs_gpu() and not scene.has_gpu)]
    if unused:
        names = ", ".join("--" + name.replace("_", "-") for name in unused)
        scene.notes = (*scene.notes, f"Options that do nothing for this source: {names}.")
    return scene


def prepare(source: Source, spec: EncodeSpec | None = None) -> Prepared:
    """Filter a source for a device (paper 3.1, 3.2, 4.1): a lazy medium on the device's lattice.

    A ``.touch`` file is already filtered for its device, and keeps that device, its lattice and its
    placement. A medium or a field keeps its lattice and its forces.
    """
    spec = spec or EncodeSpec()
    scene = open_scene(as_source(source, spec.device), spec.source)
    if spec.frames is not None:
        start, stop = spec.frames
        scene.restrict_frames(start, scene.frame_count if stop is None else stop)

    # mapping M: the placement of the scene in the device's workspace
    mapping, origin = None, scene
    if isinstance(scene, FixedLatticeScene):
        target, placement = scene.device, scene.placement
    else:
        target = device(spec.device)
        spec, bound_notes = _with_pin_bound(spec, target)
        mapping = mapping_of(scene, target, spec)
        placement = mapping.placement
        if mapping.keeps_lattice and isinstance(scene, StoredScene):
            origin = StoredScene(scene.to_the_bit())

    # device filter and haptic filters, of each object or of the whole scene
    objects = _objects(origin, target, mapping, spec)
    if objects is not None:
        medium = objects.voxelise()
    else:
        lattice = mapping.medium(origin) if mapping else origin.medium  # type: ignore[attr-defined]
        medium = filter_and_limit(lattice, spec.chain, target.force_max_n)
    mapping_notes = (*mapping.notes, *bound_notes) if mapping else ()
    notes = (*origin.notes, *mapping_notes, *_object_notes(objects, spec))

    # what the receiver renders besides the force
    coefficients = {name: value for name in COEFFICIENTS if (value := getattr(spec, name)) is not None}
    medium, objects = replace(medium, **coefficients), objects and replace(objects, **coefficients)
    if spec.vibration is not None:
        medium = add_vibration(medium, VibrationRule.parse(spec.vibration), target.force_max_n)
    elif medium.vibration is None and getattr(stored_medium(scene), "vibration", None) is not None:
        notes += ("The vibration of the source is left out: it lies on another lattice, or beside objects",)

    if spec.frames is not None:
        stop = len(medium) if stop is None else stop
        medium, objects = medium.between(start, stop), objects and objects.between(start, stop)
    if objects is not None:
        return Prepared(medium, target, placement, spec, notes, objects, has_law=scene.has_law)
    exact = None
    if mapping and isinstance(origin, AnalyticScene) and not (spec.chain or target.is_array):
        exact = exact_forces(origin, mapping.placement, mapping.profile, target.force_max_n)
    return Prepared(
        medium,
        target,
        placement,
        spec,
        notes,
        exact=exact,
        source=origin if mapping else None,
        reference=_bound_reference(origin, mapping, spec),
        has_law=scene.has_law,
        mapping=mapping,
    )


def _bound_reference(scene: Scene, mapping: Mapping | None, spec: EncodeSpec) -> str:
    """The field that an error bound refers to: the source's own forces if nothing changed them."""
    stored = stored_medium(scene)
    if stored is None or spec.chain:
        return FILTERED
    keeps_forces = mapping is None or same_lattice(mapping.placement.to_scene(mapping.grid), stored.grid)
    return SOURCE_FORCES if keeps_forces else FILTERED


def _with_pin_bound(spec: EncodeSpec, target: Device) -> tuple[EncodeSpec, tuple[str, ...]]:
    """The spec with an error bound of half a pin step if none was requested, and a note on it."""
    defaults, touch, levels = TouchSpec(), spec.touch, target.levels or _DEFAULT_PIN_HEIGHTS
    k = 0.5 / max(levels - 1, 1)
    is_default = (touch.k, touch.f0_n, touch.mode) == (defaults.k, defaults.f0_n, defaults.mode)
    is_requested = spec.coder != "touch" or not is_default
    if target.shows != "height" or is_requested or k >= defaults.k:
        return spec, ()
    f0_n = k * target.force_max_n
    note = f"k {k:.3g} and F_0 {f0_n:.3g} N: every pin within half a step of {levels} heights (--k, --f0-n)"
    return replace(spec, touch=replace(touch, k=k, f0_n=f0_n)), (note,)


def _objects(scene: Scene, target: Device, mapping: Mapping | None, spec: EncodeSpec) -> HapticScene | None:
    """The object representation after the haptic filters; None if voxels are to be coded.

    InvalidArgument if objects are requested of an array, or of a stream of voxels.
    """
    is_requested = spec.representation == "object"
    if is_requested and target.is_array:
        message = f"representation object works with a point device, not with {target.name}"
        raise InvalidArgument(f"{message}: an array pools the depth of the whole scene; take voxel or auto")
    if not is_requested and not _has_automatic_objects(scene, target, spec):
        return None
    if isinstance(scene, FixedLatticeScene):
        objects = scene.objects
    else:
        objects = haptic_scene(scene, mapping) if mapping else None
    if objects is None and is_requested:
        raise InvalidArgument("representation", "object for a stream of voxels", "voxel or auto")
    return objects and filter_objects(objects, spec.chain)


def _has_automatic_objects(scene: Scene, target: Device, spec: EncodeSpec) -> bool:
    """True if the representation "auto" means objects; their fields have no samples that could vibrate."""
    if spec.representation == "voxel" or target.is_array or spec.vibration is not None:
        return False
    return isinstance(scene, BodyScene | FixedLatticeScene) or bool(getattr(scene, "is_of_bodies", False))


def _object_notes(objects: HapticScene | None, spec: EncodeSpec) -> tuple[str, ...]:
    """Notes on the number of objects, and on the rigid ones without any force."""
    if objects is None:
        return ()
    count = len(objects.objects)
    note = f"{count} object{'s' * (count > 1)}, fields with pose tracks"
    if spec.representation == "auto":
        note += "; --representation voxel makes voxels"
    invisible = [
        repr(body.name) for body in objects.objects if body.is_rigid and not body.field(0).support_count
    ]
    if not invisible:
        return (note,)
    names = ", ".join(invisible[:_MAX_NAMES]) + (", ..." if len(invisible) > _MAX_NAMES else "")
    reason = "too small for the lattice, or outside the workspace"
    return note, f"Objects without any force, {reason}: {names}. Check --nw or --mapping."
