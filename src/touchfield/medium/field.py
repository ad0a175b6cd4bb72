"""`ForceField`: the forces of one instant at the samples of a lattice, stored only where there are any (paper
section 4).

The field is W: R^3 -> R^3.

Forces are in newtons and stored sparsely, in bricks of 8x8x8 samples; a brick without a force is not stored.
The *support* is the set of samples whose force is not zero. `Support` gives the paper's amplitude vector
**a** and direction matrix **D** (section 5.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Bools, EqualByValue, Float32s, Float64s, Int32s, Int64s, lengths_of
from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, import_extra
from touchfield.medium.budget import require_memory, zero_forces
from touchfield.medium.grid import BRICK, CORNERS, LOCAL, ON_A_SAMPLE, Grid
from touchfield.medium.samples import raster_slots, sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence


_MAX_PAIRS, _MAX_REACHED = 1 << 27, 1 << 26
_BLOCK_VALUES = 1 << 21
_BRICKS_AT_ONCE = 64


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of `array`; the array itself stays writeable."""
    view = array.view()
    view.flags.writeable = False
    return view


def brick_keys(grid: Grid, bricks: NDArray[np.integer[Any]]) -> Int64s:
    """Return the raster index (x slowest, z fastest) of each brick, int64 [n].

    `bricks` are int [n, 3].
    """
    _, by, bz = grid.brick_shape
    b = bricks.astype(np.int64)
    return (b[:, 0] * by + b[:, 1]) * bz + b[:, 2]


def bricks_of(grid: Grid, keys: Int64s) -> Int32s:
    """Return the bricks of these keys, int32 [n, 3]; the inverse of `brick_keys`."""
    _, by, bz = grid.brick_shape
    bricks, rows = np.empty((len(keys), 3), np.int32), keys // bz
    bricks[:, 0], bricks[:, 2] = rows // by, keys - rows * bz
    bricks[:, 1] = rows - by * bricks[:, 0].astype(np.int64)
    return bricks


def bricks_within(grid: Grid, spans: Int64s) -> Int32s:
    """Return the distinct bricks within boxes, ascending.

    `spans` int64 [n, 3, 2] holds the start and stop of each box along each axis, in bricks.
    """
    pairs = float(np.maximum(0, spans[..., 1] - spans[..., 0]).prod(axis=1, dtype=np.float64).sum())
    if pairs > _MAX_REACHED:
        found = f"{pairs:.3g} bricks reached"
        raise InvalidArgument("grid", found, f"up to {_MAX_REACHED}", "Take a coarser lattice.")
    keys = np.empty(int(pairs), np.int64)
    native.brick_keys(np.ascontiguousarray(spans, np.int64), grid.brick_shape, keys)
    return bricks_of(grid, np.unique(keys))


