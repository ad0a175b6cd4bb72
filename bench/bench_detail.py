"""Compares levels of detail of a field with a low-pass pyramid: errors that a hand can feel, holes and peaks.

    python bench/bench_detail.py [--nw N] [--quick]

Each level is interpolated linearly at the samples of level 0, as a receiver renders it, and compared with
level 0. Five ways to build the levels are compared:

* kept samples: `touchfield.filters.pyramid`.
* decimation: every second sample alone, without the closing of thin walls.
* low-pass: the usual pyramid, cell means by `resample`, level by level.
* signed depth: |F| continues below zero in front of the surface with the median slope of the field, and is
  clipped at zero after the interpolation. It would need support in every receiver.
* tiles of least loss: each tile of 16^3 samples has the level (0 to 3, or no force) that loses the least
  information in all within the bits of the kept samples (paper section 4, "optimal Level-of-Detail"): the
  least lost bits + lambda times sent bits. The choice is known to the receiver and costs
  nothing. It would need support in every receiver.

"nothing" is no force at all. The ripples have a period of four samples, which is finer than the levels can
show; their phase decides what the kept samples meet. The thin wall is one sample thick and oblique.

The figures are:

* beyond: voxels whose error exceeds max(F_0, k |F|), over the supported voxels of level 0; k = 0.1, F_0 =
  0.05 N.
* holes: fraction of the columns along the main direction of the force in which a fifth of the peak or less
  remains.
* peak: median over the columns of the fraction of the peak that remains.
* bits: the sum of -log2 p of the samples of the level, quantised by Q = weber:0.25/ico1, p being their
  frequency in the level: what it takes to send them as independent samples.
* lost: H(S|R) / H(S), the fraction of the information of level 0 that the rendered level R does not have; S
  and R are the quantised forces of a voxel, uniform over all. The measure does not see wrong forces, only
  unknown ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from machine import SHARED, Bar, Figures, at_least, at_most, bench
from touchfield import EncodeSpec, prepare
from touchfield.codec.paper.field_quantiser import FieldQuantiser, FieldQuantiserSpec
from touchfield.filters import half_grid, interpolate, pyramid, resample
from touchfield.medium import ForceField, Grid

K, F0_N, LEVELS = 0.1, 0.05, 3
SOURCES = ("sample:terrain", "sample:motorcycle", "sample:shapes")
OURS, DECIMATED, LOW_PASS, SIGNED = "kept samples", "decimation", "low-pass", "signed depth"
TILED, NOTHING, THIN_WALL = "tiles of least loss", "nothing", "thin wall"
QUANTISER, TILE = "weber:0.25/ico1", 16
RIPPLES = {"ripples, 0 deg": 0.0, "ripples, 45 deg": np.pi / 4, "ripples, 90 deg": np.pi / 2}
Float64s = NDArray[np.float64]
Int64s = NDArray[np.int64]


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


def thin_wall(nw: int) -> ForceField:
    """Return an oblique wall of one sample with a force of 1 N."""
    n = 1 << nw
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    at = np.moveaxis(np.indices((n, n, n), np.float64), 0, -1)
    beside = at[..., :2]
    is_wall = (np.abs((at - n / 2) @ normal) < 0.5) & ((beside >= 4) & (beside < n - 4)).all(axis=-1)
    forces = np.where(is_wall[..., None], normal, 0).astype(np.float32)
    return ForceField.from_dense(Grid.over_box((-0.05,) * 3, (0.05,) * 3, (n, n, n)), forces)


class Information:
    """Measures what level 0 loses, in bits of a quantiser that is fitted to it."""

    def __init__(self, field: ForceField) -> None:
        forces = field.to_dense()
        top_n = 1.01 * float(lengths(forces.astype(np.float64)).max())  # interpolation rounds
        self.quantise: FieldQuantiser = FieldQuantiserSpec.parse(QUANTISER).fit([field], top_n)
        self.symbols = self.symbols_of(forces)
        self.total_bits = float(self.sent_bits(forces).sum())

    def symbols_of(self, forces_n: NDArray[Any]) -> Int64s:
        """Return the symbol of each sample [x, y, z]; 0 is no force."""
        symbols = np.zeros(forces_n.shape[:3], np.int64)
        is_supported = forces_n.any(axis=-1)
        symbols[is_supported] = self.quantise.symbols_of(forces_n[is_supported].astype(np.float32))
        return symbols

    def sent_bits(self, forces_n: NDArray[Any]) -> Float64s:
        """Return -log2 p of each sample [x, y, z] among all of these."""
        symbols = self.symbols_of(forces_n)
        return np.asarray(-np.log2(np.bincount(symbols.ravel())[symbols] / symbols.size))

    def lost_bits(self, rendered_n: NDArray[Any]) -> Float64s:
        """Return -log2 p(s|r) of each voxel [x, y, z]; the mean is H(S|R)."""
        rendered = self.symbols_of(rendered_n)
        pairs = self.symbols * self.quantise.alphabet + rendered
        _, inverse, counts = np.unique(pairs, return_inverse=True, return_counts=True)
        of_rendered = np.bincount(rendered.ravel())[rendered]
        return np.asarray(-np.log2(counts[inverse.reshape(pairs.shape)] / of_rendered))

    def tiled(
        self, levels: list[NDArray[Any]], rendered: list[NDArray[Any]]
    ) -> list[tuple[Float64s, float, float]]:
        """Return the tiles of least loss, their bits and the lost bits, for the bits of each level but 0.

        `levels`, `rendered`: the samples of each level, finest first, and its forces at those of level 0.
        """
        choices = [*rendered, np.zeros_like(rendered[0])]
        lost = np.array([_tile_sums(self.lost_bits(forces)) for forces in choices])
        sent, found = np.zeros_like(lost), []
        for i, samples in enumerate(levels):
            of_samples = np.zeros(rendered[0].shape[:3])
            of_samples[:: 1 << i, :: 1 << i, :: 1 << i] = self.sent_bits(samples)
            sent[i] = _tile_sums(of_samples)
        for budget in sent[1 : len(levels)].sum(axis=(1, 2, 3)):
            choice = _least_loss(lost, sent, budget)
            of_voxel = choice.repeat(TILE, 0).repeat(TILE, 1).repeat(TILE, 2)
            sent_bits, lost_bits = (
                float(np.take_along_axis(bits, choice[None], 0).sum()) for bits in (sent, lost)
            )
            found.append((np.choose(of_voxel[..., None], choices), sent_bits, lost_bits))
        return found


def _tile_sums(values: Float64s) -> Float64s:
    """Sum a cube over its tiles, float64 [x, y, z] of tiles."""
    n = values.shape[0] // TILE
    return np.asarray(values.reshape(n, TILE, n, TILE, n, TILE).sum(axis=(1, 3, 5)))


def _least_loss(lost: Float64s, sent: Float64s, budget: float) -> NDArray[np.intp]:
    """Return the choice of each tile that minimises lost + lambda sent within the budget.

    What is left of the budget is spent tile by tile, where it saves most for its bits.
    """
    low, high = 1e-9, 1e9
    for _ in range(60):
        middle = np.sqrt(low * high)
        choice = (lost + middle * sent).argmin(axis=0)
        is_within = np.take_along_axis(sent, choice[None], 0).sum() <= budget
        low, high = (low, middle) if is_within else (middle, high)
    choice = np.asarray((lost + high * sent).argmin(axis=0))
    while True:
        lost_now, sent_now = (np.take_along_axis(bits, choice[None], 0) for bits in (lost, sent))
        saved, more = lost_now - lost, sent - sent_now
        is_better = (saved > 0) & (more <= budget - sent_now.sum())
        if not is_better.any():
            return choice
        rate = np.where(is_better, saved / np.maximum(more, 1e-9), -1.0)
        option, *tile = np.unravel_index(rate.argmax(), rate.shape)
        choice[tuple(tile)] = option


def signed(field: ForceField, level: int) -> Float64s:
    """Interpolate level 0 from signed depth and direction, float64 [x, y, z, 3].

    Every 2^level-th sample along each axis is used.
    """
    forces, h = field.to_dense().astype(np.float64), np.asarray(field.grid.spacing_m)
    size = lengths(forces)
    supported = size > 0
    slope = np.sqrt(sum(g**2 for g in np.gradient(size, *h)))
    inner = ndimage.binary_erosion(supported)
    inner = inner if inner.any() else supported
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


def fields_of(nw: int) -> dict[str, ForceField]:
    """Return level 0 of each source; those of the optional folder of inputs only if they are there."""
    fields = {name: ripples(nw, phase) for name, phase in RIPPLES.items()} | {THIN_WALL: thin_wall(nw)}
    optional = (SHARED / "meshes" / "fox" / "Fox.glb", SHARED / "rgbd_tum_fr1_rpy")
    spec = EncodeSpec(nw=nw, representation="voxel")
    for source in (*SOURCES, *(str(path) for path in optional if path.exists())):
        fields[source.rsplit("/", 1)[-1]] = prepare(source, spec).medium[0]
    return fields


def rows_of(field: ForceField) -> dict[str, Figures]:
    """Return the figures of each level and way, and of no force."""
    original = field.to_dense().astype(np.float64)
    information, rows = Information(field), dict[str, Figures]()

    def add(key: str, rendered: NDArray[Any], bits: float | None, lost: float | None = None) -> None:
        lost = float(information.lost_bits(rendered).sum()) if lost is None else lost
        figures = losses(original, rendered.astype(np.float64))
        rows[key] = {**figures, "bits": bits, "lost": lost / information.total_bits}

    add(NOTHING, np.zeros_like(original), 0.0)
    ways = {OURS: [*pyramid(field, LEVELS)], DECIMATED: decimated(field), LOW_PASS: low_pass(field)}
    rendered: list[NDArray[Any]] = [original]
    for level in range(1, LEVELS + 1):
        for way, levels in ways.items():
            forces: NDArray[Any] = interpolate(levels[level], field.grid, border="cell").to_dense()
            add(f"level {level}, {way}", forces, float(information.sent_bits(levels[level].to_dense()).sum()))
            if way == OURS:
                rendered.append(forces)
        add(f"level {level}, {SIGNED}", signed(field, level), None)
    samples = [level.to_dense() for level in ways[OURS]]
    for level, (tiled, bits, lost) in enumerate(information.tiled(samples, rendered), 1):
        add(f"level {level}, {TILED}", tiled, bits, lost)
    return rows


def measure(nw: int) -> Figures:
    """Measure each source, level and way."""
    rows = {
        f"{name}, {key}": row for name, field in fields_of(nw).items() for key, row in rows_of(field).items()
    }
    return {"levels": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require fewer violations, fewer holes and higher peaks than others leave.

    The ripples have no bars, because no level can show them. Should tiles of least loss save a tenth of what
    is lost, they are worth their support in every receiver.
    """
    rows = {key: row for key, row in figures["levels"].items() if not key.startswith("ripples")}
    others = [(row, rows.get(key.replace(OURS, DECIMATED)), key) for key, row in rows.items() if OURS in key]
    pairs = [(row, rows[key.replace(OURS, LOW_PASS)], key) for key, row in rows.items() if key.endswith(OURS)]
    first = [(ours, other) for ours, other, key in pairs if "level 1" in key]
    tiled = [(row, rows[key.replace(TILED, OURS)]) for key, row in rows.items() if key.endswith(TILED)]
    return [
        at_most("detail: level 1, voxels beyond the mask over those of a low-pass, worst", max(
            ours["beyond"] / other["beyond"] for ours, other in first), 0.75),
        at_most("detail: level 1, holes beyond those of a low-pass, worst", max(
            ours["holes"] - other["holes"] for ours, other in first), 0.0),
        at_most("detail: all levels, holes beyond those of decimation, worst", max(
            (ours["holes"] - other["holes"] for ours, other, _ in others if other), default=None), 0.0),
        at_most("detail: all levels, peak that a low-pass leaves over ours, worst", max(
            other["peak"] / ours["peak"] for ours, other, _ in pairs), 1.0),
        at_least("detail: all levels, bits lost by tiles of least loss over ours, least", min(
            tile["lost"] / ours["lost"] for tile, ours in tiled), 0.9),
    ]  # fmt: skip


if __name__ == "__main__":
    bench("detail", __doc__, measure, bars, nw=(7, 6))
