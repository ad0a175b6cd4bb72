"""Placement of a scene in a device's workspace, the lattice over it, and the same for each object.

The mapping M is that of the paper's section 3.1; the object source model is that of figure 4 (4.3, 5.1). The
device filter works on each body in the body's own frame, once for a rigid body: two thousand frames cost one
field per body. A body that stays in place, or deforms, is filtered on the device's lattice. A body that moves
is filtered on a finer lattice of its own, with cubic cells if it rotates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.devices import Device
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import (
    array_margin_m,
    array_pool,
    device_grid,
    device_medium,
    is_met_from_low,
    relief_m,
)
from touchfield.filters.registry import FieldFilter, filter_and_limit
from touchfield.filters.resample import low_pass
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.grid import Placement
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import ForceProfile, profile_of
from touchfield.sources.registry import unit_notes
from touchfield.sources.scene import Body, Scene

FIT_MARGIN: Final = 0.05
"""Free margin that a fit leaves on every side, as a fraction of the workspace's shortest side.

A hand approaches a surface from outside.
"""
_ROUNDING_M: Final = 1e-9
_MAX_WORKSPACES: Final = 32
"""Limit of the samples of a moving body's field, as a multiple of the workspace's samples.

The field covers the whole body, also the parts that never enter the workspace.
"""
_ALLOWED_SAMPLES: Final = 1 << 24
"""Samples that the field of a moving body may have in any case (200 MB)."""
_NAME_BYTES: Final = 256
_MARGIN_SAMPLES: Final = 2  # samples around a body, beyond the reach of its force and of the low-pass
_UNBOUNDED_SAMPLES: Final = 1 << 16  # samples per axis of a lattice that is larger than any filter's reach


@dataclass(frozen=True)
class Mapping:
    """The mapping M of one device, for scenes in any frame.

    `grid` is the lattice over the workspace and `profile` the force law, both in hand metres. Of `spec` the
    device filter is used, not the haptic filters. `notes` report the scale, and units that look wrong.
    `keeps_lattice` is True if the lattice is that of a stored field, which is kept without loss.
    """

    device: Device
    grid: Grid
    placement: Placement
    profile: ForceProfile
    spec: EncodeSpec
    notes: tuple[str, ...] = ()
    keeps_lattice: bool = False

    def medium(self, scene: Scene) -> HapticMedium:
        """The medium of a scene: device-filtered, in the scene's own position."""
        return device_medium(
            scene, self.device, self.grid, self.placement, self.profile, self.spec.device_filter
        )


def mapping_of(
    scene: Scene, device: Device, spec: EncodeSpec, profile: ForceProfile | None = None
) -> Mapping:
    """The mapping of a scene to the workspace of a device.

    `profile` is by default that of the force law of `spec`. InvalidArgument if the mapping is unknown, or a
    field that is kept without loss is larger than the workspace.
    """
    lossless, law = None, spec.law_spec(device.force_max_n)
    force_profile = profile or profile_of(law, math.inf if scene.is_solid else law.saturation_m)
    placement, grid = _lattice(scene, device, spec, force_profile)
    if profile is None:
        lossless = _lossless_lattice(scene, device, spec)
        placement, grid = lossless or (placement, grid)
    scale_note = _scale_note(scene, device, placement, spec)
    if device.is_array and array_pool(scene, device, spec.pool) == "relief":
        scale_note += _relief_note(scene, device, placement, grid, force_profile)
    if lossless:
        scale_note += "; the field keeps its own lattice, as it is kept without loss: --nw is not used"
    notes = (scale_note, *unit_notes(scene, *_fit_range(scene, spec)), *_option_notes(device, grid, spec))
    return Mapping(device, grid, placement, force_profile, spec, notes, lossless is not None)


def _relief_note(
    scene: Scene, device: Device, placement: Placement, grid: Grid, profile: ForceProfile
) -> str:
    """The heights of the scene, z in metres, at which an actuator of a relief is off and full on."""
    if is_met_from_low(scene.axes):
        back_m, sign = grid.box_m[1][2], -1
    else:
        back_m, sign = grid.box_m[0][2], 1
    limits_m = [
        placement.to_scene((0, 0, back_m + sign * z))[2] / scene.exaggeration for z in relief_m(grid, profile)
    ]
    off_m, on_m = np.round(limits_m, 9)
    if device.shows == "height":
        actuator, off_word, on_word = "a pin", "down", "up"
    else:
        actuator, off_word, on_word = "an actuator", "off", "full on"
    return f"; {actuator} is {off_word} at z = {off_m:.4g} m of the scene and {on_word} at {on_m:.4g} m"


