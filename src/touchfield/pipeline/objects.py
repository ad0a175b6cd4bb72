"""Represents a scene by its bodies: one force field for each body in its own frame, and a track of its poses.
The alternative is one field for the whole scene in each frame.

The object source model is that of figure 4 (paper 4.3, 5.1). The device filter works on each body in the
body's own frame, once for a rigid body: two thousand frames cost one field per body. A body that stays in
place, or deforms, is filtered on the device's lattice. A body that moves is filtered on a finer lattice of
its own, with cubic cells if it rotates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.devices import Device
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import device_medium
from touchfield.filters.registry import FieldFilter, filter_and_limit
from touchfield.filters.resample import low_pass
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.grid import Placement
from touchfield.pipeline.placement import Mapping, sides_mm
from touchfield.pipeline.source import FixedLatticeScene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.scene import Body, Scene

_MAX_WORKSPACES: Final = 32
"""Limit of the samples of a moving body's field, as a multiple of the workspace's samples.

The field covers the whole body, also the parts that never enter the workspace.
"""
_ALLOWED_SAMPLES: Final = 1 << 24
"""Samples that the field of a moving body may have in any case (200 MB)."""
_NAME_BYTES: Final = 256
_MARGIN_SAMPLES: Final = 2  # samples around a body, beyond the reach of its force and of the low-pass
_UNBOUNDED_SAMPLES: Final = 1 << 16  # samples per axis of a lattice that is larger than any filter's reach
MOVING_SPACING: Final = 0.75
"""Spacing of a moving body's lattice, as a fraction of the device's spacing.

The receiver interpolates between the samples, which is a second low-pass. The forces of `sample:falling-7`
differ from those of the voxel representation by 16.6 % (root mean square) at 1 and by 10.0 % at 0.75. Below
0.5 the difference grows again, because the device's own low-pass is then missing.
"""


def objects_of(scene: Scene, target: Device, mapping: Mapping | None, spec: EncodeSpec) -> HapticScene | None:
    """The object representation of a scene, device-filtered; None if voxels are to be coded.

    InvalidArgument if objects are requested of an array, or of a stream of voxels.
    """
    is_requested = spec.representation == "object"
    if not is_of_objects(scene, target, spec):
        return None
    if isinstance(scene, FixedLatticeScene):
        objects = scene.objects
    else:
        objects = _haptic_scene(scene, mapping) if mapping else None
    if objects is None and is_requested:
        raise InvalidArgument("representation", "object for a stream of voxels", "voxel or auto")
    return objects


def is_of_objects(scene: Scene, target: Device, spec: EncodeSpec) -> bool:
    """True if objects are coded; "auto" takes voxels for a vibration, which objects have no samples for.

    InvalidArgument if objects are requested of an array.
    """
    if spec.representation == "object":
        if not target.is_array:
            return True
        message = f"representation object works with a point device, not with {target.name}"
        raise InvalidArgument(f"{message}: an array pools the depth of the whole scene; take voxel or auto")
    return is_automatic(target, spec) and scene.is_of_bodies


def is_automatic(target: Device, spec: EncodeSpec) -> bool:
    """True if the scene decides between objects and voxels."""
    return spec.representation == "auto" and not target.is_array and spec.vibration is None


def _haptic_scene(scene: Scene, mapping: Mapping) -> HapticScene:
    """The object representation of a scene for a point device, in hand metres, before the haptic filters."""
    metadata = scene.stored
    return HapticScene(
        grid=mapping.grid,
        rate_hz=scene.rate_hz,
        objects=tuple(_object(body, mapping) for body in scene.bodies()),
        force_max_n=mapping.device.force_max_n,
        surface_damping_n_s_per_m=mapping.profile.surface_damping_n_s_per_m,
        axes=scene.axes,
        friction=metadata.friction if metadata else 0.0,
        damping_n_s_per_m=metadata.damping_n_s_per_m if metadata else 0.0,
        tags=metadata.tags if metadata else scene.tags,
        provenance={"representation": "object", "device": mapping.device.name},
    )


def _object(body: Body, mapping: Mapping) -> HapticObject:
    """The device-filtered field of a body, on the workspace's lattice or its own, with its pose track."""
    printable = "".join(letter if letter.isprintable() else " " for letter in body.name)
    name = printable.encode()[:_NAME_BYTES].decode("utf-8", "ignore")
    count = len(body.track)
    if body.track.is_constant and not body.is_free:
        rotation, shift = body.track.rotation(0), body.track.positions(0)
        is_placed = np.array_equal(rotation, np.eye(3)) and not shift.any()
        placed_scene = body.scene if is_placed else body.scene.moved(rotation, shift)
        medium = _with_single_frame_made(device_medium(placed_scene, mapping))
        return HapticObject(name, medium, PoseTrack.constant(count))
    placement = mapping.placement
    # the field is about the body's own origin; the track has the offset
    body_mapping = replace(mapping, grid=_body_lattice(body, mapping), placement=Placement(placement.scale))
    medium = _with_single_frame_made(device_medium(body.scene, body_mapping))
    return HapticObject(name, medium, body.track.scaled(placement.scale, placement.offset_m))


