"""The device filter: the mapping M of the paper's section 3.1, "scale or crop, anti-alias, resample, clip".

Type 1 (a point that the hand moves): the scene is asked for its field on a lattice `oversample` times finer than the
device's, a little beyond the workspace too; a low-pass takes it to the device's own, and every force is clipped to
F_max with its direction kept.

Type 2 (an array): the greatest or mean |F| along the third axis of the scene makes an image, a 2-D low-pass filters
it, and the actuators sample it (section 5.1). The cut-offs are those of `touchfield.filters.smoothing`.

Our addition: forces below a share of F_max (1 % by default) are dropped at the end. The tail of a low-pass would
otherwise spread the support by samples that no hand can feel and every coder must send.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.placement import Placement
from touchfield.filters.resample import axis_weights, low_pass, resample
from touchfield.medium import ForceField, Grid, HapticMedium

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.devices import Device
    from touchfield.sources.profile import ForceProfile
    from touchfield.sources.scene import Scene

ARRAY_OVERSAMPLE: Final = 8
"""Least samples to a pitch: the literal cut-off 2/d asks for more than 4."""

DEPTHS_PER_PIECE: Final = 8
"""Depth samples across the narrowest piece of the force law: what "max" may miss is an eighth of its rise."""

MAX_DEPTHS: Final = 4096
MAX_SLAB_SAMPLES: Final = 1 << 25


@dataclass(frozen=True)
class DeviceFilterSpec:
    """The options of the device filter.

    oversample : int; samples of the scene to one of the device along each axis, 1 to 8; an array takes at least 8.
    force_floor_share : float; forces below this share of F_max are dropped; 0 keeps all.
    low_pass : str; a name of `touchfield.filters.LOW_PASSES`.
    pool : str; of an array: "max" or "mean" of the forces along the depth (the mean of those that are there).
    cutoff : str; of an array of pitch d: "nyquist", 1/(2d), or "literal", 2/d as the paper prints.
    """

    oversample: int = 2
    force_floor_share: float = 0.01
    low_pass: str = "spline"
    pool: str = "max"
    cutoff: str = "nyquist"

    def __post_init__(self) -> None:
        if not (isinstance(self.oversample, int) and 1 <= self.oversample <= 8):
            raise InvalidArgument("oversample", repr(self.oversample), "a whole number from 1 to 8")
        if not 0 <= self.force_floor_share < 1:
            raise InvalidArgument("force_floor_share", repr(self.force_floor_share), "a share from 0 to below 1")
        low_pass(self.low_pass)
        for name, choices in (("pool", ("max", "mean")), ("cutoff", ("nyquist", "literal"))):
            if getattr(self, name) not in choices:
                raise InvalidArgument(name, repr(getattr(self, name)), " or ".join(choices))


@dataclass(frozen=True)
class DeviceFilter:
    """The mapping M of one device, lattice and placement.

    grid : Grid; the device's lattice, hand metres (`touchfield.filters.device_grid`); one sample deep for an
        array.
    """

    device: Device
    grid: Grid
    placement: Placement
    spec: DeviceFilterSpec = DeviceFilterSpec()

    def __post_init__(self) -> None:
        if self.device.is_array and self.grid.shape[2] != 1:
            raise InvalidArgument("grid of an array", f"{self.grid.shape[2]} samples deep", "one")

    def __call__(self, scene: Scene, frame: int, profile_hand: ForceProfile) -> ForceField:
        """M(W) of one frame, newtons on the device's lattice; `profile_hand` is the law in hand metres."""
        return self.frames(scene, profile_hand)(frame)

    def frames(self, scene: Scene, profile_hand: ForceProfile) -> Callable[[int], ForceField]:
        """M(W) by frame; where a scene gives the very field that it gave before, the result is given again."""
        if self.device.is_array:
            return lambda i: self._limited(self._at_actuators(*self._pooled(scene, i, profile_hand)))
        fine, law = self._oversampled(), profile_hand.rescaled(self.placement.scale)
        asked = self.placement.to_scene(fine)
        latest: tuple[ForceField, ForceField] | None = None

        def frame(i: int) -> ForceField:
            nonlocal latest
            source, held = scene.field(i, asked, law), latest
            if held is None or held[0] is not source:
                held = latest = source, self._limited(resample(source.on_grid(fine), self.grid, self.spec.low_pass))
            return held[1]

        return frame

    # -- scale or crop ------------------------------------------------------------------------------------

    def _oversampled(self) -> Grid:
        """The lattice on which the scene is asked, hand metres, reaching beyond the workspace."""
        factor, fine = self.spec.oversample, self.grid.refined(self.spec.oversample)
        margin = math.ceil(2 * low_pass(self.spec.low_pass).half_width * factor) + 1
        return _padded(fine, (margin, margin, margin))

    def _scaled(self, scene: Scene, frame: int, profile_hand: ForceProfile, grid: Grid) -> ForceField:
        """The scene's own field at the samples of `grid` (hand metres), relabelled to hand metres."""
        law = profile_hand.rescaled(self.placement.scale)
        return scene.field(frame, self.placement.to_scene(grid), law).on_grid(grid)

    # -- anti-alias and resample --------------------------------------------------------------------------

    def _pooled(self, scene: Scene, frame: int, profile_hand: ForceProfile) -> tuple[NDArray[np.float64], Grid]:
        """|F| pooled along the depth, float64 [x, y], and the lattice that it was taken on."""
        from touchfield.filters.kernels import forces as kernels

        fine = self._array_lattice(scene, profile_hand)
        stored = getattr(scene, "medium", None)
        if isinstance(stored, HapticMedium):
            greatest, mean = kernels.pooled(stored[frame], self.placement.to_scene(fine))
            return (greatest if self.spec.pool == "max" else mean), fine
        nx, ny, _ = fine.brick_shape
        greatest, total = np.zeros((2, nx * 8, ny * 8))
        count = np.zeros((nx * 8, ny * 8), np.int64)
        for slab in _slabs(fine):
            field = self._scaled(scene, frame, profile_hand, slab)
            kernels.add_depths(field.bricks, field.forces_n, greatest, total, count)
        image = greatest if self.spec.pool == "max" else total / np.maximum(count, 1)
        return image[: fine.shape[0], : fine.shape[1]], fine

    def _array_lattice(self, scene: Scene, profile_hand: ForceProfile) -> Grid:
        """Fine in the plane of the array, and deep enough for the thinnest wall of the law.

        A stored field has nothing between its samples: two of the lattice's to one of its own are enough.
        """
        factor = max(self.spec.oversample, ARRAY_OVERSAMPLE)
        nx, ny, _ = self.grid.shape
        low, high = self.grid.box_m
        finest = [h * self.placement.scale / 2 for h in scene.finest_m or (0.0, 0.0, 0.0)]
        fx, fy = (
            min(factor, max(1, math.ceil(s / max(f, s / factor)))) for s, f in zip(self.grid.spacing_m, finest[:2])
        )
        pieces = [b - a for a, b, _, _ in profile_hand.pieces if math.isfinite(b - a)]
        step = min([s / factor for s in self.grid.spacing_m[:2]] + [p / DEPTHS_PER_PIECE for p in pieces])
        depths = min(MAX_DEPTHS, max(1, math.ceil((high[2] - low[2]) / max(step, finest[2]))))
        reach = 2 * low_pass(self.spec.low_pass).half_width
        margins = (math.ceil(reach * fx) + 1, math.ceil(reach * fy) + 1, 0)
        return _padded(Grid.over_box(low, high, (nx * fx, ny * fy, depths)), margins)

    def _at_actuators(self, image_n: NDArray[np.float64], fine: Grid) -> ForceField:
        """The image through the low-pass, at the actuators, as forces along the array's normal."""
        amplitude = image_n
        for axis in (0, 1):
            ends = [(g.shape[axis], g.spacing_m[axis], g.origin_m[axis]) for g in (fine, self.grid)]
            weights = _axis_matrix(ends[0], ends[1], self.spec.low_pass, self.spec.cutoff)
            amplitude = np.tensordot(weights, amplitude, (1, axis))
            amplitude = np.moveaxis(amplitude, 0, axis)
        forces = np.zeros((*self.grid.shape, 3))
        forces[:, :, 0, 2] = np.maximum(amplitude, 0)  # a kernel that rings must not turn an actuator round
        return ForceField.from_dense(self.grid, forces)

    # -- clip and floor -----------------------------------------------------------------------------------

    def _limited(self, field: ForceField) -> ForceField:
        force_max = self.device.force_max_n
        return limited(field, force_max, force_max * self.spec.force_floor_share)


