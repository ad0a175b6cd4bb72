"""Compares levels of detail of a field with a low-pass pyramid: errors that a hand can feel, holes and peaks.

    python bench/bench_detail.py [--nw N] [--quick]

Each level is interpolated linearly at the samples of level 0, as a receiver renders it, and compared with
level 0. Four ways to build the levels are compared:

* kept samples: `touchfield.filters.pyramid`.
* decimation: every second sample alone, without the closing of thin walls.
* low-pass: the usual pyramid, cell means by `resample`, level by level.
* signed depth: |F| continues below zero in front of the surface with the median slope of the field, and is
  clipped at zero after the interpolation. It would need support in every receiver.

No force at all has an NMSE of 0 dB and holes everywhere. The ripples have a period of four samples, which is
finer than the levels can show; their phase decides what the kept samples meet.

The figures are:

* beyond: voxels whose error exceeds max(F_0, k |F|), over the supported voxels of level 0; k = 0.1, F_0 =
  0.05 N.
* holes: fraction of the columns along the main direction of the force in which a fifth of the peak or less
  remains.
* peak: median over the columns of the fraction of the peak that remains.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from machine import SHARED, Bar, Figures, at_most, bench
from touchfield import EncodeSpec, prepare
from touchfield.filters import half_grid, interpolate, pyramid, resample
from touchfield.medium import ForceField, Grid

K, F0_N, LEVELS = 0.1, 0.05, 3
SOURCES = ("sample:terrain", "sample:motorcycle", "sample:shapes")
OURS, DECIMATED, LOW_PASS, SIGNED = "kept samples", "decimation", "low-pass", "signed depth"
RIPPLES = {"ripples, 0 deg": 0.0, "ripples, 45 deg": np.pi / 4, "ripples, 90 deg": np.pi / 2}
Float64s = NDArray[np.float64]


def lengths(forces_n: Float64s) -> Float64s:
    """Return |F| along the last axis."""
    return np.asarray(np.sqrt((forces_n**2).sum(axis=-1)))


def low_pass(field: ForceField) -> list[ForceField]:
    """Return the usual pyramid, whose cells take two samples along each axis."""
    levels = [field]
    for _ in range(LEVELS):
        grid = levels[-1].grid
        origin, spacing = np.array(grid.origin_m), np.array(grid.spacing_m)
        (nx, ny, nz), low = (-(-n // 2) for n in grid.shape), origin - spacing / 2
        shape = nx, ny, nz
        levels.append(resample(levels[-1], Grid.over_box(low, low + 2 * spacing * shape, shape), "spline"))
    return levels


def decimated(field: ForceField) -> list[ForceField]:
    """Return every second sample along each axis, level by level."""
    levels = [field]
    for _ in range(LEVELS):
        every_second = levels[-1].to_dense()[::2, ::2, ::2]
        levels.append(ForceField.from_dense(half_grid(levels[-1].grid), every_second))
    return levels


def ripples(nw: int, phase: float) -> ForceField:
    """Return a wall of four samples behind ripples of one sample's height and four samples' period."""
    n = 1 << nw
    x, y, z = np.indices((n, n, n), np.float64)
    slope = np.pi / 2 * np.cos(np.pi / 2 * x + phase)
    steepness = np.sqrt(1 + slope**2)
    depth = (n / 2 + np.sin(np.pi / 2 * x + phase) - z) / steepness
    is_wall = (depth > 0) & (depth < 4) & (np.minimum(x, y) >= 4) & (np.maximum(x, y) < n - 4)
    normal = np.stack([-slope, np.zeros_like(slope), np.ones_like(slope)], axis=-1) / steepness[..., None]
    forces = np.where(is_wall, 0.5 * depth, 0)[..., None] * normal
    return ForceField.from_dense(
        Grid.over_box((-0.05,) * 3, (0.05,) * 3, (n, n, n)), forces.astype(np.float32)
    )


def signed(field: ForceField, level: int) -> Float64s:
    """Interpolate level 0 from signed depth and direction, float64 [x, y, z, 3].

    Every 2^level-th sample along each axis is used.
    """
    forces, h = field.to_dense().astype(np.float64), np.asarray(field.grid.spacing_m)
    size = lengths(forces)
    supported = size > 0
    slope = np.sqrt(sum(g**2 for g in np.gradient(size, *h)))
    inner = ndimage.binary_erosion(supported)
    away, nearest = ndimage.distance_transform_edt(~supported, sampling=h, return_indices=True)
    at = tuple(nearest)
    depth = np.where(supported, size, size[at] - float(np.median(slope[inner])) * away)
    direction = (forces / np.maximum(size, 1e-12)[..., None])[at]
    level_samples = np.concatenate([depth[..., None], direction], axis=-1)[
        (slice(None, None, 1 << level),) * 3
    ]
    where = np.stack(np.meshgrid(*(np.arange(n) / (1 << level) for n in field.grid.shape), indexing="ij"))
    interpolated = [
        ndimage.map_coordinates(level_samples[..., c], where, order=1, mode="nearest") for c in range(4)
    ]
    directions = np.stack(interpolated[1:], axis=-1)
    unit = directions / np.maximum(lengths(directions), 1e-12)[..., None]
    return np.asarray(np.maximum(interpolated[0], 0)[..., None] * unit)


def losses(original: Float64s, rendered: Float64s) -> Figures:
    """Return violations, NMSE, holes and peaks of a rendered level."""
    size, error = lengths(original), lengths(rendered - original)
    beyond = error > np.maximum(F0_N, K * size) * (1 + 1e-6)
    axis = int(np.abs(original).sum(axis=(0, 1, 2)).argmax())
    peak, rendered_peak = size.max(axis=axis), lengths(rendered).max(axis=axis)
    is_strong = peak > 4 * F0_N
    return {
        "beyond": float(beyond.sum() / (size > 0).sum()),
        "nmse_db": float(10 * np.log10((error**2).sum() / (size**2).sum())),
        "holes": float((rendered_peak[is_strong] <= 0.2 * peak[is_strong]).mean()),
        "peak": float(np.median(rendered_peak[is_strong] / peak[is_strong])),
    }


def measure(nw: int) -> Figures:
    """Measure each source, level and method."""
    rows: dict[str, Figures] = {}
    fox = SHARED / "meshes" / "fox" / "Fox.glb"
    fields = {name: ripples(nw, phase) for name, phase in RIPPLES.items()}
    for source in (*SOURCES, *((str(fox),) if fox.is_file() else ())):
        fields[source] = prepare(source, EncodeSpec(nw=nw, representation="voxel")).medium[0]
    for source, field in fields.items():
        original = field.to_dense().astype(np.float64)
        ours, kept, low_passed = pyramid(field, LEVELS), decimated(field), low_pass(field)
        for level in range(1, LEVELS + 1):
            ways: dict[str, NDArray[Any]] = {
                OURS: interpolate(ours[level], field.grid, border="cell").to_dense(),
                DECIMATED: interpolate(kept[level], field.grid, border="cell").to_dense(),
                LOW_PASS: interpolate(low_passed[level], field.grid, border="cell").to_dense(),
                SIGNED: signed(field, level),
            }
            for way, rendered in ways.items():
                name = source.rsplit("/", 1)[-1]
                rows[f"{name}, level {level}, {way}"] = losses(original, rendered.astype(np.float64))
    return {"levels": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require fewer violations, fewer holes and higher peaks than others leave.

    The ripples have no bars, because no level can show them.
    """
    rows = {key: row for key, row in figures["levels"].items() if not key.startswith("ripples")}
    others = [(row, rows.get(key.replace(OURS, DECIMATED)), key) for key, row in rows.items() if OURS in key]
    pairs = [(row, rows[key.replace(OURS, LOW_PASS)], key) for key, row in rows.items() if key.endswith(OURS)]
    first = [(ours, other) for ours, other, key in pairs if "level 1" in key]
    return [
        at_most("detail: level 1, voxels beyond the mask over those of a low-pass, worst", max(
            ours["beyond"] / other["beyond"] for ours, other in first), 0.75),
        at_most("detail: level 1, holes beyond those of a low-pass, worst", max(
            ours["holes"] - other["holes"] for ours, other in first), 0.0),
        at_most("detail: all levels, holes beyond those of decimation, worst", max(
            (ours["holes"] - other["holes"] for ours, other, _ in others if other), default=None), 0.0),
        at_most("detail: all levels, peak that a low-pass leaves over ours, worst", max(
            other["peak"] / ours["peak"] for ours, other, _ in pairs), 1.0),
    ]  # fmt: skip


if __name__ == "__main__":
    bench("detail", __doc__, measure, bars, nw=(7, 6))