def _option_notes(device: Device, grid: Grid, spec: EncodeSpec) -> tuple[str, ...]:
    """Notes on a wall that is too thin for the lattice, and on options without effect for the device."""
    notes: tuple[str, ...] = ()
    thickness_mm, spacing_mm = 1e3 * (spec.thickness_m or math.inf), 1e3 * max(grid.spacing_m)
    if thickness_mm < spacing_mm and not device.is_array:
        gap = f"A wall of {thickness_mm:.3g} mm is thinner than the {spacing_mm:.3g} mm between samples"
        notes += (f"{gap}: it is weak, and may have gaps (--thickness-m, --nw).",)
    ignored = ("nw", "nominal") if device.is_array else ("pool", "cutoff")
    changed = spec.changed_options()
    unused = ", ".join(f"--{name}" for name in ignored if name in changed)
    if unused:
        notes += (f"Options that do nothing for {device.name}: {unused}.",)
    return notes


def stored_medium(scene: Scene) -> HapticMedium | None:
    """The medium of a scene that is a stored field; None for any other scene."""
    stored = getattr(scene, "medium", None)
    return stored if isinstance(stored, HapticMedium) else None


def _lattice(scene: Scene, device: Device, spec: EncodeSpec, profile: ForceProfile) -> tuple[Placement, Grid]:
    """The placement of a scene and the device's lattice over it.

    An array pools the whole depth of the scene, so that the depth does not limit the scale.
    """
    box = scene.bounds_between_m(*_fit_range(scene, spec))
    is_stored = stored_medium(scene) is not None
    workspace = device.workspace_m
    if not device.is_array:
        reach_m = 0.0 if is_stored else max(0.0, profile.high_m)
        margin_m = reach_m if is_stored or spec.mapping != "fit" else reach_m + FIT_MARGIN * min(workspace)
        return _placement(box, workspace, spec.factor, margin_m), device_grid(device, spec.nw)
    placement = _placement(box, (*workspace[:2], math.inf), spec.factor, 0.0)
    depth_m = placement.scale * float(box[1][2] - box[0][2]) + 2 * array_margin_m(profile)
    return placement, device_grid(device, spec.nw, depth_m or None)


def _lossless_lattice(scene: Scene, device: Device, spec: EncodeSpec) -> tuple[Placement, Grid] | None:
    """The placement and lattice of a stored field that is kept without loss, centred or scaled.

    None for any other scene. InvalidArgument if the field is larger than the workspace.
    """
    stored = stored_medium(scene)
    if spec.coder != "touch" or spec.touch.mode != "lossless" or device.is_array or stored is None:
        return None
    half, box = np.asarray(device.workspace_m) / 2 + _ROUNDING_M, np.stack(stored.grid.box_m)
    factor = spec.factor or 1.0
    if factor == 1.0 and (np.abs(box) <= half).all():
        return Placement(), stored.grid
    sides_m = factor * np.ptp(box, axis=0)
    if not (sides_m <= 2 * half).all():
        raise InvalidArgument(
            "--lossless-quantised",
            f"a stored field of {_sides_mm(sides_m)} mm in a workspace of {_sides_mm(2 * half)} mm",
            "one that fits, as the samples of another lattice would be other forces",
            "Take a larger --device, a --mapping factor that makes it fit, or --mode mask.",
        )
    placement = Placement.scaled(box, factor)
    return placement, placement.to_hand(stored.grid)


def _sides_mm(sides_m: Float64s) -> str:
    return " x ".join(f"{1e3 * side:.4g}" for side in sides_m)


def _fit_range(scene: Scene, spec: EncodeSpec) -> tuple[int, int]:
    """The frames, start and stop, whose surface is fitted into the workspace."""
    start, spec_stop = spec.fit_frames or spec.frames or (0, None)
    stop = scene.frame_count if spec_stop is None else spec_stop
    if not 0 <= start < stop <= scene.frame_count:
        name = "fit_frames" if spec.fit_frames else "frames"
        expected = f"a range within 0:{scene.frame_count}"
        raise InvalidArgument(name, f"{start}:{stop}", expected, "Name frames that exist.")
    return start, stop


