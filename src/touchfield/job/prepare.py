"""source -> device filter (M) -> haptic filters -> medium, on the device's lattice (paper 3.1, 3.2, 4.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from touchfield.arrays import Float64s
from touchfield.codec.registry import coder
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters.contact import VibrationRule, vibrating
from touchfield.filters.device_filter import exact_forces, same_lattice
from touchfield.filters.registry import felt_medium
from touchfield.job.objects import felt_objects, haptic_scene, takes_objects
from touchfield.job.placing import Mapping, mapping_of, stored_medium
from touchfield.job.spec import OWN_FORCES, EncodeSpec
from touchfield.job.stream_scene import Source, StreamScene, as_source, is_stream
from touchfield.medium import HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.sources.stored import StoredScene
from touchfield.stream.opened import FILTERED

Forces = Callable[[Float64s], Float64s]


_MOST_NAMES: Final = 8


@dataclass(frozen=True)
class Prepared:
    """A source after the device filter and the haptic filters.

    `medium` is the voxel representation on the device's lattice; `scene` the objects, where these are to be coded and
    `medium` is made of them. ``exact(points_m [n, 3]) -> newtons [n, 3]`` is the field that the lattice samples,
    where it has a formula and no haptic filter changes it; `source` what the frames are made of: it tells how far it
    is, and what was learnt once they are made; `reference` what a promise of the coder is held against, `OWN_FORCES`
    of `touchfield.job.spec` where nothing changed these, else `FILTERED`.
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
        grid = self.medium.grid
        return {
            "frames": len(self.medium),
            "rate_hz": self.medium.rate_hz,
            "grid_shape": list(grid.shape),
            "spacing_mm": [1e3 * h for h in grid.spacing_m],
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
    """A path, ``sample:NAME`` or a scene, as a scene."""
    if isinstance(source, Scene):
        return source
    if not isinstance(source, str | Path):
        raise InvalidArgument("source", f"a {type(source).__name__}", "a path, sample:NAME or a scene")
    if is_stream(source):
        return StreamScene(source)
    if str(source).startswith("sample:"):
        from touchfield.sources.samples import sample

        return sample(str(source).removeprefix("sample:"), options)
    return open_source(source, options)


def prepare(source: Source, spec: EncodeSpec | None = None) -> Prepared:
    """A source, filtered for a device (paper 3.1, 3.2, 4.1): a lazy medium on the device's lattice.

    A ``.touch`` file has been filtered for its device before: it keeps its device, lattice and placement. A medium or
    a field keeps its lattice and its forces.
    """
    spec = spec or EncodeSpec()
    scene = open_scene(as_source(source, spec.device), spec.source)
    if spec.frames is not None:
        start, stop = spec.frames
        scene.take(start, scene.frame_count if stop is None else stop)

    mapping, origin = None, scene
    if isinstance(scene, StreamScene):
        chosen, placement = scene.device(), scene.placement
    else:
        mapping = mapping_of(scene, device(spec.device), spec)
        chosen, placement = mapping.device, mapping.placement
        if mapping.is_own and isinstance(scene, StoredScene):
            origin = StoredScene(scene.to_the_bit())

    objects = _objects(origin, chosen, mapping, spec)
    if objects is not None:
        medium = objects.voxelise()
    elif isinstance(origin, StreamScene):
        medium = felt_medium(origin.medium, spec.chain, chosen.force_max_n)
    else:
        assert mapping is not None
        medium = felt_medium(mapping.medium(origin), spec.chain, chosen.force_max_n)
    notes = (*origin.notes, *(mapping.notes if mapping else ()), *_notes_of(objects, spec))

    beside = {name: getattr(spec, name) for name in ("friction", "damping_n_s_per_m")}
    beside = {name: value for name, value in beside.items() if value is not None}
    medium, objects = replace(medium, **beside), objects and replace(objects, **beside)
    if spec.vibration is not None:
        medium = vibrating(medium, VibrationRule.parse(spec.vibration), chosen.force_max_n)
    elif _vibrates(scene) and medium.vibration is None:
        notes += ("The vibration of the source is left out: it lies on another lattice, or beside objects",)

    if spec.frames is not None:
        stop = len(medium) if stop is None else stop
        medium, objects = medium.between(start, stop), objects and objects.between(start, stop)
    is_voxel = objects is None
    return Prepared(
        medium,
        chosen,
        placement,
        spec,
        notes,
        objects,
        _exact(origin, mapping, spec) if is_voxel else None,
        origin if is_voxel and mapping else None,
        OWN_FORCES if is_voxel and _keeps_forces(origin, mapping, spec) else FILTERED,
    )


def _objects(scene: Scene, chosen: Device, mapping: Mapping | None, spec: EncodeSpec) -> HapticScene | None:
    """The object representation behind the haptic filters; None where the voxel representation is to be coded."""
    if spec.vibration is not None and spec.representation == "auto":
        return None  # objects have no samples that could vibrate
    if not takes_objects(scene, chosen, spec):
        return None
    objects = scene.objects if isinstance(scene, StreamScene) else haptic_scene(scene, mapping) if mapping else None
    if objects is None and spec.representation == "object":
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


def _vibrates(scene: Scene) -> bool:
    stored = stored_medium(scene)
    return stored is not None and stored.vibration is not None


def _exact(scene: Scene, mapping: Mapping | None, spec: EncodeSpec) -> Forces | None:
    if mapping is None or not isinstance(scene, AnalyticScene) or spec.chain or mapping.device.is_array:
        return None
    return exact_forces(scene, mapping.placement, mapping.profile, mapping.device.force_max_n)


def _keeps_forces(scene: Scene, mapping: Mapping | None, spec: EncodeSpec) -> bool:
    """True where the medium has the very forces of a stored one."""
    stored = stored_medium(scene)
    if spec.chain or stored is None:
        return False
    return mapping is None or same_lattice(mapping.placement.to_scene(mapping.grid), stored.grid)
