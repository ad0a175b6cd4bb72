"""The place of a scene in a device's workspace, the lattice over it, and the same for each of its objects.

The mapping M is of the paper's section 3.1, the object source model of figure 4 (4.3, 5.1). The device filter
works on each body in its own frame, once for a rigid one: two thousand frames cost one field a body. A body
that stays, or deforms, is filtered on the device's own lattice; one that moves on a finer lattice of its own,
of cubes if it turns.
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
    array_pool,
    array_room_m,
    device_grid,
    device_medium,
    is_met_from_low,
    relief_m,
)
from touchfield.filters.registry import FieldFilter, felt_medium
from touchfield.filters.resample import low_pass
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.grid import Placement
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import ForceProfile, profile_of
from touchfield.sources.registry import unit_notes
from touchfield.sources.scene import Body, Scene

FIT_MARGIN: Final = 0.05
"""Of the workspace's shortest side, what a fit leaves free on every side: a hand comes from outside the
surface.
"""
_ROUNDING_M: Final = 1e-9
_MOST_WORKSPACES: Final = 32
_ROOMY: Final = 1 << 24
"""A body that moves has its whole field, also what never comes into the workspace: samples it may have, as a
multiple of the workspace's, and in any case (200 MB)."""
_NAME_BYTES: Final = 256
_ROOM: Final = 2  # samples around a body, beyond the reach of its force and of the low-pass
_VAST: Final = 1 << 16  # samples along an axis on which any filter fits


@dataclass(frozen=True)
class Mapping:
    """The mapping M of one device, for scenes in any frame.

    `grid` is the lattice over the workspace and `profile` the force law, both in hand metres; of `spec` the
    device filter is used, and not the haptic filters; `notes` are on the scale, and on units that look odd.
    `is_own` tells that the lattice is that of a stored field, which is kept without loss.
    """

    device: Device
    grid: Grid
    placement: Placement
    profile: ForceProfile
    spec: EncodeSpec
    notes: tuple[str, ...] = ()
    is_own: bool = False

    def medium(self, scene: Scene) -> HapticMedium:
        """A scene where it is, through the device filter."""
        return device_medium(
            scene, self.device, self.grid, self.placement, self.profile, self.spec.device_filter
        )


def mapping_of(
    scene: Scene, chosen: Device, spec: EncodeSpec, profile: ForceProfile | None = None
) -> Mapping:
    """The mapping of a scene to the workspace of a device; `profile` is by default that of the force law of
    `spec`.

    InvalidArgument if the mapping is unknown, or a field that is kept without loss is larger than the
    workspace.
    """
    own, law = None, spec.law_spec(chosen.force_max_n)
    of_law = profile or profile_of(law, math.inf if scene.is_solid else law.saturation_m)
    placement, grid = _lattice(scene, chosen, spec, of_law)
    if profile is None:
        own = _own_lattice(scene, chosen, spec)
        placement, grid = own or (placement, grid)
    length = _wording(scene, chosen, placement, spec)
    if chosen.is_array and array_pool(scene, chosen, spec.pool) == "relief":
        far_m, sign = (grid.box_m[1][2], -1) if is_met_from_low(scene.axes) else (grid.box_m[0][2], 1)
        ends = [
            placement.to_scene((0, 0, far_m + sign * z))[2] / scene.exaggeration
            for z in relief_m(grid, of_law)
        ]
        one, low, high = (
            ("a pin", "down", "up") if chosen.shows == "height" else ("an actuator", "off", "full on")
        )
        low_m, high_m = np.round(ends, 9)
        length += f"; {one} is {low} at z = {low_m:.4g} m of the scene and {high} at {high_m:.4g} m"
    if own:
        length += "; the field keeps its own lattice, as it is kept without loss: --nw is not used"
    notes = (length, *unit_notes(scene, *_fitted(scene, spec)))
    thin_mm, apart_mm = 1e3 * (spec.thickness_m or math.inf), 1e3 * max(grid.spacing_m)
    if thin_mm < apart_mm and not chosen.is_array:
        gap = f"A wall of {thin_mm:.3g} mm is thinner than the {apart_mm:.3g} mm between samples"
        notes += (f"{gap}: it is weak, and may have gaps (--thickness-m, --nw).",)
    idle = ("nw", "nominal") if chosen.is_array else ("pool", "cutoff")
    if words := ", ".join(f"--{name}" for name in idle if name in spec.asked()):
        notes += (f"Options that do nothing for {chosen.name}: {words}.",)
    return Mapping(chosen, grid, placement, of_law, spec, notes, own is not None)


def stored_medium(scene: Scene) -> HapticMedium | None:
    """The medium of a scene that is a stored field; of any other None."""
    stored = getattr(scene, "medium", None)
    return stored if isinstance(stored, HapticMedium) else None


