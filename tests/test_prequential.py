"""The prequential code: chances, bounds, a decoder that knows only the past, known sources."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from limits_makers import fields_of, markov, sparse
from prequential_reference import ReferenceCode
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.measure.estimators import binary_entropy_bits
from touchfield.measure.prequential import PrequentialCoder, kt_code_length_bits, prequential_code_length
from touchfield.medium import ForceField

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")


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
