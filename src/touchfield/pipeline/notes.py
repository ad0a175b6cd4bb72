"""Writes the notes that a user sees about a prepared source: its scale, its unit, its objects, and options
that had no effect."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from touchfield.devices import Device
from touchfield.filters.array_filter import relief_limits_m
from touchfield.medium import HapticMedium, HapticScene
from touchfield.pipeline.objects import is_automatic
from touchfield.pipeline.placement import FIT_MARGIN, Mapping
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.scene import Scene

_MAX_NAMES: Final = 8


def notes_of(
    scene: Scene,
    mapping: Mapping | None,
    pin_notes: tuple[str, ...],
    objects: HapticScene | None,
    medium: HapticMedium,
    spec: EncodeSpec,
) -> tuple[str, ...]:
    """All notes on a source that was prepared as `objects`, or as `medium` if these are None."""
    notes = (*scene.notes,)
    if mapping is not None:
        notes += (*_mapping_notes(scene, mapping, spec), *pin_notes)
    if objects is not None:
        notes += _object_notes(objects, spec)
    if objects is not None or (mapping is not None and is_automatic(mapping.device, spec)):
        notes += (*filter(None, (getattr(scene, "overlap_note", ""),)),)
    if medium.vibration is None and scene.stored is not None and scene.stored.vibration is not None:
        notes += ("The vibration of the source is left out: its lattice differs, or the medium has objects",)
    return notes


def _mapping_notes(scene: Scene, mapping: Mapping, spec: EncodeSpec) -> tuple[str, ...]:
    """Notes on the placement of a scene, on its unit, and on options without effect for the device."""
    scale_note = _scale_note(scene, mapping, spec)
    limits_m = relief_limits_m(scene, mapping)
    if limits_m is not None:
        scale_note += _relief_note(limits_m, scene.exaggeration, mapping.device)
    if mapping.keeps_lattice:
        scale_note += "; a lossless file stores the field on its own lattice: --nw is not used"
    return (scale_note, *_unit_notes(scene, mapping), *_option_notes(mapping, spec))


def _scale_note(scene: Scene, mapping: Mapping, spec: EncodeSpec) -> str:
    """A note on the scale of a placement, and on the surface and frames that were fitted."""
    device, note = mapping.device, mapping.placement.wording
    if scene.exaggeration != 1.0:
        note += f", with heights {scene.exaggeration:g} times what they are"
    if device.is_array or spec.mapping != "fit" or scene.stored is not None:
        return note
    start, stop = mapping.fit_frames
    if scene.is_captured:
        frames = " in the first picture"
    else:
        frames = f" in frames {start} to {stop - 1}" if scene.frame_count > 1 else ""
    margin_mm = 1e3 * FIT_MARGIN * min(device.workspace_m)
    return (
        f"{note}: {scene.box_wording}{frames} fits into the workspace, {margin_mm:.3g} mm of it left on "
        "every side"
    )


def _relief_note(limits_m: tuple[float, float], exaggeration: float, device: Device) -> str:
    """The heights, z in metres, at which an actuator of a relief is off and full on."""
    off_m, on_m = np.round([z / exaggeration for z in limits_m], 9)
    if device.shows == "height":
        actuator, off_word, on_word = "a pin", "down", "up"
    else:
        actuator, off_word, on_word = "an actuator", "off", "full on"
    return f"; {actuator} is {off_word} at z = {off_m:.4g} m of the scene and {on_word} at {on_m:.4g} m"


def _unit_notes(scene: Scene, mapping: Mapping) -> tuple[str, ...]:
    """A question about the unit if the size of the scene is unusual; else nothing."""
    if scene.unit is None:
        return ()
    option, low, high = scene.unit
    size_m = float(np.ptp(mapping.fit_box_m, axis=0).max())
    if low <= size_m <= high:
        return ()
    return (f"Is the unit right? The scene measures {size_m:.3g} m across ({option}).",)


def _option_notes(mapping: Mapping, spec: EncodeSpec) -> tuple[str, ...]:
    """Notes on a wall that is too thin for the lattice, and on options without effect for the device."""
    device, grid = mapping.device, mapping.grid
    notes: tuple[str, ...] = ()
    thickness_mm, spacing_mm = 1e3 * (spec.thickness_m or math.inf), 1e3 * max(grid.spacing_m)
    if thickness_mm < spacing_mm and not device.is_array:
        gap = f"A wall of {thickness_mm:.3g} mm is thinner than the {spacing_mm:.3g} mm between samples"
        notes += (f"{gap}: it is weak, and may have gaps (--thickness-m, --nw).",)
    if max(device.workspace_m) < (spec.thickness_m or 0.0):
        unit = f"as metres: {spec.thickness_m:g} mm are --thickness-m {1e-3 * (spec.thickness_m or 0.0):g}"
        notes += (f"Is the unit right? The wall is thicker than the workspace, {unit}.",)
    ignored = ("nw", "nominal") if device.is_array else ("pool", "cutoff")
    changed = spec.changed_options()
    unused = ", ".join(f"--{name}" for name in ignored if name in changed)
    if unused:
        notes += (f"Options that do nothing for {device.name}: {unused}.",)
    return notes


def _object_notes(objects: HapticScene, spec: EncodeSpec) -> tuple[str, ...]:
    """Notes on the number of objects, and on the rigid ones without any force."""
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