def bricks_reached(
    field: ForceField, grid: Grid, move: Callable[[Float64s], Float64s] | None = None
) -> Int32s:
    """Return the bricks of `grid` that a field may reach, int32 [n, 3], ascending.

    A sample of the field acts within one spacing around it.

    ``move(points_m)``, if given, transforms the points of the field first.
    """
    points = field.grid.to_m(field.bricks[:, None] * BRICK + np.where(CORNERS, BRICK, -1))
    index = grid.to_index(points if move is None else move(points))
    low, high = index.min(axis=1) - ON_A_SAMPLE, index.max(axis=1) + ON_A_SAMPLE
    last = np.array(grid.shape) - 1
    is_met = ((high >= 0) & (low <= last)).all(axis=1)
    first = (np.clip(np.floor(low[is_met]), 0, last) // BRICK).astype(np.int64)
    end = (np.clip(np.ceil(high[is_met]), 0, last) // BRICK).astype(np.int64) + 1
    return bricks_within(grid, np.stack([first, end], axis=2))


def check_bricks(
    owner: str, grid: Grid, bricks: Int32s, name: str, values: NDArray[Any], kind: str, *components: int
) -> None:
    """Raise `InvalidArgument` if bricks or the values of their samples are invalid.

    Bricks are int32 [n, 3], ascending and within the grid; values are [n, 8, 8, 8, *components] of the type
    `kind`, such as "float32". The error names `owner`, and `name` for the values.
    """
    if bricks.dtype != np.int32 or bricks.ndim != 2 or bricks.shape[1] != 3:
        raise InvalidArgument(f"{owner} bricks", f"{bricks.dtype} {bricks.shape}", "int32 [n, 3]")
    shape = (len(bricks), BRICK, BRICK, BRICK, *components)
    if values.dtype != kind or values.shape != shape:
        raise InvalidArgument(f"{owner} {name}", f"{values.dtype} {values.shape}", f"{kind} {list(shape)}")
    if len(bricks):
        if bricks.min() < 0 or (bricks.max(0) >= grid.brick_shape).any():
            raise InvalidArgument(f"{owner} bricks", "a brick outside the grid", f"{grid.brick_shape}")
        if (np.diff(brick_keys(grid, bricks)) <= 0).any():
            raise InvalidArgument(f"{owner} bricks", "bricks out of order or twice", "ascending order")


def slots_of(sorted_keys: Int64s, keys: Int64s) -> Int64s:
    """Return the index of each key among ascending keys; -1 if it is missing.

    The result is int64, of the shape of `keys`.
    """
    if not len(sorted_keys):
        return np.full(keys.shape, -1)
    slot = np.minimum(np.searchsorted(sorted_keys, keys), len(sorted_keys) - 1)
    return np.where(sorted_keys[slot] == keys, slot, -1)


def tiled(dense: NDArray[Any]) -> NDArray[Any]:
    """Divide an array [nx, ny, nz, ...] into bricks, [bx, by, bz, 8, 8, 8, ...].

    The array is padded with zeros.
    """
    short = [*((0, -n % BRICK) for n in dense.shape[:3]), *((0, 0) for _ in dense.shape[3:])]
    padded = np.pad(dense, short) if any(after for _, after in short) else dense
    x, y, z = (n // BRICK for n in padded.shape[:3])
    return np.moveaxis(padded.reshape(x, BRICK, y, BRICK, z, BRICK, *dense.shape[3:]), (2, 4), (1, 2))


def values_at(
    grid: Grid, bricks: Int32s, values: NDArray[Any], indices: NDArray[np.integer[Any]]
) -> NDArray[Any]:
    """Look up values [n, 8, 8, 8, ...] of ascending bricks at indices int [m, 3].

    Values are 0 where there is no brick.
    """
    inside = ((indices >= 0) & (indices < grid.shape)).all(axis=1)
    slots = np.full(len(indices), -1)
    slots[inside] = slots_of(brick_keys(grid, bricks), brick_keys(grid, indices[inside] // BRICK))
    stored = np.flatnonzero(slots >= 0)
    x, y, z = (indices[stored] % BRICK).T
    out = np.zeros((len(indices), *values.shape[4:]), values.dtype)
    out[stored] = values[slots[stored], x, y, z]
    return out


def neighbour_slots(
    bricks: NDArray[np.integer[Any]],
    others: NDArray[np.integer[Any]],
    count: Sequence[int] | Int64s,
    neighbours: int = 27,
) -> Int64s:
    """Look up the neighbours of bricks: indices in `others`, int64 [n, neighbours].

    The index is -1 for a neighbour that is not in `others`.

    bricks, others : int [n, 3], int [m, 3]; the others in raster order, x slowest.
    count : 3 int; bricks along each axis.
    neighbours : int; number of neighbours to look up, of 27 in raster order; neighbour 13 is the brick
        itself.
    """
    # rows are separated by two, so that neighbours across an edge match no brick
    pitch = np.array([(count[1] + 2) * (count[2] + 2), count[2] + 2, 1], np.int64)
    keys, other_keys = bricks @ pitch, others @ pitch
    out = np.empty((len(bricks), neighbours), np.int64)
    for s in range(neighbours):
        step: Any = np.array([s // 9 - 1, s // 3 % 3 - 1, s % 3 - 1]) @ pitch
        out[:, s] = slots_of(other_keys, keys + step)
    return out


def keys_of_both(first: ForceField, second: ForceField) -> Int64s:
    """Return the keys of the bricks of either field, ascending."""
    return np.union1d(*(brick_keys(field.grid, field.bricks) for field in (first, second)))


def dilated(grid: Grid, bricks: Int32s, reach: tuple[int, int, int]) -> Int32s:
    """Return the bricks, int32 [m, 3], within `reach` samples of `bricks` [n, 3].

    `reach` is given along each axis.

    The result is ascending, within the grid, and includes `bricks`. Raises `InvalidArgument` if that yields
    more than 2^27 bricks along an axis before duplicates are removed.
    """
    keys = np.sort(brick_keys(grid, bricks))
    for axis in range(3):
        margin = -(-int(reach[axis]) // BRICK)
        keys = spread_keys(keys, grid.brick_shape, axis, (margin, margin))
    return bricks_of(grid, keys)


def spread_keys(keys: Int64s, lattice: tuple[int, int, int], axis: int, margins: tuple[int, int]) -> Int64s:
    """Extend bricks along `axis` by `margins` bricks before and after, int64 [m].

    `keys` [n] and the result are ascending keys of bricks.

    Raises `InvalidArgument` if that yields more than 2^27 bricks before duplicates are removed.
    """
    size, step = lattice[axis], int(np.prod(lattice[axis + 1 :]))
    backward, forward = (min(margin, size - 1) for margin in margins)
    if len(keys) * (backward + forward + 1) > _MAX_PAIRS:
        reach = f"{max(margins) * BRICK} samples around {len(keys)} bricks"
        raise InvalidArgument("filter reach", reach, "a smaller reach", "Take a coarser grid.")
    coordinate = keys // step % size
    moved = [
        keys[(coordinate + d >= 0) & (coordinate + d < size)] + d * step
        for d in range(-backward, forward + 1)
    ]
    sorted_keys = np.sort(np.concatenate(moved), kind="stable")  # merges the ascending rows quickly
    return np.asarray(sorted_keys[np.diff(sorted_keys, prepend=-1) > 0])


def padded_blocks(
    field: ForceField, values: NDArray[Any], bricks: Int32s, before: Sequence[int], after: Sequence[int]
) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Yield the values of a field at some bricks [m, 3], with a margin.

    The margin is `before` and `after` samples along each axis.

    `values` are those of the field's bricks [n, 8, 8, 8, ...]; missing bricks are zero. Each item is a slice
    of `bricks` and its blocks, float [.., 8 + before + after] along each axis.
    """
    grid, field_keys = field.grid, brick_keys(field.grid, field.bricks)
    low, high = ([-(-n // BRICK) for n in side] for side in (before, after))
    shape = (*(BRICK * (a + 1 + b) for a, b in zip(low, high)), *values.shape[4:])
    cut = (slice(None), *(slice(BRICK * a - m, BRICK * (a + 1) + n) for a, m, n in zip(low, before, after)))
    count = max(1, _BLOCK_VALUES // math.prod(shape))
    for start in range(0, len(bricks), count):
        span = slice(start, min(start + count, len(bricks)))
        wide = np.zeros((span.stop - start, *shape), values.dtype)
        for offset in product(*(range(-a, b + 1) for a, b in zip(low, high))):
            neighbours = bricks[span] + np.array(offset)
            slot = slots_of(field_keys, brick_keys(grid, neighbours))
            is_stored = (slot >= 0) & ((neighbours >= 0) & (neighbours < grid.brick_shape)).all(axis=1)
            target = (slice(BRICK * (d + a), BRICK * (d + a + 1)) for d, a in zip(offset, low))
            wide[(is_stored, *target)] = values[slot[is_stored]]
        yield span, wide[cut]


def numbers_of(
    where: str,
    values: ArrayLike,
    kind: type[Any] = np.float64,
    shape: tuple[int, ...] | None = None,
    *,
    is_finite: bool = False,
) -> NDArray[Any]:
    """Convert an argument to an array of a type and shape.

    Raises `InvalidArgument` if the conversion would lose data.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "cMm" or np.ma.is_masked(values):
            raise TypeError(f"{'masked values' if np.ma.is_masked(values) else array.dtype}")
        with np.errstate(over="ignore", invalid="ignore"):  # overflow gives infinity, which callers check
            numbers = array.astype(kind, copy=False)
        if np.issubdtype(kind, np.integer) and not (numbers == array).all():
            raise ValueError(f"not whole, or beyond {kind.__name__}")
        numbers = numbers if shape is None else numbers.reshape(shape)
    except (TypeError, ValueError, OverflowError) as error:
        expected = "numbers" if shape is None else f"numbers of shape {shape}".replace("-1", "n")
        raise InvalidArgument(where, f"what is no array of numbers ({error})", expected) from None
    if is_finite and not np.isfinite(numbers).all():
        raise InvalidArgument(where, "a number that is not finite", "finite numbers")
    return numbers


@dataclass(frozen=True)
class Support:
    """The samples whose force is not zero, in raster order (x slowest, z fastest)."""

    positions: Int32s  # [L, 3]; indices into the grid
    amplitudes_n: Float32s  # [L]; |F|, the paper's **a**, newtons, positive
    directions: Float32s  # [L, 3]; F / |F|, the paper's **D**


@dataclass(frozen=True, eq=False)
class ForceField(EqualByValue):
    """Forces in newtons on a grid, stored in sparse bricks.

    Samples outside the bricks are zero.

    bricks : int32 [n, 3]; brick coordinates in strictly ascending order (x slowest, z fastest).
    forces_n : float32 [n, 8, 8, 8, 3]; force at each sample, axes (brick, x, y, z, component). Samples
        outside the grid are zero, and every brick has at least one force; `from_bricks` ensures both.
    Raises `InvalidArgument` if the shapes, types or the order of the bricks are wrong.
    """

    grid: Grid
    bricks: Int32s
    forces_n: Float32s

    def __post_init__(self) -> None:
        b, f = self.bricks, self.forces_n
        check_bricks("ForceField", self.grid, b, "forces_n", f, "float32", 3)
        object.__setattr__(self, "bricks", frozen(np.ascontiguousarray(b)))
        object.__setattr__(self, "forces_n", frozen(np.ascontiguousarray(f)))

    @classmethod
    def empty(cls, grid: Grid) -> ForceField:
        """Return the field that is zero everywhere."""
        return cls(grid, np.zeros((0, 3), np.int32), np.zeros((0, BRICK, BRICK, BRICK, 3), np.float32))

    @classmethod
    def from_bricks(cls, grid: Grid, bricks: ArrayLike, forces_n: ArrayLike) -> ForceField:
        """Make a field of bricks in any order.

        Empty bricks are dropped, and samples outside the grid are set to zero.

        Raises `InvalidArgument` if a force is not finite, or a brick is given twice or lies outside the grid.
        """
        b = numbers_of("bricks", bricks, np.int32, (-1, 3))
        f = numbers_of("forces_n", forces_n, np.float32, (len(b), BRICK, BRICK, BRICK, 3), is_finite=True)
        order = np.argsort(brick_keys(grid, b), kind="stable")
        b, f = b[order], f[order]
        for axis in range(3):
            local = np.arange(BRICK)
            beyond = b[:, axis, None] * BRICK + local >= grid.shape[axis]
            if beyond.any():
                np.moveaxis(f, axis + 1, 1)[beyond] = 0
        return field_without_empty_bricks(grid, b, f)

    @classmethod
    def from_dense(cls, grid: Grid, forces_n: ArrayLike) -> ForceField:
        """Make a field of a dense array, newtons [nx, ny, nz, 3]."""
        if not isinstance(grid, Grid):
            raise InvalidArgument("grid", f"a {type(grid).__name__}", "a Grid")
        dense = numbers_of("forces_n", forces_n, np.float32)
        if dense.shape != (*grid.shape, 3):
            raise InvalidArgument("forces_n", f"shape {dense.shape}", f"{(*grid.shape, 3)}, as the grid says")
        return cls.from_slabs(grid, [dense])

    @classmethod
    def from_slabs(cls, grid: Grid, slabs: Iterable[Float32s], *, to_the_bit: bool = False) -> ForceField:
        """Make a field of dense slabs along x, newtons float32 [m, ny, nz, 3].

        m is a multiple of 8 except in the last slab. Only bricks with a force are kept; with `to_the_bit`
        bricks that contain only zeros but at least one -0.0 are kept as well.
        """
        bricks, forces = [np.zeros((0, 3), np.int32)], [np.zeros((0, BRICK, BRICK, BRICK, 3), np.float32)]
        first = 0
        for dense in slabs:
            tiles = tiled(dense)
            is_force = np.ascontiguousarray(tiles).view(np.uint32) != 0 if to_the_bit else tiles != 0
            indices = np.argwhere(is_force.any(axis=(3, 4, 5, 6))).astype(np.int32)
            forces.append(tiles[tuple(indices.T)])
            bricks.append(indices + np.array([first, 0, 0], np.int32))
            first += len(tiles)
        if to_the_bit:
            return cls(grid, np.concatenate(bricks), np.concatenate(forces))
        return cls.from_bricks(grid, np.concatenate(bricks), np.concatenate(forces))

    @classmethod
    def from_support(cls, grid: Grid, positions: ArrayLike, forces_n: ArrayLike) -> ForceField:
        """Make a field of sample indices, int [L, 3], and their forces, newtons [L, 3].

        A sample that is given twice has the last of its forces.
        """
        p = numbers_of("positions", positions, np.int64, (-1, 3))
        values = numbers_of("forces_n", forces_n, np.float32, (len(p), 3))
        if len(p) and (p.min() < 0 or (p.max(0) >= grid.shape).any()):
            raise InvalidArgument("positions", "an index outside the grid", f"below {grid.shape}")
        keys, slot = np.unique(brick_keys(grid, p // BRICK), return_inverse=True)
        forces = np.zeros((len(keys), BRICK, BRICK, BRICK, 3), np.float32)
        forces[(slot, *(p % BRICK).T)] = values
        return cls.from_bricks(grid, bricks_of(grid, keys), forces)

    def __repr__(self) -> str:
        support = f"{self.support_count:,} of {self.grid.voxel_count:,} samples hold a force"
        return f"<ForceField: {support}, {self.grid.description}>"

    def to_dense(self) -> Float32s:
        """Return the forces as a dense array, newtons, float32 [nx, ny, nz, 3]."""
        return np.concatenate(list(self.slabs(0)))

    def to_xarray(self) -> Any:
        """Convert to an `xarray.DataArray` of newtons, float32 [x, y, z, component], with axes in metres.

        Raises `MissingExtra` without xarray; `InvalidArgument` if the dense field exceeds
        `memory_budget_bytes`.
        """
        xarray = import_extra("xarray", "a field as a DataArray", "xarray", "xarray")
        require_memory("to_xarray", "a dense field", 12 * self.grid.voxel_count, "Take a coarser grid.")
        coordinates = {**self.grid.coordinates, "component": list("xyz")}
        attributes = {"units": "N"}
        return xarray.DataArray(
            self.to_dense(), coordinates, ("x", "y", "z", "component"), "forces_n", attributes
        )

    def slabs(self, axis: int) -> Iterator[Float32s]:
        """Yield dense slabs along `axis`, ascending, newtons, float32 [nx, ny, nz, 3].

        Each slab but the last is 8 samples thick along `axis`. A dense frame of 256^3 samples takes 201 MB, a
        slab of it 6 MB.
        """
        shape = self.grid.brick_shape
        order = np.argsort(self.bricks[:, axis], kind="stable")
        edges = np.searchsorted(self.bricks[order, axis], np.arange(shape[axis] + 1))
        for slab in range(shape[axis]):
            selected = order[edges[slab] : edges[slab + 1]]
            tiles = np.zeros((*np.delete(shape, axis), BRICK, BRICK, BRICK, 3), np.float32)
            tiles[tuple(np.delete(self.bricks[selected], axis, axis=1).T)] = self.forces_n[selected]
            tiles = np.expand_dims(tiles, axis).transpose(0, 3, 1, 4, 2, 5, 6)
            size = [BRICK if a == axis else n * BRICK for a, n in enumerate(shape)]
            nx, ny, nz = (n - slab * BRICK if a == axis else n for a, n in enumerate(self.grid.shape))
            yield np.ascontiguousarray(tiles.reshape(*size, 3)[:nx, :ny, :nz])

    def raster_slots(self) -> Int64s:
        """Return the indices of the support in raster order, int64 [L].

        They are indices into ``forces_n.reshape(-1, 3)``.
        """
        return raster_slots(self.bricks, self.mask)

    def vectors_n(self) -> Float32s:
        """Return the forces of the support in raster order, newtons, float32 [L, 3]."""
        return self.forces_n.reshape(-1, 3)[self.raster_slots()]

    def positions(self) -> Int32s:
        """Return the grid indices of the support in raster order, int32 [L, 3]."""
        slots = self.raster_slots()
        brick, local = np.divmod(slots, BRICK**3)
        ijk = np.stack(np.unravel_index(local, (BRICK, BRICK, BRICK)), axis=-1)
        return (self.bricks[brick] * BRICK + ijk).astype(np.int32)

    def support(self) -> Support:
        """Return the paper's **a** and **D**, with the positions of the samples."""
        vectors = self.vectors_n()
        amplitudes = lengths_of(vectors.astype(np.float64))
        directions = vectors / amplitudes[:, None]
        return Support(
            frozen(self.positions()),
            frozen(amplitudes.astype(np.float32)),
            frozen(directions.astype(np.float32)),
        )

    def forces_at(self, keys: Int64s) -> Float32s:
        """Return the forces of the bricks with these keys, float32 [n, 8, 8, 8, 3].

        `keys` are those of `brick_keys`; bricks that are not stored are zero.
        """
        slot, forces = slots_of(brick_keys(self.grid, self.bricks), keys), zero_forces(len(keys))
        forces[slot >= 0] = self.forces_n[slot[slot >= 0]]
        return forces

    @cached_property
    def mask(self) -> Bools:
        """Samples of the stored bricks whose force is not zero, bool [n, 8, 8, 8]."""
        holds = self.forces_n[..., 0] != 0
        holds |= self.forces_n[..., 1] != 0
        holds |= self.forces_n[..., 2] != 0
        return frozen(holds)

    @property
    def support_count(self) -> int:
        """L, the number of samples whose force is not zero."""
        return int(np.count_nonzero(self.mask))

    def sample_n(self, positions_m: ArrayLike) -> Float32s:
        """Return the force at points [..., 3] in metres, newtons, float32 [..., 3].

        Forces are interpolated trilinearly.

        Beyond the outermost samples the force falls to zero over one spacing.
        """
        points = numbers_of("positions_m", positions_m)
        if not points.ndim or points.shape[-1] != 3:
            raise InvalidArgument("positions_m", f"shape {points.shape}", "[..., 3], metres")
        index = np.ascontiguousarray(self.grid.to_index(points).reshape(-1, 3))
        keys = brick_keys(self.grid, self.bricks)
        return sample(index, self.grid, keys, self.forces_n).reshape(points.shape)

    def scaled(self, factor: float) -> ForceField:
        """Return the field with every force multiplied by `factor`."""
        return ForceField.from_bricks(self.grid, self.bricks, self.forces_n * np.float32(factor))

    def __add__(self, other: ForceField) -> ForceField:
        if not isinstance(other, ForceField):
            return NotImplemented
        if self.grid != other.grid:
            raise InvalidArgument("sum of two fields", "two different grids", "one grid")
        keys = keys_of_both(self, other)
        forces = self.forces_at(keys) + other.forces_at(keys)
        return ForceField.from_bricks(self.grid, bricks_of(self.grid, keys), forces)

    def on_grid(self, grid: Grid) -> ForceField:
        """Return the same forces on another grid of the same shape.

        The metres of the samples change, their indices do not.
        """
        if grid.shape != self.grid.shape:
            raise InvalidArgument("grid", f"shape {grid.shape}", f"shape {self.grid.shape}")
        return ForceField(grid, self.bricks, self.forces_n)


def field_of_points(
    grid: Grid, bricks: Int32s, forces_n: Callable[[Float64s], NDArray[np.floating[Any]]]
) -> ForceField:
    """Evaluate a force function at the samples of ascending bricks.

    `forces_n` is a function of points in metres, float64 [n, 3].

    The field is zero outside the bricks, int32 [m, 3]; bricks without a force are dropped.
    """
    forces = zero_forces(len(bricks))

    def fill(start: int, stop: int) -> None:
        for first in range(start, stop, _BRICKS_AT_ONCE):
            some = slice(first, min(first + _BRICKS_AT_ONCE, stop))
            index = bricks[some, None, None, None] * BRICK + LOCAL
            values = forces_n(grid.to_m(index).reshape(-1, 3)).reshape(index.shape)
            values[(index >= grid.shape).any(axis=-1)] = 0
            forces[some] = values

    for_chunks(fill, len(bricks), chunk=_BRICKS_AT_ONCE)
    return field_without_empty_bricks(grid, bricks, forces)


def field_without_empty_bricks(grid: Grid, bricks: Int32s, forces_n: Float32s) -> ForceField:
    """Return the field of bricks, without those that have no force.

    `bricks` are int32 [n, 3], ascending.
    """
    holds = forces_n.any(axis=(1, 2, 3, 4))
    return (
        ForceField(grid, bricks, forces_n)
        if holds.all()
        else ForceField(grid, bricks[holds], forces_n[holds])
    )