def _scale_note(scene: Scene, device: Device, placement: Placement, spec: EncodeSpec) -> str:
    """A note on the scale of a placement, and on the surface and frames that were fitted."""
    note = placement.wording
    if scene.exaggeration != 1.0:
        note += f", with heights {scene.exaggeration:g} times what they are"
    if device.is_array or spec.mapping != "fit" or stored_medium(scene) is not None:
        return note
    start, stop = _fit_range(scene, spec)
    if scene.is_captured:
        frames = " in the first picture"
    else:
        frames = f" in frames {start} to {stop - 1}" if scene.frame_count > 1 else ""
    margin_mm = 1e3 * FIT_MARGIN * min(device.workspace_m)
    return (
        f"{note}: {scene.box_wording}{frames} fits into the workspace, {margin_mm:.3g} mm of it left on "
        "every side"
    )


def _placement(
    box_m: Float64s, workspace_m: tuple[float, float, float], factor: float | None, margin_m: float
) -> Placement:
    if factor is None:
        return Placement.fit(box_m, workspace_m, margin_m=margin_m)
    return Placement.scaled(box_m, factor)


_BODY_SPACING: Final = 0.75
"""Spacing of a moving body's lattice, as a fraction of the device's spacing.

The receiver interpolates between the samples, which is a second low-pass. The forces of `sample:falling-7`
differ from those of the voxel representation by 16.6 % (root mean square) at 1 and by 10.0 % at 0.75. Below
0.5 the difference grows again, because the device's own low-pass is then missing.
"""


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


def haptic_scene(scene: Scene, mapping: Mapping) -> HapticScene:
    """The object representation of a scene for a point device, in hand metres, before the haptic filters."""
    metadata = stored_medium(scene)
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
    if body.track.is_constant:
        rotation, shift = body.track.rotation(0), body.track.positions_m[0]
        is_placed = np.array_equal(rotation, np.eye(3)) and not shift.any()
        placed_scene = body.scene if is_placed else body.scene.moved(rotation, shift)
        medium = _with_single_frame_made(mapping.medium(placed_scene))
        return HapticObject(name, medium, PoseTrack.constant(count))
    placement = mapping.placement
    # the field is about the body's own origin; the track has the offset
    body_mapping = replace(mapping, grid=_body_lattice(body, mapping), placement=Placement(placement.scale))
    medium = _with_single_frame_made(body_mapping.medium(body.scene))
    return HapticObject(name, medium, body.track.scaled(placement.scale, placement.offset_m))


def _body_lattice(body: Body, mapping: Mapping) -> Grid:
    """The lattice of a moving body: its box, and around it the reach of its force and of the low-pass."""
    never_turns = bool((body.track.quaternions == [1.0, 0.0, 0.0, 0.0]).all())
    spacing = _BODY_SPACING * np.asarray(mapping.grid.spacing_m)
    if not never_turns:
        spacing = np.full(3, math.exp(np.log(spacing).mean()))
    box = mapping.placement.scale * body.scene.bounds_m()
    low_pass_m = low_pass(mapping.spec.device_filter.low_pass).half_width * 2 * spacing
    margin = max(0.0, mapping.profile.high_m) + low_pass_m + _MARGIN_SAMPLES * spacing
    first = np.floor((box[0] - margin) / spacing)
    last = np.ceil((box[1] + margin) / spacing)
    max_samples = max(_ALLOWED_SAMPLES, _MAX_WORKSPACES * mapping.grid.voxel_count)
    if not np.prod(last - first + 1) <= max_samples:
        raise InvalidArgument(
            f"body {body.name}, mapping",
            f"{_sides_mm(np.ptp(box, axis=0))} mm of the hand",
            f"at most {max_samples} samples for it, where it needs {np.prod(last - first + 1):.4g}",
            "Take a smaller --mapping or --nw, or --representation voxel.",
        )
    x, y, z = (last - first + 1).astype(int).tolist()
    hx, hy, hz = spacing.tolist()
    ox, oy, oz = (first * spacing).tolist()
    return Grid((x, y, z), (hx, hy, hz), (ox, oy, oz))
