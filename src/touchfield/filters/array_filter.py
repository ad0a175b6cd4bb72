"""Converts a force field to what an array of actuators can show (device type 2, paper section 5.1): one value
for each actuator.

The greatest or mean |F| along the third axis of the scene makes an image, a 2-D low-pass filters it
(`touchfield.filters.smoothing`), and the actuators sample it.

For pins, which show heights, |F| is not a useful image: it grows with the depth below the surface up to F_max
and is as great under a plain as under a mountain. Our addition: pins show the *relief*, the height at which a
finger meets the surface from above (in a camera's scene: from the camera), from 0 for the lowest to F_max for
the highest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float64s, lengths_of
from touchfield.filters.device_spec import DeviceFilter
from touchfield.filters.limit import limit_forces
from touchfield.filters.resample import axis_weights, low_pass
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.grid import Placement, axis_description

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.scene import Scene

ARRAY_OVERSAMPLE: Final = 8  # fewest samples per pitch: the literal cut-off 2/d needs more than 4
DEPTHS_PER_PIECE: Final = 8  # across the narrowest piece of the law: "max" may miss an eighth of its rise
RELIEF_DEPTHS: Final = 128  # at least, from the lowest surface to the highest
MAX_DEPTHS: Final = 4096
MAX_SLAB_SAMPLES: Final = 1 << 25


def array_frames(scene: Scene, mapping: DeviceFilter) -> Callable[[int], ForceField]:
    """Return M(W) of an array by frame, newtons at the actuators."""
    pool = array_pool(scene, mapping.device, mapping.spec.pool)
    fine = _pooled_lattice(scene, mapping, pool)
    force_max_n = mapping.device.force_max_n
    floor_n = force_max_n * mapping.spec.force_floor_share

    def frame(i: int) -> ForceField:
        image = _pooled(scene, i, mapping, pool, fine)
        image_n = _relief(image, fine, mapping) if pool == "relief" else image
        return limit_forces(_at_actuators(image_n, fine, mapping), force_max_n, floor_n)

    return frame


def _pooled_lattice(scene: Scene, mapping: DeviceFilter, pool: str) -> Grid:
    """Return a lattice fine enough for the array's plane and, in depth, for the law or the heights.

    A stored field has no detail between its samples: two samples of this lattice to one of its own are
    enough.
    """
    factor = max(mapping.spec.oversample, ARRAY_OVERSAMPLE)
    nx, ny, _ = mapping.grid.shape
    low, high = mapping.grid.box_m
    finest = [h * mapping.placement.scale / 2 for h in scene.finest_m or (0.0, 0.0, 0.0)]
    fx, fy = (
        min(factor, max(1, math.ceil(s / max(f, s / factor))))
        for s, f in zip(mapping.grid.spacing_m, finest[:2])
    )
    steps = [s / factor for s in mapping.grid.spacing_m[:2]]
    if pool == "relief":
        steps.append(float(np.ptp(relief_m(mapping.grid, mapping.profile))) / RELIEF_DEPTHS)
    else:
        steps += [(b - a) / DEPTHS_PER_PIECE for a, b, _, _ in mapping.profile.pieces]
    step = min(steps)
    depths = min(MAX_DEPTHS, max(1, math.ceil((high[2] - low[2]) / max(step, finest[2]))))
    reach = 2 * low_pass(mapping.spec.low_pass).half_width
    margins = (math.ceil(reach * fx) + 1, math.ceil(reach * fy) + 1, 0)
    return Grid.over_box(low, high, (nx * fx, ny * fy, depths)).padded(margins)


def _pooled(scene: Scene, frame: int, mapping: DeviceFilter, pool: str, fine: Grid) -> Float64s:
    """Return |F| pooled along the depth of a lattice, or the rise of a relief in samples, float64 [x, y]."""
    if scene.stored is not None:
        from touchfield.filters.kernels.forces import pool_depth

        greatest, mean, first, last = pool_depth(scene.stored[frame], mapping.placement.to_scene(fine))
        rise = np.where(last > 0, fine.shape[2] + 1 - first, 0) if is_met_from_low(scene.axes) else last
        image: Float64s = {"max": greatest, "mean": mean, "relief": rise}[pool]
        return image
    law, low_m = mapping.profile, -DEPTHS_PER_PIECE * fine.spacing_m[2]
    if pool == "relief" and low_m < law.low_m:  # the relief does not depend on the thickness of the wall
        law = replace(law, pieces=((low_m, law.low_m, 1.0, 0.0), *law.pieces))
    return _columns(scene, frame, law.rescaled(mapping.placement.scale), pool, fine, mapping.placement)


def _columns(
    scene: Scene, frame: int, law: ForceProfile, pool: str, fine: Grid, placement: Placement
) -> Float64s:
    """Return the greatest or mean |F| of each column, or the number of its first supported sample."""
    bricks_x, bricks_y, _ = fine.brick_shape
    image, count = np.zeros((2, bricks_x, bricks_y, BRICK, BRICK))
    nx, ny, nz = fine.shape
    depth = max(1, MAX_SLAB_SAMPLES // (nx * ny))  # so that even a solid scene needs bounded memory
    for start in range(0, nz, depth):
        origin_m = tuple(fine.to_m((0, 0, start)).tolist())
        slab = Grid((nx, ny, min(depth, nz - start)), fine.spacing_m, origin_m)
        field = scene.field(frame, placement.to_scene(slab), law)
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
    dense = (image / np.maximum(count, 1)).transpose(0, 2, 1, 3).reshape(bricks_x * BRICK, bricks_y * BRICK)
    return dense[:nx, :ny]


def _relief(rise: Float64s, fine: Grid, mapping: DeviceFilter) -> Float64s:
    """Return pin forces, newtons, of columns with their first force `rise` samples from the far end.

    A column without a force is NaN. Samples are the middles of cells: the surface lies about where the
    last cell with a force ends.
    """
    down_m, up_m = relief_m(fine, mapping.profile)
    fraction = np.clip((rise * fine.spacing_m[2] - down_m) / (up_m - down_m), 0.0, 1.0)
    return np.where(rise > 0, mapping.device.force_max_n * fraction, np.nan)


def _at_actuators(image_n: Float64s, fine: Grid, mapping: DeviceFilter) -> ForceField:
    """Low-pass the image and sample it at the actuators, as forces along the array's normal.

    NaN (no surface) has no weight in the low-pass, so that pins are not lower at the edge of a surface.
    """
    is_land = np.isfinite(image_n)
    amplitude = _low_passed(np.where(is_land, image_n, 0.0), fine, mapping)
    if not is_land.all():
        land_fraction = _low_passed(is_land.astype(np.float64), fine, mapping)
        amplitude = np.where(land_fraction > 0.5, amplitude / np.maximum(land_fraction, 0.5), amplitude)
    forces = np.zeros((*mapping.grid.shape, 3))
    forces[:, :, 0, 2] = np.maximum(amplitude, 0)  # ringing must not reverse an actuator
    return ForceField.from_dense(mapping.grid, forces)


def _low_passed(image: Float64s, fine: Grid, mapping: DeviceFilter) -> Float64s:
    for axis in (0, 1):
        axes = [(g.shape[axis], g.spacing_m[axis], g.origin_m[axis]) for g in (fine, mapping.grid)]
        weights = _axis_matrix(axes[0], axes[1], mapping.spec.low_pass, mapping.spec.cutoff)
        image = np.moveaxis(np.tensordot(weights, image, (1, axis)), 0, axis)
    return image


def array_pool(scene: Scene, device: Device, pool: str) -> str:
    """Return how an array's depth is pooled: as requested, or for "auto" what suits scene and device.

    An image for an array has no depth, and a symbolic scene is shown by its force: both take "max".
    """
    if pool != "auto":
        return pool
    is_image, tags = False, scene.tags
    if scene.stored is not None:
        is_image, tags = scene.stored.grid.shape[2] == 1, scene.stored.tags
    has_relief = not is_image and "symbolic" not in tags
    return "relief" if device.shows == "height" and has_relief else "max"


def array_margin_m(law: ForceProfile) -> float:
    """Return the depth margin of an array's lattice on both sides of the surface: the reach of its force."""
    return max(0.0, law.high_m) + (-law.low_m if math.isfinite(law.low_m) else 0.0)


def relief_m(grid: Grid, law: ForceProfile) -> tuple[float, float]:
    """Return the heights, hand metres from the far end of the lattice, of a pin fully down and fully up."""
    depth_m, margin_m = grid.shape[2] * grid.spacing_m[2], array_margin_m(law)
    return (margin_m, depth_m - margin_m) if depth_m > 2 * margin_m else (0.0, depth_m)


def relief_limits_m(scene: Scene, mapping: DeviceFilter) -> tuple[float, float] | None:
    """Return the z of a scene, metres, at which an actuator of a relief is off and full on; else None."""
    if not mapping.device.is_array or array_pool(scene, mapping.device, mapping.spec.pool) != "relief":
        return None
    low, high = mapping.grid.box_m
    far_m, sign = (high[2], -1) if is_met_from_low(scene.axes) else (low[2], 1)
    off_m, on_m = (
        float(mapping.placement.to_scene((0, 0, far_m + sign * z))[2])
        for z in relief_m(mapping.grid, mapping.profile)
    )
    return off_m, on_m


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
