"""Block entropies and the rates of scan lines, against brute force and known sources."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from limits_makers import block_rates, fields_of, markov, most_mib, sparse
from touchfield.measure.estimators import entropy_bits
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.limits import BlockCounter, BlockRates
from touchfield.medium import Grid


def scan_line_rates(fields: Sequence[FieldSymbols], longest: int, axis: int) -> BlockRates:
    counter = BlockCounter(fields[0].alphabet, longest, "test")
    for field in fields:
        counter.add_field(field, axis)
    return counter.result()


def bits_by_hand(dense: np.ndarray, axis: int, longest: int) -> list[float]:
    """H(B_k) of the lines of a dense field along an axis, each closed to a ring."""
    lines = np.moveaxis(dense, axis, 2).reshape(-1, dense.shape[axis])
    rolled = np.stack([np.roll(lines, -k, axis=1) for k in range(longest)], axis=-1).reshape(-1, longest)
    counts = (np.unique(rolled[:, :k], axis=0, return_counts=True)[1] for k in range(1, longest + 1))
    return [entropy_bits(n) for n in counts]


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
    ours = scan_line_rates(fields_of(dense[None], 9), 5, axis)
    assert [q.value for q in ours.entropies] == pytest.approx(bits_by_hand(dense, axis, 5), abs=1e-12)
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
    ours = scan_line_rates(fields_of(np.stack([dense, dense]), 4), longest, axis)
    assert [q.value for q in ours.entropies] == pytest.approx(bits_by_hand(dense, axis, longest), abs=1e-12)
    assert ours.rates[0].samples == 2 * dense.size


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_scan_lines_cost_what_is_stored_and_not_the_lattice(axis: int) -> None:
    """A line of 2^20 samples, three bricks of it stored; laid out they would be 256 MiB."""
    symbols = np.random.default_rng(0).integers(0, 5, (3, 8, 8, 8), dtype=np.int32)
    bricks = np.zeros((3, 3), np.int32)
    bricks[:, axis] = [0, 70_000, 2**17 - 1]
    shape = [8, 8, 8]
    shape[axis] = 2**20
    field = FieldSymbols(Grid(tuple(shape), (1, 1, 1), (0, 0, 0)), bricks, symbols, 5, "test")
    assert most_mib(lambda: scan_line_rates([field], 4, axis)) < 4
    assert scan_line_rates([field], 4, axis).rates[-1].samples == 64 * 2**20


def test_a_long_sequence_in_pieces_is_counted_once() -> None:
    x = 1 + markov(300_001)  # more than are looked at at once; blocks of nothing but 0 are counted apart
    assert block_rates(x, 2).entropies[1].value == pytest.approx(
        entropy_bits(np.bincount(3 * x + np.roll(x, -1))), abs=1e-12
    )