def turned_spacing_m(spacing_m: Float64s) -> Float64s:
    """The spacing of a body that rotates: cubic cells as large as those given, float64 [3]."""
    return np.full(3, math.exp(np.log(spacing_m).mean()))


def _body_lattice(body: Body, mapping: Mapping) -> Grid:
    """The lattice of a moving body: its box, and around it the reach of its force and of the low-pass."""
    never_turns = not body.is_free and bool((body.track.quaternions == [1.0, 0.0, 0.0, 0.0]).all())
    spacing = MOVING_SPACING * np.asarray(mapping.grid.spacing_m)
    if not never_turns:
        spacing = turned_spacing_m(spacing)
    box = mapping.placement.scale * body.scene.bounds_m()
    low_pass_m = low_pass(mapping.spec.low_pass).half_width * 2 * spacing
    margin = max(0.0, mapping.profile.high_m) + low_pass_m + _MARGIN_SAMPLES * spacing
    first = np.floor((box[0] - margin) / spacing)
    last = np.ceil((box[1] + margin) / spacing)
    max_samples = max(_ALLOWED_SAMPLES, _MAX_WORKSPACES * mapping.grid.voxel_count)
    if not np.prod(last - first + 1) <= max_samples:
        raise InvalidArgument(
            f"body {body.name}, mapping",
            f"{sides_mm(np.ptp(box, axis=0))} mm of the hand",
            f"at most {max_samples} samples for it, where it needs {np.prod(last - first + 1):.4g}",
            "Take a smaller --mapping or --nw, or --representation voxel.",
        )
    x, y, z = (last - first + 1).astype(int).tolist()
    hx, hy, hz = spacing.tolist()
    ox, oy, oz = (first * spacing).tolist()
    return Grid((x, y, z), (hx, hy, hz), (ox, oy, oz))


def filter_objects(scene: HapticScene, chain: Sequence[FieldFilter]) -> HapticScene:
    """Apply the haptic filters to each object's own field, then clip it to F_max.

    An object's own lattice grows by the reach of the filters; the lattice of the workspace does not.
    """
    if not chain:
        return scene

    def filter_object(body: HapticObject) -> HapticObject:
        medium = body.medium if body.medium.grid == scene.grid else _with_filter_margin(body.medium, chain)
        filtered = filter_and_limit(medium, chain, scene.force_max_n)
        return replace(body, medium=_with_single_frame_made(filtered))

    return replace(scene, objects=tuple(map(filter_object, scene.objects)))


def _with_single_frame_made(medium: HapticMedium) -> HapticMedium:
    """The medium; if it has a single frame, the field is made now and stored."""
    return HapticMedium.from_frames([medium[0]], medium.rate_hz, medium.axes) if len(medium) == 1 else medium


def _with_filter_margin(medium: HapticMedium, chain: Sequence[FieldFilter]) -> HapticMedium:
    """The medium on a lattice that is larger by the reach of all filters, at its start by whole bricks."""
    grid = medium.grid
    # a filter's reach is limited by the lattice that it is given
    unbounded = Grid((_UNBOUNDED_SAMPLES,) * 3, grid.spacing_m, (0.0, 0.0, 0.0))
    reach = np.sum([step.claims(unbounded).reach for step in chain], axis=0)
    bricks_before = -(-reach // BRICK)
    x, y, z = (bricks_before * BRICK + grid.shape + reach).tolist()
    larger = Grid((x, y, z), grid.spacing_m, tuple(grid.to_m(-bricks_before * BRICK).tolist()))

    def frame(i: int) -> ForceField:
        field = medium[i]
        return ForceField(larger, field.bricks + bricks_before.astype(np.int32), field.forces_n)

    return replace(medium, grid=larger, make_frame=frame, vibration=None)
