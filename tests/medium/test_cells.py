"""Cells of a field: their bricks, samples, supports and hash table, against the field itself."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.compute.native import native
from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool

seeds = st.integers(0, 2**32 - 1)


def some_field(rng: np.random.Generator, shape: tuple[int, ...] | None = None) -> ForceField:
    """Random forces, possibly none, on a lattice of up to three bricks along an axis."""
    shape = tuple(int(n) for n in rng.integers(1, 25, 3)) if shape is None else shape
    grid = Grid(shape, tuple(rng.uniform(0.003, 0.02, 3)), tuple(rng.normal(0, 0.05, 3)))
    dense = rng.normal(size=(*grid.shape, 3)).astype(np.float32)
    dense[rng.random(grid.shape) > rng.choice([0.0, 0.002, 0.3, 1.0])] = 0
    return ForceField.from_dense(grid, dense)


def expected_bricks(fields: list[ForceField]) -> np.ndarray:
    """The bricks of cells that have a sample with a force, or one of the bricks themselves."""
    found = {tuple(brick) for field in fields for brick in field.bricks.tolist()}
    for field in fields:
        for index in np.argwhere(field.to_dense().any(axis=-1)):
            corners = product(*[{n >> 3, (n - 1) >> 3} for n in index.tolist()])
            found |= set(corners)
    return np.array(sorted(found)).reshape(-1, 3)


def padded(field: ForceField, low: np.ndarray, bricks: np.ndarray) -> np.ndarray:
    """Samples of a box of bricks from brick `low` on, and one more along each axis; zero outside."""
    dense = field.to_dense()
    out = np.zeros((*(8 * bricks + 1), 3), np.float32)
    first = -8 * low
    assert (first >= 0).all()
    size = np.minimum(dense.shape[:3], out.shape[:3] - first)
    target = tuple(slice(f, f + n) for f, n in zip(first, size))
    out[target] = dense[tuple(slice(n) for n in size)]
    return out


@settings(max_examples=40)
@given(seeds, st.booleans())
def test_cells_are_the_samples_of_the_field(seed: int, is_paired: bool) -> None:
    rng = np.random.default_rng(seed)
    field = some_field(rng)
    paired = some_field(rng, field.grid.shape) if is_paired else None
    pool = CellPool.of(field, paired)
    bricks = expected_bricks([field] if paired is None else [field, paired])
    if not len(bricks):
        assert not len(pool.bricks) and not pool.boxes[0, :3].any()
        return
    low, box = bricks.min(axis=0), bricks.max(axis=0) - bricks.min(axis=0) + 1
    assert np.array_equal(pool.bricks, bricks - low) and np.array_equal(pool.boxes[0, :3], box)
    samples = padded(field, np.minimum(low, 0), box + low - np.minimum(low, 0))
    cells = pool.cells.reshape(-1, 9, 9, 9, 3)
    for brick, own, supported in zip(bricks - np.minimum(low, 0), cells, pool.supported, strict=True):
        i, j, k = 8 * brick
        assert np.array_equal(own, samples[i : i + 9, j : j + 9, k : k + 9])
        has_force = own.any(axis=-1)
        corners = [has_force[a : a + 8, b : b + 8, c : c + 8] for a, b, c in product((0, 1), repeat=3)]
        bits = np.logical_or.reduce(corners).reshape(8, 64)
        assert supported.tolist() == [sum(1 << n for n in np.flatnonzero(row).tolist()) for row in bits]


@settings(max_examples=20)
@given(seeds)
def test_the_hash_table_has_each_brick_once(seed: int) -> None:
    pool = CellPool.of(some_field(np.random.default_rng(seed), (24, 20, 17)))
    numbers = (pool.bricks[:, 0] * pool.boxes[0, 1] + pool.bricks[:, 1]) * pool.boxes[0, 2] + pool.bricks[
        :, 2
    ]
    table = pool.tables[pool.tables[:, 0] >= 0]
    assert sorted(map(tuple, table.tolist())) == list(zip(numbers.tolist(), range(len(numbers))))
    assert len(pool.tables) == 1 << (64 - pool.boxes[0, 4]) and 2 * len(numbers) <= len(pool.tables)
    for number, index in table.tolist():  # open addressing: no free entry lies between its hash and its place
        slot = (number * 0x9E3779B97F4A7C15 % 2**64) >> int(pool.boxes[0, 4])
        while pool.tables[slot, 0] != number:
            assert pool.tables[slot, 0] >= 0
            slot = (slot + 1) % len(pool.tables)
        assert pool.tables[slot, 1] == index


def test_ranges_of_bricks_are_written_alike() -> None:
    field = some_field(np.random.default_rng(5), (24, 24, 24))
    whole, parts = CellPool.of(field), CellPool.of(field)
    assert whole.data is not None and parts.data is not None and len(whole.bricks) > 20
    found, corner, _, size_bytes = native.find_cells(field.bricks, field.forces_n, None, None)
    assert size_bytes == len(parts.data)
    parts.cells[:], parts.supported[:] = 7.0, 1
    edges = [0, 1, 5, 6, 20, len(whole.bricks)]
    for start, stop in reversed(list(zip(edges, edges[1:]))):
        native.fill_cells(start, stop, parts.data, corner, found, field.bricks, field.forces_n)
    assert np.array_equal(whole.data, parts.data)


def test_wrong_arrays_are_refused() -> None:
    field = some_field(np.random.default_rng(5), (24, 24, 24))
    found, corner, box, size_bytes = native.find_cells(field.bricks, field.forces_n, None, None)
    small, read_only = np.empty(size_bytes - 64, np.uint8), np.empty(size_bytes, np.uint8)
    read_only.flags.writeable = False
    for memory in (small, read_only):
        with pytest.raises(ValueError, match="an array"):
            native.start_cells(memory, corner, box, found, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="another size"):
        native.find_cells(field.bricks, field.forces_n[1:], None, None)
    count, memory = len(found) // 12, np.empty(size_bytes, np.uint8)
    native.start_cells(memory, corner, box, found, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    for start, stop in ((-1, 1), (2, 1), (0, count + 1)):
        with pytest.raises(ValueError, match="range"):
            native.fill_cells(start, stop, memory, corner, found, field.bricks, field.forces_n)