def _lattice(scene: Scene, chosen: Device, spec: EncodeSpec, profile: ForceProfile) -> tuple[Placement, Grid]:
    """The device's own lattice over the scene; an array pools all of its depth, which sets no limit to the
    scale.
    """
    box = scene.bounds_between_m(*_fitted(scene, spec))
    is_stored = stored_medium(scene) is not None
    workspace = chosen.workspace_m
    if not chosen.is_array:
        reach_m = 0.0 if is_stored else max(0.0, profile.high_m)
        margin_m = reach_m if is_stored or spec.mapping != "fit" else reach_m + FIT_MARGIN * min(workspace)
        return _placement(box, workspace, spec.factor, margin_m), device_grid(chosen, spec.nw)
    placement = _placement(box, (*workspace[:2], math.inf), spec.factor, 0.0)
    depth_m = placement.scale * float(box[1][2] - box[0][2]) + 2 * array_room_m(profile)
    return placement, device_grid(chosen, spec.nw, depth_m or None)


def _own_lattice(scene: Scene, chosen: Device, spec: EncodeSpec) -> tuple[Placement, Grid] | None:
    """The lattice of a stored field that is kept without loss, moved to the middle or scaled; None of all
    else.
    """
    stored = stored_medium(scene)
    if spec.coder != "touch" or spec.touch.mode != "lossless" or chosen.is_array or stored is None:
        return None
    half, box = np.asarray(chosen.workspace_m) / 2 + _ROUNDING_M, np.stack(stored.grid.box_m)
    factor = spec.factor or 1.0
    if factor == 1.0 and (np.abs(box) <= half).all():
        return Placement(), stored.grid
    if not (factor * np.ptp(box, axis=0) <= 2 * half).all():
        size, room = (
            " x ".join(f"{1e3 * side:.4g}" for side in s) for s in (factor * np.ptp(box, axis=0), 2 * half)
        )
        raise InvalidArgument(
            "--lossless-quantised",
            f"a stored field of {size} mm in a workspace of {room} mm",
            "one that fits, as the samples of another lattice would be other forces",
            "Take a larger --device, a --mapping factor that makes it fit, or --mode mask.",
        )
    placement = Placement.scaled(box, factor)
    return placement, placement.to_hand(stored.grid)


def _fitted(scene: Scene, spec: EncodeSpec) -> tuple[int, int]:
    """The frames, start and stop, whose surface is fitted into the workspace."""
    start, stop = spec.fit_frames or spec.frames or (0, None)
    end = scene.frame_count if stop is None else stop
    if not 0 <= start < end <= scene.frame_count:
        name, expected = (
            "fit_frames" if spec.fit_frames else "frames",
            f"a range within 0:{scene.frame_count}",
        )
        raise InvalidArgument(name, f"{start}:{end}", expected, "Name frames that are there.")
    return start, end


def _wording(scene: Scene, chosen: Device, placement: Placement, spec: EncodeSpec) -> str:
    """A note on the scale, and on what was fitted."""
    length = placement.wording
    if scene.exaggeration != 1.0:
        length += f", with heights {scene.exaggeration:g} times what they are"
    if chosen.is_array or spec.mapping != "fit" or stored_medium(scene) is not None:
        return length
    start, stop = _fitted(scene, spec)
    frames = f" in frames {start} to {stop - 1}" if scene.frame_count > 1 else ""
    frames = " in the first picture" if scene.is_captured else frames
    margin_mm = 1e3 * FIT_MARGIN * min(chosen.workspace_m)
    return (
        f"{length}: {scene.box_wording}{frames} fits into the workspace, {margin_mm:.3g} mm of it left on "
        "every side"
    )


def _placement(
    box_m: Float64s, workspace_m: tuple[float, float, float], factor: float | None, margin_m: float
) -> Placement:
    if factor is None:
        return Placement.fit(box_m, workspace_m, margin_m=margin_m)
    return Placement.scaled(box_m, factor)


_FINER: Final = 0.75
"""Spacing of a lattice that moves, of the device's. The receiver interpolates between its samples, which is a
second low-pass: at 1 the forces of `sample:falling-7` differ by 16.6 % (root mean square) from those of the
voxel representation, at 0.75 by 10.0 %, and below 0.5 by more again, because the device's own low-pass is
then missed."""


def felt_objects(scene: HapticScene, chain: Sequence[FieldFilter]) -> HapticScene:
    """The scene with each object's own field through the haptic filters, clipped to F_max behind them.

    A lattice of an object's own grows by what the filters reach; that of the workspace ends where the
    workspace does.
    """
    if not chain:
        return scene

    def felt(one: HapticObject) -> HapticObject:
        roomy = one.medium if one.medium.grid == scene.grid else _with_room(one.medium, chain)
        return replace(one, medium=_kept(felt_medium(roomy, chain, scene.force_max_n)))

    return replace(scene, objects=tuple(map(felt, scene.objects)))


