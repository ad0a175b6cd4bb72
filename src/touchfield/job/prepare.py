"""source -> device filter (M) -> haptic filters -> medium, on the device's lattice (paper 3.1, 3.2, 4.1)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import device_medium, same_lattice
from touchfield.filters.exact import exact_forces
from touchfield.filters.lattice import device_grid
from touchfield.filters.placement import Placement
from touchfield.filters.registry import felt_medium
from touchfield.filters.vibration import VibrationRule, vibrating
from touchfield.job.objects import felt_objects, haptic_scene, takes_objects
from touchfield.job.own_lattice import own_lattice
from touchfield.job.promise_kept import FILTERED, OWN_FORCES
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream_scene import Source, StreamScene, as_source, is_stream
from touchfield.medium import Grid, HapticMedium, HapticScene
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.sources.stored import StoredScene
from touchfield.sources.units import unit_notes

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from touchfield.sources.profile import ForceProfile

__all__ = ["FIT_MARGIN", "Prepared", "law_of", "open_scene", "placed_lattice", "prepare"]

FIT_MARGIN: Final = 0.05
"""Of the workspace's shortest side, what a fit leaves free on every side: a hand comes from outside the surface."""

_MOST_NAMES: Final = 8


@dataclass(frozen=True)
class Prepared:
    """A source after the device filter and the haptic filters.

    Attributes
    ----------
    medium : HapticMedium
        The voxel representation, on the device's lattice.
    device : Device
    placement : Placement
    spec : EncodeSpec
    notes : tuple of str
        What the user should be told.
    scene : HapticScene or None
        The object representation, where that is to be coded; `medium` is then made of it.
    exact : callable or None
        ``exact(points_m [n, 3]) -> newtons [n, 3]``, the field that the lattice of `medium` samples, where it has a
        formula and no haptic filter changes it.
    source : Scene or None
        What the frames are made of: it tells how far it is, and what was learnt once they are made.
    reference : str
        What a promise of the coder is held against: `touchfield.job.promise_kept.OWN_FORCES` where nothing changed
        these, else `FILTERED`.
    """

    medium: HapticMedium
    device: Device
    placement: Placement
    spec: EncodeSpec
    notes: tuple[str, ...]
    scene: HapticScene | None = None
    exact: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None
    source: Scene | None = None
    reference: str = FILTERED

    def __repr__(self) -> str:
        return f"<Prepared: {self.medium!r} for {self.device.name}>"

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
    taken = spec
    if spec.vibration is not None and spec.representation == "auto":
        taken = replace(spec, representation="voxel")  # objects have no samples that could vibrate
    mapped = _stored(scene, taken) if isinstance(scene, StreamScene) else _mapped(scene, taken)
    mapped = _vibrating(_rubbing(replace(mapped, spec=spec)), scene)
    if spec.frames is None:
        return mapped
    start, stop = spec.frames
    stop = len(mapped.medium) if stop is None else stop
    cut = mapped.medium.between(start, stop)
    return replace(mapped, medium=cut, scene=mapped.scene.between(start, stop) if mapped.scene else None)


def _rubbing(mapped: Prepared) -> Prepared:
    """With the friction and the damping that are asked for, in place of those of the source (paper 3.2)."""
    given = {name: getattr(mapped.spec, name) for name in ("friction", "damping_n_s_per_m")}
    given = {name: value for name, value in given.items() if value is not None}
    scene = mapped.scene and replace(mapped.scene, **given)
    return replace(mapped, medium=replace(mapped.medium, **given), scene=scene)


def _vibrating(mapped: Prepared, scene: Scene) -> Prepared:
    """With the vibration that is asked for, in place of any that the source has."""
    medium, words = mapped.medium, mapped.spec.vibration
    if words is not None:
        rule = VibrationRule.parse(words)
        return replace(mapped, medium=vibrating(medium, rule, mapped.device.force_max_n))
    stored = getattr(scene, "medium", None)
    if isinstance(stored, HapticMedium) and stored.vibration is not None and medium.vibration is None:
        note = "The vibration of the source is left out: it lies on another lattice, or beside objects"
        return replace(mapped, notes=(*mapped.notes, note))
    return mapped


def _stored(scene: StreamScene, spec: EncodeSpec) -> Prepared:
    """What a stream holds, through the haptic filters."""
    chosen, objects = scene.device(), scene.objects
    is_taken = takes_objects(scene, chosen, spec)
    if is_taken and objects is not None:
        return _of_objects(objects, chosen, scene.placement, spec, scene.notes)
    if spec.representation == "object":
        raise InvalidArgument("representation", "object for a stream of voxels", "voxel or auto")
    medium = felt_medium(scene.medium, spec.chain, chosen.force_max_n)
    reference = FILTERED if spec.chain else OWN_FORCES
    return Prepared(medium, chosen, scene.placement, spec, scene.notes, reference=reference)


