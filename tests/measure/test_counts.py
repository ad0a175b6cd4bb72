"""Counts of symbols: every dtype, layout and size, joint and by block, compared with numpy.unique."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.measure import kernels as count
from touchfield.measure.counts import Counts

DTYPES = ["?", "i1", "u1", "<i2", ">i2", "<u2", "<i4", ">i4", "<u4", "<i8", ">i8"]


def agrees(found: Counts, samples: NDArray[np.generic]) -> None:
    symbols, counts = np.unique(samples.astype(np.int64), return_counts=True)
    assert np.array_equal(found.cells[:, 0], symbols)
    assert np.array_equal(found.weights, counts)
    assert found.total == samples.size


def joint_agrees(found: Counts, *samples: NDArray[np.generic]) -> None:
    rows = np.stack([x.ravel().astype(np.int64) for x in samples], axis=1)
    symbols, counts = np.unique(rows, axis=0, return_counts=True)
    assert np.array_equal(found.cells, symbols)
    assert np.array_equal(found.weights, counts)


@given(st.sampled_from(DTYPES).flatmap(lambda d: arrays(d, array_shapes(max_dims=3, max_side=12))))
def test_any_dtype_and_layout(samples: NDArray[np.generic]) -> None:
    agrees(Counts.of(samples), samples)
    agrees(Counts.of(samples.T), samples)
    agrees(Counts.of(samples[..., ::-2]), samples[..., ::-2])


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("spread", [1, 3, 15, 100, 130, 5000, 60_000])
def test_large_arrays_of_every_spread(dtype: str, spread: int) -> None:
    rng = np.random.default_rng(spread)
    kind = np.dtype(dtype)
    limits = (0, 1) if kind.kind == "b" else (int(np.iinfo(kind).min), int(np.iinfo(kind).max))
    for centre in (limits[0], (limits[0] + limits[1]) // 2, limits[1]):
        drawn = np.clip(rng.integers(-spread, spread + 1, 70_003).astype(object) + centre, *limits)
        samples = drawn.astype(kind)
        agrees(Counts.of(samples), samples)
        agrees(Counts.of(samples[1:-1]), samples[1:-1])


@pytest.mark.parametrize("low", [0, 65_400, 32_760, -64])
@pytest.mark.parametrize("width", [1, 2, 17, 128, 129, 256])
def test_narrow_ranges_with_outliers(low: int, width: int) -> None:
    """Outliers at the start, within, and at the end."""
    rng = np.random.default_rng(width)
    samples = ((low + rng.integers(0, width, 400_001)) % 65_536).astype(np.uint16)
    for outlier_indices in ((), (1,), (399_999,), (5, 123_457, 300_001)):
        x = samples.copy()
        x[list(outlier_indices)] ^= 0x4321
        assert np.array_equal(count.counts_of_16_bits(x), np.bincount(x, minlength=65_536))
        assert np.array_equal(count.counts_of_16_bits(x[3:]), np.bincount(x[3:], minlength=65_536))


def same_as_bincount(x: NDArray[np.int16]) -> None:
    unsigned = x.view(np.uint16)
    assert np.array_equal(count.counts_of_16_bits(unsigned), np.bincount(unsigned, minlength=65_536))


@pytest.mark.parametrize("low", [-63, -1, -32_768, 32_767])
@pytest.mark.parametrize("width", [63, 64, 65, 127, 128, 129])
@pytest.mark.parametrize("power", [1, 4, 9])
def test_ranges_of_every_width(low: int, width: int, power: int) -> None:
    """Uniform symbols and mostly low ones; odd lengths, and unaligned starts."""
    offsets = (width * np.random.default_rng(width).random(66_001) ** power).astype(np.int64)
    offsets[[7, 40_000, 66_000]] = 0, width - 1, width - 1
    x = (low + offsets).astype(np.uint16).view(np.int16)
    for start, stop in ((0, None), (1, -1), (2, -3), (3, None)):
        same_as_bincount(x[start:stop])


@pytest.mark.parametrize("widths", [(60,), (60, 120), (60, 300), (1, 60, 1, 20_000)])
@pytest.mark.parametrize("every", [8 * 128 * 4, 50_000])
def test_blocks_that_change_their_range(
    widths: tuple[int, ...], every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each part of the data has its own range, aligned with the blocks or not; some parts are constant."""
    monkeypatch.setenv("TOUCHFIELD_THREADS", "1")
    monkeypatch.setattr(count, "_SMALL", 1)
    rng = np.random.default_rng(len(widths))
    parts = [
        rng.integers(-width, 1, every) // 2 + int(rng.integers(-32_768, 32_768))
        for width in widths * (12 // len(widths))
    ]
    x = np.concatenate(parts).astype(np.int64).astype(np.uint16).view(np.int16)
    for samples in (x, x[3:-2], np.resize(x, 600_001)):
        same_as_bincount(samples)


@pytest.mark.parametrize("distance", [100, 1500, 20_011])
def test_outlying_symbols(distance: int) -> None:
    """No, some or most chunks of a block have an outlier, which is their first, last or neither."""
    x = np.random.default_rng(distance).integers(-20, 21, 700_003).astype(np.int16)
    x[distance::distance] = 30_000
    for start in range(4):
        same_as_bincount(x[start:])


@pytest.mark.parametrize("symbol", [0, -1, 32_767, -32_768])
@pytest.mark.parametrize("width", [30, 100, 50_000])
def test_runs_among_other_symbols(symbol: int, width: int) -> None:
    x = np.full(300_001, symbol, np.int16)
    rng = np.random.default_rng(width)
    for start in range(0, len(x), 9_000):
        x[start : start + 1700] = rng.integers(-width // 2, width // 2, 1700)[: len(x) - start]
    for start in range(4):
        same_as_bincount(x[start:])


def test_tables_of_32_bits_are_summed_before_they_overflow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(count, "_ROUND", 10)
    for symbols in (9, 300):
        x = np.random.default_rng(0).integers(0, symbols, 50_001).astype(np.uint16)
        assert np.array_equal(count.counts_of_16_bits(x), np.bincount(x, minlength=65_536))


@pytest.mark.parametrize("threads", ["1", "2", "5"])
def test_counts_do_not_depend_on_threads(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
    rng = np.random.default_rng(1)
    for samples in (rng.integers(0, 40, 3_000_000).astype(np.int16), rng.integers(-(2**40), 2**40, 600_000)):
        agrees(Counts.of(samples), samples)


def test_wide_ranges_are_sorted_and_merged() -> None:
    rng = np.random.default_rng(2)
    samples = rng.integers(-(2**62), 2**62, 5000)[rng.integers(0, 5000, 900_000)]
    agrees(Counts.of(samples), samples)
    agrees(Counts.of(np.array([-(2**63), 2**63 - 1, 0, 0])), np.array([-(2**63), 2**63 - 1, 0, 0]))
    agrees(Counts.of(samples.astype(np.uint64) >> 1), samples.astype(np.uint64) >> 1)


def test_chunks_lists_and_memory_maps(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    samples = rng.integers(-300, 300, (37, 1001)).astype(np.int16)
    agrees(Counts.of_stream(row for row in samples), samples)
    agrees(Counts.of_stream([samples[:5], samples[5:].astype(np.int64)]), samples)
    agrees(Counts.of([3, 1, 3, -2]), np.array([3, 1, 3, -2]))
    np.save(tmp_path / "s.npy", samples)
    agrees(Counts.of(np.load(tmp_path / "s.npy", mmap_mode="r")), samples)
    many = rng.integers(0, 2**40, (60, 20_000))
    agrees(Counts.of_stream(iter(many)), many)
    for nothing in ([], np.zeros(0, np.int16)):
        assert Counts.of(nothing).total == 0
    for none in ([], [np.zeros(0, np.int32)]):
        assert Counts.of_stream(none).total == 0


@pytest.mark.parametrize("dtype", [">i2", "i4", "i8"])
def test_memory_is_bounded_by_the_symbols(dtype: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    samples = np.zeros((12_000, 2000), dtype)[:, ::2]
    samples[::7, ::5] = 3000
    Counts.of(samples[:300])
    tracemalloc.start()
    found = Counts.of(samples)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found.total == samples.size and peak < 1.7 * samples.size


@pytest.mark.parametrize(
    "bad", [np.zeros(3), np.array([np.nan, 1]), [0.5], "text", [None], np.zeros(2, complex)]
)
def test_invalid_symbols_are_refused(bad: object) -> None:
    with pytest.raises(InvalidArgument, match="integers or booleans"):
        Counts.of(bad)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="integers or booleans"):
        Counts.of(bad, bad)  # type: ignore[arg-type]


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="NaN among them"):
        Counts.of(np.array([1.0, np.nan]))
    with pytest.raises(InvalidArgument, match=r"2\^63"):
        Counts.of(np.array([2**63], np.uint64))
    with pytest.raises(InvalidArgument, match="one shape"):
        Counts.of([1, 2], [1, 2, 3])
    with pytest.raises(InvalidArgument, match="no array"):
        Counts.of()
    ones = np.ones(2, np.int64)
    row = ones[:1, None]
    for cells, counts in ((ones, ones), (row, ones), (row, ones[:1] * 0), (row.astype(float), ones[:1])):
        with pytest.raises(InvalidArgument, match="Counts"):
            Counts(cells, counts)
    for rows in (np.array([[1, 2], [1, 2]]), np.array([[1, 2], [1, 1]]), np.array([[2, 0], [1, 5]])):
        with pytest.raises(InvalidArgument, match="ascending"):
            Counts(rows, ones)
    with pytest.raises(ValueError, match="read-only"):
        Counts.of([1]).weights[0] = 5
    full = np.arange(70_000)
    with pytest.raises(InvalidArgument, match="joint symbols"):
        Counts.of(full, full, full, full)


# -- joint -------------------------------------------------------------------------------------------------


@given(
    st.tuples(st.sampled_from(DTYPES), st.sampled_from(DTYPES), st.integers(1, 3)).flatmap(
        lambda t: array_shapes(max_dims=2, max_side=9).flatmap(
            lambda s: st.tuples(*[arrays(d, s) for d in (t[0], t[1], t[0])[: t[2]]])
        )
    )
)
def test_joint_symbols(samples: tuple[NDArray[np.generic], ...]) -> None:
    """64-bit symbols of full range give boxes of more than 2^63 cells."""
    h = Counts.of(*samples)
    joint_agrees(h, *samples)
    joint_agrees(Counts.of(*[x.T for x in samples]), *[x.T for x in samples])


def test_large_joint_histograms() -> None:
    rng = np.random.default_rng(4)
    small = [rng.integers(-3, 4, (90, 7000)).astype(np.int8) for _ in range(3)]
    joint_agrees(Counts.of(*small), *small)
    wide = [rng.integers(0, 2**33, 3000)[rng.integers(0, 3000, 300_000)] for _ in range(2)]
    joint_agrees(Counts.of(*wide), *wide)


# -- blocks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["?", "i1", ">i2", "i2", "i4", "i8"])
@pytest.mark.parametrize("shape", [(1000,), (31, 77), (64, 64)])
def test_blocks_add_up(dtype: str, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(5)
    scale = 2**60 if dtype == "i8" else 1
    x = (rng.integers(0, 7, shape) * scale).astype(dtype)
    for layout in (x, np.asfortranarray(x)):
        counts = Counts.of(layout, blocks=9)
        assert counts.blocks is not None and counts.blocks.shape == (9, len(counts.cells))
        edges = [x.size * b // 9 for b in range(10)]
        for row, (low, high) in zip(counts.blocks, zip(edges[:-1], edges[1:], strict=True), strict=True):
            part = x.ravel()[low:high].astype(np.int64)
            assert np.array_equal(row, [(part == s).sum() for s in counts.cells[:, 0]])


def test_joint_blocks_add_up() -> None:
    rng = np.random.default_rng(6)
    x, y = rng.integers(0, 5, (2, 40, 51)) * 2**61 // 3
    counts = Counts.of(x, y, blocks=12)
    assert counts.blocks is not None and np.array_equal(counts.blocks.sum(axis=0), counts.weights)
    first = Counts.of(x.ravel()[:170], y.ravel()[:170])
    nonzero = counts.blocks[0] > 0
    assert np.array_equal(counts.cells[nonzero], first.cells)
    assert np.array_equal(counts.blocks[0][nonzero], first.weights)


def test_number_of_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.arange(1000) % 50
    assert Counts.of(x).blocks is None and not Counts.of(x).notes
    few = Counts.of(x[:5], blocks=64)
    assert few.blocks is None and "fewer than 8 blocks" in few.notes[0]
    fewer = Counts.of(x[:20], blocks=64).blocks
    assert fewer is not None and len(fewer) == 20
    monkeypatch.setattr("touchfield.measure.counts.MAX_BLOCK_CELLS", 50 * 10)
    bounded = Counts.of(x, blocks=64).blocks
    assert bounded is not None and len(bounded) == 10
    monkeypatch.setattr("touchfield.measure.counts.MAX_BLOCK_CELLS", 50 * 7)
    assert Counts.of(x, blocks=64).blocks is None
