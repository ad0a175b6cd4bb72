"""The device filter: the mapping M of the paper's section 3.1, "scale or crop, anti-alias, resample, clip".

Type 1 (a point that the hand moves): the scene is asked for its field on a lattice `oversample` times finer
than the device's, a little beyond the workspace too; a low-pass takes it to the device's own, and every force
is clipped to F_max with its direction kept. Type 2 (an array): the greatest or mean |F| along the third axis
of the scene makes an image, a 2-D low-pass filters it (`touchfield.filters.smoothing`), and the actuators
sample it (section 5.1).

Of pins, which show heights, |F| is no image: it grows with the depth below the surface as far as F_max, and
is as great under a plain as under a mountain. Our addition: theirs is the *relief*, the height at which a
finger that comes from above, of a camera's scene from the camera, meets it: the lowest 0 and the highest
F_max.

Our addition: forces below a share of F_max (1 % by default) are dropped at the end: the tail of a low-pass
would otherwise spread the support by samples that no hand can feel and every coder must send.

x_hand = scale * (x_scene - offset), with one scale for all axes: honest, where the paper's mapping may
stretch. The workspace is centred on the origin of the hand's space: along x right, y up, z towards the user;
the scene's x, y, z lie along them. The lattice is "2^n_w samples per dimension" over the nominal workspace,
or the nominal lattice of its position resolution, or the N x M actuators of an array on their pitch, laid on
the scene's x and y.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float64s, lengths_of
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, require_kinds
from touchfield.filters.resample import axis_weights, low_pass, resample
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium
from touchfield.medium.grid import Placement, axis_words

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.scene import Scene
    from touchfield.sources.shapes.analytic_scene import AnalyticScene

NW_RANGE: Final = (3, 10)
"""Least and greatest n_w; the paper takes 5 to 7."""


def require_nw(nw: int | None) -> None:
    """`InvalidArgument` if n_w is not within `NW_RANGE`, nor None, the nominal lattice."""
    if nw is not None and not (isinstance(nw, int) and NW_RANGE[0] <= nw <= NW_RANGE[1]):
        expected = f"a whole number from {NW_RANGE[0]} to {NW_RANGE[1]}, or the nominal lattice"
        raise InvalidArgument("nw", repr(nw), expected)


def device_grid(device: Device, nw: int | None = None, depth_m: float | None = None) -> Grid:
    """The lattice of a device over its workspace, centred on the origin, hand metres.

    nw : int or None; 2^nw samples along each axis; None for the nominal lattice, and of no effect for an
        array.
    depth_m : float or None; of an array: how much of the hand's depth is pooled; None for the profile's.
    Raises `InvalidArgument` if `nw` is not within `NW_RANGE`.
    """
    extents = device.workspace_m
    if device.is_array:
        extents = extents if depth_m is None else (*extents[:2], depth_m)
        shape = device.lattice
    else:
        require_nw(nw)
        shape = device.lattice if nw is None else (2**nw, 2**nw, 2**nw)
    low, high = [-e / 2 for e in extents], [e / 2 for e in extents]
    return Grid.over_box(low, high, shape)


def exact_forces(
    scene: AnalyticScene, placement: Placement, profile_hand: ForceProfile, force_max_n: float
) -> Callable[[Float64s], Float64s]:
    """The force of shapes with a formula, clipped to F_max: ``forces(points_m float64 [n, 3]) -> newtons [n,
    3]``.

    Points and the force law are in metres of the hand.
    """
    law = profile_hand.rescaled(placement.scale)
    offset_m = np.asarray(placement.offset_m)

    def forces(points_m: Float64s) -> Float64s:
        forces_n = scene.forces_n(points_m / placement.scale + offset_m, law)
        size = np.linalg.norm(forces_n, axis=1, keepdims=True)
        return np.asarray(forces_n * (force_max_n / np.maximum(size, force_max_n)))

    return forces


ARRAY_OVERSAMPLE: Final = 8  # least samples to a pitch: the literal cut-off 2/d asks for more than 4
DEPTHS_PER_PIECE: Final = (
    8  # across the narrowest piece of the law: what "max" may miss is an eighth of its rise
)
RELIEF_DEPTHS: Final = 128  # at least, from the lowest surface to the highest
MAX_DEPTHS: Final = 4096
MAX_SLAB_SAMPLES: Final = 1 << 25
POOLS: Final = ("auto", "max", "mean", "relief")


@dataclass(frozen=True)
class DeviceFilterSpec:
    """The options of the device filter."""

    oversample: int = (
        2  # samples of the scene to one of the device along an axis, 1 to 8; an array's at least 8
    )
    force_floor_share: float = 0.01  # forces below this share of F_max are dropped; 0 keeps all
    low_pass: str = "spline"  # a name of `touchfield.filters.LOW_PASSES`
    # of an array: "max" or "mean" of the forces along the depth, the "relief" of what is met from above, or
    # "auto": relief where the device shows heights, else max
    pool: str = "auto"
    cutoff: str = "nyquist"  # of an array of pitch d: 1/(2d), or "literal", 2/d as the paper prints

    def __post_init__(self) -> None:
        require_kinds(self, pool=POOLS, cutoff=("nyquist", "literal"))
        if not 1 <= self.oversample <= 8:
            raise InvalidArgument("oversample", repr(self.oversample), "a whole number from 1 to 8")
        if not 0 <= self.force_floor_share < 1:
            raise InvalidArgument(
                "force_floor_share", repr(self.force_floor_share), "a share from 0 to below 1"
            )
        low_pass(self.low_pass)


@dataclass(frozen=True)
class DeviceFilter:
    """The mapping M of one device, its lattice in hand metres (one sample deep for an array) and a placement."""

    device: Device
    grid: Grid
    placement: Placement
    spec: DeviceFilterSpec = DeviceFilterSpec()

    def frames(self, scene: Scene, profile_hand: ForceProfile) -> Callable[[int], ForceField]:
        """M(W) by frame, newtons on the device's lattice; `profile_hand` is the law in hand metres.

        Where a scene gives the very field that it gave before, the result is given again.
        """
        if self.device.is_array:
            return lambda i: self._limited(self._at_actuators(*self._pooled(scene, i, profile_hand)))
        # finer than the device's lattice, and reaching beyond the workspace
        factor, law = self.spec.oversample, profile_hand.rescaled(self.placement.scale)
        margin = math.ceil(2 * low_pass(self.spec.low_pass).half_width * factor) + 1
        fine = _padded(self.grid.refined(factor), (margin, margin, margin))
        asked = self.placement.to_scene(fine)
        latest: tuple[ForceField, ForceField] | None = None

        def frame(i: int) -> ForceField:
            nonlocal latest
            source, last = scene.field(i, asked, law), latest
            if last is None or last[0] is not source:
                last = latest = (
                    source,
                    self._limited(resample(source.on_grid(fine), self.grid, self.spec.low_pass)),
                )
            return last[1]

        return frame

    def _pooled(self, scene: Scene, frame: int, profile_hand: ForceProfile) -> tuple[Float64s, Grid]:
        """|F| pooled along the depth, float64 [x, y], and the lattice that it was taken on."""
        pool, fine = array_pool(scene, self.device, self.spec.pool), self._array_lattice(scene, profile_hand)
        stored = getattr(scene, "medium", None)
        if isinstance(stored, HapticMedium):
            from touchfield.filters.kernels.forces import pooled

            greatest, mean, first, last = pooled(stored[frame], self.placement.to_scene(fine))
            rise = np.where(last > 0, fine.shape[2] + 1 - first, 0) if is_met_from_low(scene.axes) else last
            image = {"max": greatest, "mean": mean, "relief": rise}[pool]
        else:
            law, low_m = profile_hand, -DEPTHS_PER_PIECE * fine.spacing_m[2]
            if (
                pool == "relief" and low_m < law.low_m
            ):  # what is met from above does not tell how thick its wall is
                law = replace(law, pieces=((low_m, law.low_m, 1.0, 0.0), *law.pieces))
            image = self._columns(scene, frame, law.rescaled(self.placement.scale), pool, fine)
        return (self._relief(image, fine, profile_hand) if pool == "relief" else image), fine

    def _columns(self, scene: Scene, frame: int, law: ForceProfile, pool: str, fine: Grid) -> Float64s:
        """Of the columns of a lattice the greatest or mean |F|, or how many samples from the far end they
        begin.
        """
        bricks_x, bricks_y, _ = fine.brick_shape
        image, count = np.zeros((2, bricks_x, bricks_y, BRICK, BRICK))
        nx, ny, nz = fine.shape
        depth = max(1, MAX_SLAB_SAMPLES // (nx * ny))  # so that even a solid scene needs bounded memory
        for begin in range(0, nz, depth):
            origin_m = tuple(fine.to_m((0, 0, begin)).tolist())
            slab = Grid((nx, ny, min(depth, nz - begin)), fine.spacing_m, origin_m)
            field = scene.field(frame, self.placement.to_scene(slab), law)
            columns = tuple(field.bricks[:, :2].T)
            if pool == "relief":
                number = begin + BRICK * field.bricks[:, 2, None, None, None] + np.arange(1, BRICK + 1)
                number = nz + 1 - number if is_met_from_low(scene.axes) else number
                np.maximum.at(image, columns, np.where(field.mask, number, 0).max(axis=-1))
                continue
            lengths = lengths_of(field.forces_n.astype(np.float64))
            if pool == "max":
                np.maximum.at(image, columns, lengths.max(axis=-1))
            else:
                np.add.at(image, columns, lengths.sum(axis=-1))
                np.add.at(count, columns, np.count_nonzero(field.mask, axis=-1))
        dense = (
            (image / np.maximum(count, 1)).transpose(0, 2, 1, 3).reshape(bricks_x * BRICK, bricks_y * BRICK)
        )
        return dense[:nx, :ny]

    def _relief(self, rise: Float64s, fine: Grid, law: ForceProfile) -> Float64s:
        """Newtons of pins whose columns have their first force `rise` samples from the far end; NaN without
        any.

        Samples are the middles of cells: the surface lies about where the last cell with a force ends.
        """
        down_m, up_m = relief_m(fine, law)
        share = np.clip((rise * fine.spacing_m[2] - down_m) / (up_m - down_m), 0.0, 1.0)
        return np.where(rise > 0, self.device.force_max_n * share, np.nan)

    def _array_lattice(self, scene: Scene, profile_hand: ForceProfile) -> Grid:
        """Fine in the plane of the array, and in depth for the thinnest piece of the law, or for heights.

        A stored field has nothing between its samples: two of the lattice's to one of its own are enough.
        """
        factor = max(self.spec.oversample, ARRAY_OVERSAMPLE)
        nx, ny, _ = self.grid.shape
        low, high = self.grid.box_m
        finest = [h * self.placement.scale / 2 for h in scene.finest_m or (0.0, 0.0, 0.0)]
        fx, fy = (
            min(factor, max(1, math.ceil(s / max(f, s / factor))))
            for s, f in zip(self.grid.spacing_m, finest[:2])
        )
        steps = [s / factor for s in self.grid.spacing_m[:2]]
        if array_pool(scene, self.device, self.spec.pool) == "relief":
            steps.append(float(np.ptp(relief_m(self.grid, profile_hand))) / RELIEF_DEPTHS)
        else:
            steps += [(b - a) / DEPTHS_PER_PIECE for a, b, _, _ in profile_hand.pieces]
        step = min(steps)
        depths = min(MAX_DEPTHS, max(1, math.ceil((high[2] - low[2]) / max(step, finest[2]))))
        reach = 2 * low_pass(self.spec.low_pass).half_width
        margins = (math.ceil(reach * fx) + 1, math.ceil(reach * fy) + 1, 0)
        return _padded(Grid.over_box(low, high, (nx * fx, ny * fy, depths)), margins)

    def _at_actuators(self, image_n: Float64s, fine: Grid) -> ForceField:
        """The image through the low-pass, at the actuators, as forces along the array's normal.

        A pin on land shows its height, and is not lower where the land ends: of NaN the low-pass takes no
        account.
        """
        is_land = np.isfinite(image_n)
        amplitude = self._low_passed(np.where(is_land, image_n, 0.0), fine)
        if not is_land.all():
            share = self._low_passed(is_land.astype(np.float64), fine)
            amplitude = np.where(share > 0.5, amplitude / np.maximum(share, 0.5), amplitude)
        forces = np.zeros((*self.grid.shape, 3))
        forces[:, :, 0, 2] = np.maximum(amplitude, 0)  # a kernel that rings must not turn an actuator round
        return ForceField.from_dense(self.grid, forces)

    def _low_passed(self, image: Float64s, fine: Grid) -> Float64s:
        for axis in (0, 1):
            ends = [(g.shape[axis], g.spacing_m[axis], g.origin_m[axis]) for g in (fine, self.grid)]
            weights = _axis_matrix(ends[0], ends[1], self.spec.low_pass, self.spec.cutoff)
            image = np.moveaxis(np.tensordot(weights, image, (1, axis)), 0, axis)
        return image

    def _limited(self, field: ForceField) -> ForceField:
        force_max = self.device.force_max_n
        return limited(field, force_max, force_max * self.spec.force_floor_share)


def array_pool(scene: Scene, device: Device, pool: str) -> str:
    """The way in which an array's depth is pooled: as was asked, or of "auto" what suits scene and device.

    An image for an array has no depth, and of a symbolic scene the force itself is what is to be shown.
    """
    if pool != "auto":
        return pool
    stored, is_image, tags = getattr(scene, "medium", None), False, scene.tags
    if isinstance(stored, HapticMedium):
        is_image, tags = stored.grid.shape[2] == 1, stored.tags
    has_relief = not is_image and "symbolic" not in tags
    return "relief" if device.shows == "height" and has_relief else "max"


def array_room_m(law: ForceProfile) -> float:
    """Depth of an array's lattice on both sides of the scene's surface: as far as its force reaches."""
    return max(0.0, law.high_m) + (-law.low_m if math.isfinite(law.low_m) else 0.0)


def relief_m(grid: Grid, law: ForceProfile) -> tuple[float, float]:
    """Metres of the hand, from the far end of an array's lattice, at which a pin is all the way down, and up."""
    depth_m, room_m = grid.shape[2] * grid.spacing_m[2], array_room_m(law)
    return (room_m, depth_m - room_m) if depth_m > 2 * room_m else (0.0, depth_m)


