"""The coding limits: block rates, context entropies, the prequential code; against brute force and known sources."""

from __future__ import annotations

import itertools
import json
import math
import tracemalloc
import warnings
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from prequential_reference import ReferenceCode
from touchfield.codec.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.measure.block_rate import BlockCounter, block_rates, scan_line_rates
from touchfield.measure.causal import boxes_of
from touchfield.measure.cells import CellCounter
from touchfield.measure.context import NEIGHBOURHOODS, context_entropy
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.limits import coding_limits
from touchfield.measure.plug_in import binary_entropy_bits, entropy_bits
from touchfield.measure.prequential import PrequentialCoder, kt_code_length_bits, prequential_code_length
from touchfield.measure.quantity import FewSamplesWarning
from touchfield.medium import ForceField, Grid

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")

OFFSETS = {"none": [], "previous": [(0, 0, -1)], "axes": [(0, 0, -1), (0, -1, 0), (-1, 0, 0)]}
OFFSETS["corner"] = [d for d in itertools.product((-1, 0), repeat=3) if any(d)]


def markov(n: int, seed: int = 0, a: float = 0.05, b: float = 0.2) -> np.ndarray:
    """Chain of theory.md section 4: 0 -> 1 with chance a, 1 -> 0 with chance b."""
    rng = np.random.default_rng(seed)
    runs = np.stack([rng.geometric(a, n), rng.geometric(b, n)], axis=1).ravel()
    return np.repeat(np.arange(2 * n) % 2, runs)[:n] if runs.sum() >= n else np.zeros(n, int)