@lru_cache(maxsize=8)
def _axis_matrix(
    source: tuple[int, float, float], target: tuple[int, float, float], kernel: str, cutoff: str
) -> NDArray[np.float64]:
    """The low-pass along one axis of an array, float64 [actuators, samples]; kept, as most frames ask alike."""
    share = 0.5 if cutoff == "nyquist" else 2.0
    matrix = axis_weights(source, target, low_pass(kernel), share / target[1]).dense(source[0])
    matrix.setflags(write=False)
    return matrix


def limited(field: ForceField, force_max_n: float, floor_n: float = 0.0) -> ForceField:
    """Forces longer than `force_max_n` shortened to it, their direction kept, and those below `floor_n` dropped.

    No force of the result is longer than `force_max_n`, and doing it again changes nothing.
    """
    from touchfield.filters.kernels import forces as kernels

    forces, held = kernels.limited(field.forces_n, force_max_n, floor_n)
    return ForceField(field.grid, field.bricks[held], forces[held])


def device_medium(
    scene: Scene,
    device: Device,
    grid: Grid,
    placement: Placement,
    profile_hand: ForceProfile,
    spec: DeviceFilterSpec | None = None,
) -> HapticMedium:
    """The scene as the device can show it, a lazy medium on `grid` in hand metres.

    A stored medium whose lattice is already this one (to within a millionth of a sample) passes untouched:
    neither a second low-pass nor a clip.

    grid : Grid; the device's lattice, hand metres, along the axes of the scene.
    placement : Placement; where the scene lies in the workspace.
    profile_hand : ForceProfile; the force law in hand metres.
    """
    stored = getattr(scene, "medium", None)
    if isinstance(stored, HapticMedium) and same_lattice(placement.to_scene(grid), stored.grid):
        if stored.grid == grid:
            return stored
        band = None if stored.vibration is None else stored.vibration.on_grid(grid)
        return replace(stored, grid=grid, make_frame=lambda i: stored[i].on_grid(grid), vibration=band)
    mapping = DeviceFilter(device, grid, placement, spec or DeviceFilterSpec())
    beside = stored if isinstance(stored, HapticMedium) else None
    return HapticMedium(
        grid,
        scene.rate_hz,
        scene.frame_count,
        mapping.frames(scene, profile_hand),
        axes=scene.axes,
        friction=beside.friction if beside else 0.0,
        damping_n_s_per_m=beside.damping_n_s_per_m if beside else 0.0,
        tags=beside.tags if beside else scene.tags,
        provenance={**(beside.provenance if beside else {}), **_provenance(mapping)},
    )


