"""`prepare`: turns a source into a medium on the lattice of a device, ready to be coded. It opens, places,
samples and filters the scene.

The stages are those of the paper (3.1, 3.2, 4.1), each in a module of its own; `prepare` calls them in order:

open the source                                    `source`
place it in the workspace (the mapping M)          `placement`
thicken walls that the lattice cannot hold         `thin_walls`
represent it by samples, or by objects             `touchfield.filters.device_filter`, `objects`
filter it for the hand                             `touchfield.filters.registry`
add what goes with the force, and what is stated   `touchfield.filters.contact`, `notes`, `provenance`
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

from numpy.typing import ArrayLike

from touchfield.codec.registry import coder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.devices import Device, device
from touchfield.filters.contact import VibrationRule, add_vibration
from touchfield.filters.device_filter import device_medium
from touchfield.filters.point_filter import exact_forces
from touchfield.filters.registry import filter_and_limit
from touchfield.medium import Grid, HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.perception.hand_motion import Forces
from touchfield.pipeline.notes import notes_of
from touchfield.pipeline.objects import filter_objects, is_of_objects, objects_of
from touchfield.pipeline.placement import Mapping, mapping_of
from touchfield.pipeline.source import FixedLatticeScene, Source, scene_of
from touchfield.pipeline.spec import COEFFICIENTS, SOURCE_FORCES, EncodeSpec, spec_with
from touchfield.pipeline.stream import FILTERED
from touchfield.pipeline.thin_walls import thicken
from touchfield.sources.scene import Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.stored import StoredScene

_DEFAULT_PIN_HEIGHTS: Final = 36
"""Heights of a pin display whose profile does not state them: those of the driver `pins`."""


def prepare(
    source: Source | ArrayLike, spec: EncodeSpec | None = None, grid: Grid | None = None, **options: Any
) -> Prepared:
    """Filter a source for a device (paper 3.1, 3.2, 4.1): a lazy medium on the device's lattice.

    A ``.touch`` file is already filtered for its device, and keeps that device, its lattice and its
    placement. A medium or a field keeps its lattice and its forces, as does an array of newtons on `grid`.
    `options` are options of `spec` by name: ``prepare(source, nw=6)``.
    """
    spec = spec_with(spec, options)

    # 1. open the source
    scene = scene_of(source, spec, grid)

    # 2. place it in the workspace; a medium on a fixed lattice is there already
    mapping: Mapping | None = None
    pin_notes: tuple[str, ...] = ()
    if isinstance(scene, FixedLatticeScene):
        target, placement = scene.device, scene.placement
    else:
        target = device(spec.device)
        if target.shows == "height":
            spec, pin_notes = _with_pin_bound(spec, target)
        mapping = mapping_of(scene, target, spec)
        placement = mapping.placement
        if mapping.keeps_lattice and isinstance(scene, StoredScene):
            scene = StoredScene(scene.to_the_bit())

    # 3. thicken walls that its lattice cannot hold
    thin_note, original = "", scene
    if mapping is not None:
        scene, thin_note = thicken(scene, mapping, spec, is_of_objects(scene, target, spec))

    # 4. represent it by objects, or by samples of the lattice; the device filter is applied as they are made
    objects = objects_of(scene, target, mapping, spec)

    # 5. filter it for the hand
    if objects is not None:
        objects = filter_objects(objects, spec.chain)
        medium = objects.voxelise()
    else:
        samples = device_medium(scene, mapping) if mapping else scene.stored
        medium = filter_and_limit(samples, spec.chain, target.force_max_n)  # type: ignore[arg-type]

    # 6. add what the receiver renders besides the force, and notes
    coefficients = {name: value for name in COEFFICIENTS if (value := getattr(spec, name)) is not None}
    medium, objects = replace(medium, **coefficients), objects and replace(objects, **coefficients)
    if spec.vibration is not None:
        medium = add_vibration(medium, VibrationRule.parse(spec.vibration), target.force_max_n)
    notes = notes_of(scene, mapping, (*pin_notes, *filter(None, (thin_note,))), objects, medium, spec)

    # 7. take the requested frames, and state what made the forces
    if spec.frames is not None:
        start, stop = spec.frames
        stop = len(medium) if stop is None else stop
        medium, objects = medium.between(start, stop), objects and objects.between(start, stop)
    is_thickened = scene is not original
    prepared = Prepared(
        medium, target, placement, spec, notes, objects, has_law=scene.has_law, is_thickened=is_thickened
    )
    if objects is not None:
        return prepared
    exact = None
    if mapping and isinstance(scene, AnalyticScene) and not (spec.chain or target.is_array):
        exact = exact_forces(scene, mapping.placement, mapping.profile, target.force_max_n)
    return replace(
        prepared,
        exact=exact,
        source=scene if mapping else None,
        reference=_bound_reference(scene, mapping, spec),
        mapping=mapping,
    )


@dataclass(frozen=True)
class Prepared:
    """A source after the device filter and the haptic filters.

    `medium` is the voxel representation on the device's lattice. `objects` are the bodies, if these are to
    be coded; `medium` is then made of them. ``exact(points_m [n, 3]) -> newtons [n, 3]`` is the field that
    the lattice samples, if it has a formula and no haptic filter changes it. `source` is the scene from which
    `mapping` makes the frames; it reports progress, and notes once they are made. `reference` is the field
    that the error bound refers to: `SOURCE_FORCES` of `touchfield.pipeline.spec` if nothing changed these,
    else `FILTERED`. `has_law` is True if the force law of the spec made the forces, not the source.
    `is_thickened` is True if walls that were too thin for the lattice were thickened.
    """

    medium: HapticMedium
    device: Device
    placement: Placement
    spec: EncodeSpec
    notes: tuple[str, ...]
    objects: HapticScene | None = None
    exact: Forces | None = None
    source: Scene | None = None
    reference: str = FILTERED
    has_law: bool = True
    is_thickened: bool = False
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
            "representation": "object" if self.objects else "voxel",
            **({"objects": len(self.objects.objects)} if self.objects else {}),
            **({"vibration": True} if self.medium.vibration else {}),
        }


def _with_pin_bound(spec: EncodeSpec, target: Device) -> tuple[EncodeSpec, tuple[str, ...]]:
    """The spec for pins, bounded by half a step of a pin if no bound was requested, and a note on it."""
    defaults, touch, levels = TouchSpec(), spec.touch, target.levels or _DEFAULT_PIN_HEIGHTS
    k = 0.5 / max(levels - 1, 1)
    is_default = (touch.k, touch.f0_n, touch.mode) == (defaults.k, defaults.f0_n, defaults.mode)
    is_requested = spec.coder != "touch" or not is_default
    if is_requested or k >= defaults.k:
        return spec, ()
    f0_n = k * target.force_max_n
    note = f"k {k:.3g} and F_0 {f0_n:.3g} N: every pin within half a step of {levels} heights (--k, --f0-n)"
    return replace(spec, touch=replace(touch, k=k, f0_n=f0_n)), (note,)


def _bound_reference(scene: Scene, mapping: Mapping | None, spec: EncodeSpec) -> str:
    """The field that an error bound refers to: the source's own forces if nothing changed them."""
    stored = scene.stored
    if stored is None or spec.chain:
        return FILTERED
    keeps_forces = mapping is None or mapping.placement.to_scene(mapping.grid).is_close(stored.grid)
    return SOURCE_FORCES if keeps_forces else FILTERED