def _mapped(scene: Scene, spec: EncodeSpec) -> Prepared:
    """The scene through the mapping M and the haptic filters."""
    chosen = device(spec.device)
    law = law_of(spec, chosen)
    profile = profile_of(law, math.inf if scene.is_solid else law.saturation_m)
    placed = placed_lattice(scene, chosen, spec, profile)
    kept = own_lattice(scene, chosen, spec)
    placement, grid = kept or placed
    length = _told(scene, chosen, placement, spec)
    odd = unit_notes(scene, *_fitted(scene, spec))
    if kept:
        scene = StoredScene(scene.to_the_bit()) if isinstance(scene, StoredScene) else scene
        length += "; the field keeps its own lattice, as it is kept without loss: --nw is not used"
    if takes_objects(scene, chosen, spec):
        objects = haptic_scene(scene, chosen, grid, placement, profile, spec)
        return _of_objects(objects, chosen, placement, spec, (*scene.notes, length, *odd))  # segmentation adds a note
    medium = device_medium(scene, chosen, grid, placement, profile, spec.device_filter)
    exact = None
    if isinstance(scene, AnalyticScene) and not spec.chain and not chosen.is_array:
        exact = exact_forces(scene, placement, profile, chosen.force_max_n)
    felt = felt_medium(medium, spec.chain, chosen.force_max_n)
    stored = getattr(scene, "medium", None)
    is_own = isinstance(stored, HapticMedium) and same_lattice(placement.to_scene(grid), stored.grid)
    reference = OWN_FORCES if is_own and not spec.chain else FILTERED
    notes = (*scene.notes, length, *odd)
    return Prepared(felt, chosen, placement, spec, notes, exact=exact, source=scene, reference=reference)


def _of_objects(
    objects: HapticScene, chosen: Device, placement: Placement, spec: EncodeSpec, notes: tuple[str, ...]
) -> Prepared:
    objects, count = felt_objects(objects, spec.chain), len(objects.objects)
    note = f"{count} object{'s' * (count > 1)}, fields with pose tracks"
    if spec.representation == "auto":
        note += "; --representation voxel makes voxels"
    notes = (*notes, note, *_unfelt(objects))
    return Prepared(objects.voxelise(), chosen, placement, spec, notes, objects)


def _unfelt(objects: HapticScene) -> tuple[str, ...]:
    """A note that names the rigid objects without any force."""
    lost = [repr(one.name) for one in objects.objects if one.is_rigid and not one.field(0).support_count]
    if not lost:
        return ()
    names = ", ".join(lost[:_MOST_NAMES]) + (", ..." if len(lost) > _MOST_NAMES else "")
    return (f"Not felt, as too small for the lattice or outside the workspace: {names} (--nw, --mapping)",)


def law_of(spec: EncodeSpec, chosen: Device) -> LawSpec:
    """The force law that was asked for, with the device's F_max."""
    return LawSpec(
        spec.law,
        spec.stiffness_n_per_m,
        chosen.force_max_n,
        spec.thickness_m,
        spec.band_m,
        spec.surface_damping_n_s_per_m,
    )


def placed_lattice(scene: Scene, chosen: Device, spec: EncodeSpec, profile: ForceProfile) -> tuple[Placement, Grid]:
    """Where the scene lies in the workspace, and the device's lattice over it.

    An array pools the whole depth of the scene, so that its third axis sets no limit to the scale.
    """
    box = scene.bounds_between_m(*_fitted(scene, spec))
    is_stored = isinstance(getattr(scene, "medium", None), HapticMedium)
    reach_m = 0.0 if is_stored else max(0.0, profile.high_m)
    workspace = chosen.workspace_m
    if not chosen.is_array:
        margin_m = reach_m if is_stored or spec.mapping != "fit" else reach_m + FIT_MARGIN * min(workspace)
        return _placement(box, workspace, spec.mapping, margin_m), device_grid(chosen, spec.nw)
    placement = _placement(box, (*workspace[:2], math.inf), spec.mapping, 0.0)
    wall_m = -profile.low_m if math.isfinite(profile.low_m) else 0.0
    depth_m = placement.scale * float(box[1][2] - box[0][2]) + 2 * (reach_m + wall_m)
    return placement, device_grid(chosen, spec.nw, depth_m or None)


def _fitted(scene: Scene, spec: EncodeSpec) -> tuple[int, int]:
    """The frames, start and stop, whose surface is fitted into the workspace."""
    start, stop = spec.fit_frames or spec.frames or (0, None)
    end = scene.frame_count if stop is None else stop
    if not 0 <= start < end <= scene.frame_count:
        name, expected = "fit_frames" if spec.fit_frames else "frames", f"a range within 0:{scene.frame_count}"
        raise InvalidArgument(name, f"{start}:{end}", expected, "Name frames that are there.")
    return start, end


def _told(scene: Scene, chosen: Device, placement: Placement, spec: EncodeSpec) -> str:
    """A note on the scale, and on what was fitted."""
    length = placement.wording
    if chosen.is_array or spec.mapping != "fit" or isinstance(getattr(scene, "medium", None), HapticMedium):
        return length
    start, stop = _fitted(scene, spec)
    frames = f" in frames {start} to {stop - 1}" if scene.frame_count > 1 else ""
    margin_mm = 1e3 * FIT_MARGIN * min(chosen.workspace_m)
    return (
        f"{length}: {scene.box_wording}{frames} fits into the workspace, {margin_mm:.3g} mm of it left on every side"
    )


def _placement(
    box_m: NDArray[np.float64], workspace_m: tuple[float, float, float], mapping: str, margin_m: float
) -> Placement:
    if mapping in ("fit", "fill"):
        return Placement.fit(box_m, workspace_m, margin_m=margin_m)
    if mapping == "crop":
        return Placement.crop(box_m)
    try:
        factor = float(mapping)
    except ValueError:
        raise InvalidArgument("mapping", repr(mapping), "fit, fill, crop, or a factor such as 0.05") from None
    return Placement.scaled(box_m, factor)
