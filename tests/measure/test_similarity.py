"""Similarity of media: metric axioms, counterexamples, and the NCD."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial import distance

from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.resample import resample
from touchfield.measure import information as info
from touchfield.measure.field_symbols import FieldSymbols, Frames
from touchfield.measure.similarity import Similarity, compression_distance, pack, similarity
from touchfield.medium import ForceField, Grid

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")
K = 4
SMALL = Grid((3, 2, 9), (1e-3,) * 3, (0, 0, 0))
LARGE = Grid((24, 24, 24), (1e-3,) * 3, (0, 0, 0))
Symbols = NDArray[np.int32]


def field(symbols: NDArray[np.integer], grid: Grid = SMALL, k: int = K) -> FieldSymbols:
    return FieldSymbols.from_dense(grid, symbols, k, "a Q")


def plain(a: FieldSymbols, b: FieldSymbols, over: str = "voxel") -> Similarity:
    return similarity(a, b, over, compressed=False, interval=False)


def on_row(*symbols: int) -> FieldSymbols:
    return field(np.array(symbols)[None, None, :], Grid((1, 1, len(symbols)), (1e-3,) * 3, (0, 0, 0)))


dense = arrays(np.int32, SMALL.shape, elements=st.integers(0, K - 1))


# -- metrics -----------------------------------------------------------------------------------------------


@given(dense, dense, dense)
def test_axioms_of_the_metrics(a: Symbols, b: Symbols, c: Symbols) -> None:
    """VI and sqrt(JSD) over "voxel"; also sqrt(JSD) over "object". The square root is of rounding errors."""
    f, g, h = field(a), field(b), field(c)
    ab, ba, bc, ac, aa = plain(f, g), plain(g, f), plain(g, h), plain(f, h), plain(f, f)
    for get in (lambda s: float(s.variation), lambda s: float(s.jensen_shannon)):
        assert get(ab) == pytest.approx(get(ba), abs=1e-7)
        assert get(aa) == pytest.approx(0, abs=1e-7)
        assert get(ac) <= get(ab) + get(bc) + 1e-7
        assert get(ab) >= 0
    if a.any() and b.any() and c.any():
        x, y, z = (float(plain(*p, over="object").jensen_shannon) for p in ((f, g), (g, h), (f, h)))
        assert z <= x + y + 1e-7


@given(dense, dense)
def test_values_agree_with_arrays(a: Symbols, b: Symbols) -> None:
    found = similarity(field(a), field(b), compressed=False, interval=False)
    assert float(found.variation) == pytest.approx(
        float(info.variation_of_information(a, b, interval=False)), abs=1e-12
    )
    nmi = float(info.normalised_mutual_information(a, b, interval=False))
    assert float(found.normalised) == pytest.approx(nmi, abs=1e-12, nan_ok=True)
    frequencies = [np.bincount(s.ravel(), minlength=K) / s.size for s in (a, b)]
    assert float(found.jensen_shannon) == pytest.approx(
        distance.jensenshannon(*frequencies, base=2), abs=1e-7
    )
    assert (found.variation.weighting, found.variation.quantiser, found.variation.unit) == (
        "voxel",
        "a Q",
        "bit/sample",
    )


def test_a_distance_of_0_between_media_that_differ() -> None:
    """VI is invariant to relabelling, and sqrt(JSD) to positions: each detects what the other does not."""
    a, renamed, moved = on_row(0, 0, 1, 2), on_row(1, 1, 2, 0), on_row(2, 0, 1, 0)
    assert float(plain(a, renamed).variation) == pytest.approx(0, abs=1e-12)
    assert float(plain(a, renamed).jensen_shannon) > 0.1
    assert float(plain(a, moved).jensen_shannon) == pytest.approx(0, abs=1e-7)
    assert float(plain(a, moved).variation) > 0.1


def test_triangle_inequality_fails_over_the_object() -> None:
    """Two small bodies, and one that fills the grid: in unions with it, the small ones hardly vary."""
    a, b, c = on_row(1, 2, *[0] * 98), on_row(*[1] * 100), on_row(*[0] * 98, 1, 2)
    sides = {}
    for over in ("voxel", "object"):
        sides[over] = [float(plain(*p, over=over).variation) for p in ((a, b), (b, c), (a, c))]
    assert sides["voxel"][2] <= sides["voxel"][0] + sides["voxel"][1]
    assert sides["object"][2] == pytest.approx(1), "2 * 2 - 1.5 - 1.5 bits of four voxels"
    assert sides["object"][2] > 3 * (sides["object"][0] + sides["object"][1])


# -- frames, lattices, errors ------------------------------------------------------------------------------


def test_frames_are_samples_together() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, K, (2, 3, *SMALL.shape))
    found = similarity([field(f) for f in a], [field(f) for f in b], compressed=False, interval=False)
    assert float(found.variation) == pytest.approx(
        float(info.variation_of_information(a, b, interval=False)), abs=1e-12
    )
    assert found.variation.samples == a.size


def test_interval_contains_the_value_and_summary_is_complete() -> None:
    rng = np.random.default_rng(2)
    a = rng.integers(0, K, LARGE.shape)
    b = np.where(rng.random(a.shape) < 0.5, a, rng.integers(0, K, a.shape))
    found = similarity(field(a, LARGE), field(b, LARGE))
    assert found.compression is not None
    for quantity in (found.normalised, found.variation, found.jensen_shannon):
        assert quantity.interval is None or quantity.interval.low <= float(quantity) <= quantity.interval.high
    assert set(found.summary()) == {"normalised", "variation", "jensen_shannon", "compression"}


def test_other_lattices_need_resampling(wavy_field: ForceField) -> None:
    low, high = wavy_field.grid.box_m
    coarse = resample(wavy_field, Grid.over_box(low, high, (12, 10, 9)))
    quantise = FieldQuantiserSpec.parse("weber:0.2/ico1").fit([wavy_field, coarse], 4.0)
    with pytest.raises(InvalidArgument, match="Resample one onto the lattice of the other"):
        similarity(quantise(wavy_field), quantise(coarse))
    back = similarity(quantise(wavy_field), quantise(resample(coarse, wavy_field.grid)), interval=False)
    empty = similarity(quantise(wavy_field), quantise(ForceField.empty(wavy_field.grid)), interval=False)
    assert float(back.jensen_shannon) < float(empty.jensen_shannon)
    assert math.isnan(empty.normalised.value) and empty.normalised.notes


def test_invalid_arguments_are_refused() -> None:
    a = field(np.ones(SMALL.shape, np.int64))
    nothing = field(np.zeros(SMALL.shape, np.int64))
    with pytest.raises(InvalidArgument, match="Fit one quantiser to both"):
        similarity(a, FieldSymbols.from_dense(SMALL, np.ones(SMALL.shape, int), K, "another Q"))
    with pytest.raises(InvalidArgument, match="2 frames"):
        similarity(a, [a, a])
    with pytest.raises(InvalidArgument, match="over"):
        similarity(a, a, "interaction")
    with pytest.raises(InvalidArgument, match="no voxel with a force"):
        similarity(a, nothing, "object", interval=False)
    with pytest.raises(InvalidArgument, match="Resample one"):
        compression_distance(a, on_row(1, 2))


# -- compression -------------------------------------------------------------------------------------------


def noise(seed: int, k: int = 200) -> FieldSymbols:
    return field(np.random.default_rng(seed).integers(0, k, LARGE.shape), LARGE, k)


def test_ncd_of_equal_unrelated_and_shifted_media() -> None:
    a, b = noise(3), noise(4)
    shifted = field(np.roll(a.to_dense(), 8, axis=0), LARGE, 200)  # by a whole number of bricks
    assert 0 < float(compression_distance(a, a)) < 0.05, "not 0: NCD is no metric"
    assert float(compression_distance(a, b)) == pytest.approx(1, abs=0.05)
    assert float(compression_distance(a, shifted)) < 0.1
    unrelated = float(plain(a, b).normalised)
    assert float(plain(a, shifted).normalised) == pytest.approx(unrelated, abs=0.01), (
        "voxel by voxel it is not seen"
    )
    assert float(compression_distance(a, b)) == float(compression_distance(b, a))
    assert "not a metric" in " ".join(compression_distance(a, b).notes)


@given(st.integers(0, 100), st.sampled_from([2, 250, 300, 70_000]))
def test_packed_bytes_do_not_depend_on_the_storage(seed: int, k: int) -> None:
    rng = np.random.default_rng(seed)
    s = (rng.integers(0, k, SMALL.shape) * (rng.random(SMALL.shape) < 0.1)).astype(np.int32)
    sparse = field(s, SMALL, k)
    bricks = np.argwhere(np.ones(SMALL.brick_shape)).astype(np.int32)
    full = np.zeros((len(bricks), 8, 8, 8), np.int32)
    for brick, symbols in zip(sparse.bricks.tolist(), sparse.symbols, strict=True):
        full[bricks.tolist().index(brick)] = symbols
    stored = FieldSymbols(SMALL, bricks, full, k, "a Q")
    assert pack(Frames(sparse, "a")) == pack(Frames(stored, "b"))
    changed = s.copy()
    changed[0, 0, 0] = (changed[0, 0, 0] + 1) % k
    assert pack(Frames(sparse, "a")) != pack(Frames(field(changed, SMALL, k), "b"))


def test_too_many_symbols_to_pack_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    symbols_field = field(np.ones(SMALL.shape, np.int64))
    size = len(pack(Frames(symbols_field, "a")))
    assert len(pack(Frames(symbols_field, "a"), size)) == size
    with pytest.raises(InvalidArgument, match="fewer frames"):
        pack(Frames(symbols_field, "a"), size - 1)
    monkeypatch.setattr(sys.modules[similarity.__module__], "MAX_BYTES", 2 * size)  # for both together
    assert compression_distance(symbols_field, symbols_field).samples == 2 * SMALL.voxel_count
    monkeypatch.setattr(sys.modules[similarity.__module__], "MAX_BYTES", 2 * size - 1)
    with pytest.raises(InvalidArgument, match="fewer frames"):
        compression_distance(symbols_field, symbols_field)


def test_media_of_different_lengths_are_compressed_together() -> None:
    a, b = noise(5), noise(6)
    found = compression_distance([a, b], [a])
    assert found.samples == 3 * LARGE.voxel_count and found.quantiser == "a Q" and found.weighting == "voxel"
    assert float(found) == pytest.approx(0.5, abs=0.05), "half of the longer one is not told by the other"
