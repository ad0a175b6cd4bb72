"""The device filter: the mapping M of the paper's section 3.1, "scale or crop, anti-alias, resample, clip".

Type 1 (a point that the hand moves): the scene's field is sampled on a lattice `oversample` times finer than
the device's that reaches slightly beyond the workspace. A low-pass takes it to the device's lattice, and
every force is clipped to F_max; its direction is kept. Type 2 (an array): the greatest or mean |F| along the
third axis of the scene makes an image, a 2-D low-pass filters it (`touchfield.filters.smoothing`), and the
actuators sample it (section 5.1).

For pins, which show heights, |F| is not a useful image: it grows with the depth below the surface up to F_max
and is as great under a plain as under a mountain. Our addition: pins show the *relief*, the height at which a
finger meets the surface from above (in a camera's scene: from the camera), from 0 for the lowest to F_max for
the highest.

Our addition: forces below a fraction of F_max (1 % by default) are dropped at the end. Otherwise the tail of
a low-pass would extend the support by samples that no hand can feel and every coder must send.

x_hand = scale * (x_scene - offset), with one scale for all axes, where the paper's mapping may stretch. The
workspace is centred on the origin of the hand's space: x to the right, y up, z towards the user; the scene's
x, y, z lie along them. The lattice has "2^n_w samples per dimension" over the nominal workspace, or is the
nominal lattice of its position resolution, or the N x M actuators of an array on their pitch, laid on the
scene's x and y.
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
from touchfield.medium.grid import Placement, axis_description

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.scene import Scene
    from touchfield.sources.shapes.analytic_scene import AnalyticScene

NW_RANGE: Final = (3, 10)
"""Smallest and largest n_w; the paper uses 5 to 7."""


def require_nw(nw: int | None) -> None:
    """Raise `InvalidArgument` unless n_w is within `NW_RANGE` or None (the nominal lattice)."""
    if nw is not None and not (isinstance(nw, int) and NW_RANGE[0] <= nw <= NW_RANGE[1]):
        expected = f"a whole number from {NW_RANGE[0]} to {NW_RANGE[1]}, or the nominal lattice"
        raise InvalidArgument("nw", repr(nw), expected)


def device_grid(device: Device, nw: int | None = None, depth_m: float | None = None) -> Grid:
    """Return the lattice of a device over its workspace, centred on the origin, hand metres.

    nw : int or None; 2^nw samples along each axis; None for the nominal lattice. Arrays ignore it.
    depth_m : float or None; of an array: the depth of the hand's space to pool; None for the profile's.
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
    """Return the exact force of analytic shapes, clipped to F_max, as a function of points.

    The function is ``forces(points_m float64 [n, 3]) -> newtons [n, 3]``. Points and the force law are in
    metres of the hand.
    """
    law = profile_hand.rescaled(placement.scale)
    offset_m = np.asarray(placement.offset_m)

    def forces(points_m: Float64s) -> Float64s:
        forces_n = scene.forces_n(points_m / placement.scale + offset_m, law)
        size = np.linalg.norm(forces_n, axis=1, keepdims=True)
        return np.asarray(forces_n * (force_max_n / np.maximum(size, force_max_n)))

    return forces


ARRAY_OVERSAMPLE: Final = 8  # fewest samples per pitch: the literal cut-off 2/d needs more than 4
DEPTHS_PER_PIECE: Final = 8  # across the narrowest piece of the law: "max" may miss an eighth of its rise
RELIEF_DEPTHS: Final = 128  # at least, from the lowest surface to the highest
MAX_DEPTHS: Final = 4096
MAX_SLAB_SAMPLES: Final = 1 << 25
POOLS: Final = ("auto", "max", "mean", "relief")


