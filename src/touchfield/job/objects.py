"""scene -> objects: the object source model of figure 4 (paper sections 4.3 and 5.1).

The device filter works on each body in its own frame, once for a rigid one, so that the object representation of two
thousand frames costs one field a body. A body that stays where it is, and one that deforms, is filtered on the
device's own lattice; a body that moves on a somewhat finer lattice of its own, and where it turns of cubes: its axes
are then not those of the workspace for long.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.registry import felt_medium
from touchfield.filters.resample import low_pass
from touchfield.job.placing import Mapping, stored_medium
from touchfield.job.stream_scene import StreamScene
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.sources.animated_mesh import AnimatedMeshScene
from touchfield.sources.body_scene import BodyScene

if TYPE_CHECKING:
    from collections.abc import Sequence

    from touchfield.devices import Device
    from touchfield.filters.registry import FieldFilter
    from touchfield.job.spec import EncodeSpec
    from touchfield.sources.scene import Body, Scene


REPRESENTATIONS: Final = ("auto", "voxel", "object")

_FINER: Final = 0.75
"""Spacing of a lattice that moves, of the device's. The receiver interpolates between its samples, which is a second
low-pass: at 1 the forces of `sample:falling-7` differ by 16.6 % (root mean square) from those of the voxel
representation, at 0.75 by 10.0 %, and below 0.5 by more again, because the device's own low-pass is then missed."""

_MOST_WORKSPACES: Final = 32
_ROOMY: Final = 1 << 24
"""A body that moves has its whole field, also what never comes into the workspace: samples it may have, as a multiple
of the workspace's, and in any case (200 MB)."""

_NAME_BYTES: Final = 256

_ROOM: Final = 2
"""Samples around a body, beyond the reach of its force and of the low-pass."""

_VAST: Final = 1 << 16
"""Samples along an axis on which any filter fits."""


def takes_objects(scene: Scene, chosen: Device, spec: EncodeSpec) -> bool:
    """True where the scene is to be coded as objects.

    InvalidArgument if `spec.representation` is unknown, or objects are asked for an array, which renders no place but
    its own.
    """
    if spec.representation not in REPRESENTATIONS:
        raise InvalidArgument("representation", repr(spec.representation), f"one of {', '.join(REPRESENTATIONS)}")
    if spec.representation == "object" and chosen.is_array:
        said = f"representation object works with a point device, not with {chosen.name}"
        raise InvalidArgument(f"{said}: an array pools the depth of the whole scene; take voxel or auto")
    if spec.representation == "auto":
        if chosen.is_array:
            return False
        return isinstance(scene, BodyScene | StreamScene) or (
            isinstance(scene, AnimatedMeshScene) and scene.is_of_bodies
        )
    return spec.representation == "object"


def felt_objects(scene: HapticScene, chain: Sequence[FieldFilter]) -> HapticScene:
    """The scene with each object's own field through the haptic filters, clipped to F_max behind them.

    A lattice of an object's own grows by what the filters reach; that of the workspace ends where the workspace does.
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
    vast = Grid((_VAST,) * 3, grid.spacing_m, (0.0, 0.0, 0.0))  # the filter's own reach, not a small lattice's
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
    count = len(body.track)
    if body.track.is_still:
        rotation, shift = body.track.rotation(0), body.track.positions_m[0]
        is_placed = np.array_equal(rotation, np.eye(3)) and not shift.any()
        placed = body.scene if is_placed else body.scene.moved(rotation, shift)
        return HapticObject(_label(body.name), _kept(mapping.medium(placed)), PoseTrack.still(count))
    grid = _lattice(body, mapping)
    track = body.track.scaled(mapping.placement.scale, mapping.placement.offset_m)
    return HapticObject(_label(body.name), _kept(mapping.about_origin(grid).medium(body.scene)), track)


def _label(name: str) -> str:
    """A body's name as the format takes one: of its bytes no more than it has room for, no control characters."""
    plain = "".join(letter if letter.isprintable() else " " for letter in name)
    return plain.encode()[:_NAME_BYTES].decode("utf-8", "ignore")


def _lattice(body: Body, mapping: Mapping) -> Grid:
    """The lattice of a body that moves, over its own box and what its force and the low-pass reach beyond.

    InvalidArgument if the body is so much larger than the workspace that its field would not fit in memory.
    """
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