def is_met_from_low(axes: str) -> bool:
    """True where who looks at a scene stands at low z, a camera's "..., z forward"; else z is up or to the
    viewer.
    """
    return "forward" in axis_words(axes, 2)


@lru_cache(maxsize=8)
def _axis_matrix(
    source: tuple[int, float, float], target: tuple[int, float, float], kernel: str, cutoff: str
) -> Float64s:
    """The low-pass along one axis of an array, float64 [actuators, samples]; kept, as most frames ask alike."""
    share = 0.5 if cutoff == "nyquist" else 2.0
    matrix = axis_weights(source, target, low_pass(kernel), share / target[1]).dense(source[0])
    matrix.setflags(write=False)
    return matrix


def limited(field: ForceField, force_max_n: float, floor_n: float = 0.0) -> ForceField:
    """Forces longer than `force_max_n` shortened to it, their direction kept, and those below `floor_n`
    dropped.

    No force of the result is longer than `force_max_n`, and doing it again changes nothing.
    """
    from touchfield.filters.kernels import forces as kernels

    forces, is_held = np.empty_like(field.forces_n), np.zeros(len(field.bricks), np.bool_)
    flat, out = (each.reshape(-1, BRICK**3, 3) for each in (field.forces_n, forces))
    for_chunks(kernels.limited, len(flat), flat, force_max_n, floor_n, out, is_held, chunk=64)
    return ForceField(field.grid, field.bricks[is_held], forces[is_held])


