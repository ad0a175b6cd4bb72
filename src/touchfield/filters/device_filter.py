"""The device filter: adapts a field to a device (the mapping M of paper section 3.1, "scale or crop,
anti-alias, resample, clip").

Type 1, a point that the hand moves, is filtered by `point_filter`; type 2, an array, by `array_filter`. Both
clip every force to F_max (`limit`); its direction is kept.

Our addition: forces below a fraction of F_max (1 % by default) are dropped at the end. Otherwise the tail of
a low-pass would extend the support by weak samples that every coder must send.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from touchfield.filters.array_filter import array_frames, array_pool
from touchfield.filters.device_spec import DeviceFilter
from touchfield.filters.point_filter import point_frames
from touchfield.medium import HapticMedium

if TYPE_CHECKING:
    from touchfield.sources.scene import Scene


def device_medium(scene: Scene, mapping: DeviceFilter) -> HapticMedium:
    """Return the scene as the device can show it: a lazy medium on the device's lattice, hand metres.

    A stored medium whose lattice is already this one (to within a millionth of a sample) passes unchanged.
    """
    grid, stored = mapping.grid, scene.stored
    if stored is not None and mapping.placement.to_scene(grid).is_close(stored.grid):
        if stored.grid == grid:
            return stored
        vibration_on_grid = (vibration := stored.vibration) and (lambda i: replace(vibration(i), grid=grid))
        return replace(
            stored, grid=grid, make_frame=lambda i: stored[i].on_grid(grid), vibration=vibration_on_grid
        )
    entries = _provenance(scene, mapping)
    frames = array_frames(scene, mapping) if mapping.device.is_array else point_frames(scene, mapping)
    medium = HapticMedium(
        grid, scene.rate_hz, scene.frame_count, frames, axes=scene.axes, tags=scene.tags, provenance=entries
    )
    if stored is not None:
        return replace(medium, **stored.metadata, provenance={**stored.provenance, **entries})
    return medium


def _provenance(scene: Scene, mapping: DeviceFilter) -> dict[str, str]:
    spec, placement = mapping.spec, mapping.placement
    text = f"{spec.low_pass}, oversample {spec.oversample}, floor {spec.force_floor_share:g} of F_max"
    if mapping.device.is_array:
        text += f", pool {array_pool(scene, mapping.device, spec.pool)}, cut-off {spec.cutoff}"
    return {
        "device": mapping.device.name,
        "device_filter": text,
        "placement": f"scale {placement.scale!r}, offset_m {placement.offset_m!r}",
    }