def _kept(medium: HapticMedium) -> HapticMedium:
    """The medium; the field of a single frame is made now, and kept."""
    return HapticMedium.from_frames([medium[0]], medium.rate_hz, medium.axes) if len(medium) == 1 else medium


def _with_room(medium: HapticMedium, chain: Sequence[FieldFilter]) -> HapticMedium:
    """The medium on a lattice larger by what the filters reach together, by whole bricks at its beginning."""
    grid = medium.grid
    vast = Grid(
        (_VAST,) * 3, grid.spacing_m, (0.0, 0.0, 0.0)
    )  # the filter's own reach, not a small lattice's
    reach = np.sum([step.claims(vast).reach for step in chain], axis=0)
    before = -(-reach // BRICK)
    x, y, z = (before * BRICK + grid.shape + reach).tolist()
    roomy = Grid((x, y, z), grid.spacing_m, tuple(grid.to_m(-before * BRICK).tolist()))

    def frame(i: int) -> ForceField:
        field = medium[i]
        return ForceField(roomy, field.bricks + before.astype(np.int32), field.forces_n)

    return replace(medium, grid=roomy, make_frame=frame, vibration=None)


def haptic_scene(scene: Scene, mapping: Mapping) -> HapticScene:
    """The object representation of a scene for a point device, hand metres; before the haptic filters."""
    beside = stored_medium(scene)
    return HapticScene(
        grid=mapping.grid,
        rate_hz=scene.rate_hz,
        objects=tuple(_object(body, mapping) for body in scene.bodies()),
        force_max_n=mapping.device.force_max_n,
        surface_damping_n_s_per_m=mapping.profile.surface_damping_n_s_per_m,
        axes=scene.axes,
        friction=beside.friction if beside else 0.0,
        damping_n_s_per_m=beside.damping_n_s_per_m if beside else 0.0,
        tags=beside.tags if beside else scene.tags,
        provenance={"representation": "object", "device": mapping.device.name},
    )


def _object(body: Body, mapping: Mapping) -> HapticObject:
    plain = "".join(letter if letter.isprintable() else " " for letter in body.name)
    name = plain.encode()[:_NAME_BYTES].decode("utf-8", "ignore")
    count = len(body.track)
    if body.track.is_still:
        rotation, shift = body.track.rotation(0), body.track.positions_m[0]
        is_placed = np.array_equal(rotation, np.eye(3)) and not shift.any()
        placed = body.scene if is_placed else body.scene.moved(rotation, shift)
        return HapticObject(name, _kept(mapping.medium(placed)), PoseTrack.still(count))
    place = mapping.placement
    own = replace(
        mapping, grid=_body_lattice(body, mapping), placement=Placement(place.scale)
    )  # about its origin
    return HapticObject(name, _kept(own.medium(body.scene)), body.track.scaled(place.scale, place.offset_m))


def _body_lattice(body: Body, mapping: Mapping) -> Grid:
    """The lattice of a body that moves, over its own box and what its force and the low-pass reach beyond."""
    never_turns = bool((body.track.quaternions == [1.0, 0.0, 0.0, 0.0]).all())
    spacing = _FINER * np.asarray(mapping.grid.spacing_m)
    if not never_turns:
        spacing = np.full(3, math.exp(np.log(spacing).mean()))
    box = mapping.placement.scale * body.scene.bounds_m()
    low_pass_m = low_pass(mapping.spec.device_filter.low_pass).half_width * 2 * spacing
    margin = max(0.0, mapping.profile.high_m) + low_pass_m + _ROOM * spacing
    first = np.floor((box[0] - margin) / spacing)
    last = np.ceil((box[1] + margin) / spacing)
    most = max(_ROOMY, _MOST_WORKSPACES * mapping.grid.voxel_count)
    if not np.prod(last - first + 1) <= most:
        raise InvalidArgument(
            f"body {body.name}, mapping",
            f"{' x '.join(f'{1e3 * side:.4g}' for side in np.ptp(box, axis=0))} mm of the hand",
            f"at most {most} samples for it, where it needs {np.prod(last - first + 1):.4g}",
            "Take a smaller --mapping or --nw, or --representation voxel.",
        )
    x, y, z = (last - first + 1).astype(int).tolist()
    hx, hy, hz = spacing.tolist()
    ox, oy, oz = (first * spacing).tolist()
    return Grid((x, y, z), (hx, hy, hz), (ox, oy, oz))