def sparse(shape: tuple[int, ...], alphabet: int, share: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(1, alphabet, shape) * (rng.random(shape) < share)


def fields_of(frames: np.ndarray, alphabet: int) -> list[FieldSymbols]:
    grid = Grid(frames.shape[1:], (1, 1, 1), (0, 0, 0))
    return [FieldSymbols.from_dense(grid, f, alphabet, "test") for f in frames]


def most_mib(work: Callable[[], object]) -> float:
    """The most memory that arrays take at once while something is worked out, MiB."""
    work()  # once before: what is compiled, and imported, is not counted
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def conditional_by_brute_force(frames: np.ndarray, neighbourhood: str, previous: bool) -> tuple[float, int, int]:
    joint: Counter[tuple[int, ...]] = Counter()
    for t, frame in enumerate(frames):
        padded = np.pad(frame, 1)
        for p in np.ndindex(frame.shape):
            row = [int(padded[tuple(i + 1 + e for i, e in zip(p, d, strict=True))]) for d in OFFSETS[neighbourhood]]
            row += [int(frames[t - 1][p]) if t else 0] * previous
            joint[(*row, int(frame[p]))] += 1
    contexts: Counter[tuple[int, ...]] = Counter()
    for row, n in joint.items():
        contexts[row[:-1]] += n
    bits = entropy_bits(list(joint.values())) - entropy_bits(list(contexts.values()))
    return bits, len(contexts), len(joint)


# -- block entropies --------------------------------------------------------------------------------------


def test_rates_of_a_markov_chain() -> None:
    """theory.md section 4: marginal .721928, rate .373504."""
    rates = [q.value for q in block_rates(markov(400_000), 5).rates]
    assert rates[0] == pytest.approx(0.721928, abs=0.006)
    assert rates[1:] == pytest.approx([0.373504] * 4, abs=0.003)


@given(hnp.arrays(np.int32, st.integers(1, 40), elements=st.integers(0, 3) | st.just(2**31 - 1)), st.integers(1, 6))
def test_blocks_are_counted_as_by_hand_and_rates_never_rise(x: np.ndarray, longest: int) -> None:
    longest = min(longest, len(x))
    found = block_rates(x, longest)
    for k, entropy in enumerate(found.entropies, 1):
        blocks = Counter(tuple(np.roll(x, -i)[:k].tolist()) for i in range(len(x)))
        assert entropy.value == pytest.approx(entropy_bits(list(blocks.values())), abs=1e-12)
        assert (entropy.samples, entropy.symbols) == (len(x), len(blocks))
    rates = [q.value for q in found.rates]
    assert all(later <= earlier + 1e-12 for earlier, later in itertools.pairwise(rates))
    assert math.fsum(rates) == pytest.approx(found.entropies[-1].value, abs=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_scan_lines_of_a_sparse_field_are_those_of_the_dense_one(axis: int) -> None:
    dense = sparse((19, 30, 17), 9, 0.04)
    dense[:, :16] = 0
    ours = scan_line_rates(fields_of(dense[None], 9), 5, axis=axis)
    theirs = block_rates(np.moveaxis(dense, axis, 2).reshape(-1, dense.shape[axis]), 5)
    assert [q.value for q in ours.entropies] == [q.value for q in theirs.entropies]
    assert ours.rates[0].samples == dense.size and ours.rates[0].weighting == "voxel"


@given(st.data())
def test_blocks_around_symbols_are_all_the_blocks_that_there_are(data: st.DataObject) -> None:
    """Bricks with gaps, at both ends of the ring, a last brick cut short; against every line laid out."""
    axis = data.draw(st.integers(0, 2))
    shape = [data.draw(st.integers(1, 9)) for _ in range(3)]
    shape[axis] = length = data.draw(st.integers(1, 70))
    longest = data.draw(st.integers(1, min(64, length)))
    places = data.draw(st.lists(st.tuples(*(st.integers(0, n - 1) for n in shape)), max_size=6))
    dense = np.zeros(shape, np.int32)
    for n, place in enumerate(places):
        dense[place] = 1 + n % 3
    ours, theirs = BlockCounter(4, longest), BlockCounter(4, longest)
    for field in fields_of(np.stack([dense, dense]), 4):
        ours.add_field(field, axis)
        theirs.add_lines(np.moveaxis(dense, axis, 2).reshape(-1, length))
    assert ours.result() == theirs.result()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_scan_lines_cost_what_is_stored_and_not_the_lattice(axis: int) -> None:
    """A line of 2^20 samples, three bricks of it stored; laid out they would be 256 MiB."""
    symbols = np.random.default_rng(0).integers(0, 5, (3, 8, 8, 8), dtype=np.int32)
    bricks = np.zeros((3, 3), np.int32)
    bricks[:, axis] = [0, 70_000, 2**17 - 1]
    shape = [8, 8, 8]
    shape[axis] = 2**20
    field = FieldSymbols(Grid(tuple(shape), (1, 1, 1), (0, 0, 0)), bricks, symbols, 5, "test")
    assert most_mib(lambda: scan_line_rates(field, 4, axis=axis)) < 4
    assert scan_line_rates(field, 4, axis=axis).rates[-1].samples == 64 * 2**20


def test_a_long_sequence_in_pieces_is_counted_once() -> None:
    x = markov(300_001)  # more than are looked at at once
    assert block_rates(x, 2).entropies[1].value == pytest.approx(
        entropy_bits(np.bincount(2 * x + np.roll(x, -1))), abs=1e-12
    )


# -- context entropies ------------------------------------------------------------------------------------


@pytest.mark.parametrize("previous", [False, True])
@pytest.mark.parametrize("neighbourhood", list(NEIGHBOURHOODS))
def test_contexts_of_arrays_and_fields_are_counted_as_by_hand(neighbourhood: str, previous: bool) -> None:
    frames = sparse((3, 10, 9, 11), 4, 0.1)
    bits, contexts, cells = conditional_by_brute_force(frames, neighbourhood, previous)
    for given_as in (frames, fields_of(frames, 4), iter(fields_of(frames, 4))):
        found = context_entropy(given_as, neighbourhood, previous_frame=previous)
        assert found.per_voxel.value == pytest.approx(bits, abs=1e-12)
        assert (found.contexts, found.cells) == (contexts, cells)
        assert found.per_voxel.samples == frames.size
        assert found.per_supported.value == pytest.approx(bits * frames.size / np.count_nonzero(frames), rel=1e-12)


@pytest.mark.parametrize("shape", [(50,), (7, 9), (6, 5, 4)])
@pytest.mark.parametrize("high", [2, 2**31 - 1])
def test_arrays_of_few_axes_and_large_symbols(shape: tuple[int, ...], high: int) -> None:
    """Nine symbols of 31 bits fill five words of a key."""
    x = np.where(sparse(shape, 3, 0.6) > 0, sparse(shape, 3, 1.0, 1), 0)
    large = np.where(x == 2, high, x)
    full = x.reshape(1, *(1,) * (3 - len(shape)), *shape)
    for neighbourhood in NEIGHBOURHOODS:
        bits, contexts, cells = conditional_by_brute_force(full, neighbourhood, False)
        found = context_entropy(large, neighbourhood)
        assert (found.contexts, found.cells) == (contexts, cells)
        assert found.per_voxel.value == pytest.approx(bits, abs=1e-12)


@pytest.mark.parametrize("shape", [(2**20,), (2**10, 2**10), (2, 1, 2**9, 2**10)])
@pytest.mark.parametrize("measure", [context_entropy, prequential_code_length])
def test_arrays_take_no_memory_of_their_size(shape: tuple[int, ...], measure: Callable[..., object]) -> None:
    """10^8 symbols take what 10^6 take: a box at a time, whatever the axes; the tables of the code are 32 MiB."""
    x = (np.arange(2**20) % 2).astype(np.int8).reshape(shape)
    tables = 32 if measure is prequential_code_length else 0
    assert most_mib(lambda: measure(x)) < tables + 10


@pytest.mark.parametrize("shape", [(1, 1, 1, 40), (2, 1, 6, 7), (2, 7, 3, 5), (2, 5, 9, 1)])
@pytest.mark.parametrize("most", [1, 6, 16])
def test_arrays_in_boxes_are_measured_as_in_one_piece(
    shape: tuple[int, ...], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    x = np.asfortranarray(sparse(shape, 4, 0.6)).astype(">u2")
    previous = {"previous_frame": True}
    whole = context_entropy(x, "corner", **previous), prequential_code_length(x, split=2)
    monkeypatch.setattr("touchfield.measure.context._VOXELS_AT_ONCE", most)
    monkeypatch.setattr("touchfield.measure.prequential._VOXELS_AT_ONCE", most)
    assert (context_entropy(x, "corner", **previous), prequential_code_length(x, split=2)) == whole


@given(st.tuples(*[st.integers(1, 9)] * 3), st.integers(1, 60))
def test_boxes_fill_an_array_in_raster_order(shape: tuple[int, int, int], most: int) -> None:
    order = np.arange(math.prod(shape)).reshape(shape)
    seen = [order[tuple(map(slice, *box))].ravel() for box in boxes_of(shape, most)]
    assert all(len(s) <= most for s in seen)
    assert np.array_equal(np.concatenate(seen), order.ravel())


@given(hnp.arrays(np.int16, hnp.array_shapes(min_dims=4, max_dims=4, max_side=5), elements=st.integers(0, 3)))
def test_to_know_more_never_costs_more(x: np.ndarray) -> None:
    """H(S|c) <= H(S), and less for each neighbour more: exactly so for the plug-in."""
    found = {(n, p): context_entropy(x, n, previous_frame=p).per_voxel.value
             for n in NEIGHBOURHOODS for p in (False, True)}  # fmt: skip
    assert found["none", False] == pytest.approx(entropy_bits(np.bincount(x.ravel())), abs=1e-12)
    for wide, narrow in itertools.pairwise(reversed(NEIGHBOURHOODS)):
        assert found[wide, False] <= found[narrow, False] + 1e-12
        assert found[wide, True] <= found[narrow, True] + 1e-12
    assert all(found[n, True] <= found[n, False] + 1e-12 for n in NEIGHBOURHOODS)


def test_a_field_whose_axis_neighbours_are_needed_together() -> None:
    """Each voxel is the parity of its three axis neighbours, but for one in ten: H(S|axes) = h2(.1), H(S|one) = 1."""
    flips = (np.random.default_rng(3).random((40, 40, 40)) < 0.1).astype(np.int32)
    h = binary_entropy_bits(float(flips.mean()))
    x = np.pad(flips, ((1, 0),) * 3)
    for p in itertools.product(range(1, 41), repeat=3):
        i, j, k = p
        x[p] ^= x[i - 1, j, k] ^ x[i, j - 1, k] ^ x[i, j, k - 1]
    x = x[1:, 1:, 1:]
    assert context_entropy(x, "axes").per_voxel.value == pytest.approx(h, abs=1e-3)
    assert context_entropy(x, "previous").per_voxel.value == pytest.approx(1, abs=0.01)
    length = prequential_code_length(x, alphabet=2).per_voxel.value
    assert h - 0.01 < length < h + 0.03


def test_independent_voxels_teach_nothing_and_miller_madow_sees_it() -> None:
    x = np.random.default_rng(5).choice(4, (40, 40, 40), p=[0.7, 0.1, 0.1, 0.1])
    h = entropy_bits([7, 1, 1, 1])
    plug_in = context_entropy(x, "axes").per_voxel.value
    corrected = context_entropy(x, "axes", estimator="miller-madow").per_voxel.value
    assert plug_in < corrected and abs(corrected - h) < 0.006
    assert context_entropy(x, "previous").per_voxel.value == pytest.approx(h, abs=0.01)


def test_the_frame_before_is_worth_what_it_tells() -> None:
    rng = np.random.default_rng(6)
    first = rng.integers(0, 2, (24, 24, 24))
    flips = rng.random((7, *first.shape)) < 0.02
    frames = np.concatenate([first[None], first ^ np.cumsum(flips, axis=0) % 2])
    found = context_entropy(frames, "none", previous_frame=True).per_voxel.value
    # of 16 half frames, 9 follow a 0, the two of the first frame among them; 7 follow a 1
    want = 9 / 16 * binary_entropy_bits((1 + 7 * 0.02) / 9) + 7 / 16 * binary_entropy_bits(0.02)
    assert found == pytest.approx(want, abs=0.01)
    assert context_entropy(frames, "corner").per_voxel.value > 0.95


def test_dilution_is_told() -> None:
    x = sparse((12, 12, 12), 200, 0.5)
    with pytest.warns(FewSamplesWarning, match="diluted"):
        found = context_entropy(x, "corner")
    assert found.is_diluted and found.per_voxel.value < 0.2 and "diluted" in found.per_voxel.notes[1]
    assert found.once > 0.9 * found.cells
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not context_entropy(markov(10_000), "previous").is_diluted


def test_cells_with_equal_hashes_are_told_apart() -> None:
    """More cells than the first table holds, and no two merged: counts agree with numpy's sort of whole rows."""
    rng = np.random.default_rng(7)
    rows = rng.integers(0, 60, (60_000, 3), dtype=np.uint64)
    counter = CellCounter(3, 32)  # two symbols to a word
    packed = np.stack([rows[:, 0] | rows[:, 1] << np.uint64(32), rows[:, 2]], axis=1)
    some = packed.any(axis=1)
    counter.add(packed[some])
    counter.add_zeros(int((~some).sum()))
    for columns in ((0, 1, 2), (0, 2), (1,)):
        _, want = np.unique(rows[:, columns], axis=0, return_counts=True)
        assert sorted(counter.counts(columns)) == sorted(want)
    assert counter.samples == len(rows)


# -- the prequential code ---------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 1), max_size=200))
def test_kt_is_the_running_product_and_keeps_its_bound(bits: list[int]) -> None:
    counts, length = [0.5, 0.5], 0.0
    for bit in bits:
        length -= math.log2(counts[bit] / sum(counts))
        counts[bit] += 1
    n, ones = len(bits), sum(bits)
    assert float(kt_code_length_bits(n - ones, ones)) == pytest.approx(length, abs=1e-9)
    if n:
        assert length <= n * binary_entropy_bits(ones / n) + 0.5 * math.log2(n) + 1 + 1e-9


@pytest.mark.parametrize("n", [10**6, 10**9, 10**12])
def test_kt_of_many_keeps_its_bound(n: int) -> None:
    ones = np.array([0, 1, n // 1000, n // 3, n // 2])
    slack = n * np.array([binary_entropy_bits(k / n) for k in ones]) + 0.5 * math.log2(n) + 1
    assert (kt_code_length_bits(n - ones, ones) <= slack + 1e-9 * slack).all()


@pytest.mark.parametrize(
    ("shape", "alphabet", "split"),
    [
        ((2, 2, 2), 2, None),
        ((1, 2, 2), 4, None),
        ((4,), 4, 1),
        ((3,), 7, 3),
        ((3,), 7, None),
        ((2, 1, 1, 3), 3, None),
    ],
)
def test_the_chances_of_all_arrays_add_up_to_one(shape: tuple[int, ...], alphabet: int, split: int | None) -> None:
    """A code: every chance is normalised, whatever came before."""
    size = math.prod(shape)
    every = np.array(list(itertools.product(range(alphabet), repeat=size)), np.int32).reshape(-1, *shape)
    chances = [2 ** -prequential_code_length(x, alphabet=alphabet, split=split).total_bits for x in every]
    assert math.fsum(chances) == pytest.approx(1, abs=1e-9)


def test_the_chances_of_all_small_fields_leave_out_one_case() -> None:
    """That a brick is said to hold something, and then nothing comes: half the chance of eight zeros."""
    every = np.array(list(itertools.product(range(2), repeat=8)), np.int32).reshape(-1, 1, 2, 2, 2)
    chances = [2 ** -prequential_code_length(fields_of(x, 2)).total_bits for x in every]
    never = 0.5 * 2 ** -prequential_code_length(every[0, 0], alphabet=2).total_bits
    assert math.fsum(chances) == pytest.approx(1 - never, abs=1e-9)


@pytest.mark.parametrize("split", [3, 6, 1])
def test_a_decoder_that_knows_only_the_past_agrees(split: int) -> None:
    frames = sparse((3, 11, 18, 9), 7, 0.05)
    frames[:, 2:5, 3:14, 2:6] = 1 + (np.arange(11)[:, None] // 4 + np.arange(4)) % 6  # something to learn
    frames[2, :, :, 8] = 0
    fields = fields_of(frames, 7)
    reference = ReferenceCode(7, split)
    want = [reference.frame(f) for f in fields]
    found = prequential_code_length(fields, split=split)
    assert [f.total for f in found.frames] == pytest.approx(want, rel=1e-6)
    assert found.total_bits == pytest.approx(sum(want), rel=1e-6)


@given(
    hnp.arrays(np.int32, hnp.array_shapes(min_dims=1, max_dims=3, max_side=6), elements=st.integers(0, 4)),
)
def test_never_longer_than_order_zero_and_a_bit(x: np.ndarray) -> None:
    """Whatever the data: the plain KT code of the same binary decisions is the ceiling."""
    found = prequential_code_length(x, alphabet=5).total_bits
    s = x.ravel()
    held = s[s > 0] - 1
    ceiling = float(kt_code_length_bits((s == 0).sum(), len(held)))
    ceiling += float(kt_code_length_bits((held < 2).sum(), (held >= 2).sum()))
    ceiling += float(kt_code_length_bits((held == 0).sum(), (held == 1).sum()))
    ceiling += float(kt_code_length_bits((held == 2).sum(), (held == 3).sum()))
    assert found <= ceiling + 1 + 1e-9


def test_a_known_source_is_neither_beaten_nor_missed() -> None:
    """No code is k bits shorter than -log2 of the true chance but with chance 2^-k (Barron)."""
    x = markov(200_000)
    pairs = np.bincount(2 * x[:-1] + x[1:], minlength=4)
    ideal = -float(pairs @ np.log2([0.95, 0.05, 0.2, 0.8]))
    found = prequential_code_length(x, alphabet=2)
    assert ideal - 30 < found.total_bits < 1.03 * ideal
    p = np.array([0.6, 0.2, 0.15, 0.05])
    y = np.random.default_rng(1).choice(4, (30, 30, 30), p=p)
    ideal = -float(np.bincount(y.ravel(), minlength=4) @ np.log2(p))
    # three binary nodes of order 0, each (log2 n)/2 + 1 bits, and the bit for the mixture
    assert (
        ideal - 30 < prequential_code_length(y, alphabet=4).total_bits < ideal + 3 * (0.5 * math.log2(y.size) + 1) + 1
    )


def test_what_was_learnt_serves_the_next_frame(wavy_field: ForceField) -> None:
    quantiser = FieldQuantiserSpec.parse("weber:0.1").fit([wavy_field])
    symbols = quantiser(wavy_field)
    coder = PrequentialCoder(symbols.alphabet, split=252)
    costs = [coder.add_field(symbols) for _ in range(3)]
    assert costs[1].bricks < costs[0].bricks and costs[1].support < 0.3 * costs[0].support
    assert costs[2].symbols < costs[1].symbols < costs[0].symbols
    found = coder.result("q", "voxel")
    assert found.per_frame.value == pytest.approx(found.total_bits / 3) and found.per_frame.unit == "bit/frame"
    assert found.per_voxel.estimator == "prequential"


# -- all together -----------------------------------------------------------------------------------------


def test_the_limits_of_a_medium(wavy_field: ForceField) -> None:
    moved = wavy_field.scaled(0.9)
    quantiser = FieldQuantiserSpec.parse("weber:0.25/ico3").fit([wavy_field])
    frames = [quantiser(wavy_field), quantiser(moved)]
    found = coding_limits((f for f in frames), split=92, longest=3)
    dense = np.stack([f.to_dense() for f in frames])
    p = np.count_nonzero(dense) / dense.size
    assert (found.frame_count, found.voxels, found.supported) == (2, dense.size, np.count_nonzero(dense))
    identity = binary_entropy_bits(p) + p * found.object_entropy.value
    assert found.voxel_entropy.value == pytest.approx(identity, abs=1e-12)
    assert found.voxel_entropy.value == pytest.approx(found.scan_lines.rates[0].value, abs=1e-12)
    for context in found.contexts:
        alone = context_entropy(frames, context.neighbourhood, previous_frame=context.previous_frame)
        assert alone == context and context.per_voxel.value <= found.voxel_entropy.value
    assert found.prequential == prequential_code_length(frames, split=92)
    assert found.prequential.per_voxel.value > found.context("corner", previous_frame=True).per_voxel.value
    summary = json.loads(json.dumps(found.summary(), allow_nan=False))
    assert summary["prequential"]["bits_per_frame"] == pytest.approx(found.prequential.total_bits / 2)
    for value in (found.scan_lines, found.prequential, *found.contexts):
        json.dumps(value.summary(), allow_nan=False)
    with pytest.raises(KeyError):
        found.context("none")


@pytest.mark.parametrize(
    ("shape", "axis"), [((32, 20, 1), "y"), ((40, 1, 1), "x"), ((1, 40, 1), "y"), ((9, 1, 11), "z"), ((1, 1, 1), "z")]
)
def test_flat_media_are_scanned_along_the_last_axis_that_has_samples(shape: tuple[int, ...], axis: str) -> None:
    """A flat array of actuators has limits, and those of the array without its single sample along z."""
    x = sparse((2, *shape), 4, 0.6)
    x = np.maximum.accumulate(x, axis=1 + "xyz".index(axis))  # neighbours along the lines tell
    found = coding_limits(fields_of(x, 4), split=1)
    assert found.scan_axis == found.summary()["scan_axis"] == axis
    dense = x if axis == "z" else x.reshape(2, *(1,) * shape.count(1), *(n for n in shape if n > 1))
    for context in found.contexts:
        assert context == context_entropy(
            fields_of(x, 4), context.neighbourhood, previous_frame=context.previous_frame
        )
        alone = context_entropy(dense, context.neighbourhood, previous_frame=context.previous_frame)
        assert context.per_voxel.value == pytest.approx(alone.per_voxel.value, abs=1e-12)
        assert (context.contexts, context.cells) == (alone.contexts, alone.cells)
    assert found.prequential == prequential_code_length(fields_of(x, 4), split=1)
    assert found.prequential == coding_limits(fields_of(dense, 4), split=1).prequential
    lines = block_rates(dense.reshape(-1, dense.shape[-1]), min(4, dense.shape[-1]))
    assert [q.value for q in found.scan_lines.rates] == [q.value for q in lines.rates]
    if max(shape) > 1:
        assert found.scan_lines.rates[1].value < 0.9 * found.voxel_entropy.value
        assert found.context("previous").per_voxel.value < 0.9 * found.voxel_entropy.value


def test_an_empty_medium_costs_a_few_bits_and_says_why_it_has_no_object() -> None:
    empty = FieldSymbols(Grid((64, 64, 64), (1, 1, 1), (0, 0, 0)), np.zeros((0, 3), np.int32),
                         np.zeros((0, 8, 8, 8), np.int32), 1, "test")  # fmt: skip
    found = coding_limits([empty, empty])
    assert found.voxel_entropy.value == 0 and math.isnan(found.object_entropy.value)
    assert found.object_entropy.notes and found.prequential.per_supported.notes
    assert 0 < found.prequential.total_bits < 10
    json.dumps(found.summary(), allow_nan=False)


def test_a_nominal_lattice_is_never_laid_out() -> None:
    """8 x 10^9 voxels, one brick of symbols: empty space in closed form."""
    symbols = np.zeros((1, 8, 8, 8), np.int32)
    symbols[0, 2:5, 3, 1] = [1, 2, 1]
    grid = Grid((2909, 2182, 1273), (1e-3,) * 3, (0, 0, 0))
    found = coding_limits(FieldSymbols(grid, np.int32([[100, 7, 150]]), symbols, 3, "test"))
    assert found.voxels == grid.voxel_count and found.supported == 3
    assert found.context("corner").per_voxel.samples == grid.voxel_count == found.scan_lines.rates[-1].samples
    # one brick of 16 million, its 512 samples, three symbols: not a bit for each of the others
    assert 24 < found.prequential.total_bits < 150


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: block_rates([0.5, 1.0]), "Quantise first"),
        (lambda: block_rates([[0, 1], [1]]), "x: found lists"),
        (lambda: context_entropy([[0, 1], [1]]), "frames: found lists"),
        (lambda: prequential_code_length([[0, 1], [1]]), "frames: found lists"),
        (lambda: block_rates(np.zeros(0, int)), "at least one"),
        (lambda: block_rates([1, -1]), "-1"),
        (lambda: block_rates([1, 0, 1], 4), "blocks of 4"),
        (lambda: block_rates([1, 0, 1], 0), "longest"),
        (lambda: block_rates([1, 0, 1], 2, estimator="guess"), "guess"),
        (lambda: scan_line_rates([]), "no frame"),
        (lambda: scan_line_rates(fields_of(np.ones((1, 9, 9, 2), int), 2), 3), "axis of 2"),
        (lambda: scan_line_rates(fields_of(np.ones((1, 9, 9, 2), int), 2), 2, axis=3), "axis"),
        (lambda: context_entropy(np.full((3, 3), np.nan)), "Quantise first"),
        (lambda: context_entropy(np.zeros((2, 2, 2, 2, 2), int)), "dimensions"),
        (lambda: context_entropy(np.zeros(9, int), "moore"), "moore"),
        (lambda: context_entropy(np.zeros((3, 3, 3), int), previous_frame=True), "time first"),
        (lambda: context_entropy(7), "int"),
        (lambda: context_entropy(iter([1, 2])), "FieldSymbols"),
        (lambda: prequential_code_length([0, 1, 2], alphabet=2), "below the alphabet 2"),
        (lambda: prequential_code_length([0, 1, 2], split=3), "split"),
        (lambda: prequential_code_length([0, 1, 2], split=0), "split"),
        (lambda: prequential_code_length(fields_of(np.ones((1, 2, 2, 2), int), 2), alphabet=3), "alphabet"),
        (lambda: PrequentialCoder(2).result(), "no frame"),
        (lambda: kt_code_length_bits(-1, 3), "zeros"),
        (lambda: kt_code_length_bits(1, math.nan), "ones"),
        (lambda: coding_limits([]), "no frame"),
    ],
)  # fmt: skip
def test_what_cannot_be_measured_is_refused(call: object, words: str) -> None:
    with pytest.raises(InvalidArgument, match=words):
        call()


def test_frames_that_do_not_match_are_refused() -> None:
    a = fields_of(np.ones((1, 4, 4, 4), int), 2)[0]
    for other in (
        fields_of(np.ones((1, 4, 4, 5), int), 2)[0],
        fields_of(np.ones((1, 4, 4, 4), int), 3)[0],
        FieldSymbols(a.grid, a.bricks, a.symbols, 2, "another"),
    ):
        for measure in (coding_limits, context_entropy, prequential_code_length, scan_line_rates):
            with pytest.raises(InvalidArgument, match=r"grid|quantiser"):
                measure([a, other])


def test_cells_beyond_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.0005")
    with pytest.raises(InvalidArgument, match="coarser quantiser"):
        context_entropy(np.random.default_rng(0).integers(0, 10**6, (30, 30, 30)), "corner")