@dataclass(frozen=True)
class DeviceFilterSpec:
    """The options of the device filter."""

    oversample: int = 2  # scene samples per device sample along an axis, 1 to 8; for an array at least 8
    force_floor_share: float = 0.01  # forces below this fraction of F_max are dropped; 0 keeps all
    low_pass: str = "spline"  # a name of `touchfield.filters.LOW_PASSES`
    # of an array: "max" or "mean" of the forces along the depth, the "relief" as met from above, or
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
    """The mapping M of a device: its lattice in hand metres (one sample deep for an array), a placement."""

    device: Device
    grid: Grid
    placement: Placement
    spec: DeviceFilterSpec = DeviceFilterSpec()

    def frames(self, scene: Scene, profile_hand: ForceProfile) -> Callable[[int], ForceField]:
        """Return M(W) by frame, newtons on the device's lattice; `profile_hand` is the law in hand metres.

        If the scene returns the same field object as before, so does the result.
        """
        if self.device.is_array:
            return lambda i: self._limited(self._at_actuators(*self._pooled(scene, i, profile_hand)))
        # finer than the device's lattice, and reaching beyond the workspace
        factor, law = self.spec.oversample, profile_hand.rescaled(self.placement.scale)
        margin = math.ceil(2 * low_pass(self.spec.low_pass).half_width * factor) + 1
        fine = _padded(self.grid.refined(factor), (margin, margin, margin))
        requested = self.placement.to_scene(fine)
        latest: tuple[ForceField, ForceField] | None = None

        def frame(i: int) -> ForceField:
            nonlocal latest
            source, last = scene.field(i, requested, law), latest
            if last is None or last[0] is not source:
                last = latest = (
                    source,
                    self._limited(resample(source.on_grid(fine), self.grid, self.spec.low_pass)),
                )
            return last[1]

        return frame

    def _pooled(self, scene: Scene, frame: int, profile_hand: ForceProfile) -> tuple[Float64s, Grid]:
        """Return |F| pooled along the depth, float64 [x, y], and the lattice that it was sampled on."""
        pool, fine = array_pool(scene, self.device, self.spec.pool), self._array_lattice(scene, profile_hand)
        stored = getattr(scene, "medium", None)
        if isinstance(stored, HapticMedium):
            from touchfield.filters.kernels.forces import pool_depth

            greatest, mean, first, last = pool_depth(stored[frame], self.placement.to_scene(fine))
            rise = np.where(last > 0, fine.shape[2] + 1 - first, 0) if is_met_from_low(scene.axes) else last
            image = {"max": greatest, "mean": mean, "relief": rise}[pool]
        else:
            law, low_m = profile_hand, -DEPTHS_PER_PIECE * fine.spacing_m[2]
            if (
                pool == "relief" and low_m < law.low_m
            ):  # the relief does not depend on the thickness of the wall
                law = replace(law, pieces=((low_m, law.low_m, 1.0, 0.0), *law.pieces))
            image = self._columns(scene, frame, law.rescaled(self.placement.scale), pool, fine)
        return (self._relief(image, fine, profile_hand) if pool == "relief" else image), fine

    def _columns(self, scene: Scene, frame: int, law: ForceProfile, pool: str, fine: Grid) -> Float64s:
        """Return the greatest or mean |F| of each column, or the number of its first supported sample."""
        bricks_x, bricks_y, _ = fine.brick_shape
        image, count = np.zeros((2, bricks_x, bricks_y, BRICK, BRICK))
        nx, ny, nz = fine.shape
        depth = max(1, MAX_SLAB_SAMPLES // (nx * ny))  # so that even a solid scene needs bounded memory
        for start in range(0, nz, depth):
            origin_m = tuple(fine.to_m((0, 0, start)).tolist())
            slab = Grid((nx, ny, min(depth, nz - start)), fine.spacing_m, origin_m)
            field = scene.field(frame, self.placement.to_scene(slab), law)
            columns = tuple(field.bricks[:, :2].T)
            if pool == "relief":
                number = start + BRICK * field.bricks[:, 2, None, None, None] + np.arange(1, BRICK + 1)
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
        """Return pin forces, newtons, of columns with their first force `rise` samples from the far end.

        A column without a force is NaN. Samples are the middles of cells: the surface lies about where the
        last cell with a force ends.
        """
        down_m, up_m = relief_m(fine, law)
        fraction = np.clip((rise * fine.spacing_m[2] - down_m) / (up_m - down_m), 0.0, 1.0)
        return np.where(rise > 0, self.device.force_max_n * fraction, np.nan)

    def _array_lattice(self, scene: Scene, profile_hand: ForceProfile) -> Grid:
        """Return a lattice fine enough for the array's plane and, in depth, for the law or the heights.

        A stored field has no detail between its samples: two samples of this lattice to one of its own are
        enough.
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
        """Low-pass the image and sample it at the actuators, as forces along the array's normal.

        NaN (no surface) has no weight in the low-pass, so that pins are not lower at the edge of a surface.
        """
        is_land = np.isfinite(image_n)
        amplitude = self._low_passed(np.where(is_land, image_n, 0.0), fine)
        if not is_land.all():
            land_fraction = self._low_passed(is_land.astype(np.float64), fine)
            amplitude = np.where(land_fraction > 0.5, amplitude / np.maximum(land_fraction, 0.5), amplitude)
        forces = np.zeros((*self.grid.shape, 3))
        forces[:, :, 0, 2] = np.maximum(amplitude, 0)  # ringing must not reverse an actuator
        return ForceField.from_dense(self.grid, forces)

    def _low_passed(self, image: Float64s, fine: Grid) -> Float64s:
        for axis in (0, 1):
            axes = [(g.shape[axis], g.spacing_m[axis], g.origin_m[axis]) for g in (fine, self.grid)]
            weights = _axis_matrix(axes[0], axes[1], self.spec.low_pass, self.spec.cutoff)
            image = np.moveaxis(np.tensordot(weights, image, (1, axis)), 0, axis)
        return image

    def _limited(self, field: ForceField) -> ForceField:
        force_max = self.device.force_max_n
        return limit_forces(field, force_max, force_max * self.spec.force_floor_share)


def array_pool(scene: Scene, device: Device, pool: str) -> str:
    """Return how an array's depth is pooled: as requested, or for "auto" what suits scene and device.

    An image for an array has no depth, and a symbolic scene is shown by its force: both take "max".
    """
    if pool != "auto":
        return pool
    stored, is_image, tags = getattr(scene, "medium", None), False, scene.tags
    if isinstance(stored, HapticMedium):
        is_image, tags = stored.grid.shape[2] == 1, stored.tags
    has_relief = not is_image and "symbolic" not in tags
    return "relief" if device.shows == "height" and has_relief else "max"


def array_margin_m(law: ForceProfile) -> float:
    """Return the depth margin of an array's lattice on both sides of the surface: the reach of its force."""
    return max(0.0, law.high_m) + (-law.low_m if math.isfinite(law.low_m) else 0.0)


def relief_m(grid: Grid, law: ForceProfile) -> tuple[float, float]:
    """Return the heights, hand metres from the far end of the lattice, of a pin fully down and fully up."""
    depth_m, margin_m = grid.shape[2] * grid.spacing_m[2], array_margin_m(law)
    return (margin_m, depth_m - margin_m) if depth_m > 2 * margin_m else (0.0, depth_m)


def is_met_from_low(axes: str) -> bool:
    """True if the viewer of a scene is at low z ("..., z forward", a camera's axes), else at high z."""
    return "forward" in axis_description(axes, 2)


@lru_cache(maxsize=8)
def _axis_matrix(
    source: tuple[int, float, float], target: tuple[int, float, float], kernel: str, cutoff: str
) -> Float64s:
    """The low-pass along one axis of an array, float64 [actuators, samples]; cached between frames."""
    cutoff_times_pitch = 0.5 if cutoff == "nyquist" else 2.0
    matrix = axis_weights(source, target, low_pass(kernel), cutoff_times_pitch / target[1]).dense(source[0])
    matrix.setflags(write=False)
    return matrix


def limit_forces(field: ForceField, force_max_n: float, floor_n: float = 0.0) -> ForceField:
    """Shorten forces above `force_max_n` to it, keeping their direction, and drop those below `floor_n`.

    No force of the result is longer than `force_max_n`, and the function is idempotent.
    """
    from touchfield.filters.kernels import forces as kernels

    forces, has_force = np.empty_like(field.forces_n), np.zeros(len(field.bricks), np.bool_)
    flat, out = (array.reshape(-1, BRICK**3, 3) for array in (field.forces_n, forces))
    for_chunks(kernels.limit_bricks, len(flat), flat, force_max_n, floor_n, out, has_force, chunk=64)
    return ForceField(field.grid, field.bricks[has_force], forces[has_force])


def device_medium(
    scene: Scene,
    device: Device,
    grid: Grid,
    placement: Placement,
    profile_hand: ForceProfile,
    spec: DeviceFilterSpec | None = None,
) -> HapticMedium:
    """Return the scene as the device can show it: a lazy medium on the device's lattice, hand metres.

    A stored medium whose lattice is already this one (to within a millionth of a sample) passes unchanged.
    """
    stored = getattr(scene, "medium", None)
    if isinstance(stored, HapticMedium) and same_lattice(placement.to_scene(grid), stored.grid):
        if stored.grid == grid:
            return stored
        vibration_on_grid = (vibration := stored.vibration) and (lambda i: replace(vibration(i), grid=grid))
        return replace(
            stored, grid=grid, make_frame=lambda i: stored[i].on_grid(grid), vibration=vibration_on_grid
        )
    mapping = DeviceFilter(device, grid, placement, spec or DeviceFilterSpec())
    entries = _provenance(mapping, array_pool(scene, device, mapping.spec.pool))
    frames = mapping.frames(scene, profile_hand)
    medium = HapticMedium(
        grid, scene.rate_hz, scene.frame_count, frames, axes=scene.axes, tags=scene.tags, provenance=entries
    )
    if isinstance(stored, HapticMedium):
        return replace(medium, **stored.metadata, provenance={**stored.provenance, **entries})
    return medium


def _provenance(mapping: DeviceFilter, pool: str) -> dict[str, str]:
    spec, placement = mapping.spec, mapping.placement
    text = f"{spec.low_pass}, oversample {spec.oversample}, floor {spec.force_floor_share:g} of F_max"
    if mapping.device.is_array:
        text += f", pool {pool}, cut-off {spec.cutoff}"
    return {
        "device": mapping.device.name,
        "device_filter": text,
        "placement": f"scale {placement.scale!r}, offset_m {placement.offset_m!r}",
    }


def same_lattice(a: Grid, b: Grid) -> bool:
    """True if two lattices are equal to within a millionth of a sample."""
    corners_m = [np.stack([g.origin_m, g.to_m(np.subtract(g.shape, 1))]) for g in (a, b)]
    return a.shape == b.shape and bool(
        (np.abs(corners_m[0] - corners_m[1]) < 1e-6 * np.array(b.spacing_m)).all()
    )


def _padded(grid: Grid, margins: tuple[int, int, int]) -> Grid:
    """Extend a lattice by `margins` samples on both sides of each axis."""
    x, y, z = (n + 2 * m for n, m in zip(grid.shape, margins, strict=True))
    return Grid((x, y, z), grid.spacing_m, tuple(grid.to_m(np.negative(margins)).tolist()))
