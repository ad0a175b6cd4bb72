"""Quincunx and FCC lifting: lattices, perfect reconstruction, what passes, and the filter on sparse fields."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage

from touchfield.errors import InvalidArgument
from touchfield.filters.fcc import fcc_coarse, fcc_forward, fcc_inverse, fcc_passband, fcc_responses
from touchfield.filters.field_filter import FieldFilter
from touchfield.filters.lifting import coarse_only, stage_mean_squares
from touchfield.filters.multiresolution import FILTER, MultiresolutionFilter
from touchfield.filters.quincunx import (
    quincunx_coarse,
    quincunx_forward,
    quincunx_inverse,
    quincunx_passband,
    quincunx_responses,
)
from touchfield.filters.sublattices import FCC, QUINCUNX, Chain, coarse_mask
from touchfield.medium import ForceField, Grid

FORWARD = {2: quincunx_forward, 3: fcc_forward}
INVERSE = {2: quincunx_inverse, 3: fcc_inverse}
COARSE = {2: quincunx_coarse, 3: fcc_coarse}
INTEGERS = (np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64)


def wave(shape: tuple[int, ...], frequency: tuple[float, ...]) -> NDArray[np.float64]:
    """cos(w . n); the frequency is in cycles over the whole array, so that the DFT has it in one bin."""
    phase = sum(2 * np.pi * f / n * i for f, n, i in zip(frequency, shape, np.indices(shape), strict=True))
    return np.asarray(np.cos(phase))


def frequencies(shape: tuple[int, ...]) -> list[NDArray[np.float64]]:
    """The frequencies of the DFT, radians a sample."""
    return list(np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n) for n in shape), indexing="ij"))


# -- lattices ---------------------------------------------------------------------------------------------------


def test_the_quincunx_keeps_the_sites_of_its_matrix() -> None:
    matrix = np.array([[1, 1], [1, -1]])
    for stages in range(1, 7):
        kept = np.argwhere(coarse_mask((12, 16), stages))
        whole = np.linalg.solve(np.linalg.matrix_power(matrix, stages).astype(float), kept.T)
        assert np.allclose(whole, np.round(whole))  # every kept site is D^s k ...
    n1, n2 = np.indices((12, 16))
    assert np.array_equal(coarse_mask((12, 16), 1), (n1 + n2) % 2 == 0)  # ... and none is missing
    assert np.array_equal(coarse_mask((12, 16), 2), (n1 % 2 == 0) & (n2 % 2 == 0))


def test_the_fcc_and_what_follows_it() -> None:
    a, b, c = np.indices((8, 8, 8))
    assert np.array_equal(coarse_mask((8, 8, 8), 1), (a + b + c) % 2 == 0)
    assert np.array_equal(coarse_mask((8, 8, 8), 2), ((a + b) % 2 == 0) & (c % 2 == 0))
    assert np.array_equal(coarse_mask((8, 8, 8), 3), (a % 2 == 0) & (b % 2 == 0) & (c % 2 == 0))
    assert np.array_equal(coarse_mask((8, 8, 8), 5)[::2, ::2, ::2], coarse_mask((4, 4, 4), 2))


@pytest.mark.parametrize("chain", [QUINCUNX, FCC], ids=lambda c: c.name)
def test_each_stage_keeps_half_of_a_lattice_and_the_neighbours_are_the_nearest(chain: Chain) -> None:
    d = chain.dimensions
    centre = np.full(d, 16)
    for stage, split in enumerate(chain.splits(2 * d)):
        before, after = (coarse_mask((33,) * d, s) for s in (stage, stage + 1))
        assert not (after & ~before).any()
        assert coarse_mask((32,) * d, stage).sum() == 2 * coarse_mask((32,) * d, stage + 1).sum()
        sites = np.argwhere(after) - centre
        near = sites[(np.abs(sites) <= 8).all(axis=1)]  # a lattice: it holds all differences of its sites
        held = {tuple(s) for s in np.argwhere(after) - centre}
        assert all(tuple(p - q) in held for p, q in itertools.product(near[::7], near[::5]))
        around = {tuple(o) for o in np.array(split.offsets) * split.scale}
        details = np.argwhere(before & ~after)
        for detail in details[(np.abs(details - centre) <= split.scale).all(axis=1)]:
            away = np.argwhere(after) - detail
            square = (away**2).sum(axis=1)
            assert {tuple(v) for v in away[square == square.min()]} == around
        assert {tuple(-np.array(o)) for o in around} == around


def test_no_body_centred_lattice_lies_in_the_fcc() -> None:
    """Its least square distance would be 3 (its density being 1/4), and the FCC has none that is odd."""
    sites = np.argwhere(coarse_mask((9, 9, 9), 1)) - 4
    assert not ((sites**2).sum(axis=1) % 2).any()
    body_centred = np.array([[-1, 1, 1], [1, -1, 1], [1, 1, -1]])
    assert abs(np.linalg.det(body_centred)) == pytest.approx(4)
    assert (body_centred**2).sum(axis=1).tolist() == [3, 3, 3]


def test_masks_of_odd_shapes() -> None:
    assert coarse_mask((1, 5), 1).tolist() == [[True, False, True, False, True]]
    assert coarse_mask((1, 1, 1), 60).all()
    assert coarse_mask((3, 4), 0).all()
    assert coarse_mask((7, 5), 20).sum() == 1


# -- perfect reconstruction -------------------------------------------------------------------------------------


@st.composite
def integer_arrays(draw: st.DrawFn) -> tuple[int, NDArray[Any], int]:
    dimensions = draw(st.sampled_from((2, 3)))
    shape = draw(st.tuples(*[st.integers(1, 9)] * dimensions))
    components = draw(st.sampled_from(((), (3,), (2, 2))))
    values = draw(arrays(draw(st.sampled_from(INTEGERS)), shape + components))
    return dimensions, values, draw(st.integers(0, 14))


@given(integer_arrays())
def test_integers_come_back_with_the_same_bits(case: tuple[int, NDArray[Any], int]) -> None:
    dimensions, values, stages = case
    coefficients = FORWARD[dimensions](values, stages)
    assert coefficients.dtype == (np.int32 if values.itemsize <= 2 else np.int64)
    back = INVERSE[dimensions](coefficients, stages, values.dtype)
    assert back.dtype == values.dtype and np.array_equal(back, values)


@given(st.sampled_from((2, 3)), st.lists(st.integers(1, 24), min_size=3, max_size=3), st.integers(0, 12), st.data())
def test_floats_come_back_to_rounding(dimensions: int, sizes: list[int], stages: int, data: st.DataObject) -> None:
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
    """Steps over the whole array with scipy, where only the parity of a site decides whether it is used."""
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
        # the mirror image about an edge sample is scipy's "mirror"; here every edge is a site of the first octave
        expected[details] -= ndimage.convolve(expected, kernel, mode="mirror")[details]
        expected[after] += 0.5 * ndimage.convolve(np.where(details, expected, 0), kernel, mode="mirror")[after]
    assert np.allclose(FORWARD[dimensions](values, dimensions), expected, atol=1e-14)


def test_one_row_is_lifted_in_one_dimension() -> None:
    x = np.arange(9.0) ** 2
    got = quincunx_forward(x[None], 1)[0]
    assert got[1::2] == pytest.approx(x[1::2] - (x[:-2:2] + x[2::2]) / 2)
    assert got[2:-1:2] == pytest.approx(x[2:-1:2] + (got[1:-2:2] + got[3::2]) / 4)
    assert got[[0, -1]] == pytest.approx(x[[0, -1]] + got[[1, -2]] / 2)
    assert np.array_equal(quincunx_forward(x[None], 2)[0], got)  # the diagonal stage has nothing to drop
    assert np.array_equal(quincunx_forward(x[:, None], 1)[:, 0], got)
    assert np.array_equal(fcc_forward(x[None, :, None], 1)[0, :, 0], got)


def test_a_flat_volume_is_an_image() -> None:
    image = np.random.default_rng(5).integers(-999, 999, (13, 18, 2))
    assert np.array_equal(fcc_forward(image[:, :, None], 3)[:, :, 0], quincunx_forward(image, 2))
    assert np.array_equal(fcc_forward(image[None], 2)[0], quincunx_forward(image, 2))


def test_components_are_lifted_alone_and_the_input_is_left_as_it_was() -> None:
    values = np.random.default_rng(2).normal(size=(9, 10, 11, 3))
    before = values.copy()
    together = fcc_forward(values, 4)
    assert np.array_equal(values, before)
    for c in range(3):
        assert np.array_equal(together[..., c], fcc_forward(values[..., c], 4))
    assert np.array_equal(fcc_forward(np.asfortranarray(values), 4), together)


def test_integer_lifting_rounds_to_the_nearest_of_what_floats_give() -> None:
    values = np.random.default_rng(3).integers(-30000, 30000, (12, 13, 14)).astype(np.int16)
    for stages in (1, 2, 3):
        whole, exact = fcc_forward(values, stages), fcc_forward(values.astype(float), stages)
        assert np.abs(whole - exact).max() <= 1.0 * stages  # half a unit each step, and what they hand on
    assert quincunx_forward(np.array([[0, 5], [5, 0]], np.uint8), 1).tolist() == [[3, 5], [5, 3]]  # 2.5 goes up
    assert quincunx_forward(np.array([[0, -5], [-5, 0]], np.int8), 1).tolist() == [[-2, -5], [-5, -2]]


def test_the_bits_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(4).normal(size=(64, 65, 66, 3)).astype(np.float32)
    made = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        made.append(fcc_forward(values, 7))
    assert np.array_equal(made[0], made[1]) and np.array_equal(made[0], made[2])


# -- frequencies ------------------------------------------------------------------------------------------------


def test_masked_spectrum_and_halfband_identity_of_the_quincunx() -> None:
    shape = (16, 12)
    image = np.random.default_rng(1).normal(size=shape)
    spectrum = np.fft.fft2(image)
    masked = np.fft.fft2(image * coarse_mask(shape, 1))
    assert np.allclose(masked, 0.5 * (spectrum + np.roll(spectrum, (8, 6), (0, 1))), atol=1e-12)
    w1, w2 = frequencies(shape)
    h0 = quincunx_responses(w1, w2)[1] / 2
    assert np.allclose(h0, 0.5 + 0.25 * (np.cos(w1) + np.cos(w2)), atol=1e-15)
    assert np.allclose(h0 + quincunx_responses(w1 + np.pi, w2 + np.pi)[1] / 2, 1, atol=1e-15)


def test_masked_spectrum_and_halfband_identity_of_the_fcc() -> None:
    shape = (8, 12, 10)
    volume = np.random.default_rng(1).normal(size=shape)
    spectrum = np.fft.fftn(volume)
    masked = np.fft.fftn(volume * coarse_mask(shape, 1))
    assert np.allclose(masked, 0.5 * (spectrum + np.roll(spectrum, (4, 6, 5), (0, 1, 2))), atol=1e-11)
    w = frequencies(shape)
    h0 = fcc_responses(*w)[1] / 2
    assert np.allclose(h0 + fcc_responses(*(x + np.pi for x in w))[1] / 2, 1, atol=1e-15)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_stated_responses_are_those_of_the_lifting(dimensions: int) -> None:
    """An impulse far from the border: at a kept and at a dropped site, forth and back."""
    shape, centre = ((17,) * dimensions, (8,) * dimensions)
    responses = {2: quincunx_responses, 3: fcc_responses}[dimensions]
    w = frequencies(shape)
    analysis, synthesis = responses(*w)
    rows = np.zeros(shape)  # the coarse site in the middle as a function of the input
    for site in itertools.product(range(5, 12), repeat=dimensions):
        impulse = np.zeros(shape)
        impulse[site] = 1
        rows[site] = FORWARD[dimensions](impulse, 1)[centre]
    assert np.allclose(np.fft.fftn(np.fft.ifftshift(rows)), analysis, atol=1e-13)
    impulse = np.zeros(shape)
    impulse[centre] = 1
    spread = INVERSE[dimensions](impulse, 1)  # a coarse value alone; its update subtracts no detail
    assert np.allclose(np.fft.fftn(np.fft.ifftshift(spread)), synthesis, atol=1e-13)


def test_the_passbands_are_half_of_the_cube_and_tile_it_with_their_image() -> None:
    rng = np.random.default_rng(9)
    w = rng.uniform(-np.pi, np.pi, (3, 400_000))
    for passband, d in ((quincunx_passband, 2), (fcc_passband, 3)):
        inside = passband(*w[:d])
        assert inside.mean() == pytest.approx(0.5, abs=0.004)
        assert (inside ^ passband(*(w[:d] + np.pi))).all()
    cell = np.abs(w).sum(axis=0) <= 1.5 * np.pi
    assert np.array_equal(fcc_passband(*w), cell)
    n = 200  # the volume once more, by the midpoint rule
    axis = (np.arange(n) + 0.5) / n * np.pi
    volume = (axis[:, None, None] + axis[:, None] + axis <= 1.5 * np.pi).mean()
    assert volume == pytest.approx(0.5, abs=1e-4)


def test_a_pattern_that_separable_decimation_aliases_keeps_its_frequency() -> None:
    """0.75 pi along an axis: in the diamond, but beyond pi / 2; decimated by 2 it is felt as 0.25 pi."""
    image = wave((32, 32), (12.0, 0.0))
    separable = np.zeros_like(image)
    separable[::2, ::2] = image[::2, ::2]
    w1, w2 = frequencies((32, 32))
    slow = np.hypot(w1, w2) < np.pi / 2
    kept = image * coarse_mask((32, 32), 1)
    assert quincunx_passband(0.75 * np.pi, 0.0) and not quincunx_passband(0.75 * np.pi, 0.5 * np.pi)
    assert np.abs(np.fft.fft2(separable))[slow].max() == pytest.approx(32 * 32 / 8)  # a phantom at 0.25 pi
    assert np.abs(np.fft.fft2(kept))[slow].max() < 1e-9
    rebuilt = np.abs(np.fft.fft2(coarse_only(image[:, :], QUINCUNX, 1)))
    assert rebuilt[12, 0] > 0.55 * 32 * 32 / 2  # the pattern itself is still there
    assert rebuilt[12, 0] > 2 * rebuilt[slow].max()


def test_a_time_that_stands_still_passes_the_second_stage_of_x_y_t() -> None:
    """x, y, t: after two stages every second frame is left, as a quincunx picture."""
    still = np.repeat(np.random.default_rng(6).normal(size=(16, 16, 1)), 12, axis=2)
    found = fcc_coarse(fcc_forward(still, 2), 2)
    assert not (found.positions[:, 2] % 2).any()
    assert not (found.positions[:, :2].sum(axis=1) % 2).any()
    frames = found.values.reshape(-1, 6)  # raster order, t fastest
    assert np.allclose(frames, frames[:, :1], atol=1e-12)


# -- the coarse signal ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("stages", [0, 1, 2, 3, 5])
def test_the_coarse_samples_are_where_the_mask_says(dimensions: int, stages: int) -> None:
    shape = (7, 12, 9)[:dimensions]
    coefficients = FORWARD[dimensions](np.random.default_rng(8).normal(size=(*shape, 3)), stages)
    found = COARSE[dimensions](coefficients, stages)
    mask = coarse_mask(shape, stages)
    assert np.array_equal(found.positions, np.argwhere(mask))
    assert np.array_equal(found.values, coefficients[mask])
    assert not found.values.flags.writeable
    only = np.where(mask[..., None], coefficients, 0)
    array, chain = INVERSE[dimensions](coefficients, stages), (QUINCUNX, FCC)[dimensions - 2]
    assert np.allclose(coarse_only(array, chain, stages), INVERSE[dimensions](only, stages), atol=1e-12)


@pytest.mark.parametrize("chain", [QUINCUNX, FCC], ids=lambda c: c.name)
def test_a_constant_has_no_details_and_a_ramp_none_inside(chain: Chain) -> None:
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
    of_smooth, of_noise = (stage_mean_squares(fcc_forward(v, 3), FCC, 3) for v in (smooth, noise))
    assert of_smooth[:3].max() < 2e-3 * of_smooth[3]
    assert of_smooth[3] == pytest.approx(np.square(smooth).mean(), rel=0.05)
    assert of_noise[:3].min() > 0.5 * of_noise[3]


def test_mean_squares_are_counted_by_hand() -> None:
    values = np.zeros((2, 2, 2))
    values[0, 0], values[0, 1], values[1, 0], values[1, 1] = (1, 2), (3, 0), (0, 4), (5, 0)
    assert stage_mean_squares(values, QUINCUNX, 0).tolist() == [55 / 4]
    assert stage_mean_squares(values, QUINCUNX, 1).tolist() == [25 / 2, 30 / 2]
    assert stage_mean_squares(values, QUINCUNX, 2).tolist() == [25 / 2, 25, 5]
    assert stage_mean_squares(np.ones((1, 1)), QUINCUNX, 1).tolist() == [0, 1]


# -- what cannot be lifted --------------------------------------------------------------------------------------


@pytest.mark.parametrize("stages", [-1, 61, 1.5, "3", None, True])
def test_a_number_of_stages_that_is_none(stages: Any) -> None:
    image = np.zeros((4, 4, 4))
    for call in (
        lambda: quincunx_forward(image, stages),
        lambda: fcc_inverse(image, stages),
        lambda: fcc_coarse(image, stages),
        lambda: coarse_only(image, FCC, stages),
        lambda: stage_mean_squares(image, FCC, stages),
        lambda: coarse_mask((4, 4), stages),
    ):
        with pytest.raises(InvalidArgument, match=r"stages: found .* expected a whole number from 0 to 60"):
            call()


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros(4), np.zeros((0, 4)), np.zeros((4, 4), complex), np.array([["a"]]), np.array([[np.nan]]),
        np.array([[np.inf]]), np.array([[3e38]], np.float32), np.array([[None]]),
    ],
)  # fmt: skip
def test_an_image_that_is_none(wrong: NDArray[Any]) -> None:
    with pytest.raises(InvalidArgument, match="image"):
        quincunx_forward(wrong, 1)
    with pytest.raises(InvalidArgument, match="coefficients"):
        quincunx_inverse(wrong, 1)
    with pytest.raises(InvalidArgument, match="coefficients"):
        quincunx_coarse(wrong, 1)


def test_a_volume_and_a_shape_that_are_none() -> None:
    with pytest.raises(InvalidArgument, match=r"volume.*3 axes"):
        fcc_forward(np.zeros((4, 4)), 1)
    for shape in ((4,), (4, 4, 4, 4), (4, 0), (-1, -4)):
        with pytest.raises(InvalidArgument, match="shape"):
            coarse_mask(shape, 1)


def test_booleans_are_numbers() -> None:
    support = np.random.default_rng(0).random((6, 7, 8)) < 0.5
    assert np.array_equal(fcc_inverse(fcc_forward(support, 5), 5, bool), support)


# -- the filter on fields ---------------------------------------------------------------------------------------


def field_of(forces_n: NDArray[Any]) -> ForceField:
    return ForceField.from_dense(Grid(forces_n.shape[:3], (0.001, 0.002, 0.003), (0.1, 0.2, 0.3)), forces_n)


def sparse(shape: tuple[int, int, int], share: float, seed: int = 0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    held = rng.random(shape) < share
    return (rng.normal(size=(*shape, 3)) * held[..., None]).astype(np.float32)


def clear_of(claims_reach: tuple[int, int, int], room: int = 3) -> tuple[int, int, int]:
    x, y, z = (2 * r + room + 2 for r in claims_reach)
    return (x, y, z)


@pytest.mark.parametrize("shape", [(40, 37, 50), (24, 20, 17), (5, 6, 7), (9, 16, 33), (90, 70, 1), (1, 64, 70),
                                   (1, 1, 130)])  # fmt: skip
@pytest.mark.parametrize("stages", [1, 2, 3, 4, 8, 12])
def test_in_bricks_the_bits_are_those_of_the_whole(shape: tuple[int, int, int], stages: int) -> None:
    for forces in (sparse(shape, 1.0), sparse(shape, 3 / math.prod(shape), seed=1)):
        made = MultiresolutionFilter(stages)(field_of(forces))
        assert np.array_equal(made.to_dense(), coarse_only(forces, FCC, stages))
        assert made.mask.any(axis=(1, 2, 3)).all()
        assert ForceField.from_bricks(made.grid, made.bricks, made.forces_n) == made  # nothing beyond the grid


@pytest.mark.parametrize("stages", [1, 2, 3, 7])
def test_nothing_goes_farther_than_the_reach(stages: int) -> None:
    wide = Grid((200, 200, 200), (1, 1, 1), (0, 0, 0))
    step = MultiresolutionFilter(stages)
    reach = np.array(step.claims(wide).reach)
    found = np.zeros(3, int)
    for offset in itertools.product((0, 1), repeat=3):  # each place relative to the first octave's lattice
        at = np.array((96, 96, 96)) + offset
        out = step(ForceField.from_support(wide, at[None], [[1.0, 2.0, 3.0]]))
        assert out.support_count > 1
        found = np.maximum(found, np.abs(out.positions() - at).max(axis=0))
    assert (found <= reach).all()
    if stages == 1:
        assert (found == reach).all()
    assert reach.tolist() == [[3, 3, 3], [6, 6, 6], [9, 9, 6], [39, 39, 30]][[1, 2, 3, 7].index(stages)]


@pytest.mark.parametrize("stages", [1, 3, 5])
def test_mean_constant_and_sum_are_as_claimed(stages: int) -> None:
    wide = Grid((160, 160, 160), (1, 1, 1), (0, 0, 0))
    step, rest = MultiresolutionFilter(stages), MultiresolutionFilter(stages, "details")
    claims = step.claims(wide)
    assert claims.linear and claims.keeps_mean and claims.dc_gain == 1 and rest.claims(wide).dc_gain == 0
    shape = clear_of(claims.reach)
    rng = np.random.default_rng(stages)
    positions = rng.integers(70, 90, (40, 3))
    fields = [ForceField.from_support(wide, positions[i::2], rng.normal(size=(20, 3))) for i in range(2)]
    for field in fields:
        total = field.forces_n.sum(axis=(0, 1, 2, 3), dtype=np.float64)
        made = step(field).forces_n.sum(axis=(0, 1, 2, 3), dtype=np.float64)
        assert made == pytest.approx(total, abs=1e-5)
        assert np.abs((step(field) + rest(field) + field.scaled(-1)).forces_n).max(initial=0) < 1e-6
    both = step(fields[0].scaled(2.0) + fields[1])
    parts = step(fields[0]).scaled(2.0) + step(fields[1])
    assert np.abs((both + parts.scaled(-1.0)).forces_n).max(initial=0) < 2e-6
    constant = np.broadcast_to(np.float32([1, -2, 0.3]), (*(min(n, 48) for n in shape), 3))
    assert np.abs(step(field_of(constant)).to_dense() - constant).max() < 1e-6  # at the border, too
    assert np.abs(rest(field_of(constant)).to_dense()).max() < 1e-6


def test_a_level_of_detail_is_one_already() -> None:
    forces = sparse((33, 34, 35), 0.2)
    once = MultiresolutionFilter(3)(field_of(forces))
    twice = MultiresolutionFilter(3)(once)
    assert np.abs(once.to_dense() - forces).max() > 0.5
    assert np.abs(twice.to_dense() - once.to_dense()).max() < 1e-6  # a projection


def test_a_field_of_a_million_million_samples_stays_sparse() -> None:
    grid = Grid((1 << 14, 1 << 14, 1 << 13), (1e-5,) * 3, (0, 0, 0))
    rng = np.random.default_rng(3)
    at = np.concatenate([rng.integers(0, 8192, (3, 3)), [[0, 0, 0], [16383, 16383, 8191]]])
    forces = rng.normal(size=(5, 3))
    made = MultiresolutionFilter(4)(ForceField.from_support(grid, at, forces))
    assert 0 < len(made.bricks) < 400
    reach = MultiresolutionFilter(4).claims(grid).reach
    assert (np.abs(made.positions()[:, None] - at) <= reach).all(axis=2).any(axis=1).all()
    corner = np.zeros((64, 64, 64, 3), np.float32)
    corner[0, 0, 0] = forces[3]
    expected = coarse_only(corner, FCC, 4)
    low = made.positions().max(axis=1) < 40
    found = np.zeros_like(corner)
    found[tuple(made.positions()[low].T)] = made.vectors_n()[low]
    assert np.array_equal(found, expected)


def test_an_empty_field_and_one_sample() -> None:
    grid = Grid((40, 30, 20), (1, 1, 1), (0, 0, 0))
    for stages in (1, 12):
        for keep in ("coarse", "details"):
            assert MultiresolutionFilter(stages, keep)(ForceField.empty(grid)) == ForceField.empty(grid)
    point = field_of(np.ones((1, 1, 1, 3), np.float32))
    assert MultiresolutionFilter(5)(point) == point
    assert MultiresolutionFilter(5).claims(point.grid).reach == (0, 0, 0)


def test_the_threads_do_not_show_in_a_field(monkeypatch: pytest.MonkeyPatch, wavy_field: ForceField) -> None:
    made = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        made.append(MultiresolutionFilter(5)(wavy_field))
    assert made[0] == made[1]
    assert made[0].grid == wavy_field.grid


def test_words() -> None:
    assert issubclass(FILTER, FieldFilter) and FILTER.name == "multiresolution"
    assert FILTER.parse("") == FILTER.parse("3") == MultiresolutionFilter(3, "coarse")
    assert FILTER.parse("stages=5,keep=details") == MultiresolutionFilter(5, "details")
    assert FILTER.parse(MultiresolutionFilter(7, "details").words) == MultiresolutionFilter(7, "details")
    for text in ("0", "13", "-1", "2.5", "stages=nan"):
        with pytest.raises(InvalidArgument, match="stages"):
            FILTER.parse(text)
    with pytest.raises(InvalidArgument, match="keep: found 'fine'; expected coarse or details"):
        FILTER.parse("keep=fine")


@pytest.mark.shared
def test_a_real_picture_comes_back(shared_data: Path) -> None:
    from PIL import Image

    pictures = sorted(p for p in shared_data.rglob("*.png") if p.stat().st_size < 4 << 20)
    if not pictures:
        pytest.skip("no picture")
    picture = np.asarray(Image.open(pictures[0]))
    coefficients = quincunx_forward(picture, 8)
    assert np.array_equal(quincunx_inverse(coefficients, 8, picture.dtype), picture)
    energies = stage_mean_squares(coefficients, QUINCUNX, 8)
    assert energies[:8].max() < energies[8]
