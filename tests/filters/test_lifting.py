"""Quincunx and FCC lifting: perfect reconstruction, coarse samples, and invalid arguments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage

from lifting_makers import FORWARD, INVERSE, coarse_mask, coarse_only, mean_squares
from touchfield.errors import InvalidArgument
from touchfield.filters.lifting import (
    FCC,
    QUINCUNX,
    MultiresolutionFilter,
    SublatticeChain,
    fcc_forward,
    fcc_inverse,
    quincunx_forward,
    quincunx_inverse,
)
from touchfield.medium import Grid

INTEGERS = (np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64)


@st.composite
def integer_arrays(draw: st.DrawFn) -> tuple[int, NDArray[Any], int]:
    dimensions = draw(st.sampled_from((2, 3)))
    shape = draw(st.tuples(*[st.integers(1, 9)] * dimensions))
    components = draw(st.sampled_from(((), (3,), (2, 2))))
    values = draw(arrays(draw(st.sampled_from(INTEGERS)), shape + components))
    return dimensions, values, draw(st.integers(0, 14))


@given(integer_arrays())
@example((2, np.full((3, 3), 2**63, np.uint64), 2))
def test_integer_round_trip_is_exact(case: tuple[int, NDArray[Any], int]) -> None:
    dimensions, values, stages = case
    coefficients = FORWARD[dimensions](values, stages)
    assert coefficients.dtype == (np.int32 if values.itemsize <= 2 else np.int64)
    back = INVERSE[dimensions](coefficients, stages)
    assert back.dtype == np.int64  # a uint64 of at least 2^63 becomes the negative number with its bits
    assert np.array_equal(back, values.astype(np.int64))


@given(
    st.sampled_from((2, 3)),
    st.lists(st.integers(1, 24), min_size=3, max_size=3),
    st.integers(0, 12),
    st.data(),
)
def test_float_round_trip_is_exact_to_rounding(
    dimensions: int, sizes: list[int], stages: int, data: st.DataObject
) -> None:
    kind = data.draw(st.sampled_from((np.float16, np.float32, np.float64)))
    scale = data.draw(st.sampled_from((1e-3, 1.0, 1e3)))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    values = (scale * rng.normal(size=(*sizes[:dimensions], 3))).astype(kind)
    coefficients = FORWARD[dimensions](values, stages)
    back = INVERSE[dimensions](coefficients, stages)
    tolerance = 4e-15 if kind is np.float64 else 1e-6
    assert np.abs(back - values.astype(back.dtype)).max() <= tolerance * float(np.abs(values).max())


@pytest.mark.parametrize("dimensions", [2, 3])
def test_lifting_agrees_with_convolution(dimensions: int) -> None:
    """Steps over the whole array with scipy, where the parity of a site decides whether it is used."""
    rng = np.random.default_rng(dimensions)
    values = rng.normal(size=(11, 8, 9)[:dimensions])
    expected = values.copy()
    chain = {2: QUINCUNX, 3: FCC}[dimensions]
    for stage in range(dimensions):
        before, after = (coarse_mask(values.shape, s) for s in (stage, stage + 1))
        kernel = np.zeros((3,) * dimensions)
        for offset in chain.splits(stage + 1)[-1].offsets:
            kernel[tuple(np.array(offset) + 1)] = 1
        kernel /= kernel.sum()
        details = before & ~after
        # reflection about an edge sample is scipy's "mirror"; here every edge is a site of the first
        # octave
        expected[details] -= ndimage.convolve(expected, kernel, mode="mirror")[details]
        expected[after] += (
            0.5 * ndimage.convolve(np.where(details, expected, 0), kernel, mode="mirror")[after]
        )
    assert np.allclose(FORWARD[dimensions](values, dimensions), expected, atol=1e-14)


def test_one_row_is_lifted_in_one_dimension() -> None:
    x = np.arange(9.0) ** 2
    got = quincunx_forward(x[None], 1)[0]
    assert got[1::2] == pytest.approx(x[1::2] - (x[:-2:2] + x[2::2]) / 2)
    assert got[2:-1:2] == pytest.approx(x[2:-1:2] + (got[1:-2:2] + got[3::2]) / 4)
    assert got[[0, -1]] == pytest.approx(x[[0, -1]] + got[[1, -2]] / 2)
    assert np.array_equal(quincunx_forward(x[None], 2)[0], got)  # the diagonal stage removes no sample
    assert np.array_equal(quincunx_forward(x[:, None], 1)[:, 0], got)
    assert np.array_equal(fcc_forward(x[None, :, None], 1)[0, :, 0], got)


def test_a_flat_volume_is_an_image() -> None:
    image = np.random.default_rng(5).integers(-999, 999, (13, 18, 2))
    assert np.array_equal(fcc_forward(image[:, :, None], 3)[:, :, 0], quincunx_forward(image, 2))
    assert np.array_equal(fcc_forward(image[None], 2)[0], quincunx_forward(image, 2))


def test_components_are_lifted_separately_and_the_input_is_unchanged() -> None:
    values = np.random.default_rng(2).normal(size=(9, 10, 11, 3))
    before = values.copy()
    together = fcc_forward(values, 4)
    assert np.array_equal(values, before)
    for c in range(3):
        assert np.array_equal(together[..., c], fcc_forward(values[..., c], 4))
    assert np.array_equal(fcc_forward(np.asfortranarray(values), 4), together)


def test_integer_lifting_rounds_the_float_result() -> None:
    values = np.random.default_rng(3).integers(-30000, 30000, (12, 13, 14)).astype(np.int16)
    for stages in (1, 2, 3):
        rounded, exact = fcc_forward(values, stages), fcc_forward(values.astype(float), stages)
        assert np.abs(rounded - exact).max() <= 1.0 * stages  # half a unit per step, and its propagation
    # 2.5 rounds up
    assert quincunx_forward(np.array([[0, 5], [5, 0]], np.uint8), 1).tolist() == [
        [3, 5],
        [5, 3],
    ]
    assert quincunx_forward(np.array([[0, -5], [-5, 0]], np.int8), 1).tolist() == [[-2, -5], [-5, -2]]


def test_the_bits_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(4).normal(size=(64, 65, 66, 3)).astype(np.float32)
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append(fcc_forward(values, 7))
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[0], results[2])


# -- the coarse signal -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("stages", [0, 1, 2, 3, 5])
def test_coarse_samples_rebuild_the_coarse_signal(dimensions: int, stages: int) -> None:
    shape = (7, 12, 9)[:dimensions]
    coefficients = FORWARD[dimensions](np.random.default_rng(8).normal(size=(*shape, 3)), stages)
    mask = coarse_mask(shape, stages)
    only = np.where(mask[..., None], coefficients, 0)
    array, chain = INVERSE[dimensions](coefficients, stages), (QUINCUNX, FCC)[dimensions - 2]
    assert np.allclose(coarse_only(array, chain, stages), INVERSE[dimensions](only, stages), atol=1e-12)


@pytest.mark.parametrize("chain", [QUINCUNX, FCC], ids=lambda c: c.name)
def test_a_constant_has_no_details_and_a_ramp_none_inside(chain: SublatticeChain) -> None:
    d = chain.dimensions
    flat = FORWARD[d](np.full((9, 10, 11)[:d], 3, np.int16), 2 * d)
    mask = coarse_mask(flat.shape, 2 * d)
    assert (flat[mask] == 3).all() and not flat[~mask].any()
    ramp = np.indices((24,) * d).sum(axis=0).astype(float)
    inside = (slice(10, -10),) * d
    assert np.abs(coarse_only(ramp, chain, d) - ramp)[inside].max() < 1e-12


def test_details_are_small_where_the_field_is_smooth() -> None:
    n = 32
    smooth = np.cos(2 * np.pi * np.indices((n, n, n)) / n).sum(axis=0)
    noise = np.random.default_rng(0).normal(size=(n, n, n)) * smooth.std()
    of_smooth, of_noise = (mean_squares(fcc_forward(v, 3), FCC, 3) for v in (smooth, noise))
    assert of_smooth[:3].max() < 2e-3 * of_smooth[3]
    assert of_smooth[3] == pytest.approx(np.square(smooth).mean(), rel=0.05)
    assert of_noise[:3].min() > 0.5 * of_noise[3]


# -- what cannot be lifted ---------------------------------------------------------------------------------


@pytest.mark.parametrize("stages", [-1, 61, 1.5, "3", None, True])
def test_invalid_numbers_of_stages_are_refused(stages: Any) -> None:
    image = np.zeros((4, 4, 4))
    for call in (
        lambda: quincunx_forward(image, stages),
        lambda: fcc_inverse(image, stages),
    ):
        with pytest.raises(InvalidArgument, match=r"stages: found .* expected a whole number from 0 to 60"):
            call()


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros(4),
        np.zeros((0, 4)),
        np.zeros((4, 4), complex),
        np.array([["a"]]),
        np.array([[np.nan]]),
        np.array([[np.inf]]),
        np.array([[3e38]], np.float32),
        np.array([[-3e38]], np.float32),
        np.array([[None]]),
    ],
)
def test_invalid_images_are_refused(wrong: NDArray[Any]) -> None:
    with pytest.raises(InvalidArgument, match="image"):
        quincunx_forward(wrong, 1)
    with pytest.raises(InvalidArgument, match="coefficients"):
        quincunx_inverse(wrong, 1)


def test_reach_depends_on_the_stages_with_sites_along_an_axis() -> None:
    reaches = MultiresolutionFilter(6).claims(Grid((40, 40, 2), (0.001,) * 3, (0.0,) * 3)).reach
    assert reaches == (3 * (1 + 1 + 1 + 2 + 2 + 2), 3 * (1 + 1 + 1 + 2 + 2 + 2), 3 * (1 + 1))


def test_invalid_volumes_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"volume.*3 axes"):
        fcc_forward(np.zeros((4, 4)), 1)


def test_booleans_are_numbers() -> None:
    support = np.random.default_rng(0).random((6, 7, 8)) < 0.5
    assert np.array_equal(fcc_inverse(fcc_forward(support, 5), 5), support)


@pytest.mark.shared
def test_recorded_image_round_trip(shared_data: Path) -> None:
    from PIL import Image

    pictures = sorted(p for p in shared_data.rglob("*.png") if p.stat().st_size < 4 << 20)
    if not pictures:
        pytest.skip("no picture")
    picture = np.asarray(Image.open(pictures[0]))
    coefficients = quincunx_forward(picture, 8)
    assert np.array_equal(quincunx_inverse(coefficients, 8), picture)
    energies = mean_squares(coefficients, QUINCUNX, 8)
    assert energies[:8].max() < energies[8]