def _provenance(mapping: DeviceFilter) -> dict[str, str]:
    spec, placement = mapping.spec, mapping.placement
    words = f"{spec.low_pass}, oversample {spec.oversample}, floor {spec.force_floor_share:g} of F_max"
    if mapping.device.is_array:
        words += f", pool {spec.pool}, cut-off {spec.cutoff}"
    return {
        "device": mapping.device.name,
        "device_filter": words,
        "placement": f"scale {placement.scale!r}, offset_m {placement.offset_m!r}",
    }


def same_lattice(a: Grid, b: Grid) -> bool:
    """Test that two lattices are one, to within a millionth of a sample."""
    if a.shape != b.shape:
        return False
    first = np.abs(np.subtract(a.origin_m, b.origin_m)) / b.spacing_m
    last = np.abs(a.to_m(np.subtract(a.shape, 1)) - b.to_m(np.subtract(b.shape, 1))) / b.spacing_m
    return bool(max(first.max(), last.max()) < 1e-6)


def _padded(grid: Grid, margins: tuple[int, int, int]) -> Grid:
    """The same lattice with more samples on both sides of each axis."""
    x, y, z = (n + 2 * m for n, m in zip(grid.shape, margins, strict=True))
    return Grid((x, y, z), grid.spacing_m, tuple(grid.to_m(np.negative(margins)).tolist()))


def _slabs(grid: Grid) -> Iterator[Grid]:
    """The grid in pieces along its depth, so that even a solid scene needs bounded memory."""
    nx, ny, nz = grid.shape
    size = max(1, MAX_SLAB_SAMPLES // (nx * ny))
    for begin in range(0, nz, size):
        origin = grid.to_m((0, 0, begin)).tolist()
        yield Grid((nx, ny, min(size, nz - begin)), grid.spacing_m, tuple(origin))
