"""Equation 4: dense arrays by two methods against scipy, bricks against dense, and entropies of item 11."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import ArrayLike
from scipy import ndimage, signal

from touchfield.errors import InvalidArgument
from touchfield.filters.fir import ANCHORS, FirFilter, fir_filter, frequency_response
from touchfield.filters.separable import BOUNDARIES, SCIPY_MODES
from touchfield.medium import ForceField, Grid


def random_field(shape: tuple[int, int, int], seed: int, density: float = 0.02) -> ForceField:
    rng = np.random.default_rng(seed)
    forces = rng.normal(size=(*shape, 3)) * (rng.random(shape) < density)[..., None]
    return ForceField.from_dense(Grid(shape, (0.001,) * 3, (0.0,) * 3), forces)


def filter_of_array(taps: ArrayLike, **others: Any) -> FirFilter:
    """The filter of an array of one or three axes, through the text of its taps;
    `others` are its other fields.
    """
    h = np.asarray(taps, np.float64)
    text = "/".join(repr(float(v)) for v in h.ravel())
    return FirFilter(f"{'x'.join(str(n) for n in h.shape)}:{text}" if h.ndim != 1 else text, **others)


# -- dense -------------------------------------------------------------------------------------------------


def test_the_literal_sum_of_equation_4() -> None:
    """The explicit sum: y[n] = sum of h[k] x[n - k], with zeros before the first sample."""
    rng = np.random.default_rng(0)
    x, h = rng.normal(size=20), rng.normal(size=4)
    expected = [sum(h[k] * x[n - k] for k in range(4) if n >= k) for n in range(20)]
    assert fir_filter(x, h, anchor="causal") == pytest.approx(expected, abs=1e-13)
    assert fir_filter(x, h, anchor="causal") == pytest.approx(signal.lfilter(h, [1.0], x), abs=1e-13)


@given(
    st.lists(st.integers(1, 9), min_size=1, max_size=3), st.integers(0, 2), st.sampled_from(ANCHORS),
    st.sampled_from(BOUNDARIES), st.booleans(), st.data(),
)  # fmt: skip
def test_any_kernel_is_the_padded_sum(
    shape: list[int], components: int, anchor: str, boundary: str, product: bool, data: st.DataObject
) -> None:
    rng = np.random.default_rng(len(shape))
    x = rng.normal(size=(*shape, *[2] * components))
    counts = [data.draw(st.integers(1, n)) for n in shape]
    if anchor == "centred":
        counts = [n - 1 + n % 2 for n in counts]
    h = rng.normal(size=counts)
    if product:
        h = math.prod((rng.normal(size=n).reshape([-1 if a == b else 1 for b in range(len(counts))])
                       for a, n in enumerate(counts)), start=np.ones([1] * len(counts)))  # fmt: skip
    mode = {"zero": "constant", "nearest": "edge", "reflect": "symmetric", "wrap": "wrap"}[boundary]
    lookahead = [n // 2 if anchor == "centred" else 0 for n in counts]
    padding = [(n - 1 - a, a) for n, a in zip(counts, lookahead, strict=True)]
    wide = np.pad(x, [*padding, *[(0, 0)] * components], mode=mode)
    expected = np.zeros_like(x)
    for k in itertools.product(*(range(n) for n in counts)):
        window = tuple(slice(n - 1 - i, n - 1 - i + m) for n, i, m in zip(counts, k, shape, strict=True))
        expected += h[k] * wide[window]
    assert np.abs(fir_filter(x, h, anchor=anchor, boundary=boundary) - expected).max() < 1e-12


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_causal_form_is_the_shifted_centred_one(boundary: str) -> None:
    x, h = np.random.default_rng(3).normal(size=(30, 31)), np.random.default_rng(4).normal(size=(5, 7))
    centred, causal = (fir_filter(x, h, anchor=a, boundary=boundary) for a in ("centred", "causal"))
    assert causal[4:-2, 6:-3] == pytest.approx(centred[2:-4, 3:-6], abs=1e-13)  # by (N - 1)/2 = 2 and 3
    assert centred == pytest.approx(ndimage.convolve(x, h, mode=SCIPY_MODES[boundary]), abs=1e-13)


def test_dtype_of_the_signal_is_preserved() -> None:
    h = np.array([1.0, 2.0, 1.0]) / 4
    assert fir_filter(np.ones((9, 3), np.float32), h).dtype == np.float32
    assert fir_filter(np.ones(9, np.int64), h).dtype == np.float64


@pytest.mark.parametrize(
    ("taps", "options", "message"),
    [
        (np.ones(4), {}, "odd number along each axis"),
        (np.ones((3, 2)), {}, "odd number along each axis"),
        (np.ones(11), {}, "11 taps along an axis of 10 samples; expected at most 10"),
        (np.ones((3, 13)), {}, "axis 1: found 13 taps along an axis of 12"),
        (np.ones((1, 1, 1)), {}, "3 axes for a signal"),
        (np.array([1, np.nan, 1]), {}, "not finite"),
        (np.array([]), {}, "at least one tap"),
        (np.array(2.0), {}, "at least one tap"),
        (np.ones(3), {"anchor": "left"}, "centred or causal"),
        (np.ones(3), {"boundary": "mirror"}, "zero, nearest, reflect, wrap"),
    ],
)
def test_invalid_kernels_are_refused(taps: np.ndarray, options: dict[str, str], message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        fir_filter(np.ones((10, 12)), taps, **options)


def test_a_signal_that_is_not_finite_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="signal: found a number that is not finite"):
        fir_filter(np.array([1.0, np.nan, 2.0]), np.ones(1))


# -- item 11: does filtering lower the entropy? ------------------------------------------------------------


def entropy_bits(counts: Counter[object]) -> float:
    total = sum(counts.values())
    return -sum(n / total * math.log2(n / total) for n in counts.values())


def test_filtering_raises_the_entropy_of_a_sample_and_lowers_that_of_the_field() -> None:
    """All 512 equally likely binary fields on a 3 x 3 torus, through the 3 x 3 box sum."""
    fields = np.array(list(itertools.product((0, 1), repeat=9)), float).reshape(-1, 3, 3)
    sample_counts = Counter(fields[:, 1, 1].tolist())
    assert entropy_bits(sample_counts) == 1.0
    boxed = [fir_filter(f, np.ones((3, 3)), boundary="wrap") for f in fields]
    assert entropy_bits(Counter(round(f[1, 1]) for f in boxed)) == pytest.approx(2.629928, abs=1e-6)
    joint = entropy_bits(Counter(tuple(np.rint(f).ravel().tolist()) for f in boxed))
    assert joint == pytest.approx(2.629928, abs=1e-6)  # of 9 bits: all nine sums are equal
    assert joint / 9 == pytest.approx(0.292214, abs=1e-6)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
    crossed = [fir_filter(f, cross, boundary="wrap") for f in fields]
    assert entropy_bits(Counter(round(f[1, 1]) for f in crossed)) > 1.0
    assert entropy_bits(Counter(tuple(np.rint(f).ravel().tolist()) for f in crossed)) <= 9.0 + 1e-12


def test_the_joint_entropy_of_a_valid_box_of_4_by_4() -> None:
    fields = ((np.arange(1 << 16)[:, None] >> np.arange(16)) & 1).reshape(-1, 4, 4).astype(float)
    sums = fir_filter(np.moveaxis(fields, 0, -1), np.ones((3, 3)), anchor="causal")[2:, 2:]
    codes = np.rint(sums).astype(np.int64).reshape(4, -1)
    _, counts = np.unique(codes, axis=1, return_counts=True)
    probability = counts / counts.sum()
    assert -(probability * np.log2(probability)).sum() == pytest.approx(8.786455, abs=1e-6)


# -- bricks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("taps", [[1.0, 3.0, 2.0], [0.5, -1.0, 0.0, 2.0, 1.0]])
def test_one_axis_of_taps_on_bricks_equals_the_dense_array(taps: list[float]) -> None:
    field = random_field((20, 17, 26), 5)
    filtered = filter_of_array(taps, normalise=False)(field)
    h = np.einsum("i,j,k->ijk", taps, taps, taps)
    expected = fir_filter(field.to_dense().astype(float), h)
    assert np.abs(filtered.to_dense() - expected).max() < 2e-5
    assert filtered == ForceField.from_dense(field.grid, filtered.to_dense())


@pytest.mark.parametrize("shape", [(3, 3, 3), (1, 5, 3), (9, 1, 11)])
def test_a_box_of_taps_on_bricks_equals_the_dense_array(shape: tuple[int, int, int]) -> None:
    field = random_field((20, 17, 26), 6)
    h = np.random.default_rng(7).normal(size=shape)
    filtered = filter_of_array(h, normalise=False)(field)
    expected = fir_filter(field.to_dense().astype(float), h)
    assert np.abs(filtered.to_dense() - expected).max() < 1e-5
    assert filtered == ForceField.from_dense(field.grid, filtered.to_dense())


@given(
    st.tuples(*[st.integers(1, 20)] * 3), st.integers(0, 999), st.sampled_from([0.002, 0.1, 1.0]), st.data()
)
def test_any_box_of_taps_on_any_field(
    shape: tuple[int, int, int], seed: int, density: float, data: st.DataObject
) -> None:
    field = random_field(shape, seed, density)
    odd = [2 * data.draw(st.integers(0, min(n - 1, 5) // 2)) + 1 for n in shape]
    h = np.random.default_rng(seed).normal(size=odd)
    filtered = filter_of_array(h, normalise=False)(field)
    expected = fir_filter(field.to_dense().astype(float), h)
    assert np.abs(filtered.to_dense() - expected).max() < 1e-4


@pytest.mark.parametrize("taps", ["1/2/1", "3x3x3:" + "/".join(str(v) for v in range(27))])
def test_the_same_bits_for_any_number_of_threads(taps: str, monkeypatch: pytest.MonkeyPatch) -> None:
    field = random_field((60, 50, 40), 8)
    results = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append(FirFilter(taps)(field))
    assert results[0] == results[1]


def test_bricks_of_a_huge_lattice() -> None:
    grid = Grid((1 << 20, 1 << 20, 1 << 20), (1e-6,) * 3, (0.0,) * 3)
    field = ForceField.from_support(
        grid, [[7, 8, 9], [1 << 19, 0, (1 << 20) - 1]], [[1.0, 0, 0], [0, 2.0, 0]]
    )
    laplace = "3x3x3:0/0/0/0/1/0/0/0/0/0/1/0/1/-6/1/0/1/0/0/0/0/0/1/0/0/0/0"
    filtered = FirFilter(laplace, normalise=False)(field)
    assert filtered.support_count == 7 + 5
    assert filtered.vectors_n().sum(axis=0) == pytest.approx([0, -4, 0])


# -- what it declares --------------------------------------------------------------------------------------


def test_claims_of_a_smoothing_and_a_high_pass() -> None:
    grid = Grid((40, 40, 40), (0.001,) * 3, (0.0,) * 3)
    smooth = FirFilter("1/2/1")
    high = FirFilter("3x1x1:-1/2/-1", normalise=False)
    assert smooth.claims(grid).reach == (1, 1, 1) and smooth.claims(grid).dc_gain == pytest.approx(1)
    assert smooth.claims(grid).keeps_mean and smooth.claims(grid).max_principle
    assert FirFilter("-100/201/-100").claims(grid).dc_gain == pytest.approx(1)  # a small sum is not zero
    with pytest.raises(InvalidArgument, match="found 0 frequencies"):
        frequency_response(1.0)
    assert high.claims(grid).dc_gain == 0 and not high.claims(grid).keeps_mean
    field = ForceField.from_support(grid, [[20, 20, 20]], [[1.0, 2.0, 3.0]])
    assert smooth(field).vectors_n().sum(axis=0) == pytest.approx([1, 2, 3], rel=1e-6)
    assert high(field).vectors_n().sum(axis=0) == pytest.approx([0, 0, 0], abs=1e-6)


def test_a_constant_is_multiplied_by_the_gain() -> None:
    grid = Grid((12, 12, 12), (0.001,) * 3, (0.0,) * 3)
    field = ForceField.from_dense(grid, np.ones((12, 12, 12, 3)))
    for filt in (FirFilter("1/2/4"), FirFilter("1/2/4", normalise=False)):
        gain = filt.claims(grid).dc_gain
        assert filt.claims(grid).keeps_mean == filt.normalise
        assert gain == pytest.approx(1 if filt.normalise else 343)
        assert filt(field).to_dense()[1:-1, 1:-1, 1:-1] == pytest.approx(
            np.full((10, 10, 10, 3), gain), rel=1e-6
        )


def test_a_flat_field_is_filtered_along_its_two_axes() -> None:
    field = random_field((20, 20, 1), 9, 0.2)
    h = np.array([1.0, 2.0, 1.0]) / 4
    expected = fir_filter(field.to_dense().astype(float), np.multiply.outer(h, h))
    assert np.abs(FirFilter("1/2/1")(field).to_dense() - expected).max() < 1e-6


# -- words -------------------------------------------------------------------------------------------------


def test_text_round_trip() -> None:
    parsed = FirFilter.parse("1/2/1,anchor=centred,boundary=zero")  # the notation of older streams
    assert parsed == FirFilter("1/2/1") == FirFilter.parse(parsed.text)
    h = np.random.default_rng(1).normal(size=(3, 1, 3))
    array_filter, field = filter_of_array(h), random_field((16, 16, 16), 2)
    assert np.array_equal(array_filter.kernel, h) and array_filter(field) == FirFilter.parse(
        array_filter.text
    )(field)


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("taps", ["1/2/1", "3x1x3:0/1/0/1/4/1/0/1/0"])
def test_a_field_continues_beyond_its_border_as_an_array_does(boundary: str, taps: str) -> None:
    field = random_field((11, 9, 10), 3, density=0.5)
    by_text = FirFilter.parse(f"{taps},boundary={boundary}")
    weights = by_text.kernel / by_text.kernel.sum()
    if weights.ndim == 1:
        weights = weights[:, None, None] * weights[:, None] * weights
    expected = fir_filter(field.to_dense(), weights, boundary=boundary)
    np.testing.assert_allclose(by_text(field).to_dense(), expected, atol=1e-6)
    with pytest.raises(InvalidArgument, match="boundary"):
        FirFilter.parse(f"{taps},boundary=mirror")


@pytest.mark.parametrize("shape", [(3,), (3, 1, 3)])
def test_taps_of_a_file_become_text(tmp_path: Path, shape: tuple[int, ...]) -> None:
    """Only the command line reads a file: the text of a stream never names one."""
    taps = np.random.default_rng(7).random(shape)
    np.save(tmp_path / "taps.npy", taps)
    text = FirFilter.expand(f"{tmp_path / 'taps.npy'},normalise=false")
    np.testing.assert_array_equal(FirFilter.parse(text).kernel, taps)
    assert not FirFilter.parse(text).normalise and FirFilter.expand("1/2/1") == "1/2/1"
    with pytest.raises(InvalidArgument, match="--fir taps"):
        FirFilter.parse(str(tmp_path / "taps.npy"))
    (tmp_path / "bad.npy").write_bytes(b"no array")
    with pytest.raises(InvalidArgument, match=r"bad.npy, which cannot be read"):
        FirFilter.expand(str(tmp_path / "bad.npy"))


def test_an_empty_field_stays_empty() -> None:
    empty = ForceField.empty(Grid((8, 8, 8), (1.0,) * 3, (0.0,) * 3))
    assert FirFilter("1/2/1")(empty) == empty
    assert filter_of_array(np.random.default_rng(1).normal(size=(3, 3, 3)))(empty) == empty


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no taps"),
        ("1/x/1", "numbers with /"),
        ("2x2x2:1/2", "after a shape"),
        ("3x3:1/2/3/4/5/6/7/8/9", "one axis or three"),
        ("1/1", "odd number"),
        ("1/nan/1", "not finite"),
        ("-1/2/-1", "normalise=false"),
        ("0/0/0,normalise=false", "not zero"),
        ("taps.npy", "numbers with /"),
        ("1/2/1,anchor=causal", "each of taps, normalise, boundary at most once"),
        ("1/2/1,normalise=perhaps", "true or false"),
    ],
)
def test_invalid_texts_are_refused(text: str, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        FirFilter.parse(text)


def test_a_kernel_larger_than_the_field_is_refused() -> None:
    field = random_field((20, 20, 4), 1, 0.1)
    with pytest.raises(InvalidArgument, match="along z: found 5 taps along an axis of 4 samples"):
        FirFilter("1/1/1/1/1")(field)
    with pytest.raises(InvalidArgument, match="along z: found 3 taps along an axis of 2 samples"):
        FirFilter("1/2/1").claims(Grid((20, 20, 2), (0.001,) * 3, (0.0,) * 3))
    with pytest.raises(InvalidArgument, match="along z"):
        filter_of_array(np.random.default_rng(0).normal(size=(1, 1, 5))).claims(field.grid)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sums_beyond_the_type_are_refused(dtype: type) -> None:
    huge = 0.5 * float(np.finfo(dtype).max)
    message = f"signal: found numbers whose sums are beyond {np.dtype(dtype)}"
    for shape, taps in (((40,), np.ones(3)), ((9, 9), np.eye(3)), ((7, 7, 7, 3), np.ones((3, 3, 3)))):
        with pytest.raises(InvalidArgument, match=message):
            fir_filter(np.full(shape, huge, dtype), taps)
    assert np.isfinite(fir_filter(np.full(40, huge / 8, dtype), np.ones(3))).all()


@pytest.mark.parametrize("taps", ["1/2/1", "3x3x3:" + "/".join(str(v) for v in range(27)), "1e39/1e39/1e39"])
def test_forces_beyond_float32_are_refused(taps: str) -> None:
    grid = Grid((12, 12, 12), (0.001,) * 3, (0.0,) * 3)
    field = ForceField.from_dense(grid, np.full((12, 12, 12, 3), 3e38))
    with pytest.raises(InvalidArgument, match=r"sums are beyond float32|a number that is not finite"):
        FirFilter(taps, normalise=False)(field)