def device_medium(
    scene: Scene,
    device: Device,
    grid: Grid,
    placement: Placement,
    profile_hand: ForceProfile,
    spec: DeviceFilterSpec | None = None,
) -> HapticMedium:
    """The scene as the device can show it, a lazy medium on the device's lattice; grid and law in hand
    metres.

    A stored medium whose lattice is already this one (to within a millionth of a sample) passes untouched.
    """
    stored = getattr(scene, "medium", None)
    if isinstance(stored, HapticMedium) and same_lattice(placement.to_scene(grid), stored.grid):
        if stored.grid == grid:
            return stored
        band = (vibration := stored.vibration) and (lambda i: replace(vibration(i), grid=grid))
        return replace(stored, grid=grid, make_frame=lambda i: stored[i].on_grid(grid), vibration=band)
    mapping = DeviceFilter(device, grid, placement, spec or DeviceFilterSpec())
    told = _provenance(mapping, array_pool(scene, device, mapping.spec.pool))
    frames = mapping.frames(scene, profile_hand)
    medium = HapticMedium(
        grid, scene.rate_hz, scene.frame_count, frames, axes=scene.axes, tags=scene.tags, provenance=told
    )
    if isinstance(stored, HapticMedium):
        return replace(medium, **stored.beside, provenance={**stored.provenance, **told})
    return medium


def _provenance(mapping: DeviceFilter, pool: str) -> dict[str, str]:
    spec, placement = mapping.spec, mapping.placement
    words = f"{spec.low_pass}, oversample {spec.oversample}, floor {spec.force_floor_share:g} of F_max"
    if mapping.device.is_array:
        words += f", pool {pool}, cut-off {spec.cutoff}"
    return {
        "device": mapping.device.name,
        "device_filter": words,
        "placement": f"scale {placement.scale!r}, offset_m {placement.offset_m!r}",
    }


def same_lattice(a: Grid, b: Grid) -> bool:
    """Test that two lattices are one, to within a millionth of a sample."""
    ends = [np.stack([g.origin_m, g.to_m(np.subtract(g.shape, 1))]) for g in (a, b)]
    return a.shape == b.shape and bool((np.abs(ends[0] - ends[1]) < 1e-6 * np.array(b.spacing_m)).all())


def _padded(grid: Grid, margins: tuple[int, int, int]) -> Grid:
    """The same lattice with more samples on both sides of each axis."""
    x, y, z = (n + 2 * m for n, m in zip(grid.shape, margins, strict=True))
    return Grid((x, y, z), grid.spacing_m, tuple(grid.to_m(np.negative(margins)).tolist()))
